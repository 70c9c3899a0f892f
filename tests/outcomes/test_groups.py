"""Groups of gestures against groupings and accuracies computed by hand, and against naive loops."""

import tomllib

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bench
from bench.cli import main
from bench.outcomes.groups import groupings
from tests.reports.store import made_up, tracked_run, with_hits


def table(mistakes, of=4, gestures="abcd"):
    """``of`` captures of each gesture by each person; ``mistakes``: for each person, ``ab`` is an a labelled b."""
    rows = []
    for person, wrong in enumerate(mistakes, 1):
        for true in gestures:
            labels = [pair[1] for pair in wrong.split() if pair[0] == true]
            for label in labels + [true] * (of - len(labels)):
                rows.append((str(person), len(rows), str(person), true, *(float(label == g) for g in gestures)))
    return pd.DataFrame(rows, columns=["fold", "capture", "subject", "true", *(f"p_{g}" for g in gestures)])


def test_an_abstention_is_in_no_group_and_no_confusion():
    rows = table(["ab ba", "ab ba", "ab ba"])
    gone = rows["true"] == "a"
    abstaining = rows.assign(**{name: rows[name].where(~gone, 0.0) for name in ("p_a", "p_b", "p_c", "p_d")})
    assert groupings(abstaining)["accuracy"].tolist() == pytest.approx([100 * 11 / 16, 75, 75])


def test_the_pair_with_the_most_confusions_per_pair_of_captures_is_merged():
    # 12 captures of each. a and b: 5 mutual confusions / (12 * 12). Then ab and c: 4 / (24 * 12), c and d: 3 / (12 *
    # 12), so c and d are merged although ab and c have more confusions. The order is the same without any one person.
    found = groupings(table(["ab ba ac bc cd", "ab ba ca dc", "ab ac dc"]))
    assert found["grouping"].tolist() == [
        (("a",), ("b",), ("c",), ("d",)),
        (("a", "b"), ("c",), ("d",)),
        (("a", "b"), ("c", "d")),
    ]
    assert found["groups"].tolist() == [4, 3, 2] and (found["same"] == 3).all() and (found["subjects"] == 3).all()
    # Of 16 captures of each person correct: 11, 12, 13; with a and b merged 13, 14, 14; with both merged 14, 15, 15.
    assert found["accuracy"].tolist() == pytest.approx([100 * n / 48 for n in (36, 41, 44)])
    assert found["largest"].tolist() == pytest.approx([25, 50, 50])
    assert found[["low", "high"]].isna().all(axis=None)  # of three people


def test_each_person_is_scored_with_the_groups_of_the_others():
    # All: a and b have 4 mutual confusions, b and c 5. Without the third person, who has all 5: a and b.
    found = groupings(table(["ab ba", "ab ba", "bc bc bc cb cb"], of=6, gestures="abc")).iloc[1]
    assert found["grouping"] == (("a",), ("b", "c")) and found["same"] == 2
    assert found["accuracy"] == pytest.approx(100 * (16 + 16 + 13) / 54)  # 18 of 18 with b and c merged
    assert found["largest"] == pytest.approx(100 * 2 / 3)


def by_hand(tested, grouping):
    """Share of the captures whose group has the highest sum of mean probabilities."""
    hits = []
    for _, capture in tested.groupby("capture"):
        sums = [sum(capture[f"p_{gesture}"].mean() for gesture in group) for group in grouping]
        hits.append(capture["true"].iloc[0] in grouping[int(np.argmax(sums))])
    return 100 * np.mean(hits)


@given(seed=st.integers(0, 10**6), counts=st.lists(st.integers(1, 3), min_size=3, max_size=4))
def test_nothing_of_a_person_decides_on_the_groups_of_that_person(seed, counts):
    people = [
        made_up(1, count, 0.6, seed + i, windows=2, gestures="abcd").assign(subject=str(i), fold=str(i))
        for i, count in enumerate(counts)
    ]
    found = groupings(pd.concat(people))
    expected = []
    for i, person in enumerate(people):  # the grouping comes from a table without the person
        chosen = groupings(pd.concat([p for k, p in enumerate(people) if k != i]))["grouping"]
        expected.append([by_hand(person, grouping) for grouping in chosen])
    assert found["accuracy"].tolist() == pytest.approx(np.mean(expected, axis=0).tolist())


def test_the_command_uses_all_seeds_of_the_most_accurate_system(store, capsys):
    tracked_run(store, "lda", with_hits([12, 13, 14, 13, 13]))
    for seed, hits in enumerate(([16, 17, 18, 17, 17], [18, 17, 16, 17, 17])):
        tracked_run(store, "rf", with_hits(hits), seed=str(seed))
    assert main(["choose", "groups=yes", "data=synth"]) == 0
    text = capsys.readouterr().out
    assert "LOSO (5 subjects); rf" in text
    found = bench.groups(data="synth")
    assert found["accuracy"][0] == pytest.approx(85) and found["low"][0] == pytest.approx(85)
    assert bench.groups(model="lda")["accuracy"][0] == pytest.approx(65)
    merged = found["grouping"][1]  # of three gestures, two are merged
    shown = text.partition("[reactions]\n")[2].partition("\n")[0]
    assert tomllib.loads(shown) == {"_".join(g): list(g) for g in merged if len(g) > 1}
