"""Scores of reported events by hand, by naive loops, by sed_eval; rejection of labels."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.values.intervals import draw_weights
from bench.values.measures import Measure
from touchbench_streams.curve import missed_at, pool_sweeps
from touchbench_streams.events import (
    alarm_interval,
    match_reports,
    mean_over_subjects,
    report_table,
    summarise_by_subject,
    summarise_touches,
)
from touchbench_streams.recordings import Recordings, event_table
from touchbench_streams.rejection import last_confidence, learn_reject, rejection_scores

# Two recordings at 10 Hz; the collar of 0.5 s has 5 frames.
TRUTH = event_table(
    [
        (0, 10, 30, "pat"),
        (0, 33, 50, "rub"),
        (0, 80, 90, "pat"),
        (1, 10, 30, "hit"),
        (1, 60, 70, "pat"),
    ]
)
REPORTS = report_table(
    (*row, 0.9, 1)
    for row in (
        (0, 9, 9, "pat", "pat"),  # before any touch: false alarm
        (0, 28, 45, "rub", "rub"),  # reported during the pat, ends in the rub: belongs to the pat
        (0, 34, 40, "pat", "rub"),  # in the collar of the pat, but during the rub
        (0, 42, 50, "rub", "pat"),
        (0, 51, 60, "rub", "rub"),  # in the collar of the rub
        (0, 95, 99, "pat", "pat"),  # last frame of the collar
        (1, 36, 40, "hit", "hit"),  # one frame after the collar: false alarm
        (1, 60, 60, "pat", "rub"),
    )
)
WORDS = st.sampled_from(["pat", "rub", "hit"])


def test_cases_by_hand():
    shuffled = REPORTS.iloc[::-1]
    touches, reports = match_reports(TRUTH, shuffled, rate_hz=10)
    assert list(reports["touch"][::-1]) == [-1, 0, 1, 1, 1, 2, -1, 4]
    assert reports.drop(columns="touch").equals(shuffled.reset_index(drop=True))
    assert touches[[*TRUTH]].equals(TRUTH)
    assert list(touches["found"]) == [True, True, True, False, True]
    np.testing.assert_allclose(touches["latency_s"], [1.8, 0.1, 1.5, np.nan, 0])
    assert list(touches["first_correct"]) == [False, False, True, False, True]
    assert list(touches["end_correct"]) == [False, True, True, False, False]
    assert list(touches["fragments"]) == [1, 3, 1, 0, 1]
    assert list(touches["insertions"]) == [
        0,
        1,
        0,
        0,
        0,
    ]  # a first report with a wrong label is none
    assert list(touches["late"]) == [False, False, True, False, False]
    numbers = {"touches": 5, "touches_found": 4 / 5, "first_correct": 2 / 5, "end_correct": 2 / 5}
    numbers |= {
        "late": 1 / 5,
        "merged": 0,
        "fragmented": 1 / 5,
        "fragments": 6 / 4,
        "insertions_per_touch": 1 / 5,
    }
    numbers |= {
        "first_correct_found": 2 / 4,
        "end_correct_found": 2 / 4,
        "false_alarms_per_hour": 4,
    }
    numbers |= {"latency_s_p50": 0.8, "latency_s_p90": 1.71}  # of 0, 0.1, 1.5, 1.8 s
    assert summarise_touches(touches, reports, background_s=1800) == pytest.approx(numbers)


def test_a_touch_without_a_report_is_merged_if_one_before_it_was_not_over():
    truth = event_table(
        [(0, 10, 30, "pat"), (0, 30, 50, "rub"), (0, 60, 70, "rub"), (1, 30, 50, "rub")]
    )
    lasting = report_table([(0, 12, 55, "pat", "pat", 0.9, 0), (0, 20, 25, "pat", "pat", 0.9, 0)])
    touches, reports = match_reports(truth, lasting, rate_hz=10)
    assert list(touches["found"]) == [True, False, False, False]
    assert list(touches["merged"]) == [False, True, False, False]
    numbers = summarise_touches(touches, reports, 60)
    assert (numbers["merged"], numbers["fragmented"], numbers["late"]) == (0.25, 0.25, 0)


def test_without_touches_or_background_scores_are_nan():
    touches, reports = match_reports(TRUTH[:0], REPORTS, 10)
    numbers = summarise_touches(touches, reports, 3600)
    assert numbers.pop("touches") == 0 and numbers.pop("false_alarms_per_hour") == len(REPORTS)
    assert np.isnan([*numbers.values()]).all()
    assert np.isnan(summarise_touches(touches, reports, 0)["false_alarms_per_hour"])
    missed = summarise_touches(*match_reports(TRUTH, REPORTS[:0], 10), 3600)
    assert missed["touches_found"] == missed["end_correct"] == missed["insertions_per_touch"] == 0
    assert np.isnan(
        [missed[name] for name in ("first_correct_found", "latency_s_p50", "fragments")]
    ).all()


@st.composite
def random_tables(draw):
    """Random touches and reports of three recordings, also where there is nothing."""
    touches, reports = [], []
    for recording in range(3):
        end = 0
        for gap, frames, gesture in draw(
            st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9), WORDS), max_size=4)
        ):
            touches.append((recording, end + gap, end + gap + frames, gesture))
            end += gap + frames
    row = st.tuples(st.integers(0, 2), st.integers(0, 60), st.integers(0, 9), WORDS, WORDS)
    for recording, reported, frames, first, label in draw(
        st.lists(row, max_size=12, unique_by=lambda r: r[:3])
    ):
        changes = int(first != label)
        reports.append((recording, reported, reported + frames, first, label, 0.5, changes))
    return touches, reports, draw(st.integers(1, 6))


@given(random_tables())
def test_matches_equal_a_loop_over_all_pairs(case):
    true, reported, collar = case
    touch = []
    for r in reported:
        inside = [i for i, t in enumerate(true) if t[0] == r[0] and t[1] <= r[1] < t[2]]
        late = [i for i, t in enumerate(true) if t[0] == r[0] and 0 <= r[1] - t[2] <= collar]
        touch.append(inside[0] if inside else max(late, key=lambda i: true[i][2], default=-1))
    touches, reports = match_reports(event_table(true), report_table(reported), 2 * collar)
    assert list(reports["touch"]) == touch
    for i, row in enumerate(touches.itertuples()):
        of_touch = sorted(r for j, r in enumerate(reported) if touch[j] == i)
        assert row.found == bool(of_touch) and row.fragments == len(of_touch)
        assert row.changes == sum(r[6] for r in of_touch)
        assert row.confidence == 0.5 or not of_touch and np.isnan(row.confidence)
        assert row.insertions == sum(r[4] != true[i][3] for r in of_touch[1:])
        assert row.first_correct == (bool(of_touch) and of_touch[0][3] == true[i][3])
        assert row.end_correct == (bool(of_touch) and of_touch[-1][4] == true[i][3])
        assert (
            np.isnan(row.latency_s)
            if not of_touch
            else row.latency_s == (of_touch[0][1] - true[i][1]) / 2 / collar
        )


# Onsets of touches of 30 frames, then reports, each as {recording: frames}; true positives, false
# positives and false negatives of sed_eval 0.2.1: EventBasedMetrics(event_label_list=["touch"],
# evaluate_onset=True, evaluate_offset=False, t_collar=17.5, event_matching_type="optimal"), one
# file per recording, a frame a second. With 30 frames and a collar of 5, a report of ours belongs
# to a touch from its onset until 35 frames later. Reports were given to sed_eval 17.5 frames
# earlier, which makes its collar on either side the same rule. No touch has two reports.
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
]


@pytest.mark.parametrize("onsets, reported, counts", SED_EVAL)
def test_counts_equal_sed_evals(onsets, reported, counts):
    truth = event_table((r, s, s + 30, "pat") for r, starts in onsets.items() for s in starts)
    reports = report_table(
        (r, f, f + 1, "pat", "pat", 1, 0) for r, frames in reported.items() for f in frames
    )
    touches, reports = match_reports(truth, reports, rate_hz=10)
    numbers = summarise_touches(touches, reports, background_s=3600)
    found = round(numbers["touches_found"] * len(touches))
    assert (found, numbers["false_alarms_per_hour"], len(touches) - found) == counts


def test_subjects_and_intervals():
    """Subject c has background and a false alarm, but no touches; d has no background."""
    truth = pd.concat([TRUTH, event_table([(3, 0, 9, "pat")])], ignore_index=True)
    more = report_table([(2, 5, 9, "pat", "pat", 0.5, 0)])
    reports = pd.concat([REPORTS, more], ignore_index=True)
    names = np.array(list("abcd"))
    touches, reports = match_reports(
        truth.assign(subject=names[truth["recording"]]),
        reports.assign(subject=names[reports["recording"]]),
        10,
    )
    background = {"d": 0.0, "c": 900.0, "b": 1800.0, "a": 3600.0}
    table = summarise_by_subject(touches, reports, background).set_index("subject")
    assert list(table.index) == list("abcd") and list(table["touches"]) == [3, 2, 0, 1]
    np.testing.assert_allclose(table["touches_found"], [1, 0.5, np.nan, 0])
    np.testing.assert_allclose(table["false_alarms_per_hour"], [1, 2, 4, np.nan])
    assert table.loc["a"].to_dict() == summarise_touches(touches[:3], reports[:6], 3600) | {
        "background_s": 3600
    }

    found = mean_over_subjects(touches, reports, background)
    each = touches.groupby("subject")["end_correct"].mean()
    assert found["end_correct"] == pytest.approx(each.mean()) != touches["end_correct"].mean()
    assert (
        found["subjects"] == 4
        and np.isnan([v for k, v in found.items() if k.endswith(("_low", "_high"))]).all()
    )


def test_the_interval_of_false_alarms_is_the_wider_of_bootstrap_and_poisson_and_of_none_a_limit():
    even = np.column_stack([[1, 1, 1, 1, 1], np.full(5, 0.26)])  # five alarms in 1.3 hours
    exact = [stats.chi2.ppf(0.025, 10) / 2 / 1.3, stats.chi2.ppf(0.975, 12) / 2 / 1.3]
    assert alarm_interval(even) == pytest.approx(exact)
    assert np.round(exact, 1).tolist() == [1.2, 9.0]
    assert alarm_interval(np.array([[50, 1.0], *[[0, 1.0]] * 5])) == pytest.approx(
        (0, 25), abs=1
    )  # one person alone
    low, high = alarm_interval(even * [0, 1])
    assert np.isnan(low) and high == pytest.approx(3.0 / 1.3, abs=0.01)
    assert np.isnan(alarm_interval(even[:4])).all()
    shown = Measure("a", ends="a").as_text({"a": 0.0, "a_high": high})
    assert shown == "0.0 [at most 2.3]"


def sweep_table(rows):
    """Rows of a sweep from (offset, subject, hits, alarms, reports)."""
    return pd.DataFrame(rows, columns=["offset", "subject", "hits", "alarms", "reports"])


def test_the_best_threshold_that_keeps_to_the_rate_counts():
    table = sweep_table(
        [
            *((-1.0, "a", 10, 30, 80), (-1.0, "b", 10, 0, 10)),  # reports always
            *((0.0, "a", 9, 4, 13), (0.0, "b", 9, 1, 11)),
            *((1.0, "a", 6, 1, 8), (1.0, "b", 7, 0, 7)),
            (2.0, "a", 1, 0, 1),  # not tried for the other subject
        ]
    )
    numbers = missed_at(
        pool_sweeps(table), pd.Series({"a": 10, "b": 10}), pd.Series({"a": 0.5, "b": 0.5})
    )
    assert numbers["missed_at_5"] == pytest.approx(1 - 18 / 20)
    assert numbers["missed_at_1"] == pytest.approx(1 - 13 / 20)
    assert np.isnan(numbers["missed_at_5_low"])  # two people


def test_the_interval_is_that_of_drawings():
    rng = np.random.default_rng(3)
    people, offsets = list("abcdef"), np.arange(-2.0, 3.0)
    touches = dict(zip(people, [8, 5, 12, 9, 7, 0], strict=True))
    hours = dict(zip(people, [0.5, 0.2, 0.4, 0.6, 0.3, 0.4], strict=True))
    table = sweep_table(
        [
            (o, p, h := rng.integers(0, touches[p] + 1), a := rng.integers(0, 9), h + a)
            for p in people
            for o in offsets
        ]
    )
    numbers = missed_at(pool_sweeps(table), pd.Series(touches)[:5], pd.Series(hours))
    counted = {(row.offset, row.subject): (row.hits, row.alarms) for row in table.itertuples()}
    least = []
    for drawing in draw_weights([6])[0].tolist():
        times, most = dict(zip(people, drawing, strict=True)), -1
        for offset in offsets:
            hits, alarms = (sum(counted[offset, p][k] * times[p] for p in people) for k in (0, 1))
            if alarms <= 10 * sum(hours[p] * times[p] for p in people):
                most = max(most, hits)
        total = sum(touches[p] * times[p] for p in people)
        least += [1 - most / total] if most >= 0 and total else []
    ends = [numbers["missed_at_10_low"], numbers["missed_at_10_high"]]
    np.testing.assert_allclose(ends, np.quantile(least, [0.025, 0.975]))


def test_the_confidence_of_a_touch_is_that_of_its_last_label():
    touches = event_table([(0, 0, 100, "pat"), (0, 200, 300, "rub"), (1, 0, 100, "pat")])
    reports = report_table(
        [
            (0, 250, 290, "rub", "rub", 0.3, 0),
            (0, 50, 60, "pat", "pat", 0.9, 0),
            (0, 80, 100, "pat", "rub", 0.4, 1),  # the same touch once more
            (0, 400, 450, "pat", "pat", 0.2, 0),  # no touch
        ]
    )
    assert last_confidence(touches, reports, 100.0).to_dict() == {0: 0.4, 1: 0.3}


def test_rejection_is_counted_by_each_folds_threshold():
    """With thresholds 0.5 and 0.2, one of the known 0.6, 0.4 and 0.3 lies below."""
    rows = [
        ("a", "pat", 0.6),
        ("a", "pat", 0.4),
        ("a", "unknown", 0.55),
        ("b", "pat", 0.3),
        ("b", "unknown", 0.05),
    ]
    tables = []
    for i, (fold, gesture, confidence) in enumerate(rows):
        common = {"fold": fold, "subject": fold, "recording": 0}
        tables.append(
            common | {"kind": "touch", "start": 200 * i, "end": 200 * i + 100, "gesture": gesture}
        )
        said = {
            "reported": 200 * i + 50,
            "end": 200 * i + 90,
            "first": "pat",
            "label": "pat",
            "confidence": confidence,
            "changes": 0,
        }
        tables.append(common | {"kind": "report"} | said)
    table = pd.DataFrame(tables)
    scores = rejection_scores(table, {"a": 0.5, "b": 0.2}, 100.0)
    # above the thresholds: known 0.1, -0.1, 0.1, unknown 0.05, -0.15; of 6 pairs 5 are in order
    assert scores == pytest.approx(
        {"auroc": 5 / 6, "rejected_unknown": 1 / 2, "rejected_known": 1 / 3}
    )
    nothing = rejection_scores(table[table["gesture"] != "unknown"], {"a": 0.5, "b": 0.2}, 100.0)
    assert np.isnan(nothing["auroc"]) and np.isnan(nothing["rejected_unknown"])


@dataclass
class SubjectWatcher:
    """A watcher that reports a confidence for each held-out subject, and checks who trained it."""

    system: object
    reject: float = 0.5
    hears: bool = True

    def with_new_names(self, make_system, captures, recordings):
        assert {*recordings.subjects.tolist()} == {*captures.subjects.tolist()}
        return SubjectWatcher(make_system().fit(captures, captures.gestures), 0.0, self.hears)

    def report_touches(self, corpus):
        assert self.reject == 0
        subjects = corpus.subjects.tolist()
        assert not {*subjects} & self.system.subjects_ and len(self.system.subjects_) == 6 - len(
            subjects
        )
        at = 5 if self.hears else 20
        return report_table(
            [(i, at, at + 3, "pat", "pat", float(s) / 10, 0) for i, s in enumerate(subjects)]
        )


class Fitted:
    def fit(self, X, y):
        assert y.tolist() == X.gestures.tolist()
        self.subjects_ = {*X.subjects.tolist()}
        return self


def test_the_threshold_is_learned_on_subjects_whom_the_system_has_not_seen():
    names = [str(i + 1) for i in range(6)]
    frames = [np.zeros((30, 1, 1), np.uint16)] * 6
    captures = Corpus.from_captures(
        frames * 2, pd.DataFrame({"subject": names * 2, "gesture": "pat"}), 5.0
    )
    whole = Corpus.from_captures(frames, pd.DataFrame({"subject": names, "gesture": ""}), 5.0)
    recordings = Recordings(whole, event_table([(i, 0, 9, "pat") for i in range(6)]))
    assert (
        learn_reject(Fitted, captures, recordings, SubjectWatcher(None)) == 0.1
    )  # the lowest of six confidences, 0.1 to 0.6
    with pytest.raises(InputError, match="none was found"):
        learn_reject(Fitted, captures, recordings, SubjectWatcher(None, hears=False))
