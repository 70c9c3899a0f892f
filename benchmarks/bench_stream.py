"""What a replay costs, and which temperature makes confidence on prefixes honest.

For the first folds of LOSO: seconds of the inner fits and replays, of the fit, of the replay and of the timing. Then
log loss and expected calibration error (ten bins of equal counts) of the test subjects' decisions, raw and with one
temperature, with one that goes in a line over log milliseconds (what ``bench stream`` does), and with one for each
instant; all three are fitted to training subjects.

    OMP_NUM_THREADS=1 python benchmarks/bench_stream.py haart softmax 4
"""

import sys
import time

import numpy as np
import pandas as pd

from bench.corpora.library import open_corpus
from bench.models.search.inner_folds import inner_folds
from bench.plan.cells import cells
from bench.plan.plan import folds_of
from bench.scores import classes_of
from bench.work.replay import Calibration, Replay, decision_latency, replayed


def arrays(table: pd.DataFrame, rate_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Probabilities, column of the true class, milliseconds seen, and instant of every decision."""
    classes = classes_of(table)
    proba = table[[f"p_{c}" for c in classes]].to_numpy(dtype=float)
    true = np.searchsorted(classes, table["true"].to_numpy(dtype=str))
    return proba, true, 1000 / rate_hz * table["frames"].to_numpy(), table["instant"].to_numpy()


def judged(proba: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Log loss and expected calibration error."""
    loss = -np.log(np.maximum(proba[np.arange(len(true)), true], 1e-6)).mean()
    sure, hit = proba.max(axis=1), proba.argmax(axis=1) == true
    bins = np.array_split(np.argsort(sure), 10)
    return loss, sum(len(b) * abs(sure[b].mean() - hit[b].mean()) for b in bins) / len(true)


def main(data: str = "haart", model: str = "softmax", count: str = "3") -> None:
    """Print seconds per fold, and both measures of each way to calibrate."""
    (cell,) = cells({"data": data, "model": model})
    corpus = open_corpus(cell.data, cell.data_parameters)
    instants = Replay().instants(int(corpus.lengths.max()), corpus.rate_hz)
    found = []
    for fold in folds_of(cell, corpus)[: int(count)]:
        spent = [time.perf_counter()]
        part = corpus[fold.train]
        inner = [
            replayed(cell.estimator().fit(part[a], part.gestures[a]), part, "", b, instants)
            for a, b in inner_folds(part.subjects.astype(str), "3")
        ]
        spent.append(time.perf_counter())
        estimator = cell.estimator().fit(part, part.gestures)
        spent.append(time.perf_counter())
        table = replayed(estimator, corpus, fold.name, fold.test, instants)
        spent.append(time.perf_counter())
        decide = decision_latency(estimator, corpus[fold.test], instants)
        spent.append(time.perf_counter())
        print(
            f"fold {fold.name}: {{:.1f}} s inner, {{:.1f}} s fit, {{:.1f}} s replay, {{:.1f}} s timing".format(
                *np.diff(spent)
            )
            + f"; a decision {np.median(decide):.1f} ms",
            flush=True,
        )
        proba, true, ms, instant = arrays(pd.concat(inner), corpus.rate_hz)
        tested, label, seen, at = arrays(table, corpus.rate_hz)
        flat = np.full(len(ms), 1.0)
        ways = {
            "raw": tested,
            "one temperature": Calibration.fit(proba, true, flat)(tested, np.ones(len(seen))),
            "a line": Calibration.fit(proba, true, ms)(tested, seen),
            "one an instant": np.empty_like(tested),
        }
        for i in np.unique(at):
            here = instant == i
            fitted = Calibration.fit(proba[here], true[here], flat[here])
            ways["one an instant"][at == i] = fitted(tested[at == i], np.ones((at == i).sum()))
        found.append({name: judged(way, label) for name, way in ways.items()})
    for name in found[0]:
        loss, error = np.mean([row[name] for row in found], axis=0)
        print(f"{name:16} log loss {loss:.3f}, calibration error {100 * error:.1f} %")


if __name__ == "__main__":
    main(*sys.argv[1:])
