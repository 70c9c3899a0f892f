"""Imports in a process of their own, whose time and memory are measured, so that a bad one harms nobody."""

import gc
import json
import os
import resource
import select
import subprocess
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 10.0
MIB = 1500.0
MESSAGE = 300  # characters
ADDRESSES = 8 << 30  # bytes; a last wall around the machine, far above what counts as too much
CLASSES = ("refused", "right", "wrong", "traceback", "beyond")


@dataclass
class Outcome:
    """What became of one import.

    Attributes:
        kind: one of CLASSES.
        message: what was said, or what differs.
        seconds: of the import alone.
        mib: highest resident memory of the process while it imported.
    """

    kind: str
    message: str
    seconds: float = 0.0
    mib: float = 0.0


class Child:
    """A process that imports one file after another; it is replaced when it dies, hangs or has grown.

    Args:
        seconds: longest time of an import.
        mib: most memory of the process, of which 300 MiB are libraries.
    """

    def __init__(self, seconds: float = SECONDS, mib: float = MIB) -> None:
        self.seconds, self.mib = seconds, mib
        self.process: subprocess.Popen | None = None

    def __enter__(self) -> "Child":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None

    def run(self, kind: str, path: Path, options: dict[str, str], valid: bool | None = None) -> Outcome:
        """Import a file and compare what was stored with what the independent reader finds in it.

        Args:
            kind: name of the importer.
            path: the file.
            options: of the importer, as text.
            valid: whether the file is known to be good; None leaves that to the independent reader.
        """
        if self.process is None:
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
            self.process = subprocess.Popen([sys.executable, __file__], bufsize=0, **pipes)  # select sees no buffers
            self._answer(120)  # libraries are loaded
        request = {"kind": kind, "path": str(path), "options": options, "valid": valid}
        self.process.stdin.write(json.dumps(request).encode() + b"\n")
        self.process.stdin.flush()
        first = self._answer(self.seconds + 5)  # the child measures; these seconds are for a busy machine
        if first is None:
            return self._gone(f"no answer in {self.seconds:g} s")
        outcome = Outcome(**first)
        if outcome.seconds > self.seconds or outcome.mib > self.mib:
            self.stop()
            return Outcome("beyond", f"{outcome.seconds:.1f} s, {outcome.mib:.0f} MiB", outcome.seconds, outcome.mib)
        compared = self._answer(120)
        if compared is None:
            return self._gone("the independent reader did not end")
        if compared["mib"] > self.mib / 2:  # what one import leaves must not be counted for the next
            self.stop()
        return Outcome(compared["kind"], compared["message"], outcome.seconds, outcome.mib)

    def _answer(self, seconds: float) -> dict | None:
        ready, _, _ = select.select([self.process.stdout], [], [], seconds)
        line = self.process.stdout.readline() if ready else b""
        return json.loads(line) if line else None

    def _gone(self, why: str) -> Outcome:
        try:
            died = self.process.wait(1)  # what dies may take a moment
        except subprocess.TimeoutExpired:
            died = None
        self.stop()
        return Outcome("beyond", why) if died is None else Outcome("traceback", f"the process died with {died}")


def memory(name: str) -> float:
    """MiB of this process: ``VmHWM`` is the peak, ``VmRSS`` what it is now."""
    try:
        status = Path("/proc/self/status").read_text()
        return int(status.split(f"{name}:")[1].split()[0]) / 1024
    except OSError:  # not Linux: the highest so far, which is at least as strict
        scale = 1 << 20 if sys.platform == "darwin" else 1 << 10
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / scale


def forget_peak() -> None:
    """Let the peak begin again, where the system can."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        pass


def imported(kind: str, path: Path, options: dict[str, str]) -> tuple[Outcome, object]:
    """Import a file as ``bench data import`` does; the corpus too if there is one."""
    from bench.corpora.library import import_corpus
    from bench.errors import InputError

    corpus, message, outcome = None, "", "right"
    forget_peak()
    started = time.perf_counter()
    try:
        corpus = import_corpus(kind, path, options)
    except InputError as e:
        message, outcome = str(e), "refused"
        if len(message) > MESSAGE or len(message.splitlines()) != 1 or not message.isprintable():
            message, outcome = f"{len(message)} characters: {message!r}"[:2000], "wrong"
    except MemoryError:
        message, outcome = "MemoryError", "beyond"
    except Exception:
        message, outcome = traceback.format_exc()[-3000:], "traceback"
    return Outcome(outcome, message, time.perf_counter() - started, memory("VmHWM")), corpus


def judged(request: dict, outcome: Outcome, corpus: object) -> Outcome:
    """The outcome after a look at what the independent reader says of the file."""
    from tests.fuzz import readers

    if outcome.kind not in ("right", "refused"):
        return outcome
    try:
        expected = readers.read(request["kind"], Path(request["path"]), request["options"])
    except readers.Invalid as e:
        if request["valid"]:
            return Outcome("wrong", f"the independent reader refuses a good file: {e}")
        if outcome.kind == "right":
            return Outcome("wrong", f"imported, but {e}")
        return outcome
    except Exception:
        return Outcome("wrong", f"the independent reader is at fault: {traceback.format_exc()[-2000:]}")
    if outcome.kind == "refused":
        return Outcome("wrong", f"refused, but the independent reader finds no fault: {outcome.message}")
    if difference := readers.difference(expected, corpus):
        return Outcome("wrong", difference)
    return outcome


def main() -> None:
    """Answer one request a line until the parent closes the pipe."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    sys.path.insert(0, str(ROOT))

    import bench.corpora.library
    import bench.corpora.read.cost
    import bench.corpora.read.haart
    import bench.corpora.read.table  # noqa: F401

    try:
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    except (OSError, ValueError):
        pass
    with tempfile.TemporaryDirectory() as home:
        os.environ["TOUCHBENCH_HOME"] = home
        print("{}", file=out, flush=True)
        for line in sys.stdin:
            request = json.loads(line)
            outcome, corpus = imported(request["kind"], Path(request["path"]), request["options"])
            print(json.dumps(vars(outcome)), file=out, flush=True)
            outcome = judged(request, outcome, corpus)
            del corpus
            gc.collect()
            outcome.mib = memory("VmRSS")
            print(json.dumps(vars(outcome)), file=out, flush=True)


if __name__ == "__main__":
    main()
