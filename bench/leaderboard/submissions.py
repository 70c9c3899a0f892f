"""Submissions: a folder with the predictions of one system for one task, and where they come from.

docs/leaderboard.md describes it. Whoever reads one trusts none of it: files are small plain files, every row of the
task is there exactly once, and every score is computed here from the labels.
"""

from __future__ import annotations

import hashlib
import json
import re
import stat
import warnings
from dataclasses import dataclass
from datetime import date
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from string import ascii_letters, digits
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from bench.corpora.read.limits import called, plain, quoted, short
from bench.corpora.read.parquet import ParquetFile
from bench.errors import InputError, nearest
from bench.leaderboard.tasks import CLEAN, TASKS, Task, digest_of, rows_of
from bench.outcomes import scores

ABOUT = "submission.json"
TABLES = ("predictions.parquet", "predictions.csv")
LARGEST_ABOUT, LARGEST_TABLE, LARGEST_HEADER = 64 << 10, 8 << 20, 64 << 10  # bytes
TEXTS = {"task": 60, "system": 200, "who": 60, "date": 10, "revision": 80, "command": 2000, "digest": 64, "note": 500}
TEXTS |= {"batch": 3, "conditions": 200}
NEEDED = ("task", "system", "who", "date")
PUNCTUATION = ".,:'&+-_=|/()[]"  # of a name, besides letters, digits and single spaces of ASCII
DOT = " · "  # between model and features in the name of a system
RESERVED = "touchbench"  # in the name of a team: of the results that come with touchbench
REFERENCE = Path(str(files("reports"))) / "reference"  # folder of these results
NUMBERS = ("parameters", "flash_bytes", "ram_bytes")
_LETTERS = frozenset(ascii_letters + digits)
SUM = 0.02  # that probabilities, which may be rounded, may differ from 1


@dataclass(frozen=True)
class Submission:
    """What a folder holds.

    Attributes:
        name: of the folder.
        task: that it answers.
        about: what it says of itself, by the names in `TEXTS` and `NUMBERS`.
        table: a row for each of `rows_of` the task, with ``predicted`` and, where they were given, ``p_<class>``.
        sha256: of the names and the content of its two files.
        verified: date and revision of a maintainer's rerun, in words; empty without a rerun.
    """

    name: str
    task: Task
    about: dict[str, Any]
    table: pd.DataFrame
    sha256: str
    verified: str = ""

    @property
    def reference(self) -> bool:
        """Whether it is one of the results that come with touchbench; `read` refuses their name to all others."""
        return _is_reserved(self.about["who"])

    @property
    def remarks(self) -> str:
        """What its labels rest on besides single captures, as the run recorded it; empty for nothing."""
        batch = "labels depend on other test captures" if "batch" in self.about else ""
        conditions = self.about.get("conditions", "").split(",")
        return "; ".join(filter(None, [batch, f"uses {', '.join(conditions)}" if any(conditions) else ""]))

    @property
    def counted(self) -> pd.DataFrame:
        """The rows that accuracy is of: all but those of clean captures where faults are the task."""
        return self.table[self.table["fault"] != CLEAN] if "fault" in self.task.keys else self.table

    @cached_property
    def scores(self) -> dict[str, float]:
        """As `score` gives them."""
        return _scored(self)


def read(folder: Path) -> Submission:
    """Read and check a folder that anybody may have made.

    Raises:
        InputError: it is no submission, or not one of a task; the message begins with the name of the folder.
    """
    name = called(folder)
    try:
        about = _about(_plain_file(folder / ABOUT, LARGEST_ABOUT))
        if _is_reserved(about["who"]) and not folder.resolve().is_relative_to(REFERENCE.resolve()):
            raise InputError(
                f"{ABOUT}: who is {quoted(about['who'])}; only the results in reports/reference may use this name"
            )
        task = TASKS[about["task"]]
        there = [folder / table for table in TABLES if (folder / table).exists() or (folder / table).is_symlink()]
        if len(there) != 1:
            raise InputError(f"holds {len(there)} of {' and '.join(TABLES)}; give one")
        given = about.get("digest", "")
        if given and given != digest_of(task):
            raise InputError(f"digest {given[:16]} is not that of {task.name}, {digest_of(task)[:16]}")
        expected = rows_of(task)
        table = _checked(_read_table(there[0], len(expected)), task, expected)
        sha256 = _sha256(folder / ABOUT, there[0])
    except InputError as e:
        raise InputError(f"{name}: {e}") from e
    except OSError as e:
        raise InputError(f"{name}: cannot be read ({e.strerror})") from e
    return Submission(name, task, about, table, sha256)


def score(submission: Submission) -> dict[str, float]:
    """Accuracy, its 95 % interval over subjects, macro-F1, mean and SD of the subjects' accuracies, and parts.

    Parts are accuracies at an instant (``at 500 ms``) or of clean captures and under the worst fault. They are
    computed once for each submission that was read.
    """
    return dict(submission.scores)


def _scored(submission: Submission) -> dict[str, float]:
    table, keys = submission.table, submission.task.keys
    hit = table["true"] == table["predicted"]
    parts: dict[str, float] = {}
    if keys == ("ms",):
        parts = {f"at {ms} ms": float(found) for ms, found in hit.groupby(table["ms"], sort=False).mean().items()}
    if "fault" in keys:
        by_fault = hit.groupby(table["fault"], sort=False).mean()
        parts = {"clean": float(by_fault.pop(CLEAN)), f"worst fault: {by_fault.idxmin()}": float(by_fault.min())}
    table = submission.counted
    classes = sorted(set(table["true"]))
    low, high = scores.subject_interval(table)
    subjects = scores.per_subject(table)["accuracy"]
    return {
        "accuracy": float((table["true"] == table["predicted"]).mean()),
        "low": low,
        "high": high,
        "macro_f1": float(scores.per_class(table, classes)["f1"].mean()),
        "subject_mean": float(subjects.mean()),
        "subject_sd": float(subjects.std(ddof=1)),
        **parts,
    }


def behind(one: Submission, best: Submission, draws: int = 2000, seed: int = 0) -> tuple[float, float, float]:
    """Accuracy less that of another submission to the same task, with its 95 % paired bootstrap interval over subjects.

    Both are counted on the same rows and the same drawn subjects, so what makes a subject hard for both cancels out.
    """
    rows = [each.counted for each in (one, best)]  # in the order of the task's rows
    ours, theirs = ((table["true"] == table["predicted"]).to_numpy(int) for table in rows)
    each = pd.Series(ours - theirs).groupby(rows[0]["subject"].to_numpy()).agg(["sum", "size"]).to_numpy()
    drawn = each[np.random.default_rng(seed).integers(0, len(each), (draws, len(each)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], [0.025, 0.975])
    return float((ours - theirs).mean()), float(low), float(high)


def write(folder: Path, about: dict[str, Any], table: pd.DataFrame) -> None:
    """Write the two files into a folder that is there.

    Probabilities are rounded to three decimals, except in rows whose label that would change.
    """
    (folder / ABOUT).write_text(json.dumps(about, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    kept = table.drop(columns=["subject", "true"])
    if columns := [scores.PREFIX + c for c in scores.classes_of(table)]:
        exact = kept[columns].to_numpy(np.float32)
        rounded = exact.round(3)
        same = rounded.argmax(axis=1) == exact.argmax(axis=1)
        kept[columns] = np.where(same[:, None], rounded, exact)
        kept = kept.drop(columns="predicted")
    kept.to_parquet(folder / TABLES[0], index=False, compression="zstd")


def written(folder: Path, about: dict[str, Any], table: pd.DataFrame) -> Submission:
    """Write a submission into a new folder and read it as anybody would.

    Raises:
        InputError: it would be refused.
    """
    folder.mkdir()
    write(folder, about, table)
    return read(folder)


def _sha256(*paths: Path) -> str:
    """Hash of the names and the content of files."""
    hashes = [f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n" for path in paths]
    return hashlib.sha256("".join(hashes).encode()).hexdigest()


def _is_reserved(who: str) -> bool:
    return RESERVED in re.sub("[^a-z0-9]", "", who.lower())


def _plain_file(path: Path, most: int) -> bytes:
    """The content of a file that is no link, pipe or device, and not too large."""
    try:
        found = path.lstat()
    except OSError as e:
        raise InputError(f"{path.name} is not there; docs/leaderboard.md says what a submission is") from e
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path.name} is not a plain file")
    if found.st_size > most:
        raise InputError(f"{path.name} has {found.st_size} bytes, at most {most} are read")
    return path.read_bytes()


def _about(content: bytes) -> dict[str, Any]:
    """What a submission says of itself."""
    try:
        about = json.loads(content.decode("utf-8"), parse_constant=_no_number)
    except (ValueError, RecursionError) as e:
        raise InputError(f"{ABOUT} is not JSON ({plain(e)})") from e
    if not isinstance(about, dict):
        raise InputError(f"{ABOUT} is not a JSON object")
    if strange := sorted(set(about) - {*TEXTS, *NUMBERS, "versions"}):
        raise InputError(f"{ABOUT}: no key is called {quoted(strange[0])}; known: {', '.join([*TEXTS, *NUMBERS])}")
    if lacking := [key for key in NEEDED if not about.get(key)]:
        raise InputError(f"{ABOUT}: {lacking[0]} is missing; add it")
    versions = about.get("versions", {})
    if not isinstance(versions, dict) or len(versions) > 100:
        raise InputError(f"{ABOUT}: versions is no object of at most 100 texts")
    for key, value in [*((k, about[k]) for k in TEXTS if k in about), *versions.items()]:
        most = TEXTS.get(key, 80)
        if not isinstance(value, str) or len(value) > most or not value.isprintable() or not key.isprintable():
            raise InputError(f"{ABOUT}: {quoted(key)} is not one line of at most {most} visible characters")
    _check_name("system", about["system"].replace(DOT, " "))
    _check_name("who", about["who"])
    if about.get("batch", "yes") != "yes":
        raise InputError(f"{ABOUT}: batch is {quoted(about['batch'])}; write 'yes' or leave it out")
    for key in NUMBERS:
        value = about.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e15:
            raise InputError(f"{ABOUT}: {key} is not a number from 0 on")
    try:
        date.fromisoformat(about["date"])
    except ValueError as e:
        raise InputError(f"{ABOUT}: date is {quoted(about['date'])}, not a day such as 2026-01-31") from e
    if about["task"] not in TASKS:
        raise InputError(f"{ABOUT}: no task is called {quoted(about['task'])}; {nearest(about['task'], TASKS)}")
    return about


def _check_name(key: str, name: str) -> None:
    """Refuse a name that is blank or that may look like another one: letters of other scripts, doubled spaces.

    Raises:
        InputError: it is such a name.
    """
    words = name.split(" ")
    visible = all(word and not set(word) - {*PUNCTUATION} - _LETTERS for word in words)
    if not visible or not set(name) & _LETTERS:
        raise InputError(
            f"{ABOUT}: {key} is {short(ascii(name), 60)}; write ASCII letters (ue for \u00fc), digits, single spaces "
            f"or {PUNCTUATION}"
        )


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number")


def _read_table(path: Path, rows: int) -> pd.DataFrame:
    """The rows of either format, as they are; text as text or categories.

    Args:
        path: the file.
        rows: that it must have; of a longer CSV file one more is read.
    """
    content = _plain_file(path, LARGEST_TABLE)
    try:
        if path.suffix == ".csv":
            if max(content.find(b"\n"), 0) > LARGEST_HEADER:
                raise InputError(f"{path.name}: its first line is no header")
            with warnings.catch_warnings():
                warnings.simplefilter("error", pd.errors.ParserWarning)  # a row with more cells than the header
                return pd.read_csv(
                    path, dtype=str, keep_default_na=False, encoding="utf-8", index_col=False, nrows=rows + 1
                )
        columns = ParquetFile(path).columns  # refuses what unpacks to far more than it is
        about = pq.read_metadata(path)
        if about.num_rows != rows:
            raise InputError(f"{path.name}: {about.num_rows} rows, not {rows}")
        text = [f.name for f in about.schema.to_arrow_schema() if str(f.type) in ("string", "large_string")]
        return pq.ParquetFile(path, read_dictionary=text).read(columns).to_pandas()
    except InputError:
        raise
    except Exception as e:  # pandas and pyarrow raise a dozen types for damaged files
        raise InputError(f"{path.name} cannot be read as a table ({plain(e)})") from e


def _checked(given: pd.DataFrame, task: Task, expected: pd.DataFrame) -> pd.DataFrame:
    """The rows of the task with the labels that were given.

    Raises:
        InputError: columns, rows or values that are not those of the task.
    """
    classes, keys = sorted(set(expected["true"])), ["capture", *task.keys]
    answers = _answers(given, keys, classes)
    if len(given) != len(expected):
        raise InputError(f"there are not {len(expected)} rows, as {task.name} has")
    words = pd.DataFrame({key: _texts(given[key]) for key in keys})
    if (twice := words.duplicated()).any():
        raise InputError(f"{_row(words[twice], keys)} is there twice")
    joined = expected.merge(words.assign(position=np.arange(len(words))), on=keys, how="left")
    if (missing := joined["position"].isna()).any():
        raise InputError(f"{_row(joined[missing], keys)} is missing")
    rows = given.iloc[joined["position"].astype(int)].reset_index(drop=True)
    if "true" in rows and (wrong := _texts(rows["true"]) != expected["true"]).any():
        raise InputError(
            f"true of {_row(expected[wrong], keys)} is {expected[wrong]['true'].iloc[0]}, not what it says"
        )
    if answers == ["predicted"]:
        labels = _texts(rows["predicted"])
        if (strange := ~labels.isin(classes)).any():
            raise InputError(f"predicted is {quoted(labels[strange].iloc[0])}, not one of {', '.join(classes)}")
        return expected.assign(predicted=labels)
    proba = _numbers(rows[answers])
    labels = np.asarray(classes, dtype=object)[proba.argmax(axis=1)]
    shown = pd.DataFrame(proba.astype(np.float32), columns=answers)
    return pd.concat([expected.assign(predicted=labels), shown], axis=1)


def _texts(column: pd.Series) -> pd.Series:
    """A column as text.

    Raises:
        InputError: a cell is empty or holds bytes.
    """
    if column.isna().any():
        raise InputError(f"{column.name} holds an empty cell; fill it")
    values = column.astype(object)
    if values.map(lambda value: isinstance(value, bytes)).any():
        raise InputError(f"{column.name} is not text; write it as UTF-8 text")
    return values.map(str)


def _answers(given: pd.DataFrame, keys: list[str], classes: list[str]) -> list[str]:
    """The columns that hold labels or probabilities."""
    probabilities = [scores.PREFIX + c for c in classes]
    known = [*keys, "predicted", *probabilities, "true"]
    if strange := sorted(set(map(str, given.columns)) - {*known}):
        raise InputError(f"column {quoted(strange[0])} is not one of {', '.join(known)}")
    if lacking := [c for c in keys if c not in given]:
        raise InputError(f"column {lacking[0]} is missing")
    answers = [c for c in ("predicted", *probabilities) if c in given]
    if answers not in (["predicted"], probabilities):
        raise InputError(f"give a column predicted, or one for every class: {', '.join(probabilities)}")
    return answers


def _numbers(given: pd.DataFrame) -> np.ndarray:
    """Probabilities [rows, classes]."""
    try:
        proba = given.astype(float).to_numpy()
    except (ValueError, TypeError) as e:
        raise InputError(f"a probability is no number ({plain(e)})") from e
    if not np.isfinite(proba).all() or (proba < 0).any():
        raise InputError("a probability is not a number from 0 to 1")
    total = proba.sum(axis=1)
    if (off := np.abs(total - 1)).max() > SUM:
        raise InputError(f"the probabilities of a row add up to {total[off.argmax()]:.3g}, not to 1")
    return proba


def _row(found: pd.DataFrame, keys: list[str]) -> str:
    """The first row in words."""
    return ", ".join(f"{name} {plain(found[name].iloc[0], 30)}" for name in keys)
