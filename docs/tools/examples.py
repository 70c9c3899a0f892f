"""Run the examples of the documentation: all ``sh`` and ``python`` blocks of its pages.

The blocks of a page run in order, in a temporary folder with an empty store and an empty data
folder. Comments in a page, which are not shown, say what is special about a block:

    <!-- not run: why -->        before it: it is not run, and the page says why
    <!-- needs: aeon gcc -->     before it: packages or programs without which it is not run
    <!-- output -->              after it: its output is shown there (also: first 9 lines, last 9
                                 lines)

A Python block that begins with ``# name.py`` is a file for the blocks after it. As a command, this
file runs the named pages, or all of them; exit code 1 if a block fails.
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
LONGEST_S = 300  # of a block
BLOCK = re.compile(
    r"(?:^<!-- (?P<special>not run|needs): (?P<words>[^>]+) -->\n)?"
    r"^```(?P<language>sh|python)\n(?P<text>.*?)^```$"
    r"(?:\n\n?^<!-- output(?:: (?P<end>first|last) (?P<lines>\d+) lines)? -->$)?",
    re.DOTALL | re.MULTILINE,
)


class BlockError(Exception):
    """A block ended with an error or took too long."""


@dataclass(frozen=True)
class Block:
    """A block of a page."""

    language: str
    text: str
    reason_not_run: str  # empty if it is run
    shows_output: bool
    end: str  # first or last, if only some lines of the output are shown
    lines: int  # number of these

    @property
    def file(self) -> str:
        """Name of the file that a Python block is for the others; empty if it is run."""
        name = re.match(r"# (\w+\.py)\n", self.text)
        return name[1] if name and self.language == "python" else ""


def read_block(match: re.Match[str]) -> Block:
    """Read a block from a match of `BLOCK`."""
    reason = match["words"] or ""
    if match["special"] == "needs":
        missing = [word for word in reason.split() if not _is_installed(word)]
        reason = f"needs {' and '.join(missing)}" if missing else ""
    shows_output = "<!-- output" in match[0].rpartition("```")[2]
    lines = int(match["lines"] or 0)
    return Block(match["language"], match["text"], reason, shows_output, match["end"] or "", lines)


def _is_installed(name: str) -> bool:
    """True if there is a program or a package of a name."""
    return bool(shutil.which(name) or (name.isidentifier() and find_spec(name)))


def make_environment(folder: Path) -> dict[str, str]:
    """Make variables for commands: ``bench`` is this tree's; data and store lie in a folder."""
    programs = folder / ".bin"
    programs.mkdir()
    run_bench = "-c 'import sys; from bench.cli import main; sys.exit(main())' "
    for name, options in {"bench": run_bench, "python": ""}.items():
        (programs / name).write_text(f'#!/bin/sh\nexec {sys.executable} {options}"$@"\n')
        (programs / name).chmod(0o755)
    kept = {key: value for key, value in os.environ.items() if key != "MLFLOW_TRACKING_URI"}
    return kept | {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "TOUCHBENCH_HOME": str(folder / ".home"),
        "OMP_NUM_THREADS": "1",
        "COLUMNS": "100",
    }


def run_page(page: str, store: Path) -> list[str]:
    """Run a page on a copy of an empty store; return the output of each block.

    Raises:
        BlockError: a block ends with an error, or takes too long.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        variables = make_environment(folder)
        shutil.copy(store, folder / "mlflow.db")  # making one takes seconds
        blocks = map(read_block, BLOCK.finditer(page))
        return [_run_block(block, folder, variables) for block in blocks]


def _run_block(block: Block, folder: Path, variables: dict[str, str]) -> str:
    """Run a block in a folder; return its output, "" if it is not run.

    Raises:
        BlockError: it ends with an error, or takes too long.
    """
    if block.reason_not_run:
        return ""
    if block.file:
        (folder / block.file).write_text(block.text)
        return ""
    shell = ["bash", "-euo", "pipefail", "-c"]
    command = [*(shell if block.language == "sh" else [sys.executable, "-c"]), block.text]
    try:
        process = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
            stdin=subprocess.DEVNULL,
            cwd=folder,
            env=variables,
        )
    except subprocess.TimeoutExpired as e:
        raise BlockError(f"takes more than {LONGEST_S} s:\n{block.text}") from e
    output = process.stdout
    if process.returncode:
        end = output[-2000:] + process.stderr[-2000:]
        raise BlockError(f"ends with {process.returncode}:\n{block.text}\n{end}")
    return output.replace(str(folder.resolve()), "/home/you").replace(str(folder), "/home/you")


def site_name(page: Path) -> str:
    """A page as the site names it: its path below docs/."""
    return page.relative_to(DOCS).as_posix() if page.is_relative_to(DOCS) else page.name


def run_pages(pages: Iterable[Path]) -> dict[str, list[str] | str]:
    """Run pages, two at a time; return the output of their blocks, or an error, by name."""
    from bench.store.database import create_database

    with tempfile.TemporaryDirectory() as name:
        store = Path(name) / "mlflow.db"
        create_database(store)

        def output_or_error(page: Path) -> list[str] | str:
            try:
                return run_page(page.read_text(), store)
            except BlockError as e:
                return f"{page.name}: a block {e}"

        pages = list(pages)
        with ThreadPoolExecutor(2) as threads:
            return dict(
                zip(map(site_name, pages), threads.map(output_or_error, pages), strict=True)
            )


def main(arguments: list[str]) -> int:
    """Run the named pages, or all; return 1 if a block fails."""
    results = run_pages([DOCS / name for name in arguments] or sorted(DOCS.rglob("*.md")))
    errors = [result for result in results.values() if isinstance(result, str)]
    print(*errors, f"{len(results) - len(errors)} of {len(results)} pages run", sep="\n")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
