"""What a protocol adds, by hand: paired points over LOSO, published numbers without them, and what was not run."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bench.reports import ledger
from bench.reports.comparison import published
from bench.reports.papers import against
from tests.results import HAART, evaluated, with_hits

HITS = {  # of 20 captures of each of six subjects
    ("svm", "loso"): [8, 9, 10, 11, 12, 13],
    ("svm", "windows"): [20, 20, 20, 20, 20, 19],
    ("svm", "kfold"): [9, 11, 13, 12, 14, 16],
    ("lda", "loso"): [9, 10, 11, 12, 14, 16],
    ("lda", "windows"): [18, 17, 19, 18, 18, 18],
    ("lda", "kfold"): [12, 12, 12, 13, 15, 17],
}
WORDS = {"loso": "LOSO (6 subjects)", "windows": "10-fold of windows, optimistic", "kfold": "10-fold, subjects mixed"}


def runs(hits=HITS, **about):
    """Runs on captures that go by the name of HAART, with the arguments that made them."""
    made = []
    for (system, protocol), right in hits.items():
        typed = {"data": "haart", "protocol": protocol, "model": system, "features": "touch"}
        tags = {
            "protocol": protocol,
            "protocol_label": WORDS[protocol],
            "mixes_subjects": str(protocol != "loso").lower(),
        }
        tags |= {"touchbench.command": "run", "touchbench.arguments": json.dumps(typed)}
        made.append(evaluated(system, with_hits(right), **HAART | tags | about))
    return made


def test_points_are_paired_over_people():
    table = ledger.ledger(runs()).set_index(["system", "key"])
    assert len(table) == len(HITS) and set(table["protocol"]) == set(WORDS.values())
    for (system, protocol), right in HITS.items():
        row, loso = table.loc[system, protocol], np.array(HITS[system, "loso"])
        assert row["accuracy"] == pytest.approx(5 * np.mean(right)) and row["subjects"] == 6
        assert row["mixes_subjects"] == (protocol != "loso")
        better = sum(np.mean(other) > np.mean(right) for (_, p), other in HITS.items() if p == protocol)
        assert row["place"] == f"{better + 1} of 2"
        if protocol == "loso":
            assert np.isnan(row["points"])
            continue
        points = 5.0 * (np.array(right) - loso)
        assert row["points"] == pytest.approx(points.mean())
        ends = [points.min(), points.max()]  # the interval of the test of six people is their whole range
        assert row[["points_low", "points_high"]].tolist() == pytest.approx(ends)
        assert row["p"] == pytest.approx(2 / 2**6)  # all six gain


def test_only_captures_under_two_protocols_are_in_it():
    one = {key: right for key, right in HITS.items() if key[1] == "loso"}
    assert not len(ledger.ledger(runs(one))) and not len(ledger.ledger([]))
    assert not len(
        ledger.ledger([*runs(one), *runs({("svm", "kfold"): HITS["svm", "kfold"]}, subset="cover == 'none'")])
    )
    without = runs({key: right for key, right in HITS.items() if key[1] != "loso"})
    table = ledger.ledger(without)
    assert len(table) == 4 and table["points"].isna().all() and ledger.explained(without, ledger.under(without)).empty


def test_published_numbers_without_the_points_of_their_protocol():
    made = runs()
    numbers = ledger.explained(made, ledger.under(made)).set_index("id")
    assert set(numbers.index) == set(published().query("data == 'haart' and accuracy.notna()")["id"])
    people = 5 * np.mean([np.subtract(HITS[s, "kfold"], HITS[s, "loso"]) for s in ("svm", "lda")], axis=0)
    ends = stats.ttest_1samp(people, 0).confidence_interval()
    row = numbers.loc["cang2015-haart-all"]
    assert row["nearest"] == "kfold (inferred)" and row["printed"] == 90 and "inferred" in row["says"]
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
    printed, left = published()["accuracy"].iloc[[0, 1, 4]], published()["accuracy"].iloc[[0, 1, 5]]  # 53, 46, 64 or 54
    assert ledger.share(printed, left) == pytest.approx(1 - np.var([53, 46, 54]) / np.var([53, 46, 64]))
    assert np.isnan(ledger.share(printed[:2], left[:2]))


def test_one_command_runs_what_is_missing():
    some = {key: right for key, right in HITS.items() if key != ("lda", "windows")}
    assert ledger.missing(runs(some)) == [
        "bench run data=haart protocol=windows,within,challenge model=svm,lda features=touch"
    ]
    (tuned,) = ledger.missing(runs({("svm", "loso"): HITS["svm", "loso"]}, **{"touchbench.command": "tune"}))
    assert tuned.startswith("bench tune data=haart protocol=windows,kfold,")
    assert ledger.missing(runs()) == ["bench run data=haart protocol=within,challenge model=svm,lda features=touch"]


def test_a_line_is_interrupted_at_a_protocol_that_its_system_lacks():
    rows = ledger.ledger(runs({key: right for key, right in HITS.items() if key != ("svm", "kfold")}))
    (axes,) = ledger.slopes(rows, "").axes
    drawn = [container.lines[0].get_ydata() for container in axes.containers]
    means = [[5 * np.mean(HITS[system, p]) for p in ("windows", "kfold", "loso")] for system in ("svm", "lda")]
    means[0][1] = np.nan
    np.testing.assert_allclose([ys.astype(float) for ys in drawn], means)


def test_the_section_and_its_picture(tmp_path):
    made = runs()
    assert ledger.section(made[:1], against(made[:1]), tmp_path)[0] == []
    (section,), rows = ledger.section(made, against(made), tmp_path)
    pd.testing.assert_frame_equal(rows, ledger.ledger(made))
    first, command, numbers = section.parts
    assert section.heading == "What a protocol adds"
    assert "differs: svm under windows, lda under kfold, lda under loso" in " ".join(first.sentences)
    rows = first.table.texts
    assert [row["protocol"] for row in rows[:3]] == [WORDS["windows"], WORDS["kfold"], WORDS["loso"]]
    assert first.table.groups == ["lda"] * 3 + ["svm"] * 3
    assert rows[1]["points over LOSO [95 %]"].startswith("+7.5 [") and rows[2]["points over LOSO [95 %]"] == "-"
    drawing = first.picture.path.read_text()
    assert 'id="line2d' not in drawing  # which other figures of the page have, too
    assert all(word in drawing for word in ("optimistic", "subjects mixed", "new subjects", "svm", "lda"))
    assert len(command.table) == 1
    words = " ".join(numbers.sentences)
    assert re.search(r"The 2 published|is unknown, so nothing is explained", words) and "not run here" in words
