"""One ranking of systems over several corpora, by hand."""

import numpy as np
import pandas as pd
import pytest

from bench.reading.frame import group_results
from bench.reports.over_corpora import rank_over_corpora, rank_systems
from tests.reading.results import make_run, predictions_with_hits

# Accuracy of three and of two people.
ONE = pd.DataFrame({"a": [90.0, 80, 50], "b": [70.0, 80, 60], "c": [10.0, 20, 70]}).T
TWO = pd.DataFrame({"a": [40.0, 40], "b": [60.0, 40], "c": [50.0, 30]}).T


def test_ranks_by_hand():
    """Ranks are a: 1, 1.5, 3 and 3, 1.5; b: 2, 1.5, 2 and 1, 1.5; c: 3, 3, 1 and 2, 3."""
    table = rank_systems({"one": ONE, "two": TWO}).set_index("system")
    assert table["mean_rank"].to_dict() == pytest.approx({"b": 8 / 5, "a": 10 / 5, "c": 12 / 5})
    assert list(table.index) == ["b", "a", "c"] and table["low"].isna().all()
    assert table["accuracy"].to_dict() == pytest.approx({"b": 62, "a": 60, "c": 36})
    assert table["one_place"].to_dict() == {"a": 1, "b": 2, "c": 3}  # means 73.3, 70, 33.3
    assert table["two_place"].to_dict() == {"b": 1, "a": 2.5, "c": 2.5}  # means 50, 40, 40
    ends = ["difference", "difference_low", "difference_high"]
    assert table.loc["a", "difference"] == pytest.approx(-2)
    assert table.loc["a", ends[1:]].isna().all()  # of five people
    six = rank_systems({"one": ONE, "two": ONE}).set_index("system")
    lost = ONE.loc["c"] - ONE.loc[six.index[0]]  # the interval of six people is their whole range
    assert six.loc["c", ends].tolist() == pytest.approx([lost.mean(), lost.min(), lost.max()])


def test_a_system_without_results_on_a_corpus_is_left_out():
    """Also one that lacks a person; a corpus with one system is not ranked."""
    partly, more = TWO.copy(), ONE.copy()
    partly.loc["c", 1], more.loc["d"] = np.nan, 100.0
    table = rank_systems({"one": more, "two": partly, "three": TWO.loc[["a"]]})
    assert table["system"].tolist() == ["b", "a"] and "three_place" not in table
    assert rank_systems({"one": ONE}) is None
    assert rank_systems({"one": ONE, "two": TWO.loc[["a"]]}) is None


def test_corpora_of_different_people_are_ranked():
    """Changed, joined and generated corpora do not count, nor does another protocol."""
    runs = []

    def add(data, digest, hits, **more):
        for system, extra in (("good", 4), ("bad", 0)):
            about = {"data": data, "corpus_digest": digest * 64, "synthetic": "false"} | more
            runs.append(make_run(system, predictions_with_hits([h + extra for h in hits]), **about))

    add("copy", "a", [10, 12, 14, 9])  # the newer of equal captures counts
    add("haart", "a", [10, 12, 14, 9])
    add("haart-aligned", "b", [10, 12, 14, 9], **{"touchbench.changes": "align=2:1"})
    add("haart+x", "c", [10, 12, 14, 9, 3])
    add("synth", "d", [10, 12], synthetic="true")
    add("other", "e", [10, 12], protocol="kfold", protocol_label="2-fold")
    assert rank_over_corpora(group_results(runs)) == {}
    add("cuddlebot", "f", [5, 8, 16])
    (table,) = rank_over_corpora(group_results(runs)).values()
    assert table["mean_rank"].tolist() == [1, 2] and table["difference"].tolist() == [0, -20]
    assert [name for name in table if name.endswith("_place")] == ["haart_place", "cuddlebot_place"]
