"""The analysis of `bench stress` on made-up tables: planted failures are found, others are not."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from bench.values.stability import (
    accuracy_curve,
    chance_accuracy,
    clean_labels,
    find_failing_slices,
    half_margins,
    score_slices,
)
from tests.reading.results import analyse_labels

WORDS = {"under": "fault"}


def made_up(
    seed=0,
    subjects=10,
    repetitions=6,
    accuracy=0.6,
    failing=lambda row: None,
    faults=("noise", "shift"),
    length=lambda rng: 100,
):
    """A table whose captures are right with one probability, or with that of ``failing(row)``."""
    rng = np.random.default_rng(seed)
    captures = product(
        range(subjects), ("pat", "rub", "tap", "hit"), ("fur", "none"), range(repetitions // 2)
    )
    cases = [("", "none", 0), *product(["under"], faults, range(1, 6))]
    names = ("capture", "subject", "true", "cover", "length", "circumstance", "case", "level")
    rows = []
    for capture, (subject, gesture, cover, _) in enumerate(captures):
        about = (capture, str(subject), gesture, cover, length(rng))
        for case in cases:
            row = dict(zip(names, (*about, *case), strict=True))
            chance = failing(row)
            right = rng.random() < (accuracy if chance is None else chance)
            rows.append(row | {"predicted": gesture if right else "else"})
    table = pd.DataFrame(rows)
    amounts = table["level"].map(lambda level: f"{level} %" if level else "")
    return table.assign(
        fold=table["subject"], train_subjects=subjects - 1, amount=amounts, p_true=0.5
    )


def found_in(table):
    return analyse_labels(table).tables["slices"].set_index("slice")


@pytest.mark.parametrize(
    ("failing", "name", "touched"),
    [
        (
            lambda r: 0.1 if r["case"] == "noise" and r["level"] > 2 else None,
            "noise 3 %",
            "noise [345]",
        ),
        (
            lambda r: 0.05 if r["true"] == "rub" and r["cover"] == "fur" else None,
            "gesture rub, cover fur",
            "rub|fur",
        ),
    ],
)
def test_a_planted_failure_is_found(failing, name, touched):
    found = found_in(made_up(failing=failing, accuracy=0.8, subjects=14, repetitions=12))
    row = found.loc[name]
    assert row["failing"] and row["p_corrected"] <= 0.05 and row["gap"] > 0.2
    innocent = found[~found.index.str.contains(touched)]
    assert innocent["failing"].sum() <= 1 and len(innocent) > 100


def test_the_counts_and_p_values_of_a_slice():
    table = made_up(failing=lambda r: 0.1 if r["case"] == "noise" else None, subjects=8)
    found = found_in(table)
    clean = clean_labels(table)
    hit = clean["true"] == clean["predicted"]
    one = found.loc["subject 2"]
    mine = clean["subject"] == "2"
    assert (
        one["right"] == hit[mine].sum() and one["captures"] == mine.sum() and one["subjects"] == 1
    )
    assert one["p"] == pytest.approx(
        binomtest(one["right"], one["captures"], hit.mean(), "less").pvalue
    )
    noisy = table[(table["case"] == "noise") & (table["level"] == 2) & (table["true"] == "rub")]
    row = found.loc["gesture rub, noise 2 %"]
    right = noisy["true"] == noisy["predicted"]
    assert (row["right"], row["captures"], row["subjects"]) == (right.sum(), len(noisy), 8)
    assert row["gap"] == pytest.approx(hit.mean() - right.mean())
    difference = right.groupby(noisy["subject"]).mean() - hit.groupby(clean["subject"]).mean()
    naive = np.mean(
        [
            np.dot(signs, difference) <= difference.sum() + 1e-9
            for signs in product((1, -1), repeat=8)
        ]
    )
    expected = (hit.groupby(clean["subject"]).mean() * noisy.groupby("subject").size()).sum() / len(
        noisy
    )
    assert row["p"] == pytest.approx(
        max(naive, binomtest(right.sum(), len(noisy), expected, "less").pvalue)
    )


def test_correction_is_benjamini_and_hochbergs_with_a_quarter_of_the_rate_each():
    found = found_in(made_up(failing=lambda r: 0.2 if r["level"] > 3 else None))
    for pairs, faults in product((False, True), repeat=2):
        part = found[
            (found["kind"].str.contains(" x ") == pairs) & ((found["fault"] != "") == faults)
        ]
        p = part.loc[part["tested"], "p"].sort_values()
        naive = [min(p.iloc[j] * len(p) / (j + 1) for j in range(i, len(p))) for i in range(len(p))]
        assert (
            np.allclose(part["p_corrected"].loc[p.index], np.minimum(4 * np.array(naive), 1))
            and len(p) > 1
        )
    assert found.loc[~found["tested"], "p_corrected"].isna().all()
    assert (found["failing"] == (found["p_corrected"] <= 0.05)).all() and found["failing"].any()


def test_groups_are_tested_in_each_circumstance_as_if_it_were_the_only_one():
    table = made_up(failing=lambda r: 0.3 if r["level"] > 2 else None).assign(
        hit=lambda t: t["true"] == t["predicted"]
    )
    noise, shift = (table[table["case"].isin(["none", fault])] for fault in ("noise", "shift"))
    shift = shift.assign(circumstance=shift["circumstance"].replace("under", "after"))
    both = pd.concat([noise, shift[shift["circumstance"] == "after"]], ignore_index=True)
    words = {"under": "fault", "after": "time"}
    numbers, tables = find_failing_slices(both, words, "gesture")
    for key, labels in (("under", noise), ("after", shift)):
        own, made = find_failing_slices(labels, {key: words[key]}, "gesture")
        rows = tables["slices"][tables["slices"]["circumstance"].isin(["", words[key]])]
        of = [each.set_index("slice").sort_index() for each in (rows, made["slices"])]
        pd.testing.assert_frame_equal(*of)
        for count in (f"failing_slices.{key}", f"tested_slices.{key}"):
            assert numbers[count] == own[count] == own[count.partition(".")[0]] > 0
    assert numbers["failing_slices"] == tables["slices"]["failing"].sum() > own["failing_slices"]


def test_small_slices_of_weak_methods_that_could_never_fail_are_not_tested():
    """Twelve captures of six subjects, right one time in five: the lowest binomial p is 0.8^12."""
    rows = [
        (str(s), 100 * s + c, "a" if c < 2 else "b", c % 5 == 0)
        for s in range(6)
        for c in range(40)
    ]
    table = pd.DataFrame(rows, columns=["subject", "capture", "true", "hit"])
    table["predicted"] = np.where(table["hit"], table["true"], "c")
    same = {
        "circumstance": "",
        "case": "none",
        "level": 0,
        "amount": "",
        "train_subjects": 4,
        "length": 5,
    }
    table = table.assign(fold=table["subject"], **same)
    found = score_slices(table, WORDS, "gesture").set_index("slice")
    assert found.loc["gesture a", "captures"] == 12 and found.loc[
        "gesture a", "floor"
    ] == pytest.approx(0.8**12)
    assert not found.loc["gesture a", "tested"] and found.loc["gesture b", "tested"]


def test_curves_by_hand():
    captures = [
        ("1", 1, "a", "a", "b"),
        ("1", 2, "b", "a", "b"),
        ("2", 3, "a", "a", "b"),
        ("2", 4, "b", "b", "b"),
    ]
    cases = {3: ("", "none", 0), 4: ("under", "noise", 1)}  # by the place of the label
    rows = [
        (*capture[:3], capture[place], *case)
        for place, case in cases.items()
        for capture in captures
    ]
    table = pd.DataFrame(
        rows, columns=["fold", "capture", "true", "predicted", "circumstance", "case", "level"]
    )
    table = table.assign(subject=table["fold"], amount="1 %", train_subjects=1, length=5)
    (row,) = accuracy_curve(table.sample(frac=1, random_state=0), "under").to_dict("records")
    assert (row["accuracy"], row["loss"], row["broken"], row["mended"], row["captures"]) == (
        0.5,
        0.25,
        2,
        1,
        4,
    )


def test_where_half_of_the_margin_is_lost():
    accuracy = pd.Series([0.8, 0.7, 0.4, 0.6, 0.1])
    found = pd.DataFrame(
        {"fault": "noise", "severity": range(1, 6), "accuracy": accuracy, "loss": 0.9 - accuracy}
    )
    found["amount"] = [f"{10 * severity} %" for severity in found["severity"]]

    def half(clean, chance, **changed):
        (row,) = half_margins(found.assign(**changed), clean, chance).to_dict("records")
        return row["half_margin"], row["where"]

    assert half(0.9, 0.1) == (
        pytest.approx(2 + 0.2 / 0.3),
        "20 to 30 %",
    )  # 0.5 lies between 0.7 and 0.4
    assert half(0.9, 0.75) == (pytest.approx(0.75), "below 10 %")  # 0.825 between 0.9 and 0.8
    assert half(0.9, 0.1, accuracy=0.6) == (np.inf, "beyond 50 %")
    assert np.isnan(half(0.3, 0.3)[0]) and half(0.3, 0.3)[1] == "no margin"
    assert half_margins(found, 0.9, 0.1)["loss"].iloc[0] == pytest.approx(0.38)


def test_length_and_training_subjects():
    table = made_up(length=lambda rng: int(rng.integers(1, 200)))
    fewer = table[table["case"] == "none"].assign(
        train_subjects=3, predicted="else", circumstance="train_subjects"
    )
    tables = (one := analyse_labels(pd.concat([table, fewer], ignore_index=True))).tables
    frames = tables["conditions"][tables["conditions"]["factor"] == "frames"]
    units = clean_labels(tables["labels"])
    assert len(frames) == 5 and frames["captures"].sum() == units["capture"].nunique()
    ends = sorted(tuple(map(int, value.split(" to "))) for value in frames["value"])
    assert all(high < low for (_, high), (low, _) in zip(ends[:-1], ends[1:], strict=True))
    assert tables["learning"]["train_subjects"].tolist() == [3, 9]
    assert tables["learning"]["accuracy"].tolist() == [0, one["accuracy"]]
    assert one["accuracy"] == pytest.approx((units["true"] == units["predicted"]).mean())
    assert one["chance"] == chance_accuracy(units) == 0.25
    assert "frames" not in set(analyse_labels(made_up()).tables["conditions"]["factor"])
