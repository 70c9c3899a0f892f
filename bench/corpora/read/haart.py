"""HAART, the Human-Animal Affective Robot Touch set, in the layout of its public release."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.archive import by_macos, opened
from bench.corpora.read.csv_text import FrameFile, capture_starts
from bench.corpora.read.limits import called, plain, quoted
from bench.errors import InputError

T = TypeVar("T")
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
_BROKEN = "not a readable zip file ({}); get it again"


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
        "source": f"{plain(path.name, 200)}; UBC SPIN lab, Human-Animal Affective Robot Touch",
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
        raise InputError(
            f"{plain(folder, 160)}: there is no such file or folder; give the zip file or the folder of the release"
        )
    files = [file for pattern in ("*", "*/*") for file in folder.glob(pattern) if file.is_file()]
    return _chosen({file.relative_to(folder).as_posix(): file for file in files}.items(), called(folder))


def _members(path: Path) -> dict[str, bytes]:
    with opened(path, _BROKEN) as (archive, members):
        chosen = _chosen(((member.filename, member) for member in members), called(path))
        if max(member.file_size for member in chosen.values()) > LARGEST_MEMBER:
            raise InputError(f"{called(path)}: a file in it is larger than {LARGEST_MEMBER >> 20} MiB; get it again")
        return {name: archive.read(member) for name, member in chosen.items()}


def _chosen(everything: Iterable[tuple[str, T]], where: str) -> dict[str, T]:
    """The two files among all by their paths, the ones that lie least deep."""
    found: dict[str, list[tuple[int, T]]] = {}
    for path, file in everything:
        if not by_macos(path):
            *folders, name = path.split("/")
            found.setdefault(name.lower(), []).append((len(folders), file))
    chosen = {}
    for name in (TRAINING, TEST):
        if name.lower() not in found:
            raise InputError(f"{where}: {name} is missing; give the release with its {TRAINING} and {TEST}")
        least = min(depth for depth, _ in found[name.lower()])
        first, *others = (file for depth, file in found[name.lower()] if depth == least)
        if others:
            raise InputError(f"{where}: {name} is in it twice; leave only the one that is meant")
        chosen[name] = first
    return chosen


def _part(source: Path | bytes, name: str, split: str) -> tuple[pd.DataFrame, np.ndarray]:
    file = FrameFile(source, name)
    participant = "ParticipantNo" if split == "train" else "ParticipantID"
    numbered = [] if split == "train" else ["Sequence"]
    conditions = [participant, "Substrate", "Cover", "Gesture"]
    file.require([*conditions, *numbered, *CELLS])
    labels, values = file.read(numbered, CELLS, FULL_SCALE)
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
    first = labels.iloc[starts].reset_index(drop=True).astype(dict.fromkeys(conditions, str))
    _check_labels(first[participant], "[PT]?[1-9][0-9]{0,8}", "a participant such as P4", starts, name)
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
        raise InputError(
            f"{name}, line {starts[i] + 2}: {labels.name} is {quoted(labels.iloc[i])}, not {wanted}; correct it"
        )


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
