"""Learning curves: nested people, shares of captures, the law and where one curve overtakes another."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.errors import InputError
from bench.plan.cells import cells
from bench.plan.plan import corpus_of, folds_of
from reports.learning import Learning, carried_on, curve, law, main, overtaken, some
from tests.conftest import random_corpus

SMALL = ["data.subjects=5", "data.variants=normal", "data.repetitions=4", "features=jung28"]


@given(st.floats(0, 0.4), st.floats(0.05, 0.6), st.floats(0.1, 1.9))
def test_a_law_is_found_again(a, b, c):
    counts = np.array([2, 4, 8, 16, 64.0])
    found = law(counts, a + b * counts**-c)
    expected, guessed = a + b * counts**-c, found[0] + found[1] * counts ** -found[2]
    np.testing.assert_allclose(guessed, expected, atol=3e-3)
    assert 0 <= found[0] <= 1 and 0 <= found[1] <= 1 and 0 <= found[2] <= 2


def test_a_law_never_promises_that_more_people_hurt_or_that_errors_vanish_below_nothing():
    rising = law(np.array([2, 4, 8.0]), np.array([0.2, 0.25, 0.3]))
    assert rising[1] == pytest.approx(0, abs=1e-9) and rising[0] == pytest.approx(0.25, abs=1e-6)
    steep = law(np.array([2, 4, 8.0]), np.array([0.9, 0.2, 0.01]))
    assert steep[0] >= 0 and steep[1] <= 1


def test_parts_are_nested_and_shares_are_even():
    (cell,) = cells(dict(word.split("=") for word in ["data=synth", "model=bayes", *SMALL]))
    corpus = corpus_of(cell)
    for fold in folds_of(cell, corpus):
        two, three, quarter, whole = Learning((2, 3), (0.25,)).parts(cell, corpus, fold)
        assert set(two[0]) < set(three[0]) < set(whole[0]) == set(fold.train)
        assert [len(set(corpus.subjects[part])) for part, *_ in (two, three, quarter, whole)] == [2, 3, 4, 4]
        each = pd.crosstab(corpus.subjects[quarter[0]], corpus.gestures[quarter[0]])
        assert (each == 1).all().all()  # of four
    ragged = random_corpus(per_class=5)
    train = np.arange(len(ragged))[np.arange(len(ragged)) % 4 > 0]
    kept = some(ragged, train, 0.5)
    for subject in set(ragged.subjects):
        for gesture in set(ragged.gestures):
            there = [i for i in train if (ragged.subjects[i], ragged.gestures[i]) == (subject, gesture)]
            mine = [i for i in kept if (ragged.subjects[i], ragged.gestures[i]) == (subject, gesture)]
            assert len(mine) == max(1, -(-len(there) // 2)) and set(mine) <= set(there)


def table(accuracies):
    """Hits by people [subjects] of three persons with ten captures each."""
    rows = []
    for people, of_subject in accuracies.items():
        for subject, right in enumerate(of_subject):
            for k in range(10):
                rows.append((str(subject), str(subject), people, 1.0, 70, "a", "a" if k < right else "b"))
    names = ["fold", "subject", "people", "share", "trained", "true", "predicted"]
    return pd.DataFrame(rows, columns=names)


def test_points_and_what_is_expected_are_those_of_pooled_captures():
    found = table({2: [5, 6, 4], 4: [6, 6, 6], 8: [7, 8, 6], 9: [7, 8, 7]})
    points = curve(found)
    assert points["people"].tolist() == [2, 4, 8, 9]
    assert points["accuracy"].tolist() == pytest.approx([15 / 30, 18 / 30, 21 / 30, 22 / 30])
    ahead = np.array([2.0, 9.0, 50.0])
    expected = carried_on(found, ahead, draws=20)
    a, b, c = law(np.array([2, 4, 8, 9.0]), 1 - np.array([15, 18, 21, 22]) / 30)
    np.testing.assert_allclose(expected[0], 1 - a - b * ahead**-c)
    assert expected.shape == (21, 3) and (np.diff(expected, axis=1) >= -1e-12).all()


def test_overtaking_by_hand():
    counts = np.array([2, 10, 50, 300.0])
    other = np.array([[0.6, 0.7, 0.75, 0.76]] * 3)
    deep = np.array([[0.7, 0.65, 0.76, 0.80], [0.5, 0.6, 0.7, 0.77], [0.5, 0.6, 0.7, 0.75]])
    assert overtaken(deep, other, counts) == (50.0, 0.5)  # early luck does not count
    assert overtaken(other, deep, counts)[0] == np.inf


def test_it_runs_from_the_command_line(tmp_path, capsys):
    out = tmp_path / "curves"
    assert main(["model=bayes,lda", "people=2,3", "share=0.25", "until=100", f"out={out}", *SMALL]) == 0
    found = pd.read_csv(out / "learning.csv")
    measured = found[found["kind"] == "measured"]
    assert len(measured) == 8 and set(measured["people"]) == {2, 3, 4}
    assert len(found[found["kind"].str.startswith("above")]) == 1 and (out / "learning.png").stat().st_size > 10_000
    assert "synthetic" in capsys.readouterr().err
    with pytest.raises(InputError, match="people=4: fold 1 has 4 for training"):
        main(["model=bayes", "people=4", f"out={out}", *SMALL])
    with pytest.raises(InputError, match="share= numbers above 0"):
        main(["model=bayes", "share=2.0", *SMALL])


def test_a_plus_begins_another_system_of_the_same_captures(tmp_path):
    out = tmp_path / "curves"
    words = ["model=bayes", *SMALL, "people=2", f"out={out}", "+", "model=softmax", "features=jung28"]
    words += ["+", "model=lda", "features=touch"]
    assert main(words) == 0
    found = pd.read_csv(out / "learning.csv")
    assert [*found["system"].unique()] == ["bayes · jung28", "softmax · jung28", "lda · touch"]
    assert set(found.loc[found["kind"] == "measured", "people"]) == {2, 4}
    for more, said in (
        (["people=3"], "people"),
        (["+"], r"\+ stands between systems"),
        (["+", "features=touch"], r"\+ stands between systems"),
        (["+", "model=lda", "features=touch"], "two curves would be called lda · touch"),
    ):
        with pytest.raises(InputError, match=said):
            main([*words, *more])
    with pytest.raises(InputError, match=r"\+ stands between systems"):
        main(["+", "model=bayes", "features=jung28"])
    for captures in ("data=synth,haart", "protocol=loso,kfold"):
        with pytest.raises(InputError):
            main(["model=bayes", "features=jung28", captures])
