"""CuddleBot recordings of 2015 (Cang et al., ICMI 2015), the folder ``Touch Data`` of lauracang/ICMI15 on GitHub."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.archive import files
from bench.corpora.read.haart import GESTURES
from bench.corpora.read.limits import called, deviations, plain, quoted
from bench.errors import InputError

ROWS, COLS, FRAMES = 10, 10, 540  # a repetition is 10 s at 54 Hz
RATE_HZ, FULL_SCALE = 54.0, 1023
NAME = re.compile(rf"[0-9]+-([0-9]{{1,4}})(cover|none)(dynamic|static)({'|'.join(GESTURES)})\.csv")
PUBLISHED = {"captures": 902, "files": 447, "subjects": 16}
LARGEST = 64 << 20  # bytes of a file


def read(path: Path) -> Corpus:
    """Read the recordings from a folder, or from a tar or zip archive of it.

    Each repetition is a capture. Pressure is 1023 less the stored value. Conditions are cover, motion of the robot and
    repetition.

    Raises:
        InputError: there is no such file, or one is broken; the message names it.
    """
    path, rows, arrays = Path(path), [], []
    give = "the folder Touch Data or an archive"
    found = [
        (NAME.fullmatch(name.rsplit("/", 1)[-1]), name, c) for name, c in files(path, NAME.fullmatch, LARGEST, give)
    ]
    if not found:
        raise InputError(f"{called(path)}: no file like 150505-2coverdynamicpat.csv in it; give the folder Touch Data")
    seen: set[str] = set()
    for match, name, content in sorted(found, key=lambda file: (int(file[0][1]), file[1])):
        if match[0] in seen:
            raise InputError(f"{called(path)}: {match[0]} is in it twice; leave only the one that is meant")
        seen.add(match[0])
        who, cover, motion, gesture = match.groups()
        frames = _frames(content, name)
        for repetition, part in enumerate(np.split(frames, len(frames) // FRAMES), start=1):
            arrays.append(part)
            rows.append((str(int(who)), gesture, cover, motion, str(repetition)))
    captures = pd.DataFrame(rows, columns=["subject", "gesture", "cover", "motion", "repetition"])
    here = {"captures": len(captures), "files": len(seen), "subjects": captures["subject"].nunique()}
    info = {
        "source": f"{plain(path.name, 200)}; CuddleBot recordings, lauracang/ICMI15. Whether people also took part in "
        "HAART is not known",
        "licence": "none stated by its authors",
        "synthetic": False,
        "warnings": deviations([(name, here[name], published) for name, published in PUBLISHED.items()]),
    }
    return Corpus.from_captures(arrays, captures, RATE_HZ, full_scale=FULL_SCALE, name="cuddlebot", info=info)


def _frames(content: bytes, name: str) -> np.ndarray:
    """Frames of a file: uint16 [frames, rows, cols], in pressure."""
    try:
        table = pd.read_csv(io.BytesIO(content), header=None, dtype=str, keep_default_na=False)
    except (ValueError, UnicodeError) as e:  # pandas' ParserError and EmptyDataError are ValueErrors
        raise InputError(f"{plain(name)}: not a CSV file ({plain(e)}); get it again") from e
    if table.shape[1] != COLS:
        raise InputError(f"{plain(name)}: {table.shape[1]} columns instead of {COLS}; get it again")
    good = table.apply(lambda column: column.str.fullmatch("[0-9]{1,4}")).to_numpy(dtype=bool)
    values = np.where(good, table, "9999").astype(np.int64)
    wrong = np.argwhere(values > FULL_SCALE)
    if len(wrong):
        row, column = wrong[0]
        raise InputError(
            f"{plain(name)}, line {row + 1}: {quoted(str(table.iat[row, column]))} is no whole number from 0 to "
            f"{FULL_SCALE}; get the file again"
        )
    if not len(values) or len(values) % (ROWS * FRAMES):
        raise InputError(
            f"{plain(name)}: {len(values)} lines, but a repetition has {ROWS * FRAMES}: cut off; get it again"
        )
    return (FULL_SCALE - values).astype(np.uint16).reshape(-1, ROWS, COLS)
