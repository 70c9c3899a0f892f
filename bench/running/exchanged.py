"""The audit on a corpus with exchanged labels and people, in a data folder of its own.

From such labels a system that learns from its training captures alone learns nothing. One that
reads the files of the corpus is better than chance on them, or its predictions change with files of
captures that it was not given. One that has a copy elsewhere predicts the true labels.
"""

from __future__ import annotations

import tempfile
import warnings
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from joblib.externals.loky import ProcessPoolExecutor
from scipy.stats import binom
from sklearn.model_selection import KFold

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.folder import content_digest, write_folder
from bench.corpora.library import imported_names, open_corpus
from bench.errors import InputError, suggest_names
from bench.ground.closed import close_corpora
from bench.plan.cells import Cell
from bench.running.audit import (
    LEVEL,
    Check,
    CheckResult,
    Mistake,
    SkippedCheck,
    describe_difference,
    mean_probabilities,
    run_checks,
)
from bench.running.fold import limit_threads, take_evenly

MOST_CAPTURES = 420  # of the corpus that are used, so that an audit stays short
FOLDS = 3
FEWEST_CLASSES = 3  # with two, a label that is not the true one would tell the true one


class ExchangedFolds(NamedTuple):
    """Predictions of a system on captures with exchanged labels."""

    labels: np.ndarray  # of each capture, predicted in the fold that tests it
    first: pd.DataFrame  # probabilities of the test captures of the first fold


class AuditedCorpus:
    """A corpus with exchanged labels and people, and what a system predicts on it."""

    def __init__(self, cell: Cell) -> None:
        if cell.data not in imported_names():
            advice = suggest_names(cell.data, imported_names())
            raise InputError(f"data={cell.data}: give one imported corpus; {advice}")
        whole = open_corpus(cell.data, {})
        self.cell, self.true = cell, whole[take_evenly(np.arange(len(whole)), MOST_CAPTURES)]
        self.exchanged = exchange_labels(self.true)

    @cached_property
    def folds(self) -> ExchangedFolds:
        """Predictions of the system."""
        return self.predict(self.exchanged)

    def predict(self, stored: Corpus) -> ExchangedFolds:
        """Fit and predict in a new process, in whose data folder a corpus has the name."""
        with tempfile.TemporaryDirectory() as home:
            digest = content_digest(stored)
            folder = Path(home) / "corpora" / stored.name
            write_folder(stored, folder / digest[:16], digest)
            (folder / "current").write_text(digest[:16])
            with ProcessPoolExecutor(1, env={"TOUCHBENCH_HOME": home}) as process:
                return process.submit(predict_folds, self.cell, self.exchanged).result()


def exchange_labels(corpus: Corpus) -> Corpus:
    """Give each capture another class, each with the same probability, and somebody's subject."""
    rng, gestures = np.random.default_rng(0), corpus.gestures
    labels = gestures.copy()
    for name in (names := np.unique(gestures)):
        rows = np.flatnonzero(gestures == name)
        others = rng.permutation(names[names != name])
        labels[rows] = rng.permutation(np.resize(others, len(rows)))
    captures = corpus.captures.assign(gesture=labels, subject=rng.permutation(corpus.subjects))
    return corpus.detach().with_fields(captures=captures)


def change_test_captures(corpus: Corpus) -> Corpus:
    """The same captures, with noise and other labels in those that the first fold tests."""
    rng, (_, test) = np.random.default_rng(0), split_captures(corpus)[0]
    frames, labels = corpus.frames.copy(), corpus.gestures.copy()
    for start, length in zip(corpus.starts[test], corpus.lengths[test], strict=True):
        values = rng.integers(0, int(corpus.full_scale) + 1, (length, *corpus.grid))
        frames[start : start + length] = values.astype(frames.dtype)
    labels[test] = rng.permutation(labels[test])
    return corpus.with_fields(frames=frames, captures=corpus.captures.assign(gesture=labels))


def split_captures(corpus: Corpus) -> list[tuple[np.ndarray, np.ndarray]]:
    """Positions of training and test captures of each fold."""
    return [*KFold(FOLDS, shuffle=True, random_state=0).split(np.arange(len(corpus)))]


def predict_folds(cell: Cell, tested: Corpus) -> ExchangedFolds:
    """Fit each fold of the stored corpus, and predict its test captures from memory."""
    corpus, probabilities = open_corpus(cell.data, {}), []
    labels = np.empty(len(tested), dtype=object)
    with close_corpora(), limit_threads(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for train, test in split_captures(corpus):
            part = corpus[train]
            system = contract.fit_system(cell.estimator(), part, part.gestures)
            probabilities.append(mean_probabilities(system, tested[test]))
            labels[test] = probabilities[-1].idxmax(axis=1)
    return ExchangedFolds(labels, probabilities[0])


def check_exchanged_labels(audited: AuditedCorpus) -> str:
    """Train on exchanged labels, which leaves chance, for them and for the true ones."""
    true, exchanged = audited.true.gestures, audited.exchanged.gestures
    count, classes = len(true), len(set(true))
    if classes < FEWEST_CLASSES:
        raise SkippedCheck(f"{audited.cell.data} has only {classes} classes")
    labels = audited.folds.labels
    most = int(binom.interval(LEVEL, count, 1 / (classes - 1))[1])
    of_exchanged, of_true = int((labels == exchanged).sum()), int((labels == true).sum())
    sentence = (
        f"trained on exchanged labels of {count} captures, it predicts {of_exchanged} of these "
        f"labels and {of_true} of the true ones; chance gives at most {most}"
    )
    if max(of_exchanged, of_true) > most:
        raise Mistake(f"it knows captures that it was not given: {sentence}")
    return sentence


def check_files(audited: AuditedCorpus) -> str:
    """Change the captures in the files that a fold does not train on."""
    folds = audited.predict(change_test_captures(audited.exchanged))
    changed = "other test captures in the files of the corpus change"
    if difference := describe_difference(audited.folds.first, folds.first):
        raise Mistake(f"{changed} what is learned: {difference}")
    return f"{changed} no prediction"


CHECKS: dict[str, Check] = {
    "exchanged labels": (check_exchanged_labels, "labels and probabilities"),
    "files of the corpus": (check_files, "equal seeds"),
}


def audit_corpus(audited: AuditedCorpus, earlier: list[CheckResult]) -> list[CheckResult]:
    """Run the checks on a corpus, after those on generated captures."""
    return run_checks(audited, CHECKS, earlier)
