"""Measures the numbers of README.md and the user pages again, by the table docs/notes/numbers.md.

    python docs/tools/page_numbers.py             those that need no HAART
    python docs/tools/page_numbers.py haart=yes   also those on HAART, imported as `haart`; networks take hours
    python docs/tools/page_numbers.py chip lda    only those with these words in page or commands

Prints the page, the numbers as written, the numbers now, and the data. The exit code is 1 if a number differs, or if a
page no longer has its text. Commands run through the Python API, in temporary folders with stores of their own.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
import tempfile
from collections.abc import Callable
from contextlib import chdir
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import bench

FOLDERS = tempfile.TemporaryDirectory()  # removed at the end
ROOT = Path(__file__).parent.parent.parent
TABLE = ROOT / "docs" / "notes" / "numbers.md"
WORDS = {"a quarter": (25.0, 5.0), "one half": (50.0, 5.0), "nearly five": (5.0, 0.5)}  # percent or points, deviation


@dataclass(frozen=True)
class Entry:
    """A row of the table.

    Attributes:
        page: path in the repository.
        text: words and numbers of the page.
        numbers: numbers among them, as written.
        commands: shell commands, without ``bench``.
        read: name of a function of `READ` and its arguments, separated by commas.
        data: ``synth``, ``reference`` or ``haart``.
    """

    page: str
    text: str
    numbers: list[str]
    commands: tuple[str, ...]
    read: str
    data: str

    def is_on_page(self) -> bool:
        """Return True if the page has the text."""
        return self.text in re.sub(r"\s+", " ", (ROOT / self.page).read_text(encoding="utf-8"))

    def now(self) -> list[float]:
        """The numbers, measured."""
        name, *arguments = self.read.split(", ")
        return READ[name](results(self.commands), *arguments)


def entries() -> list[Entry]:
    """The rows of the table; numbers are bold there."""
    found = []
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip().replace(r"\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 5 and cells[0].endswith(".md"):
            page, text, commands, read, data = cells
            numbers, commands = re.findall(r"\*\*(.+?)\*\*", text), re.findall("`bench ([^`]+)`", commands)
            found.append(Entry(page, text.replace("**", ""), numbers, tuple(commands), read, data))
    return found


def agrees(written: str, now: float) -> bool:
    """Return True if a number equals the written one in its digits; roughly for words and numbers from 1000."""
    digits = written.replace(" ", "")
    value, most = WORDS.get(written) or (float(digits), 0.5 * 10.0 ** -len(digits.partition(".")[2]))
    return abs(now - value) <= (max(most, 0.005 * value) if value >= 1000 else most) + 1e-9


@cache
def results(commands: tuple[str, ...]) -> list[Any]:
    """Results of commands that share a store."""
    found = []
    folder = tempfile.mkdtemp(dir=FOLDERS.name)  # kept to the end: workers of the last commands still are in theirs
    with chdir(folder):
        os.environ["MLFLOW_TRACKING_URI"] = f"sqlite:///{folder}/mlflow.db"
        for command in commands:
            name, *words = shlex.split(command)
            found.append(COMMANDS[name](**dict(word.split("=", 1) for word in words if "=" in word)))
    return found


def leaderboard() -> Any:
    """The reference results, by task and name."""
    return bench.results("reference").set_index(["task", "name"])


def accuracy(found: list[Any]) -> list[float]:
    """Accuracy of every run, in percent.

    Raises:
        RuntimeError: a fold failed, so the accuracy is of others.
    """
    for table in found:
        for done in table["folds"] if "folds" in table else ():
            if len({*str(done).split("/")}) > 1:
                raise RuntimeError(f"only {done} folds are done")
    return [float(value) for table in found for value in table["accuracy"]]


def sizes(found: list[Any]) -> list[float]:
    """Accuracy in percent and flash in kB of the first run."""
    return [*accuracy(found)[:1], found[0]["flash_bytes"][0] / 1000]


def difference(found: list[Any], first: str, second: str) -> list[float]:
    """Accuracy of one run minus that of another, in points, by their positions from 0."""
    return [accuracy(found)[int(first)] - accuracy(found)[int(second)]]


def values(row: Any, columns: tuple[str, ...]) -> list[float]:
    """Values of a row; ``kB`` before a column converts bytes."""
    return [float(row[c.removeprefix("kB ")]) / (1000 if c.startswith("kB ") else 1) for c in columns]


def reference(found: list[Any], task: str, name: str, *columns: str) -> list[float]:
    """Columns of a reference result."""
    return values(found[0].loc[(task, name)], columns)


def choice(found: list[Any], chosen: str, other: str) -> list[float]:
    """Accuracy and flash of the chosen system, accuracy of another, loss ± its standard error, flash of the other."""
    table = found[-1].choice.table.set_index("system")
    assert found[-1].system == chosen, found[-1]
    one, best = table.loc[chosen], table.loc[other]
    return [one["accuracy"], one["flash"], best["accuracy"], one["loss"], one["error"], best["flash"]]


def in_c(found: list[Any], *columns: str) -> list[float]:
    """Columns of the first run of ``bench chip``."""
    return values(found[0].iloc[0], columns)


def captures(found: list[Any]) -> list[float]:
    """Number of captures of a surveyed corpus."""
    return [float(found[0].counts["captures"].sum())]


def groups(found: list[Any], number: str) -> list[float]:
    """A row of ``bench scene``: accuracy, its interval, that of the largest group, subjects with the same groups."""
    row = found[-1].set_index("groups").loc[int(number)]
    return values(row, ("accuracy", "low", "high", "largest", "same"))


COMMANDS: dict[str, Callable[..., Any]] = {
    "run": bench.run,
    "choose": bench.choose,
    "scene": bench.scene,
    "chip": lambda **values: bench.chip(**values).full,
    "leaderboard": leaderboard,
    "data": bench.look,
}
READ: dict[str, Callable[..., list[float]]] = {
    f.__name__: f for f in (accuracy, sizes, difference, reference, choice, groups, in_c, captures)
}


def main(arguments: list[str]) -> int:
    """Print the entries that the arguments select; 1 if a number differs, or a page no longer has its text."""
    words = [word for word in arguments if word != "haart=yes"]
    wrong = 0
    for one in entries():
        if not all(word in " ".join([one.page, *one.commands]) for word in words):
            continue
        if one.data == "haart" and "haart=yes" not in arguments:
            verdict, now = "not measured" if one.is_on_page() else "not on the page", []
        else:
            now = one.now()
            same = len(now) == len(one.numbers) and all(map(agrees, one.numbers, now))
            verdict = "not on the page" if not one.is_on_page() else "same" if same else "DIFFERS"
        wrong += verdict not in ("same", "not measured")
        measured_now = ", ".join(f"{value:.2f}" for value in now) or "-"
        print(f"{one.page}: {', '.join(one.numbers)} | now {measured_now} | {one.data} | {verdict}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
