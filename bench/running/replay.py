"""Captures seen so far: decisions at instants, and early stopping.

The replay table has a row per capture and instant with new frames: the columns of the predictions
table (`bench.values.scores`), where ``start`` and ``frames`` are those seen, ``instant`` (frames of
a long enough capture by then), ``confidence`` (calibrated) and ``settled`` (1 less the expected
gain of waiting). After its last row a capture keeps its last decision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import logsumexp, softmax
from sklearn.linear_model import Ridge

from bench import contract
from bench.corpora.corpus import Corpus, shared_frames, untrained_classes
from bench.ground.timing import Times, time_repeatedly
from bench.models.search.inner_folds import split_tested_subjects
from bench.running.fitted import FittedFold
from bench.running.fold import (
    TIMED_CAPTURES,
    find_batch_effects,
    limit_threads,
    predict_to_table,
    take_evenly,
)
from bench.running.results import FoldResult
from bench.values.scores import PREFIX, classes_of, label_windows
from bench.values.stopping import learn_stopping

ReplayOptions = Any  # `bench.running.circumstances.instants.Instants`, which imports this file
DEFAULT_REPLAY = SimpleNamespace(after=(), hop_ms=None, start="onset")  # of a saved system
FIRST_MS = 62.5
GROWTH = 2**0.5  # of the touch seen, from one instant to the next
INNER = "3"  # groups of training subjects, each left out once
LEAST = 1e-6  # probability that is taken for impossible
HOTTEST = 100.0  # temperature of a calibration
RIDGE = 1e-2
STATE = (  # variables of a decision
    *("one", "first", "first_squared", "second", "third"),
    *("time", "time_squared", "first_time", "second_time", "same", "same_time"),
)
TIMED_INSTANTS = 8


def skip_to_start(corpus: Corpus, start: str) -> Corpus:
    """Return captures from the start of a replay: their ``onset``, or their ``middle``."""
    if start == "onset":
        return corpus
    skipped = corpus.lengths // 2
    return without_digest(corpus, shared_frames(corpus)[1] + skipped, corpus.lengths - skipped)


def decision_instants(replay: ReplayOptions, longest: int, rate_hz: float) -> np.ndarray:
    """Frames seen at each decision, rising to ``longest``, int64 [instants].

    Without times and a hop, it decides whenever 1.41 times as much has been seen, from 62.5 ms on.
    """
    per_ms = rate_hz / 1000
    if replay.after:
        ms = np.sort(replay.after)
    elif replay.hop_ms is not None:
        ms = replay.hop_ms * np.arange(1, int(longest / per_ms / replay.hop_ms) + 2)
    else:
        octaves = max(0.0, np.log2(longest / per_ms / FIRST_MS))
        ms = FIRST_MS * GROWTH ** np.arange(np.ceil(octaves / np.log2(GROWTH)) + 1)
    seen = np.floor(ms * per_ms + 1e-6).astype(np.int64)
    return np.unique(np.append(seen[(seen > 0) & (seen < longest)], longest))


def without_digest(corpus: Corpus, starts: np.ndarray, lengths: np.ndarray) -> Corpus:
    """Return parts of captures; features of whole ones are cached under the digest."""
    return corpus.with_fields(starts=starts, lengths=lengths, digest="", path=None)


def first_frames(corpus: Corpus, frames: int) -> Corpus:
    """Return the first frames of each capture, at most ``frames``; no frame is copied."""
    if (corpus.lengths <= frames).all():
        return corpus
    return without_digest(corpus, shared_frames(corpus)[1], np.minimum(corpus.lengths, frames))


def replay_fold(replay: ReplayOptions, at: FittedFold) -> FoldResult:
    """Replay the test captures of a fold through its system, and time decisions.

    Its table ``replay`` is the replay table. Where stopping is learned, on training subjects alone,
    ``rules`` has the rule, and ``thresholds`` the result of each threshold there.
    """
    corpus, fold, system = at.corpus, at.fold, at.system
    touch = skip_to_start(corpus, replay.start)
    instants = decision_instants(replay, int(touch.lengths.max()), corpus.rate_hz)
    tables = {}
    with limit_threads(at.threads):
        table = replay_captures(system, touch, fold.name, fold.test, instants)
        early = first_frames(touch, int(instants[len(instants) // 2]))
        effects = find_batch_effects(system, early, fold.test)
        if replay.stopping:
            rule, series = learn_stopping_rule(at.cell.estimator, corpus, fold.train, replay)
            table = add_settledness(table, rule.calibration, rule.waiting, corpus.rate_hz)
            row = {"fold": fold.name, "threshold": rule.threshold}
            row |= {f"temperature_{k}": value for k, value in asdict(rule.calibration).items()}
            weights = zip(STATE, rule.waiting.weights, strict=True)
            row |= {f"waiting_{name}": weight for name, weight in weights}
            tables = {"rules": pd.DataFrame([row]), "thresholds": series.assign(fold=fold.name)}
    with limit_threads(1):
        latency = time_decisions(system, touch[fold.test], instants)
    times = {"replay_ms": latency.ms, "replay_wall_ms": latency.wall_ms}
    tables = {"replay": table} | tables
    return FoldResult(fold.name, tables=tables, times=times, batch_effects=effects)


def replay_captures(
    system: contract.System,
    corpus: Corpus,
    fold: str,
    positions: np.ndarray,
    instants: np.ndarray,
) -> pd.DataFrame:
    """Replay some captures; return their replay table without ``confidence`` and ``settled``.

    It is sorted by capture, then instant. A system that decides per window has the mean probability
    of its windows so far.
    """
    parts, before = [], 0
    for frames in instants:
        alive = positions[corpus.lengths[positions] > before]
        if not len(alive):
            break
        seen, captures = first_frames(corpus, frames), corpus.index[alive]
        table = predict_to_table(system, seen, fold, alive)
        columns = [PREFIX + name for name in classes_of(table)]
        by_capture = table.groupby("capture", sort=False)[columns].mean()
        rows = table.drop_duplicates("capture").set_index("capture").loc[captures].reset_index()
        rows[columns] = by_capture.reindex(captures).to_numpy()
        parts.append(rows.assign(start=0, frames=seen.lengths[alive], instant=frames))
        before = frames
    table = pd.concat(parts, ignore_index=True)
    return table.sort_values(["capture", "instant"], kind="stable", ignore_index=True)


@dataclass(frozen=True)
class Calibration:
    """Temperature scaling (Guo et al. 2017); the temperature changes with the touch seen.

    Probabilities become softmax(log p / T). log T is a straight line over log ms, from the first
    instant to the last. One temperature for all instants would trust early decisions too
    much, and one for each would rest on few captures at late instants.
    """

    first_ms: float  # seen at the first instant, before which T stays the same
    last_ms: float  # seen at the last instant, after which T stays the same
    first: float  # temperature at the first instant
    last: float  # temperature at the last instant

    @classmethod
    def fit(cls, proba: np.ndarray, true: np.ndarray, ms: np.ndarray) -> Calibration:
        """Fit to decisions by maximum likelihood; temperatures stay within 1/100 and 100.

        Args:
            proba: probabilities [decisions, classes].
            true: index of the true class [decisions].
            ms: milliseconds seen [decisions].
        """
        logs = np.log(np.maximum(proba, LEAST))
        late = _lateness(ms, ms.min(), ms.max())
        rows = np.arange(len(logs))

        def loss(ends: np.ndarray) -> tuple[float, np.ndarray]:
            sharp = np.exp(-(ends[0] * (1 - late) + ends[1] * late))
            scaled = sharp[:, None] * logs
            total = logsumexp(scaled, axis=1)
            expected = (np.exp(scaled - total[:, None]) * logs).sum(axis=1)
            slope = -sharp * (expected - logs[rows, true])  # of the loss in log T
            gradient = np.array([(slope * (1 - late)).mean(), (slope * late).mean()])
            return (total - scaled[rows, true]).mean(), gradient

        most = np.log(HOTTEST)
        bounds = [(-most, most)] * 2
        ends = minimize(loss, np.zeros(2), jac=True, method="L-BFGS-B", bounds=bounds).x
        first, last = np.exp(ends)
        return cls(float(ms.min()), float(ms.max()), float(first), float(last))

    def __call__(self, proba: np.ndarray, ms: np.ndarray) -> np.ndarray:
        """Calibrate probabilities [decisions, classes] of decisions that saw ``ms``; 0 stays 0."""
        late = _lateness(ms, self.first_ms, self.last_ms)
        temperature = np.exp(np.log(self.first) * (1 - late) + np.log(self.last) * late)
        calibrated = softmax(np.log(np.maximum(proba, LEAST)) / temperature[:, None], axis=1)
        return np.where(proba.any(axis=1, keepdims=True), calibrated, 0)


def _lateness(ms: np.ndarray, first: float, last: float) -> np.ndarray:
    """Place of each time between first (0) and last (1) on a logarithmic scale."""
    if last <= first:
        return np.zeros(len(ms))
    return np.clip(np.log(ms / first) / np.log(last / first), 0, 1)


@dataclass(frozen=True)
class Waiting:
    """Expected gain in accuracy from the rest of a capture, by least squares over replays.

    A capture that would get no better label at its end can be decided on at once, however unsure
    its label is: gestures that look the same do so for ever. So confidence does not tell when to
    stop.
    """

    weights: tuple[float, ...]  # of the variables of a decision, in the order of `STATE`

    @classmethod
    def fit(cls, table: pd.DataFrame, rate_hz: float) -> Waiting:
        """Fit to a replay table.

        The target is 1 if only the last decision is right, -1 if only the present one is.
        """
        right = table["true"].astype(str) == label_windows(table)["predicted"]
        last = right.groupby([table["fold"], table["capture"]], sort=False).transform("last")
        regression = Ridge(RIDGE, fit_intercept=False)
        regression.fit(_decision_variables(table, rate_hz), last.astype(float) - right)
        return cls(tuple(regression.coef_.tolist()))

    def __call__(self, table: pd.DataFrame, rate_hz: float) -> np.ndarray:
        """Return the expected gain of each row, -1 to 1."""
        return np.clip(_decision_variables(table, rate_hz) @ np.array(self.weights), -1, 1)


def _class_probabilities(table: pd.DataFrame) -> np.ndarray:
    return table[[PREFIX + c for c in classes_of(table)]].to_numpy(dtype=np.float64)


def _milliseconds_seen(table: pd.DataFrame, rate_hz: float) -> np.ndarray:
    return 1000 / rate_hz * table["frames"].to_numpy()


def _decision_variables(table: pd.DataFrame, rate_hz: float) -> np.ndarray:
    """Variables of each decision [rows, STATE]: largest probabilities, time, the label before."""
    proba = -np.sort(-_class_probabilities(table), axis=1)
    proba = np.pad(proba, ((0, 0), (0, max(0, 3 - proba.shape[1]))))
    first, second, third = proba[:, :3].T
    time = np.log(_milliseconds_seen(table, rate_hz) / FIRST_MS)
    label = label_windows(table)["predicted"]
    before = label.groupby([table["fold"], table["capture"]], sort=False).shift(1)
    same = (label == before).to_numpy(dtype=float)
    of_proba = [np.ones(len(table)), first, first**2, second, third]
    of_time = [time, time**2, first * time, second * time]
    return np.column_stack([*of_proba, *of_time, same, same * time])


def add_settledness(
    table: pd.DataFrame, calibration: Calibration, waiting: Waiting, rate_hz: float
) -> pd.DataFrame:
    """Add the calibrated probability of each decision's label, and how settled it is."""
    confidence = calibration(_class_probabilities(table), _milliseconds_seen(table, rate_hz)).max(
        axis=1
    )
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


def why_unlearnable(system: contract.System, corpus: Corpus) -> str:
    """Return why no `Stopping` can be learned from training captures; "" if it can."""
    gestures = corpus.gestures
    if len(set(corpus.subjects[~corpus.is_added])) < 2:
        return "only one subject trains"
    for inner, judged in split_tested_subjects(corpus, INNER):
        if len(set(gestures[inner])) < 2:
            return "leaving subjects out leaves one class"
        if lacking := untrained_classes(gestures, inner, judged):
            return f"without some of them nobody is left who shows {lacking[0]}"
        contract.check_training(system, corpus[inner], gestures[inner])
    return ""


def learn_stopping_rule(
    make_system: Callable[[], contract.System],
    corpus: Corpus,
    train: np.ndarray,
    replay: ReplayOptions = DEFAULT_REPLAY,
) -> tuple[Stopping, pd.DataFrame]:
    """Learn the stopping rule from the training part; no other capture is looked at.

    Each of its subjects is replayed by a system that was not trained on them.

    Returns:
        The rule, and a row for each threshold tried.
    """
    part, rate_hz = corpus[train], corpus.rate_hz
    touch = skip_to_start(part, replay.start)
    instants = decision_instants(replay, int(touch.lengths.max()), rate_hz)
    tables = []
    for number, (inner, judged) in enumerate(split_tested_subjects(part, INNER)):
        system = contract.fit_system(make_system(), part[inner], part.gestures[inner])
        tables.append(replay_captures(system, touch, str(number), judged, instants))
    table = pd.concat(tables, ignore_index=True)
    true = np.searchsorted(classes_of(table), table["true"].to_numpy(dtype=str))
    ms = _milliseconds_seen(table, rate_hz)
    calibration = Calibration.fit(_class_probabilities(table), true, ms)
    parts = []
    for rows in tables:  # the gain of waiting is learned from other subjects than the threshold
        others = pd.concat([other for other in tables if other is not rows], ignore_index=True)
        parts.append(add_settledness(rows, calibration, Waiting.fit(others, rate_hz), rate_hz))
    threshold, series = learn_stopping(pd.concat(parts, ignore_index=True), rate_hz)
    return Stopping(calibration, Waiting.fit(table, rate_hz), threshold), series


def time_decisions(system: contract.System, touch: Corpus, instants: np.ndarray) -> Times:
    """Time decisions from raw frames: one at a time, warm, over instants of single captures.

    A system that decides on windows sees its newest one, as it has decided on those before.
    """
    calls = []
    for i in take_evenly(np.arange(len(touch)), TIMED_CAPTURES):
        capture, start = touch[i : i + 1], shared_frames(touch)[1][i : i + 1]
        ends = np.minimum(take_evenly(instants, TIMED_INSTANTS), touch.lengths[i])
        for frames in np.unique(ends):  # the end of a capture is a decision, too
            first = frames - contract.frames_at_once(system, int(frames))
            newest = without_digest(capture, start + first, np.array([frames - first]))
            blind = contract.blind_captures(system, newest.detach())
            calls.append(partial(system.predict, blind))
    return time_repeatedly(calls)
