"""One system in a fold, in a worker process: fit, predict, measure."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench import contract
from bench.corpora.corpus import COPY, Corpus, shared_frames
from bench.errors import PredictionError
from bench.ground.timing import Times, time_once, time_repeatedly
from bench.models.sizes import measure_sizes

AGAIN = 32  # test captures of a fold that are predicted again, in another batch and order
ALONE = 8  # of these, also predicted alone, which takes some systems as long as all together
TOLERANCE = 1e-3  # of a probability: float32 rounds differently in another batch
TIMED_CAPTURES = 5
WARM_UP = 1
DECIMAL_BITS = 16  # of a reading that is no whole number


class FittedSystem(NamedTuple):
    """A fitted system, and the `seconds_metrics` of its fit."""

    system: contract.System
    metrics: dict[str, float]


@contextmanager
def limit_threads(threads: int) -> Iterator[None]:
    """Limit computing to some threads; libraries that are loaded later are not limited.

    PyTorch keeps its own count, which threadpoolctl does not reach.
    """
    with threadpool_limits(threads):
        if torch := sys.modules.get("torch"):
            torch.set_num_threads(threads)
        yield


def fit_timed(system: contract.System, corpus: Corpus) -> dict[str, float]:
    """Fit a system to all captures of a corpus; return its `seconds_metrics`.

    Of a search they are those of the last fit: trials before it may be read from a file.
    """
    fit = partial(contract.fit_system, system, corpus, corpus.gestures)
    _, times, cpu_ms = time_once(fit, partial(contract.reported_fit_seconds, system))
    return seconds_metrics("fit", times, cpu_ms)


def fit_together_timed(
    systems: Sequence[contract.System], parts: Sequence[Corpus]
) -> list[FittedSystem | Exception]:
    """Fit systems at once, each to captures of its own; each has an equal share of the seconds.

    Returns:
        Each fitted system, or why it failed.
    """
    count = len(systems)
    failures, times, cpu_ms = time_once(
        partial(contract.fit_together, systems, parts),
        lambda wall, cpu: (wall / count, cpu / count),
    )
    metrics = seconds_metrics("fit", times, cpu_ms)
    pairs = zip(systems, failures, strict=True)
    return [failure or FittedSystem(system, metrics) for system, failure in pairs]


def seconds_metrics(name: str, times: Times, cpu_ms: float) -> dict[str, float]:
    """Seconds of work done once: on the quiet machine, by the wall clock, and of the processor."""
    milliseconds = {"": times.ms[0], "_wall": times.wall_ms[0], "_cpu": cpu_ms}
    return {f"{name}{clock}_seconds": ms / 1000 for clock, ms in milliseconds.items()}


def memory_metrics(system: contract.System, corpus: Corpus) -> dict[str, float]:
    """Measure the sizes of a fitted system, and the memory peak since `reset_peak_memory`."""
    peak = peak_memory()  # before sizes are counted, which takes memory, too
    taxels = corpus.grid[0] * corpus.grid[1]
    sizes = measure_sizes(system, taxels, int(corpus.lengths.max()))
    return {"peak_rss_bytes": peak, **sizes, **skin_metrics(corpus)}


def skin_metrics(corpus: Corpus) -> dict[str, float]:
    """Costs of the skin: taxels, wires, values and bits per second, and bytes of a frame."""
    rows, cols = corpus.grid
    is_whole = shared_frames(corpus)[0].dtype.kind in "iu"
    bits = int(corpus.full_scale).bit_length() if is_whole else DECIMAL_BITS
    costs = {"taxels": rows * cols, "wires": rows + cols, "bits": bits}
    costs |= corpus.info.get("skin_costs", {})  # of a design
    values, bits = costs["taxels"] * corpus.rate_hz, costs.pop("bits")
    frame_bytes = costs["taxels"] * -(-bits // 8)
    rates = {"values_per_s": values, "bits_per_s": values * bits}
    return costs | rates | {"frame_bytes": frame_bytes}


def reset_peak_memory() -> None:
    """Reset this process's memory peak: a worker runs fold after fold.

    Only Linux can do this. Elsewhere the peak may be that of an earlier, larger system.
    """
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory() -> int:
    """Memory peak of this process, in bytes."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("VmHWM:")).split()[1])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def predict_to_table(
    system: contract.System,
    corpus: Corpus,
    fold: str,
    test: np.ndarray,
    classes: list[str] | None = None,
) -> pd.DataFrame:
    """Predict test captures; return a predictions table (`bench.values.scores`).

    Args:
        system: a fitted system.
        corpus: captures.
        fold: name of the fold.
        test: positions of the captures to predict.
        classes: columns of probabilities, sorted; None for the classes of the corpus.

    Raises:
        ValueError: a capture has no decision, or a probability is not finite.
    """
    tested = corpus[test]
    decisions, proba = contract.predict_decisions(system, tested)
    position = decisions["capture"].to_numpy()
    if len(missing := np.setdiff1d(np.arange(len(tested)), position)):
        raise ValueError(f"there is no decision on capture {tested.index[missing[0]]}")
    names = np.unique(corpus.gestures.astype(str) if classes is None else classes)
    columns = np.zeros((len(decisions), len(names)), dtype=np.float32)
    columns[:, np.searchsorted(names, _class_names(system))] = proba
    if not np.isfinite(columns).all():
        raise ValueError(f"{int((~np.isfinite(columns)).sum())} probabilities are not finite")
    table = decisions.assign(
        fold=fold,
        capture=tested.index[position],
        start=decisions["start"].to_numpy() + tested.piece[position] % COPY,  # in its capture
        true=tested.gestures[position],
    )[["fold", "capture", "start", "frames", "true"]]
    captures = tested.captures.iloc[position].reset_index(drop=True)
    if tested.target == "gesture":
        captures = captures.drop(columns="gesture")
    return pd.concat(
        [table, captures, pd.DataFrame(columns, columns=[f"p_{name}" for name in names])], axis=1
    )


def describe_disagreement(system: contract.System, tested: Corpus) -> str:
    """Say on which captures ``predict`` and the probabilities disagree; "" if they agree.

    A label agrees if its probability is the highest within `TOLERANCE`, on average or in one
    decision on the capture, as of a system that votes. Where a system abstains, each label agrees.
    """
    decisions, names = _predict_together(system, tested), _class_names(system)
    wrong = []
    for place, label in enumerate(contract.predict_labels(system, tested)):
        rows = decisions.on_capture(place).proba
        proba = np.vstack([rows, rows.mean(axis=0)])
        of_label = proba[:, names.index(label)] if label in names else -1.0
        if not (proba.max(axis=1) - of_label <= TOLERANCE).any() and proba.any():
            wrong.append((tested.index[place], str(label), names[int(proba[-1].argmax())]))
    if not wrong:
        return ""
    capture, label, probable = wrong[0]
    return (
        f"predict and the probabilities disagree on {len(wrong)} of {len(tested)} captures; on "
        f"capture {capture}, predict gives {label!r} and {probable!r} has the highest probability; "
        "the columns of probabilities need the order of classes_; without predict_proba, the "
        "labels of predict count"
    )


def check_agreement(system: contract.System, corpus: Corpus, test: np.ndarray) -> None:
    """Verify on a few test captures that ``predict`` and the probabilities agree.

    Raises:
        PredictionError: they disagree.
    """
    if words := describe_disagreement(system, corpus[take_evenly(test, ALONE)]):
        raise PredictionError(words)


def find_batch_effects(
    system: contract.System,
    corpus: Corpus,
    test: np.ndarray,
    predictions: pd.DataFrame | None = None,
    parts: int = 1,
) -> list[str]:
    """Name test captures whose prediction depends on the captures predicted with them.

    Some test captures are copied out of the corpus, so that no cache knows them. They are predicted
    together in reverse order, without the others, and some of them alone. Their windows and labels
    must be those of the fold, their probabilities within 0.001.

    Args:
        system: the fitted system.
        corpus: captures.
        test: positions of the test captures.
        predictions: their predictions table; None to predict them here.
        parts: number of parts of the fold, which share the work.

    Returns:
        A sentence for each capture.
    """
    if predictions is None:
        predictions = predict_to_table(system, corpus, "", test)
    names = _class_names(system)
    proba = predictions[[f"p_{name}" for name in names]].to_numpy()
    in_fold = Decisions.from_table(predictions, proba)
    sample = take_evenly(test, -(-AGAIN // parts))[::-1]
    sample_alone = {*take_evenly(sample, ALONE).tolist()}
    reordered = _predict_together(system, corpus[sample].detach())
    effects = []
    for place, position in enumerate(sample):
        capture, alone = corpus.index[position], corpus[[position]].detach()
        before = in_fold.on_capture(capture)
        before = before._replace(start=before.start - corpus.piece[position] % COPY)
        again = {"in another order": reordered.on_capture(place)}
        if position in sample_alone:
            again = {"alone": _predict_together(system, alone), **again}
        for how, now in again.items():
            if not (difference := _describe_difference(before, now, names)):
                continue
            first, second = _predict_together(system, alone), _predict_together(system, alone)
            if _describe_difference(first, second, names):
                effects.append(f"capture {capture} is predicted differently each time")
            else:
                old, new = difference
                batch = f"among {len(test)} test captures"
                effects.append(f"capture {capture} has {new} {how}, {old} {batch}")
            break
    return effects


def take_evenly(values: np.ndarray, most: int) -> np.ndarray:
    """Take at most so many of some values, evenly spread."""
    places = np.linspace(0, len(values) - 1, min(most, len(values)))
    return values[np.unique(places.astype(int))]


class Decisions(NamedTuple):
    """Decisions on captures: arrays [decisions], float64 probabilities [decisions, classes]."""

    capture: np.ndarray
    start: np.ndarray
    frames: np.ndarray
    proba: np.ndarray

    @classmethod
    def from_table(cls, table: pd.DataFrame, proba: np.ndarray) -> Decisions:
        """Make decisions of a table with these columns, and the probabilities of its rows."""
        capture, start, frames = (table[name].to_numpy() for name in ("capture", "start", "frames"))
        return cls(capture, start, frames, np.asarray(proba, dtype=np.float64))

    def on_capture(self, capture: object) -> Decisions:
        """Return the decisions on one capture."""
        rows = self.capture == capture
        return Decisions(*(values[rows] for values in self))


def _predict_together(system: contract.System, corpus: Corpus) -> Decisions:
    """Predict all captures in one batch."""
    return Decisions.from_table(*contract.predict_decisions(system, corpus))


def _class_names(system: contract.System) -> list[str]:
    return np.asarray(system.classes_).astype(str).tolist()


def _describe_difference(
    before: Decisions, now: Decisions, names: list[str]
) -> tuple[str, str] | None:
    """Say how decisions on one capture differ, before and now; None if they agree."""
    if len(before.proba) != len(now.proba):
        return f"{len(before.proba)} decisions", f"{len(now.proba)}"
    windows = {"a window that begins at frame": (before.start, now.start)}
    windows["a window with a number of frames of"] = before.frames, now.frames
    for words, (old, new) in windows.items():
        if (moved := old != new).any():
            first = int(moved.argmax())
            return f"{words} {old[first]}", f"{words} {new[first]}"
    label, other = _label_index(now.proba), _label_index(before.proba)
    if label != other:
        return f"label {names[other]}", f"label {names[label]}"
    if np.abs(before.proba - now.proba).max() <= TOLERANCE:
        return None
    means = (decisions.proba[:, label].mean() for decisions in (before, now))
    old_words, new_words = (f"label {names[label]} with {mean:.3f}" for mean in means)
    return old_words, new_words


def _label_index(proba: np.ndarray) -> int:
    """Index of the class with the highest mean probability."""
    return int(np.float32(proba).mean(axis=0).argmax())


def measure_latency(
    system: contract.System, tested: Corpus, frames: int
) -> tuple[dict[str, list[float]], dict[str, float]]:
    """Time predictions of single captures, warm, on one thread (`bench.ground.timing`).

    One decision needs ``frames`` frames. If no capture is longer, both timings are one.

    Returns:
        Milliseconds from raw frames to a label: ``predict_ms`` of whole captures, ``decide_ms`` of
        the frames of one decision, and both by the wall clock. Also `pace_metrics`, and
        ``predict_relative``, the mean time of a whole capture in units of the reference workload's.
    """
    sample = take_evenly(np.arange(len(tested)), TIMED_CAPTURES)
    captures = [contract.blind_captures(system, tested[i : i + 1].detach()) for i in sample]
    for capture in captures[:WARM_UP]:
        system.predict(capture)
    predict = decide = time_repeatedly(partial(system.predict, one) for one in captures)
    if any(one.lengths[0] > frames for one in captures):
        starts = [one.with_fields(lengths=np.minimum(one.lengths, frames)) for one in captures]
        decide = time_repeatedly(partial(system.predict, one) for one in starts)
    times = {
        "predict_ms": predict.ms,
        "decide_ms": decide.ms,
        "predict_wall_ms": predict.wall_ms,
        "decide_wall_ms": decide.wall_ms,
    }
    relative = float(np.mean(predict.ms)) / predict.quiet_ms
    return times, pace_metrics(predict) | {"predict_relative": relative}


def pace_metrics(times: Times) -> dict[str, float]:
    """Speed of the machine: ms of the reference workload, now and at best, and its slowdown."""
    return {name: getattr(times, name) for name in ("reference_ms", "quiet_ms", "slowdown")}
