"""Compare all that two MLflow stores hold: ``python -m tests.net.stores BEFORE AFTER`` prints every difference.

BEFORE and AFTER are folders with ``mlflow.db``, or tracking URIs. Runs are paired by what they are runs of, tables by
name. Numbers must be equal to the last digit, SVG files to the last byte. Times, memory, versions, machine, ids and
keys are left out. Exit code 1 if anything differs or is on one side alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import numpy as np
import pandas as pd

SAME_RUN = ("touchbench.kind", "system", "data", "protocol_label", "subset", "target", "seed")  # tags
NOT_OPTIONS = ("data", "features", "model", "protocol", "tuning", "version")  # parts whose parameters are in the system
APART = re.compile(  # numbers, parameters, tags and columns that differ from run to run
    r"(.*_)?seconds|.*_ms_p\d+|predict_ms|decide_ms|slowdown|quiet_ms"
    r"|decisions_per_second|reference_ms|predict_relative|peak_rss_bytes"
    r"|front"  # trials that no other beats in accuracy and time
    r"|version\..*|touchbench\.format|chip\.toolchain|git|cpu|simd|threads|touchbench\.cell|mlflow\.(user|source\..*|log-model.*)"
)
TEXTS = (".json", ".md", ".txt", ".tex")
TEMPORARY = "folds/"  # files of folds, until they are tables of the run


def without(values: dict[str, Any]) -> dict[str, Any]:
    """The values that do not differ from run to run."""
    return {name: value for name, value in values.items() if not APART.fullmatch(str(name))}


class Side:
    """One store: a folder with ``mlflow.db``, or a tracking URI."""

    def __init__(self, address: str) -> None:
        from mlflow import MlflowClient

        self.folder = None if "://" in address else Path(address).resolve()
        self.client = MlflowClient(address if self.folder is None else f"sqlite:///{self.folder / 'mlflow.db'}")
        experiments = [e.experiment_id for e in self.client.search_experiments()]
        self.runs, token = [], None
        while page := self.client.search_runs(experiments, max_results=1000, page_token=token):
            self.runs += page
            if not (token := page.token):
                break
        self.runs.sort(key=lambda run: run.info.start_time)

    def text(self, value: str) -> str:
        """A text without the folder of the store."""
        return value.replace(str(self.folder), "~") if self.folder else value

    def kind(self, run: Any) -> tuple[str, ...]:
        """What a run is a run of, without its options."""
        return tuple(self.text(run.data.tags.get(name, "")) for name in SAME_RUN)

    def facts(self, run: Any) -> dict[str, object]:
        """All that is stored of a run, by a name that says what it is."""
        facts: dict[str, object] = {"status": run.info.status}
        for what in ("params", "tags"):
            facts |= {f"{what} {k}": self.text(v) for k, v in without(getattr(run.data, what)).items()}
        for metric in run.data._metric_objs:
            if not APART.fullmatch(metric.key) and not metric.key.startswith("fold/"):  # which its table of folds has
                points = self.client.get_metric_history(run.info.run_id, metric.key) if metric.step else ()
                facts[f"number {metric.key}"] = sorted((p.step, p.value) for p in points) or metric.value
        with tempfile.TemporaryDirectory() as fetched:
            root = self._files(run, fetched)
            for path in sorted(path for path in root.rglob("*") if path.is_file()):
                if not (name := str(path.relative_to(root))).startswith(TEMPORARY):
                    facts |= self._contents(f"file {name}", path)
        return facts

    def _files(self, run: Any, fetched: str) -> Path:
        """The folder of a run's files; a copied store has them beside its database."""
        uri = urlparse(run.info.artifact_uri)
        if self.folder and uri.scheme == "touchbench":
            return self.folder / uri.path.lstrip("/")
        root = Path(uri.path)
        if self.folder:
            beside = self.folder / "mlruns" / root.parent.parent.name / run.info.run_id / "artifacts"
            return beside if beside.exists() else root
        return Path(self.client.download_artifacts(run.info.run_id, "", fetched))

    def _contents(self, name: str, path: Path) -> dict[str, object]:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
            return {name: f"{len(table)} rows"} | {f"{name}: column {c}": v for c, v in without(dict(table)).items()}
        if path.suffix in TEXTS:
            content = json.loads(path.read_text()) if path.suffix == ".json" else self.text(path.read_text())
            return {name: without(content) if isinstance(content, dict) else content}
        return {name: hashlib.sha256(path.read_bytes()).hexdigest()[:12]} if path.suffix == ".svg" else {}


def options_of(run: Any) -> list[tuple[str, str]]:
    """Options of the experiment."""
    own = {k: v for k, v in without(run.data.params).items() if k.split(".")[0] not in NOT_OPTIONS}
    return sorted((k, v) for k, v in own.items() if k not in ("corpus_digest", "where", "target"))


def named(side: Side, run: Any) -> str:
    """A run in words."""
    return " | ".join([*side.kind(run), *(f"{k}={v}" for k, v in options_of(run))])


def paired(before: Side, after: Side) -> tuple[list[tuple[Any, Any]], list[Any], list[Any]]:
    """Pairs of runs of the same thing, those with equal options first, then by age; and those of one side alone."""
    pairs, lonely, rest = [], [*before.runs], [*after.runs]
    for exact in (True, False):
        for run in lonely.copy():
            like = [r for r in rest if after.kind(r) == before.kind(run)]
            if like := [r for r in like if not exact or options_of(r) == options_of(run)]:
                pairs.append((run, like[0]))
                rest.remove(like[0])
                lonely.remove(run)
    return pairs, lonely, rest


def difference(before: object, after: object) -> str:
    """How two values differ, in words; empty if they are equal. Nothing equals nothing, and text no number."""
    if isinstance(before, pd.Series) and isinstance(after, pd.Series):
        kinds = [_kind(column) for column in (before, after)]
        if kinds[0] != kinds[1]:
            return f"{kinds[0]} -> {kinds[1]}"
        if len(before) != len(after):
            return ""  # which the number of rows tells
        old, new = (column.astype(object).to_numpy() for column in (before, after))
        wrong = [i for i, (a, b) in enumerate(zip(old, new, strict=True)) if difference(a, b)]
        if not wrong:
            return ""
        return f"differs in {len(wrong)} rows, row {wrong[0]}: {difference(old[wrong[0]], new[wrong[0]])}"
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        wrong = [i for i, (a, b) in enumerate(zip(before, after, strict=True)) if repr(a) != repr(b)]
        return f"{before[wrong[0]]!r} -> {after[wrong[0]]!r}" if wrong else ""
    return "" if repr(before) == repr(after) else f"{before!r} -> {after!r}"


def _kind(column: pd.Series) -> str:
    """Text, number, number of 32 bits or truth."""
    if column.dtype in (bool, np.float32):
        return "truth" if column.dtype == bool else "short number"
    return "number" if pd.api.types.is_numeric_dtype(column) else "text"


def main(before: str, after: str) -> int:
    """Print differences and a summary."""
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    one, other = Side(before), Side(after)
    pairs, only_before, only_after = paired(one, other)
    lines = [f"{named(one, run)}: run only before" for run in only_before]
    lines += [f"{named(other, run)}: run only after" for run in only_after]
    counts: Counter[str] = Counter(runs=len(pairs))
    for run, twin in pairs:
        old, new, where = one.facts(run), other.facts(twin), named(one, run)
        for name in dict.fromkeys([*old, *new]):
            counts[name.split()[0]] += 1
            if name not in old or name not in new:
                alone, whole = ("before" if name in old else "after"), name.partition(": column")[0]
                if name == whole or (whole in old and whole in new):
                    lines.append(f"{where}: {name} only {alone}")
            elif words := difference(old[name], new[name]):
                lines.append(f"{where}: {name}: {words}")
    print(*lines, sep="\n", end="\n" * bool(lines))
    print(f"compared: {', '.join(f'{count} {what}' for what, count in counts.items() if count) or 'nothing'}")
    print(f"{len(lines)} differences")
    return int(bool(lines) or not pairs)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
