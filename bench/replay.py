"""Captures as a robot sees them, only what has been touched so far: decisions at instants, and when to stop early.

The replay table has one row per capture and instant at which there was something new: the columns of the predictions
table (`bench.scores`), where ``start`` and ``frames`` are what had been seen, ``instant`` (the frames that a capture
that is long enough would have given by then) and ``confidence`` (calibrated). After its last row a capture keeps its
last decision.
"""

from __future__ import annotations

import traceback
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import logsumexp, softmax
from threadpoolctl import threadpool_limits

from bench.corpus import Corpus, InputError
from bench.fold import (
    TIMED_CAPTURES,
    FoldResult,
    decisions,
    fitted,
    footprint,
    forget_peak,
    latency,
    milliseconds,
    torch_threads,
)
from bench.scores import PREFIX, classes_of, subject_interval, windows
from models.inner import inner_folds

if TYPE_CHECKING:
    from bench.cells import Cell

FIRST_MS = 62.5
GROWTH = 2**0.5  # of what has been seen, from one instant to the next
INNER = "3"  # groups of training subjects, each left out once
THRESHOLDS = (*np.round(np.arange(0.05, 0.96, 0.05), 2).tolist(), 0.97, 0.98, 0.99, 0.995, 0.999, np.inf)
LEAST = 1e-6  # probability that is taken for impossible
HOTTEST = 100.0
TIMED_INSTANTS = 8


@dataclass(frozen=True)
class Replay:
    """How captures are replayed.

    Args:
        hop_ms: milliseconds from one decision to the next; None decides whenever 1.41 times as much has been seen,
            from 62.5 ms on.
        start: ``onset``, or ``middle``: the first half of each capture is not seen.
    """

    hop_ms: float | None = None
    start: str = "onset"

    def check(self, rate_hz: float) -> None:
        """Refuse what cannot be replayed.

        Raises:
            InputError: another start, or a hop below one frame.
        """
        if self.start not in ("onset", "middle"):
            raise InputError(f"start={self.start}: give onset or middle")
        if self.hop_ms is not None and not 1000 / rate_hz <= self.hop_ms < np.inf:
            raise InputError(
                f"hop_ms={self.hop_ms:g}: one frame takes {1000 / rate_hz:.4g} ms; give at least that, or leave it out"
            )

    def begun(self, corpus: Corpus) -> Corpus:
        """The captures from where the replay begins."""
        if self.start == "onset":
            return corpus
        skipped = corpus.lengths // 2
        return uncached(corpus, corpus.starts + skipped, corpus.lengths - skipped)

    def instants(self, longest: int, rate_hz: float) -> np.ndarray:
        """Frames seen at each decision, rising to ``longest``, int64 [instants]."""
        per_ms = rate_hz / 1000
        if self.hop_ms is not None:
            ms = self.hop_ms * np.arange(1, int(longest / per_ms / self.hop_ms) + 2)
        else:
            octaves = max(0.0, np.log2(longest / per_ms / FIRST_MS))
            ms = FIRST_MS * GROWTH ** np.arange(np.ceil(octaves / np.log2(GROWTH)) + 1)
        seen = np.floor(ms * per_ms + 1e-6).astype(np.int64)
        return np.unique(np.append(seen[(seen > 0) & (seen < longest)], longest))


def uncached(corpus: Corpus, starts: np.ndarray, lengths: np.ndarray) -> Corpus:
    """Parts of captures; without the digest, under which the features of whole captures are cached."""
    return replace(corpus, starts=starts, lengths=lengths, digest="", path=None)


def prefix(corpus: Corpus, frames: int) -> Corpus:
    """The first frames of each capture, at most ``frames``; no frame is copied."""
    if (corpus.lengths <= frames).all():
        return corpus
    return uncached(corpus, corpus.starts, np.minimum(corpus.lengths, frames))


def replayed(estimator: object, corpus: Corpus, fold: str, positions: np.ndarray, instants: np.ndarray) -> pd.DataFrame:
    """The replay table of some captures, without ``confidence``; sorted by capture, then instant.

    A system that decides per window has the mean probability of its windows so far.

    Args:
        estimator: fitted.
        corpus: captures from where the replay begins.
        fold: what the rows are called.
        positions: which captures.
        instants: frames seen at each decision, rising.
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
        rows = table.drop_duplicates("capture").set_index("capture").loc[corpus.index[alive]].reset_index()
        rows[columns] = mean.to_numpy()
        parts.append(rows.assign(start=0, frames=seen.lengths[alive], instant=frames))
        before = frames
    table = pd.concat(parts, ignore_index=True)
    return table.sort_values(["capture", "instant"], kind="stable", ignore_index=True)


@dataclass(frozen=True)
class Calibration:
    """Temperature scaling (Guo et al. 2017) with a temperature that changes with what has been seen.

    Probabilities become softmax(log p / T), where log T goes in a straight line over log milliseconds from the first
    instant to the last. One temperature for all instants would trust early decisions too much, and one for each would
    rest on few captures at late instants.

    Args:
        first_ms: what has been seen at the first instant; before it T stays the same.
        last_ms: and at the last, after which T stays the same.
        first: temperature at the first instant.
        last: and at the last.
    """

    first_ms: float
    last_ms: float
    first: float
    last: float

    @classmethod
    def fit(cls, proba: np.ndarray, true: np.ndarray, ms: np.ndarray) -> Calibration:
        """Maximum likelihood over decisions; temperatures stay within 1/100 and 100.

        Args:
            proba: probabilities [decisions, classes].
            true: column of the true class, int [decisions].
            ms: what each decision had seen [decisions].
        """
        logs = np.log(np.maximum(proba, LEAST))
        place = _place(ms, ms.min(), ms.max())
        rows = np.arange(len(logs))

        def loss(ends: np.ndarray) -> tuple[float, np.ndarray]:
            sharp = np.exp(-(ends[0] * (1 - place) + ends[1] * place))
            scaled = sharp[:, None] * logs
            total = logsumexp(scaled, axis=1)
            expected = (np.exp(scaled - total[:, None]) * logs).sum(axis=1)
            slope = -sharp * (expected - logs[rows, true])  # of the loss in log T
            return (total - scaled[rows, true]).mean(), np.array([(slope * (1 - place)).mean(), (slope * place).mean()])

        most = np.log(HOTTEST)
        first, last = np.exp(minimize(loss, np.zeros(2), jac=True, method="L-BFGS-B", bounds=[(-most, most)] * 2).x)
        return cls(float(ms.min()), float(ms.max()), float(first), float(last))

    def __call__(self, proba: np.ndarray, ms: np.ndarray) -> np.ndarray:
        """Calibrated probabilities [decisions, classes] of decisions that had seen ``ms``."""
        place = _place(ms, self.first_ms, self.last_ms)
        temperature = np.exp(np.log(self.first) * (1 - place) + np.log(self.last) * place)
        return softmax(np.log(np.maximum(proba, LEAST)) / temperature[:, None], axis=1)


def _place(ms: np.ndarray, first: float, last: float) -> np.ndarray:
    """Where each time lies between first (0) and last (1) on a logarithmic scale."""
    return np.clip(np.log(ms / first) / np.log(last / first), 0, 1) if last > first else np.zeros(len(ms))


def with_confidence(table: pd.DataFrame, calibration: Calibration, rate_hz: float) -> pd.DataFrame:
    """A replay table with the calibrated probability of each decision's label."""
    proba = table[[PREFIX + c for c in classes_of(table)]].to_numpy(dtype=np.float64)
    ms = 1000 / rate_hz * table["frames"].to_numpy()
    return table.assign(confidence=calibration(proba, ms).max(axis=1))


def standing(table: pd.DataFrame, frames: int) -> pd.DataFrame:
    """The decision of each capture that stands when ``frames`` could have been seen, with its label."""
    return windows(table[table["instant"] <= frames].groupby(["fold", "capture"], sort=False).tail(1))


def stopped(table: pd.DataFrame, threshold: float) -> pd.DataFrame:
    """The first decision of each capture whose confidence reaches the threshold, else its last, with its label."""
    keys = [table["fold"], table["capture"]]
    reached = (table["confidence"] >= threshold).astype(int)
    before = reached.groupby(keys, sort=False).cumsum() - reached
    return windows(table[before == 0].groupby(["fold", "capture"], sort=False).tail(1))


def learn_stopping(table: pd.DataFrame, rate_hz: float) -> tuple[float, pd.DataFrame]:
    """The threshold that saves most time for what training subjects show to be no loss.

    Args:
        table: replay of training captures by systems that their subjects had no part in, with ``confidence``.
        rate_hz: frames per second.

    Returns:
        The threshold with the smallest mean observed time whose accuracy, as a mean over subjects, is not below that of
        whole captures by more than one standard error of the difference; and what each threshold of the series gives.
    """
    whole = _hits(stopped(table, np.inf))
    rows = []
    for threshold in THRESHOLDS:
        rowed = stopped(table, threshold)
        lost = (whole - _hits(rowed)).to_numpy()
        error = lost.std(ddof=1) / np.sqrt(len(lost)) if len(lost) > 1 else 0.0
        rows.append(
            {
                "threshold": threshold,
                "accuracy": (rowed["true"] == rowed["predicted"]).mean(),
                "lost": lost.mean(),
                "error": error,
                "mean_ms": 1000 / rate_hz * rowed["frames"].mean(),
            }
        )
    series = pd.DataFrame(rows)
    allowed = series[series["lost"] <= series["error"] + 1e-12]
    best = allowed.sort_values(["mean_ms", "threshold"], ascending=[True, False], kind="stable").iloc[0]
    return float(best["threshold"]), series


def _hits(labelled: pd.DataFrame) -> pd.Series:
    """Accuracy of each subject."""
    return (labelled["true"] == labelled["predicted"]).groupby(labelled["subject"]).mean()


def by_instant(table: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Accuracy of the standing decisions at every instant, with ``ms`` and ``mean_ms``, as shorter captures end."""
    instants = np.sort(table["instant"].unique())
    return pd.DataFrame(
        {"ms": 1000 / rate_hz * frames} | _scored(standing(table, frames), rate_hz) for frames in instants
    )


def by_threshold(table: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Accuracy and mean observed time of stopping at every threshold of the series."""
    return pd.DataFrame({"threshold": t} | _scored(stopped(table, t), rate_hz) for t in THRESHOLDS)


def learned_point(table: pd.DataFrame, thresholds: dict[str, float], rate_hz: float) -> dict[str, float]:
    """Accuracy and mean observed time where each fold stops at the threshold that its training part gave."""
    parts = [stopped(rows, thresholds[fold]) for fold, rows in table.groupby("fold", sort=False)]
    return _scored(pd.concat(parts, ignore_index=True), rate_hz)


def _scored(labelled: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    low, high = subject_interval(labelled)
    subjects = _hits(labelled)
    return {
        "mean_ms": 1000 / rate_hz * labelled["frames"].mean(),
        "accuracy": (labelled["true"] == labelled["predicted"]).mean(),
        "low": low,
        "high": high,
        "subject_mean": subjects.mean(),
        "subject_sd": subjects.std(ddof=1),
    }


def stream_fold(
    cell: Cell, corpus: Corpus, name: str, train: np.ndarray, test: np.ndarray, threads: int, replay: Replay
) -> FoldResult:
    """Fit on whole training captures, replay the test captures; calibration and threshold see training subjects only.

    ``trials`` of the result is what each threshold gives on training subjects, ``chosen`` what was learned from them.
    """
    forget_peak()
    try:
        begun = replay.begun(corpus)
        instants = replay.instants(int(begun.lengths.max()), corpus.rate_hz)
        estimator = cell.estimator()
        with threadpool_limits(threads):
            torch_threads(threads)
            calibration, threshold, series = learned(cell, corpus, train, replay)
            metrics = fitted(estimator, corpus[train])
            table = with_confidence(replayed(estimator, begun, name, test, instants), calibration, corpus.rate_hz)
        with threadpool_limits(1):
            torch_threads(1)
            whole, *_ = latency(estimator, corpus[test], int(corpus.lengths.max()))
            decide = decision_latency(estimator, begun[test], instants)
    except Exception:  # whatever a system raises is this fold's result, not the end of the run
        return FoldResult(name, error=traceback.format_exc())
    metrics |= footprint(estimator, corpus)
    if hop := system_hop(estimator, corpus[train]):
        metrics["system_hop_ms"] = 1000 / corpus.rate_hz * hop
    chosen = {"threshold": threshold} | {f"temperature_{k}": v for k, v in asdict(calibration).items()}
    return FoldResult(name, table, metrics, whole, decide, chosen=chosen, trials=series)


def learned(cell: Cell, corpus: Corpus, train: np.ndarray, replay: Replay) -> tuple[Calibration, float, pd.DataFrame]:
    """Calibration and threshold from the training part, each of its subjects replayed by a system that never met it.

    Nothing of another capture is looked at.
    """
    part = corpus[train]
    begun = replay.begun(part)
    instants = replay.instants(int(begun.lengths.max()), corpus.rate_hz)
    tables = []
    for inner, judged in inner_folds(part.subjects.astype(str), INNER):
        estimator = cell.estimator().fit(part[inner], part.gestures[inner])
        tables.append(replayed(estimator, begun, "", judged, instants))
    table = pd.concat(tables, ignore_index=True)
    classes = classes_of(table)
    true = np.searchsorted(classes, table["true"].to_numpy(dtype=str))
    ms = 1000 / corpus.rate_hz * table["frames"].to_numpy()
    proba = table[[PREFIX + c for c in classes]].to_numpy(dtype=np.float64)
    calibration = Calibration.fit(proba, true, ms)
    return calibration, *learn_stopping(with_confidence(table, calibration, corpus.rate_hz), corpus.rate_hz)


def decision_latency(estimator: object, begun: Corpus, instants: np.ndarray) -> list[float]:
    """Milliseconds from raw frames to a decision: one prefix at a time, warm, over the instants of single captures."""
    chosen = np.unique(np.linspace(0, len(begun) - 1, min(TIMED_CAPTURES, len(begun))).astype(int))
    seen = instants[np.unique(np.linspace(0, len(instants) - 1, TIMED_INSTANTS).astype(int))]
    spent = []
    for i in chosen:
        for frames in np.unique(np.minimum(seen, begun.lengths[i])):  # its end is a decision, too
            spent.append(milliseconds(estimator.predict, prefix(begun[i : i + 1], frames).detached())[0])
    return spent


def system_hop(estimator: object, captures: Corpus) -> float | None:
    """Frames from one decision of a system to the next, None for one that decides once whatever it is given."""
    if not hasattr(estimator, "decide"):
        return None
    longest = int(captures.lengths.argmax())
    starts = np.unique(estimator.decide(captures[longest : longest + 1])[0]["start"])
    return float(np.median(np.diff(starts))) if len(starts) > 1 else None
