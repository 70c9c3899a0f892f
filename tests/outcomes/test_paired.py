"""The rule of one standard error against exact fractions, and the three places that decide by it."""

from fractions import Fraction

import numpy as np
import pandas as pd

from bench.outcomes.choice import decide
from bench.outcomes.stopping import learn_stopping
from bench.paired import mean_and_error, within_one_standard_error
from models.search.study import Tried
from models.search.tuning import Search

ONE_PERSON = [(n, k, m) for n in range(2, 31) for m in (6, 7, 11, 84) for k in (0, m // 3, m - 1)]


def exactly_within(lost):
    """Mean against standard error, both squared, in fractions."""
    mean = sum(lost) / len(lost)
    square = sum((x - mean) ** 2 for x in lost) / (len(lost) - 1) / len(lost)
    return mean <= 0 or mean**2 <= square


def people(n, k, m):
    """Two systems that differ on the last of n people by one of m captures: shares as exact fractions."""
    rest = [Fraction((3 * i + k) % (m + 1), m) for i in range(n - 1)]
    return [*rest, Fraction(k + 1, m)], [*rest, Fraction(k, m)]


def test_a_loss_on_one_person_equals_its_standard_error():
    for case in ONE_PERSON:
        best, other = people(*case)
        assert exactly_within([a - b for a, b in zip(best, other, strict=True)])
        for scale in (1, 100):
            lost = scale * np.array(best, dtype=float) - scale * np.array(other, dtype=float)
            assert within_one_standard_error(lost), case


def test_it_is_the_exact_rule_where_several_people_differ():
    rng = np.random.default_rng(0)
    for _ in range(500):
        lost = [Fraction(int(d), 84) for d in rng.integers(-2, 4, rng.integers(2, 31))]
        assert within_one_standard_error(np.array(lost, dtype=float)) == exactly_within(lost), lost
    assert not within_one_standard_error(np.array([0.1])) and within_one_standard_error(np.array([1e-16]))
    assert mean_and_error(np.array([1.0, 3.0])) == (2.0, 1.0) and np.isnan(mean_and_error(np.array([2.0]))[1])


def chosen_of_two(best, other):
    """Whether `bench choose` takes the cheaper of two systems, and what a search for the smallest value ranks."""
    subjects = 100 * pd.DataFrame([best, other])
    table = pd.DataFrame({"system": ["dear", "cheap"], "unit": "capture", "flash": [9.0, 1.0]})
    choice = decide(table.assign(accuracy=subjects.mean(axis=1)), subjects, "flash", {}, None)

    search = Search({"m": None}, {"m": {"size": [1, 2]}}, objective="smallest")
    search.features = None
    names = [str(i) for i in range(len(best))]
    trials = [
        Tried({"model": "m", "m.size": size}, "complete", subjects=dict(zip(names, shares, strict=True)))
        for size, shares in ((2, best), (1, other))
    ]
    return choice.chosen == 1, search._ranked(trials) == [1, 0]


def test_choice_and_search_take_the_cheaper_of_two_that_differ_on_one_person():
    for case in ONE_PERSON[::5]:
        assert chosen_of_two(*(np.array(shares, dtype=float) for shares in people(*case))) == (True, True), case


def test_stopping_takes_the_earlier_of_two_instants_that_differ_on_one_person():
    for n in (2, 5, 8, 10, 30):
        rows = []
        for subject in range(n):
            for capture in range(7):
                early = "b" if subject == 0 and capture == 0 else "a"
                place = {"fold": "1", "capture": 7 * subject + capture, "subject": str(subject), "true": "a"}
                rows += [
                    place | {"frames": 10, "instant": 10, "settled": 0.9, "p_a": early == "a", "p_b": early == "b"},
                    place | {"frames": 90, "instant": 90, "settled": 1.0, "p_a": True, "p_b": False},
                ]
        table = pd.DataFrame(rows).astype({"p_a": float, "p_b": float})
        assert learn_stopping(table, 100.0)[0] == 0.9, n
