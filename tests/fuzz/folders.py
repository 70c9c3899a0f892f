"""Stored corpora and tables of features with random damage, opened and used in a process that is watched.

By hand: ``python tests/fuzz/folders.py --examples 300 --seed 0``. Each example is a data folder with two imported
corpora, two generated ones and their features, of which one to three things are harmed. Classes of outcome:

- refused: in one line that says to import again; an import then makes it whole.
- right: what is used is what was stored: the damage is undone, computed again, or not in what counts.
- wrong: anything else is used, or what is whole is refused, or verifying and opening do not agree.
- traceback: another error than `InputError`, or the process died.
- beyond: over 10 seconds, or over 2 GiB of memory.
"""

import argparse
import json
import os
import random
import resource
import select
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # for those who start this file

from tests.fuzz.damage import DAMAGE

SECONDS = 10.0
MEMORY = 2 << 30  # bytes of address space above what the libraries take
CLASSES = ("refused", "right", "wrong", "traceback", "beyond")
NAMES = ("arm", "leg")
GENERATED = {"subjects": 1, "variants": ("normal",), "rows": 3, "cols": 3}


def made(name):
    """What an import of this name finds."""
    import numpy as np
    import pandas as pd

    from bench.corpora.corpus import Corpus

    rng = np.random.default_rng(NAMES.index(name))
    arrays = [rng.integers(0, 1000, (int(rng.integers(2, 9)), 3, 4)).astype(np.uint16) for _ in range(12)]
    captures = pd.DataFrame(
        {
            "subject": np.repeat(["1", "2", "3"], 4),
            "gesture": np.roll(["pat", "rub", "tap"] * 4, NAMES.index(name)),
            "force": np.where(rng.random(12) < 0.3, np.nan, rng.random(12)),
        }
    )
    info = {"source": name, "licence": "", "synthetic": False, "warnings": []}
    return Corpus.from_captures(arrays, captures, 100.0 + NAMES.index(name), info=info)


class Broken(Exception):
    """An outcome that must not be."""


def check(good, what):
    if not good:
        raise Broken(what)


def same(one, other):
    """Whether two corpora hold the same."""
    import numpy as np

    return (
        np.array_equal(one.frames, other.frames)
        and one.frames.dtype == other.frames.dtype
        and np.array_equal(one.lengths, other.lengths)
        and np.array_equal(one.starts, other.starts)
        and one.captures.astype(str).equals(other.captures.astype(str))
        and (one.rate_hz, one.full_scale) == (other.rate_hz, other.full_scale)
        and {**one.info, "format": 0} == {**other.info, "format": 0}
    )


def whole(home, template, name):
    """Whether the files that hold a corpus are those that were stored, whatever they look like."""
    parts = [p.relative_to(template) for p in (template / "corpora" / name).rglob("*") if p.is_file()]
    parts = [p for p in parts if p.name != "seal.json"]
    pairs = [(home / p, template / p) for p in parts]
    return all(
        one.is_file() and one.stat().st_size == other.stat().st_size and one.read_bytes() == other.read_bytes()
        for one, other in pairs
    )


def used(home, template):
    """Open, verify and use all that is in a data folder; whether anything was refused."""
    from bench.corpora import library, synth
    from bench.corpora.library import import_corpus, open_corpus, verify
    from bench.errors import InputError
    from features import cache as kept
    from features.jung28 import Jung28

    library.load = lambda room, kind: lambda source: made(source.name)
    refused = []

    def features_are_right(corpus, expected):
        kept._read.cache_clear()
        check(Jung28().transform(corpus).equals(Jung28().extract(expected)), "other features")

    for name in NAMES:
        expected, as_stored = made(name), whole(home, template, name)
        try:
            corpus = open_corpus(name, {})
            check(corpus.name == name and same(corpus, expected), f"{name}: another corpus is used")
            check(not any(verify(name).values()), f"{name}: opened, and verified as damaged")
        except InputError as e:
            message = str(e)
            check(len(message) <= 300 and message.isprintable(), f"said {message!r}")
            check("import it again" in message or "Import it with" in message, f"said {message!r}")
            check(not as_stored, f"{name} is whole, but: {message}")
            refused.append(message)
            try:
                check(any(verify(name).values()), f"{name}: refused, and verified as good")
            except InputError as again:
                check("Import it with" in str(again), f"verify said {again!r}")
            import_corpus("any", Path(name), {"name": name})
            corpus = open_corpus(name, {})
            check(same(corpus, expected) and not any(verify(name).values()), f"{name}: imported again, and not right")
        features_are_right(corpus, expected)
    for seed in (0, 1):
        expected = synth.generate(**GENERATED, seed=seed)
        corpus = open_corpus("synth", GENERATED | {"seed": seed})
        check(same(corpus, expected) and corpus.synthetic, f"synth {seed}: another corpus is used")
        check(corpus.info == expected.info and corpus.name == "synth", f"synth {seed}: other words")
        features_are_right(corpus, expected)
    left = [p for p in home.rglob(".*") if not p.name.endswith(".lock")]
    check(not left, f"left behind: {left}")
    return refused


def example(place, seed, index):
    """Harm a copy of the template and use it: kind of outcome, what was said, and the damage."""
    rng = random.Random(f"{seed} {index}")
    template, home = place / "template", place / "home"
    shutil.rmtree(home, ignore_errors=True)
    shutil.copytree(template, home)
    os.environ["TOUCHBENCH_HOME"] = str(home)
    if rng.random() < 0.7:  # else the copy itself looks changed
        for path in home.rglob("seal.json"):
            found = (path.parent / "frames.npy").stat()
            look = [found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino]
            path.write_text(json.dumps([json.loads(path.read_text())[0], *look]))
    time.sleep(0.02)  # clocks of files tick every few milliseconds
    names, wanted = [], rng.choice([1, 1, 2, 3])
    for _ in range(20):
        rooms = rng.choice([["corpora/arm"], ["corpora/synth"], ["features"], ["corpora", "features"], ["corpora"]])
        paths = sorted(p for room in rooms for p in (home / room).rglob("[!.]*") if p.is_file() and not p.is_symlink())
        paths = [p for p in paths if p.stat().st_size < 1 << 20]
        damage = rng.choice(DAMAGE)
        try:
            damage(paths, rng)
            names.append(damage.__name__)
        except Exception:  # it needs what is not there, or can no longer be read
            continue
        if len(names) == wanted:
            break
    try:
        refused = used(home, template)
        return ("refused", refused[0], names) if refused else ("right", "", names)
    except Broken as e:
        return "wrong", str(e), names
    except MemoryError:
        return "beyond", traceback.format_exc()[-1500:], names
    except Exception:
        return "traceback", traceback.format_exc()[-3000:], names


def work(place):
    """Answer one example a line until the parent closes the pipe."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    template = place / "template"
    if not template.exists():
        os.environ["TOUCHBENCH_HOME"] = str(template)
        template.mkdir()
        from bench.corpora import library
        from bench.corpora.library import import_corpus

        library.load = lambda room, kind: lambda source: made(source.name)
        for name in NAMES:
            import_corpus("any", Path(name), {"name": name})
        used(template, template)
    size = Path("/proc/self/statm")
    if size.exists():
        here = int(size.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (here + MEMORY, here + MEMORY))
    print(json.dumps(["ready"]), file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(example(place, *json.loads(line))), file=answers, flush=True)


def fuzz(examples, seed):
    """Outcomes by damage, and what must not be: (index, kind, what was said, damage)."""
    counts, bad, process = Counter(), [], None

    def answer(seconds):
        ready, _, _ = select.select([process.stdout], [], [], seconds)
        line = process.stdout.readline() if ready else b""
        return json.loads(line) if line else None

    with tempfile.TemporaryDirectory() as place:
        for index in range(examples):
            if process is None:
                pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
                process = subprocess.Popen([sys.executable, __file__, "--work", place], cwd=ROOT, **pipes)
                if answer(120) != ["ready"]:
                    process.kill()
                    raise RuntimeError("the process that opens folders did not start")
            process.stdin.write(json.dumps([seed, index]).encode() + b"\n")
            found = answer(SECONDS)
            if found is None:
                try:
                    found = ("traceback", f"the process died with {process.wait(1)}", [])
                except subprocess.TimeoutExpired:
                    found = ("beyond", f"no answer in {SECONDS:g} s", [])
                process.kill()
                process.communicate()
                process = None
            kind, said, damage = found
            counts.update((name, kind) for name in damage or ["none"])
            counts["all", kind] += 1
            if kind not in ("refused", "right"):
                bad.append((index, kind, said, damage))
        if process is not None:
            process.kill()
            process.communicate()
    return counts, bad


def main():
    """Print the table of outcomes; exit code 1 if any is one that must not be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--examples", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.work:
        work(asked.work)
        return 0
    started = time.perf_counter()
    counts, bad = fuzz(asked.examples, asked.seed)
    print(f"{'damage':18}" + "".join(f"{kind:>11}" for kind in CLASSES))
    for name in [*sorted({name for name, _ in counts} - {"all"}), "all"]:
        print(f"{name:18}" + "".join(f"{counts[name, kind]:11}" for kind in CLASSES))
    print(f"{asked.examples} examples in {time.perf_counter() - started:.0f} s; one may have several kinds of damage")
    for index, kind, said, damage in bad:
        print(f"\nexample {index} of seed {asked.seed}: {kind} after {', '.join(damage)}\n{said}")
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
