"""CoST, the Corpus of Social Touch.

Jung et al. 2014; doi 10.4121/uuid:5ef62345-3b3e-479c-8e1d-c922748c9b29.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pacsv

from bench.corpora.corpus import Corpus
from bench.corpora.read.limits import (
    SYNTHETIC,
    check_columns,
    deviations_from_published,
    file_name,
    quote_text,
    source_info,
)
from bench.corpora.read.rows import CsvTable
from bench.corpora.synth import FULL_SCALE, VARIANTS
from bench.errors import InputError
from bench.ground.scratch import write_then_rename

GESTURES = tuple(
    "grab hit massage pat pinch poke press rub scratch slap squeeze stroke tap tickle".split()
)
LABELS = ["subject", "variant", "gesture", "frame"]
CHANNELS = [f"ch{number}" for number in range(1, 65)]
RATE_HZ = 135.0
NO_HEADER = pacsv.WriteOptions(include_header=False)

# Seven of 31 x 3 x 14 x 6 = 7812 captures were removed before publication (Jung et al. 2017, 3.3).
PUBLISHED_MD5 = "c6035f76d1e13f81168dd79586dcb742"
PUBLISHED_SUBJECTS = 31
SHORTEST, LONGEST = "frames of the shortest capture", "frames of the longest capture"
MD5 = "MD5 of the file"
PUBLISHED = {
    "captures": 7805,
    "subjects": PUBLISHED_SUBJECTS,
    "variant": {"gentle": 2601, "normal": 2602, "rough": 2602},
    "gesture": dict.fromkeys(GESTURES, 558)
    | dict.fromkeys("massage pat rub squeeze tickle".split(), 557)
    | {"stroke": 556},
    SHORTEST: 10,
    LONGEST: 1747,
    MD5: PUBLISHED_MD5,
}

# Which subjects the challenge trained on was not published, but the lengths of their captures tell:
# frames of a subject's 12 gentle and normal captures of a gesture, for the 21 training subjects.
SUMS = """
grab 957 5247 1518 2679 2409 1260 2217 2745 2340 1194 2127 1422 2250 1722 1572 2445 1107 1665 3126
3180 1809
press 663 3777 1197 2565 1548 1224 3105 1758 2610 1155 1707 1524 2310 1008 1170 2226 1035 1536
3726 2391 2040
rub 1494 4512 3918 3942 3390 2316 4293 5388 5541 1599 3480 2097 5724 3231 2226 4095 1995 2082 5646
2853 3120
scratch 1410 3594 4977 4398 3366 2082 3198 3087 4179 1158 3165 1749 5622 3960 2751 3225 1836 2604
3906 3132 2445
"""
CHALLENGE_FRAMES = {
    gesture: tuple(map(int, sums.split()))
    for gesture, sums in re.findall(r"([a-z]+)([0-9\s]+)", SUMS)
}


def read(path: Path) -> Corpus:
    """Read ``CoST.csv``, whole or in part; each deviation from the published figures is a warning.

    Row 0 is at the top (the file's channels 57 to 64). If the lengths of captures identify the
    subjects of the 2015 challenge, a column ``split`` says which captures it used for training and
    for testing. A column ``synthetic`` of ones, which CoST does not have, marks generated captures,
    as `write_cost` does.

    Raises:
        InputError: the file is not in the format, or is damaged; the message names the line.
    """
    path = Path(path)
    rows = CsvTable(path, file_name(path), counts=[*LABELS, SYNTHETIC], whole=True)
    check_columns(rows.columns, LABELS + CHANNELS, rows.header_prefix)
    synthetic = SYNTHETIC in rows.columns
    if extra := set(rows.columns) - {*LABELS, SYNTHETIC, *CHANNELS}:
        raise InputError(
            f"{rows.header_prefix}: column {quote_text(min(extra))} is not one of CoST's; "
            "import it as a table instead"
        )
    labels = rows.read_rows(CHANNELS, FULL_SCALE).labels
    if synthetic:
        is_one = labels[SYNTHETIC] == 1
        rows.check_labels(SYNTHETIC, is_one, "1, as this format marks all or none")
    for column, count in (("variant", len(VARIANTS)), ("gesture", len(GESTURES))):
        rows.check_labels(column, labels[column].between(1, count), f"one of 1 to {count}")
    first, starts, lengths = rows.split_captures(LABELS[:3], labels["frame"].to_numpy(), 1)
    captures = pd.DataFrame(
        {
            "subject": first["subject"].astype(str),
            "variant": np.asarray(VARIANTS, dtype=object)[first["variant"] - 1],
            "gesture": np.asarray(GESTURES, dtype=object)[first["gesture"] - 1],
        }
    )
    captures["repetition"] = captures.groupby(["subject", "variant", "gesture"]).cumcount() + 1
    with open(path, "rb") as file:
        md5 = hashlib.file_digest(file, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
    figures = {SHORTEST: lengths.min(), LONGEST: lengths.max(), MD5: md5}
    warnings = deviations_from_published(captures, PUBLISHED, figures)
    if training := training_subjects(captures, lengths):
        split = np.where(captures["subject"].isin(training), "train", "test")
        captures["split"] = np.where(captures["variant"] == "rough", "", split)
    else:
        warnings.append(
            "the official 21 / 10 challenge split cannot be recovered from the frame counts; "
            "protocol=challenge draws seeded random 21 / 10 splits instead and says so in every row"
        )
    source, licence = (
        "; 4TU, doi 10.4121/uuid:5ef62345-3b3e-479c-8e1d-c922748c9b29",
        "CC BY-NC-SA 4.0",
    )
    if synthetic:
        source, licence = "; generated, in the layout of CoST", "none needed"
    info = source_info(path, source, licence, warnings, synthetic)
    frames = rows.values.reshape(-1, 8, 8)[:, ::-1].copy()
    return Corpus(frames, starts, lengths, captures, RATE_HZ, FULL_SCALE, "cost", info=info)


def write_cost(corpus: Corpus, path: Path) -> None:
    """Write captures as ``CoST.csv``; ``synthetic`` follows ``frame`` for generated ones.

    Raises:
        InputError: the format cannot hold the captures, or the file cannot be written.
    """
    path, captures = Path(path), corpus.captures
    has_frames = corpus.grid == (8, 8) and corpus.frames.dtype == np.uint16
    names = [str(subject) for subject in set(corpus.subjects)]
    requirements = {
        f"8x8 frames of whole numbers up to {FULL_SCALE}": has_frames
        and corpus.frames.max() <= FULL_SCALE,
        f"a column variant of {', '.join(VARIANTS)}": "variant" in captures
        and captures["variant"].isin(VARIANTS).all(),
        f"the gestures {', '.join(GESTURES)}": np.isin(corpus.gestures, GESTURES).all(),
        "subjects that are whole numbers of up to 9 digits": all(
            re.fullmatch(r"0|[1-9]\d{0,8}", name, re.ASCII) for name in names
        ),
    }
    for requirement, is_met in requirements.items():
        if not is_met:
            raise InputError(
                f"{corpus.name}: CoST's format needs {requirement}; "
                "give format=table, which holds any captures"
            )
    variants = captures["variant"].map(VARIANTS.index) + 1
    gestures = captures["gesture"].map(GESTURES.index) + 1
    codes = np.stack([captures["subject"], variants, gestures], axis=1).astype(np.int32)
    columns = [*LABELS, *([SYNTHETIC] if corpus.synthetic else []), *CHANNELS]
    try:
        with write_then_rename(path) as beside, open(beside, "wb") as file:
            file.write(", ".join(columns).encode() + b"\n")
            for i in range(0, len(corpus), 256):  # a call for each capture takes twice as long
                some = corpus[i : i + 256]
                labels = np.repeat(codes[i : i + 256], some.lengths, axis=0)
                frame = np.concatenate([np.arange(1, n + 1, dtype=np.int32) for n in some.lengths])
                mark = np.ones((len(frame), int(corpus.synthetic)), np.int32)
                values = np.concatenate([*some])[:, ::-1].reshape(-1, 64)
                rows = np.column_stack([labels, frame, mark, values]).T.copy()
                pacsv.write_csv(pa.table([*rows], names=columns), file, NO_HEADER)
    except OSError as e:
        raise InputError(f"{path} cannot be written ({e.strerror}); choose another place") from e


def training_subjects(captures: pd.DataFrame, lengths: np.ndarray) -> set[str]:
    """The 21 training subjects of the challenge, or none if the lengths of captures do not fit.

    A training subject has a known sum in each of four gestures. A test subject may share one by
    chance (about 2 in 100 do for a gesture), but not all four. So the subjects found must be 21 and
    have exactly the known sums.
    """
    used = captures.assign(frames=lengths)[captures["variant"].isin(["gentle", "normal"])]
    frames = used.pivot_table(index="subject", columns="gesture", values="frames", aggfunc="sum")
    has_gestures = set(CHALLENGE_FRAMES) <= set(frames)
    if captures["subject"].nunique() != PUBLISHED_SUBJECTS or not has_gestures:
        return set()
    matches = [frames[gesture].isin(sums) for gesture, sums in CHALLENGE_FRAMES.items()]
    training = frames[np.logical_and.reduce(matches)]
    is_exact = all(sorted(training[g]) == sorted(sums) for g, sums in CHALLENGE_FRAMES.items())
    return set(training.index) if is_exact else set()
