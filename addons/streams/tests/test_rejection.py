"""Watching recordings: a sensor that shows nothing, or nonsense, raises no event; a threshold that rejects labels."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from touchbench_streams.events import last_confidence, report_table
from touchbench_streams.points import frontier, points_of
from touchbench_streams.recordings import Recordings, event_table
from touchbench_streams.rejection import learn_reject, reject_threshold


def test_the_confidence_of_a_touch_is_that_of_its_last_label():
    touches = event_table([(0, 0, 100, "pat"), (0, 200, 300, "rub"), (1, 0, 100, "pat")])
    reports = report_table(
        [
            (0, 250, 290, "rub", "rub", 0.3),
            (0, 50, 60, "pat", "pat", 0.9),
            (0, 80, 100, "pat", "rub", 0.4),  # the same touch once more
            (0, 400, 450, "pat", "pat", 0.2),  # no touch
        ]
    )
    assert last_confidence(touches, reports, 100.0).to_dict() == {0: 0.4, 1: 0.3}


@pytest.mark.parametrize(
    ("confidence", "threshold"),
    [([0.5], 0.5), ([0.3, 0.2, 0.9], 0.2), ([i / 100 for i in range(41)], 0.02), ([i / 100 for i in range(40)], 0.01)],
)
def test_a_threshold_rejects_at_most_one_known_touch_in_twenty(confidence, threshold):
    assert reject_threshold(np.array(confidence)) == threshold
    assert sum(c < threshold for c in confidence) <= 0.05 * len(confidence)


def test_a_threshold_needs_touches():
    with pytest.raises(InputError, match="none was found"):
        reject_threshold(np.zeros(0))


@dataclass
class Told:
    """A watcher whose reports tell who its system was fitted to: a confidence for each held-out subject."""

    system: object
    reject: float = 0.5

    def renamed(self, make_system, captures, recordings):
        assert {*recordings.subjects.tolist()} == {*captures.subjects.tolist()}
        return Told(make_system().fit(captures, captures.gestures), 0.0)

    def reports(self, corpus):
        assert self.reject == 0
        subjects = corpus.subjects.tolist()
        assert not {*subjects} & self.system.subjects_ and len(self.system.subjects_) == 6 - len(subjects)
        return report_table([(i, 5, 8, "pat", "pat", float(s) / 10) for i, s in enumerate(subjects)])


class Fitted:
    def fit(self, X, y):
        assert y.tolist() == X.gestures.tolist()
        self.subjects_ = {*X.subjects.tolist()}
        return self


def test_the_threshold_is_learned_on_subjects_whom_the_system_has_not_seen():
    names = [str(i + 1) for i in range(6)]
    frames = [np.zeros((10, 1, 1), np.uint16)] * 6
    captures = Corpus.from_captures(frames * 2, pd.DataFrame({"subject": names * 2, "gesture": "pat"}), 54.0)
    whole = Corpus.from_captures(frames, pd.DataFrame({"subject": names, "gesture": ""}), 54.0)
    recordings = Recordings(whole, event_table([(i, 0, 9, "pat") for i in range(6)]))
    assert learn_reject(Fitted, captures, recordings, Told(None)) == 0.1  # of 0.1, 0.2, ... 0.6


def test_operating_points_find_more_with_more_alarms():
    rows = [
        (-9.0, 0, 0.2),
        (-8.0, 0, 0.5),
        (-7.0, 0, 0.5),
        (-5.0, 3, 0.5),
        (-3.0, 2, 0.8),
        (1.0, 6, 0.7),
        (2.0, 9, 0.9),
    ]
    table = pd.DataFrame(rows, columns=["threshold", "alarms", "found"]).assign(hours=0.5)
    assert frontier(table)["threshold"].tolist() == [-7.0, -3.0, 2.0]
    expected = ((2.0, 18.0, 0.9), (1.0, 12.0, 0.7), (-3.0, 4.0, 0.8), (-7.0, 0.0, 0.5))
    assert points_of(table, 1.0) == expected  # from the highest threshold to the lowest
