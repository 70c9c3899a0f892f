"""The audit of a system: rules that a score does not show, each checked on generated captures.

A check is one function of a `Audited`. It returns a result and one sentence, or raises what the system raises, which is
a failure. The first fit and its predictions are shared by all checks.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
import pandas as pd
from joblib.externals.loky import ProcessPoolExecutor
from scipy.stats import binom
from sklearn.base import clone

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.errors import HiddenError, InputError, PredictionError
from bench.plan.cells import Cell
from bench.plan.plan import Fold, checked
from bench.work.fold import TOLERANCE, batch_effects, computing, disagreement
from bench.work.personal import met

PASSED, FAILED, SKIPPED = "passed", "failed", "not applicable"
EQUAL = 1e-6  # of a probability: two fits that should be the same
LEVEL = 0.999  # of the interval around chance
TRAINED = ("1", "2", "3")  # subjects; the other two are tested
Answer = tuple[str, str]  # a result and a sentence


@dataclass(frozen=True)
class Verdict:
    """The result of one check.

    Attributes:
        check: name of the check.
        result: verdict: passed, failed or not applicable.
        sentence: the reason.
        seconds: seconds of the clock.
    """

    check: str
    result: str
    sentence: str
    seconds: float


@cache
def captures() -> Corpus:
    """The captures that a system is audited on: 14 gestures of 5 subjects, once each."""
    return generate(5, variants=("normal",))


@cache
def probe() -> Corpus:
    """Captures of another subject, which no check trains on or changes."""
    return generate(1, variants=("normal",), repetitions=2, seed=1)


def with_conditions(corpus: Corpus, names: tuple[str, ...]) -> Corpus:
    """Captures with columns of two values, for conditions that a system declares and that these captures have not."""
    values = np.where(np.arange(len(corpus)) % 2, "a", "b")
    return corpus.changed(captures=corpus.captures.assign(**{n: values for n in names if n not in corpus.captures}))


class Audited:
    """The audited system, with values shared by several checks.

    Args:
        cell: names the system; its data and protocol are not looked at.
    """

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        conditions = contract.conditions(cell.estimator())
        self.corpus, self.probe = (with_conditions(corpus, conditions) for corpus in (captures(), probe()))
        trained = np.isin(self.corpus.subjects.astype(str), TRAINED)
        self.train, self.test = np.flatnonzero(trained), np.flatnonzero(~trained)

    def fitted(self, corpus: Corpus, train: np.ndarray | None = None) -> contract.System:
        """A new system that is fitted to a part of some captures, by default to all, as in a fold of a run."""
        train = np.arange(len(corpus)) if train is None else train
        part = corpus[train]
        contract.check_training(self.cell.estimator(), part, part.gestures)
        test = np.setdiff1d(np.arange(len(corpus)), train)
        return next(met(self.cell, corpus, Fold("audit", train, test))).estimator

    def refitted(self, corpus: Corpus, train: np.ndarray) -> pd.DataFrame:
        """Predictions of the probe captures by a new system that is fitted to a part of some captures."""
        return predicted(self.fitted(corpus, train), self.probe)

    @cached_property
    def first(self) -> contract.System:
        """The system, fitted to the training captures."""
        return self.fitted(self.corpus, self.train)

    @cached_property
    def expected(self) -> pd.DataFrame:
        """Its predictions of the probe captures."""
        return predicted(self.first, self.probe)

    @property
    def is_seeded(self) -> bool:
        """True if it declares random training by a parameter ``seed`` or ``random_state``."""
        params: dict[str, object] = getattr(self.cell.estimator(), "get_params", dict)()
        named = any(k.split("__")[-1] in ("seed", "random_state") and v is not None for k, v in params.items())
        return self.cell.seed is not None or (self.cell.has_objects and named)


def predicted(estimator: contract.System, corpus: Corpus) -> pd.DataFrame:
    """Mean probability over the decisions on each capture [captures, classes].

    Raises:
        PredictionError: a label is no class, or probabilities are none.
        ValueError: a capture has no decision.
    """
    table, proba = contract.decide(estimator, corpus)
    names = np.asarray(estimator.classes_).astype(str)
    mean = pd.DataFrame(np.asarray(proba, dtype=np.float64), columns=names).groupby(table["capture"].to_numpy()).mean()
    if len(mean) != len(corpus):
        raise ValueError(f"{len(corpus)} captures have {len(mean)} predictions")
    return mean


def difference(one: pd.DataFrame, other: pd.DataFrame) -> str:
    """The difference of two `predicted` tables of the same captures; empty if they agree."""
    if set(one) != set(other):
        return f"the classes differ: {len(one.columns)} and {len(other.columns)}"
    labels = int((one.idxmax(axis=1) != other.idxmax(axis=1)).sum())
    if labels:
        return f"{labels} of {len(one)} labels differ"
    most = float((one - other).abs().to_numpy().max())
    return f"labels are equal, probabilities differ by up to {most:.2g}" if most > EQUAL else ""


def passed_if(differs: str, sentence: str, reason: str) -> Answer:
    """Passed where two predictions do not differ."""
    return (FAILED, f"{reason}: {differs}") if differs else (PASSED, sentence)


# The checks


def fits(subject: Audited) -> Answer:
    """A fit to the training captures."""
    subject.first  # noqa: B018 - it may raise
    return PASSED, f"it fits {len(subject.train)} captures of {len(TRAINED)} subjects"


def no_labels(subject: Audited) -> Answer:
    """Predictions of captures without labels, subjects and origin."""
    with suppress(PredictionError):  # which the next check tells
        subject.expected  # noqa: B018 - it may raise
        contract.labels(subject.first, subject.probe)
    columns = contract.conditions(subject.first)
    declared = f"; it declares to need {', '.join(columns)}" if columns else ""
    return PASSED, f"it predicts without labels, subjects and origin{declared}"


def probabilities(subject: Audited) -> Answer:
    """Labels of the classes in training; probabilities from 0 to 1 with a sum of 1 that agree with them."""
    classes = np.unique(subject.corpus.gestures[subject.train].astype(str))
    if sorted(str(name) for name in subject.first.classes_) != classes.tolist():
        return FAILED, f"classes_ has {len(subject.first.classes_)} names, training had {len(classes)} classes"
    if words := disagreement(subject.first, subject.probe):  # it may raise
        return FAILED, words
    if not (contract.has_probabilities(subject.first) or contract.decides_often(subject.first)):
        return PASSED, "its labels are classes of its training captures; it has no probabilities"
    return PASSED, f"they are 0 or more, have a sum of 1 over {len(classes)} classes and agree with predict"


def single_capture(subject: Audited) -> Answer:
    """Predictions of a capture alone, in a batch, and in a batch in reverse order."""
    effects = batch_effects(subject.first, subject.corpus, subject.test)
    if effects:
        return FAILED, f"{len(effects)} of {len(subject.test)} predictions depend on the other captures: {effects[0]}"
    return PASSED, f"{len(subject.test)} captures alone are predicted as in a batch, within {TOLERANCE:g}"


def equal_seeds(subject: Audited) -> Answer:
    """Two fits to the same captures."""
    hint = "" if subject.is_seeded else "; give it a parameter seed"
    return passed_if(
        difference(subject.expected, subject.refitted(subject.corpus, subject.train)),
        "two fits to the same captures predict the same",
        f"two fits to the same captures differ{hint}",
    )


def training_order(subject: Audited) -> Answer:
    """A fit to the training captures in another order."""
    order = np.random.default_rng(0).permutation(subject.train)
    other = subject.refitted(subject.corpus, order)
    share = float((subject.expected.idxmax(axis=1) == other.idxmax(axis=1)).mean())
    if share < 1 and subject.is_seeded:
        return SKIPPED, f"training is random (seed); in another order {100 * share:.0f} % of the labels are equal"
    if share < 1:
        return FAILED, f"in another order of training captures {100 * share:.0f} % of the labels are equal"
    return PASSED, f"training captures in another order give the same {len(other)} labels"


def shuffled_labels(subject: Audited) -> Answer:
    """Accuracy on test subjects after training on shuffled labels."""
    corpus, rng = subject.corpus, np.random.default_rng(0)
    names = corpus.gestures.copy()
    for name in TRAINED:  # within a subject, so that every class stays in every inner fold
        rows = np.flatnonzero(corpus.subjects.astype(str) == name)
        names[rows] = rng.permutation(names[rows])
    shuffled = corpus.changed(captures=corpus.captures.assign(gesture=names))
    tested = corpus[subject.test]
    hits, usual = (
        int((predicted(one, tested).idxmax(axis=1).to_numpy() == tested.gestures).sum())
        for one in (subject.fitted(shuffled, subject.train), subject.first)
    )
    most = int(binom.interval(LEVEL, len(tested), 1 / len(set(tested.gestures)))[1])
    return FAILED if hits > most else PASSED, (
        f"after training on shuffled labels {hits} of {len(tested)} test captures are correct, on true ones {usual}; "
        f"chance gives 0 to {most} ({100 * LEVEL:g} % interval)"
    )


def clones(subject: Audited) -> Answer:
    """scikit-learn's ``clone``, ``get_params`` and ``set_params``."""
    estimator: Any = subject.cell.estimator()
    if not hasattr(estimator, "get_params"):
        return SKIPPED, "it has no get_params, so scikit-learn cannot copy it"
    params = shown(estimator)
    if shown(clone(estimator)) != params:  # which itself raises where a constructor changes an argument
        return FAILED, "clone() gives other parameters"
    if shown(estimator.set_params(**estimator.get_params(deep=False))) != params:
        return FAILED, "set_params() with the values of get_params() changes parameters"
    if "first" in vars(subject) and shown(subject.first) != params:
        return FAILED, "fit() changes parameters; keep learned values in attributes that end in _"
    count = len(estimator.get_params())
    return PASSED, f"clone, get_params and set_params keep {count} parameter{'s' * (count != 1)}"


def shown(estimator: contract.System) -> str:
    """Parameters in full, without addresses in memory."""
    return re.sub(r" at 0x[0-9a-f]+", "", contract.settings(estimator))


def unseen(cell: Cell) -> pd.DataFrame:
    """Predictions of the test captures by a system that is fitted to the training captures, in a new process."""
    subject = Audited(cell)
    with computing(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return predicted(subject.first, subject.corpus[subject.test])


def no_state(subject: Audited) -> Answer:
    """A fit after fits to other classes and to the test captures, against a first fit.

    What a class or a module keeps of a fit, a new object has, too; a new process has it not.
    """
    estimator = subject.cell.estimator()
    part, names = subject.corpus[subject.train], np.unique(subject.corpus.gestures.astype(str))
    few = part[np.isin(part.gestures.astype(str), names[::3])]
    for training in (few, part):
        estimator.fit(training, training.gestures)
    if differs := difference(subject.expected, predicted(estimator, subject.probe)):
        return FAILED, f"a fit depends on the fit before it: {differs}"
    with ProcessPoolExecutor(1) as process:
        expected = process.submit(unseen, subject.cell).result()
    subject.fitted(subject.corpus)
    now = predicted(subject.fitted(subject.corpus, subject.train), subject.corpus[subject.test])
    return passed_if(
        difference(expected, now),
        "a fit after others, also to the test captures, predicts as a first fit in a new process",
        "a fit remembers captures of fits before it, in its class or module",
    )


def other_test_captures(subject: Audited) -> Answer:
    """A fit in a fold whose test captures have other values and labels."""
    corpus, test, rng = subject.corpus, subject.test, np.random.default_rng(0)
    frames, names = corpus.frames.copy(), corpus.gestures.copy()
    for start, length in zip(corpus.starts[test], corpus.lengths[test], strict=True):
        values = rng.integers(0, int(corpus.full_scale) + 1, (length, *corpus.grid))
        frames[start : start + length] = values.astype(frames.dtype)
    names[test] = rng.permutation(names[test])
    other = corpus.changed(frames=frames, captures=corpus.captures.assign(gesture=names))
    return passed_if(
        difference(subject.expected, subject.refitted(other, subject.train)),
        "other values and labels of test captures change no prediction",
        "other values and labels of test captures change what is learned",
    )


def other_skin(subject: Audited) -> Answer:
    """A fit to captures of 5x3 taxels at 54 Hz."""
    corpus = generate(3, variants=("normal",), rows=5, cols=3, rate_hz=54.0)
    corpus = with_conditions(corpus, contract.conditions(subject.cell.estimator()))
    predicted(subject.fitted(corpus), corpus)
    return PASSED, f"it fits and predicts {len(corpus)} captures of 5x3 taxels at 54 Hz"


def one_frame(subject: Audited) -> Answer:
    """A fit in which some captures have one frame, and predictions of captures of one frame."""
    corpus = subject.corpus[subject.train]
    lengths = np.where(np.arange(len(corpus)) % 5 == 0, 1, corpus.lengths)
    estimator = subject.fitted(corpus.changed(lengths=lengths))
    predicted(estimator, subject.probe.changed(lengths=np.ones(len(subject.probe), dtype=np.int64)))
    count = int((lengths == 1).sum())
    return PASSED, f"it fits with {count} captures of one frame and predicts {len(subject.probe)} of them"


def saved(subject: Audited) -> Answer:
    """A system that is pickled and loaded as ``bench fit`` and ``bench predict`` do."""
    if columns := contract.conditions(subject.first):
        return SKIPPED, f"it needs {', '.join(columns)} to predict, which a saved model does not get"

    import cloudpickle

    from bench.work.saved import Recogniser, by_value

    by_value()
    recogniser = Recogniser(subject.first, subject.corpus[subject.train])
    content = cloudpickle.dumps(recogniser)
    labels = [one.label(subject.probe) for one in (recogniser, cloudpickle.loads(content))]
    return passed_if(
        difference(*(table.drop(columns=["label", "confidence"]) for table in labels)),
        f"saved ({len(content) / 1000:,.0f} kB) and loaded, it predicts the same",
        "saved and loaded, it gives other predictions",
    )


@dataclass(frozen=True)
class Check:
    """A rule with its test.

    Attributes:
        name: name in the table.
        answer: the function that checks it.
        needs: the check without which this one is not applicable; empty for none.
    """

    name: str
    answer: Callable[[Audited], Answer]
    needs: str = "labels and probabilities"


CHECKS = (
    Check("fit", fits, ""),
    Check("no labels needed", no_labels, "fit"),
    Check("labels and probabilities", probabilities, "no labels needed"),
    Check("single capture", single_capture),
    Check("equal seeds", equal_seeds),
    Check("training order", training_order, "equal seeds"),
    Check("shuffled labels", shuffled_labels),
    Check("clone and parameters", clones, ""),
    Check("no state between fits", no_state, "equal seeds"),
    Check("test captures", other_test_captures, "equal seeds"),
    Check("another grid and rate", other_skin),
    Check("one-frame captures", one_frame),
    Check("saved and loaded", saved),
)


def audited(cell: Cell) -> list[Verdict]:
    """Every check of one system, in the order of `CHECKS`.

    Args:
        cell: names the system; its data and protocol are not looked at.

    Returns:
        One verdict per check.
    """
    subject = Audited(cell)
    verdicts: list[Verdict] = []
    with computing(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for check in CHECKS:
            began = time.perf_counter()
            result, sentence = _answer(check, subject, verdicts)
            verdicts.append(Verdict(check.name, result, sentence, time.perf_counter() - began))
    return verdicts


def refuse(cell: Cell) -> None:
    """Refuse a system before its audit.

    Raises:
        InputError: it cannot be made, or declares conditions that a prediction must not use.
    """
    try:
        system = checked(cell)
        contract.check_conditions(system, with_conditions(captures(), contract.conditions(system)))
    except InputError:
        raise
    except Exception as e:  # a constructor of the user's may raise anything
        raise InputError(f"model={cell.model.short}: it cannot be made: {last_line(e)}") from e


def _answer(check: Check, subject: Audited, before: list[Verdict]) -> Answer:
    """The answer of one check; not applicable where the check that it needs has not passed."""
    if check.needs in {verdict.check for verdict in before if verdict.result != PASSED}:
        return SKIPPED, f"not checked, as {check.needs!r} has not passed"
    try:
        return check.answer(subject)
    except InputError as e:
        return SKIPPED if before else FAILED, f"the system refuses these captures: {e}"
    except HiddenError as e:  # its message names the attribute
        return FAILED, str(e)
    except Exception as e:  # a system of the user's may raise anything
        return FAILED, last_line(e)


def last_line(error: Exception) -> str:
    """The type of an exception and the last line of its message."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[-1]}" if lines else type(error).__name__
