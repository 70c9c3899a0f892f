"""The command ``bench stream``: captures replayed through fitted systems, and frames from standard input."""

from __future__ import annotations

import hashlib
import importlib
from dataclasses import asdict
from functools import partial
from pathlib import Path

import pandas as pd
from rich.markup import escape
from rich.table import Table

from bench.cells import PARTS, Cell, cells, convert, items, parse
from bench.corpus import Corpus, InputError
from bench.fold import FoldResult
from bench.replay import INNER, Replay, by_instant, by_threshold, learned_point, standing, stopped, stream_fold
from bench.run import begun, console, ended, interrupted, jobs_of, planned, run_cell
from bench.runner import Fold
from bench.source import source_digest
from bench.tracking import CellRun, costs
from models.inner import inner_folds
from reports.streaming import SHOWN_MS, figure, write_streaming

KEYS = {"data", "where", "target", "seed", "jobs", "hop_ms", "start", "out", "source", "window_ms", *PARTS}


def stream(arguments: list[str]) -> int:
    """Replay captures under a protocol, or decide on frames from standard input; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    values = parse(arguments, KEYS)
    if "source" in values:
        from bench.live import live

        return live(values)
    if "window_ms" in values:
        raise InputError(f"window_ms={values['window_ms']}: only with source=-; leave it out")
    hop = number("hop_ms", values.pop("hop_ms")) if "hop_ms" in values else None
    replays = [Replay(hop, start) for start in dict.fromkeys(items("start", values.pop("start", "onset")))]
    out = Path(values.pop("out", "report"))
    jobs = jobs_of(values)
    plans = planned(cells(values), jobs)
    for cell, corpus, folds, *_ in plans:
        check(cell, corpus, folds)
        for replay in replays:
            replay.check(corpus.rate_hz)
    writable(out)
    for name in dict.fromkeys(cell.data for cell, corpus, *_ in plans if len(set(corpus.lengths)) == 1):
        console.print(
            f"warning: {name}: all captures are equally long; features that grow with duration were never seen at "
            "another one, so a capture that is not whole yet may look like nothing that was ever seen",
            style="yellow",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    client = begun(plans, jobs)
    table, failed, runs = _result_table(), [], []
    for cell, corpus, folds, workers, threads in plans:
        for replay in replays:
            tracked = partial(StreamRun, replay, runs)
            work = partial(stream_fold, replay=replay)
            try:
                key = stream_key(cell, corpus, threads, replay)
                found = run_cell(client, tracked, key, cell, corpus, folds, workers, threads, work)
            except KeyboardInterrupt:
                return interrupted()
            metrics, errors, _ = found
            failed += [f"{cell.system()}, {cell.data}, {cell.protocol}: fold {name}" for name in errors]
            _add_row(table, cell, corpus, replay, metrics, len(folds) - len(errors), len(folds))
    code = ended([table], plans, failed)
    for path in write_streaming(client, [run.run_id for run in runs if run.done], out):
        console.print(str(path), markup=False, highlight=False, soft_wrap=True)
    return code


def number(key: str, text: str) -> float:
    """A number above 0.

    Raises:
        InputError: it is none.
    """
    value = convert(key, text, 1.0)
    if not 0 < value < float("inf"):
        raise InputError(f"{key}={text}: give a number above 0")
    return value


def writable(folder: Path) -> None:
    """Make the folder before anything is run.

    Raises:
        InputError: it cannot be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise InputError(f"out={folder}: cannot be written ({e.strerror}); choose another folder") from e


def check(cell: Cell, corpus: Corpus, folds: list[Fold]) -> None:
    """Refuse training parts from which no threshold can be learned.

    Raises:
        InputError: a training part of one subject, or of subjects one of whom has all but one class.
    """
    for fold in folds:
        subjects, gestures = corpus.subjects[fold.train].astype(str), corpus.gestures[fold.train]
        if len(set(subjects)) < 2:
            raise InputError(
                f"protocol={cell.protocol}: fold {fold.name} trains on one subject, and when to stop is learned by "
                "leaving training subjects out; choose another protocol or more captures"
            )
        inner_parts = [inner for inner, _ in inner_folds(subjects, INNER)]
        if hasattr(estimator := cell.estimator(), "check_training"):
            for inner in inner_parts:
                estimator.check_training(corpus[fold.train][inner], gestures[inner])
        if any(len(set(gestures[inner])) < 2 for inner in inner_parts):
            raise InputError(
                f"protocol={cell.protocol}: leaving training subjects of fold {fold.name} out leaves one "
                f"{corpus.target}; choose another protocol or more captures"
            )


def stream_key(cell: Cell, corpus: Corpus, threads: int, replay: Replay) -> str:
    """What makes two replays the same: the cell, how it is replayed, and the code of it."""
    code = source_digest(importlib.import_module("bench.replay"))
    return hashlib.sha256(f"{cell.key(corpus, threads)} {replay} {code}".encode()).hexdigest()[:20]


class StreamRun(CellRun):
    """The parent run of a replayed cell, tagged ``stream``."""

    kind = "stream"
    fold_kind = "stream_fold"

    def __init__(self, replay: Replay, made: list, client: object, cell: Cell, corpus: Corpus, *more: object) -> None:
        self.options = {f"stream.{k}": v for k, v in asdict(replay).items()}
        self.start = replay.start
        super().__init__(client, cell, corpus, *more)
        made.append(self)

    def fold_metrics(self, result: FoldResult) -> dict[str, float]:
        """Accuracy of whole captures, and of stopping at the learned threshold; costs."""
        point = learned_point(result.predictions, {result.name: result.chosen["threshold"]}, self.rate_hz)
        whole = stopped(result.predictions, float("inf"))
        found = {"accuracy": float((whole["true"] == whole["predicted"]).mean())}
        return found | {"adaptive_accuracy": point["accuracy"], "adaptive_ms": point["mean_ms"]} | costs([result])

    def measure(self, predictions: pd.DataFrame, results: list[FoldResult]) -> dict[str, float]:
        """Accuracy of whole captures and of adaptive stopping, and what a decision costs."""
        whole = by_instant(predictions, self.rate_hz).iloc[-1]
        point = learned_point(predictions, {r.name: r.chosen["threshold"] for r in results}, self.rate_hz)
        found = {k: v for k, v in costs(results).items() if not k.startswith("threshold")}
        found |= {"decisions_per_second": 1000 / found["decide_ms_p95"]}
        found |= {"accuracy": whole["accuracy"], "accuracy_low": whole["low"], "accuracy_high": whole["high"]}
        found |= {"mean_ms": whole["mean_ms"], "adaptive_ms": point["mean_ms"]}
        found |= {f"adaptive_{k}": point[k] for k in ("accuracy", "low", "high")}
        found |= {f"accuracy_at_{ms}_ms": value for ms, value in _shown(predictions, self.rate_hz).items()}
        return {k: float(v) for k, v in found.items() if v == v}

    def write_tables(self, predictions: pd.DataFrame, results: list[FoldResult], folder: Path) -> None:
        """Every decision, accuracy against time and against threshold, and the figure of both."""
        predictions.to_parquet(folder / "predictions.parquet", index=False)
        tables = {
            "instants": by_instant(predictions, self.rate_hz),
            "stopping": by_threshold(predictions, self.rate_hz),
        }
        for name, table in tables.items():
            table.to_csv(folder / f"{name}.csv", index=False)
        point = learned_point(predictions, {r.name: r.chosen["threshold"] for r in results}, self.rate_hz)
        figure([self.tags | tables | {"start": self.start, "adaptive": point}], folder)


def _shown(predictions: pd.DataFrame, rate_hz: float) -> dict[int, float]:
    """Accuracy of the decisions that stand after a few round times, of those at which there are any."""
    found = {}
    for ms in SHOWN_MS:
        frames = int(ms * rate_hz / 1000 + 1e-6)
        if predictions["instant"].min() <= frames <= predictions["instant"].max():
            labelled = standing(predictions, frames)
            found[ms] = float((labelled["true"] == labelled["predicted"]).mean())
    return found


def _result_table() -> Table:
    table = Table(title="Accuracy in percent against touch seen; stopping learned on training subjects")
    for name in ("system", "data", "subset", "protocol", "start"):
        table.add_column(name)
    for name in (
        *(f"{ms} ms" for ms in SHOWN_MS),
        "whole",
        "mean ms",
        "stopped",
        "mean ms",
        "decision ms",
        "a second",
        "own hop ms",
    ):
        table.add_column(name, justify="right")
    table.add_column("folds", justify="right")
    return table


def _add_row(
    table: Table, cell: Cell, corpus: Corpus, replay: Replay, metrics: dict[str, float], good: int, folds: int
) -> None:
    def shown(name: str, scale: float = 1, digits: int = 0) -> str:
        return f"{scale * metrics[name]:.{digits}f}" if name in metrics else "-"

    table.add_row(
        escape(cell.system()),
        cell.data + ("*" if corpus.synthetic else ""),
        escape((cell.where or "all") + (f", {cell.target}" if cell.target != "gesture" else "")),
        escape(str(cell.protocol)),
        replay.start,
        *(shown(f"accuracy_at_{ms}_ms", 100, 1) for ms in SHOWN_MS),
        *(shown("accuracy", 100, 1), shown("mean_ms"), shown("adaptive_accuracy", 100, 1), shown("adaptive_ms")),
        " / ".join(shown(f"decide_ms_p{p}", digits=1) for p in (50, 95, 99)),
        shown("decisions_per_second"),
        shown("system_hop_ms"),
        f"{good}/{folds}",
    )
