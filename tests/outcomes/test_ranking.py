"""One ranking over corpora: by hand, by a naive loop, and what is not ranked."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.outcomes.ranking import distinct, ranking
from bench.outcomes.runs import grouped
from bench.outcomes.store import connect
from bench.reports import page
from tests.reports.store import keep
from tests.results import evaluated, with_hits

ONE = {"a": [90, 80, 50], "b": [70, 80, 60], "c": [10, 20, 70]}  # accuracy of three people
TWO = {"a": [40, 40], "b": [60, 40], "c": [50, 30]}


def results(**corpora):
    rows = [
        (data, system, str(person), float(value))
        for data, systems in corpora.items()
        for system, values in systems.items()
        for person, value in enumerate(values)
    ]
    return pd.DataFrame(rows, columns=["data", "system", "subject", "accuracy"])


def test_ranks_by_hand():
    """Ranks are a: 1, 1.5, 3 and 3, 1.5; b: 2, 1.5, 2 and 1, 1.5; c: 3, 3, 1 and 2, 3."""
    found = ranking(results(one=ONE, two=TWO))
    table = found.table.set_index("system")
    assert table["mean_rank"].to_dict() == pytest.approx({"b": 8 / 5, "a": 10 / 5, "c": 12 / 5})
    assert list(table.index) == ["b", "a", "c"] and found.people == {"one": 3, "two": 2}
    assert table["accuracy"].to_dict() == pytest.approx({"b": 62, "a": 60, "c": 36})
    assert table["one_place"].to_dict() == {"a": 1, "b": 2, "c": 3}  # means 73.3, 70, 33.3
    assert table["two_place"].to_dict() == {"b": 1, "a": 2.5, "c": 2.5}  # means 50, 40, 40
    lost = np.array([20, 0, -10, -20, 0])  # a less b: t(0.975, 4) is 2.776
    half = 2.776445 * lost.std(ddof=1) / np.sqrt(5)
    assert table.loc["a", "difference"] == -2
    assert table.loc["a", ["difference_low", "difference_high"]].tolist() == pytest.approx([-2 - half, -2 + half])
    # Of three pairs, a-c is tied on two, a-b is reversed and b-c agrees: (1 - 1) / sqrt(3 * 2).
    assert found.taus == [("one", "two", pytest.approx(0))]


def test_the_mean_rank_and_its_interval():
    rng = np.random.default_rng(3)
    one, two = ({s: rng.integers(0, 6, n) * 20 for s in "abcd"} for n in (9, 14))
    table = ranking(results(one=one, two=two)).table.set_index("system")
    for system in "abcd":
        ranks = []
        for corpus in (one, two):
            for person in range(len(corpus["a"])):
                better = sum(corpus[other][person] > corpus[system][person] for other in "abcd")
                equal = sum(corpus[other][person] == corpus[system][person] for other in "abcd")
                ranks.append(better + (equal + 1) / 2)
        row = table.loc[system]
        assert row["mean_rank"] == pytest.approx(np.mean(ranks))
        assert row["low"] < row["mean_rank"] < row["high"]
        assert row["high"] - row["low"] == pytest.approx(2 * 1.96 * np.std(ranks) / np.sqrt(23), rel=0.2)
    same = {"a": [50] * 6, "b": [40] * 6}
    table = ranking(results(one=same, two={"a": [70] * 5, "b": [20] * 5})).table
    assert table[["low", "mean_rank", "high"]].to_numpy().tolist() == [[1, 1, 1], [2, 2, 2]]
    few = ranking(results(one=same, two={"a": [70] * 4, "b": [20] * 4})).table
    assert few[["low", "high"]].isna().all(axis=None)


def test_a_system_without_results_on_a_corpus_is_left_out():
    """Also one that lacks a person; a corpus with one system is not ranked."""
    partly = {**TWO, "c": [50, np.nan]}
    found = ranking(results(one=ONE | {"d": [100] * 3}, two=partly, three={"a": [30, 50]}))
    assert found.table["system"].tolist() == ["b", "a"] and found.unranked == ["three"]
    assert found.lacking == {"d": ["two"], "c": ["two"]}
    assert ranking(results(one=ONE)) is None and ranking(results(one=ONE, two={"a": [1, 2]})) is None


@given(st.lists(st.tuples(st.sets(st.sampled_from("abcdef"), min_size=1), st.integers(1, 4)), max_size=5))
def test_no_other_set_of_corpora_has_more_results(stored):
    """A loop over all sets of corpora; of those with the most results, the largest is taken."""
    tables = {f"c{i}": {system: [1.0] * people for system in systems} for i, (systems, people) in enumerate(stored)}
    most = (0, 0)
    for n in range(2, len(stored) + 1):
        for some in combinations(stored, n):
            systems = set.intersection(*(systems for systems, _ in some))
            if len(systems) > 1:
                most = max(most, (len(systems) * sum(people for _, people in some), n))
    found = ranking(results(**tables))
    assert (
        (0, 0) == most if found is None else (len(found.table) * sum(found.people.values()), len(found.people)) == most
    )


def corpora():
    """Results of two systems on corpora, the newest last, and of one system on one of them."""
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
    others = len(made)
    run("cuddlebot", "f", [5, 8, 16])
    about = {"data": "cuddlebot", "corpus_digest": "f" * 64, "synthetic": "false"}
    return made[:others], [*made[others:], evaluated("alone", with_hits([1, 2, 3]), **about)]


def test_corpora_of_different_people_are_ranked_together():
    """Changed, joined and generated corpora do not count, nor does another protocol."""
    one, another = corpora()
    assert distinct(grouped(one)) == []
    ((groups, left_out),) = distinct(grouped([*one, *another]))
    assert {*groups} == {"haart", "cuddlebot"} and {*left_out} == {"haart-aligned", "haart+x", "copy"}


def test_the_report_ranks_over_two_corpora(monkeypatch):
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda self, path, **_: Path(path).write_text("<svg/>"))
    store = connect()
    one, another = corpora()
    for r in one:
        keep(store, r)
    page.write_report(store, Path("report"))
    assert "Over several corpora" not in Path("report/index.html").read_text()
    assert Path("report/ranking.csv").read_text().startswith("system,mean_rank,")
    for r in another:
        keep(store, r)
    page.write_report(store, Path("report"))
    text, table = Path("report/comparison.md").read_text(), pd.read_csv("report/ranking.csv")
    assert "## Over several corpora" in text and "align=2:1" in text and "on haart: alone" in text
    assert "7 people: 4 of haart and 3 of cuddlebot" in text and "is unknown" in text
    assert table["mean_rank"].tolist() == [1, 2] and table["difference"].tolist() == [0, -20]
    assert 'id="over-several-corpora"' in Path("report/index.html").read_text()
    assert [path.suffix for path in sorted(Path("report/figures").glob("*over-several*"))] == [".svg"]
