"""HAART, the Human-Animal Affective Robot Touch set, in the layout of its public release."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.archive import read_files
from bench.corpora.read.limits import (
    check_columns,
    deviations_from_published,
    file_name,
    source_info,
)
from bench.corpora.read.rows import CsvTable
from bench.errors import InputError

FILES = {"training.csv": "train", "testWITHLABELS.csv": "test"}
CELLS = [f"cell{number}" for number in range(1, 65)]
FRAMES = 432  # the middle 8 s of 10 s at 54 Hz
RATE_HZ = 54.0
FULL_SCALE = 1023
LARGEST = 512 << 20  # bytes of a file
GESTURES = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")
PUBLISHED = {
    "train": {
        "captures": 578,
        "gesture": dict.fromkeys(GESTURES, 83) | {"constant": 82, "rub": 81},
    },
    "test": {"captures": 251, "gesture": dict.fromkeys(GESTURES, 36) | {"constant": 35}},
}
PUBLISHED_SUBJECTS = 10


def read(path: Path) -> Corpus:
    """Read the release, an archive or a folder with its two CSV files.

    The column ``split`` is that of the 2015 challenge.

    Raises:
        InputError: a file is missing or damaged; the message names the line.
    """
    path, names = Path(path), [name.lower() for name in FILES]
    advice = "the zip file or the folder of the release"
    contents = read_files(path, names.__contains__, LARGEST, advice)
    if missing := [name for name in FILES if name.lower() not in contents]:
        raise InputError(
            f"{file_name(path)}: {missing[0]} is missing; give the release with its "
            f"{' and '.join(FILES)}"
        )
    parts = [_read_part(contents[name.lower()], name, split) for name, split in FILES.items()]
    frames = np.concatenate([values for _, values in parts]).reshape(-1, 8, 8)
    captures = pd.concat([labels for labels, _ in parts], ignore_index=True)
    warnings = []
    for split, figures in PUBLISHED.items():
        part = captures[captures["split"] == split]
        warnings += deviations_from_published(part, figures, part=f"{split} ")
    warnings += deviations_from_published(captures, {"subjects": PUBLISHED_SUBJECTS})
    source = "; UBC SPIN lab, Human-Animal Affective Robot Touch"
    info = source_info(path, source, "none stated by its authors", warnings)
    starts = np.arange(len(captures), dtype=np.int64) * FRAMES
    lengths = np.full_like(starts, FRAMES)
    return Corpus(frames, starts, lengths, captures, RATE_HZ, FULL_SCALE, "haart", info=info)


def _read_part(content: bytes, name: str, split: str) -> tuple[pd.DataFrame, np.ndarray]:
    """Captures and frames of one file; the training file does not number its frames."""
    rows = CsvTable(content, name, counts=["Sequence"], whole=True)
    participant = "ParticipantNo" if split == "train" else "ParticipantID"
    numbers = [] if split == "train" else ["Sequence"]
    conditions = [participant, "Gesture", "Substrate", "Cover"]
    check_columns(rows.columns, [*conditions, *numbers, *CELLS], rows.header_prefix)
    labels = rows.read_rows(CELLS, FULL_SCALE).labels
    frame = labels["Sequence"].to_numpy() if numbers else np.arange(len(labels)) % FRAMES + 1
    captures, starts, lengths = rows.split_captures(conditions, frame, 1)
    if len(wrong := np.flatnonzero(lengths != FRAMES)):
        rows.refuse_row(
            starts[wrong[0]],
            f"the capture that starts here has {lengths[wrong[0]]} frames instead of {FRAMES}; "
            "get the file again",
        )
    is_name = labels[participant].str.fullmatch("[PT]?[1-9][0-9]{0,8}")
    rows.check_labels(participant, is_name, "a participant such as P4")
    is_gesture = labels["Gesture"].isin(GESTURES)
    rows.check_labels("Gesture", is_gesture, f"one of {', '.join(GESTURES)}")
    captures = captures[conditions].set_axis(["subject", "gesture", "substrate", "cover"], axis=1)
    return captures.assign(subject=captures["subject"].str.lstrip("PT"), split=split), rows.values
