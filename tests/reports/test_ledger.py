"""What a protocol adds, by hand."""

import json

import numpy as np
import pytest
from scipy import stats

from bench.reports import ledger
from bench.reports.comparison import load_published
from bench.reports.papers import compare_with_published
from tests.reading.results import HAART, make_run, predictions_with_hits

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


def runs(hits=HITS, command="run", **about):
    """Runs on captures with the name of HAART, with the arguments that made them."""
    made = []
    for (system, name), right in hits.items():
        typed = {"data": "haart", "protocol": name, "model": system, "features": "touch"}
        tags = {
            "touchbench.command": command,
            "touchbench.arguments": json.dumps(typed),
            "protocol": name,
            "protocol_label": WORDS[name],
            "mixes_subjects": str(name != "loso").lower(),
        }
        made.append(make_run(system, predictions_with_hits(right), **HAART | tags | about))
    return made


def test_points_are_paired_over_people():
    table = ledger.make_ledger(runs()).set_index(["system", "key"])
    assert len(table) == len(HITS) and set(table["protocol"]) == set(WORDS.values())
    for (system, protocol), right in HITS.items():
        row, loso = table.loc[system, protocol], np.array(HITS[system, "loso"])
        assert row["accuracy"] == pytest.approx(5 * np.mean(right)) and row["subjects"] == 6
        assert row["mixes_subjects"] == (protocol != "loso")
        others = [np.mean(other) for (_, name), other in HITS.items() if name == protocol]
        assert row["place"] == f"{1 + sum(mean > np.mean(right) for mean in others)} of 2"
        if protocol == "loso":
            assert np.isnan(row["points"])
            continue
        points = 5.0 * (np.array(right) - loso)  # the interval of six people is their whole range
        numbers = [points.mean(), points.min(), points.max(), 2 / 2**6]
        names = ["points", "points_low", "points_high", "p"]
        assert row[names].tolist() == pytest.approx(numbers)


def test_only_captures_under_two_protocols_are_in_it():
    loso = {key: hits for key, hits in HITS.items() if key[1] == "loso"}
    others = {key: hits for key, hits in HITS.items() if key[1] != "loso"}
    subset = runs({("svm", "kfold"): HITS["svm", "kfold"]}, subset="cover == 'none'")
    assert not len(ledger.make_ledger([])) and not len(ledger.make_ledger([*runs(loso), *subset]))
    made = runs(others)
    table = ledger.make_ledger(made)
    assert len(table) == 4 and table["points"].isna().all()
    assert ledger.explain_published("haart", ledger.accuracies_by_protocol(made)).empty


def test_published_numbers_without_the_points_of_their_protocol():
    accuracies = ledger.accuracies_by_protocol(runs())
    numbers = ledger.explain_published("haart", accuracies).set_index("id")
    printed = load_published().query("data == 'haart' and accuracy.notna()")
    assert set(numbers.index) == set(printed["id"])
    gains = [np.subtract(HITS[s, "kfold"], HITS[s, "loso"]) for s in ("svm", "lda")]
    people = 5 * np.mean(gains, axis=0)
    ends = stats.ttest_1samp(people, 0).confidence_interval()
    row = numbers.loc["cang2015-haart-all"]
    assert row["nearest"] == "kfold (inferred)" and row["printed"] == 90
    values = row[["points", "points_low", "points_high", "less"]].tolist()
    assert values == pytest.approx([people.mean(), ends.low, ends.high, 90 - people.mean()])
    assert numbers.loc["almashhadani2021-haart", ["points", "less"]].tolist() == [0, 83.2]
    unknown = {
        "xu2026-haart": "unknown",
        "ta2015-haart-test": "challenge, not run",
        "cang2015-haart-person": "within (inferred), not run",
    }
    assert numbers.loc[[*unknown], "nearest"].to_dict() == unknown
    assert numbers.loc[[*unknown], "points"].isna().all()


def test_share_of_the_spread():
    printed = load_published()["accuracy"].iloc[[0, 1, 4]]
    rest = load_published()["accuracy"].iloc[[0, 1, 5]]  # 53, 46, 64 or 54
    share = 1 - np.var([53, 46, 54]) / np.var([53, 46, 64])
    assert ledger.explained_share(printed, rest) == pytest.approx(share)
    assert np.isnan(ledger.explained_share(printed[:2], rest[:2]))


def test_one_command_runs_what_is_missing():
    some = {key: right for key, right in HITS.items() if key != ("lda", "windows")}
    command = "bench run data=haart protocol={} model=svm,lda features=touch"
    assert ledger.missing_commands(runs(some)) == [command.format("windows,within,challenge")]
    assert ledger.missing_commands(runs()) == [command.format("within,challenge")]
    tuned = runs({("svm", "loso"): HITS["svm", "loso"]}, command="tune")
    (line,) = ledger.missing_commands(tuned)
    assert line.startswith("bench tune data=haart protocol=windows,kfold,")


def test_a_line_is_interrupted_at_a_protocol_that_its_system_lacks():
    some = {key: right for key, right in HITS.items() if key != ("svm", "kfold")}
    (axes,) = ledger.draw_slopes(ledger.make_ledger(runs(some)), "").axes
    drawn = [container.lines[0].get_ydata().astype(float) for container in axes.containers]
    means = {key: 5 * np.mean(right) for key, right in some.items()}
    protocols = ("windows", "kfold", "loso")
    expected = [[means.get((s, p), np.nan) for p in protocols] for s in ("svm", "lda")]
    np.testing.assert_allclose(drawn, expected)


def test_exhibits_of_the_ledger(tmp_path):
    made = runs()
    assert ledger.ledger_exhibits(made[:1], compare_with_published(made[:1]), tmp_path) == []
    first, _, numbers = ledger.ledger_exhibits(made, compare_with_published(made), tmp_path)
    words = "differs: svm under windows, lda under kfold, lda under loso"
    assert words in " ".join(first.sentences)
    texts = first.table.texts
    assert [row["protocol"] for row in texts[:3]] == [
        WORDS[p] for p in ("windows", "kfold", "loso")
    ]
    points = [row["points over LOSO [95 %]"] for row in texts[1:3]]
    assert points[0].startswith("+7.5 [") and points[1] == "-"
    drawing = first.picture.path.read_text()
    assert 'id="line2d' not in drawing  # which other figures of the page have, too
    for word in ("optimistic", "subjects mixed", "new subjects", "svm", "lda"):
        assert word in drawing
    sentences = " ".join(numbers.sentences)
    assert "is unknown, so nothing is explained" in sentences and "not run here" in sentences
