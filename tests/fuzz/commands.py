"""Command lines from the registry's own grammar, most of them a little wrong, in a process whose time is limited.

By hand: ``python -m tests.fuzz.commands --examples 1000``. Classes of outcome: refused (exit code 2 and one line),
right (0), fold failed (1, and the line that says which fold and why), wrong (any other end), traceback, beyond (time,
memory).
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import resource
import select
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 60.0
MOST = 310  # characters of the one line, with "bench: "
MEMORY = 4 << 30  # bytes above what the libraries take
CLASSES = ("refused", "right", "fold failed", "wrong", "traceback", "beyond")
ODD = [
    *("", "0", "1", "-1", "2", "3", "0.5", "-0.5", "1e-300", "1e308", "1e309", "nan", "inf", "-inf", "None", "true"),
    *("false", "1000001", "2147483648", "4294967296", "1000000000000", "9" * 25, "9" * 5000, "0x10", "1_0", "١", "½"),
    *("a" * 300, "a\0b", "\n", "=", ",", ",,", "1,", "+", "a+b", "é", "'", '"', "\\", "../../x", "/dev/null", "-", "~"),
    *("$(id)", "{0}", "%s", "[", "__class__", "None,1", "1,1", "x" * 4000, "\ud800"),
]
WHERE = [
    *("variant == 'rough'", "subject < '2'", "repetition > 0", "repetition.isin([1])", "gesture in ['tap', 'pat']"),
    *(
        "gesture.str.startswith('t')",
        "not (variant == 'x')",
        "repetition + 1 == 2",
        "nothing == 1",
        "gesture",
        "1",
        "(",
    ),
    *(
        "__import__('os')",
        "gesture.to_csv('x')",
        "@x",
        "gesture == " * 200,
        "(" * 500,
        "9" * 5000 + " < repetition",
        "",
    ),
]
CHEAP = {  # parameters that keep a valid line short, where they are not what is tried
    "trees": "5",
    "rounds": "5",
    "epochs": "1",
    "pretraining": "1",
    "runs": "1",
    "patience": "1",
    "trials": "2",
    "iterations": "2",
    "kernels": "84",
}
SLOW = {
    "auto",
    "rocket",
    "touchnet",
    "mlp",
    "balli2015_rf",
    "wingerden2014_mlp",
}  # seconds to minutes even on so few captures


@dataclass
class Ended:
    """How one command line ended."""

    kind: str
    said: str
    seconds: float


def line(rng: random.Random) -> list[str]:
    """One command line: a valid one, then up to three changes."""
    command = rng.choice(
        ["run"] * 5 + ["tune", "stress", "stream", "fit", "choose", "extract", "report", "check", "data"]
    )
    if command == "data":
        words = rng.choice(
            [
                [],
                ["import", "table", "x.csv"],
                ["import", "cost", "x"],
                ["export", "synth", "o.csv"],
                ["show", "synth"],
                ["no"],
            ]
        )
        pairs = {k: v for k, v in _keys(rng, "data") if rng.random() < 0.5}
        return ["data", *words, *_changed(rng, pairs)]
    return [command, *_changed(rng, dict(_keys(rng, command)))]


def _keys(rng: random.Random, command: str) -> list[tuple[str, str]]:
    """Keys that a command takes, with values that it should accept."""
    if command == "data":
        known = {"name": "n", "grid": "2x2", "rate_hz": "10", "full_scale": "255", "format": "cost", "subjects": "2"}
        return list(known.items())
    if command == "report":
        return [("out", "r")]
    if command == "check":
        return [("baseline", "b.json"), ("run", "false")]
    found = [("data.subjects", "3"), ("data.variants", "normal"), *_part(rng, "model", "models")]
    if command in ("run", "tune", "stress", "stream"):
        found += _part(rng, "protocol", "protocols")
        found += [("jobs", "1")] if rng.random() < 0.3 else []
    if rng.random() < 0.5 or command == "extract":
        found += _part(rng, "features", "features")
    if rng.random() < 0.3:
        found.append(("where", rng.choice(WHERE)))
    if rng.random() < 0.2:
        found.append(("target", rng.choice(["variant", "gesture+variant", "subject", "repetition", "nothing"])))
    own = {
        "stress": [("faults", rng.choice(["noise", "shift,rotation", "all"])), ("train_subjects", "1")],
        "stream": [("hop_ms", rng.choice(["100", "500"])), ("start", rng.choice(["onset", "middle"]))],
        "tune": [("trials", "2"), ("inner", "2"), ("budget", "1")],
        "fit": [("out", "m")],
        "choose": [("by", rng.choice(["flash", "ram"])), ("max_flash", "1kB"), ("margin", "1")],
        "extract": [("out", rng.choice(["f.csv", "f.parquet"])), ("data", "synth")],
    }
    return found + [pair for pair in own.get(command, []) if rng.random() < 0.7 or command == "extract"]


def _part(rng: random.Random, key: str, room: str) -> list[tuple[str, str]]:
    """A name of a room with some of its parameters."""
    from bench.arguments import text_of
    from bench.registry import load, names, parameters

    name = rng.choice([n for n in names(room) if n not in SLOW])
    usual = parameters(load(room, name))
    found = {k: text_of(v) for k, v in usual.items() if rng.random() < 0.15}
    found |= {k: CHEAP[k] for k in usual if k in CHEAP}
    return [(key, name), *((f"{key}.{k}", v) for k, v in found.items() if v)]


def _changed(rng: random.Random, pairs: dict[str, str]) -> list[str]:
    words = [f"{k}={v}" for k, v in pairs.items()]
    for _ in range(rng.choice([0, 0, 1, 1, 2, 3])):
        at = rng.randrange(len(words)) if words else 0
        key = words[at].partition("=")[0] if words else "model"
        words[at : at + 1] = rng.choice(
            [
                [f"{key}={rng.choice(ODD)}"],
                [f"{key}={rng.choice(ODD)}"],
                [f"{key}={rng.choice(ODD)},{rng.choice(ODD)}"],
                [f"{key}.{rng.choice(['C', 'frames', 'seed', 'x', ''])}={rng.choice(ODD)}"],
                [f"{rng.choice(ODD)}={rng.choice(ODD)}"],
                [rng.choice(ODD)],
                [key],
                [],
                [f"{key}x={rng.choice(ODD)}"],
                [f"{key}=1", f"{key}=1"],
            ]
        )
    return words


def serve() -> None:
    """Run the command lines on standard input, one JSON list each; answer each with a line of JSON."""
    sys.path.insert(0, str(ROOT))
    import bench.work.loop as loop
    from bench.cli import main
    from tests.conftest import InProcess

    loop.Processes = InProcess
    out = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    print("ready", file=out, flush=True)
    for given in sys.stdin:
        said, printed, begun = io.StringIO(), io.StringIO(), time.monotonic()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
            loop.console.file = said
            try:
                code: object = main(json.loads(given))
            except BaseException:  # whatever it is, it should not have come here
                code = traceback.format_exc()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(json.dumps([code, said.getvalue(), time.monotonic() - begun, peak]), file=out, flush=True)


def judged(code: object, said: str) -> tuple[str, str]:
    """The class of an outcome, and what shows it."""
    if isinstance(code, str) or "Traceback" in said:
        return "traceback", str(code)[-600:] if isinstance(code, str) else said[-600:]
    lines = [text for text in said.splitlines() if text.startswith("bench: ")]
    if code == 0:
        return "right", ""
    if code == 2:
        good = len(lines) == 1 and len(lines[0]) <= MOST
        return ("refused", lines[0]) if good else ("wrong", f"exit code 2 with {lines}")
    if code == 1 and " failed: " in said:
        return "fold failed", next(text for text in said.splitlines() if " failed: " in text)
    return "wrong", f"exit code {code}: {said[-300:]}"


class Commands:
    """A process that runs command lines in a folder of its own; it is replaced when it dies, hangs or has grown."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.process: subprocess.Popen | None = None
        self.first = 0.0

    def _start(self) -> subprocess.Popen:
        env = os.environ | {"TOUCHBENCH_HOME": str(self.folder / "home"), "PYTHONWARNINGS": "ignore"}
        env |= {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.commands", "--serve"],
            cwd=self.folder,
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        return process

    def stop(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None

    def run(self, words: list[str]) -> Ended:
        """Run one line."""
        if self.process is None:
            self.process = self._start()
        process = self.process
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps(words) + "\n")
        process.stdin.flush()
        if not select.select([process.stdout], [], [], SECONDS)[0]:
            self.stop()
            return Ended("beyond", f"no end after {SECONDS:g} s", SECONDS)
        answer = process.stdout.readline()
        if not answer:
            self.stop()
            return Ended("beyond", "the process died", 0.0)
        code, said, seconds, peak = json.loads(answer)
        if peak * 1024 > MEMORY:
            self.stop()
            return Ended("beyond", f"{peak / 1e6:.1f} GB", seconds)
        return Ended(*judged(code, said), seconds)


def fuzz(
    examples: int, seed: int, folder: Path, shown: bool = False
) -> tuple[Counter[str], list[tuple[list[str], Ended]]]:
    """Run many lines.

    Returns:
        How many ended how, and those that ended badly.
    """
    rng, counts, bad, slowest = random.Random(seed), Counter[str](), [], 0.0
    commands = Commands(folder)
    try:
        for i in range(examples):
            words = line(rng)
            ended = commands.run(words)
            counts[ended.kind] += 1
            slowest = max(slowest, ended.seconds)
            if ended.kind in CLASSES[3:]:
                bad.append((words, ended))
                if shown:
                    print([w[:80] for w in words], ended, sep="\n  ", flush=True)
            if shown and i % 50 == 49:
                print(f"{i + 1}: {dict(counts)}, slowest {slowest:.1f} s", flush=True)
    finally:
        commands.stop()
    return counts, bad


def main() -> int:
    """Parse the arguments, run, and print the table of outcomes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--examples", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        serve()
        return 0
    with tempfile.TemporaryDirectory() as folder:
        counts, bad = fuzz(given.examples, given.seed, Path(folder), shown=True)
    for kind in CLASSES:
        print(f"{kind:12}{counts[kind]:6}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
