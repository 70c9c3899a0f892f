"""Submissions: a folder with the predictions of one system for one task, and where they come from.

docs/notes/tasks.md describes it. Whoever reads one trusts none of it: files are small plain files, every row of the
task is there exactly once, and every score is computed here from the labels.
"""

from __future__ import annotations

import hashlib
import json
import re
import stat
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from bench import resampling, scores
from bench.board.tasks import CLEAN, FALSE_ALARMS, RATE_HZ, Task, digest_of, recordings_of, rows_of, task_of
from bench.corpora.read.csv_text import FrameFile
from bench.corpora.read.limits import called, check_labels, plain, quoted, short
from bench.corpora.read.parquet import ParquetFile
from bench.errors import InputError
from bench.outcomes.events import FALSE_ALARM, REPORT, matched, summary

METADATA = "submission.json"
TABLES = ("predictions.parquet", "predictions.csv")
EVENT = ("subject", *(column for column in REPORT if column != "recording"))  # columns of a watched task
EVENTS = 20_000  # that a submission may report
LARGEST = {METADATA: 64 << 10} | dict.fromkeys(TABLES, 8 << 20)  # bytes


class Text(NamedTuple):
    """A text of submission.json: the most characters it may have, and whether it must be there."""

    most: int
    required: bool = False


TEXTS = {"task": Text(60, True), "system": Text(200, True), "who": Text(60, True), "date": Text(10, True)}
TEXTS |= {"revision": Text(80), "command": Text(2000), "digest": Text(64), "note": Text(500)}
TEXTS |= {"batch": Text(3), "conditions": Text(200)}
NUMBERS = ("parameters", "flash_bytes", "ram_bytes")
VERSION, VERSIONS = Text(80), 100  # of a package, and how many there may be
PUNCTUATION = ".,:'&+-_=|/()[]"  # of a name, besides letters, digits and single spaces of ASCII
_WORD = f"[A-Za-z0-9{re.escape(PUNCTUATION)}]+"
NAME = re.compile(rf"(?=.*[A-Za-z0-9]){_WORD}(?: {_WORD})*")
DOT = " · "  # between model and features in the name of a system
RESERVED = "touchbench"  # in the name of a team: of the results that come with touchbench
REFERENCE = Path(str(files("bench.board"))) / "reference"  # folder of these results
FRAME = re.compile("[0-9]{1,9}")
EVENT_PARTS = ("touches_found", "first_correct", "false_alarms_per_hour", "latency_s_p50")
SUM = 0.02  # that probabilities, which may be rounded, may differ from 1


@dataclass(frozen=True)
class Submission:
    """A folder that was read.

    Attributes:
        name: name of the folder.
        task: task that it answers.
        metadata: the content of its ``submission.json``, by the names in `TEXTS` and `NUMBERS`.
        table: a row for each of `rows_of` the task, with ``predicted`` and optionally ``p_<class>``; of a watched task
            with the columns of `bench.outcomes.events.matched`, and ``predicted`` empty for a missed touch.
        sha256: SHA-256 of the names and the content of its two files.
        verified: date and revision of a maintainer's rerun, in words; empty without a rerun.
        events: reported events of a watched task, with ``touch`` as of `matched`.
    """

    name: str
    task: Task
    metadata: dict[str, Any]
    table: pd.DataFrame
    sha256: str
    verified: str = ""
    events: pd.DataFrame | None = None

    @property
    def reference(self) -> bool:
        """True for a reference result of touchbench; `read` refuses their names to all others."""
        return _is_reserved(self.metadata["who"])

    @property
    def remarks(self) -> str:
        """Inputs of its labels besides single captures, as the run recorded them, too many false alarms, or nothing."""
        batch = "labels depend on other test captures" if "batch" in self.metadata else ""
        conditions = self.metadata.get("conditions", "")
        alarms = f"more than {FALSE_ALARMS:g} false alarms per hour" if self.alarming else ""
        return "; ".join(filter(None, [alarms, batch, conditions and f"uses {conditions.replace(',', ', ')}"]))

    @property
    def alarming(self) -> bool:
        """True where there are more false alarms than the task allows; such a submission ranks below the others."""
        return self.scores.get("false_alarms_per_hour", 0) > FALSE_ALARMS

    @property
    def answers(self) -> pd.DataFrame:
        """The labels that a rerun must repeat, and where they belong; no two rows are equal."""
        if self.events is None:
            return self.table[[*self.task.names, "predicted"]]
        return self.events[[name for name in EVENT if name != "confidence"]]

    @property
    def counted(self) -> pd.DataFrame:
        """The rows that accuracy is of: all but those of clean captures where faults are the task."""
        return self.table[self.table["fault"] != CLEAN] if "fault" in self.task.keys else self.table

    @cached_property
    def scores(self) -> dict[str, float]:
        """Accuracy, its 95 % interval over subjects, macro-F1, mean and SD of the subjects' accuracies, and parts.

        Parts are accuracies at an instant (``at 500 ms``), or of clean captures and under the worst fault, or
        `EVENT_PARTS` of `bench.outcomes.events.summary`.
        """
        hit = self.table["true"] == self.table["predicted"]
        parts: dict[str, float] = {}
        if "ms" in self.task.keys:
            by_instant = hit.groupby(self.table["ms"], sort=False).mean()
            parts = {f"at {ms} ms": float(accuracy) for ms, accuracy in by_instant.items()}
        if "fault" in self.task.keys:
            by_fault = hit.groupby(self.table["fault"], sort=False).mean()
            parts = {"clean": float(by_fault.pop(CLEAN)), f"worst fault: {by_fault.idxmin()}": float(by_fault.min())}
        if self.events is not None:
            recordings = recordings_of(self.task).query("gesture == ''")
            frames = (recordings["end"] - recordings["start"]).sum() - (self.table["end"] - self.table["start"]).sum()
            numbers = summary(self.table, self.events, frames / RATE_HZ)
            parts = {name: numbers[name] for name in EVENT_PARTS}
        table = self.counted
        low, high = scores.subject_interval(table)
        subjects = scores.per_subject(table)["accuracy"]
        return {
            "accuracy": float((table["true"] == table["predicted"]).mean()),
            "low": low,
            "high": high,
            "macro_f1": float(scores.per_class(table, sorted(set(table["true"])))["f1"].mean()),
            "subject_mean": float(subjects.mean()),
            "subject_sd": float(subjects.std(ddof=1)),
            **parts,
        }


def read(folder: Path) -> Submission:
    """Read and check the folder of a submission.

    Raises:
        InputError: it is no submission, or not one of a task; the message begins with the name of the folder.
    """
    name = called(folder)
    try:
        metadata = _metadata(_plain_file(folder / METADATA))
        if _is_reserved(metadata["who"]) and not folder.resolve().is_relative_to(REFERENCE.resolve()):
            raise InputError(
                f"{METADATA}: who is {quoted(metadata['who'])}; only the results of touchbench may use this name"
            )
        task = task_of(metadata["task"])
        if metadata.get("digest", "") not in ("", digest := digest_of(task)):
            raise InputError(f"digest {metadata['digest'][:16]} is not that of {task.name}, {digest[:16]}")
        tables = [path for path in (folder / table for table in TABLES) if path.exists() or path.is_symlink()]
        if len(tables) != 1:
            raise InputError(f"holds {len(tables)} of {' and '.join(TABLES)}; give one")
        table, events = _watched(tables[0], task) if task.watched else (_table(tables[0], task), None)
        sha256 = _sha256(folder / METADATA, tables[0])
    except InputError as e:
        raise InputError(f"{name}: {e}") from e
    except OSError as e:
        raise InputError(f"{name}: cannot be read ({e.strerror})") from e
    return Submission(name, task, metadata, table, sha256, events=events)


@lru_cache
def reference_of(task: str) -> tuple[Submission, ...]:
    """The results for a task that come with touchbench; read and scored once in a process."""
    return tuple(read(path.parent) for path in sorted(REFERENCE.glob(f"{task}/*/{METADATA}")))


def behind(one: Submission, best: Submission) -> tuple[float, float, float]:
    """Accuracy less that of another submission to the same task, with its 95 % paired bootstrap interval over subjects.

    Both are counted on the same rows and the same drawn subjects, so what makes a subject hard for both cancels out.
    """
    rows = [each.counted for each in (one, best)]  # in the order of the task's rows
    ours, theirs = ((table["true"] == table["predicted"]).to_numpy(int) for table in rows)
    each = pd.Series(ours - theirs).groupby(rows[0]["subject"].to_numpy()).agg(["sum", "size"]).to_numpy()
    low, high = resampling.ratio_interval(each)
    return float((ours - theirs).mean()), float(low), float(high)


def write(folder: Path, metadata: dict[str, Any], table: pd.DataFrame) -> Submission:
    """Write a submission into a new folder and read it back.

    Probabilities are rounded to three decimals, except in rows whose label that would change.

    Raises:
        InputError: it would be refused.
    """
    folder.mkdir()
    (folder / METADATA).write_text(json.dumps(metadata, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    table = table.drop(columns={"subject", "true"} - {*task_of(metadata["task"]).names}, errors="ignore")
    if columns := [scores.PREFIX + c for c in scores.classes_of(table)]:
        exact = table[columns].to_numpy(np.float32)
        rounded = exact.round(3)
        same = rounded.argmax(axis=1) == exact.argmax(axis=1)
        table[columns] = np.where(same[:, None], rounded, exact)
        table = table.drop(columns="predicted")
    # No table of a run: the task names its columns and their types, and strangers read and write it, too (`_cells`).
    table.to_parquet(folder / TABLES[0], index=False, compression="zstd")
    return read(folder)


def _sha256(*paths: Path) -> str:
    """Hash of the names and the content of files."""
    hashes = [f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n" for path in paths]
    return hashlib.sha256("".join(hashes).encode()).hexdigest()


def _is_reserved(who: str) -> bool:
    return RESERVED in re.sub("[^a-z0-9]", "", who.lower())


def _plain_file(path: Path) -> bytes:
    """The content of a file that is no link, pipe or device, and not too large."""
    try:
        status = path.lstat()
    except OSError as e:
        raise InputError(f"{path.name} is not there; docs/notes/tasks.md says what a submission is") from e
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path.name} is not a plain file")
    if status.st_size > LARGEST[path.name]:
        raise InputError(f"{path.name} has {status.st_size} bytes, at most {LARGEST[path.name]} are read")
    return path.read_bytes()


def _metadata(content: bytes) -> dict[str, Any]:
    """The content of ``submission.json``.

    Raises:
        InputError: it is not JSON, or a key or a value is not as `TEXTS` and `NUMBERS` say.
    """
    try:
        metadata = json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as e:
        raise InputError(f"{METADATA} is not JSON ({plain(e)})") from e
    if not isinstance(metadata, dict):
        raise InputError(f"{METADATA} is not a JSON object")
    if wrong := _flaw(metadata):
        raise InputError(f"{METADATA}: {wrong}")
    return metadata


def _flaw(metadata: dict[str, Any]) -> str:
    """Why the content of ``submission.json`` is refused, or nothing."""
    if unknown := sorted(metadata.keys() - {*TEXTS, *NUMBERS, "versions"}):
        return f"no key is called {quoted(unknown[0])}; known: {', '.join([*TEXTS, *NUMBERS, 'versions'])}"
    versions = metadata.get("versions", {})
    if not isinstance(versions, dict) or len(versions) > VERSIONS:
        return f"versions is no object of at most {VERSIONS} texts"
    if missing := [key for key, text in TEXTS.items() if text.required and not metadata.get(key)]:
        return f"{missing[0]} is missing; add it"
    for key, value in [*((key, metadata[key]) for key in TEXTS if key in metadata), *versions.items()]:
        most = TEXTS.get(key, VERSION).most
        if not isinstance(value, str) or len(value) > most or not value.isprintable() or not key.isprintable():
            return f"{quoted(key)} is not one line of at most {most} visible characters"
    for key, name in (("system", metadata["system"].replace(DOT, " ")), ("who", metadata["who"])):
        if not NAME.fullmatch(name):  # it may look like another name, or like none
            allowed = f"ASCII letters (ue for \u00fc), digits, single spaces or {PUNCTUATION}"
            return f"{key} is {short(ascii(name), 60)}; write {allowed}"
    if metadata.get("batch", "yes") != "yes":
        return f"batch is {quoted(metadata['batch'])}; write 'yes' or leave it out"
    for key in NUMBERS:
        value = metadata.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e15:
            return f"{key} is not a number from 0 on"
    day, latest = metadata["date"], datetime.now(UTC).date() + timedelta(days=1)  # it is tomorrow in the east
    try:
        if date.fromisoformat(day).isoformat() != day:  # dates are sorted as text
            raise ValueError(day)
    except ValueError:
        return f"date is {quoted(day)}, not a day such as 2026-01-31"
    return f"date is {day}, which is in the future; give the day of submission" if day > f"{latest}" else ""


def _table(path: Path, task: Task) -> pd.DataFrame:
    """The rows of a task with the labels of a file.

    Raises:
        InputError: the file is no table, or a column, row or value does not fit the task.
    """
    expected, keys = rows_of(task), [*task.names]
    classes = sorted(set(expected["true"]))
    probabilities = [scores.PREFIX + c for c in classes]
    allowed = [*keys, "predicted", *probabilities, "true"]
    columns = _columns(path, allowed, keys)
    answers = [c for c in allowed if c in columns and c not in (*keys, "true")]
    if answers not in (["predicted"], probabilities):
        raise InputError(f"give a column predicted, or one for every class: {', '.join(probabilities)}")

    cells = _cells(path, columns, len(expected))
    if len(cells) != len(expected):
        raise InputError(f"there are not {len(expected)} rows, as {task.name} has")
    texts = cells[[c for c in columns if c not in probabilities]].astype(object).map(str)
    if (twice := texts.duplicated(keys)).any():
        raise InputError(f"{_row(texts[twice], keys)} is there twice")
    joined = expected.merge(texts.reset_index(names="position"), on=keys, how="left", suffixes=("", " given"))
    if (missing_rows := joined["position"].isna()).any():
        raise InputError(f"{_row(joined[missing_rows], keys)} is missing")
    if "true" in texts and (wrong := joined["true given"] != joined["true"]).any():
        label = joined.loc[wrong, "true"].iloc[0]
        raise InputError(f"true of {_row(joined[wrong], keys)} is another class than in the task: {label}")
    if answers == ["predicted"]:
        labels = texts["predicted"]
        check_labels(labels, labels.isin(classes), f"one of {', '.join(classes)}", f"{path.name}, row", first=1)
        return expected.assign(predicted=joined["predicted"])
    proba = _numbers(cells[probabilities])[joined["position"].to_numpy()]
    labelled = expected.assign(predicted=np.asarray(classes, dtype=object)[proba.argmax(axis=1)])
    return pd.concat([labelled, pd.DataFrame(proba.astype(np.float32), columns=probabilities)], axis=1)


def _watched(path: Path, task: Task) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The touches of a watched task with the labels of a file, and its events.

    Raises:
        InputError: the file is no table, a column or a value does not fit the task, an event occurs twice or outside
            of its recording, or a recording has none.
    """
    truth, recordings = rows_of(task), recordings_of(task).query("gesture == ''")
    classes, lengths = sorted(set(truth["true"])), recordings.set_index("subject")["end"]
    cells = _cells(path, _columns(path, [*EVENT], EVENT), EVENTS)
    if len(cells) > EVENTS:
        raise InputError(f"{path.name}: more than {EVENTS} rows")
    texts = cells[[*EVENT]].astype(object).map(str)
    last = texts["subject"].map(lengths)  # NaN for a strange subject, which is refused first
    frames = texts[["reported", "end"]].where(lambda table: table.map(FRAME.fullmatch).notna()).astype(float)
    confidence = pd.to_numeric(texts["confidence"], errors="coerce")
    inside = "a whole number of frames from 1 to the length of its recording"
    for name, good, wanted in (
        ("subject", last.notna(), f"one of {', '.join(lengths.index)}"),
        *((name, frames[name].between(1, last), inside) for name in frames),
        *((name, texts[name].isin(classes), f"one of {', '.join(classes)}") for name in ("first", "label")),
        ("confidence", confidence.between(0, 1), "a number from 0 to 1"),
    ):
        check_labels(texts[name], good, wanted, f"{path.name}, row", first=1)
    events = texts.assign(**frames, confidence=confidence, recording=0).astype(REPORT)
    events["recording"] = events["subject"].map(dict(zip(truth["subject"], truth["recording"], strict=True)))
    events = events.sort_values(["recording", "reported"], ignore_index=True)
    if (twice := events.duplicated([*task.names])).any():
        raise InputError(f"{_row(events[twice], [*task.names])} is there twice")
    if missing := [subject for subject in lengths.index if subject not in set(events["subject"])]:
        raise InputError(f"no event of subject {missing[0]}; give the events of all {len(lengths)} recordings")
    touches, events = matched(truth.rename(columns={"true": "gesture"}), events, RATE_HZ)
    labels = events[events["touch"] != FALSE_ALARM].drop_duplicates("touch", keep="last").set_index("touch")["label"]
    touches = touches.rename(columns={"gesture": "true"})
    return touches.assign(predicted=labels.reindex(touches.index, fill_value="")), events


def _columns(path: Path, allowed: Sequence[str], needed: Sequence[str]) -> list[str]:
    """Columns of a plain file, checked before anything is unpacked.

    Raises:
        InputError: the file is no table, a column is not allowed, or one that is needed is missing.
    """
    content = _plain_file(path)
    columns = FrameFile(content, path.name).columns if path.suffix == ".csv" else ParquetFile(path).columns
    if unknown := sorted({*columns} - {*allowed}):
        raise InputError(f"column {quoted(unknown[0])} is not one of {', '.join(allowed)}")
    if missing := [name for name in needed if name not in columns]:
        raise InputError(f"column {missing[0]} is missing")
    return columns


def _cells(path: Path, columns: list[str], most: int) -> pd.DataFrame:
    """The rows of either format, as they are; text as text or categories.

    Args:
        path: the file.
        columns: their names.
        most: number of rows that it may have; of a longer CSV file one more is read.

    Raises:
        InputError: the file cannot be read, or a parquet file has more rows.
    """
    try:
        if path.suffix == ".csv":
            with warnings.catch_warnings():
                warnings.simplefilter("error", pd.errors.ParserWarning)  # a row with more cells than the header
                return pd.read_csv(
                    path, header=0, names=columns, nrows=most + 1, dtype=str, keep_default_na=False, index_col=False
                )
        file = pq.read_metadata(path)
        if file.num_rows > most:
            raise InputError(f"{path.name}: {file.num_rows} rows, more than {most}")
        # Of text each word once, so that a long one that is repeated is not multiplied.
        text = [f.name for f in file.schema.to_arrow_schema() if str(f.type) in ("string", "large_string")]
        table = pq.ParquetFile(path, read_dictionary=text).read(columns)
        return table.to_pandas(ignore_metadata=True).set_axis(columns, axis=1)
    except InputError:
        raise
    except Exception as e:  # pandas and pyarrow raise a dozen types for damaged files
        raise InputError(f"{path.name} cannot be read as a table ({plain(e)})") from e


def _numbers(cells: pd.DataFrame) -> np.ndarray:
    """Probabilities [rows, classes].

    Raises:
        InputError: a probability is not from 0 to 1, or the probabilities of a row do not add up to 1.
    """
    try:
        proba = cells.astype(float).to_numpy()
    except (ValueError, TypeError) as e:
        raise InputError(f"a probability is no number ({plain(e)})") from e
    if not np.isfinite(proba).all() or (proba < 0).any():
        raise InputError("a probability is not a number from 0 to 1")
    total = proba.sum(axis=1)
    if (off := np.abs(total - 1)).max() > SUM:
        raise InputError(f"the probabilities of a row add up to {total[off.argmax()]:.3g}, not to 1")
    return proba


def _row(table: pd.DataFrame, keys: list[str]) -> str:
    """The first row in words."""
    return ", ".join(f"{name} {plain(table[name].iloc[0], 30)}" for name in keys)
