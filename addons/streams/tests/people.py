"""Recordings of generated people, and made-up results of ``bench watch``."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.corpora import synth
from bench.corpora.library import import_corpus
from bench.ground.scratch import data_folder
from bench.plan.grid import make_cells
from bench.plan.plan import Fold, make_plans
from tests.reading.results import HAART, make_result
from touchbench_streams import synth_recordings
from touchbench_streams.study import Continuous

TINY = ["data=synth", "data.subjects=3", "data.variants=normal", "data.rate_hz=20"]
TINY += ["data.rows=3", "data.cols=3", "jobs=1"]
FEW = {name: synth.GESTURES[name] for name in ("grab", "pat", "poke", "rub", "stroke", "tap")}


def generate_people(**fields):
    """Generate people with one touch of each of a few gestures, on 3 x 3 taxels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synth_recordings, "GESTURES", FEW)
        return synth_recordings.generate(variants=("normal",), rows=3, cols=3, **fields)


PEOPLE = generate_people(subjects=3, rate_hz=15.0)
# 100 s at 50 Hz with 10 s of touch; one touch is found, one missed, one false alarm raised.
WATCHED = pd.DataFrame(
    [("recording", np.nan, 5000, None, np.nan, None, None, np.nan)]
    + [
        ("touch", 500, 750, "pat", np.nan, None, None, np.nan),
        ("touch", 1000, 1250, "rub", np.nan, None, None, np.nan),
    ]
    + [
        ("report", np.nan, 755, None, 550, "tap", "pat", 0.8),
        ("report", np.nan, 2000, None, 1900, "rub", "rub", 0.6),
    ]
    + [
        ("probability", np.nan, np.nan, None, seen, None, None, 0.1)
        for seen in range(20, 5000, 100)
    ],
    columns=["kind", "start", "end", "gesture", "reported", "first", "label", "confidence"],
).assign(recording=0, subject="1", fold="1", changes=0)


def import_recordings(name, frames, labels, subjects, rate_hz="15"):
    """Import recordings of 3 x 3 taxels under a name."""
    table = pd.DataFrame(frames.reshape(len(labels), -1), columns=[f"ch{i}" for i in range(9)])
    file = Path(data_folder(), f"{name}.parquet")
    file.parent.mkdir(parents=True, exist_ok=True)
    table.assign(label=labels, subject=subjects)[["subject", "label", *table.columns]].to_parquet(
        file
    )
    return import_corpus("recording", file, {"name": name, "rate_hz": rate_hz, "grid": "3x3"})


def import_day(labels=None, frames=None):
    """Import the recordings of `PEOPLE` as ``day``, with other labels and frames if given."""
    labels = PEOPLE.frame_labels() if labels is None else labels
    frames = PEOPLE.corpus.frames if frames is None else frames
    return import_recordings(
        "day", frames, labels, np.repeat(PEOPLE.subjects, PEOPLE.corpus.lengths)
    )


def make_day_plan():
    """The plan of ``bench watch data=day``."""
    found = make_cells({"data": "day", "model": "lda", "features": "touch"})
    return make_plans([replace(cell, run_kind=Continuous()) for cell in found], 1)[0]


def fold_without(subject, corpus):
    """The fold that tests a subject."""
    return Fold(
        subject,
        *(np.flatnonzero((corpus.subjects == subject) == tested) for tested in (False, True)),
    )


def make_watch_result(system, end_correct, alarms, latency, flash=4000.0, tables=None, **about):
    """A result of ``bench watch`` with each subject's share of touches correct at the end."""
    metrics = {
        "end_correct": sum(end_correct) / len(end_correct),
        "touches_found": 0.9,
        "first_correct": 0.5,
    }
    metrics |= {
        "false_alarms_per_hour": alarms,
        "latency_s_p50": latency,
        "flash_bytes": flash,
        "ram_bytes": 900.0,
    }
    metrics |= {"touches": 2.0, "background_minutes": 1.5, "quiet_ms": 2.0}
    hours = {"false_alarms_per_hour": alarms, "background_s": 90.0 / len(end_correct)}
    names = map(str, range(1, len(end_correct) + 1))
    usual = {
        "predictions": WATCHED,
        "per_subject": pd.DataFrame({"subject": names, "end_correct": end_correct, **hours}),
        "curve": pd.DataFrame(
            {"offset": [-1, 0], "missed": [0.5, 0.0], "false_alarms_per_hour": [0.0, 40]}
        ),
    }
    options = {
        "watch.detector": "frames",
        "watch.false_alarms": "5.0",
        "watch.background": "",
        "watch.unknown": "",
    }
    return make_result(system, "watch", metrics, usual | (tables or {}), **HAART | options | about)
