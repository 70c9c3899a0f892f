"""One system in a fold, in a worker process: fit, predict, measure."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench import contract
from bench.corpora.corpus import COPY, Corpus
from bench.errors import PredictionError
from bench.ground.timing import Times, timed, timed_once
from bench.models.sizes import sizes

AGAIN = 32  # test captures of a fold that are predicted again, in a batch and an order of their own
ALONE = 8  # of these, predicted alone as well: for some systems one capture takes as long as all together
TOLERANCE = 1e-3  # of a probability: float32 rounds otherwise in a batch of another size
TIMED_CAPTURES = 5
WARM_UP = 1


@contextmanager
def computing(threads: int) -> Iterator[None]:
    """Limit computing to so many threads; libraries that are not loaded yet are not reached.

    PyTorch keeps its own count, which threadpoolctl does not reach.
    """
    with threadpool_limits(threads):
        if torch := sys.modules.get("torch"):
            torch.set_num_threads(threads)
        yield


def fitted(estimator: contract.System, corpus: Corpus) -> dict[str, float]:
    """Fit to all captures of a corpus; its seconds, as `seconds_of` has them.

    Of a system that searches, the last fit alone: the search before it may have been stored in part.
    """
    counted = partial(contract.fit_seconds, estimator)
    return seconds_of(
        "fit", *timed_once(partial(estimator.fit, corpus, corpus.gestures), counted)[1:]
    )


def seconds_of(name: str, times: Times, cpu_ms: float) -> dict[str, float]:
    """Seconds of work that was done once: on the quiet machine, by the wall clock, and of the processor."""
    spent = (times.ms[0], times.wall_ms[0], cpu_ms)
    return {
        f"{name}{kind}_seconds": ms / 1000
        for kind, ms in zip(("", "_wall", "_cpu"), spent, strict=True)
    }


def footprint(estimator: contract.System, corpus: Corpus) -> dict[str, float]:
    """Most memory that this process has held since `forget_peak`, and the sizes of a fitted system."""
    taxels = corpus.grid[0] * corpus.grid[1]
    return {"peak_rss_bytes": peak_memory(), **sizes(estimator, taxels, int(corpus.lengths.max()))}


def forget_peak() -> None:
    """Begin anew to watch for the most memory that this process holds: a worker runs fold after fold.

    Only Linux can do this. Elsewhere the peak is that of the whole process, which may have run larger systems before.
    """
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory() -> int:
    """Most bytes of memory that this process has held at once."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("VmHWM:")).split()[1])
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else 1024 * most


def decisions(
    estimator: contract.System,
    corpus: Corpus,
    fold: str,
    test: np.ndarray,
    classes: list[str] | None = None,
) -> pd.DataFrame:
    """The predictions table of one fold, described in `bench.values.scores`.

    Its classes are those of the corpus, unless they are given, sorted.
    """
    tested = corpus[test]
    table, proba = contract.decide(estimator, tested)
    position = table["capture"].to_numpy()
    if len(without := np.setdiff1d(np.arange(len(tested)), position)):
        raise ValueError(f"there is no decision on capture {tested.index[without[0]]}")
    start = (
        table["start"].to_numpy() + tested.piece[position] % COPY
    )  # of a window that is split as a capture
    table = table.assign(
        fold=fold, capture=tested.index[position], start=start, true=tested.gestures[position]
    )
    about = tested.captures.drop(columns=tested.target if tested.target == "gesture" else [])
    about = about.iloc[position].reset_index(drop=True)
    names = np.unique(corpus.gestures.astype(str) if classes is None else classes)
    columns = np.zeros((len(table), len(names)), dtype=np.float32)
    columns[:, np.searchsorted(names, np.asarray(estimator.classes_).astype(str))] = proba
    if not np.isfinite(columns).all():
        raise ValueError(f"{int((~np.isfinite(columns)).sum())} probabilities are not finite")
    named = pd.DataFrame(columns, columns=[f"p_{c}" for c in names])
    return pd.concat([table[["fold", "capture", "start", "frames", "true"]], about, named], axis=1)


def disagreement(estimator: contract.System, tested: Corpus, decided: Decided | None = None) -> str:
    """The captures that ``predict`` labels otherwise than the probabilities do, in words; empty if there is none.

    A label agrees if its probability is the highest within `TOLERANCE`, on average or in one decision on the capture,
    as of a system that votes. Where a system abstains in its probabilities, each label agrees.
    """
    decided, names = decided or _decided(estimator, tested), _names(estimator)
    found = []
    for place, label in enumerate(contract.labels(estimator, tested)):
        own = decided.of(place).proba
        every = np.vstack([own, own.mean(axis=0)])
        given = every[:, names.index(label)] if label in names else -1.0
        if not (every.max(axis=1) - given <= TOLERANCE).any() and every.any():
            found.append((tested.index[place], str(label), names[int(every[-1].argmax())]))
    if not found:
        return ""
    capture, label, probable = found[0]
    return (
        f"predict and the probabilities disagree on {len(found)} of {len(tested)} captures; on capture {capture}, "
        f"predict gives {label!r} and {probable!r} has the highest probability; the columns of probabilities need the "
        "order of classes_; without predict_proba, the labels of predict count"
    )


def batch_effects(
    estimator: contract.System,
    corpus: Corpus,
    test: np.ndarray,
    predictions: pd.DataFrame | None = None,
    parts: int = 1,
) -> list[str]:
    """Test captures whose prediction depends on the captures that are predicted together with them.

    Some test captures are copied out of the corpus, so that no cache knows them, and predicted together in reverse
    order, without the others, and some of them alone. Their windows and labels must be those of the fold, their
    probabilities within 0.001. A fold has several ``parts``, which share the work.
    """
    if predictions is None:
        predictions = decisions(estimator, corpus, "", test)
    chosen, names = some_of(test, -(-AGAIN // parts))[::-1], _names(estimator)
    alone = {*some_of(chosen, ALONE).tolist()}
    together = _decided(estimator, corpus[chosen].detached())
    expected = Decided.from_table(
        predictions, predictions[[f"p_{name}" for name in names]].to_numpy()
    )
    effects = []
    for place, position in enumerate(chosen):
        capture = corpus.index[position]
        rows, again = expected.of(capture), {"in another order": together.of(place)}
        rows = rows._replace(start=rows.start - corpus.piece[position] % COPY)
        if position in alone:
            again = {"alone": _decided(estimator, corpus[[position]].detached()), **again}
        for how, other in again.items():
            if effect := _difference(rows, other, names):
                one = corpus[[position]].detached()
                if _difference(_decided(estimator, one), _decided(estimator, one), names):
                    effects.append(f"capture {capture} is predicted differently each time")
                else:
                    before, now = effect
                    effects.append(
                        f"capture {capture} has {now} {how}, {before} among {len(test)} test captures"
                    )
                break
    return effects


def check_agreement(
    estimator: contract.System,
    corpus: Corpus,
    test: np.ndarray,
    predictions: pd.DataFrame | None = None,
) -> None:
    """Verify on a few test captures that ``predict`` and the probabilities agree."""
    tested, decided = corpus[some_of(test, ALONE)], None
    if predictions is not None:
        rows = predictions[predictions["capture"].isin(tested.index)]
        place = pd.Index(tested.index).get_indexer(rows["capture"])
        names = [f"p_{name}" for name in _names(estimator)]
        decided = Decided.from_table(rows.assign(capture=place), rows[names].to_numpy())
    if words := disagreement(estimator, tested, decided):
        raise PredictionError(words)


def some_of(test: np.ndarray, most: int) -> np.ndarray:
    """At most so many of the positions of test captures, evenly spread."""
    return test[np.unique(np.linspace(0, len(test) - 1, min(most, len(test))).astype(int))]


class Decided(NamedTuple):
    """Decisions on some captures: arrays [decisions], and float64 probabilities [decisions, classes]."""

    capture: np.ndarray
    start: np.ndarray
    frames: np.ndarray
    proba: np.ndarray

    @classmethod
    def from_table(cls, table: pd.DataFrame, proba: np.ndarray) -> Decided:
        """From a table with these columns, such as `bench.contract.decide` gives, and the probabilities beside it."""
        capture, start, frames = (table[name].to_numpy() for name in ("capture", "start", "frames"))
        return cls(capture, start, frames, np.asarray(proba, dtype=np.float64))

    def of(self, capture: object) -> Decided:
        """The decisions on one capture."""
        rows = self.capture == capture
        return Decided(*(values[rows] for values in self))


def _decided(estimator: contract.System, corpus: Corpus) -> Decided:
    """All captures predicted together."""
    return Decided.from_table(*contract.decide(estimator, corpus))


def _names(estimator: contract.System) -> list[str]:
    return np.asarray(estimator.classes_).astype(str).tolist()


def _difference(before: Decided, now: Decided, names: list[str]) -> tuple[str, str] | None:
    """What decisions on one capture do not have in common, in words; None if they agree."""
    if len(before.proba) != len(now.proba):
        return f"{len(before.proba)} decisions", f"{len(now.proba)}"
    what = ("a window that begins at frame", "a window with a number of frames of")
    for words, old, new in zip(what, before[1:3], now[1:3], strict=True):
        if (moved := old != new).any():
            first = int(moved.argmax())
            return f"{words} {old[first]}", f"{words} {new[first]}"
    one, other = _label(now.proba), _label(before.proba)
    if one != other:
        return f"label {names[other]}", f"label {names[one]}"
    if np.abs(before.proba - now.proba).max() <= TOLERANCE:
        return None
    old, new = before.proba[:, one].mean(), now.proba[:, one].mean()
    return f"label {names[one]} with {old:.3f}", f"label {names[one]} with {new:.3f}"


def _label(proba: np.ndarray) -> int:
    """Index of the class with the highest mean probability."""
    return int(np.float32(proba).mean(axis=0).argmax())


def latency(
    estimator: contract.System, tested: Corpus, frames: int
) -> tuple[list[float], list[float], dict[str, list[float]], dict[str, float]]:
    """Milliseconds from raw frames to a label, one capture at a time, warm, on one thread (`bench.ground.timing`).

    For each timed capture as a whole, and for no more of it than one decision needs (timed once where this is all of
    it); both by the wall clock, by name; and ``predict_relative``, the mean time of a whole capture as a multiple of
    the reference workload's, with `paced`.
    """
    chosen = some_of(np.arange(len(tested)), TIMED_CAPTURES)
    whole = [contract.blinded(estimator, tested[i : i + 1].detached()) for i in chosen]
    first = [one.changed(lengths=np.minimum(one.lengths, frames)) for one in whole]
    for one in (whole * WARM_UP)[:WARM_UP]:
        estimator.predict(one)
    predict = decide = timed(partial(estimator.predict, one) for one in whole)
    if any(len(early.frames) < len(one.frames) for early, one in zip(first, whole, strict=True)):
        decide = timed(partial(estimator.predict, one) for one in first)
    walls = {"predict_wall_ms": predict.wall_ms, "decide_wall_ms": decide.wall_ms}
    relative = float(np.mean(predict.ms)) / predict.quiet_ms
    return predict.ms, decide.ms, walls, paced(predict) | {"predict_relative": relative}


def paced(times: Times) -> dict[str, float]:
    """How fast the machine was: the reference workload's milliseconds, now and at best, and how busy it was."""
    return {
        "reference_ms": times.reference_ms,
        "quiet_ms": times.quiet_ms,
        "slowdown": times.slowdown,
    }
