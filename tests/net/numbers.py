"""Numbers that no change of structure may change.

``pytest tests/net/test_numbers.py --golden`` stores them. Each case of a group gives a table: the
probabilities of a system, a digest of each column of a feature set, of each severity of a fault, of
the tables of a run. It is stored in ``numbers/GROUP/CASE.csv``. With ``--exact``, on the processor
and with the libraries that stored them, all must be equal to the last digit. Without, as on any
machine, numbers may differ by `ELSEWHERE`, and digests are not compared. Only `probabilities`,
`damaged` and `tables` use what is not public.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_DISABLE_JIT", "1")

import numpy as np
import pandas as pd

import bench
from bench import contract
from bench.corpora import faults
from bench.corpora.corpus import Corpus
from bench.ground import registry
from bench.models.recipe import build_recipe
from bench.reading.runs import load_results
from bench.store.client import connect

FOLDER = Path(__file__).parent / "numbers"
ELSEWHERE = {
    "rtol": 1e-3,
    "atol": 1e-5,
}  # networks sum in another order on another processor: up to 3e-4 was seen
TOUCHES = "gesture in ('pat', 'rub', 'stroke', 'tap')"
CAPTURES = {
    "data__subjects": 3,
    "data__variants": ("normal",),
    "data__repetitions": 1,
    "data__rate_hz": 45.0,
}
ON = {"data": "synth", "where": TOUCHES, "features": "jung28", "jobs": 1, **CAPTURES}
QUICK: dict[
    str, dict[str, object]
] = {  # systems with little to learn; networks learn for one epoch
    "rf": {"trees": 10},
    "et": {"trees": 10},
    "xgb": {"trees": 5},
    "boost": {"rounds": 5, "depth": 3},
    "mlp": {"layers": "4", "runs": 1},
    "perceptron": {"updates": 50},
    "balli2015_rf": {"selected": 3},
    "reflex": {"copies": 1, "window": 0.2, "early": 0.1, "units": 4},
    "cnn85": {"frames": 10, "batch": 16},
    "rocket": {"kernels": 84},
    "touchnet": {"seconds": 0.2, "width": 4, "updates": 10, "batch": 16},
    "auto": {"seconds": float("inf"), "trials": 2, "inner": "2"},
}
NOT_STORED = (
    "seconds",
    "ms_p",
    "predict_ms",
    "front",
)  # parts of the names of columns that depend on time


def touches(seed: int = 0) -> Corpus:
    """Twelve generated captures of three people, of 7 to 64 frames."""
    parameters = {name.removeprefix("data__"): value for name, value in CAPTURES.items()}
    return bench.corpus("synth", where=TOUCHES, seed=seed, **parameters)


def split_touches() -> tuple[Corpus, np.ndarray, np.ndarray]:
    """The captures, and the positions of those of all people but one, and of this one."""
    corpus = touches()
    is_tested = corpus.subjects == corpus.subjects[0]
    return corpus, np.flatnonzero(~is_tested), np.flatnonzero(is_tested)


def make_system(name: str, **options: object) -> contract.System:
    """Make a system with little to learn, on jung28 if it takes a feature set."""
    factory = registry.load_part("models", name)
    options = {**QUICK.get(name, {}), **options}
    if "epochs" in registry.parameter_defaults(factory):
        options = {"epochs": 1, **options}
    features = registry.load_part("features", "jung28")()
    return build_recipe(
        factory, features if registry.required_parameters(factory) else None, **options
    )


@cache
def fit_system(name: str) -> contract.System:
    """Fit a system to all people but one, once for all tests of the process."""
    corpus, train, _ = split_touches()
    return make_system(name).fit(corpus[train], corpus.gestures[train])


def probabilities(name: str) -> pd.DataFrame:
    """Probabilities of each capture of one person by a system that is fitted on the others."""
    corpus, _, test = split_touches()
    system = fit_system(name)
    proba = contract.predict_probabilities(system, corpus[test])
    return pd.DataFrame(proba.astype(float), columns=list(system.classes_)).assign(capture=test)


def columns(name: str) -> pd.DataFrame:
    """Mean and digest of each feature over all captures."""
    corpus = touches()
    table = registry.load_part("features", name)().fit_transform(corpus, corpus.gestures)
    rows = [
        (column, float(values.mean()), digest(values.to_numpy(float)))
        for column, values in table.items()
    ]
    return pd.DataFrame(rows, columns=["feature", "mean", "digest"])


def damaged(name: str) -> pd.DataFrame:
    """Mean and digest of the frames of all captures at each severity of a fault."""
    corpus, fault, rows = touches(), faults.FAULTS[name], []
    everything = np.arange(len(corpus))
    for severity in range(1, 6):
        frames = faults.damage_captures(
            corpus, everything, faults.as_shares(corpus, everything), fault, severity
        ).frames
        rows.append((severity, len(frames), float(frames.mean()), digest(frames)))
    return pd.DataFrame(rows, columns=["severity", "frames", "mean", "digest"])


RUNS: dict[str, Callable[[], pd.DataFrame]] = {
    "run": lambda: bench.run(model="bayes", **ON),
    "tune": lambda: bench.tune(model="tree", model__level=[1, 9], inner="2", **ON),
    "stress": lambda: bench.run(
        model="bayes", under=["noise", "dead_taxels"], train_subjects=[1], **ON
    ),
    "stream": lambda: bench.run(model="bayes", after=["250ms", "500ms"], stopping=True, **ON),
}


def tables(name: str) -> pd.DataFrame:
    """Digest of each column of each stored table of a run, with the mean of a column of numbers."""
    RUNS[name]()
    (run,), rows = load_results(connect()), []
    for title in sorted({*run.tables} - {"folds"}):  # their times
        for column, values in sorted(run.tables[title].items()):
            if any(part in str(column) for part in NOT_STORED):
                continue
            numeric = pd.api.types.is_numeric_dtype(values)
            cells = values.to_numpy(float) if numeric else "\n".join(map(str, values))
            mean = float(np.nan_to_num(cells).clip(-1e9, 1e9).mean()) if numeric else np.nan
            rows.append((title, column, len(values), mean, digest(cells)))
    return pd.DataFrame(rows, columns=["table", "column", "rows", "mean", "digest"])


def digest(values: np.ndarray | str) -> str:
    """Digest of a text, or of numbers; -0 is 0."""
    data = (
        values.encode() if isinstance(values, str) else np.ascontiguousarray(values + 0).tobytes()
    )
    return hashlib.sha256(data).hexdigest()[:12]


GROUPS: dict[str, Callable[[str], pd.DataFrame]] = {
    "models": probabilities,
    "features": columns,
    "faults": damaged,
    "runs": tables,
}


def cases() -> list[tuple[str, str]]:
    """Groups and names of all that has numbers."""
    names = {
        "models": registry.registered_parts("models"),
        "features": registry.registered_parts("features"),
    }
    names |= {"faults": faults.FAULTS, "runs": RUNS}
    return [(group, name) for group in GROUPS for name in names[group]]


def stored() -> list[tuple[str, str]]:
    """Groups and names of the stored numbers."""
    return sorted((path.parent.name, path.stem) for path in FOLDER.rglob("*.csv"))


def read(path: Path) -> pd.DataFrame:
    """Stored numbers, to the last digit."""
    return pd.read_csv(
        path,
        float_precision="round_trip",
        dtype={"digest": str},
        keep_default_na=False,
        na_values=[""],
    )


def compare(path: Path, found: pd.DataFrame, exact: bool) -> None:
    """Raise AssertionError where found numbers are not the stored ones."""
    found.to_csv("found.csv", index=False)
    left_out = [] if exact else ["digest"]
    tables = [
        read(each).drop(columns=left_out, errors="ignore") for each in (path, Path("found.csv"))
    ]
    pd.testing.assert_frame_equal(*tables, check_exact=exact, **{} if exact else ELSEWHERE)
