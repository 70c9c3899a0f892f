"""The engine of both searches: resumed wherever it was cut, and its rule of giving up."""

import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import wilcoxon

from bench.models.search.study import Study, Tried, study_name
from bench.models.space import Range
from bench.scratch import home

CAPTURES = SimpleNamespace(digest="abc", index=np.arange(3), piece=np.zeros(3, int), steps=())
LABELS = np.array(["a", "b", "a"])
SPACES = {
    "line": {"line.x": Range(1e-3, 10.0, log=True), "line.n": Range(1, 9)},
    "list": {"list.kind": ["u", "v", 2, None]},
}


def value_of(trial):
    """Best for x of 0.1 and small n."""
    bad = abs(np.log10(trial["line.x"]) + 1) + trial["line.n"] / 9 if trial["model"] == "line" else 1.5
    return 1 / (1 + bad)


def searched(most=14, budget=np.inf, stop=None, key=0):
    """A search of fourteen trials, of which every third is given up and every fifth fails; stopped within a trial."""
    made = Study({"model": ["line", "list"]}, SPACES, 3, most, budget, time.perf_counter(), {"cost": 0.9})

    def step():
        number = len(made.tried)
        if made.left <= 0:
            return None
        trial = made.drawn({"model": "list"} if number == 1 else {}, each=True)
        if number == stop:
            raise KeyboardInterrupt
        score = value_of(trial)
        tried = partial(Tried, trial, costs={"cost": score}, heat=score)
        if number % 3 == 2:
            return tried(state="pruned", subjects={"p": score})
        if number % 5 == 4:
            return tried(state="failed", error="ValueError: no")
        proba = np.full((2, 3), score, dtype=np.float16)
        return tried(state="complete", subjects={"p": score, "q": score / 2}, proba=proba)

    made.search(step, {"key": key}, CAPTURES, LABELS)
    return made.tried


def facts(trials):
    """All of some trials but the seconds, with the types of their values."""
    return [
        (repr(t.trial), t.state, t.subjects, t.costs, t.heat, t.error, None if t.proba is None else t.proba.tolist())
        for t in trials
    ]


@pytest.fixture(scope="module")
def straight():
    """Uninterrupted, and not stored."""
    digest, CAPTURES.digest = CAPTURES.digest, ""
    try:
        return facts(searched())
    finally:
        CAPTURES.digest = digest


@pytest.mark.parametrize("stop", [0, 1, 2, 13])
def test_an_interrupted_search_goes_on_as_if_it_had_not_been(straight, stop):
    with pytest.raises(KeyboardInterrupt):
        searched(stop=stop)
    folder = home() / "studies" / study_name({"key": 0}, CAPTURES, LABELS)
    (folder / ".killed.pickle").write_bytes(b"half of a trial")  # by a process that was killed while it wrote
    assert facts(searched()) == straight
    assert facts(searched(stop=0)) == straight  # all are stored: none is made
    assert len({line[0] for line in straight}) > 10  # they differ, or this shows nothing


shares = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=9)


@given(shares)
def test_a_trial_is_worse_if_a_signed_rank_test_over_the_subjects_so_far_says_so(pairs):
    mine, best = np.array(pairs).T / 4
    made = Study({"model": ["m"]}, {"m": {}}, 0, 9, np.inf, 0.0, {"cost": 1.0})
    step = iter(
        [
            Tried({"model": "m"}, "complete", subjects=dict.fromkeys(range(10), 1.0), costs={"cost": 2.0}),  # too dear
            Tried({"model": "m"}, "complete", subjects=dict(enumerate([*best, 1.0]))),
            Tried({"model": "m"}, "large", subjects={"a": 99.0, "b": 99.0}),
        ]
    )
    made.search(lambda: next(step, None), {}, SimpleNamespace(digest=""), LABELS)
    expected = len(mine) > 1 and wilcoxon(mine - best, alternative="less", zero_method="zsplit").pvalue < 0.1
    expected = expected and mine.mean() < np.mean([*best, 1.0])
    assert made.worse(Tried({"model": "m"}, "complete", subjects=dict(enumerate(mine)))) == expected
