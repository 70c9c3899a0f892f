"""Compare all that two MLflow stores hold: ``python -m tests.net.stores BEFORE AFTER`` prints every difference.

BEFORE and AFTER are folders with ``mlflow.db``, or tracking URIs. Runs are paired by what they are runs of, folds by
name, tables by name without suffix. Numbers must be equal to the last digit, SVG files to the last byte. Times, memory,
versions, machine, ids and keys are left out. Exit code 1 if anything differs or is on one side alone.

Folds are rows of a run's table of folds; before, each was a run of its own. A store of that kind may be BEFORE: status
and numbers of its folds, also by epoch, are compared as well. What such folds had besides (tables that the run has,
too, parameters ``chosen.*``) is left out.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import numpy as np
import pandas as pd

SAME_RUN = ("touchbench.kind", "system", "data", "protocol_label", "subset", "target", "seed")  # tags
NOT_OPTIONS = ("data", "features", "model", "protocol", "tuning", "version")  # parts whose parameters are in the system
APART = re.compile(  # numbers, parameters, tags and columns that differ from run to run
    r"(.*_)?seconds|.*_ms_p\d+|predict_ms|decide_ms|slowdown|quiet_ms"
    r"|(window_)?decision_ms|decisions_per_second|reference_ms|predict_relative|peak_rss_bytes"
    r"|front"  # trials that no other beats in accuracy and time
    r"|version\..*|touchbench\.format|chip\.toolchain|git|cpu|simd|threads|touchbench\.cell|mlflow\.(parentRunId|user|source\..*|log-model.*)"
)
TABLES, TEXTS = (".csv", ".parquet"), (".json", ".md", ".txt", ".tex")
NOT_NUMBERS = ("fold", "status", "error", "cpu", "simd")  # of a row of the table of folds
OF_FOLDS = re.compile("folds?/|(folds|history).parquet")  # files that are compared fold by fold, or are temporary


@dataclass
class Found:
    """Differences and counts of what was compared."""

    differences: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def equal(self, what: str, where: str, before: object, after: object) -> None:
        """Count a value of a kind; note it if it differs."""
        self.counts[what] += 1
        if not same(before, after):
            self.differences.append(f"{where}: {before!r} -> {after!r}")

    def both(self, what: str, where: str, before: dict[str, Any], after: dict[str, Any]) -> Iterator[str]:
        """Names on both sides; the others are noted."""
        for name in before:
            if name in after:
                yield name
            else:
                self.differences.append(f"{where}: {what} {name} only before")
        self.differences += [f"{where}: {what} {name} only after" for name in after if name not in before]


def same(before: object, after: object) -> bool:
    """Return True for equal values of equal kind; nothing equals nothing."""
    if isinstance(before, float) and isinstance(after, float):
        return before == after or (math.isnan(before) and math.isnan(after))
    return before == after


class Side:
    """One store.

    Args:
        address: folder with ``mlflow.db``, or a tracking URI.
    """

    def __init__(self, address: str) -> None:
        from mlflow import MlflowClient

        self.folder = None if "://" in address else Path(address).resolve()
        self.client = MlflowClient(address if self.folder is None else f"sqlite:///{self.folder / 'mlflow.db'}")
        experiments = [e.experiment_id for e in self.client.search_experiments()]
        runs, token = [], None
        while True:
            page = self.client.search_runs(experiments, max_results=1000, page_token=token)
            runs, token = [*runs, *page], page.token
            if not token:
                break
        runs.sort(key=lambda run: run.info.start_time)
        self.parents, self.children = [], defaultdict(list)
        for run in runs:
            parent = run.data.tags.get("mlflow.parentRunId")
            (self.children[parent] if parent else self.parents).append(run)

    def text(self, value: str) -> str:
        """A text without the folder of the store."""
        return value.replace(str(self.folder), "~") if self.folder else value

    def texts(self, values: dict[str, str]) -> dict[str, str]:
        """Parameters or tags that do not differ from run to run."""
        return {name: self.text(text) for name, text in values.items() if not APART.fullmatch(name)}

    def numbers(self, run: Any) -> dict[str, object]:
        """Numbers of a run; one with steps is the list of all."""
        numbers: dict[str, object] = {}
        for metric in run.data._metric_objs:
            if not APART.fullmatch(metric.key) and not metric.key.startswith("fold/"):  # which its table of folds has
                numbers[metric.key] = metric.value
                if metric.step:
                    history = self.client.get_metric_history(run.info.run_id, metric.key)
                    numbers[metric.key] = sorted((point.step, point.value) for point in history)
        return numbers

    def files(self, run: Any, fetched: Path) -> dict[str, Path]:
        """Files of a run by name; a copied folder has them beside its database."""
        uri = urlparse(run.info.artifact_uri)
        root = Path(uri.path) if uri.scheme in ("", "file") else None
        if self.folder and uri.scheme == "touchbench":  # beside the database, wherever it is moved
            root = self.folder / uri.path.lstrip("/")
        elif self.folder and root is not None:
            beside = self.folder / "mlruns" / root.parent.parent.name / run.info.run_id / "artifacts"
            root = beside if beside.exists() else root
        if root is None or not (root.exists() or self.folder):
            root = Path(self.client.download_artifacts(run.info.run_id, "", str(fetched)))
        return {str(path.relative_to(root)): path for path in sorted(root.rglob("*")) if path.is_file()}

    def folds(self, run: Any) -> dict[str, dict[str, object]]:
        """Status and numbers of the folds of a run by name, those by epoch as a list."""
        folds: dict[str, dict[str, object]] = {}
        for child in self.children[run.info.run_id]:
            numbers = {k: v for k, v in self.numbers(child).items() if not (isinstance(v, float) and math.isnan(v))}
            folds[child.data.tags["touchbench.fold"]] = {"status": child.info.status, **numbers}
        if folds:
            return folds
        with tempfile.TemporaryDirectory() as folder:
            files = self.files(run, Path(folder))
            if "folds.parquet" not in files:
                return {}
            for row in pd.read_parquet(files["folds.parquet"]).to_dict("records"):
                numbers = {k: v for k, v in row.items() if k not in NOT_NUMBERS and not APART.fullmatch(k)}
                numbers = {k: v for k, v in numbers.items() if not pd.isna(v)}
                folds[row["fold"]] = {"status": row["status"], **numbers}
            if "history.parquet" in files:
                epochs = pd.read_parquet(files["history.parquet"])
                for fold, rows in epochs.groupby("fold"):
                    for name in (n for n in rows if n not in ("fold", "epoch")):
                        known = rows[rows[name].notna()]
                        folds[fold][name] = [*zip(known["epoch"], known[name], strict=True)]
        return folds


def kind_of(side: Side, run: Any) -> tuple[str, ...]:
    """What a run is a run of, without its options."""
    return tuple(side.text(run.data.tags.get(name, "")).replace(", over=", ", smallest=") for name in SAME_RUN)


def options_of(run: Any) -> tuple[tuple[str, str], ...]:
    """Options of the experiment."""
    own = {k: v for k, v in run.data.params.items() if k.split(".")[0] not in NOT_OPTIONS and not APART.fullmatch(k)}
    return tuple(sorted((k, v) for k, v in own.items() if k not in ("corpus_digest", "where", "target")))


def paired(before: Side, after: Side) -> tuple[list[tuple[Any, Any]], list[Any], list[Any]]:
    """Pairs of runs of the same thing, those with equal options first, then by age; and those of one side alone."""
    pairs, rest = [], list(after.parents)
    lonely = []
    for exact in (True, False):
        for run in before.parents if exact else lonely.copy():
            like = [r for r in rest if kind_of(after, r) == kind_of(before, run)]
            like = [r for r in like if options_of(r) == options_of(run)] if exact else like
            if like:
                pairs.append((run, like[0]))
                rest.remove(like[0])
                if not exact:
                    lonely.remove(run)
            elif exact:
                lonely.append(run)
    return pairs, lonely, rest


def compare(before: str, after: str) -> Found:
    """Compare two stores."""
    one, other, found = Side(before), Side(after), Found()
    pairs, only_before, only_after = paired(one, other)
    for side, runs, words in ((one, only_before, "before"), (other, only_after, "after")):
        found.differences += [f"{named(side, run)}: run only {words}" for run in runs]
    for run, twin in pairs:
        where = named(one, run)
        _compare_runs(found, where, (one, run), (other, twin))
        folds = one.folds(run), other.folds(twin)
        for name in found.both("fold", where, *folds):
            at, sides = f"{where}, fold {name}", (folds[0][name], folds[1][name])
            found.counts["folds"] += 1
            for key in found.both("number", at, *sides):
                found.equal("numbers", f"{at}: {key}", sides[0][key], sides[1][key])
    return found


def named(side: Side, run: Any) -> str:
    """A run in words."""
    options = [f"{k}={v}" for k, v in options_of(run)]
    return " | ".join([*kind_of(side, run), *options])


def _compare_runs(found: Found, where: str, before: tuple[Side, Any], after: tuple[Side, Any]) -> None:
    (one, run), (other, twin) = before, after
    found.counts["runs"] += 1
    found.equal("states", f"{where}: status", run.info.status, twin.info.status)
    for what in ("params", "tags"):
        sides = one.texts(getattr(run.data, what)), other.texts(getattr(twin.data, what))
        for name in found.both(what, where, *sides):
            found.equal("parameters and tags", f"{where}: {what} {name}", sides[0][name], sides[1][name])
    numbers = one.numbers(run), other.numbers(twin)
    for name in found.both("number", where, *numbers):
        found.equal("numbers", f"{where}: {name}", numbers[0][name], numbers[1][name])
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "a").mkdir(), (Path(folder) / "b").mkdir()
        files = one.files(run, Path(folder) / "a"), other.files(twin, Path(folder) / "b")
        stems = [{_stem(name): path for name, path in side.items() if not OF_FOLDS.match(name)} for side in files]
        for name in found.both("file", where, *stems):
            paths = stems[0][name], stems[1][name]
            if paths[0].suffix in TABLES:
                compare_tables(found, f"{where}: {name}", *paths)
            elif paths[0].suffix in TEXTS:
                texts = [_text(side, path) for side, path in ((one, paths[0]), (other, paths[1]))]
                found.equal("texts", f"{where}: {name}", *texts)
            elif paths[0].suffix == ".svg":
                found.equal("pictures", f"{where}: {name}", *(_digest(path) for path in paths))


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


def _stem(name: str) -> str:
    return str(Path(name).with_suffix("")) if Path(name).suffix in TABLES else name


def _text(side: Side, path: Path) -> object:
    """A text without folder and times."""
    text = side.text(path.read_text())
    if path.suffix == ".json":
        content = json.loads(text)
        return {k: v for k, v in content.items() if not APART.fullmatch(k)} if isinstance(content, dict) else content
    return text


def compare_tables(found: Found, where: str, before: Path, after: Path) -> None:
    """Compare two tables: columns, rows and values in their order; the types of Parquet hold for both."""
    found.counts["tables"] += 1
    tables = [_read(path) for path in (before, after)]
    names = [[name for name in table if not APART.fullmatch(name)] for table in tables]
    if names[0] != names[1]:
        found.differences.append(f"{where}: columns {names[0]} -> {names[1]}")
    if len(tables[0]) != len(tables[1]):
        found.differences.append(f"{where}: {len(tables[0])} rows -> {len(tables[1])}")
        return
    for name in (n for n in names[0] if n in names[1]):
        kinds = [_kind(table[name], path) for table, path in zip(tables, (before, after), strict=True)]
        if None not in kinds and kinds[0] != kinds[1]:
            found.differences.append(f"{where}: column {name} is {kinds[0]} -> {kinds[1]}")
        kind = kinds[0] or kinds[1] or _guessed(*(table[name] for table in tables))
        told = before.suffix == after.suffix == ".parquet"
        columns = [[_value(value, kind, told) for value in table[name]] for table in tables]
        found.counts["values"] += len(columns[0])
        wrong = [i for i, (a, b) in enumerate(zip(*columns, strict=True)) if not same(a, b)]
        if wrong:
            first = f"row {wrong[0]}: {columns[0][wrong[0]]!r} -> {columns[1][wrong[0]]!r}"
            found.differences.append(f"{where}: column {name} differs in {len(wrong)} rows, {first}")


def _read(path: Path) -> pd.DataFrame:
    """A table; the cells of CSV as they are written."""
    if path.suffix == ".parquet":
        return pd.read_parquet(path)
    return pd.read_csv(path, dtype=str, keep_default_na=False)


def _kind(column: pd.Series, path: Path) -> str | None:
    """Text, number, number of 32 bits or truth; None if a file does not tell."""
    if path.suffix == ".csv":
        return None
    if pd.api.types.is_bool_dtype(column):
        return "truth"
    if column.dtype == np.float32:
        return "short number"
    return "number" if pd.api.types.is_numeric_dtype(column) else "text"


def _guessed(*columns: pd.Series) -> str:
    """The kind of columns of CSV files: numbers if all cells are."""
    try:
        [float(cell) for column in columns for cell in column if cell != ""]
    except ValueError:
        return "text"
    return "number"


def _value(value: Any, kind: str, told: bool) -> object:
    """A value to compare; an empty text, None and NaN are apart if both files tell them apart, as CSV does not."""
    if value is None or (value == "" and not told):
        return None
    if not isinstance(value, str) and pd.isna(value):
        return math.nan if told else None
    if kind == "number":
        return float(value)
    if kind == "short number":
        return float(np.float32(value))
    return str(value)


def main(before: str, after: str) -> int:
    """Print differences and a summary."""
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    found = compare(before, after)
    for difference in found.differences:
        print(difference)
    print(f"compared: {', '.join(f'{count} {what}' for what, count in found.counts.items()) or 'nothing'}")
    print(f"{len(found.differences)} differences")
    return int(bool(found.differences) or not found.counts)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
