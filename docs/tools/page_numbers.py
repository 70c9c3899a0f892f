"""Measures the numbers of README.md and the user pages again, by the table docs/notes/numbers.md.

    python docs/tools/page_numbers.py             those that need no HAART
    python docs/tools/page_numbers.py haart=yes   also those on HAART, imported as `haart`; networks take hours
    python docs/tools/page_numbers.py chip lda    only those with these words in page or commands

Prints the page, the numbers as written, the numbers now, and the data; then every figure that is written in two ways,
by two rows of the table, or by a page and the reference results. The exit code is 1 if a number differs, is written in
two ways, or if a page no longer has its text. Commands run through the Python API, in temporary folders with stores of
their own.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import bench

FOLDERS = tempfile.TemporaryDirectory()  # removed at the end
ROOT = Path(__file__).parent.parent.parent
TABLE = ROOT / "docs" / "notes" / "numbers.md"
FIGURES = ("haart-loso-v1", "cuddlebot-loso-v1")  # tasks whose accuracies the pages cite: means over people
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


def rows(columns: int) -> list[list[str]]:
    """The rows of the table on pages with so many columns."""
    split = (re.split(r"(?<!\\)\|", line)[1:-1] for line in TABLE.read_text(encoding="utf-8").splitlines())
    found = [[cell.strip().replace(r"\|", "|") for cell in cells] for cells in split]
    return [cells for cells in found if len(cells) == columns and cells[0].endswith(".md")]


def entries() -> list[Entry]:
    """The rows with commands; numbers are bold there."""
    found = []
    for page, text, commands, read, data in rows(5):
        numbers, typed = re.findall(r"\*\*(.+?)\*\*", text), re.findall("`bench ([^`]+)`", commands)
        found.append(Entry(page, text.replace("**", ""), numbers, tuple(typed), read, data))
    return found


def twice() -> list[str]:
    """A line for each number that two rows of the table read alike and write differently."""
    first: dict[tuple, tuple[str, str]] = {}
    found = []
    for one in entries():
        name, *arguments = one.read.split(", ")
        columns: Sequence[object] = range(len(one.numbers))
        if name in ("reference", "in_c"):  # whose last arguments name columns
            arguments, columns = arguments[: -len(columns)], arguments[-len(columns) :]
        for number, column in zip(one.numbers, columns, strict=True):
            page, before = first.setdefault((one.commands, name, *arguments, column), (one.page, number))
            if not same(before, number):
                found.append(f"{one.page}: {number}, but {page}: {before}; both by bench {one.commands[-1]}")
    return found


def same(one: str, other: str) -> bool:
    """Return True if two written numbers are equal in the digits that both have."""
    if one in WORDS or other in WORDS:
        return one == other
    short, long = sorted((one, other), key=lambda text: len(text.partition(".")[2]))
    return agrees(short, float(long.replace(" ", "")))


def statements(page: str) -> list[str]:
    """The sentences and the rows of tables of a page, code left out."""
    text = re.sub(r"^```.*?^```", "", page, flags=re.DOTALL | re.MULTILINE)
    found = [line for line in text.splitlines() if line.startswith("|")]
    prose = "\n".join("" if line.startswith("|") else line for line in text.splitlines())
    for block in re.split(r"\n\s*\n|\n(?=- )", prose):
        found += re.split(r"(?<=[.;:]) ", " ".join(block.split()))
    return found


def cited(statement: str, system: str) -> bool:
    """Return True if a sentence names a system, or a row of a table is its row."""
    if statement.startswith("|"):
        return statement.split("|")[1].strip() == system
    return re.search(rf"{re.escape(system)}(?! on `)", statement) is not None


def beside(
    pages: Mapping[str, str], figures: Mapping[str, Mapping[str, float]], others: Collection[tuple[str, str]]
) -> list[str]:
    """A line for each accuracy whose last digit is one beside the figure of its system: another measure or version.

    Args:
        pages: texts by name.
        figures: accuracy in percent by task, for each system in the words of the pages.
        others: pages and texts whose numbers are of something else.
    """
    found = []
    for name, page in pages.items():
        for statement in statements(page):
            if any(name == where and text in statement for where, text in others):
                continue
            numbers = re.findall(r"(?<![\d.+-])\d\d\.\d(?!\d)", re.sub(r"\[.*?\]", "", statement))
            for system, tasks in figures.items():
                for task, value in tasks.items():
                    near = [n for n in numbers if abs(float(n) - value) < 0.16 and not agrees(n, value)]
                    if near and cited(statement, system):
                        found.append(f"{name}: {', '.join(near)}, but {system} has {value:.1f} in {task}: {statement}")
    return found


def pages() -> dict[str, str]:
    """The texts of all pages by path, but for the table."""
    paths = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return {str(p.relative_to(ROOT)): p.read_text(encoding="utf-8") for p in paths if p != TABLE}


def reference_figures() -> dict[str, dict[str, float]]:
    """The mean accuracy over people of each reference result by task, for each system as the pages name it."""
    found: dict[str, dict[str, float]] = {}
    for (task, _), row in leaderboard().iterrows():
        if task in FIGURES:
            words = " on ".join(f"`{part}`" for part in row["system"].split(" · "))
            found.setdefault(words, {})[task] = float(row["subject_mean"])
    return found


def differently() -> list[str]:
    """A line for each figure that the table or the pages write in two ways."""
    return twice() + beside(pages(), reference_figures(), [(page, text) for page, text, _ in rows(3)])


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


def in_c(found: list[Any], *columns: str) -> list[float]:
    """Columns of the first run of ``bench chip``."""
    return values(found[0].iloc[0], columns)


def captures(found: list[Any]) -> list[float]:
    """Number of captures of a surveyed corpus."""
    return [float(found[0].counts["captures"].sum())]


def groups(found: list[Any], number: str) -> list[float]:
    """A row of ``bench groups``: accuracy, its interval, that of the largest group, subjects with the same groups."""
    row = found[-1].set_index("groups").loc[int(number)]
    return values(row, ("accuracy", "low", "high", "largest", "same"))


COMMANDS: dict[str, Callable[..., Any]] = {
    "run": bench.run,
    "choose": bench.choose,
    "groups": bench.groups,
    "chip": lambda **values: bench.chip(**values).full,
    "leaderboard": leaderboard,
    "data": bench.look,
}
READ: dict[str, Callable[..., list[float]]] = {
    f.__name__: f for f in (accuracy, sizes, difference, reference, groups, in_c, captures)
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
    in_two_ways = [] if words else differently()
    print("".join(f"{line}\n" for line in in_two_ways), end="")
    return int(wrong > 0 or bool(in_two_ways))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
