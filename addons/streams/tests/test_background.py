"""Further recordings without touch: learned from, but for those of a test subject."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.corpora.library import import_corpus
from bench.errors import InputError
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.scratch import home
from touchbench_streams.fold import too_short
from touchbench_streams.recordings import captures_in, recorded
from touchbench_streams.stored import further, joined
from touchbench_streams.study import Continuous
from touchbench_streams.synth_recordings import generate

PEOPLE = generate(subjects=3, variants=("normal",), rows=3, cols=3, rate_hz=15.0)
STILL = {"4": 900, "1": 450}  # frames of further background by subject


def stored(name, frames, labels, subjects, rate_hz="15"):
    """Recordings imported under a name."""
    table = pd.DataFrame(frames.reshape(len(labels), -1), columns=[f"ch{i}" for i in range(9)])
    file = Path(home(), f"{name}.parquet")
    file.parent.mkdir(parents=True, exist_ok=True)
    table.assign(label=labels, subject=subjects)[["subject", "label", *table.columns]].to_parquet(file)
    return import_corpus("recording", file, {"name": name, "rate_hz": rate_hz, "grid": "3x3"})


@pytest.fixture
def imported():
    """Recordings with touches (``day``), and further ones without (``still``)."""
    stored("day", PEOPLE.corpus.frames, PEOPLE.frame_labels(), np.repeat(PEOPLE.subjects, PEOPLE.corpus.lengths))
    return still(0)


def still(seed, changed=""):
    """The readings of further background; those of one subject are others."""
    subjects = np.repeat([*STILL], [*STILL.values()])
    frames = np.random.default_rng(7).integers(0, 9, (len(subjects), 9))
    frames[subjects == changed] = np.random.default_rng(seed).integers(0, 1024, (np.sum(subjects == changed), 9))
    return stored("still", frames, [""] * len(subjects), subjects)


def plan_of():
    words = {"data": "day", "model": "lda", "features": "touch"}
    (plan,) = planned([replace(cell, study=Continuous()) for cell in cells(words)], 1)
    return plan


def test_recordings_of_a_test_subject_are_left_out(imported):
    corpus = captures_in(PEOPLE)
    taught = recorded(corpus[np.isin(corpus.subjects, ["2", "3"])])
    both = joined(taught, further("still", corpus), np.array(["1"]))
    assert both.subjects.tolist() == ["2", "3", "4"]
    assert both.corpus.captures["recording"].nunique() == 3
    pd.testing.assert_frame_equal(both.events, taught.events)
    assert both.background_frames().sum() == taught.background_frames().sum() + STILL["4"]
    np.testing.assert_array_equal(both.corpus[0], taught.corpus[0])
    np.testing.assert_array_equal(both.corpus[2], recorded(imported).corpus[int(imported.subjects[1] == "4")])


def test_what_a_test_subject_recorded_changes_nothing_and_what_others_did_counts(imported):
    plan, kind = plan_of(), Continuous(detector="threshold", background="still", false_alarms=2.0)
    one, identity = kind.fold(plan.cell, plan.corpus, plan.folds[0], 1), kind.identity()
    still(3, "1")
    assert kind.identity() != identity
    tested = kind.fold(plan.cell, plan.corpus, plan.folds[0], 1)
    pd.testing.assert_frame_equal(one.trials, tested.trials)
    assert one.chosen == tested.chosen
    still(3, "4")
    assert not kind.fold(plan.cell, plan.corpus, plan.folds[0], 1).trials.equals(one.trials)


def test_further_background_makes_lower_rates_learnable(imported):
    plan = plan_of()
    quiet = min(PEOPLE.background_frames()[~(PEOPLE.subjects == out)].sum() for out in PEOPLE.subjects) / 15 / 60
    trains = [fold.train for fold in plan.folds]
    (alone,), (more,) = (too_short(plan.corpus, trains, 0.001, background) for background in ("", "still"))
    assert f" is {quiet:.1f} minutes" in alone
    assert f" is {quiet + sum(STILL.values()) / 15 / 60:.1f} minutes" in more


@pytest.mark.parametrize("name, fact", [("nothing", "no such recordings"), ("fast", r"rate_hz is 30.*not 15")])
def test_what_is_no_further_background_is_refused(name, fact):
    stored("fast", np.zeros((60, 9), int), [""] * 60, ["9"] * 60, "30")
    with pytest.raises(InputError, match=fact):
        further(name, PEOPLE.corpus)
