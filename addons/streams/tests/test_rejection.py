"""Watching recordings: a sensor that shows nothing, or nonsense, raises no event; a threshold that rejects labels."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from touchbench_streams.events import report_table
from touchbench_streams.recordings import Recordings, event_table
from touchbench_streams.rejection import last_confidence, learn_reject, rejection_scores


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


def test_rejection_is_counted_by_each_folds_threshold():
    """Touches of 1 s, one every 2 s; thresholds 0.5 and 0.2: of the known 0.6, 0.4 and 0.3 one lies below."""
    rows = [("a", "pat", 0.6), ("a", "pat", 0.4), ("a", "unknown", 0.55), ("b", "pat", 0.3), ("b", "unknown", 0.05)]
    tables = []
    for i, (fold, gesture, confidence) in enumerate(rows):
        common = {"fold": fold, "subject": fold, "recording": 0}
        tables.append(common | {"kind": "touch", "start": 200 * i, "end": 200 * i + 100, "gesture": gesture})
        said = {"reported": 200 * i + 50, "end": 200 * i + 90, "first": "pat", "label": "pat", "confidence": confidence}
        tables.append(common | {"kind": "report"} | said)
    table = pd.DataFrame(tables)
    scores = rejection_scores(table, {"a": 0.5, "b": 0.2}, 100.0)
    # above the thresholds: known 0.1, -0.1, 0.1, unknown 0.05, -0.15; of 6 pairs 5 are in order
    assert scores == pytest.approx({"auroc": 5 / 6, "rejected_unknown": 1 / 2, "rejected_known": 1 / 3})
    nothing = rejection_scores(table[table["gesture"] != "unknown"], {"a": 0.5, "b": 0.2}, 100.0)
    assert np.isnan(nothing["auroc"]) and np.isnan(nothing["rejected_unknown"])


@dataclass
class Told:
    """A watcher whose reports tell who its system was fitted to: a confidence for each held-out subject."""

    system: object
    reject: float = 0.5
    hears: bool = True

    def renamed(self, make_system, captures, recordings):
        assert {*recordings.subjects.tolist()} == {*captures.subjects.tolist()}
        return Told(make_system().fit(captures, captures.gestures), 0.0, self.hears)

    def reports(self, corpus):
        assert self.reject == 0
        subjects = corpus.subjects.tolist()
        assert not {*subjects} & self.system.subjects_ and len(self.system.subjects_) == 6 - len(subjects)
        at = 5 if self.hears else 20
        return report_table([(i, at, at + 3, "pat", "pat", float(s) / 10) for i, s in enumerate(subjects)])


class Fitted:
    def fit(self, X, y):
        assert y.tolist() == X.gestures.tolist()
        self.subjects_ = {*X.subjects.tolist()}
        return self


def test_the_threshold_is_learned_on_subjects_whom_the_system_has_not_seen():
    names = [str(i + 1) for i in range(6)]
    frames = [np.zeros((30, 1, 1), np.uint16)] * 6
    captures = Corpus.from_captures(frames * 2, pd.DataFrame({"subject": names * 2, "gesture": "pat"}), 5.0)
    whole = Corpus.from_captures(frames, pd.DataFrame({"subject": names, "gesture": ""}), 5.0)
    recordings = Recordings(whole, event_table([(i, 0, 9, "pat") for i in range(6)]))
    assert learn_reject(Fitted, captures, recordings, Told(None)) == 0.1  # of 0.1, 0.2, ... 0.6
    with pytest.raises(InputError, match="none was found"):
        learn_reject(Fitted, captures, recordings, Told(None, hears=False))
