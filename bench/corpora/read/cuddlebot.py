"""CuddleBot recordings of 2015 (Cang et al., ICMI 2015).

They are the folder ``Touch Data`` of lauracang/ICMI15 on GitHub.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.archive import read_files
from bench.corpora.read.haart import GESTURES
from bench.corpora.read.limits import deviations_from_published, file_name, source_info
from bench.corpora.read.rows import CsvTable
from bench.errors import InputError

ROWS, FRAMES = 10, 540  # a repetition is 10 s at 54 Hz
TAXELS = [f"taxel{i}" for i in range(1, 11)]  # of a row; files have no header
RATE_HZ, FULL_SCALE = 54.0, 1023
SUBJECTS = "[2-9]|1[0-7]"  # of the study; the repository has trials of a first person, too
NAME = re.compile(rf"[0-9]+-({SUBJECTS})(cover|none)(dynamic|static)({'|'.join(GESTURES)})\.csv")
PUBLISHED = {"captures": 902, "files": 447, "subjects": 16}
LARGEST = 64 << 20  # bytes of a file
SOURCE = (
    "; CuddleBot recordings, lauracang/ICMI15. Whether people also took part in HAART is not known"
)


def read(path: Path) -> Corpus:
    """Read the recordings from a folder, or from a tar or zip archive of it.

    Each repetition is a capture. Pressure is 1023 less the stored value. Conditions are cover,
    motion of the robot and repetition.

    Raises:
        InputError: there is no such file, or one is damaged; the message names it.
    """
    path, rows, arrays = Path(path), [], []
    contents = read_files(path, NAME.fullmatch, LARGEST, "the folder Touch Data or an archive")
    if not contents:
        raise InputError(
            f"{file_name(path)}: no file like 150505-2coverdynamicpat.csv in it; "
            "give the folder Touch Data"
        )
    for name in sorted(contents, key=lambda name: (int(NAME.fullmatch(name)[1]), name)):
        subject, cover, motion, gesture = NAME.fullmatch(name).groups()
        frames = _read_frames(contents[name], name)
        for repetition, part in enumerate(np.split(frames, len(frames) // FRAMES), start=1):
            arrays.append(part)
            rows.append((str(int(subject)), gesture, cover, motion, str(repetition)))
    captures = pd.DataFrame(rows, columns=["subject", "gesture", "cover", "motion", "repetition"])
    warnings = deviations_from_published(captures, PUBLISHED, {"files": len(contents)})
    info = source_info(path, SOURCE, "none stated by its authors", warnings)
    return Corpus.from_captures(
        arrays, captures, RATE_HZ, full_scale=FULL_SCALE, name="cuddlebot", info=info
    )


def _read_frames(content: bytes, name: str) -> np.ndarray:
    """Pressure in a file, uint16 [frames, rows, cols]."""
    lines = filter(bytes.strip, content.splitlines())  # blank ones are between repetitions
    header = ",".join(TAXELS).encode()
    rows = CsvTable(b"\n".join([header, *lines]), name, whole=True)
    rows.first = 1  # the header is ours
    values = rows.read_rows(TAXELS, FULL_SCALE).values
    if len(values) % (ROWS * FRAMES):
        raise InputError(
            f"{name}: {len(values)} lines, but a repetition has {ROWS * FRAMES}: cut off; "
            "get it again"
        )
    return (FULL_SCALE - values).reshape(-1, ROWS, len(TAXELS))
