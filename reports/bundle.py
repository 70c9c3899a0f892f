"""A bundle: a zip file of stored runs with their tables and the report on them, which is made from it again.

It holds the bytes of one time for equal runs, and no path of the machine. Nothing of a bundle is unpacked to files.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bench.corpora.read.archive import opened
from bench.corpora.read.limits import called, check_file
from bench.errors import InputError
from bench.ground.progress import warn
from bench.ground.registry import run_views
from bench.ground.scratch import replacing
from bench.reports.comparison import command
from bench.store.tables import file_of, read_table, write_table
from bench.values.result import COMPARABLE, SAME_SYSTEM, Result, Tables, several

FORMAT = 1
HEAD, RUNS, TABLES, REPORT = (
    "touchbench.json",
    "runs.json",
    "tables",
    "report",
)  # names in the zip file
TIME = (1980, 1, 1, 0, 0, 0)  # of every file; the earliest that a zip file can hold
OF_STORE = ("artifacts", "mlflow.")  # beginnings of names of what says only where a run was stored
NEEDED = (
    *COMPARABLE,
    *SAME_SYSTEM,
    "synthetic",
    "touchbench.kind",
    "run_id",
    "status",
    "started",
)  # of each run
FOLDER = re.compile(
    r"(?:/|[A-Za-z]:[/\\]).*[/\\](?=[^/\\]+\.py(:\w+)?$)"
)  # of a part in a file of the user's
BROKEN = "damaged, or no zip file ({}); get it again"
README = """A report of touchbench {version} with everything behind it.

report/          the page, CSV and LaTeX tables, figures
commands.sh      the commands that make the runs
runs.json        of each run parameters, numbers, versions and the digest of the corpus
tables/          of each run its tables (parquet): predictions, accuracy of each subject and gesture, ...
touchbench.json  the version of this format, and the options of the report

To make the page again without the corpus: bench report from=FILE.zip
To repeat the runs, import the corpora first; bench data shows their digests:
{corpora}
"""


class Bundle:
    """A store of the runs in a bundle, with the methods of `bench.store.client.Store` for reading.

    Attributes:
        options: options of ``bench report`` with which its page was made.

    Raises:
        InputError: the file is damaged, no bundle, or of a newer format.
    """

    def __init__(self, path: Path) -> None:
        check_file(path)
        self.path = path
        with opened(path, BROKEN) as (archive, members):
            names = [member.filename for member in members]
            if HEAD not in names:
                raise InputError(
                    f"{called(path)}: no bundle of bench report; make one with bench report bundle=FILE.zip"
                )
            head = json.loads(archive.read(HEAD))
            if head["format"] > FORMAT:
                raise InputError(
                    f"{called(path)}: made by touchbench {head['touchbench']} in format {head['format']}, this version "
                    f"reads format {FORMAT}; install that one"
                )
            self.tables: dict[str, list[str]] = {}  # of each run
            for run_id, table in re.findall(
                rf"^{TABLES}/(.+)/(.+)\.parquet$", "\n".join(names), re.MULTILINE
            ):
                self.tables.setdefault(run_id, []).append(table)
            if damaged := archive.testzip():
                raise ValueError(damaged)
            self.options = {str(key): str(value) for key, value in head["options"].items()}
            self.runs: list[dict[str, dict[str, Any]]] = json.loads(archive.read(RUNS))
            for run in self.runs:
                if missing := [
                    name for name in NEEDED if name not in {*run["about"], *run["metrics"]}
                ]:
                    raise ValueError(f"a run lacks {missing[0]}")
        if strange := sum(run["about"]["touchbench.kind"] not in run_views() for run in self.runs):
            warn(
                f"{several(strange, 'run')} of {called(path)} left out: install the add-ons that made them"
            )

    def of_kind(self, *kinds: str, data: str = "") -> list[dict[str, dict[str, Any]]]:
        """The runs of some kinds: all, or those on one corpus."""
        kept = [run for run in self.runs if run["about"]["touchbench.kind"] in kinds]
        return [run for run in kept if data in ("", run["about"]["data"])]

    def result(self, run: Mapping[str, dict[str, Any]]) -> Result:
        """A run as a result; its tables are read when they are asked for."""
        run_id = run["about"]["run_id"]
        held, this = self.tables.get(run_id, []), f"{called(self.path)}, run {run_id}"

        def read(name: str, columns: Sequence[str] = ()) -> Any:
            if name not in held:
                return None
            with opened(self.path, BROKEN) as (archive, _):
                return read_table(
                    io.BytesIO(archive.read(f"{TABLES}/{run_id}/{file_of(name)}")),
                    name,
                    this,
                    columns,
                )

        return Result(
            run["about"],
            run["metrics"],
            Tables({}, read, f"{this} is missing; get it again", lambda: held),
        )

    def add(self, folder: Path, files: Iterable[Path]) -> None:
        """Add the files of a report in a folder."""
        with zipfile.ZipFile(self.path, "a") as archive:
            for file in sorted(files):
                _add(archive, f"{REPORT}/{file.relative_to(folder).as_posix()}", file.read_bytes())


@contextmanager
def writing(
    path: Path, results: Collection[Result], options: Mapping[str, str]
) -> Iterator[Bundle]:
    """Write results and the options of their report as a bundle, and yield it, to make and add the report.

    Raises:
        InputError: the file cannot be written; what was there stays.
    """
    try:
        with replacing(path) as beside:
            with zipfile.ZipFile(beside, "w") as archive:
                for name, content in _files(results, options):
                    _add(archive, name, content)
            yield Bundle(beside)
    except OSError as e:
        raise InputError(
            f"bundle={path} cannot be written ({e.strerror or e}); choose another place"
        ) from e


def _files(results: Collection[Result], options: Mapping[str, str]) -> Iterator[tuple[str, bytes]]:
    """The files of a bundle without its report, by name."""
    runs = [{"about": _portable(r.about), "metrics": r.metrics} for r in results]
    head = {"format": FORMAT, "touchbench": version("touchbench"), "options": dict(options)}
    corpora = sorted({f"{r['data']} {r['corpus_digest']}" for r in results})
    commands = dict.fromkeys(command(Result(run["about"], {}, {})) for run in runs)
    texts = {
        HEAD: json.dumps(head, indent=1, sort_keys=True),
        "README.txt": README.format(version=head["touchbench"], corpora="\n".join(corpora)),
        "commands.sh": "".join(f"{line}\n" for line in commands if line != "-"),
        RUNS: json.dumps(runs, indent=1, sort_keys=True),
    }
    yield from ((name, text.encode()) for name, text in texts.items())
    for r in results:
        for name in sorted(r.tables):
            buffer = io.BytesIO()
            write_table(r.tables[name], buffer)
            yield f"{TABLES}/{r['run_id']}/{file_of(name)}", buffer.getvalue()


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    entry = zipfile.ZipInfo(name, TIME)
    entry.create_system, entry.external_attr = 3, 0o644 << 16  # as on Unix, wherever it is written
    archive.writestr(entry, content, zipfile.ZIP_DEFLATED)


def _portable(about: Mapping[str, Any]) -> dict[str, Any]:
    """What a run is without the store and the folders of this machine."""
    kept = {key: value for key, value in about.items() if not key.startswith(OF_STORE)}
    texts = [value for value in kept.values() if isinstance(value, str)]
    folders = sorted(
        {found[0] for text in texts if (found := FOLDER.match(text))}, key=len, reverse=True
    )
    for folder in folders:
        kept = {
            key: value.replace(folder, "") if isinstance(value, str) else value
            for key, value in kept.items()
        }
    return kept
