"""One system in a fold, in a worker process: fit, predict, measure."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench import contract
from bench.corpora.corpus import Corpus
from models.sizes import sizes

ALONE = 32  # test captures of a fold that are predicted alone, too
SOME = 8  # the same of captures that are damaged, or of which the beginning is seen
TOLERANCE = 1e-3  # of a probability: float32 rounds otherwise in a batch of another size
TIMED_CAPTURES = 20
WARM_UP = 3
REFERENCES = 8  # before the timed captures, and again after them


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
    """Fit to all captures of a corpus; its wall and CPU seconds.

    Of a system that searches, the last fit alone: the search before it may have been stored in part.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    estimator.fit(corpus, corpus.gestures)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    wall, cpu = contract.fit_seconds(estimator, wall, cpu)
    return {"fit_seconds": wall, "fit_cpu_seconds": cpu}


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
    estimator: contract.System, corpus: Corpus, fold: str, test: np.ndarray, classes: list[str] | None = None
) -> pd.DataFrame:
    """The predictions table of one fold, described in `bench.outcomes.scores`.

    Its classes are those of the corpus, unless they are given, sorted.
    """
    tested = corpus[test]
    table, proba = contract.decide(estimator, tested)
    position = table["capture"].to_numpy()
    if len(without := np.setdiff1d(np.arange(len(tested)), position)):
        raise ValueError(f"there is no decision on capture {tested.index[without[0]]}")
    table = table.assign(fold=fold, capture=tested.index[position], true=tested.gestures[position])
    about = tested.captures.drop(columns=tested.target if tested.target == "gesture" else [])
    about = about.iloc[position].reset_index(drop=True)
    names = np.unique(corpus.gestures.astype(str) if classes is None else classes)
    columns = np.zeros((len(table), len(names)), dtype=np.float32)
    columns[:, np.searchsorted(names, np.asarray(estimator.classes_).astype(str))] = proba
    if not np.isfinite(columns).all():
        raise ValueError(f"{int((~np.isfinite(columns)).sum())} probabilities are not finite")
    named = pd.DataFrame(columns, columns=[f"p_{c}" for c in names])
    return pd.concat([table[["fold", "capture", "start", "frames", "true"]], about, named], axis=1)


def batch_effects(
    estimator: contract.System,
    corpus: Corpus,
    test: np.ndarray,
    predictions: pd.DataFrame | None = None,
    most: int = ALONE,
) -> list[str]:
    """Test captures whose prediction depends on the captures that are predicted together with them.

    Some test captures are copied out of the corpus, so that no cache knows them, and predicted alone and together in
    reverse order. Their windows and labels must be those of the fold, their probabilities within 0.001.

    Args:
        estimator: fitted.
        corpus: the captures that the fold is of.
        test: positions of the test captures.
        predictions: table of `decisions` of all of them; made anew if not given.
        most: captures that are predicted again.

    Returns:
        One sentence per capture; none if every prediction depends on its own capture alone.
    """
    if predictions is None:
        predictions = decisions(estimator, corpus, "", test)
    chosen = test[np.unique(np.linspace(0, len(test) - 1, min(most, len(test))).astype(int))][::-1]
    together = _decided(estimator, corpus[chosen].detached())
    names = [f"p_{name}" for name in np.asarray(estimator.classes_).astype(str)]
    expected = predictions.groupby("capture", sort=False)
    effects = []
    for place, position in enumerate(chosen):
        capture = corpus.index[position]
        rows = expected.get_group(capture)[["start", "frames", *names]]
        one = corpus[[position]].detached()
        alone = _decided(estimator, one)
        ordered = together[together["capture"] == place]
        for how, table in (("alone", alone), ("in another order", ordered)):
            if effect := _difference(rows, table):
                if _difference(alone, _decided(estimator, one)):
                    effects.append(f"capture {capture} is predicted differently each time")
                else:
                    before, now = effect
                    effects.append(f"capture {capture} has {now} {how}, {before} among {len(test)} test captures")
                break
    return effects


def _decided(estimator: contract.System, corpus: Corpus) -> pd.DataFrame:
    """Decisions on some captures: capture, start, frames and a column ``p_<class>`` for each class."""
    table, proba = contract.decide(estimator, corpus)
    names = [f"p_{name}" for name in np.asarray(estimator.classes_).astype(str)]  # a class may be called capture
    values = pd.DataFrame(np.asarray(proba, dtype=np.float64), columns=names)
    places = table[["capture", "start", "frames"]].reset_index(drop=True)
    return pd.concat([places, values], axis=1)


def _difference(before: pd.DataFrame, now: pd.DataFrame) -> tuple[str, str] | None:
    """What two tables of decisions on one capture do not have in common, in words; None if they agree."""
    if len(before) != len(now):
        return f"{len(before)} decisions", f"{len(now)}"
    for name in ("start", "frames"):
        if (moved := before[name].to_numpy() != now[name].to_numpy()).any():
            first = int(moved.argmax())
            what = "a window that begins at frame" if name == "start" else "a window with a number of frames of"
            return f"{what} {before[name].iloc[first]}", f"{what} {now[name].iloc[first]}"
    old, new = (table.drop(columns=["start", "frames", "capture"], errors="ignore") for table in (before, now))
    if (one := _label(new)) != (other := _label(old)):
        return f"label {other}", f"label {one}"
    if np.abs(old.to_numpy() - new.to_numpy()).max() <= TOLERANCE:
        return None
    return f"label {one} with {old[f'p_{one}'].mean():.3f}", f"label {one} with {new[f'p_{one}'].mean():.3f}"


def _label(proba: pd.DataFrame) -> str:
    return str(proba.columns[int(np.float32(proba.to_numpy()).mean(axis=0).argmax())]).removeprefix("p_")


def latency(
    estimator: contract.System, tested: Corpus, frames: int
) -> tuple[list[float], list[float], dict[str, float]]:
    """Milliseconds from raw frames to a label, one capture at a time, warm, on one thread.

    Returns:
        One value per timed capture, for the whole capture and for no more of it than one decision needs; and
        ``predict_relative``, the processor time of labelling a whole capture as a multiple of ``reference_ms``, that of
        one `reference`. Other programs on the machine change the former and hardly the ratio.
    """
    chosen = np.unique(np.linspace(0, len(tested) - 1, min(TIMED_CAPTURES, len(tested))).astype(int))
    whole = [contract.blinded(estimator, tested[i : i + 1].detached()) for i in chosen]
    first = [one.changed(lengths=np.minimum(one.lengths, frames)) for one in whole]
    for _ in range(WARM_UP):
        reference()
    workload = [milliseconds(reference)[1] for _ in range(REFERENCES)]
    for one in (whole * WARM_UP)[:WARM_UP]:
        estimator.predict(one)
    timed = [milliseconds(estimator.predict, one) for one in whole]
    workload += [milliseconds(reference)[1] for _ in range(REFERENCES)]  # before and after: clocks change
    # Means, because some systems count processor time in steps of 15 ms.
    reference_ms, predict_ms = np.mean(workload), np.mean([cpu for _, cpu in timed])
    relative = {"reference_ms": float(reference_ms)}
    if reference_ms > 0:
        relative["predict_relative"] = float(predict_ms / reference_ms)
    return [wall for wall, _ in timed], [milliseconds(estimator.predict, one)[0] for one in first], relative


def reference() -> float:
    """A fixed piece of work of some milliseconds: matrix products, a sort, a spectrum, and Python with small arrays."""
    matrix = np.linspace(-1, 1, 96 * 96).reshape(96, 96)
    product = matrix
    for _ in range(10):
        product = matrix @ product
        product = product / np.abs(product).max()
    wave = np.sort(np.sin(np.arange(16384.0)))
    total = float(product.sum() + np.abs(np.fft.rfft(wave)).sum())
    for i in range(15000):
        total += i * 7 % 13
    for i in range(200):
        total += float(np.asarray([total, i]).mean() > 0)
    return total


def milliseconds(work: Callable, *arguments: object) -> tuple[float, float]:
    """Milliseconds of the wall clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    work(*arguments)
    cpu = time.process_time() - cpu
    return (time.perf_counter() - wall) * 1000, cpu * 1000
