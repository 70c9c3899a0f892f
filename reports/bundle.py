"""A bundle: a zip file of stored runs, their tables and the report, which it can make again.

Equal runs give equal bytes. It holds no path of the machine, and reading it unpacks no file.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from bench.corpora.read.archive import open_zip
from bench.corpora.read.limits import check_file, file_name
from bench.errors import InputError, one_line
from bench.ground.progress import warn
from bench.ground.registry import PART_GROUPS, load_part, views_of_runs
from bench.ground.scratch import write_then_rename
from bench.ground.source import own_files
from bench.reports.comparison import command_line, load_published
from bench.store.tables import read_table, table_file, write_table
from bench.values.result import GRIDS_TAG, Result, RunTables, format_count

FORMAT = 1
RESERVED = ("README.txt", "commands.sh")  # names that no file of the user's may have, too
# Names in the zip file.
HEAD, RUNS, TABLES, REPORT = "touchbench.json", "runs.json", "tables", "report"
NUMBERS = "published.parquet"
TIME = (1980, 1, 1, 0, 0, 0)  # of every file; the earliest that a zip file can hold
OF_STORE = ("artifacts", "mlflow.")  # beginnings of tags that say only where a run was stored
# The folder of a part in a file of the user's.
FOLDER = re.compile(r"(?:/|[A-Za-z]:[/\\]).*[/\\](?=[^/\\]+\.py(:\w+)?$)")
BROKEN = "damaged, or no zip file ({}); get it again"
StoredRun = dict[str, dict[str, Any]]  # attributes ("about") and metrics
README = """A report of touchbench {version} with everything behind it.

report/          the page, CSV and LaTeX tables, figures
commands.sh      the commands that make the runs, in this folder
runs.json        parameters, numbers, versions and digest of the corpus of each run
tables/          tables of each run (parquet), such as predictions and accuracy of each subject
published.parquet  published numbers of the papers, and of published=
{own}
touchbench.json  the version of this format, and the options of the report

To make the page again without the corpus: bench report from=FILE.zip
To repeat the runs, import the corpora first; bench data shows their digests:
{corpora}

It does not contain:
{missing}
"""
UNCONTAINED = "captures, trained models, installed packages (their versions are in runs.json)"


@dataclass(frozen=True)
class OwnFiles:
    """The user's files that runs need, by their places in a bundle, and sentences on others."""

    contents: Mapping[str, bytes]
    missing: Sequence[str]


def find_own_files(results: Iterable[Result], folder: Path) -> OwnFiles:
    """The code of the user's own parts of some runs, and the files in a folder that name the runs.

    A part's file comes with what it imports from its folder and what that names in ``depends``. A
    file that changed since a run is left out, as it would make other runs.
    """
    contents: dict[str, bytes] = {}
    missing = []
    parts = {
        (group, str(r[f"{key}_name"]), str(r.get(f"{key}_file", "")))
        for r in results
        for key, group in PART_GROUPS.items()
        if str(r.get(f"{key}_name", "")).rpartition(":")[0].endswith(".py")
    }
    for group, name, digest in sorted(parts):
        path = Path(name.rpartition(":")[0])
        try:
            files = own_files(load_part(group, name).__module__)
            found = {place: file.read_bytes() for place, file in files.items()}
        except (InputError, OSError) as e:
            missing.append(f"{path.name}: {one_line(e)}".replace(f"{path.parent}/", ""))
            continue
        if digest not in ("", hashlib.sha256(found[path.name]).hexdigest()):
            missing.append(f"{path.name} as it was when some runs were made; it has changed since")
            continue
        for place, content in found.items():
            is_taken = place in (*RESERVED, HEAD, RUNS, NUMBERS) or place.startswith("..")
            if is_taken or contents.get(place, content) != content:
                missing.append(f"{place} of {path.name}: another file has this place")
            else:
                contents[place] = content
    grids = {each for r in results for each in r.get(GRIDS_TAG, "").split(", ")} - {""}
    for file in sorted(folder.glob("*.toml")):
        digest = hashlib.sha256(content := file.read_bytes()).hexdigest()[:16]
        if digest in grids:
            contents[file.name] = content
            grids.discard(digest)
    missing += [
        f"the TOML file with SHA-256 {each}..., not in this folder" for each in sorted(grids)
    ]
    return OwnFiles(contents, [*dict.fromkeys(missing)])


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
        with open_zip(path, BROKEN) as (archive, members):
            self.names = [member.filename for member in members]
            if HEAD not in self.names:
                raise InputError(
                    f"{file_name(path)}: no bundle of bench report; make one with "
                    "bench report bundle=FILE.zip"
                )
            head = json.loads(archive.read(HEAD))
            if head["format"] > FORMAT:
                raise InputError(
                    f"{file_name(path)}: made by touchbench {head['touchbench']} in format "
                    f"{head['format']}, this version reads format {FORMAT}; install that one"
                )
            if damaged := archive.testzip():
                raise ValueError(damaged)
            self.options = {str(key): str(value) for key, value in head["options"].items()}
            self.runs: list[StoredRun] = json.loads(archive.read(RUNS))
            names = head.get("own", ())
            own = {name: archive.read(name) for name in names if name in self.names}
            self.own_files = OwnFiles(own, head.get("missing", ()))
            numbers = archive.read(NUMBERS) if NUMBERS in self.names else b""
            self.numbers = read_table(io.BytesIO(numbers), NUMBERS) if numbers else load_published()
            kinds = [str(run["about"]["touchbench.kind"]) for run in self.runs]
        if unknown := sum(kind not in views_of_runs() for kind in kinds):
            warn(
                f"{format_count(unknown, 'run')} of {file_name(path)} left out: "
                "install the add-ons that made them"
            )

    def runs_of_kind(self, *kinds: str, data: str = "") -> list[StoredRun]:
        """The runs of some kinds: all, or those on one corpus."""
        runs = [run for run in self.runs if run["about"]["touchbench.kind"] in kinds]
        return [run for run in runs if data in ("", run["about"]["data"])]

    def load_result(self, run: StoredRun) -> Result:
        """A run as a result; its tables are read when they are asked for."""
        run_id = run["about"]["run_id"]
        label = f"{file_name(self.path)}, run {run_id}"
        folder = f"{TABLES}/{run_id}/"
        files = [name.removeprefix(folder) for name in self.names if name.startswith(folder)]
        tables = [name.removesuffix(".parquet") for name in files]

        def read(name: str, columns: Sequence[str] = ()) -> Any:
            if name not in tables:
                return None
            with open_zip(self.path, BROKEN) as (archive, _):
                content = io.BytesIO(archive.read(folder + table_file(name)))
            return read_table(content, name, label, columns)

        missing = f"{label} is missing; get it again"
        return Result(run["about"], run["metrics"], RunTables({}, read, missing, lambda: tables))

    def add_report(self, folder: Path, files: Iterable[Path]) -> None:
        """Add the files of a report in a folder."""
        with zipfile.ZipFile(self.path, "a") as archive:
            for file in sorted(files):
                name = f"{REPORT}/{file.relative_to(folder).as_posix()}"
                _add_file(archive, name, file.read_bytes())


@contextmanager
def write_bundle(
    path: Path,
    results: Collection[Result],
    options: Mapping[str, str],
    numbers: pd.DataFrame,
    own: OwnFiles,
) -> Iterator[Bundle]:
    """Write results, and options and numbers of their report; yield the bundle to add the report.

    Raises:
        InputError: the file cannot be written; what was there stays.
    """
    try:
        with write_then_rename(path) as scratch:
            with zipfile.ZipFile(scratch, "w") as archive:
                for name, content in _bundle_files(results, options, numbers, own):
                    _add_file(archive, name, content)
            yield Bundle(scratch)
    except OSError as e:
        message = f"bundle={path} cannot be written ({e.strerror or e}); choose another place"
        raise InputError(message) from e


def _bundle_files(
    results: Collection[Result], options: Mapping[str, str], numbers: pd.DataFrame, own: OwnFiles
) -> Iterator[tuple[str, bytes]]:
    """The files of a bundle without its report, by name."""
    runs = [{"about": _without_folders(r.attributes), "metrics": r.metrics} for r in results]
    head = {"format": FORMAT, "touchbench": version("touchbench"), "options": dict(options)}
    head |= {"own": [*own.contents], "missing": [*own.missing]}
    corpora = sorted({f"{r['data']} {r['corpus_digest']}" for r in results})
    commands = dict.fromkeys(command_line(Result(run["about"], {}, {})) for run in runs)
    texts = {
        HEAD: json.dumps(head, indent=1, sort_keys=True),
        "README.txt": README.format(
            version=head["touchbench"],
            corpora="\n".join(corpora),
            own="\n".join(f"{name:16} your file" for name in own.contents),
            missing="\n".join([UNCONTAINED, *own.missing]),
        ),
        "commands.sh": "".join(f"{line}\n" for line in commands if line != "-"),
        RUNS: json.dumps(runs, indent=1, sort_keys=True),
    }
    yield from ((name, text.encode()) for name, text in texts.items())
    yield from own.contents.items()
    yield NUMBERS, _as_parquet(numbers)
    for r in results:
        for name in sorted(r.tables):
            yield f"{TABLES}/{r['run_id']}/{table_file(name)}", _as_parquet(r.tables[name])


def _as_parquet(table: pd.DataFrame) -> bytes:
    write_table(table, buffer := io.BytesIO())
    return buffer.getvalue()


def _add_file(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    entry = zipfile.ZipInfo(name, TIME)
    entry.create_system, entry.external_attr = 3, 0o644 << 16  # as on Unix, wherever it is written
    archive.writestr(entry, content, zipfile.ZIP_DEFLATED)


def _without_folders(about: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of a run without the places of its store and the folders of this machine."""
    kept = {key: value for key, value in about.items() if not key.startswith(OF_STORE)}
    texts = {key: value for key, value in kept.items() if isinstance(value, str)}
    folders = {match[0] for text in texts.values() if (match := FOLDER.match(text))}
    for folder in sorted(folders, key=len, reverse=True):
        texts = {key: text.replace(folder, "") for key, text in texts.items()}
    return kept | texts
