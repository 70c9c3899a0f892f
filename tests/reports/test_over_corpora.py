"""One ranking over corpora: by hand, by a naive loop, and the corpora that are not ranked."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.outcomes.frame import grouped
from bench.reports import page
from bench.reports.over_corpora import ranking, rankings
from bench.store import connect
from tests.reports.store import keep
from tests.results import evaluated, with_hits

ONE = pd.DataFrame({"a": [90.0, 80, 50], "b": [70.0, 80, 60], "c": [10.0, 20, 70]}).T  # accuracy of three people
TWO = pd.DataFrame({"a": [40.0, 40], "b": [60.0, 40], "c": [50.0, 30]}).T


def test_ranks_by_hand():
    """Ranks are a: 1, 1.5, 3 and 3, 1.5; b: 2, 1.5, 2 and 1, 1.5; c: 3, 3, 1 and 2, 3."""
    table = ranking({"one": ONE, "two": TWO}).set_index("system")
    assert table["mean_rank"].to_dict() == pytest.approx({"b": 8 / 5, "a": 10 / 5, "c": 12 / 5})
    assert list(table.index) == ["b", "a", "c"] and table["low"].isna().all()
    assert table["accuracy"].to_dict() == pytest.approx({"b": 62, "a": 60, "c": 36})
    assert table["one_place"].to_dict() == {"a": 1, "b": 2, "c": 3}  # means 73.3, 70, 33.3
    assert table["two_place"].to_dict() == {"b": 1, "a": 2.5, "c": 2.5}  # means 50, 40, 40
    ends = ["difference", "difference_low", "difference_high"]
    assert table.loc["a", ends].tolist() == pytest.approx([-2, np.nan, np.nan], nan_ok=True)  # of five people
    six = ranking({"one": ONE, "two": ONE}).set_index("system")
    lost = ONE.loc["c"] - ONE.loc[six.index[0]]  # the interval of the test of six people is their whole range
    assert six.loc["c", ends].tolist() == pytest.approx([lost.mean(), lost.min(), lost.max()])


def test_a_system_without_results_on_a_corpus_is_left_out():
    """Also one that lacks a person; a corpus with one system is not ranked."""
    partly, more = TWO.copy(), ONE.copy()
    partly.loc["c", 1], more.loc["d"] = np.nan, 100.0
    found = ranking({"one": more, "two": partly, "three": TWO.loc[["a"]]})
    assert found["system"].tolist() == ["b", "a"] and "three_place" not in found
    assert ranking({"one": ONE}) is None and ranking({"one": ONE, "two": TWO.loc[["a"]]}) is None


def test_corpora_of_different_people_are_ranked_on_the_page(quick):
    """Changed, joined and generated corpora do not count, nor does another protocol."""
    made = []

    def run(data, digest, hits, **more):
        for system, extra in (("good", 4), ("bad", 0)):
            about = {"data": data, "corpus_digest": digest * 64, "synthetic": "false"} | more
            made.append(evaluated(system, with_hits([h + extra for h in hits]), **about))

    run("copy", "a", [10, 12, 14, 9])  # the newer of equal captures counts
    run("haart", "a", [10, 12, 14, 9])
    run("haart-aligned", "b", [10, 12, 14, 9], **{"touchbench.changes": "align=2:1"})
    run("haart+x", "c", [10, 12, 14, 9, 3])
    run("synth", "d", [10, 12], synthetic="true")
    run("other", "e", [10, 12], protocol="kfold", protocol_label="2-fold")
    assert rankings(grouped(made)) == {}
    run("cuddlebot", "f", [5, 8, 16])
    for r in made:
        keep(connect(), r)
    page.write_report(connect(), Path("report"))
    text, table = Path("report/comparison.md").read_text(), pd.read_csv("report/ranking.csv")
    assert "## Over several corpora" in text and "over 7 people" in text
    assert table["mean_rank"].tolist() == [1, 2] and table["difference"].tolist() == [0, -20]
    assert [name for name in table if name.endswith("_place")] == ["haart_place", "cuddlebot_place"]
