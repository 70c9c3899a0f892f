"""HAART, the Human-Animal Affective Robot Touch set, in the layout of its public release."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.archive import files
from bench.corpora.read.limits import called, check_columns, deviations, plain
from bench.corpora.read.rows import CsvTable
from bench.errors import InputError

TRAINING = "training.csv"
TEST = "testWITHLABELS.csv"
CELLS = [f"cell{i}" for i in range(1, 65)]
FRAMES = 432  # the middle 8 s of 10 s at 54 Hz
RATE_HZ = 54.0
FULL_SCALE = 1023
LARGEST = 512 << 20  # bytes of a file
PUBLISHED = {"train": 578, "test": 251}
GESTURES = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")
PUBLISHED_GESTURES = {
    "train": dict.fromkeys(GESTURES, 83) | {"constant": 82, "rub": 81},
    "test": dict.fromkeys(GESTURES, 36) | {"constant": 35},
}
PUBLISHED_SUBJECTS = 10


def read(path: Path) -> Corpus:
    """Read the release, an archive or a folder with its two CSV files; ``split`` is the 2015 challenge's.

    Raises:
        InputError: a file is missing or broken; the message names the line.
    """
    path = Path(path)
    found: dict[str, bytes] = {}
    for name, content in files(
        path,
        lambda name: name.lower() in (TRAINING, TEST.lower()),
        LARGEST,
        "the zip file or the folder of the release",
    ):
        if (file := name.lower().rsplit("/", 1)[-1]) in found:
            raise InputError(f"{called(path)}: {plain(name)} is in it twice; leave only the one that is meant")
        found[file] = content
    if missing := [name for name in (TRAINING, TEST) if name.lower() not in found]:
        raise InputError(f"{called(path)}: {missing[0]} is missing; give the release with its {TRAINING} and {TEST}")
    parts = [_part(found[name.lower()], name, split) for name, split in ((TRAINING, "train"), (TEST, "test"))]
    frames = np.concatenate([values for _, values in parts]).reshape(-1, 8, 8)
    captures = pd.concat([rows for rows, _ in parts], ignore_index=True)
    info = {
        "source": f"{plain(path.name, 200)}; UBC SPIN lab, Human-Animal Affective Robot Touch",
        "licence": "none stated by its authors",
        "synthetic": False,
        "warnings": differences(captures),
    }
    starts = np.arange(len(captures), dtype=np.int64) * FRAMES
    lengths = np.full(len(captures), FRAMES, dtype=np.int64)
    return Corpus(frames, starts, lengths, captures, RATE_HZ, FULL_SCALE, "haart", info=info)


def differences(captures: pd.DataFrame) -> list[str]:
    """Differences from the published release, one sentence per figure."""
    figures = []
    for split, published in PUBLISHED.items():
        counts = captures.loc[captures["split"] == split, "gesture"].value_counts()
        figures.append((f"{split} captures", counts.sum(), published))
        for gesture in GESTURES:
            here = counts.get(gesture, 0)
            figures.append((f"{split} captures of gesture {gesture}", here, PUBLISHED_GESTURES[split][gesture]))
    return deviations([*figures, ("subjects", captures["subject"].nunique(), PUBLISHED_SUBJECTS)])


def _part(source: bytes, name: str, split: str) -> tuple[pd.DataFrame, np.ndarray]:
    """Captures and frames of one file; frames of the training file have no number, but 432 make a capture."""
    table = CsvTable(source, name, counts=["Sequence"], whole=True)
    participant, numbered = ("ParticipantNo", []) if split == "train" else ("ParticipantID", ["Sequence"])
    conditions = [participant, "Substrate", "Cover", "Gesture"]
    check_columns(table.columns, [*conditions, *numbered, *CELLS], table.header)
    rows = table.read(CELLS, FULL_SCALE)
    labels = rows.labels
    frame = labels["Sequence"].to_numpy() if numbered else np.arange(len(labels)) % FRAMES + 1
    starts = rows.starts(conditions, frame, 1)
    lengths = np.diff(starts, append=len(labels))
    if len(wrong := np.flatnonzero(lengths != FRAMES)):
        rows.refuse(
            starts[wrong[0]],
            f"the capture that starts here has {lengths[wrong[0]]} frames instead of {FRAMES}; get the file again",
        )
    who, gesture = labels[participant], labels["Gesture"]
    rows.check(participant, who.str.fullmatch("[PT]?[1-9][0-9]{0,8}"), "a participant such as P4")
    rows.check("Gesture", gesture.isin(GESTURES), f"one of {', '.join(GESTURES)}")
    first = labels.iloc[starts].astype(dict.fromkeys(conditions, str)).reset_index(drop=True)
    captures = {
        "subject": first[participant].str.lstrip("PT"),
        "gesture": first["Gesture"],
        "substrate": first["Substrate"],
        "cover": first["Cover"],
        "split": split,
    }
    return pd.DataFrame(captures), rows.values
