"""One fold under stress, in a worker process: fitted once on clean captures, tested under every fault and severity.

The table of a fold has one row per tested capture and circumstance: ``fold``, ``capture``, ``length`` (frames, clean),
``fault`` (``none`` for clean captures), ``severity`` (0 to 5), ``amount`` (what that is in the fault's unit),
``train_subjects`` (how many subjects the system was fitted on), ``true``, ``predicted``, ``p_true`` (probability of the
true class), and the columns of the corpus's captures (``subject`` and conditions).
"""

from __future__ import annotations

import hashlib
import time
import traceback
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench import scores
from bench.corpus import Corpus
from bench.faults import SEVERITIES, Fault, as_shares, damaged
from bench.fold import FoldResult, decisions, torch_threads

if TYPE_CHECKING:
    from bench.cells import Cell

CLEAN = "none"
ADDED = ("length", "fault", "severity", "amount", "train_subjects", "predicted", "p_true")
COLUMNS = ("fold", "capture", "true", *ADDED)


def stress_fold(
    cell: Cell, corpus: Corpus, name: str, train: np.ndarray, test: np.ndarray, threads: int,
    faults: tuple[Fault, ...] = (), fewer: tuple[int, ...] = (),
) -> FoldResult:  # fmt: skip
    """Fit on the clean training captures and decide on the test captures as they are and under every fault.

    Args:
        cell: what is fitted.
        corpus: all captures.
        name: of the fold.
        train: positions of the training captures.
        test: positions of the test captures.
        threads: that computing may use.
        faults: what the test captures go through, each at every severity.
        fewer: numbers of training subjects on which the system is fitted again, and meets the clean test captures.

    Returns:
        The fold's table, and the seconds of the first fit, the faults and further fits; an exception becomes ``error``.
    """
    try:
        estimator = cell.estimator()
        with threadpool_limits(threads):
            torch_threads(threads)
            started = time.perf_counter()
            estimator.fit(corpus[train], corpus.gestures[train])
            fitted, cpu = time.perf_counter(), time.process_time()
            subjects = len(set(corpus.subjects[train]))
            about = {"length": corpus.lengths[test], "train_subjects": subjects}
            clean = {"fault": CLEAN, "severity": 0, "amount": ""}
            parts = [labelled(estimator, corpus, name, test, about | clean)]
            shares = as_shares(corpus, test)
            for fault in faults:
                for severity in range(1, SEVERITIES + 1):
                    worse = damaged(corpus, test, shares, fault, severity)
                    how = {"fault": fault.name, "severity": severity, "amount": fault.describe(severity)}
                    parts.append(labelled(estimator, worse, name, test, about | how))
            tested, cpu = time.perf_counter(), time.process_time() - cpu
            for count in fewer:
                part = subset(corpus, train, test, count, seed_of(cell))
                estimator = cell.estimator().fit(corpus[part], corpus.gestures[part])
                parts.append(labelled(estimator, corpus, name, test, about | clean | {"train_subjects": count}))
    except Exception:  # whatever a system raises is this fold's result, not the end of the command
        return FoldResult(name, error=traceback.format_exc())
    metrics = {
        "fit_seconds": fitted - started,
        "fault_seconds": tested - fitted,
        "fault_cpu_seconds": cpu,
        "refit_seconds": time.perf_counter() - tested,
    }
    return FoldResult(name, pd.concat(parts, ignore_index=True), metrics)


def labelled(estimator: object, corpus: Corpus, fold: str, test: np.ndarray, about: dict[str, object]) -> pd.DataFrame:
    """One row per test capture with the label that ``bench run`` would give it."""
    predictions = decisions(estimator, corpus, fold, test)
    proba = [scores.PREFIX + c for c in scores.classes_of(predictions)]
    mean = predictions.groupby(["fold", "capture"], sort=False)[proba].mean().to_numpy()
    rows = scores.captures(predictions).drop(columns=["start", "frames"])
    p_true = mean[np.arange(len(rows)), pd.Index(proba).get_indexer(scores.PREFIX + rows["true"].astype(str))]
    return rows.assign(p_true=p_true, **about)


def subset(corpus: Corpus, train: np.ndarray, test: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Positions of the training captures of ``count`` training subjects.

    The subjects come in one random order per seed and test subjects, so that fewer are among more, and every system
    learns from the same ones.
    """
    subjects = sorted(set(corpus.subjects[train]))
    drawn = hashlib.sha256(repr((seed, sorted(set(corpus.subjects[test])))).encode()).digest()
    order = np.random.default_rng(int.from_bytes(drawn[:16], "little")).permutation(len(subjects))
    return train[np.isin(corpus.subjects[train], [subjects[i] for i in order[:count]])]


def seed_of(cell: Cell) -> int:
    """The seed of a cell, 0 for a system that has none."""
    return int((cell.tuning or cell.model.parameters).get("seed", 0))
