"""The system that is shipped: trained on all captures, saved as an MLflow model."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import contract
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
    measure_footprint,
    measure_latency,
    reset_peak_memory,
)
from bench.running.replay import Stopping, learn_stopping_rule, why_unlearnable
from bench.running.results import FoldResult, combine_costs
from bench.running.tracking import identity_tags, run_params
from bench.running.workers import fill_cache
from bench.store.client import connect, report_store_errors
from bench.store.database import lock_run, store_uri

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.running.saved import Recogniser

EXAMPLE_FRAMES = 3


@dataclass(frozen=True)
class Fitted:
    """A system that was trained on all captures."""

    cell: Cell
    recogniser: Recogniser  # the fitted system with the required format of its frames
    uri: str  # of the saved model in the store
    run_id: str
    captures: int  # of gestures; a stream's background is not among them
    told: str = ""  # sentence on what else is saved

    def __str__(self) -> str:
        kind = "synthetic " if self.recogniser.synthetic else ""
        return (
            f"{self.uri}  {self.cell.system_name()}, {self.captures} {kind}captures of {self.cell.data}, "
            f"run runs:/{self.run_id}/model"
        )

    __repr__ = __str__


def fit(cell: Cell, out: Path | None = None, stopping: bool = True, learner: Any = None) -> Fitted:
    """Train on all captures of a cell, and save in the store, and in a folder where one is given.

    With ``stopping``, three more fits that leave subjects out teach the calibration and the stopping rule. ``learner``
    learns what else is saved with the system, as an added key of ``bench fit`` asks.
    """
    if out is not None:
        check_empty_folder(out)
    check_system(cell)
    estimator, corpus = (
        cell.estimator(),
        captures_of_cell(cell) if learner is None else learner.captures(cell),
    )
    if conditions := contract.required_conditions(estimator):
        raise InputError(
            f"model={cell.model}: it predicts with {', '.join(conditions)}, which a saved model does not get; "
            "remove its conditions, or evaluate it with bench run"
        )
    contract.check_training(estimator, corpus, corpus.gestures)
    store, threads = connect(writes=True), usable_cores()
    plan = Plan(cell, corpus, (), 1, threads)
    reset_peak_memory()
    fill_cache(plan.cell, plan.corpus)
    with console.status(f"training {cell.system_name()}"):
        with limit_threads(threads):
            learned_stopping = _stopping(cell, corpus) if stopping else None
            metrics = fit_timed(estimator, corpus)
            more = None if learner is None else _more(learner, cell, estimator, corpus)
    with limit_threads(1):
        milliseconds = measure_latency(estimator, corpus, int(corpus.lengths.max()))[:2]
    metrics = combine_costs(
        [FoldResult("", None, metrics | measure_footprint(estimator, corpus), *milliseconds)]
    )

    import mlflow

    from bench.running.saved import Recogniser, copy_own_code, pickle_user_code, silence_mlflow

    recogniser = Recogniser(estimator, corpus, learned_stopping, more)
    plugins = [part.name for part in (cell.model, cell.features) if part]
    model = recogniser.mlflow_arguments(plugins, corpus[0][:EXAMPLE_FRAMES], cell.model.packages())
    pickle_user_code()
    how = f" {learner.params}" if learner else ""
    key = hashlib.sha256(f"{plan.key} fit{how}".encode()).hexdigest()[:20]
    tags = identity_tags(plan) | {"touchbench.kind": "fit", "touchbench.cell": key}
    with lock_run(key):
        for cut_off in store.search_runs(
            f"tags.`touchbench.cell` = '{key}' and attributes.status = 'RUNNING'"
        ):
            store.delete_run(cut_off.info.run_id)
        params = run_params(plan) | this_machine()._asdict() | {"captures": len(corpus)}
        params |= {} if more is None else learner.params
        run_id = store.create_run(
            f"fit {cell.system_name()} | {cell.data} | all captures", tags, params
        ).info.run_id
        store.log_values(run_id, metrics)
        mlflow.set_tracking_uri(store_uri())
        with (
            copy_own_code() as code,
            silence_mlflow(),
            report_store_errors(),
            mlflow.start_run(run_id=run_id),
        ):
            model["code_paths"] = [code]
            saved = mlflow.pyfunc.log_model(name="model", **model)
            if (
                out is not None
            ):  # last, so that what is killed before can be repeated: the folder is not there yet
                with fill_then_rename(out) as beside:
                    mlflow.pyfunc.save_model(str(beside), **model)
    gestures = int((~np.isin(corpus.gestures, corpus.info.get(ASIDE, []))).sum())
    return Fitted(
        cell,
        recogniser,
        saved.model_uri,
        run_id,
        gestures,
        "" if more is None else learner.sentence,
    )


def _more(learner: Any, cell: Cell, estimator: contract.System, corpus: Corpus) -> Any:
    """What else is saved with the system; None, with a warning, where the captures cannot teach it."""
    try:
        if len(set(corpus.subjects)) < 2:
            raise InputError("only one subject trains")
        for line in learner.warnings(corpus):
            warn(f"warning: {line}")
        return learner.learned(cell.estimator, estimator, corpus)
    except InputError as e:
        warn(f"warning: the model {learner.without}: {e}")
        return None


def _stopping(cell: Cell, corpus: Corpus) -> Stopping | None:
    """How sure the system of a cell may be, and when it can decide; None where its captures cannot teach it."""
    try:
        why = why_unlearnable(cell.untrained_system, corpus)
    except InputError as e:
        why = str(e)
    if why:
        warn(f"warning: the model has no calibration and no stopping threshold: {why}")
        return None
    return learn_stopping_rule(cell.estimator, corpus, np.arange(len(corpus)))[0]
