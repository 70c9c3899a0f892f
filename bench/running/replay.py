"""Captures seen by a robot, only the touch so far: decisions at instants, and early stopping.

The replay table has one row per capture and instant at which there was something new: the columns of the predictions
table (`bench.values.scores`), where ``start`` and ``frames`` are what had been seen, ``instant`` (the frames that a
capture that is long enough would have given by then), ``confidence`` (calibrated) and ``settled`` (1 less what waiting
is expected to gain). After its last row a capture keeps its last decision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import logsumexp, softmax
from sklearn.linear_model import Ridge

from bench import contract
from bench.corpora.corpus import Corpus, storage, untrained
from bench.ground.timing import Times, timed
from bench.models.search.inner_folds import inner_folds
from bench.running.fold import TIMED_CAPTURES, batch_effects, computing, decisions, some_of
from bench.running.results import FoldResult
from bench.values.scores import PREFIX, classes_of, windows
from bench.values.stopping import learn_stopping

if TYPE_CHECKING:
    from bench.running.fitted import Fitted

    Instants = Any  # `bench.running.circumstances.instants.Instants`: the settings of a replay

FIRST_MS = 62.5
GROWTH = 2**0.5  # of what has been seen, from one instant to the next
INNER = "3"  # groups of training subjects, each left out once
LEAST = 1e-6  # probability that is taken for impossible
HOTTEST = 100.0
RIDGE = 1e-2
STATE = (
    *(
        "one",
        "first",
        "first_squared",
        "second",
        "third",
        "time",
        "time_squared",
        "first_time",
        "second_time",
    ),
    *("same", "same_time"),
)
TIMED_INSTANTS = 8
USUAL = SimpleNamespace(
    after=(), hop_ms=None, start="onset"
)  # settings of the replay that a saved system learns from


def begun(corpus: Corpus, start: str) -> Corpus:
    """The captures from where a replay begins: at their ``onset``, or in the ``middle``."""
    if start == "onset":
        return corpus
    skipped = corpus.lengths // 2
    return uncached(corpus, storage(corpus)[1] + skipped, corpus.lengths - skipped)


def instants_of(how: Instants, longest: int, rate_hz: float) -> np.ndarray:
    """Frames seen at each decision, rising to ``longest``, int64 [instants].

    Without times and a hop, it decides whenever 1.41 times as much has been seen, from 62.5 ms on.
    """
    per_ms = rate_hz / 1000
    if how.after:
        ms = np.sort(how.after)
    elif how.hop_ms is not None:
        ms = how.hop_ms * np.arange(1, int(longest / per_ms / how.hop_ms) + 2)
    else:
        octaves = max(0.0, np.log2(longest / per_ms / FIRST_MS))
        ms = FIRST_MS * GROWTH ** np.arange(np.ceil(octaves / np.log2(GROWTH)) + 1)
    seen = np.floor(ms * per_ms + 1e-6).astype(np.int64)
    return np.unique(np.append(seen[(seen > 0) & (seen < longest)], longest))


def uncached(corpus: Corpus, starts: np.ndarray, lengths: np.ndarray) -> Corpus:
    """Parts of captures; without the digest, under which the features of whole captures are cached."""
    return corpus.changed(starts=starts, lengths=lengths, digest="", path=None)


def prefix(corpus: Corpus, frames: int) -> Corpus:
    """The first frames of each capture, at most ``frames``; no frame is copied."""
    if (corpus.lengths <= frames).all():
        return corpus
    return uncached(corpus, storage(corpus)[1], np.minimum(corpus.lengths, frames))


def replay_fold(how: Instants, at: Fitted) -> FoldResult:
    """Replay the test captures of a fold through its system, and time decisions.

    Its table ``replay`` is the replay table; where stopping is learned, ``rules`` has what was learned on training
    subjects, and ``thresholds`` what each threshold gives there. Calibration and threshold see only these.
    """
    corpus, fold, system = at.corpus, at.fold, at.system
    touch = begun(corpus, how.start)
    instants = instants_of(how, int(touch.lengths.max()), corpus.rate_hz)
    tables = {}
    with computing(at.threads):
        table = replayed(system, touch, fold.name, fold.test, instants)
        early = prefix(touch, int(instants[len(instants) // 2]))
        effects = batch_effects(system, early, fold.test)
        if how.stopping:
            rule, series = learned(at.cell.estimator, corpus, fold.train, how)
            table = weighed(table, rule.calibration, rule.waiting, corpus.rate_hz)
            row: dict[str, object] = {"fold": fold.name, "threshold": rule.threshold}
            row |= {f"temperature_{k}": v for k, v in asdict(rule.calibration).items()}
            row |= {
                f"waiting_{name}": weight
                for name, weight in zip(STATE, rule.waiting.weights, strict=True)
            }
            tables = {"rules": pd.DataFrame([row]), "thresholds": series.assign(fold=fold.name)}
    with computing(1):
        spent = decision_latency(system, touch[fold.test], instants)
    times = {"replay_ms": spent.ms, "replay_wall_ms": spent.wall_ms}
    return FoldResult(
        fold.name, tables={"replay": table} | tables, times=times, batch_effects=effects
    )


def replayed(
    estimator: contract.System,
    corpus: Corpus,
    fold: str,
    positions: np.ndarray,
    instants: np.ndarray,
) -> pd.DataFrame:
    """The replay table of some captures, without ``confidence`` and ``settled``; sorted by capture, then instant.

    A system that decides per window has the mean probability of its windows so far.
    """
    parts, before = [], 0
    for frames in instants:
        alive = positions[corpus.lengths[positions] > before]
        if not len(alive):
            break
        seen = prefix(corpus, frames)
        table = decisions(estimator, seen, fold, alive)
        columns = [PREFIX + c for c in classes_of(table)]
        mean = table.groupby("capture", sort=False)[columns].mean().reindex(corpus.index[alive])
        rows = (
            table.drop_duplicates("capture")
            .set_index("capture")
            .loc[corpus.index[alive]]
            .reset_index()
        )
        rows[columns] = mean.to_numpy()
        parts.append(rows.assign(start=0, frames=seen.lengths[alive], instant=frames))
        before = frames
    table = pd.concat(parts, ignore_index=True)
    return table.sort_values(["capture", "instant"], kind="stable", ignore_index=True)


@dataclass(frozen=True)
class Calibration:
    """Temperature scaling (Guo et al. 2017) with a temperature that changes with the amount of touch seen.

    Probabilities become softmax(log p / T), where log T goes in a straight line over log milliseconds from the first
    instant to the last. One temperature for all instants would trust early decisions too much, and one for each would
    rest on few captures at late instants.
    """

    first_ms: float  # seen at the first instant, before which T stays the same
    last_ms: float  # at the last instant, after which T stays the same
    first: float  # temperature at the first instant
    last: float  # at the last instant

    @classmethod
    def fit(cls, proba: np.ndarray, true: np.ndarray, ms: np.ndarray) -> Calibration:
        """Maximum likelihood over decisions; temperatures stay within 1/100 and 100."""
        logs = np.log(np.maximum(proba, LEAST))
        late = _lateness(ms, ms.min(), ms.max())
        rows = np.arange(len(logs))

        def loss(ends: np.ndarray) -> tuple[float, np.ndarray]:
            sharp = np.exp(-(ends[0] * (1 - late) + ends[1] * late))
            scaled = sharp[:, None] * logs
            total = logsumexp(scaled, axis=1)
            expected = (np.exp(scaled - total[:, None]) * logs).sum(axis=1)
            slope = -sharp * (expected - logs[rows, true])  # of the loss in log T
            return (total - scaled[rows, true]).mean(), np.array(
                [(slope * (1 - late)).mean(), (slope * late).mean()]
            )

        most = np.log(HOTTEST)
        first, last = np.exp(
            minimize(loss, np.zeros(2), jac=True, method="L-BFGS-B", bounds=[(-most, most)] * 2).x
        )
        return cls(float(ms.min()), float(ms.max()), float(first), float(last))

    def __call__(self, proba: np.ndarray, ms: np.ndarray) -> np.ndarray:
        """Calibrated probabilities [decisions, classes] of decisions that had seen ``ms``; zeros stay zeros."""
        late = _lateness(ms, self.first_ms, self.last_ms)
        temperature = np.exp(np.log(self.first) * (1 - late) + np.log(self.last) * late)
        calibrated = softmax(np.log(np.maximum(proba, LEAST)) / temperature[:, None], axis=1)
        return np.where(proba.any(axis=1, keepdims=True), calibrated, 0)


def _lateness(ms: np.ndarray, first: float, last: float) -> np.ndarray:
    """Where each time lies between first (0) and last (1) on a logarithmic scale."""
    return (
        np.clip(np.log(ms / first) / np.log(last / first), 0, 1)
        if last > first
        else np.zeros(len(ms))
    )


@dataclass(frozen=True)
class Waiting:
    """The expected gain in accuracy from the rest of a capture: least squares over replayed training captures.

    A capture that would be labelled no better at its end can be decided on at once, however unsure its label is: two
    gestures that look the same look the same for ever. So it is not confidence that says when to stop.
    """

    weights: tuple[float, ...]  # of the variables of a decision, in the order of `STATE`

    @classmethod
    def fit(cls, table: pd.DataFrame, rate_hz: float) -> Waiting:
        """Fit to a replay table: the target is 1 if only the last decision is right, -1 if only this one is."""
        right = table["true"].astype(str) == windows(table)["predicted"]
        last = right.groupby([table["fold"], table["capture"]], sort=False).transform("last")
        regression = Ridge(RIDGE, fit_intercept=False).fit(
            _state(table, rate_hz), last.astype(float) - right
        )
        return cls(tuple(regression.coef_.tolist()))

    def __call__(self, table: pd.DataFrame, rate_hz: float) -> np.ndarray:
        """Expected gain of each row, -1 to 1."""
        return np.clip(_state(table, rate_hz) @ np.array(self.weights), -1, 1)


def _probabilities(table: pd.DataFrame) -> np.ndarray:
    return table[[PREFIX + c for c in classes_of(table)]].to_numpy(dtype=np.float64)


def _milliseconds_seen(table: pd.DataFrame, rate_hz: float) -> np.ndarray:
    return 1000 / rate_hz * table["frames"].to_numpy()


def _state(table: pd.DataFrame, rate_hz: float) -> np.ndarray:
    """The variables of each decision [rows, STATE]: its three largest probabilities, time, and the label before it."""
    proba = -np.sort(-_probabilities(table), axis=1)
    first, second, third = (
        proba[:, i] if i < proba.shape[1] else np.zeros(len(proba)) for i in range(3)
    )
    time = np.log(_milliseconds_seen(table, rate_hz) / FIRST_MS)
    label = windows(table)["predicted"]
    before = label.groupby([table["fold"], table["capture"]], sort=False).shift(1)
    same = (label == before).to_numpy(dtype=float)
    columns = [
        np.ones(len(table)),
        first,
        first**2,
        second,
        third,
        time,
        time**2,
        first * time,
        second * time,
    ]
    return np.column_stack([*columns, same, same * time])


def weighed(
    table: pd.DataFrame, calibration: Calibration, waiting: Waiting, rate_hz: float
) -> pd.DataFrame:
    """A replay table with the calibrated probability of each decision's label, and how settled it is."""
    confidence = calibration(_probabilities(table), _milliseconds_seen(table, rate_hz)).max(axis=1)
    return table.assign(confidence=confidence, settled=np.clip(1 - waiting(table, rate_hz), 0, 1))


@dataclass(frozen=True)
class Stopping:
    """The stopping rule learned from training subjects."""

    calibration: Calibration  # of probabilities
    waiting: Waiting  # expected gain from the rest of a capture
    threshold: float  # least settledness of a final label; infinite if no saving was found

    @property
    def saves(self) -> bool:
        """True if a label settles before the end of a capture."""
        return bool(np.isfinite(self.threshold))


def unlearnable(estimator: contract.System, corpus: Corpus) -> str:
    """The reason why no `Stopping` can be learned from some training captures; empty if it can."""
    gestures, subjects = corpus.gestures, corpus.subjects.astype(str)
    if len(set(subjects)) < 2:
        return "only one subject trains"
    for inner, judged in inner_folds(subjects, INNER):
        if len(set(gestures[inner])) < 2:
            return "leaving subjects out leaves one class"
        if lacking := untrained(gestures, inner, judged):
            return f"without some of them nobody is left who shows {lacking[0]}"
        contract.check_training(estimator, corpus[inner], gestures[inner])
    return ""


def learned(
    untrained: Callable[[], contract.System],
    corpus: Corpus,
    train: np.ndarray,
    how: Instants = USUAL,
) -> tuple[Stopping, pd.DataFrame]:
    """Learn the stopping rule from the training part; also return the result of each threshold there.

    Each of its subjects is replayed by a system that was not trained on it. No other capture is looked at.
    """
    part = corpus[train]
    touch = begun(part, how.start)
    instants = instants_of(how, int(touch.lengths.max()), corpus.rate_hz)
    tables = []
    for number, (inner, judged) in enumerate(inner_folds(part.subjects.astype(str), INNER)):
        estimator = untrained().fit(part[inner], part.gestures[inner])
        tables.append(replayed(estimator, touch, str(number), judged, instants))
    table = pd.concat(tables, ignore_index=True)
    true = np.searchsorted(classes_of(table), table["true"].to_numpy(dtype=str))
    calibration = Calibration.fit(
        _probabilities(table), true, _milliseconds_seen(table, corpus.rate_hz)
    )
    parts = []
    for (
        rows
    ) in tables:  # what waiting gains is learned from other subjects than what stopping loses
        others = pd.concat([other for other in tables if other is not rows], ignore_index=True)
        parts.append(
            weighed(rows, calibration, Waiting.fit(others, corpus.rate_hz), corpus.rate_hz)
        )
    threshold, series = learn_stopping(pd.concat(parts, ignore_index=True), corpus.rate_hz)
    return Stopping(calibration, Waiting.fit(table, corpus.rate_hz), threshold), series


def decision_latency(estimator: contract.System, touch: Corpus, instants: np.ndarray) -> Times:
    """Times from raw frames to a decision: one at a time, warm, over the instants of single captures.

    A system that decides on windows sees its newest one, as it has decided on those before.
    """
    chosen = some_of(np.arange(len(touch)), TIMED_CAPTURES)
    seen = some_of(instants, TIMED_INSTANTS)
    each = []
    for i in chosen:
        for frames in np.unique(np.minimum(seen, touch.lengths[i])):  # its end is a decision, too
            first = frames - contract.frames_at_once(estimator, int(frames))
            newest = uncached(
                touch[i : i + 1], storage(touch)[1][i : i + 1] + first, np.array([frames - first])
            )
            each.append(partial(estimator.predict, contract.blinded(estimator, newest.detached())))
    return timed(each)
