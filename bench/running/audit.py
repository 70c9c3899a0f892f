"""The audit of a system: rules that a score does not show, each checked on generated captures.

A check is a function of an `AuditedSystem`. It returns a sentence if the system keeps the rule,
or raises `Mistake` or `SkippedCheck`; any other exception is a failure.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import cloudpickle
import numpy as np
import pandas as pd
from joblib.externals.loky import ProcessPoolExecutor
from scipy.stats import binom
from sklearn.base import clone

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.errors import HiddenError, InputError, PredictionError
from bench.ground.closed import close_corpora
from bench.plan import objects
from bench.plan.cells import Cell
from bench.plan.plan import check_system
from bench.running.fold import TOLERANCE, describe_disagreement, find_batch_effects, limit_threads

PASSED, FAILED, SKIPPED = "passed", "failed", "not applicable"
EQUAL = 1e-6  # of a probability: two fits that should be the same
LEVEL = 0.999  # of the interval around chance
TRAINED = ("1", "2", "3")  # subjects; the other two are tested
SEEDS = ("seed", "random_state")  # parameters that declare random training


Check = tuple[Callable[[Any], str], str]  # and the name of the check that must pass before


class Mistake(Exception):
    """A broken rule, in a sentence."""


class SkippedCheck(Exception):
    """Why a rule does not apply to a system."""


@dataclass(frozen=True)
class CheckResult:
    """The result of one check: passed, failed or not applicable, and why."""

    check: str
    result: str
    sentence: str
    seconds: float


@cache
def audit_captures() -> Corpus:
    """Generate the captures of an audit: 14 gestures of 5 subjects, once each."""
    return generate(5, variants=("normal",))


@cache
def probe_captures() -> Corpus:
    """Generate captures of another subject, which no check trains on or changes."""
    return generate(1, variants=("normal",), repetitions=2, seed=1)


def add_conditions(corpus: Corpus, names: tuple[str, ...]) -> Corpus:
    """Add columns of two values, for declared conditions that the captures lack."""
    values = np.where(np.arange(len(corpus)) % 2, "a", "b")
    columns = {name: values for name in names if name not in corpus.captures}
    return corpus.with_fields(captures=corpus.captures.assign(**columns))


class AuditedSystem:
    """The audited system, with the captures of its audit."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        conditions = contract.required_conditions(cell.estimator())
        self.corpus = add_conditions(audit_captures(), conditions)
        self.probe = add_conditions(probe_captures(), conditions)
        is_trained = np.isin(self.corpus.subjects.astype(str), TRAINED)
        self.train, self.test = np.flatnonzero(is_trained), np.flatnonzero(~is_trained)

    def fit_new(self, part: Corpus) -> contract.System:
        """Fit a new system to some captures."""
        contract.check_training(self.cell.estimator(), part, part.gestures)
        return contract.fit_system(self.cell.estimator(), part, part.gestures)

    @cached_property
    def first(self) -> contract.System:
        """The system, fitted to the training captures."""
        return self.fit_new(self.corpus[self.train])

    @cached_property
    def probe_proba(self) -> pd.DataFrame:
        """Its predictions of the probe captures."""
        return mean_probabilities(self.first, self.probe)

    def require_equal(self, system: contract.System, mistake: str) -> None:
        """Raise a `Mistake` if another system predicts the probe captures differently."""
        proba = mean_probabilities(system, self.probe)
        if difference := describe_difference(self.probe_proba, proba):
            raise Mistake(f"{mistake}: {difference}")

    @property
    def is_seeded(self) -> bool:
        """True if it declares random training by a parameter of `SEEDS`."""
        if not self.cell.objects:
            return self.cell.seed is not None
        params: dict[str, object] = getattr(self.cell.estimator(), "get_params", dict)()
        seeds = [value for name, value in params.items() if name.split("__")[-1] in SEEDS]
        return self.cell.seed is not None or any(value is not None for value in seeds)


def mean_probabilities(system: contract.System, corpus: Corpus) -> pd.DataFrame:
    """Mean probability over the decisions on each capture [captures, classes]."""
    decisions, proba = contract.predict_decisions(system, corpus)
    names = np.asarray(system.classes_).astype(str)
    table = pd.DataFrame(np.asarray(proba, dtype=np.float64), columns=names)
    mean = table.groupby(decisions["capture"].to_numpy()).mean()
    if len(mean) != len(corpus):
        raise ValueError(f"{len(corpus)} captures have {len(mean)} predictions")
    return mean


def describe_difference(one: pd.DataFrame, other: pd.DataFrame) -> str:
    """Say how two `mean_probabilities` of the same captures differ; "" if they agree."""
    if set(one) != set(other):
        return f"the classes differ: {len(one.columns)} and {len(other.columns)}"
    if labels := int((one.idxmax(axis=1) != other.idxmax(axis=1)).sum()):
        return f"{labels} of {len(one)} labels differ"
    most = float((one - other).abs().to_numpy().max())
    return f"labels are equal, probabilities differ by up to {most:.2g}" if most > EQUAL else ""


def check_fit(audited: AuditedSystem) -> str:
    """Fit the training captures."""
    audited.first  # noqa: B018 - it may raise
    return f"it fits {len(audited.train)} captures of {len(TRAINED)} subjects"


def check_blindness(audited: AuditedSystem) -> str:
    """Predict without labels, subjects and origin."""
    with suppress(PredictionError):  # which the next check reports
        audited.probe_proba  # noqa: B018 - it may raise
        contract.predict_labels(audited.first, audited.probe)
    columns = contract.required_conditions(audited.first)
    declared = f"; it declares to need {', '.join(columns)}" if columns else ""
    return f"it predicts without labels, subjects and origin{declared}"


def check_labels(audited: AuditedSystem) -> str:
    """Compare classes, labels and probabilities."""
    system = audited.first
    classes = np.unique(audited.corpus.gestures[audited.train].astype(str))
    if sorted(str(name) for name in system.classes_) != classes.tolist():
        raise Mistake(
            f"classes_ has {len(system.classes_)} names, training had {len(classes)} classes"
        )
    if disagreement := describe_disagreement(system, audited.probe):
        raise Mistake(disagreement)
    if not (contract.has_probabilities(system) or contract.decides_often(system)):
        return "its labels are classes of its training captures; it has no probabilities"
    return f"they are 0 or more, have a sum of 1 over {len(classes)} classes and agree with predict"


def check_single_captures(audited: AuditedSystem) -> str:
    """Predict captures in another batch, and alone."""
    count = len(audited.test)
    if effects := find_batch_effects(audited.first, audited.corpus, audited.test):
        raise Mistake(
            f"{len(effects)} of {count} predictions depend on the other captures: {effects[0]}"
        )
    return (
        f"{count} captures in another batch, some of them alone, are predicted the same, within "
        f"{TOLERANCE:g}"
    )


def check_seeds(audited: AuditedSystem) -> str:
    """Fit the same captures again."""
    hint = "" if audited.is_seeded else "; give it a parameter seed"
    system = audited.fit_new(audited.corpus[audited.train])
    audited.require_equal(system, f"two fits to the same captures differ{hint}")
    return "two fits to the same captures predict the same"


def check_training_order(audited: AuditedSystem) -> str:
    """Fit the training captures in another order."""
    order = np.random.default_rng(0).permutation(audited.train)
    proba = mean_probabilities(audited.fit_new(audited.corpus[order]), audited.probe)
    equal = audited.probe_proba.idxmax(axis=1) == proba.idxmax(axis=1)
    percent = f"{100 * float(equal.mean()):.0f} % of the labels are equal"
    if equal.all():
        return f"training captures in another order give the same {len(proba)} labels"
    if audited.is_seeded:
        raise SkippedCheck(f"training is random (seed); in another order {percent}")
    raise Mistake(f"in another order of training captures {percent}")


def check_shuffled_labels(audited: AuditedSystem) -> str:
    """Train on shuffled labels, which leaves chance."""
    corpus, rng = audited.corpus, np.random.default_rng(0)
    names = corpus.gestures.copy()
    for name in TRAINED:  # within a subject, so that every class stays in every inner fold
        rows = np.flatnonzero(corpus.subjects.astype(str) == name)
        names[rows] = rng.permutation(names[rows])
    shuffled = corpus.with_fields(captures=corpus.captures.assign(gesture=names))
    tested = corpus[audited.test]

    def count_correct(system: contract.System) -> int:
        labels = mean_probabilities(system, tested).idxmax(axis=1).to_numpy()
        return int((labels == tested.gestures).sum())

    correct = count_correct(audited.fit_new(shuffled[audited.train]))
    most = int(binom.interval(LEVEL, len(tested), 1 / len(set(tested.gestures)))[1])
    sentence = (
        f"after training on shuffled labels {correct} of {len(tested)} test captures are correct, "
        f"on true ones {count_correct(audited.first)}; chance gives 0 to {most} "
        f"({100 * LEVEL:g} % interval)"
    )
    if correct > most:
        raise Mistake(sentence)
    return sentence


def check_cloning(audited: AuditedSystem) -> str:
    """Clone the system, set its parameters, and compare them after the fit."""
    system: Any = audited.cell.estimator()
    if not hasattr(system, "get_params"):
        raise SkippedCheck("it has no get_params, so scikit-learn cannot copy it")
    params = _parameter_text(system)
    if _parameter_text(clone(system)) != params:  # clone raises if a constructor changes arguments
        raise Mistake("clone() gives other parameters")
    if _parameter_text(system.set_params(**system.get_params(deep=False))) != params:
        raise Mistake("set_params() with the values of get_params() changes parameters")
    if "first" in vars(audited) and _parameter_text(audited.first) != params:
        raise Mistake("fit() changes parameters; keep learned values in attributes that end in _")
    count = len(system.get_params())
    return f"clone, get_params and set_params keep {count} parameter{'s' * (count != 1)}"


def _parameter_text(system: contract.System) -> str:
    """Parameters in full, without addresses in memory."""
    return re.sub(r" at 0x[0-9a-f]+", "", objects.settings_text(system))


def predict_in_new_process(cell: Cell) -> pd.DataFrame:
    """Fit a system, in a new process, and predict the test captures."""
    audited = AuditedSystem(cell)
    with limit_threads(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mean_probabilities(audited.first, audited.corpus[audited.test])


def check_state(audited: AuditedSystem) -> str:
    """Fit after other fits, with the same object and a new one.

    State of a class or a module remains in a new object, but not in a new process.
    """
    system = audited.cell.estimator()
    part, names = audited.corpus[audited.train], np.unique(audited.corpus.gestures.astype(str))
    few = part[np.isin(part.gestures.astype(str), names[::3])]
    for training in (few, part):
        system.fit(training, training.gestures)
    audited.require_equal(system, "a fit depends on the fit before it")
    with ProcessPoolExecutor(1) as process:
        expected = process.submit(predict_in_new_process, audited.cell).result()
    audited.fit_new(audited.corpus)
    proba = mean_probabilities(audited.fit_new(part), audited.corpus[audited.test])
    if difference := describe_difference(expected, proba):
        raise Mistake(
            f"a fit remembers captures of fits before it, in its class or module: {difference}"
        )
    return "a fit after others, also to the test captures, predicts as a first fit in a new process"


def check_test_captures(audited: AuditedSystem) -> str:
    """Change test captures before a fit."""
    corpus, test, rng = audited.corpus, audited.test, np.random.default_rng(0)
    frames, names = corpus.frames.copy(), corpus.gestures.copy()
    for start, length in zip(corpus.starts[test], corpus.lengths[test], strict=True):
        values = rng.integers(0, int(corpus.full_scale) + 1, (length, *corpus.grid))
        frames[start : start + length] = values.astype(frames.dtype)
    names[test] = rng.permutation(names[test])
    other = corpus.with_fields(frames=frames, captures=corpus.captures.assign(gesture=names))
    changed = "other values and labels of test captures change"
    audited.require_equal(audited.fit_new(other[audited.train]), f"{changed} what is learned")
    return f"{changed} no prediction"


def check_other_sensor(audited: AuditedSystem) -> str:
    """Fit and predict captures of another grid and rate."""
    corpus = generate(3, variants=("normal",), rows=5, cols=3, rate_hz=54.0)
    corpus = add_conditions(corpus, contract.required_conditions(audited.cell.estimator()))
    mean_probabilities(audited.fit_new(corpus), corpus)
    return f"it fits and predicts {len(corpus)} captures of 5x3 taxels at 54 Hz"


def check_short_captures(audited: AuditedSystem) -> str:
    """Fit and predict captures of one frame."""
    corpus, probe = audited.corpus[audited.train], audited.probe
    lengths = np.where(np.arange(len(corpus)) % 5 == 0, 1, corpus.lengths)
    system = audited.fit_new(corpus.with_fields(lengths=lengths))
    short_probe = probe.with_fields(lengths=np.ones(len(probe), dtype=np.int64))
    mean_probabilities(system, short_probe)
    fitted = (lengths == 1).sum()
    return f"it fits with {fitted} captures of one frame and predicts {len(probe)} of them"


def check_saving(audited: AuditedSystem) -> str:
    """Save and load the system as ``bench fit`` and ``bench predict`` do."""
    from bench.running.saved import Recogniser, pickle_user_code

    if columns := contract.required_conditions(audited.first):
        needed = ", ".join(columns)
        raise SkippedCheck(f"it needs {needed} to predict, which a saved model does not get")
    pickle_user_code()
    recogniser = Recogniser(audited.first, audited.corpus[audited.train])
    content = cloudpickle.dumps(recogniser)
    proba = []
    for each in (recogniser, cloudpickle.loads(content)):
        table = each.label(audited.probe)
        proba.append(table.drop(columns=["label", "confidence", "unlike"]))
    if difference := describe_difference(*proba):
        raise Mistake(f"saved and loaded, it gives other predictions: {difference}")
    return f"saved ({len(content) / 1000:,.0f} kB) and loaded, it predicts the same"


# In the order of the table: each check, and the check without which it is not applicable.
CHECKS: dict[str, Check] = {
    "fit": (check_fit, ""),
    "no labels needed": (check_blindness, "fit"),
    "labels and probabilities": (check_labels, "no labels needed"),
    "single capture": (check_single_captures, "labels and probabilities"),
    "equal seeds": (check_seeds, "labels and probabilities"),
    "training order": (check_training_order, "equal seeds"),
    "shuffled labels": (check_shuffled_labels, "labels and probabilities"),
    "clone and parameters": (check_cloning, ""),
    "no state between fits": (check_state, "equal seeds"),
    "test captures": (check_test_captures, "equal seeds"),
    "another grid and rate": (check_other_sensor, "labels and probabilities"),
    "one-frame captures": (check_short_captures, "labels and probabilities"),
    "saved and loaded": (check_saving, "labels and probabilities"),
}


def audit_system(cell: Cell) -> list[CheckResult]:
    """Run every check on the system of a cell; its data and protocol are not used."""
    with close_corpora(), limit_threads(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return run_checks(AuditedSystem(cell), CHECKS, [])


def run_checks(
    audited: object, checks: dict[str, Check], earlier: Sequence[CheckResult]
) -> list[CheckResult]:
    """Run checks in their order, after earlier ones."""
    results = list[CheckResult]()
    for name, (check, needed) in checks.items():
        started, all_results = time.perf_counter(), [*earlier, *results]
        if needed in {each.check for each in all_results if each.result != PASSED}:
            result, sentence = SKIPPED, f"not checked, as {needed!r} has not passed"
        else:
            result, sentence = _run_check(check, audited, is_first=not all_results)
        results.append(CheckResult(name, result, sentence, time.perf_counter() - started))
    return results


def refuse_system(cell: Cell) -> None:
    """Refuse a system that cannot be made, or declares conditions that it must not use."""
    system = check_system(cell)
    corpus = add_conditions(audit_captures(), contract.required_conditions(system))
    contract.check_conditions(system, corpus)


def _run_check(check: Callable[[Any], str], audited: object, is_first: bool) -> tuple[str, str]:
    """Run one check; return its result and sentence."""
    try:
        return PASSED, check(audited)
    except SkippedCheck as e:
        return SKIPPED, str(e)
    except InputError as e:
        return FAILED if is_first else SKIPPED, f"the system refuses these captures: {e}"
    except (Mistake, HiddenError) as e:  # which names the attribute
        return FAILED, str(e)
    except Exception as e:  # a system of the user's may raise anything
        return FAILED, _last_line(e)


def _last_line(error: Exception) -> str:
    """The type of an exception and the last line of its message."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[-1]}" if lines else type(error).__name__
