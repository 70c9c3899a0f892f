"""The task of continuous touch: events of a submission against touches that it cannot supply."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.board import answers, marks, rerun, submissions, tasks
from bench.board.page import reference_of, scores_of
from bench.board.submissions import EVENT
from bench.board.tasks import TASKS
from bench.cli import main
from bench.errors import InputError
from tests.board.submitted import folder_of
from tests.results import result

NAME = "haart-watch-v1"
TASK = TASKS[NAME]
TRUTH = pd.DataFrame(  # ten minutes of two people
    [
        ("a", "0", "32400", ""),
        ("a", "540", "810", "pat"),
        ("a", "1080", "1350", "rub"),
        ("b", "0", "32400", ""),
        ("b", "540", "810", "tickle"),
    ],
    columns=["subject", "start", "end", "gesture"],
)
EVENTS = pd.DataFrame(
    [
        ("b", 838, 900, "tickle", "tickle", 0.9),  # 28 frames after the touch, one more than 0.5 s
        ("a", 700, 820, "rub", "pat", 0.8),  # the second report of the first touch
        ("a", 594, 640, "rub", "rub", 0.7),  # one second after its start
        ("a", 1377, 1370, "rub", "rub", 1.0),  # 27 frames after the second one
        ("a", 5000, 32400, "pat", "pat", 0.0),
    ],
    columns=[*EVENT],
)
CHANGES = {
    "a strange subject": ({"subject": "c"}, "row 5: subject is 'c', not one of a, b"),
    "not yet": ({"reported": 0}, "row 5: reported is '0', not a whole number of frames from 1"),
    "half a frame": ({"reported": 5000.5}, "reported is '5000.5'"),
    "never": ({"reported": np.nan}, "row 5: reported is"),
    "after the recording": ({"end": 32401}, "row 5: end is '32401'"),
    "no gesture": ({"first": "notouch"}, "row 5: first is 'notouch', not one of pat, rub, tickle"),
    "no label": ({"label": ""}, "row 5: label is ''"),
    "no share": ({"confidence": 1.1}, "row 5: confidence is '1.1', not a number from 0 to 1"),
    "no confidence": ({"confidence": np.nan}, "row 5: confidence is"),
    "twice": ({"reported": 700}, "subject a, reported 700 is there twice"),
}


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setattr(tasks, "_table", lambda name: TRUTH)


def submission(name="mine", events=EVENTS):
    return submissions.read(folder_of(name, events, task=NAME))


def test_the_recordings_never_change():
    """Counts of HAART, and the rules of the composer: 2 to 6 s of touch, 3 to 10 s of background, at 54 Hz."""
    touches = tasks.rows_of(TASK)
    captures = tasks.captures_of(TASKS["haart-loso-v1"]).query("gesture != 'notouch'")
    counts = captures.value_counts(["subject", "gesture"]).to_dict()
    assert touches.value_counts(["subject", "true"]).to_dict() == counts and len(touches) == 710
    frames = touches["end"] - touches["start"]
    gaps = touches["start"] - touches.groupby("subject")["end"].shift(fill_value=0)
    whole = tasks.recordings_of(TASK).query("gesture == ''").set_index("subject")
    last = whole["end"] - touches.groupby("subject")["end"].max()
    assert frames.between(1, 324).all() and pd.concat([gaps, last]).between(162, 540).all()
    assert (whole["end"].sum() - frames.sum()) / 54 / 60 == pytest.approx(77.99104938271606)  # of a stored run


def test_scores_are_a_count_by_hand(tiny):
    """One of three touches is missed; two false alarms in 1185 s of background are too many."""
    one = submission()
    scored = one.scores
    assert (scored["touches_found"], scored["first_correct"], scored["accuracy"]) == pytest.approx(
        (2 / 3, 1 / 3, 2 / 3)
    )
    assert scored["false_alarms_per_hour"] == pytest.approx(2 * 3600 / 1185)
    assert scored["latency_s_p50"] == pytest.approx((1 + 5.5) / 2)
    assert one.table["predicted"].tolist() == ["pat", "rub", ""]
    assert one.remarks == "more than 5 false alarms per hour"
    calm = submission("calm", EVENTS.iloc[[2]].assign(label="pat").pipe(lambda e: pd.concat([e, EVENTS.iloc[[0]]])))
    assert calm.scores["accuracy"] == pytest.approx(1 / 3) and not calm.remarks  # one false alarm: 3.04 per hour
    table = scores_of([one, calm])
    assert table["name"].tolist() == ["calm", "mine"], "too many false alarms are listed last"
    assert table["behind"].tolist()[1] == pytest.approx(100 / 3) and np.isnan(table["behind"][0])


@pytest.mark.parametrize(("change", "fact"), CHANGES.values(), ids=CHANGES)
def test_a_wrong_event_is_refused(tiny, change, fact):
    rows = EVENTS.astype(object)
    rows.loc[4, [*change]] = [*change.values()]
    with pytest.raises(InputError) as refused:
        submission(events=rows)
    assert str(refused.value).startswith("mine: ") and fact in str(refused.value) and str(refused.value).isprintable()


def test_wrong_tables_are_refused(tiny, monkeypatch):
    for number, (events, fact) in enumerate(
        [
            (EVENTS.query("subject == 'a'"), "no event of subject b; give the events of all 2 recordings"),
            (EVENTS.drop(columns="first"), "column first is missing"),
            (EVENTS.assign(true="pat"), "column 'true' is not one of subject, reported"),
        ]
    ):
        with pytest.raises(InputError, match=fact):
            submission(str(number), events)
    monkeypatch.setattr(submissions, "EVENTS", 4)
    with pytest.raises(InputError, match="more than 4 rows"):
        submission()


def test_a_run_is_answered_by_its_events(tiny):
    """Its recordings must be those of the task."""
    stored = TRUTH.assign(kind=np.where(TRUTH["gesture"] == "", "recording", "touch"))
    stored = stored.astype({"start": float, "end": float}).replace({"start": {0: np.nan}, "gesture": {"": None}})
    stored = pd.concat([stored, EVENTS.assign(kind="report"), pd.DataFrame({"kind": ["curve"], "subject": "a"})])
    events = answers.table(TASK, result(kind="watch", tables={"predictions": stored}))
    one = submissions.write(Path("written"), submission().metadata, events)
    assert one.answers.equals(submission("again").answers) and len(one.answers) == 5
    longer = {"predictions": stored.replace({"end": {1350.0: 1351.0}})}
    with pytest.raises(InputError, match="1a2b has other recordings than haart-watch-v1"):
        answers.table(TASK, result(kind="watch", tables=longer, run_id="1a2b"))


def test_a_rerun_must_report_the_same_events(tiny, monkeypatch, capsys):
    submission()
    monkeypatch.setattr(rerun, "command_of", lambda one: [])
    monkeypatch.setattr("bench.cli.main", lambda words: 0)
    for number, (events, code, line) in enumerate(
        [
            (EVENTS.iloc[::-1], 0, "5 of 5 events are equal (100.00 %)"),
            (EVENTS.assign(first="pat"), 1, "1 of 5 events are equal (20.00 %), 4 differ"),
            (pd.concat([EVENTS, EVENTS.tail(1).assign(reported=9999)]), 1, "5 of 6 events are equal"),
        ]
    ):
        again = dataclasses.replace(submission(f"again{number}", events), name="mine")
        monkeypatch.setattr(rerun, "answer", lambda *_, again=again: again)
        monkeypatch.setattr("bench.board.commands.every_result", lambda *_: [])
        assert main(["leaderboard", "rerun=mine", "all"]) == code
        assert line in capsys.readouterr().out and Path(marks.FILE).exists()


def test_reference_results_have_the_scores_of_their_runs():
    """Figures of docs/notes/watch.md, which `bench watch` printed."""
    printed = {"lda-touch": (98.2, 74.9, 78.3, 3.8, 1.02), "reflex": (98.2, 75.4, 78.9, 3.8, 1.02)}
    rows = scores_of(reference_of(NAME)).set_index("name")
    names = ["touches_found", "first_correct", "accuracy", "false_alarms_per_hour", "latency_s_p50"]
    for name, figures in printed.items():
        assert [round(rows.loc[name, n], 2 if n.startswith("lat") else 1) for n in names] == list(figures)
    for one in reference_of(NAME):
        assert (one.table["end_correct"] == (one.table["predicted"] == one.table["true"])).all()
        assert set(one.table["predicted"]) - {""} <= set(one.table["true"])
