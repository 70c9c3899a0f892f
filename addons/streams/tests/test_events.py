"""Reported events against true touches: cases by hand, a naive loop, and the counts of sed_eval."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bench.measures import Measure
from touchbench_streams.events import alarm_interval, matched, over_people, per_subject, report_table, summary
from touchbench_streams.recordings import event_table

# Two recordings at 10 Hz; the collar of 0.5 s has 5 frames.
TRUTH = event_table(
    [(0, 10, 30, "pat"), (0, 33, 50, "rub"), (0, 80, 90, "pat"), (1, 10, 30, "hit"), (1, 60, 70, "pat")]
)
REPORTS = report_table(
    [
        (0, 9, 9, "pat", "pat", 0.9),  # before any touch: false alarm
        (0, 28, 45, "rub", "rub", 0.9),  # reported during the pat, ends in the rub: belongs to the pat
        (0, 34, 40, "pat", "rub", 0.9),  # in the collar of the pat, but during the rub
        (0, 42, 50, "rub", "pat", 0.9),
        (0, 51, 60, "rub", "rub", 0.9),  # in the collar of the rub
        (0, 95, 99, "pat", "pat", 0.9),  # last frame of the collar
        (1, 36, 40, "hit", "hit", 0.9),  # one frame after the collar: false alarm
        (1, 60, 60, "pat", "rub", 0.9),
    ]
)
WORDS = st.sampled_from(["pat", "rub", "hit"])


def test_cases_by_hand():
    shuffled = REPORTS.iloc[::-1]
    touches, reports = matched(TRUTH, shuffled, rate_hz=10)
    assert list(reports["touch"][::-1]) == [-1, 0, 1, 1, 1, 2, -1, 4]
    assert reports.drop(columns="touch").equals(shuffled.reset_index(drop=True))
    assert touches[[*TRUTH]].equals(TRUTH)
    assert list(touches["found"]) == [True, True, True, False, True]
    np.testing.assert_allclose(touches["latency_s"], [1.8, 0.1, 1.5, np.nan, 0])
    assert list(touches["first_correct"]) == [False, False, True, False, True]
    assert list(touches["end_correct"]) == [False, True, True, False, False]
    assert list(touches["fragments"]) == [1, 3, 1, 0, 1]
    assert list(touches["insertions"]) == [0, 1, 0, 0, 0]  # a first report with a wrong label is none
    assert list(touches["late"]) == [False, False, True, False, False]
    assert summary(touches, reports, background_s=1800) == pytest.approx(
        {
            "touches": 5,
            "touches_found": 4 / 5,
            "first_correct": 2 / 5,
            "end_correct": 2 / 5,
            "late": 1 / 5,
            "merged": 0,
            "fragmented": 1 / 5,
            "first_correct_found": 2 / 4,
            "end_correct_found": 2 / 4,
            "false_alarms_per_hour": 4,
            "latency_s_p50": 0.8,  # of 0, 0.1, 1.5, 1.8 s
            "latency_s_p90": 1.71,
            "fragments": 6 / 4,
            "insertions_per_touch": 1 / 5,
        }
    )


def test_a_touch_without_a_report_is_merged_if_one_before_it_was_not_over():
    truth = event_table([(0, 10, 30, "pat"), (0, 30, 50, "rub"), (0, 60, 70, "rub"), (1, 30, 50, "rub")])
    lasting = report_table([(0, 12, 55, "pat", "pat", 0.9), (0, 20, 25, "pat", "pat", 0.9)])
    touches, reports = matched(truth, lasting, rate_hz=10)
    assert list(touches["found"]) == [True, False, False, False]
    assert list(touches["merged"]) == [False, True, False, False]
    numbers = summary(touches, reports, 60)
    assert (numbers["merged"], numbers["fragmented"], numbers["late"]) == (0.25, 0.25, 0)


@pytest.mark.parametrize("frames, touch", [(50, 0), (51, -1)])
def test_the_collar_ends_with_its_last_frame(frames, touch):
    reported = report_table([(0, 50 + frames, 190, "pat", "pat", 1)])
    assert list(matched(event_table([(0, 0, 50, "pat")]), reported, 100)[1]["touch"]) == [touch]


def test_without_touches_or_background_scores_are_nan():
    touches, reports = matched(TRUTH[:0], REPORTS, 10)
    numbers = summary(touches, reports, 3600)
    assert numbers.pop("touches") == 0 and numbers.pop("false_alarms_per_hour") == len(REPORTS)
    assert np.isnan([*numbers.values()]).all()
    assert np.isnan(summary(touches, reports, 0)["false_alarms_per_hour"])
    missed = summary(*matched(TRUTH, REPORTS[:0], 10), 3600)
    assert missed["touches_found"] == missed["end_correct"] == missed["insertions_per_touch"] == 0
    assert np.isnan([missed[name] for name in ("first_correct_found", "latency_s_p50", "fragments")]).all()


@st.composite
def tables(draw):
    """Random touches and reports of three recordings, also where there is nothing."""
    touches, reports = [], []
    for recording in range(3):
        end = 0
        for gap, frames, gesture in draw(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9), WORDS), max_size=4)):
            touches.append((recording, end + gap, end + gap + frames, gesture))
            end += gap + frames
    row = st.tuples(st.integers(0, 2), st.integers(0, 60), st.integers(0, 9), WORDS, WORDS)
    for recording, reported, frames, first, label in draw(st.lists(row, max_size=12, unique_by=lambda r: r[:3])):
        reports.append((recording, reported, reported + frames, first, label, 0.5))
    return touches, reports, draw(st.integers(1, 6))


@given(tables())
def test_matches_equal_a_loop_over_all_pairs(case):
    true, reported, collar = case
    touch = []
    for r in reported:
        inside = [i for i, t in enumerate(true) if t[0] == r[0] and t[1] <= r[1] < t[2]]
        late = [i for i, t in enumerate(true) if t[0] == r[0] and 0 <= r[1] - t[2] <= collar]
        touch.append(inside[0] if inside else max(late, key=lambda i: true[i][2], default=-1))
    touches, reports = matched(event_table(true), report_table(reported), 2 * collar)
    assert list(reports["touch"]) == touch
    for i, row in enumerate(touches.itertuples()):
        of_touch = sorted(r for j, r in enumerate(reported) if touch[j] == i)
        assert row.found == bool(of_touch) and row.fragments == len(of_touch)
        assert row.insertions == sum(r[4] != true[i][3] for r in of_touch[1:])
        assert row.first_correct == (bool(of_touch) and of_touch[0][3] == true[i][3])
        assert row.end_correct == (bool(of_touch) and of_touch[-1][4] == true[i][3])
        assert np.isnan(row.latency_s) if not of_touch else row.latency_s == (of_touch[0][1] - true[i][1]) / 2 / collar


# Onsets of touches of 30 frames, then reports, each as {recording: frames}; true positives, false positives and false
# negatives of sed_eval 0.2.1: EventBasedMetrics(event_label_list=["touch"], evaluate_onset=True, evaluate_offset=False,
# t_collar=17.5, event_matching_type="optimal"), one file per recording, a frame a second. With 30 frames and a collar
# of 5, a report of ours belongs to a touch from its onset until 35 frames later. Reports were given to sed_eval 17.5
# frames earlier, which makes its collar on either side the same rule. No touch has two reports.
SED_EVAL = [
    (
        {0: [127, 267, 406, 502], 1: [102, 214, 330, 477]},
        {0: [160, 300, 441, 443, 502], 1: [38, 135, 238, 262, 273, 330, 430, 457]},
        (7, 6, 1),
    ),
    (
        {0: [125, 228], 1: [171, 318, 467, 572]},
        {0: [130, 161, 165, 181], 1: [109, 131, 354, 402, 502, 607]},
        (3, 7, 3),
    ),
    (
        {0: [114, 262, 387, 510], 1: [96, 194, 311]},
        {0: [114, 183, 297, 348, 422, 424, 510, 546], 1: [61, 66, 130, 138, 209, 268, 283, 323]},
        (7, 9, 0),
    ),
]


@pytest.mark.parametrize("onsets, reported, counts", SED_EVAL)
def test_counts_equal_sed_evals(onsets, reported, counts):
    truth = event_table((r, s, s + 30, "pat") for r, starts in onsets.items() for s in starts)
    reports = report_table((r, f, f + 1, "pat", "pat", 1) for r, frames in reported.items() for f in frames)
    touches, reports = matched(truth, reports, rate_hz=10)
    numbers = summary(touches, reports, background_s=3600)
    found = round(numbers["touches_found"] * len(touches))
    assert (found, numbers["false_alarms_per_hour"], len(touches) - found) == counts


def test_subjects_and_intervals():
    """Subject c has no touches, only background and a false alarm; d has touches and no background."""
    truth = pd.concat([TRUTH, event_table([(3, 0, 9, "pat")])], ignore_index=True)
    reports = pd.concat([REPORTS, report_table([(2, 5, 9, "pat", "pat", 0.5)])], ignore_index=True)
    names = np.array(list("abcd"))
    touches, reports = matched(
        truth.assign(subject=names[truth["recording"]]), reports.assign(subject=names[reports["recording"]]), 10
    )
    background = {"d": 0.0, "c": 900.0, "b": 1800.0, "a": 3600.0}
    table = per_subject(touches, reports, background).set_index("subject")
    assert list(table.index) == list("abcd") and list(table["touches"]) == [3, 2, 0, 1]
    np.testing.assert_allclose(table["touches_found"], [1, 0.5, np.nan, 0])
    np.testing.assert_allclose(table["false_alarms_per_hour"], [1, 2, 4, np.nan])
    assert table.loc["a"].to_dict() == summary(touches[:3], reports[:6], 3600) | {"background_s": 3600}

    found = over_people(touches, reports, background)
    each = touches.groupby("subject")["end_correct"].mean()
    assert found["end_correct"] == pytest.approx(each.mean()) != touches["end_correct"].mean()
    assert found["subjects"] == 4 and np.isnan([v for k, v in found.items() if k.endswith(("_low", "_high"))]).all()


def test_the_interval_of_false_alarms_is_the_wider_of_bootstrap_and_poisson_and_of_none_a_limit():
    even = np.column_stack([[1, 1, 1, 1, 1], np.full(5, 0.26)])  # five alarms in 1.3 hours
    exact = [stats.chi2.ppf(0.025, 10) / 2 / 1.3, stats.chi2.ppf(0.975, 12) / 2 / 1.3]
    assert alarm_interval(even) == pytest.approx(exact)
    assert np.round(exact, 1).tolist() == [1.2, 9.0]
    assert alarm_interval(np.array([[50, 1.0], *[[0, 1.0]] * 5])) == pytest.approx((0, 25), abs=1)  # one person alone
    low, high = alarm_interval(even * [0, 1])
    assert np.isnan(low) and high == pytest.approx(3.0 / 1.3, abs=0.01)
    assert np.isnan(alarm_interval(even[:4])).all()
    shown = Measure("a", ends="a").of({"a": 0.0, "a_high": high})
    assert shown == "0.0 [at most 2.3]"
