"""Runs the examples of the documentation: every ``sh`` and ``python`` block of its pages, in a folder of its own.

A page's blocks run in order, in one temporary folder with an empty store and an empty data folder. Comments in the
page say what is special; they are not shown.

    <!-- not run: why -->        before a block: it is not run, and the page says why
    <!-- needs: aeon gcc -->     before a block: packages or programs without which it is not run
    <!-- output -->              after a block: what it printed is shown there (also: first 9 lines, last 9 lines)

A Python block that begins with ``# name.py`` is a file for the blocks after it. As a command, runs the pages named (by
default all of them) and ends with 1 if a block fails.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

DOCS = Path(__file__).parent.parent
ROOT = DOCS.parent
LONGEST = 300  # seconds of a block
BLOCK = re.compile(
    r"(?:^<!-- (?P<special>not run|needs): (?P<words>[^>]+) -->\n)?"
    r"^```(?P<language>sh|python)\n(?P<text>.*?)^```$"
    r"(?:\n\n?^<!-- output(?:: (?P<end>first|last) (?P<lines>\d+) lines)? -->$)?",
    re.DOTALL | re.MULTILINE,
)


class Failed(Exception):
    """A block that ends with an error; says which one and what it printed."""


@dataclass(frozen=True)
class Block:
    """A block of a page: what is typed, why it is not run if it is not, and which lines of its output are shown."""

    language: str
    text: str
    left_out: str
    shown: bool
    end: str  # first or last, where only so many lines are shown
    lines: int

    @property
    def file(self) -> str:
        """The name under which a Python block is saved for others; empty if it is run."""
        named = re.match(r"# (\w+\.py)\n", self.text)
        return named[1] if named and self.language == "python" else ""


def block(match: re.Match[str]) -> Block:
    """What `BLOCK` has found."""
    words = match["words"] or ""
    left_out = words if match["special"] == "not run" else ""
    if match["special"] == "needs" and (
        missing := [word for word in words.split() if not here(word)]
    ):
        left_out = f"needs {' and '.join(missing)}"
    shown = "<!-- output" in match[0].rpartition("```")[2]
    return Block(
        match["language"],
        match["text"],
        left_out,
        shown,
        match["end"] or "",
        int(match["lines"] or 0),
    )


def here(name: str) -> bool:
    """Whether a program or a package of that name is installed."""
    return bool(shutil.which(name) or (name.isidentifier() and find_spec(name)))


def environment(folder: Path) -> dict[str, str]:
    """Variables for commands: ``bench`` is this tree's, and data and store lie in `folder`."""
    programs = folder / ".bin"
    programs.mkdir()
    for name, code in {
        "bench": "-c 'import sys; from bench.cli import main; sys.exit(main())' ",
        "python": "",
    }.items():
        (programs / name).write_text(f'#!/bin/sh\nexec {sys.executable} {code}"$@"\n')
        (programs / name).chmod(0o755)
    kept = {key: value for key, value in os.environ.items() if key != "MLFLOW_TRACKING_URI"}
    return kept | {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "TOUCHBENCH_HOME": str(folder / ".home"),
        "OMP_NUM_THREADS": "1",
        "COLUMNS": "100",
    }


def outputs(page: str, store: Path) -> list[str]:
    """Run a page on a copy of an empty store; what each of its blocks printed, "" of those that are left out.

    Raises:
        Failed: a block ends with an error, or takes too long.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        variables = environment(folder)
        shutil.copy(store, folder / "mlflow.db")  # the first command would take seconds to make one
        return [printed(block(match), folder, variables) for match in BLOCK.finditer(page)]


def printed(block: Block, folder: Path, variables: dict[str, str]) -> str:
    """Run a block in a folder; what it printed, the folder's own name taken out.

    Raises:
        Failed: it ends with an error, or takes too long.
    """
    if block.left_out:
        return ""
    if block.file:
        (folder / block.file).write_text(block.text)
        return ""
    command = (
        ["bash", "-euo", "pipefail", "-c"] if block.language == "sh" else [sys.executable, "-c"]
    )
    try:
        about = {
            "capture_output": True,
            "text": True,
            "timeout": LONGEST,
            "stdin": subprocess.DEVNULL,
        }
        done = subprocess.run([*command, block.text], cwd=folder, env=variables, **about)
    except subprocess.TimeoutExpired as e:
        raise Failed(f"takes more than {LONGEST} s:\n{block.text}") from e
    if done.returncode:
        raise Failed(
            f"ends with {done.returncode}:\n{block.text}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    return done.stdout.replace(str(folder.resolve()), "/home/you").replace(str(folder), "/home/you")


def site_name(page: Path) -> str:
    """A page as the site names it: its place below docs/."""
    return page.relative_to(DOCS).as_posix() if page.is_relative_to(DOCS) else page.name


def run(pages: Iterable[Path]) -> dict[str, list[str] | str]:
    """Run pages, two at a time; by name what their blocks printed, or, as text, how one failed."""
    from bench.store.database import create

    with tempfile.TemporaryDirectory() as name:
        store = Path(name) / "mlflow.db"
        create(store)

        def result(page: Path) -> list[str] | str:
            try:
                return outputs(page.read_text(), store)
            except Failed as e:
                return f"{page.name}: a block {e}"

        pages = list(pages)
        with ThreadPoolExecutor(2) as threads:
            return dict(zip(map(site_name, pages), threads.map(result, pages), strict=True))


def main(arguments: list[str]) -> int:
    """Run the pages named, or all; 1 if a block fails."""
    found = run([DOCS / name for name in arguments] or sorted(DOCS.rglob("*.md")))
    failed = [said for said in found.values() if isinstance(said, str)]
    print(*failed, sep="\n", end="\n" if failed else "")
    print(f"{len(found) - len(failed)} of {len(found)} pages run")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
