"""Captures that are the same, against loops over all pairs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.duplicates import identical, seen_before
from bench.corpora.survey import Survey
from tests.conftest import random_corpus


def copied(corpus, pairs, **fields):
    """The corpus with captures replaced by copies of others, given as (place, copied one)."""
    arrays = list(corpus)
    for place, of in pairs:
        arrays[place] = arrays[of].copy()
    fields = {"full_scale": corpus.full_scale, "name": corpus.name} | fields
    return Corpus.from_captures(arrays, corpus.captures, corpus.rate_hz, **fields)


@given(st.integers(0, 10**6), st.sampled_from(["uint16", "float32"]))
def test_groups_are_those_of_all_pairs_compared(seed, kind):
    rng = np.random.default_rng(seed)
    shapes = [(1, 1), (1, 2), (2, 1)]
    arrays = []
    for _ in range(30):  # few values, so that captures are alike in parts, as a whole, and not at all
        values = rng.integers(0, 2, (rng.integers(1, 4), *shapes[rng.integers(3)])).astype(kind)
        arrays.append(-values if kind == "float32" else values)  # a zero with a sign equals one without
    expected = {tuple(j for j, b in enumerate(arrays) if np.array_equal(a, b)) for a in arrays}
    found = identical(arrays)
    assert found == sorted(list(group) for group in expected if len(group) > 1)
    assert identical(arrays[:1]) == identical([]) == []


@given(st.integers(0, 10**6))
def test_what_is_tested_after_training_is_that_of_a_loop(seed):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, 8, 20)
    groups = [g.tolist() for g in (np.flatnonzero(labels == k) for k in range(6)) if len(g) > 1]
    sides = []
    for _ in range(3):
        order = rng.permutation(20)
        sides.append((np.sort(order[:9]), np.sort(order[9:15])))
    expected = {}
    for train, test in sides:
        for i in test:
            twins = [int(j) for j in train for g in groups if i in g and j in g]
            if twins:
                expected.setdefault(int(i), twins[0])
    assert seen_before(groups, sides, 20) == sorted(expected.items())


def test_an_import_warns_of_them_and_a_survey_lists_them():
    corpus = copied(random_corpus(longest=20), [(10, 1), (30, 1), (5, 4)])
    survey, table = Survey(corpus), Survey(corpus).duplicates
    (line,) = survey.repeated()
    assert "\n" not in line and line.startswith("Duplicates: 5 captures") and Survey(random_corpus()).repeated() == []
    assert table[["group", "capture"]].to_numpy().tolist() == [[1, 1], [1, 10], [1, 30], [2, 4], [2, 5]]
    assert Survey(corpus[np.array([30, 9, 1])]).duplicates["capture"].tolist() == [1, 30]  # of the whole corpus
