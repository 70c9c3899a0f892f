"""The command ``bench stress``: where recognisers fail, under faults and under what is not a fault."""

from __future__ import annotations

import hashlib
import importlib
import json
import re
import tempfile
from functools import partial
from pathlib import Path

import pandas as pd
from rich.markup import escape
from rich.table import Table

from bench.cells import Cell, cells, convert, items, parse
from bench.corpus import Corpus
from bench.errors import InputError
from bench.faults import Fault, known
from bench.fold import FoldResult
from bench.registry import nearest
from bench.run import KEYS as RUN_KEYS
from bench.run import begun, ended, interrupted, jobs_of, output, planned, run_cell
from bench.source import source_digest
from bench.stress_fold import COLUMNS, seed_of, stress_fold, subset
from bench.tracking import CellRun
from reports import stability, stability_tables

KEYS = {*RUN_KEYS, "faults", "train_subjects", "out"}
TAKEN = {*COLUMNS, "start", "frames", "hit"}  # columns of the table, which a corpus cannot have too


def stress(arguments: list[str]) -> int:
    """Stress every cell that the arguments name, print where each fails; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    values = parse(arguments, KEYS)
    faults = _faults(values)
    fewer = _counts(values)
    asked = cells({k: v for k, v in values.items() if k not in ("faults", "train_subjects", "out")})
    plans = planned(asked, jobs := jobs_of(values))
    for plan in plans:
        _check(plan, fewer)
    out = Path(values.get("out", "stress"))
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise InputError(f"{out} cannot be written ({e.strerror}); choose another out=") from e
    client = begun(plans, jobs)
    options = {"faults": ", ".join(f.name for f in faults), "train_subjects": ", ".join(map(str, fewer)) or "all"}
    found: list[tuple[str, stability.Analysis, str]] = []
    failed: list[str] = []
    for plan in plans:
        cell, corpus, *_, threads = plan
        key = stress_key(cell, corpus, threads, faults, fewer)
        work = partial(stress_fold, faults=faults, fewer=fewer)
        try:
            analysed, errors, _ = run_cell(client, partial(StressRun, options), key, *plan, work)
        except KeyboardInterrupt:
            return interrupted()
        failed += [f"{cell.system()}, {cell.data}, {cell.protocol}: fold {name}" for name in errors]
        if analysed:
            found.append((*analysed, corpus.digest))
    _report(client, found, out)
    return ended([], plans, failed)


def _faults(values: dict[str, str]) -> tuple[Fault, ...]:
    """Faults that were asked for, all without ``faults=``, in the order in which they are known."""
    there = known()
    asked = items("faults", values["faults"]) if "faults" in values else list(there)
    for name in asked:
        if name not in there:
            raise InputError(f"faults={name}: not known; {nearest(name, there)}")
    return tuple(fault for name, fault in there.items() if name in asked)


def _counts(values: dict[str, str]) -> tuple[int, ...]:
    """Numbers of training subjects that were asked for."""
    if "train_subjects" not in values:
        return ()
    counts = {convert("train_subjects", text, 4) for text in items("train_subjects", values["train_subjects"])}
    if min(counts) < 1:
        raise InputError(f"train_subjects={min(counts)}: give whole numbers from 1 on")
    return tuple(sorted(counts))


def _check(plan: tuple, fewer: tuple[int, ...]) -> None:
    cell, corpus, folds, *_ = plan
    if both := sorted(TAKEN & set(corpus.captures)):
        raise InputError(
            f"{corpus.name} has a column {both[0]!r}, and so has the table of bench stress; rename it and import again"
        )
    estimator = cell.estimator()
    for fold in folds:
        subjects = len(set(corpus.subjects[fold.train]))
        for count in fewer:
            if count >= subjects:
                raise InputError(
                    f"train_subjects={count}: fold {fold.name} of protocol={cell.protocol} has {subjects} training "
                    f"subjects; give fewer than that (all of them are always used too)"
                )
            if hasattr(estimator, "check_training"):
                part = subset(corpus, fold.train, fold.test, count, seed_of(cell))
                estimator.check_training(corpus[part], corpus.gestures[part])


def stress_key(cell: Cell, corpus: Corpus, threads: int, faults: tuple[Fault, ...], fewer: tuple[int, ...]) -> str:
    """What makes two stress runs the same run: that of the cell, the faults with their code, the training subjects."""
    same = {
        "cell": cell.key(corpus, threads),
        "harness": source_digest(importlib.import_module("bench.stress_fold")),
        "faults": [(f.name, f.unit, f.amounts, f.sensor, source_digest(f.damage)) for f in faults],
        "train_subjects": fewer,
    }
    return hashlib.sha256(json.dumps(same).encode()).hexdigest()[:20]


class StressRun(CellRun):
    """The parent run of a stressed cell, found again if it was begun before."""

    kind, fold_kind = "stress", "stress_fold"

    def __init__(self, options: dict[str, object], *more: object) -> None:
        self.options = options
        super().__init__(*more)

    def fold_metrics(self, result: FoldResult) -> dict[str, float]:
        """Accuracy of clean captures, and under each fault and severity; seconds."""
        accuracy = (result.predictions["true"] == result.predictions["predicted"]).groupby(
            [result.predictions["fault"], result.predictions["severity"]]
        )
        named = {f"accuracy.{fault}.{severity}": value for (fault, severity), value in accuracy.mean().items()}
        return {"accuracy": stability.unharmed(result.predictions).pipe(_accuracy)} | named | result.metrics

    def close(self, order: list[str]) -> tuple[str, stability.Analysis] | None:
        """Analyse the run from its folds in the order of the protocol and end it.

        Returns:
            Its id and what its table says; None if no fold went well.
        """
        results = [self.done[name] for name in order if name in self.done]
        if not results:
            self.client.set_terminated(self.run_id, "FAILED")
            return None
        table = pd.concat([r.predictions for r in results], ignore_index=True)
        analysis = stability.analyse(self.client.get_run(self.run_id).data.tags, table)
        if not self.finished:  # else nothing was run, nothing is written
            seconds = {k: sum(r.metrics[k] for r in results) / len(results) for k in results[0].metrics}
            counts = {"folds": len(results), "folds_failed": len(order) - len(results)}
            self._log(self.run_id, stability.metrics(analysis) | seconds | counts, [])
            with tempfile.TemporaryDirectory() as folder:
                table.to_parquet(Path(folder) / "stress.parquet", index=False)
                self.client.log_artifacts(self.run_id, folder)
            self.client.set_terminated(self.run_id, "FINISHED" if len(results) == len(order) else "FAILED")
        return self.run_id, analysis


def _accuracy(units: pd.DataFrame) -> float:
    return float((units["true"] == units["predicted"]).mean())


def _report(client: object, found: list[tuple[str, stability.Analysis, str]], out: Path) -> None:
    """Print, write and track the tables and figures of the methods of each corpus, subset and protocol."""
    contexts: dict[tuple, list[tuple[str, stability.Analysis]]] = {}
    for run, analysis, digest in found:
        contexts.setdefault((*analysis.context, digest), []).append((run, analysis))
    screen = output()
    used: set[Path] = set()
    for context, members in contexts.items():
        folder = out
        if len(contexts) > 1:
            name = re.sub(r"[^A-Za-z0-9]+", "-", " ".join(context[:-1])).strip("-").lower()
            folder = out / name if out / name not in used else out / f"{name}-{len(used) + 1}"
        used.add(folder)
        analyses = [analysis for _, analysis in members]
        paths = stability_tables.write(analyses, folder)
        for run, analysis in members:
            for path in paths:
                client.log_artifact(run, str(path), "stability")
            if seeds := stability.seeds([a for a in analyses if a.system == analysis.system]).to_dict("records"):
                client.log_metric(run, "seed_accuracy_sd", seeds[0]["sd"])
                client.log_metric(run, "seed_labels_changed", seeds[0]["changed"])
        screen.print(escape(stability_tables.title(analyses[0])), style="bold")
        for heading, note, table in stability_tables.sections(analyses):
            _print(screen, heading, note, table)
        screen.print(f"tables and figures: {escape(str(folder))}", soft_wrap=True)


def _print(screen: object, heading: str, note: str, table: pd.DataFrame) -> None:
    if len(table):
        shown = Table(title=escape(heading), caption=escape(note), title_justify="left", caption_justify="left")
        for name in table.columns:
            text = table[name].str.fullmatch(r"[-><\d. e+]+|no margin").all()
            shown.add_column(escape(name), justify="right" if text else "left")
        for row in table.itertuples(index=False):
            shown.add_row(*(escape(cell) for cell in row))
        screen.print(shown)
    else:
        screen.print(f"{escape(heading)}: {escape(note)}", soft_wrap=True)
