"""Kill commands at random moments, repeat them, and compare what they stored with what an unbroken run stores.

Run by hand, on Linux; pytest does not collect it:

    python -m tests.kills --kills 100 --seed 0

Each kill is a round: a fresh working folder, data folder and TMPDIR; SIGKILL after a share of the time that the command
takes, to the process alone or to its group; the same command again, in every third round killed a second time, until it
ends. The exit code is 1 if anything differs, fails, runs on or lies about; those rounds are kept and named.
``--round 17`` repeats one round, ``--only run,fit`` takes some commands.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlparse

import pandas as pd
from filelock import FileLock, Timeout
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

ROOT = Path(__file__).resolve().parents[2]
BENCH = [sys.executable, "-c", "import sys; from bench.cli import main; sys.exit(main())"]
MARK = "TOUCHBENCH_KILLS"  # in the environment of all processes of a round
PATIENCE = 5.0  # seconds in which workers must end after their parent
LIMIT = 600.0  # seconds of a command that is not killed
SYNTH = ["data=synth", "data.subjects=4", "data.variants=normal", "features=jung28"]
# What a clock or the memory of the process gives differs between any two runs; decision_ms adds a time to what is seen.
MEASURED = re.compile(
    r"(decide_ms|predict_ms)(_p\d+)?|(capture_)?decision_ms|reference_ms|predict_relative|decisions_per_second"
    r"|peak_rss_bytes|seconds|\w+_seconds|front"  # the front of a search is one of accuracy against time
)
COLUMNS = (
    "rounds",
    "parent killed",
    "group killed",
    "killed twice",
    "ended before",
    "equal",
    "different",
    "not resumed",
    "left running",
    "left lying",
    "half between",
)
BAD = ("different", "not resumed", "left running", "left lying")

State = dict[str, str]  # what is stored, by a name, as a digest or a short text


@dataclass
class Place:
    """Folders of a round, and the processes that were seen there."""

    root: Path
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)
    pids: set[int] = field(default_factory=set)

    @property
    def work(self) -> Path:
        return self.root / "work"

    @property
    def home(self) -> Path:
        return self.root / "home"

    @property
    def tmp(self) -> Path:
        return self.root / "tmp"

    @property
    def log(self) -> Path:
        return self.root / "log.txt"


@dataclass(frozen=True)
class Command:
    """A command that is killed.

    Attributes:
        name: in tables.
        arguments: of ``bench``.
        collect: what it stored.
        prepared: folders from which rounds start, in turn; None is an empty one.
        between: looks at what a kill left, before the command is repeated: "", "half", or what is wrong.
        refusal: part of the message of a repeated command that is right to refuse, if all is there.
    """

    name: str
    arguments: list[str]
    collect: Callable[[Place], State]
    prepared: tuple[Path | None, ...] = (None,)
    between: Callable[[Place, State], str] | None = None
    refusal: str = ""


@dataclass(frozen=True)
class Reference:
    """An unbroken run: its seconds, what it stored, and all names in its data folder."""

    seconds: float
    state: State
    names: frozenset[str]


@dataclass
class Round:
    """What became of one kill."""

    counts: Counter[str]
    problems: list[str]


def main() -> int:
    """Kill, compare, print; 1 if anything is wrong."""
    asked = options()
    base = Path(tempfile.mkdtemp(prefix="kills-", dir=asked.folder))
    screen = Console(soft_wrap=True, highlight=False)
    screen.print(f"code in {ROOT}, rounds in {base}")
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=screen
    )
    with bar:
        task = bar.add_task("preparing", total=None)
        commands = prepare(base / "prepared")
        if asked.only:
            commands = [c for c in commands if c.name in asked.only.split(",")]
        chosen = [asked.round] if asked.round is not None else list(range(asked.kills))
        references: dict[tuple[str, int], Reference] = {}
        bar.update(task, total=len(chosen), completed=0)
        totals = {command.name: Counter[str]() for command in commands}
        for i in chosen:
            command = commands[i % len(commands)]
            turn = i // len(commands)
            group = bool((turn + i % len(commands)) % 2)  # alternates within a command and from one to the next
            begin = turn // 2 % len(command.prepared)
            if (command.name, begin) not in references:
                bar.update(task, description=f"{command.name} without a kill")
                references[command.name, begin] = reference(command, begin, base / "reference")
                screen.print(f"{command.name} takes {references[command.name, begin].seconds:.1f} s")
            bar.update(task, description=f"{i}: {command.name}")
            rng = random.Random(f"{asked.seed} {i}")
            done = play(command, begin, references[command.name, begin], base / f"round{i}", group, i % 3 == 2, rng)
            totals[command.name] += done.counts
            for problem in done.problems:
                screen.print(f"round {i}, {command.name}: {problem}", markup=False)
            if any(done.counts[column] for column in BAD):
                screen.print(f"  kept: {base / f'round{i}'}")
            else:
                shutil.rmtree(base / f"round{i}", ignore_errors=True)
            bar.advance(task)
    bad = report(screen, totals)
    if not bad:
        shutil.rmtree(base, ignore_errors=True)
    return int(bad)


def options() -> argparse.Namespace:
    """From the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.kills")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--round", type=int, help="only this one")
    parser.add_argument("--only", default="", help="names of commands, with commas")
    parser.add_argument("--folder", help="where rounds lie; default: where temporary files do")
    return parser.parse_args()


def report(screen: Console, totals: dict[str, Counter[str]]) -> bool:
    """Print all counts; whether one is bad."""
    table = Table("command", *COLUMNS, title="kills")
    everything = sum(totals.values(), Counter[str]())
    for name, counts in {**totals, "all": everything}.items():
        table.add_row(name, *(str(counts[column]) for column in COLUMNS))
    Console(width=max(160, screen.width)).print(table)
    print("half between: a report of which a part was new when the kill came; the repeated command wrote it anew")
    return any(everything[column] for column in BAD)


# What is killed


def prepare(folder: Path) -> list[Command]:
    """The commands, with tables to import and stores to report on."""
    made = place(folder / "made")
    must(made, "data", "export", "synth", "large.csv", "format=cost", "subjects=4", "repetitions=2")
    must(made, "data", "export", "synth", "small.csv", "format=cost", "subjects=2", "variants=normal")
    large, small = made.work / "large.csv", made.work / "small.csv"
    table = ["name=arm", "grid=8x8", "rate_hz=135"]
    before = place(folder / "imported")
    must(before, "data", "import", "table", str(small), *table)

    one = place(folder / "one")
    must(one, "run", *SYNTH, "model=svm")
    must(one, "report")
    two = place(folder / "two")
    for path in (one.work, one.home):
        shutil.copytree(path, two.root / path.name, dirs_exist_ok=True)
    must(two, "stream", *SYNTH, "model=svm", "out=stream")  # its figures and one system more make the new report differ
    must(two, "run", *SYNTH, "model=bayes")
    stored, reported = folder / "stored", folder / "reported"
    for target in (stored, reported):  # artifacts are read where they lie
        (target / "work").mkdir(parents=True)
        shutil.copy(two.work / "mlflow.db", target / "work")
        shutil.copytree(two.home, target / "home")
    shutil.copytree(one.work / "report", reported / "work" / "report")
    old_report, old_corpus = files(one.work / "report", ".csv"), corpora(before)

    return [
        Command("run", ["run", *SYNTH, "model=svm"], collect_store),
        Command("stress", ["stress", *SYNTH, "model=svm", "faults=noise,shift"], outputs("stress")),
        Command("stream", ["stream", *SYNTH, "model=svm", "out=stream"], outputs("stream")),
        Command("tune", ["tune", *SYNTH, "model=svm", "trials=4", "inner=2"], collect_store),
        Command(
            "import",
            ["data", "import", "table", str(large), *table],
            corpora,
            (None, before.root),
            lambda at, new: "" if corpora(at) in ({}, old_corpus, new) else "corpus neither old nor new after the kill",
        ),
        Command(
            "fit",
            ["fit", *SYNTH, "model=rf", "out=model"],
            lambda at: collect_fit(at, small),
            refusal="there is something already",
        ),
        Command(
            "report",
            ["report"],
            lambda at: files(at.work / "report", ".csv", ".md"),
            (stored, reported),
            lambda at, new: half(files(at.work / "report", ".csv"), old_report, new),
        ),
    ]


def half(found: State, old: State, new: State) -> str:
    """Whether the tables of a report are neither those of the old one nor those of the new one."""
    now, *whole = ({k: v for k, v in report.items() if k.endswith(".csv")} for report in (found, old, new))
    return "" if now in ({}, *whole) else "half"


# What is stored


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def without_times(path: Path) -> str:
    """Digest of a table, times left out; bit for bit where there are none."""
    if path.suffix == ".parquet" and not any(MEASURED.fullmatch(c) for c in pd.read_parquet(path).columns):
        return digest(path.read_bytes())
    table = pd.read_csv(path, dtype=str) if path.suffix == ".csv" else pd.read_parquet(path)
    return digest(table[[c for c in table.columns if not MEASURED.fullmatch(str(c))]].to_csv(index=False).encode())


def files(folder: Path, *read: str) -> State:
    """Names of all files of a folder; of some kinds also the content."""
    found = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        found[str(path.relative_to(folder))] = digest(path.read_bytes()) if path.suffix in read else "there"
    return found


def collect_store(at: Place) -> State:
    """All runs that are not deleted: metrics but times, parameters, tags, captures, tables; files by name."""
    from mlflow import MlflowClient

    found: State = {}
    client = MlflowClient(f"sqlite:///{at.work / 'mlflow.db'}")
    for run in client.search_runs([e.experiment_id for e in client.search_experiments()], max_results=1000):
        tags = {k: v for k, v in run.data.tags.items() if not k.startswith("mlflow.") or k == "mlflow.note.content"}
        parts = (tags.get("touchbench.kind"), tags.get("touchbench.fold"), run.info.run_name)
        name = " ".join(str(part) for part in parts if part)
        while f"{name}: status" in found:  # there should be one
            name += " again"
        found[f"{name}: status"] = run.info.status
        found |= {f"{name}: metric {k}": repr(v) for k, v in run.data.metrics.items() if not MEASURED.fullmatch(k)}
        found |= {f"{name}: parameter {k}": v for k, v in run.data.params.items()}
        found |= {f"{name}: tag {k}": v for k, v in tags.items()}
        for i, given in enumerate(run.inputs.dataset_inputs if run.inputs else []):
            found[f"{name}: captures {i}"] = f"{given.dataset.name} {given.dataset.digest}"
        artifacts = Path(unquote(urlparse(run.info.artifact_uri).path))
        for path in sorted(p for p in artifacts.rglob("*") if p.is_file()):
            value = without_times(path) if path.suffix in (".csv", ".parquet") else "there"
            found[f"{name}: file {path.relative_to(artifacts)}"] = value
    return found


def outputs(folder: str) -> Callable[[Place], State]:
    """The runs, and a folder of tables and figures."""

    def collect(at: Place) -> State:
        there = at.work / folder
        tables = {p.name: without_times(p) for p in there.glob("*.csv")}
        return collect_store(at) | {f"{folder}/{k}": v for k, v in (files(there) | tables).items()}

    return collect


def corpora(at: Place) -> State:
    """The imported corpus that is pointed at, byte for byte."""
    folder = at.home / "corpora" / "arm"
    pointer = folder / "current"
    if not pointer.is_file():
        return {}
    name = pointer.read_text().strip()
    found = {"current": name} | files(folder / name, ".npy", ".parquet", ".json")
    return {k: "there" if k == "seal.json" else v for k, v in found.items()}  # that holds times and an inode


def collect_fit(at: Place, captures: Path) -> State:
    """The runs, and the labels of some captures by the model in the store and the one in the folder."""
    found = collect_store(at)
    from mlflow import MlflowClient

    client = MlflowClient(f"sqlite:///{at.work / 'mlflow.db'}")
    fitted = client.search_runs([e.experiment_id for e in client.search_experiments()], "status = 'FINISHED'")
    models = {"folder": "model"} | ({"store": f"runs:/{fitted[0].info.run_id}/model"} if fitted else {})
    for name, model in models.items():
        out = at.root / f"{name}.csv"
        code, said = ended(start(at, ["predict", model, str(captures), f"out={out}"]), at)
        found[f"labels by {name}"] = digest(out.read_bytes()) if code == 0 else f"exit code {code}: {said}"
    return found


# Rounds


def place(root: Path, template: Path | None = None) -> Place:
    """Fresh folders, or copies of prepared ones."""
    at = Place(root)
    shutil.rmtree(root, ignore_errors=True)
    for folder in (at.work, at.home, at.tmp):
        original = template / folder.name if template else None
        if original and original.is_dir():
            shutil.copytree(original, folder)
        else:
            folder.mkdir(parents=True)
    return at


def start(at: Place, arguments: list[str]) -> subprocess.Popen[bytes]:
    """A command as the leader of a group of its own."""
    environment = {k: v for k, v in os.environ.items() if k not in ("MLFLOW_TRACKING_URI", "PYTHONHOME")}
    environment |= {"PYTHONPATH": str(ROOT), "TOUCHBENCH_HOME": str(at.home), "TMPDIR": str(at.tmp), MARK: at.mark}
    with at.log.open("ab") as log:
        log.write(f"\n--- bench {' '.join(arguments)}\n".encode())
        log.flush()
        process = subprocess.Popen(
            [*BENCH, *arguments],
            cwd=at.work,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    at.pids.add(process.pid)
    return process


def ended(process: subprocess.Popen[bytes], at: Place) -> tuple[int | str, str]:
    """Exit code of a command that is let run, and the last line that it printed."""
    code: int | str
    try:
        code = process.wait(LIMIT)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        code = f"none in {LIMIT:g} s"
    lines = at.log.read_text(errors="replace").rpartition("\n--- bench ")[2].strip().splitlines()
    return code, next((line for line in reversed(lines) if line.strip()), "")[:300]


def must(at: Place, *arguments: str) -> None:
    """Run what cannot fail."""
    code, said = ended(start(at, list(arguments)), at)
    if code != 0:
        raise SystemExit(f"bench {' '.join(arguments)} gave {code}: {said} ({at.log})")


def reference(command: Command, begin: int, folder: Path) -> Reference:
    """Run a command twice without a kill; the first fills the system's caches, both must store the same."""
    states, seconds, names = [], 0.0, frozenset[str]()
    for turn in range(2):
        at = place(folder / f"{command.name}{begin}{turn}", command.prepared[begin])
        began = time.monotonic()
        must(at, *command.arguments)
        seconds = time.monotonic() - began
        names = listing(at)
        left = lying(at, names) + running(at)
        states.append(command.collect(at))
        if left:
            raise SystemExit(f"{command.name} leaves without any kill: {'; '.join(left)}")
    if differing := differences(*states):
        raise SystemExit(f"{command.name} does not repeat without any kill: {'; '.join(differing)}")
    return Reference(seconds, states[0], names)


def play(
    command: Command, begin: int, expected: Reference, folder: Path, group: bool, twice: bool, rng: random.Random
) -> Round:
    """One round: killed, repeated, compared."""
    counts, problems = Counter[str](), []
    counts["rounds"] = 1
    counts["group killed" if group else "parent killed"] = 1
    while True:
        at, moment = place(folder, command.prepared[begin]), rng.uniform(0, expected.seconds)
        if killed(at, command.arguments, moment, group):
            break
        counts["ended before"] += 1
    how = f"SIGKILL to the {'group' if group else 'process'} after {moment:.2f} of {expected.seconds:.2f} s"
    left = running(at)
    said = command.between(at, expected.state) if command.between else ""
    if twice:
        later = rng.uniform(0, expected.seconds)
        if killed(at, command.arguments, later, group):
            counts["killed twice"] = 1
            how += f", again after {later:.2f} s"
            left += running(at)
            said = said or (command.between(at, expected.state) if command.between else "")
    process = start(at, command.arguments)
    code, last = ended(process, at)
    left += running(at)
    scattered = lying(at, expected.names)
    try:
        found = command.collect(at)
    except Exception as e:  # whatever the store or a table raises after a kill is what is looked for
        found = {"cannot be read": f"{type(e).__name__}: {e}"}
    differing = differences(expected.state, found)
    counts["half between"] = int(said == "half")
    if said and said != "half":
        differing.append(said)
    right = code == 0 or (code == 2 and bool(command.refusal) and command.refusal in last and not differing)
    counts["not resumed"] = int(not right)
    counts["different"] = int(right and bool(differing))
    counts["equal"] = int(right and not differing)
    counts["left running"], counts["left lying"] = int(bool(left)), int(bool(scattered))
    if not right:
        problems.append(f"not resumed: exit code {code}: {last}")
    shown = [*differing[:12], *([f"and {len(differing) - 12} more"] if len(differing) > 12 else [])]
    for label, found_here in (("different", shown), ("left running", left), ("left lying", scattered)):
        if found_here:
            problems.append(f"{label}: {'; '.join(found_here)}")
    return Round(counts, [f"{problem} [{how}; begun {begin}]" for problem in problems])


def killed(at: Place, arguments: list[str], moment: float, group: bool) -> bool:
    """Start a command and kill it at a moment; False if it had ended."""
    process = start(at, arguments)
    try:
        process.wait(moment)
        return False
    except subprocess.TimeoutExpired:
        at.pids |= descendants(process.pid)
    (os.killpg if group else os.kill)(process.pid, signal.SIGKILL)
    return process.wait() == -signal.SIGKILL


def differences(expected: State, found: State) -> list[str]:
    """What differs, by name."""
    return [
        f"{name}: {found.get(name, 'missing')} instead of {expected.get(name, 'nothing')}"
        for name in sorted(expected.keys() | found.keys())
        if expected.get(name) != found.get(name)
    ]


# What is left


def parents() -> dict[int, tuple[int, str]]:
    """Of every process the parent and the state."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            rest = (folder / "stat").read_text().rpartition(")")[2].split()  # a name may hold anything
        except OSError:  # it has just ended
            continue
        found[int(folder.name)] = (int(rest[1]), rest[0])
    return found


def descendants(pid: int) -> set[int]:
    """Children of a process, theirs, and so on."""
    found, new, table = set[int](), {pid}, parents()
    while new:
        new = {child for child, (parent, _) in table.items() if parent in new} - found
        found |= new
    return found


def marked(at: Place) -> dict[int, str]:
    """Living processes of a round, by number, with what they run."""
    found = {}
    for pid, (_, state) in parents().items():
        try:
            if state not in "ZX" and f"{MARK}={at.mark}\0".encode() in Path(f"/proc/{pid}/environ").read_bytes():
                found[pid] = Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")[:100]
        except OSError:  # it has ended, or belongs to someone else
            continue
    return found


def running(at: Place) -> list[str]:
    """Processes that have not ended after some patience; they are ended."""
    until = time.monotonic() + PATIENCE
    while (there := marked(at)) and time.monotonic() < until:
        at.pids |= set(there)
        time.sleep(0.1)
    for pid in there:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:  # in this very moment
            pass
    return [f"process {pid}: {line}" for pid, line in there.items()]


def listing(at: Place) -> frozenset[str]:
    """All names in the data folder, and those in the working folder but the files of runs."""
    home = {f"home/{path.relative_to(at.home)}" for path in at.home.rglob("*")}
    work = {f"work/{path.relative_to(at.work)}" for path in at.work.rglob("*")}
    return frozenset(home | {name for name in work if not name.startswith(("work/mlruns/", "work/model/"))})


def lying(at: Place, expected: frozenset[str]) -> list[str]:
    """What lies about: scratch, hidden or unexpected names, locks that are held, semaphores, runs that seem to run."""
    found = [f"scratch {path}" for path in sorted((at.home / "tmp").glob("*")) + sorted(at.tmp.glob("*"))]
    scratch = "home/tmp/"
    for name in sorted(listing(at)):
        if name.startswith(scratch):
            continue
        path = at.root / name
        if name.endswith(".lock"):
            found += held(path)
        elif Path(name).name.startswith("."):
            found.append(f"hidden {name}")
        elif name not in expected:
            found.append(f"unexpected {name}")
    for path in Path("/dev/shm").glob("*"):
        if any(re.search(rf"(?<!\d){pid}(?!\d)", path.name) for pid in at.pids):
            found.append(f"shared memory {path.name}")
    return found + unfinished(at)


def held(path: Path) -> list[str]:
    """A lock that nobody can take."""
    try:
        with FileLock(path, timeout=0):
            return []
    except Timeout:
        return [f"held {path.name}"]


def unfinished(at: Place) -> list[str]:
    """Runs that say they run; they do not."""
    if not (at.work / "mlflow.db").exists():
        return []
    from mlflow import MlflowClient

    client = MlflowClient(f"sqlite:///{at.work / 'mlflow.db'}")
    found = client.search_runs([e.experiment_id for e in client.search_experiments()], "status = 'RUNNING'")
    return [f"run {run.info.run_name} RUNNING" for run in found]


if __name__ == "__main__":
    sys.exit(main())
