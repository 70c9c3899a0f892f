"""How cheap may the inner protocol be: what each picks for jung2017_svm_rbf, how good it is, and how long it takes.

Every outer fold of LOSO is searched over the published grid of 110 points with each inner protocol, with and without
giving up what is worse. A pick is judged by the test subject; ``to loso`` is the mean difference over test subjects to
what the papers do, with its standard error. The row ``best fixed`` is the one point that is best over all test
subjects, which no honest search can know.

    OMP_NUM_THREADS=1 python benchmarks/bench_tuning.py haart
    OMP_NUM_THREADS=1 python benchmarks/bench_tuning.py synth 3,loso on
"""

import sys
from collections import Counter

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from bench.corpora.library import open_corpus
from bench.features.jung54 import Jung54
from bench.models.classic.jung2014 import PENALTIES
from bench.models.classic.jung2017 import WIDTHS, jung2017_svm_rbf
from bench.models.classic.svm import svm
from bench.models.search import study
from bench.protocols.subjects import LOSO


def one(corpus: object, inner: str, worse: float, train: np.ndarray, test: np.ndarray) -> dict:
    """Search in one outer fold."""
    study.WORSE = worse
    search = jung2017_svm_rbf(inner)
    X = corpus[train]
    search.fit(X, X.gestures)
    hit = search.predict(corpus[test]) == corpus.gestures[test]
    states = search.trials_["state"].value_counts()
    return {
        "inner": inner,
        "given up at p": worse,
        "accuracy": hit.mean(),
        "seconds": search.search_seconds_,
        "given up": states.get("pruned", 0),
        "pick": (search.chosen_["svm.C"], search.chosen_["svm.gamma"]),
    }


def fixed(table: pd.DataFrame, corpus: object, C: float, gamma: float, folds: list) -> float:
    """Mean accuracy of the test subjects with one point for all folds."""
    hits = []
    for train, test in folds:
        model = svm("passthrough", C, gamma).fit(table.iloc[train], corpus.gestures[train])
        hits.append((model.predict(table.iloc[test]) == corpus.gestures[test]).mean())
    return float(np.mean(hits))


def main(name: str, inners: str = "2,3,5,loso", giving_up: str = "on,off") -> None:
    """Print one line per inner protocol, the last of which is the one to compare with."""
    small = {"subjects": 12, "repetitions": 2} if name == "synth" else {}
    corpus = open_corpus(name, small).detached()
    folds = list(LOSO().split(corpus))
    print(f"{name}: {len(corpus)} captures, {len(folds)} subjects, LOSO, {len(PENALTIES) * len(WIDTHS)} points")
    levels = [{"on": study.WORSE, "off": 0.0}[word] for word in giving_up.split(",")]
    jobs = [(inner, worse, *fold) for inner in inners.split(",") for worse in levels for fold in folds]
    rows = pd.DataFrame(Parallel(2)(delayed(one)(corpus, *job) for job in jobs))
    reference = rows["accuracy"].to_numpy()[-len(folds) :]
    for (inner, worse), part in rows.groupby(["inner", "given up at p"], sort=False):
        lost = 100 * (part["accuracy"].to_numpy() - reference)
        (C, gamma), often = Counter(part["pick"]).most_common(1)[0]
        print(
            f"inner={inner:4}  giving up {'on ' if worse else 'off'}  "
            f"accuracy {100 * part['accuracy'].mean():.1f} ± {100 * part['accuracy'].std():.1f}  "
            f"to loso {lost.mean():+.1f} ± {lost.std(ddof=1) / np.sqrt(len(lost)):.1f}  "
            f"{part['seconds'].mean():6.1f} s a fold  given up {part['given up'].mean():.0f}  "
            f"most often C 2^{np.log2(C):.0f} gamma 2^{np.log2(gamma):.0f} ({often} folds)"
        )
    table = Jung54().fit_transform(corpus)
    points = [(C, gamma) for C in PENALTIES for gamma in WIDTHS]
    means = Parallel(2)(delayed(fixed)(table, corpus, *point, folds) for point in points)
    C, gamma = points[int(np.argmax(means))]
    print(f"best fixed point C 2^{np.log2(C):.0f} gamma 2^{np.log2(gamma):.0f}: {100 * max(means):.1f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
