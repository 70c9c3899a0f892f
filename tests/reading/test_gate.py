"""The gate: its tests against enumeration, its verdicts, and the file of a baseline."""

import itertools
import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from bench.errors import InputError
from bench.grammar.options import command_options
from bench.ground.digests import json_with_digest
from bench.reading.gate import (
    SystemRecord,
    baseline_json,
    bootstrap_distribution,
    bootstrap_interval,
    bootstrap_p,
    bootstrap_units,
    compare_with_baseline,
    read_baseline,
    why_labels_may_differ,
)
from bench.running.results import FoldResult, combine_costs

NAMES = {
    "data": "toy",
    "corpus_digest": "d",
    "subset": "all",
    "target": "gesture",
    "protocol": "loso",
    "system": "s",
}
HERE = {"cpu": "x", "threads": "1", "version.numpy": "2"}
LIMITS = {name: command_options("check")[name].default for name in ("error", "slower")}


def measured(right, seed="none", costs=None, **fields):
    """A run of a subject for each capture, with a correct label wherever ``right`` is 1."""
    labels = pd.DataFrame(
        {"capture": range(len(right)), "true": "pat", "predicted": np.where(right, "pat", "rub")}
    )
    labels["fold"] = labels["subject"] = labels["capture"].astype(str)
    costs = {"relative": 2.0, "flash": 400.0} if costs is None else costs
    return SystemRecord("model=svm", NAMES | {"seed": seed} | fields, HERE, costs, labels, True)


def words(then, now, **limits):
    (verdict,) = compare_with_baseline([then], [now], **LIMITS | limits)
    return verdict.alarms


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=4))
def test_the_bootstrap_is_the_limit_of_drawing_with_replacement(differences):
    differences = np.array(differences)
    n = len(differences)
    sums = Counter(sum(draw) for draw in itertools.product(differences, repeat=n))
    values, chance = bootstrap_distribution(differences, n)
    assert dict(zip(values[chance > 0], chance[chance > 0], strict=True)) == pytest.approx(
        {s: count / n**n for s, count in sums.items()}
    )
    signed = itertools.product([*differences, *-differences], repeat=n)
    far = sum(abs(sum(draw)) >= abs(differences.sum()) for draw in signed)
    assert bootstrap_p(differences) == pytest.approx(far / (2 * n) ** n)
    every = np.repeat([*sums], [*sums.values()])
    low, high = bootstrap_interval(differences)
    assert (every <= low).mean() >= 0.025 - 1e-9 and (every < low).mean() <= 0.025 + 1e-9
    assert (every <= high).mean() >= 0.975 - 1e-9 and (every < high).mean() <= 0.975 + 1e-9


def test_the_chances_of_a_false_alarm_are_as_stated():
    """Two runs whose hits differ by chance; captures of a subject vary together."""
    rng = np.random.default_rng(1)
    p = []
    for _ in range(1500):
        luck = rng.normal(0, 0.1, (2, 12, 1))
        hits = (rng.random((2, 12, 20)) < 0.6 + luck).sum(axis=2)
        p.append(bootstrap_p(hits[1] - hits[0]))
    p = np.array(p)
    for level in (0.05, 0.01):  # at most the level, but for the chance of this very simulation
        assert binom.sf((p < level).sum() - 1, len(p), level) > 1e-3
    assert (p < 0.05).mean() > 0.02  # and not because nothing is ever found


def test_captures_are_drawn_where_subjects_are_too_few():
    tested = pd.DataFrame({"subject": list("aabbccde"), "capture": [0, 1, 2, 3, 4, 4, 5, 6]})
    tested["difference"] = [1, 0, -1, -1, 1, 1, 0, -1]
    # None, one or two of five better by the toss of a coin, and as many worse: 2 * 16 / 2^5.
    units, kind = bootstrap_units(tested, 1.0)
    assert kind == "subjects" and units.tolist() == [1, -2, 2, 0, -1]
    units, kind = bootstrap_units(tested, 0.99)
    assert kind == "captures" and units.tolist() == [1, 0, -1, -1, 2, 0, -1]  # 4 is in two folds
    many = pd.DataFrame({"subject": range(16), "capture": range(16), "difference": 0})
    assert (
        bootstrap_units(many, 2 * 137 / 2**16)[1] == "subjects"
        and bootstrap_units(many[1:], 0.0042)[1] == "captures"
    )


SAME, WORSE = [1, 0] * 60, [0, 0] * 12 + [1, 0] * 48
COSTS = {"relative": 2.0, "flash": 400.0}
ALARMS = [  # correct captures of a run, its costs, and the alarms
    (SAME, COSTS, ()),
    (SAME, {"relative": 3.9, "flash": 440.0}, ()),
    (SAME, {"relative": 4.1, "flash": 441.0}, ("slower", "larger")),
    (SAME, {}, ()),
    ([1, 1] * 12 + [1, 0] * 48, COSTS, ("better",)),
    ([0, 1] * 6 + [1, 0] * 54, COSTS, ("changed",)),  # 12 labels, none too many right or wrong
    ([0, 1] + [1, 0] * 59, COSTS, ()),  # rounding
    (WORSE, {"relative": 9.0, "flash": 1.0}, ("worse", "slower")),
]


@pytest.mark.parametrize(("right", "costs", "alarms"), ALARMS)
def test_alarms_on_accuracy_labels_and_costs(right, costs, alarms):
    assert words(measured(SAME), measured(right, costs=costs)) == alarms


def test_a_verdict_is_a_line():
    (verdict,) = compare_with_baseline([measured(SAME)], [measured(WORSE)], **LIMITS)
    line = "worse    s | toy* | loso: pooled 50.0 -> 40.0 %, -10.0 [-15.8, -5.0], p "
    assert verdict.line.startswith(line)


def test_a_random_system_is_held_to_its_labels_only_where_it_must_repeat_them():
    then = measured([1, 0] * 60, seed="0")
    other = measured([0, 1] * 20 + [1, 0] * 40, seed="1")
    assert words(then, replace(other, names=then.names)) == ("changed",)
    assert words(then, other) == () and why_labels_may_differ(then, other) == "seed 1"
    assert (
        "40 of 120 labels changed (allowed with seed 1)"
        in compare_with_baseline([then], [other], **LIMITS)[0].line
    )
    assert words(then, replace(other, names=then.names, environment=HERE | {"cpu": "y"})) == ()
    none = measured([1, 0] * 60)
    assert not why_labels_may_differ(none, replace(none, environment={}))


def test_an_alarm_names_the_stored_revision_since_which_runs_differ():
    then, worse = measured([1, 0] * 60), measured([0, 0] * 12 + [1, 0] * 48)
    stored = [("a", worse), ("b", then), ("c", then), ("d", worse), ("e", worse)]
    # By how many runs are stored; c is as the baseline.
    for count, words in {5: ", since revision d (last the same: c)", 3: "", 0: ""}.items():
        (verdict,) = compare_with_baseline(
            [then], [worse], **LIMITS, load_history=lambda now, count=count: stored[:count]
        )
        assert verdict.details.partition("flash x1.00")[2] == words
    (verdict,) = compare_with_baseline([then], [then], **LIMITS, load_history=lambda now: stored)
    assert "since" not in verdict.line


def test_what_has_no_counterpart_is_no_pass():
    then = measured([1, 0, 1], seed="0")
    for current, told in (
        ([measured([1, 0, 1], seed="0", system="t")], "make one with: bench run model=svm"),
        ([measured([1, 0, 1], seed="0", corpus_digest="e")], "other captures than the baseline"),
    ):
        (verdict,) = compare_with_baseline([then], current, **LIMITS)
        assert verdict.alarms == ("not run",) and told in verdict.details and not verdict.current
    assert words(then, measured([1, 0, 1, 1], seed="0")) == ("other captures",)
    same, other = measured([1, 0, 1], seed="0"), measured([0, 0, 0, 0], seed="1")
    assert (
        compare_with_baseline([then], [same, other], **LIMITS)[0].alarms == ()
    )  # the same seed before any other


def test_one_busy_moment_counts_for_little_in_a_relative_time():
    names = {"reference_ms": 1, "predict_relative": 2, "flash_bytes": 1, "fit_seconds": 1}
    metrics = [
        {name: factor * seconds for name, factor in names.items()} for seconds in (1.0, 2.0, 9.0)
    ]
    numbers = combine_costs(
        [
            FoldResult("x", metrics=m, times={"predict_ms": [1.0], "decide_ms": [1.0]})
            for m in metrics
        ]
    )
    assert (numbers["reference_ms"], numbers["predict_relative"]) == (2, 4)
    assert (numbers["flash_bytes"], numbers["fit_seconds"]) == (9, 4)


WORDS = st.sampled_from(["pat", "a b", 'q"é', "\\n"])


@given(
    st.lists(
        st.tuples(st.sampled_from(["1", "fold02"]), st.sampled_from(["1", "ü"]), WORDS, WORDS),
        min_size=1,
    )
)
def test_a_baseline_is_read_as_it_was_written(tmp_path_factory, rows):
    labels = pd.DataFrame(rows, columns=["fold", "subject", "true", "predicted"])
    labels.insert(1, "capture", np.arange(len(rows)))
    stored = replace(measured([1]), labels=labels, run="""model=svm 'where=variant == "rough"'""")
    path = tmp_path_factory.mktemp("b") / "b.json"
    path.write_text(baseline_json([stored, stored]), encoding="utf-8")
    for found in read_baseline(path):
        assert {**vars(found), "labels": 0} == {**vars(stored), "labels": 0}
        pd.testing.assert_frame_equal(
            found.labels.sort_values("capture", ignore_index=True), labels, check_dtype=False
        )


def test_a_damaged_baseline_is_refused(tmp_path):
    good, path = baseline_json([measured([1, 0])]), tmp_path / "b.json"
    flipped = good.replace('"predicted": [', '"predicted": [1, ').replace("[1, 0, ", "[1, ", 1)
    assert flipped != good and json.loads(flipped)
    for wrong in (
        flipped,
        good.replace('"seed"', '"seeds"'),
        good.replace("]}\n", ""),
        json_with_digest('{"format": 2, "systems": []}'),
        json_with_digest('{"format": 1, "systems": []}'),
        json_with_digest('{"format": 2, "systems": [{"run": ""}]}'),
    ):
        path.write_text(wrong)
        with pytest.raises(InputError):
            read_baseline(path)
