"""Sections of the report, by hand: faults, revisions, one ranking over corpora, and what a protocol adds."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bench.cli import main
from bench.ground.registry import views
from bench.reading.frame import grouped
from bench.reports import ledger
from bench.reports.comparison import published
from bench.reports.contexts import contexts
from bench.reports.history import drawn, history, section
from bench.reports.over_corpora import ranking, rankings
from bench.reports.papers import against
from tests.reports.store import tracked_run
from tests.results import HAART, evaluated, stressed, with_hits

BOTH = {"noise": 0.1, "shift": 0.234}


def test_faults_of_each_method_the_run_that_met_most_then_the_newest_with_its_lowest_seed(tmp_path):
    results = [
        stressed("svm", 0.5, BOTH),
        whole := stressed("svm", 0.6, BOTH, {"half_margin.shift": 2.25}),
        stressed("svm", 0.6, {"noise": 0.3}),
        stressed("svm", 0.9, BOTH, status="FAILED"),
        stressed("svm", 0.9, BOTH, seed="1"),
        forest := stressed("rf", 0.7, {"noise": 0.05}),
        stressed("rf", 0.7, BOTH, subset="cover == 'none'"),
        stressed("rf", 0.7, BOTH, data="synth", synthetic="true"),
    ]
    (first, runs), *rest = contexts(results, more="loss.")
    assert runs == [forest, whole] and first.endswith("only the lowest seed of each system")
    assert ["cover" in name for name, _ in rest] == [True, False] and "(synthetic)" in rest[1][0]
    part = views()["under"].section(results, tmp_path).parts[0]
    picture, table = part.picture, part.table
    drawing = picture.path.read_text()
    assert all(
        f">{text}</text>" in drawing
        for text in ("23", "10", "5", "-", "svm (60 % clean)", "rf (70 % clean)")
    )
    row = table.shown().set_index("system").loc["svm"]
    assert (
        row["half of the margin is lost at"] == "shift 2.2"
        and row["failing of tested groups"] == "3 of 40"
    )
    assert row["worst subject"] == "30.0" and table.shown()["system"].tolist() == ["rf", "svm"]


def test_groups_of_several_corpora_and_words_of_what_they_share_come_from_the_class():
    runs = [
        evaluated("svm", corpus_digest=digest, **{"dim.mode": mode})
        for digest in "ab"
        for mode in ("up", "down")
    ]
    same = {"dim.mode": ("pressed {}", "up")}
    found = contexts(runs, same)
    assert len(found) == 3 and [members for _, members in contexts(runs)] == [[runs[3]], [runs[1]]]
    assert ["pressed down" in words for words, _ in found] == [True, False, True]
    assert len({words for words, _ in found}) == 3 and not any("up" in words for words, _ in found)


def run(git, right, cost=1.0, relative=2.0, **about):
    return evaluated(
        "a",
        with_hits([right] * 5),
        cost=cost,
        metrics={"predict_relative": relative},
        git=git,
        **about,
    )


def test_a_step_is_where_the_gate_would_no_longer_report_the_same():
    runs = [
        run("a", 9),
        run("a", 14),
        run("b", 14, relative=3.9),
        run("c", 8),
        run("d+changes", 8, cost=1.09),
    ]
    runs += [
        run("e", 8, cost=1.11),
        run("f", 8, 1.11, relative=4.1),
        run("x", 3, seed=1),
        run("x", 20, data="other"),
    ]
    table = history(runs)
    assert table["revision"].tolist() == [
        "a",
        "b",
        "c",
        "d+changes",
        "e",
        "f",
    ]  # the newest of a; others have one
    wrong = table.set_index("revision")["step"].str.partition(":")[0].to_dict()
    assert wrong == {"a": "", "b": "", "c": "worse", "d+changes": "", "e": "larger", "f": "slower"}
    assert table["before"].tolist() == ["", "a", "b", "c", "d+changes", "e"]
    assert "30 of 100 labels changed" in table["step"][2] and "time x2.05" in table["step"][5]
    again = history([run("a", 9), run("b", 9), run("a", 9)])
    assert again["revision"].tolist() == ["b", "a"]  # the runs that count, in their order
    slow = history(
        [
            run(git, 14, relative=relative)
            for git, relative in zip("abcd", (1, 1.5, 1.9, 2.5), strict=True)
        ]
    )
    assert slow["step"].str.partition(":")[0].tolist() == ["", "", "", "slower"]


def test_the_report_draws_each_revision_and_lists_steps(store, quick, capsys, tmp_path):
    tracked_run(store, "a", with_hits([9] * 5), git="0" * 12)
    assert main(["report", "history=yes"]) == 0 and not Path("report/history.csv").exists()
    assert "no system has complete runs of several revisions" in capsys.readouterr().err
    made = [run("0" * 12, 9), run("1" * 12, 14), run("3" * 12 + "+changes", 8)]
    shown, table = section(made, tmp_path)
    np.testing.assert_allclose(table["accuracy %"], [45, 70, 40])
    assert table["flash kB"].tolist() == [4] * 3 and (table["step"] != "").tolist() == [
        False,
        True,
        True,
    ]
    ticks = {
        label.get_text() for axes in drawn(history(made)).axes for label in axes.get_xticklabels()
    }
    assert (
        any(text.startswith("33333333+") for text in ticks) and len(shown.parts[0].table.rows) == 2
    )


ONE = pd.DataFrame(
    {"a": [90.0, 80, 50], "b": [70.0, 80, 60], "c": [10.0, 20, 70]}
).T  # accuracy of three people
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
    assert table.loc["a", ends].tolist() == pytest.approx(
        [-2, np.nan, np.nan], nan_ok=True
    )  # of five people
    six = ranking({"one": ONE, "two": ONE}).set_index("system")
    lost = (
        ONE.loc["c"] - ONE.loc[six.index[0]]
    )  # the interval of the test of six people is their whole range
    assert six.loc["c", ends].tolist() == pytest.approx([lost.mean(), lost.min(), lost.max()])


def test_a_system_without_results_on_a_corpus_is_left_out():
    """Also one that lacks a person; a corpus with one system is not ranked."""
    partly, more = TWO.copy(), ONE.copy()
    partly.loc["c", 1], more.loc["d"] = np.nan, 100.0
    found = ranking({"one": more, "two": partly, "three": TWO.loc[["a"]]})
    assert found["system"].tolist() == ["b", "a"] and "three_place" not in found
    assert ranking({"one": ONE}) is None and ranking({"one": ONE, "two": TWO.loc[["a"]]}) is None


def test_corpora_of_different_people_are_ranked():
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
    (table,) = rankings(grouped(made)).values()
    assert table["mean_rank"].tolist() == [1, 2] and table["difference"].tolist() == [0, -20]
    assert [name for name in table if name.endswith("_place")] == ["haart_place", "cuddlebot_place"]


HITS = {  # of 20 captures of each of six subjects
    ("svm", "loso"): [8, 9, 10, 11, 12, 13],
    ("svm", "windows"): [20, 20, 20, 20, 20, 19],
    ("svm", "kfold"): [9, 11, 13, 12, 14, 16],
    ("lda", "loso"): [9, 10, 11, 12, 14, 16],
    ("lda", "windows"): [18, 17, 19, 18, 18, 18],
    ("lda", "kfold"): [12, 12, 12, 13, 15, 17],
}
WORDS = {
    "loso": "LOSO (6 subjects)",
    "windows": "10-fold of windows, optimistic",
    "kfold": "10-fold, subjects mixed",
}


def runs(hits=HITS, **about):
    """Runs on captures that go by the name of HAART, with the arguments that made them."""
    made = []
    for (system, name), right in hits.items():
        typed = {"data": "haart", "protocol": name, "model": system, "features": "touch"}
        tags = {
            "touchbench.command": "run",
            "touchbench.arguments": json.dumps(typed),
            "protocol": name,
        }
        tags |= {"protocol_label": WORDS[name], "mixes_subjects": str(name != "loso").lower()}
        made.append(evaluated(system, with_hits(right), **HAART | tags | about))
    return made


def test_points_are_paired_over_people():
    table = ledger.ledger(runs()).set_index(["system", "key"])
    assert len(table) == len(HITS) and set(table["protocol"]) == set(WORDS.values())
    for (system, protocol), right in HITS.items():
        row, loso = table.loc[system, protocol], np.array(HITS[system, "loso"])
        assert row["accuracy"] == pytest.approx(5 * np.mean(right)) and row["subjects"] == 6
        assert row["mixes_subjects"] == (protocol != "loso")
        better = sum(
            np.mean(other) > np.mean(right) for (_, p), other in HITS.items() if p == protocol
        )
        assert row["place"] == f"{better + 1} of 2"
        if protocol == "loso":
            assert np.isnan(row["points"])
            continue
        points = 5.0 * (np.array(right) - loso)
        assert row["points"] == pytest.approx(points.mean())
        ends = [
            points.min(),
            points.max(),
        ]  # the interval of the test of six people is their whole range
        assert row[["points_low", "points_high"]].tolist() == pytest.approx(ends)
        assert row["p"] == pytest.approx(2 / 2**6)  # all six gain


def test_only_captures_under_two_protocols_are_in_it():
    one, without = (
        {k: hits for k, hits in HITS.items() if (k[1] == "loso") == loso} for loso in (True, False)
    )
    other = runs({("svm", "kfold"): HITS["svm", "kfold"]}, subset="cover == 'none'")
    assert not len(ledger.ledger([])) and not len(ledger.ledger([*runs(one), *other]))
    made = runs(without)
    table = ledger.ledger(made)
    assert (
        len(table) == 4
        and table["points"].isna().all()
        and ledger.explained(made, ledger.under(made)).empty
    )


def test_published_numbers_without_the_points_of_their_protocol():
    made = runs()
    numbers = ledger.explained(made, ledger.under(made)).set_index("id")
    assert set(numbers.index) == set(
        published().query("data == 'haart' and accuracy.notna()")["id"]
    )
    people = 5 * np.mean(
        [np.subtract(HITS[s, "kfold"], HITS[s, "loso"]) for s in ("svm", "lda")], axis=0
    )
    ends = stats.ttest_1samp(people, 0).confidence_interval()
    row = numbers.loc["cang2015-haart-all"]
    assert (
        row["nearest"] == "kfold (inferred)" and row["printed"] == 90 and "inferred" in row["says"]
    )
    found = row[["points", "points_low", "points_high", "less"]].tolist()
    assert found == pytest.approx([people.mean(), ends.low, ends.high, 90 - people.mean()])
    assert numbers.loc["almashhadani2021-haart", ["points", "less"]].tolist() == [0, 83.2]
    for name, nearest in (
        ("xu2026-haart", "unknown"),
        ("ta2015-haart-test", "challenge, not run"),
        ("cang2015-haart-person", "within (inferred), not run"),
    ):
        assert numbers.loc[name, "nearest"] == nearest and np.isnan(numbers.loc[name, "points"])
    assert numbers["nearest"].str.startswith("unknown").sum() == 1


def test_share_of_the_spread():
    printed, left = (
        published()["accuracy"].iloc[[0, 1, 4]],
        published()["accuracy"].iloc[[0, 1, 5]],
    )  # 53, 46, 64 or 54
    assert ledger.share(printed, left) == pytest.approx(
        1 - np.var([53, 46, 54]) / np.var([53, 46, 64])
    )
    assert np.isnan(ledger.share(printed[:2], left[:2]))


def test_one_command_runs_what_is_missing():
    some = {key: right for key, right in HITS.items() if key != ("lda", "windows")}
    assert ledger.missing(runs(some)) == [
        "bench run data=haart protocol=windows,within,challenge model=svm,lda features=touch"
    ]
    (tuned,) = ledger.missing(
        runs({("svm", "loso"): HITS["svm", "loso"]}, **{"touchbench.command": "tune"})
    )
    assert tuned.startswith("bench tune data=haart protocol=windows,kfold,")
    assert ledger.missing(runs()) == [
        "bench run data=haart protocol=within,challenge model=svm,lda features=touch"
    ]


def test_a_line_is_interrupted_at_a_protocol_that_its_system_lacks():
    rows = ledger.ledger(
        runs({key: right for key, right in HITS.items() if key != ("svm", "kfold")})
    )
    (axes,) = ledger.slopes(rows, "").axes
    drawn = [container.lines[0].get_ydata() for container in axes.containers]
    means = [
        [5 * np.mean(HITS[system, p]) for p in ("windows", "kfold", "loso")]
        for system in ("svm", "lda")
    ]
    means[0][1] = np.nan
    np.testing.assert_allclose([ys.astype(float) for ys in drawn], means)


def test_the_section_and_its_picture(tmp_path):
    made = runs()
    assert ledger.section(made[:1], against(made[:1]), tmp_path)[0] == []
    (section,), rows = ledger.section(made, against(made), tmp_path)
    pd.testing.assert_frame_equal(rows, ledger.ledger(made))
    first, _, numbers = section.parts
    assert "differs: svm under windows, lda under kfold, lda under loso" in " ".join(
        first.sentences
    )
    texts = first.table.texts
    assert [row["protocol"] for row in texts[:3]] == [
        WORDS["windows"],
        WORDS["kfold"],
        WORDS["loso"],
    ]
    assert (
        texts[1]["points over LOSO [95 %]"].startswith("+7.5 [")
        and texts[2]["points over LOSO [95 %]"] == "-"
    )
    drawing = first.picture.path.read_text()
    assert 'id="line2d' not in drawing  # which other figures of the page have, too
    assert all(
        word in drawing for word in ("optimistic", "subjects mixed", "new subjects", "svm", "lda")
    )
    words = " ".join(numbers.sentences)
    assert (
        re.search(r"The 2 published|is unknown, so nothing is explained", words)
        and "not run here" in words
    )
