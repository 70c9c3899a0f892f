"""The survey of recordings against a loop over frames."""

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.corpora.recordings import Recordings, captures_in, event_table
from bench.corpora.streams import survey_recordings

RATE = 10.0
EVENTS = [(0, 4, 8, "pat"), (0, 10, 12, "?"), (0, 14, 20, "rub"), (0, 20, 22, "pat"), (1, 0, 3, "pat")]


def test_levels_stretches_and_gaps_are_those_of_a_loop():
    rng = np.random.default_rng(4)
    frames = [rng.integers(0, 120, (n, 2, 3)).astype(np.uint16) for n in (40, 12, 9)]
    for recording, start, end, _ in EVENTS:
        frames[recording][start:end] += 20
    frames[0][:, 1, 2] = 7
    names = pd.DataFrame({"subject": ["ann", "ann", "bob"], "gesture": "", "recording": ["x", "y", "z"]})
    whole = Recordings.of(Corpus.from_captures(frames, names, RATE), event_table(EVENTS))
    found = survey_recordings(whole, captures_in(whole))
    for i, stream in enumerate(frames):
        level = np.array([frame.mean() for frame in stream])
        label = np.full(len(stream), "", object)
        for recording, start, end, gesture in EVENTS:
            if recording == i:
                label[start:end] = gesture
        quiet = level[label == ""]
        row = found.recordings.iloc[i]
        assert row["background"] == pytest.approx(len(quiet) / RATE / 60)
        assert row["doubtful"] == pytest.approx((label == "?").sum() / RATE / 60)
        assert row["idle"] == pytest.approx(np.quantile(quiet, 0.25))
        mine = found.stretches[found.stretches["recording"] == names["recording"][i]]
        if i == 2:  # bob never touched, so nothing is known of his touches
            assert np.isnan(row["touch"]) and row["above"] == 0 and not len(mine)
            continue
        touch = np.quantile(level[(label != "") & (label != "?")], 0.25)
        assert (row["touch"], row["above"]) == pytest.approx((touch, 100 * (quiet > touch).mean()))
        above = {k for k in range(len(stream)) if label[k] == "" and level[k] > touch}
        spans = [range(round(s * RATE), round(e * RATE)) for s, e in mine[["start", "end"]].to_numpy()]
        assert {k for span in spans for k in span} == above
        assert all(span.start - 1 not in above and span.stop not in above for span in spans)
        assert mine["pressure"].tolist() == pytest.approx([level[span.start : span.stop].mean() for span in spans])
    assert len(found.stretches) >= 5
    assert found.gaps.tolist() == pytest.approx([0.6, 0.0]) and found.brief == 0.5  # what is between is not looked at
    taxels = found.captures.taxels
    assert taxels["mean"].tolist() == pytest.approx(np.concatenate(frames).mean(axis=0).ravel().tolist())
