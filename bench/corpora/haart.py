"""HAART, the Human-Animal Affective Robot Touch set, in the layout of its public release."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.text import FrameFile, capture_starts
from bench.errors import InputError

TRAINING = "training.csv"
TEST = "testWITHLABELS.csv"
CELLS = [f"cell{i}" for i in range(1, 65)]
FRAMES = 432  # the middle 8 s of 10 s at 54 Hz
RATE_HZ = 54.0
FULL_SCALE = 1023
LARGEST_MEMBER = 512 << 20  # bytes
PUBLISHED = {"train": 578, "test": 251}
GESTURES = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")
PUBLISHED_GESTURES = {
    "train": dict.fromkeys(GESTURES, 83) | {"constant": 82, "rub": 81},
    "test": dict.fromkeys(GESTURES, 36) | {"constant": 35},
}
PUBLISHED_SUBJECTS = 10


def read(path: Path) -> Corpus:
    """Read the release as a zip file, or as a folder with its two CSV files.

    Returns:
        uint16 frames 8 x 8; subject (participant number), gesture, substrate, cover, split (the 2015 challenge's).

    Raises:
        InputError: a file is missing or broken; the message names the line.
    """
    path = Path(path)
    sources = _members(path) if path.is_file() else _files(path)
    parts = [_part(sources[TRAINING], TRAINING, "train"), _part(sources[TEST], TEST, "test")]
    frames = np.concatenate([values for _, values in parts]).reshape(-1, 8, 8)
    captures = pd.concat([rows for rows, _ in parts], ignore_index=True)
    info = {
        "source": f"{path.name}; UBC SPIN lab, Human-Animal Affective Robot Touch",
        "licence": "none stated by its authors",
        "synthetic": False,
        "warnings": differences(captures),
    }
    starts = np.arange(len(captures), dtype=np.int64) * FRAMES
    lengths = np.full(len(captures), FRAMES, dtype=np.int64)
    return Corpus(frames, starts, lengths, captures, RATE_HZ, FULL_SCALE, "haart", info=info)


def differences(captures: pd.DataFrame) -> list[str]:
    """What differs from the published release, one sentence per figure."""
    found = []

    def check(what: str, here: int, published: int) -> None:
        if here != published:
            found.append(f"{what}: {here} here, {published} published")

    for split, published in PUBLISHED.items():
        part = captures[captures["split"] == split]
        check(f"{split} captures", len(part), published)
        for gesture in GESTURES:
            here = int((part["gesture"] == gesture).sum())
            check(f"{split} captures of gesture {gesture}", here, PUBLISHED_GESTURES[split][gesture])
    check("subjects", captures["subject"].nunique(), PUBLISHED_SUBJECTS)
    return found


def _files(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such file or folder; give the zip file or the folder of the release")
    found = {}
    for file in sorted([*folder.glob("*.csv"), *folder.glob("*/*.csv")]):
        found.setdefault(file.name.lower(), file)
    return {name: _need(found, name, folder.name) for name in (TRAINING, TEST)}


def _members(path: Path) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(path) as archive:
            found = {}
            for member in archive.infolist():
                found.setdefault(member.filename.rsplit("/", 1)[-1].lower(), member)
            return {name: _bytes(archive, _need(found, name, path.name)) for name in (TRAINING, TEST)}
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError, OSError) as e:
        # RuntimeError: a member is encrypted, or (NotImplementedError) packed in a way that Python does not know
        raise InputError(f"{path.name}: not a readable zip file ({e}); get it again") from e


def _need(found: dict, name: str, where: str) -> object:
    if name.lower() not in found:
        raise InputError(f"{where}: {name} is missing; give the release with its {TRAINING} and {TEST}")
    return found[name.lower()]


def _bytes(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    with archive.open(member) as f:
        content = f.read(LARGEST_MEMBER + 1)  # what the header says of its size may be wrong
    if len(content) > LARGEST_MEMBER:
        raise InputError(
            f"{Path(archive.filename).name}: {member.filename} is larger than {LARGEST_MEMBER >> 20} MiB; "
            "this is not the HAART release"
        )
    return content


def _part(source: Path | bytes, name: str, split: str) -> tuple[pd.DataFrame, np.ndarray]:
    file = FrameFile(source, name)
    participant = "ParticipantNo" if split == "train" else "ParticipantID"
    numbered = [] if split == "train" else ["Sequence"]
    conditions = [participant, "Substrate", "Cover", "Gesture"]
    file.require([*conditions, *numbered, *CELLS])
    labels, values = file.read(numbered, CELLS, FULL_SCALE)
    labels[conditions] = labels[conditions].apply(lambda c: c.astype(str).str.strip())
    if split == "test":
        starts = capture_starts(labels[conditions], labels["Sequence"].to_numpy(), 1, name)
    else:
        starts = _blocks(labels[conditions], name)
    lengths = np.diff(starts, append=len(labels))
    if len(wrong := np.flatnonzero(lengths != FRAMES)):
        line = starts[wrong[0]] + 2
        raise InputError(
            f"{name}, line {line}: the capture that starts here has {lengths[wrong[0]]} frames instead of {FRAMES}; "
            "get the file again"
        )
    first = labels.iloc[starts].reset_index(drop=True)
    _check_labels(first[participant], r"[PT]?[1-9]\d*", "a participant such as P4", starts, name)
    _check_labels(first["Gesture"], "|".join(GESTURES), f"one of {', '.join(GESTURES)}", starts, name)
    captures = pd.DataFrame(
        {
            "subject": first[participant].str.lstrip("PT"),
            "gesture": first["Gesture"],
            "substrate": first["Substrate"],
            "cover": first["Cover"],
            "split": split,
        }
    )
    return captures, values


def _check_labels(labels: pd.Series, pattern: str, wanted: str, starts: np.ndarray, name: str) -> None:
    wrong = np.flatnonzero(~labels.str.fullmatch(pattern).to_numpy(dtype=bool))
    if len(wrong):
        i = wrong[0]
        raise InputError(f"{name}, line {starts[i] + 2}: {labels.name} is {labels.iloc[i]!r}, not {wanted}; correct it")


def _blocks(labels: pd.DataFrame, name: str) -> np.ndarray:
    """Starts of the training captures, which have no frame number: 432 rows each, unless the labels change earlier."""
    codes = labels.groupby(list(labels.columns), sort=False).ngroup().to_numpy()
    starts = np.arange(0, len(labels), FRAMES)
    change = np.flatnonzero(np.diff(codes)) + 1
    early = change[change % FRAMES != 0]
    if len(early):
        row = int(early[0])
        begin = row // FRAMES * FRAMES
        raise InputError(
            f"{name}, line {row + 2}: the capture that starts in line {begin + 2} has {row - begin} frames instead of "
            f"{FRAMES}; get the file again"
        )
    return starts
