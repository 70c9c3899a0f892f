"""`auto` against FLAML and AutoGluon: the same features, inner subjects, budgets and core.

Each outer fold is a process of its own with one thread. FLAML and AutoGluon are given the table of `touch` and
`jung54` of whole captures, computed beforehand, and three groups of training subjects to judge by, the groups that
`auto` has. `auto` is given captures of a stored corpus whose tables of whole captures are kept; windows it computes
itself, within its budget. Bytes in flash are counted for `auto` (`bench.models.sizes`); of the others the pickled size.

    pip install -e '.[automl]'
    python benchmarks/bench_auto.py haart loso 10,30,60 auto,flaml,autogluon 2 results.csv
"""

import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.model_selection import GroupKFold

TOOLS = ("auto", "flaml", "autogluon")
SYNTH = {  # grid, rate: three skins
    "cost": {"subjects": 12, "repetitions": 1, "seed": 5},
    "coarse": {"subjects": 12, "repetitions": 1, "rows": 6, "cols": 6, "rate_hz": 12.0, "seed": 6},
    "wide": {"subjects": 12, "repetitions": 1, "rows": 19, "cols": 24, "rate_hz": 30.0, "seed": 7},
}


def corpus_of(name: str) -> object:
    """A stored corpus; the generated ones are stored under their own names."""
    from bench.corpora.library import open_corpus

    return open_corpus("synth", SYNTH[name]) if name in SYNTH else open_corpus(name, {})


def outer_folds(corpus: object, protocol: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """LOSO, or so many groups of subjects."""
    who = corpus.subjects.astype(str)
    count = len(set(who)) if protocol == "loso" else int(protocol)
    return list(GroupKFold(count, shuffle=True, random_state=0).split(who, groups=who))


def groups_of(subjects: np.ndarray) -> np.ndarray:
    """Which of three groups each capture's subject is in, as `auto` deals them."""
    from bench.models.search.inner_folds import inner_folds

    groups = np.zeros(len(subjects), dtype=int)
    for number, (_, test) in enumerate(inner_folds(subjects.astype(str), "3")):
        groups[test] = number
    return groups


def tables(corpus: object) -> pd.DataFrame:
    """Features of whole captures."""
    from bench.features.jung54 import Jung54
    from bench.features.touch import TouchFeatures

    return pd.concat([TouchFeatures().fit_transform(corpus), Jung54().fit_transform(corpus)], axis=1)


def by_auto(corpus: object, train: np.ndarray, test: np.ndarray, budget: float) -> tuple[np.ndarray, float, int]:
    """Labels, seconds of the fit, and bytes in flash."""
    from bench.models.search.auto import Auto
    from bench.models.sizes import sizes

    X = corpus[train]
    system = Auto(seconds=budget).fit(X, X.gestures)
    spent = system.search_seconds_ + system.fit_seconds_[0]  # a study that was kept is not searched again
    taxels = corpus.grid[0] * corpus.grid[1]
    return system.predict(corpus[test]), spent, sizes(system, taxels, int(corpus.lengths.max()))["flash_bytes"]


def by_flaml(corpus: object, train: np.ndarray, test: np.ndarray, budget: float) -> tuple[np.ndarray, float, int]:
    """The same; groups of subjects judge, and the best estimator is fitted to all at last."""
    from flaml import AutoML

    table, y = tables(corpus), corpus.gestures
    began = time.perf_counter()
    system = AutoML()
    system.fit(
        table.iloc[train],
        y[train],
        task="classification",
        metric="accuracy",
        time_budget=budget,
        eval_method="cv",
        n_splits=3,
        split_type="group",
        groups=groups_of(corpus.subjects[train]),
        n_jobs=1,
        seed=0,
        verbose=0,
        estimator_list=["lgbm", "xgboost", "xgb_limitdepth", "rf", "extra_tree", "lrl1", "lrl2", "kneighbor"],
    )
    spent = time.perf_counter() - began
    return np.asarray(system.predict(table.iloc[test])), spent, len(pickle.dumps(system.model))


def by_autogluon(corpus: object, train: np.ndarray, test: np.ndarray, budget: float) -> tuple[np.ndarray, float, int]:
    """The same; bags of models over the groups of subjects, and a weighted ensemble of them."""
    from autogluon.tabular import TabularPredictor

    table = tables(corpus)
    labelled = table.iloc[train].assign(label=corpus.gestures[train], group=groups_of(corpus.subjects[train]))
    folder = tempfile.mkdtemp()
    try:
        began = time.perf_counter()
        system = TabularPredictor(
            "label", eval_metric="accuracy", path=folder, groups="group", verbosity=0, log_to_file=False
        )
        system.fit(
            labelled,
            time_limit=budget,
            num_cpus=1,
            num_gpus=0,
            num_stack_levels=0,
            ag_args_ensemble={"fold_fitting_strategy": "sequential_local"},
        )
        spent = time.perf_counter() - began
        return system.predict(table.iloc[test]).to_numpy(), spent, int(system.disk_usage())
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def one(tool: str, name: str, protocol: str, fold: int, budget: float) -> None:
    """One outer fold in this process: accuracy, seconds, bytes."""
    from threadpoolctl import threadpool_limits

    corpus = corpus_of(name)
    train, test = outer_folds(corpus, protocol)[fold]
    tables(corpus)  # kept
    with threadpool_limits(1):
        labels, spent, size = globals()[f"by_{tool}"](corpus, train, test, budget)
    hit = labels == corpus.gestures[test]
    for who in np.unique(corpus.subjects[test]):
        print("found", who, hit[corpus.subjects[test] == who].mean(), spent, size, sep=",")


def main(name: str, protocol: str, budgets: str, tools: str, jobs: str, out: str) -> None:
    """Every tool, budget and fold that is not in the file yet, so many at a time; then a line per tool and budget."""
    from joblib import Parallel, delayed

    done = pd.read_csv(out) if Path(out).exists() else pd.DataFrame(columns=["data", "tool", "budget", "fold"])
    finished = set(done[["data", "tool", "budget", "fold"]].itertuples(index=False, name=None))
    count = len(outer_folds(corpus_of(name), protocol))
    jobs_left = [(t, float(b), f) for b in budgets.split(",") for f in range(count) for t in tools.split(",")]

    def run(tool: str, budget: float, fold: int) -> None:
        alone = os.environ | {v: "1" for v in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
        process = subprocess.run(
            [sys.executable, __file__, "one", tool, name, protocol, str(fold), str(budget)],
            capture_output=True,
            text=True,
            env=alone,
            check=False,
        )
        lines = [line.split(",")[1:] for line in process.stdout.splitlines() if line.startswith("found,")]
        if not lines:
            print(f"{tool} {budget} fold {fold} failed: {process.stderr.strip().splitlines()[-1:]}")
        for who, accuracy, spent, size in lines:
            row = [name, tool, budget, fold, who, float(accuracy), float(spent), int(size)]
            names = ["data", "tool", "budget", "fold", "subject", "accuracy", "seconds", "bytes"]
            pd.DataFrame([row], columns=names).to_csv(out, mode="a", index=False, header=not Path(out).exists())

    Parallel(int(jobs), prefer="threads")(delayed(run)(*each) for each in jobs_left if (name, *each) not in finished)
    summary(pd.read_csv(out))


def summary(results: pd.DataFrame) -> None:
    """Accuracy over subjects with its 95 % interval, seconds, bytes, and the paired difference of `auto` to each."""
    from bench.outcomes.statistics import interval

    for (data, budget), rows in results.groupby(["data", "budget"]):
        wide = rows.pivot_table(index="subject", columns="tool", values="accuracy")
        for tool in wide:
            mine = rows[rows["tool"] == tool]
            low, high = interval(wide[tool].dropna().to_numpy())
            line = f"{data} {budget:g} s {tool:9s} {100 * wide[tool].mean():.1f} ({100 * low:.1f} - {100 * high:.1f})"
            line += f" {mine['seconds'].mean():.1f} s, at most {mine['seconds'].max():.1f}"
            line += f", {mine['bytes'].mean():.0f} B"
            if tool != "auto" and "auto" in wide:
                low, high = interval((wide["auto"] - wide[tool]).dropna().to_numpy())
                line += f"; auto better by {100 * low:.1f} to {100 * high:.1f}"
            print(line)


if __name__ == "__main__":
    if sys.argv[1] == "one":
        one(sys.argv[2], sys.argv[3], sys.argv[4], int(sys.argv[5]), float(sys.argv[6]))
    else:
        main(*sys.argv[1:])
