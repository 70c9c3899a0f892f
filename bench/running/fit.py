"""Fits the system that is shipped, to all captures, and saves it as an MLflow model."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.library import ASIDE
from bench.errors import InputError
from bench.ground.machine import this_machine
from bench.ground.progress import console, warn
from bench.ground.scratch import check_empty_folder, fill_then_rename
from bench.plan.cells import Cell
from bench.plan.plan import Plan, captures_of_cell, check_system, usable_cores
from bench.running.fold import (
    fit_timed,
    limit_threads,
    measure_latency,
    memory_metrics,
    reset_peak_memory,
)
from bench.running.replay import Stopping, learn_stopping_rule, why_unlearnable
from bench.running.results import FoldResult, combine_costs
from bench.running.tracking import identity_tags, run_params
from bench.running.workers import fill_cache
from bench.store.client import connect, report_store_errors, use_tracking_uri
from bench.store.database import lock_run

if TYPE_CHECKING:
    from bench.running.saved import Recogniser

EXAMPLE_FRAMES = 3


@dataclass(frozen=True)
class Fitted:
    """A saved system that was fitted to all captures."""

    cell: Cell
    recogniser: Recogniser  # the fitted system with the required format of its frames
    uri: str  # of the saved model in the store
    run_id: str
    captures: int  # of gestures; a stream's background is not among them
    note: str = ""  # sentence on what else is saved

    def __str__(self) -> str:
        kind = "synthetic " if self.recogniser.synthetic else ""
        return (
            f"{self.uri}  {self.cell.system_name()}, {self.captures} {kind}captures of "
            f"{self.cell.data}, run runs:/{self.run_id}/model"
        )

    __repr__ = __str__


def fit(cell: Cell, out: Path | None = None, stopping: bool = True, learner: Any = None) -> Fitted:
    """Fit a system to all captures of a cell, and save it in the store.

    Args:
        cell: the system and its captures.
        out: a new folder to save it in, too.
        stopping: with three more fits, learn calibration and stopping rule on left-out subjects.
        learner: learns what else is saved, as an added key of ``bench fit`` asks.

    Raises:
        InputError: the system needs conditions, or cannot learn from the captures.
    """
    import mlflow

    from bench.running.saved import (
        Recogniser,
        copy_own_code,
        log_model,
        pickle_user_code,
        save_model,
        silence_mlflow,
    )

    if out is not None:
        check_empty_folder(out)
    check_system(cell)
    system = cell.estimator()
    corpus = learner.load_captures(cell) if learner else captures_of_cell(cell)
    if cell.design:
        corpus = cell.design.fit_range(corpus, np.arange(len(corpus)))
    if conditions := contract.required_conditions(system):
        raise InputError(
            f"model={cell.model}: it predicts with {', '.join(conditions)}, which a saved model "
            "does not get; remove its conditions, or evaluate it with bench run"
        )
    contract.check_training(system, corpus, corpus.gestures)
    store, threads = connect(writes=True), usable_cores()
    plan = Plan(cell, corpus, (), 1, threads)
    reset_peak_memory()
    fill_cache(cell, corpus)
    with console.status(f"training {cell.system_name()}"), limit_threads(threads):
        rule = _learn_stopping(cell, corpus) if stopping else None
        metrics = fit_timed(system, corpus)
        watcher = _learn_more(learner, cell, system, corpus) if learner else None
    with limit_threads(1):
        times, _ = measure_latency(system, corpus, int(corpus.lengths.max()))
    times = {name: times[name] for name in ("predict_ms", "decide_ms")}
    metrics |= memory_metrics(system, corpus)
    metrics = combine_costs([FoldResult("", metrics=metrics, times=times)])
    recogniser = Recogniser(system, corpus, rule, watcher)
    plugins = [part.name for part in (cell.model, cell.features) if part]
    model = recogniser.mlflow_arguments(plugins, corpus[0][:EXAMPLE_FRAMES], cell.model.packages())
    pickle_user_code()
    identity = f"{plan.key} fit" + (f" {learner.params}" if learner else "")
    key = hashlib.sha256(identity.encode()).hexdigest()[:20]
    tags = identity_tags(plan) | {"touchbench.kind": "fit", "touchbench.cell": key}
    params = run_params(plan) | this_machine()._asdict() | {"captures": len(corpus)}
    params |= {} if watcher is None else learner.params
    with lock_run(key):
        condition = f"tags.`touchbench.cell` = '{key}' and attributes.status = 'RUNNING'"
        for run in store.search_runs(condition):  # that were cut off
            store.delete_run(run.info.run_id)
        name = f"fit {cell.system_name()} | {cell.data} | all captures"
        run_id = store.create_run(name, tags, params).info.run_id
        store.log_values(run_id, metrics)
        with (
            use_tracking_uri(),
            copy_own_code() as code,
            silence_mlflow(),
            report_store_errors(),
            mlflow.start_run(run_id=run_id),
        ):
            model["code_paths"] = [code]
            saved = log_model(model)
            if out is not None:  # last: if this is killed before, the command can be repeated
                with fill_then_rename(out) as folder:
                    save_model(folder, model)
    gestures = int((~np.isin(corpus.gestures, corpus.info.get(ASIDE, []))).sum())
    note = "" if watcher is None else learner.note
    return Fitted(cell, recogniser, saved.model_uri, run_id, gestures, note)


def _learn_more(learner: Any, cell: Cell, system: contract.System, corpus: Corpus) -> Any:
    """Learn what else is saved; None, with a warning, if the captures cannot teach it."""
    try:
        if len(set(corpus.subjects)) < 2:
            raise InputError("only one subject trains")
        for line in learner.warnings_of_captures(corpus):
            warn(f"warning: {line}")
        return learner.learn_watcher(cell.estimator, system, corpus)
    except InputError as e:
        warn(f"warning: the model {learner.inability}: {e}")
        return None


def _learn_stopping(cell: Cell, corpus: Corpus) -> Stopping | None:
    """Learn calibration and stopping rule; None, with a warning, if captures cannot teach it."""
    try:
        reason = why_unlearnable(cell.untrained_system, corpus)
    except InputError as e:
        reason = str(e)
    if reason:
        warn(f"warning: the model has no calibration and no stopping threshold: {reason}")
        return None
    return learn_stopping_rule(cell.estimator, corpus, np.arange(len(corpus)))[0]
