"""Two systems of any tool against scipy and by hand, and predictions that cannot be compared."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bench
from bench.cli import main
from tests.reading.results import predictions_with_hits
from tests.reading.test_statistics import signed_rank_by_hand
from tests.reports.store import tracked_run

GESTURES = ("pat", "rub", "tap")
FEW = pd.DataFrame(
    {"id": ["a", "b"], "subject": ["1", "2"], "truth": ["pat", "tap"], "prediction": ["pat", "pat"]}
)


def predictions(hits, of=20):
    """A file's table: of each subject's ``of`` captures as many are right as ``hits`` says."""
    rows = [(100 * s + c, s, c, c < right) for s, right in enumerate(hits, 1) for c in range(of)]
    truth = [GESTURES[c % 3] for _, _, c, _ in rows]
    said = [GESTURES[(c + (not right)) % 3] for _, _, c, right in rows]
    return pd.DataFrame(
        {
            "id": [r[0] for r in rows],
            "subject": [r[1] for r in rows],
            "truth": truth,
            "prediction": said,
        }
    )


def ends_of_seven(differences):
    """The interval of Wilcoxon's test, which rejects a sum of ranks of 2 for seven people (5 %)."""
    means = sorted((a + b) / 2 for i, a in enumerate(differences) for b in differences[i:])
    assert len(means) == 28
    return means[2], means[-3]


def test_two_files_give_scipys_paired_statistics_and_captures_counted_by_hand(capsys):
    """Shuffled rows, CSV with semicolons beside parquet."""
    one, other = predictions([18, 17, 12, 15, 9, 14, 16]), predictions([15, 17, 13, 11, 8, 10, 12])
    one.sample(frac=1, random_state=1).to_csv("one.csv", index=False, sep=";", encoding="utf-8-sig")
    other.to_parquet("other.parquet")
    found = bench.compare("one.csv", Path("other.parquet"))
    gained = 5 * np.array([3, 0, -1, 4, 1, 4, 4])
    assert found.difference == pytest.approx(gained.mean())
    assert (found.low, found.high) == pytest.approx(ends_of_seven(gained))
    assert found.p == pytest.approx(signed_rank_by_hand(gained))
    assert (found.gain, found.lose) == (["1", "4", "5", "6", "7"], ["3"])
    only, other_only = found.only()  # the captures between the numbers of right ones
    more = {1: (15, 18), 4: (11, 15), 5: (8, 9), 6: (10, 14), 7: (12, 16)}
    assert sorted(only) == sorted(
        f"{100 * s + c}" for s, ends in more.items() for c in range(*ends)
    )
    assert other_only == ["312"]
    merged = one.merge(other, on=["id", "subject", "truth"])
    for row in found.gestures.to_dict("records"):
        each = merged[merged["truth"] == row["gesture"]]
        rights = [
            (each[p] == each["truth"]).groupby(each["subject"]).mean() * 100
            for p in ("prediction_x", "prediction_y")
        ]
        assert (row["captures"], row["difference"]) == (
            len(each),
            pytest.approx((rights[0] - rights[1]).mean()),
        )
        assert (row["low"], row["high"]) == pytest.approx(ends_of_seven([*(rights[0] - rights[1])]))
    assert found.gestures[["only", "other_only"]].sum().tolist() == [16, 1]
    assert main(["compare", "one.csv", "other.parquet", "out=both.csv"]) == 0
    assert f"{abs(found.difference):.1f} points more accurate" in capsys.readouterr().out
    both = pd.read_csv("both.csv")
    assert len(both) == 140 and (both["right"] - both["other_right"]).sum() == 15


def test_the_test_rejects_above_the_smallest_difference_and_not_below_it():
    hits, other = np.array([18, 17, 12, 15, 9, 14, 16]), np.array([15, 17, 13, 11, 8, 10, 12])
    spread = 5 * (hits - other - np.mean(hits - other))
    smallest = bench.compare(predictions(hits), predictions(other)).smallest
    above, below = (
        [signed_rank_by_hand(spread + sign * by * smallest) for sign in (1, -1)]
        for by in (1.001, 0.999)
    )
    assert max(above) < 0.05 <= max(below)


def test_windows_vote_and_what_one_file_lacks_is_named():
    rows = [
        ("a", "pat"),
        ("a", "pat"),
        ("a", "tap"),
        ("b", "tap"),
        ("b", "rub"),
        ("c", None),
        ("d", "rub"),
    ]
    truth = {"a": "pat", "b": "rub", "c": "pat", "d": "rub"}
    one = pd.DataFrame(
        [(i, "1" if i in "ab" else "2", truth[i], label) for i, label in rows],
        columns=["id", "subject", "truth", "prediction"],
    )
    other = one.drop_duplicates("id").iloc[:3].assign(prediction=["tap", "rub", "pat"])
    found = bench.compare(one, other)
    table = found.captures.set_index("id")
    assert (
        table["right"].to_dict() == {"a": 1, "b": 0.5, "c": 0}
        and table.at["b", "prediction"] == "tap / rub"
    )
    assert found.accuracy.loc["1"].tolist() == [75, 50] and found.accuracy.loc["2"].tolist() == [
        0,
        100,
    ]
    words = repr(found)
    for end in (
        "2 captures (a, b) with several rows",
        "1 capture (b) with a tied vote",
        "1 capture (c) with no pred",
    ):
        assert f"the first table has {end}" in words
    assert (
        "Only the first table has 1 capture (d)" in words
        and "2 subjects: too few for an interval" in words
    )
    assert "interval [" not in words and "detected" not in words and np.isnan(found.low)


def test_labels_that_are_no_truth_and_people_who_may_be_one_are_named():
    one, other = predictions([9, 8, 7]), predictions([8, 8, 8])
    other.loc[other.index[-1], "prediction"] = "knock"
    found = bench.compare(one, other)
    assert "predicts 'knock' (1x), which no capture has as truth; these are wrong." in repr(found)
    tied = other.assign(prediction="knock").iloc[-1:]
    found = bench.compare(one, pd.concat([other.assign(prediction=other["truth"]), tied]))
    assert "predicts 'knock' (1x), which" in repr(found)
    for table in (one, other):
        table["subject"] = table["subject"].map({1: "1", 2: "2", 3: "02"})
    assert "subject '02' (20x) and '2' (20x) may be one" in repr(bench.compare(one, other))
    numbers = predictions([9, 8, 7]).replace(dict(zip(GESTURES, "123", strict=True)))
    floats = numbers.assign(prediction=numbers["prediction"] + ".0")
    with pytest.raises(bench.InputError, match=r"prediction '.\.0' .* may be the truth '.', spelt"):
        bench.compare(numbers, floats)


def test_a_table_against_stored_runs_whose_seeds_are_averaged(store):
    """The ids of a run are places in the corpus."""
    tracked_run(store, "svm · touch", predictions_with_hits([18, 14, 15, 12, 16]))
    tracked_run(store, "svm · touch", predictions_with_hits([16, 14, 15, 12, 16]), seed="1")
    run = tracked_run(store, "lda", predictions_with_hits([17, 14, 15, 12, 16]))
    found = bench.compare(predictions([12] * 5), "svm · touch", data="synth")
    assert found.difference == pytest.approx(-5 * np.mean([5, 2, 3, 0, 4]))
    assert found.subjects == 5
    assert "LOSO" in repr(found) and "cannot verify the protocol of the first table" in repr(found)
    assert bench.compare(run[:8], "svm · touch").difference == pytest.approx(0)
    assert bench.compare(run, "svm · touch, seed 0").difference == pytest.approx(-1)


TABLES = [  # changes of a table, and what is told of it
    (lambda t: t.drop(columns="truth"), "no column truth"),
    (lambda t: t.assign(id=["x", "y"]), "no capture is in both"),
    (lambda t: t.assign(truth=["pat", "rub"]), "capture b: truth is 'tap' in"),
    (lambda t: t.assign(subject=["1", "9"]), "capture b: subject is '2' in"),
    (lambda t: t.assign(subject=["1", None]), "subject is empty"),
    (lambda t: pd.concat([t, t.assign(truth="rub")]), "capture a has 'pat' and 'rub' as truth"),
    (lambda t: t.iloc[:0], "no predictions"),
    (lambda t: t.assign(prediction=["Pat", "tap"]), "'Pat' .1x. may be the truth 'pat'"),
    (lambda t: t.assign(prediction=["tap", "[pat]"]), "'.pat.' .1x. may be the truth 'pat'"),
    (lambda t: t.assign(prediction=[0, 2]), "predicts '0' .1x., '2' .1x., which no capture has"),
]
FILES = [  # content of a file, or the name of one
    (FEW.to_csv(index=False).encode("utf-16"), "UTF-8"),
    (FEW.assign(truth="größ").to_csv(index=False).encode("latin-1"), "line 2"),
    (b"id,subject,truth,prediction\na,1,pat,pat\nb,2\n", "line 3"),
    ("nowhere.csv", "no such file"),
    (".", "scored run"),
    ("good.csv", "both are good.csv"),
]


@pytest.mark.parametrize(("wrong", "words"), TABLES + FILES)
def test_what_cannot_be_compared_is_refused_in_a_line(wrong, words):
    FEW.to_csv("good.csv", index=False)
    given = [wrong] if isinstance(wrong, str) else ["wrong.csv"]
    if callable(wrong):
        wrong(FEW).to_csv("wrong.csv", index=False)
        given.append(wrong(FEW))
    elif isinstance(wrong, bytes):
        Path("wrong.csv").write_bytes(wrong)
    for each in given:
        with pytest.raises(bench.InputError, match=words) as error:
            bench.compare("good.csv", each)
        assert "\n" not in str(error.value)


def test_a_damaged_parquet_file_and_keys_beside_two_files_are_refused():
    FEW.to_parquet("half.parquet")
    Path("half.parquet").write_bytes(Path("half.parquet").read_bytes()[:-40])
    with pytest.raises(bench.InputError, match="not a readable parquet"):
        bench.compare(FEW, "half.parquet")
    with pytest.raises(bench.InputError, match="data= selects stored runs"):
        bench.compare(FEW, FEW.assign(prediction="rub"), data="haart")
