"""The audit of a system: rules that a score does not show, each checked on generated captures.

A check is one function of a `Audited` with `@check`. It gives the sentence of a system that keeps the rule, or raises:
`Mistake`, `Skipped`, or what the system raises, which is a failure.
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
from bench.plan import objects
from bench.plan.cells import Cell
from bench.plan.plan import check_system
from bench.running.fold import TOLERANCE, describe_disagreement, find_batch_effects, limit_threads

PASSED, FAILED, SKIPPED = "passed", "failed", "not applicable"
EQUAL = 1e-6  # of a probability: two fits that should be the same
LEVEL = 0.999  # of the interval around chance
TRAINED = ("1", "2", "3")  # subjects; the other two are tested


class Mistake(Exception):
    """A rule that a system does not keep, in a sentence."""


class Skipped(Exception):
    """The reason why a rule does not apply to a system."""


@dataclass(frozen=True)
class CheckResult:
    """The result of one check: passed, failed or not applicable, and why."""

    check: str
    result: str
    sentence: str
    seconds: float


@dataclass(frozen=True)
class Check:
    """A rule: its name in the table, its function, and the check without which it is not applicable, if any."""

    name: str
    answer: Callable[[Audited], str]
    needs: str


CHECKS: list[Check] = []


def check(name: str, needs: str = "labels and probabilities") -> Callable:
    """Add a function to the checks, in the order of the table."""
    return lambda answer: CHECKS.append(Check(name, answer, needs))


@cache
def audit_captures() -> Corpus:
    """The captures that a system is audited on: 14 gestures of 5 subjects, once each."""
    return generate(5, variants=("normal",))


@cache
def probe_captures() -> Corpus:
    """Captures of another subject, which no check trains on or changes."""
    return generate(1, variants=("normal",), repetitions=2, seed=1)


def with_conditions(corpus: Corpus, names: tuple[str, ...]) -> Corpus:
    """Captures with columns of two values, for conditions that a system declares and that these captures have not."""
    values = np.where(np.arange(len(corpus)) % 2, "a", "b")
    return corpus.with_fields(
        captures=corpus.captures.assign(**{n: values for n in names if n not in corpus.captures})
    )


class Audited:
    """The audited system, with the captures that it is audited on, its first fit and the predictions of this."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        conditions = contract.required_conditions(cell.estimator())
        self.corpus, self.probe = (
            with_conditions(corpus, conditions) for corpus in (audit_captures(), probe_captures())
        )
        trained = np.isin(self.corpus.subjects.astype(str), TRAINED)
        self.train, self.test = np.flatnonzero(trained), np.flatnonzero(~trained)

    def fit_new(self, part: Corpus) -> contract.System:
        """A new system that is fitted to some captures."""
        contract.check_training(self.cell.estimator(), part, part.gestures)
        return self.cell.estimator().fit(part, part.gestures)

    @cached_property
    def first(self) -> contract.System:
        """The system, fitted to the training captures."""
        return self.fit_new(self.corpus[self.train])

    @cached_property
    def expected(self) -> pd.DataFrame:
        """Its predictions of the probe captures."""
        return mean_probabilities(self.first, self.probe)

    def require_equal(self, estimator: contract.System, mistake: str) -> None:
        """Verify that another system predicts the probe captures as the first."""
        if differs := describe_difference(self.expected, mean_probabilities(estimator, self.probe)):
            raise Mistake(f"{mistake}: {differs}")

    @property
    def is_seeded(self) -> bool:
        """True if it declares random training by a parameter ``seed`` or ``random_state``."""
        params: dict[str, object] = getattr(self.cell.estimator(), "get_params", dict)()
        named = any(
            k.split("__")[-1] in ("seed", "random_state") and v is not None
            for k, v in params.items()
        )
        return self.cell.seed is not None or (bool(self.cell.objects) and named)


def mean_probabilities(estimator: contract.System, corpus: Corpus) -> pd.DataFrame:
    """Mean probability over the decisions on each capture [captures, classes]."""
    table, proba = contract.predict_decisions(estimator, corpus)
    names = np.asarray(estimator.classes_).astype(str)
    mean = (
        pd.DataFrame(np.asarray(proba, dtype=np.float64), columns=names)
        .groupby(table["capture"].to_numpy())
        .mean()
    )
    if len(mean) != len(corpus):
        raise ValueError(f"{len(corpus)} captures have {len(mean)} predictions")
    return mean


def describe_difference(one: pd.DataFrame, other: pd.DataFrame) -> str:
    """The difference of two `mean_probabilities` tables of the same captures; empty if they agree."""
    if set(one) != set(other):
        return f"the classes differ: {len(one.columns)} and {len(other.columns)}"
    if labels := int((one.idxmax(axis=1) != other.idxmax(axis=1)).sum()):
        return f"{labels} of {len(one)} labels differ"
    most = float((one - other).abs().to_numpy().max())
    return f"labels are equal, probabilities differ by up to {most:.2g}" if most > EQUAL else ""


@check("fit", "")
def _(subject: Audited) -> str:
    subject.first  # noqa: B018 - it may raise
    return f"it fits {len(subject.train)} captures of {len(TRAINED)} subjects"


@check("no labels needed", "fit")
def _(subject: Audited) -> str:
    with suppress(PredictionError):  # which the next check tells
        subject.expected  # noqa: B018 - it may raise
        contract.predict_labels(subject.first, subject.probe)
    columns = contract.required_conditions(subject.first)
    declared = f"; it declares to need {', '.join(columns)}" if columns else ""
    return f"it predicts without labels, subjects and origin{declared}"


@check("labels and probabilities", "no labels needed")
def _(subject: Audited) -> str:
    classes = np.unique(subject.corpus.gestures[subject.train].astype(str))
    if sorted(str(name) for name in subject.first.classes_) != classes.tolist():
        raise Mistake(
            f"classes_ has {len(subject.first.classes_)} names, training had {len(classes)} classes"
        )
    if words := describe_disagreement(subject.first, subject.probe):
        raise Mistake(words)
    if not (contract.has_probabilities(subject.first) or contract.decides_often(subject.first)):
        return "its labels are classes of its training captures; it has no probabilities"
    return f"they are 0 or more, have a sum of 1 over {len(classes)} classes and agree with predict"


@check("single capture")
def _(subject: Audited) -> str:
    count = len(subject.test)
    if effects := find_batch_effects(subject.first, subject.corpus, subject.test):
        raise Mistake(
            f"{len(effects)} of {count} predictions depend on the other captures: {effects[0]}"
        )
    return f"{count} captures in another batch, some of them alone, are predicted the same, within {TOLERANCE:g}"


@check("equal seeds")
def _(subject: Audited) -> str:
    hint = "" if subject.is_seeded else "; give it a parameter seed"
    subject.require_equal(
        subject.fit_new(subject.corpus[subject.train]),
        f"two fits to the same captures differ{hint}",
    )
    return "two fits to the same captures predict the same"


@check("training order", "equal seeds")
def _(subject: Audited) -> str:
    order = np.random.default_rng(0).permutation(subject.train)
    other = mean_probabilities(subject.fit_new(subject.corpus[order]), subject.probe)
    share = float((subject.expected.idxmax(axis=1) == other.idxmax(axis=1)).mean())
    if share < 1 and subject.is_seeded:
        raise Skipped(
            f"training is random (seed); in another order {100 * share:.0f} % of the labels are equal"
        )
    if share < 1:
        raise Mistake(
            f"in another order of training captures {100 * share:.0f} % of the labels are equal"
        )
    return f"training captures in another order give the same {len(other)} labels"


@check("shuffled labels")
def _(subject: Audited) -> str:
    corpus, rng = subject.corpus, np.random.default_rng(0)
    names = corpus.gestures.copy()
    for name in TRAINED:  # within a subject, so that every class stays in every inner fold
        rows = np.flatnonzero(corpus.subjects.astype(str) == name)
        names[rows] = rng.permutation(names[rows])
    shuffled = corpus.with_fields(captures=corpus.captures.assign(gesture=names))
    tested = corpus[subject.test]
    hits, usual = (
        int((mean_probabilities(one, tested).idxmax(axis=1).to_numpy() == tested.gestures).sum())
        for one in (subject.fit_new(shuffled[subject.train]), subject.first)
    )
    most = int(binom.interval(LEVEL, len(tested), 1 / len(set(tested.gestures)))[1])
    sentence = (
        f"after training on shuffled labels {hits} of {len(tested)} test captures are correct, on true ones {usual}; "
        f"chance gives 0 to {most} ({100 * LEVEL:g} % interval)"
    )
    if hits > most:
        raise Mistake(sentence)
    return sentence


@check("clone and parameters", "")
def _(subject: Audited) -> str:
    estimator: Any = subject.cell.estimator()
    if not hasattr(estimator, "get_params"):
        raise Skipped("it has no get_params, so scikit-learn cannot copy it")
    params = _shown(estimator)
    if (
        _shown(clone(estimator)) != params
    ):  # which itself raises where a constructor changes an argument
        raise Mistake("clone() gives other parameters")
    if _shown(estimator.set_params(**estimator.get_params(deep=False))) != params:
        raise Mistake("set_params() with the values of get_params() changes parameters")
    if "first" in vars(subject) and _shown(subject.first) != params:
        raise Mistake("fit() changes parameters; keep learned values in attributes that end in _")
    count = len(estimator.get_params())
    return f"clone, get_params and set_params keep {count} parameter{'s' * (count != 1)}"


def _shown(estimator: contract.System) -> str:
    """Parameters in full, without addresses in memory."""
    return re.sub(r" at 0x[0-9a-f]+", "", objects.settings_text(estimator))


def unseen(cell: Cell) -> pd.DataFrame:
    """Predictions of the test captures by a system that is fitted to the training captures, in a new process."""
    subject = Audited(cell)
    with limit_threads(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mean_probabilities(subject.first, subject.corpus[subject.test])


@check("no state between fits", "equal seeds")
def _(subject: Audited) -> str:
    """What a class or a module keeps of a fit, a new object has, too; a new process has it not."""
    estimator = subject.cell.estimator()
    part, names = subject.corpus[subject.train], np.unique(subject.corpus.gestures.astype(str))
    few = part[np.isin(part.gestures.astype(str), names[::3])]
    for training in (few, part):
        estimator.fit(training, training.gestures)
    subject.require_equal(estimator, "a fit depends on the fit before it")
    with ProcessPoolExecutor(1) as process:
        expected = process.submit(unseen, subject.cell).result()
    subject.fit_new(subject.corpus)
    now = mean_probabilities(subject.fit_new(part), subject.corpus[subject.test])
    if differs := describe_difference(expected, now):
        raise Mistake(
            f"a fit remembers captures of fits before it, in its class or module: {differs}"
        )
    return "a fit after others, also to the test captures, predicts as a first fit in a new process"


@check("test captures", "equal seeds")
def _(subject: Audited) -> str:
    corpus, test, rng = subject.corpus, subject.test, np.random.default_rng(0)
    frames, names = corpus.frames.copy(), corpus.gestures.copy()
    for start, length in zip(corpus.starts[test], corpus.lengths[test], strict=True):
        values = rng.integers(0, int(corpus.full_scale) + 1, (length, *corpus.grid))
        frames[start : start + length] = values.astype(frames.dtype)
    names[test] = rng.permutation(names[test])
    other = corpus.with_fields(frames=frames, captures=corpus.captures.assign(gesture=names))
    changed = "other values and labels of test captures change"
    subject.require_equal(subject.fit_new(other[subject.train]), f"{changed} what is learned")
    return f"{changed} no prediction"


@check("another grid and rate")
def _(subject: Audited) -> str:
    corpus = generate(3, variants=("normal",), rows=5, cols=3, rate_hz=54.0)
    corpus = with_conditions(corpus, contract.required_conditions(subject.cell.estimator()))
    mean_probabilities(subject.fit_new(corpus), corpus)
    return f"it fits and predicts {len(corpus)} captures of 5x3 taxels at 54 Hz"


@check("one-frame captures")
def _(subject: Audited) -> str:
    corpus = subject.corpus[subject.train]
    lengths = np.where(np.arange(len(corpus)) % 5 == 0, 1, corpus.lengths)
    estimator = subject.fit_new(corpus.with_fields(lengths=lengths))
    mean_probabilities(
        estimator, subject.probe.with_fields(lengths=np.ones(len(subject.probe), dtype=np.int64))
    )
    return f"it fits with {(lengths == 1).sum()} captures of one frame and predicts {len(subject.probe)} of them"


@check("saved and loaded")
def _(subject: Audited) -> str:
    """As ``bench fit`` and ``bench predict`` do."""
    if columns := contract.required_conditions(subject.first):
        raise Skipped(f"it needs {', '.join(columns)} to predict, which a saved model does not get")

    import cloudpickle

    from bench.running.saved import Recogniser, pickle_user_code

    pickle_user_code()
    recogniser = Recogniser(subject.first, subject.corpus[subject.train])
    content = cloudpickle.dumps(recogniser)
    labels = [one.label_captures(subject.probe) for one in (recogniser, cloudpickle.loads(content))]
    if differs := describe_difference(
        *(table.drop(columns=["label", "confidence", "unlike"]) for table in labels)
    ):
        raise Mistake(f"saved and loaded, it gives other predictions: {differs}")
    return f"saved ({len(content) / 1000:,.0f} kB) and loaded, it predicts the same"


def audit_system(cell: Cell) -> list[CheckResult]:
    """Every check of the system of a cell, in the order of `CHECKS`; its data and protocol are not looked at."""
    subject = Audited(cell)
    verdicts: list[CheckResult] = []
    with limit_threads(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for each in CHECKS:
            began = time.perf_counter()
            result, sentence = _answer(each, subject, verdicts)
            verdicts.append(CheckResult(each.name, result, sentence, time.perf_counter() - began))
    return verdicts


def refuse_system(cell: Cell) -> None:
    """Refuse a system before its audit: it cannot be made, or declares conditions that it must not use."""
    try:
        system = check_system(cell)
        contract.check_conditions(
            system, with_conditions(audit_captures(), contract.required_conditions(system))
        )
    except InputError:
        raise
    except Exception as e:  # a constructor of the user's may raise anything
        raise InputError(
            f"model={cell.model.short_name}: it cannot be made: {_last_line(e)}"
        ) from e


def _answer(each: Check, subject: Audited, before: list[CheckResult]) -> tuple[str, str]:
    """The result and sentence of one check."""
    if each.needs in {verdict.check for verdict in before if verdict.result != PASSED}:
        return SKIPPED, f"not checked, as {each.needs!r} has not passed"
    try:
        return PASSED, each.answer(subject)
    except Skipped as e:
        return SKIPPED, str(e)
    except InputError as e:
        return SKIPPED if before else FAILED, f"the system refuses these captures: {e}"
    except (Mistake, HiddenError) as e:  # which names the attribute
        return FAILED, str(e)
    except Exception as e:  # a system of the user's may raise anything
        return FAILED, _last_line(e)


def _last_line(error: Exception) -> str:
    """The type of an exception and the last line of its message."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[-1]}" if lines else type(error).__name__
