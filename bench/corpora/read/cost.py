"""CoST, the Corpus of Social Touch (Jung et al. 2014; doi 10.4121/uuid:5ef62345-3b3e-479c-8e1d-c922748c9b29)."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pacsv

from bench.corpora.corpus import Corpus
from bench.corpora.read.limits import SYNTHETIC, called, check_columns, deviations, plain, quoted
from bench.corpora.read.rows import CsvTable
from bench.corpora.synth import FULL_SCALE, VARIANTS
from bench.errors import InputError
from bench.scratch import replacing

GESTURES = tuple("grab hit massage pat pinch poke press rub scratch slap squeeze stroke tap tickle".split())
LABELS = ["subject", "variant", "gesture", "frame"]
CHANNELS = [f"ch{i}" for i in range(1, 65)]
RATE_HZ = 135.0

# Of 31 x 3 x 14 x 6 = 7812 captures seven were removed before publication (Jung et al. 2017, section 3.3).
PUBLISHED_MD5 = "c6035f76d1e13f81168dd79586dcb742"
PUBLISHED_CAPTURES = 7805
PUBLISHED_SUBJECTS = 31
PUBLISHED_VARIANTS = {"gentle": 2601, "normal": 2602, "rough": 2602}
PUBLISHED_GESTURES = {g: 558 for g in GESTURES} | dict.fromkeys(("massage", "pat", "rub", "squeeze", "tickle"), 557)
PUBLISHED_GESTURES["stroke"] = 556
PUBLISHED_LENGTHS = (10, 1747)

# Which subjects the challenge trained on was not published, but the lengths of their captures identify them: frames of
# a subject's 12 gentle and normal captures of a gesture, for the 21 training subjects.
SUMS = """
grab 957 5247 1518 2679 2409 1260 2217 2745 2340 1194 2127 1422 2250 1722 1572 2445 1107 1665 3126 3180 1809
press 663 3777 1197 2565 1548 1224 3105 1758 2610 1155 1707 1524 2310 1008 1170 2226 1035 1536 3726 2391 2040
rub 1494 4512 3918 3942 3390 2316 4293 5388 5541 1599 3480 2097 5724 3231 2226 4095 1995 2082 5646 2853 3120
scratch 1410 3594 4977 4398 3366 2082 3198 3087 4179 1158 3165 1749 5622 3960 2751 3225 1836 2604 3906 3132 2445
"""
CHALLENGE_FRAMES = {gesture: tuple(map(int, sums)) for gesture, *sums in map(str.split, SUMS.strip().splitlines())}


def read(path: Path) -> Corpus:
    """Read ``CoST.csv``, whole or in part; every figure that differs from the published one is a warning.

    Row 0 is at the top (the file's channels 57 to 64). Where the lengths of captures identify the subjects of the 2015
    challenge, a column ``split`` says which captures it used for training and for testing. A column ``synthetic`` of
    ones, which CoST has not, marks generated captures, as `write` does.

    Raises:
        InputError: the file is not in the format, or is broken; the message names the line.
    """
    path = Path(path)
    table = CsvTable(path, called(path), counts=[*LABELS, SYNTHETIC], whole=True)
    check_columns(table.columns, LABELS + CHANNELS, table.header)
    made = SYNTHETIC in table.columns
    if extra := set(table.columns) - {*LABELS, SYNTHETIC, *CHANNELS}:
        raise InputError(
            f"{table.header}: column {quoted(min(extra))} is not one of CoST's; import it as a table instead"
        )
    rows = table.read(CHANNELS, FULL_SCALE)
    labels = rows.labels
    if made:
        rows.check(SYNTHETIC, labels[SYNTHETIC] == 1, "1, as this format marks all or none")
    for column, codes in (("variant", len(VARIANTS)), ("gesture", len(GESTURES))):
        rows.check(column, labels[column].between(1, codes), f"one of 1 to {codes}")
    starts = rows.starts(LABELS[:3], labels["frame"].to_numpy(), 1)
    first = labels.iloc[starts]
    captures = pd.DataFrame(
        {
            "subject": first["subject"].astype(str).to_numpy(),
            "variant": np.asarray(VARIANTS, dtype=object)[first["variant"].to_numpy() - 1],
            "gesture": np.asarray(GESTURES, dtype=object)[first["gesture"].to_numpy() - 1],
        }
    )
    captures["repetition"] = captures.groupby(["subject", "variant", "gesture"]).cumcount() + 1
    lengths = np.diff(starts, append=len(labels))
    with open(path, "rb") as file:
        md5 = hashlib.file_digest(file, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
    warnings = differences(captures, lengths, md5)
    if training := training_subjects(captures, lengths):
        split = np.where(captures["subject"].isin(training), "train", "test")
        captures["split"] = np.where(captures["variant"] == "rough", "", split)
    else:
        warnings.append(
            "the official 21 / 10 challenge split cannot be recovered from the frame counts; protocol=challenge draws "
            "seeded random 21 / 10 splits instead and says so in every row"
        )
    published = "; 4TU, doi 10.4121/uuid:5ef62345-3b3e-479c-8e1d-c922748c9b29"
    info = {
        "source": plain(path.name, 200) + ("; generated, in the layout of CoST" if made else published),
        "licence": "none needed" if made else "CC BY-NC-SA 4.0",
        "synthetic": made,
        "warnings": warnings,
    }
    frames = rows.values.reshape(-1, 8, 8)
    for block in np.array_split(frames, max(1, len(frames) // 65536)):
        block[:] = block[:, ::-1].copy()
    return Corpus(frames, starts, lengths, captures, RATE_HZ, FULL_SCALE, "cost", info=info)


def write(corpus: Corpus, path: Path) -> None:
    """Write captures in the format of ``CoST.csv``, generated ones with a column ``synthetic`` behind ``frame``."""
    path, captures = Path(path), corpus.captures
    if not path.name or (path.exists() and not path.is_file()):  # a device would be replaced, a pipe waited for
        raise InputError(f"{path} cannot be written (it is not a plain file); name a file")
    if corpus.grid != (8, 8) or corpus.frames.dtype != np.uint16:
        rows, cols = corpus.grid
        raise InputError(
            f"{corpus.name}: CoST's format holds 8x8 frames of whole numbers, these are {rows}x{cols} of "
            f"{corpus.frames.dtype}"
        )
    if (highest := max((int(capture.max()) for capture in corpus), default=0)) > FULL_SCALE:
        raise InputError(f"{corpus.name}: CoST's format holds values up to {FULL_SCALE}, the highest here is {highest}")
    if "variant" not in captures or not captures["variant"].isin(VARIANTS).all():
        raise InputError(f"{corpus.name}: CoST's format needs a column variant of {', '.join(VARIANTS)}")
    if unknown := sorted(set(corpus.gestures) - set(GESTURES)):
        raise InputError(f"{corpus.name}: gesture {unknown[0]!r} has no code in CoST's format")
    if unfit := sorted(s for s in set(map(str, corpus.subjects)) if not re.fullmatch(r"0|[1-9]\d{0,8}", s, re.ASCII)):
        raise InputError(
            f"{corpus.name}: CoST's format needs subjects that are whole numbers of up to 9 digits, not {unfit[0]!r}"
        )
    variants, gestures = captures["variant"].map(VARIANTS.index), captures["gesture"].map(GESTURES.index)
    codes = np.stack([captures["subject"].astype(int), variants.astype(int) + 1, gestures.astype(int) + 1], axis=1)
    columns = [*LABELS, *([SYNTHETIC] if corpus.synthetic else []), *CHANNELS]
    try:
        with replacing(path) as beside, open(beside, "wb") as f:
            f.write(", ".join(columns).encode() + b"\n")
            for i in range(0, len(corpus), 256):
                some = corpus[i : i + 256]
                frame = np.concatenate([np.arange(1, n + 1, dtype=np.int32) for n in some.lengths])
                values = np.concatenate(list(some))[:, ::-1].reshape(-1, 64)
                mark = np.ones((len(frame), len(columns) - len(LABELS + CHANNELS)), np.int32)
                labels = np.repeat(codes[i : i + 256].astype(np.int32), some.lengths, axis=0)
                rows = np.column_stack([labels, frame, mark, values])
                table = pa.Table.from_arrays([pa.array(column) for column in rows.T.copy()], names=columns)
                pacsv.write_csv(table, f, pacsv.WriteOptions(include_header=False))
    except OSError as e:
        raise InputError(f"{path} cannot be written ({e.strerror}); choose another place") from e


def differences(captures: pd.DataFrame, lengths: np.ndarray, md5: str) -> list[str]:
    """Differences from the published corpus, one sentence per figure."""
    counts = captures["variant"].value_counts(), captures["gesture"].value_counts()
    return deviations(
        [
            ("captures", len(captures), PUBLISHED_CAPTURES),
            ("subjects", captures["subject"].nunique(), PUBLISHED_SUBJECTS),
            *((f"captures of variant {v}", counts[0].get(v, 0), n) for v, n in PUBLISHED_VARIANTS.items()),
            *((f"captures of gesture {g}", counts[1].get(g, 0), n) for g, n in PUBLISHED_GESTURES.items()),
            ("frames of the shortest capture", lengths.min(), PUBLISHED_LENGTHS[0]),
            ("frames of the longest capture", lengths.max(), PUBLISHED_LENGTHS[1]),
            ("MD5 of the file", md5, PUBLISHED_MD5),
        ]
    )


def training_subjects(captures: pd.DataFrame, lengths: np.ndarray) -> set[str]:
    """The 21 training subjects of the challenge by the lengths of their captures, or none if they do not match.

    A training subject has a known sum in each of the four gestures. A test subject may share one of them by chance,
    about 2 in 100 do for a gesture, but not all four; so the subjects found must be 21 and have exactly the known sums.
    """
    used = captures.assign(frames=lengths)[captures["variant"].isin(["gentle", "normal"])]
    frames = used.pivot_table(index="subject", columns="gesture", values="frames", aggfunc="sum")
    if captures["subject"].nunique() != PUBLISHED_SUBJECTS or not set(CHALLENGE_FRAMES) <= set(frames):
        return set()
    matches = [frames[gesture].isin(sums) for gesture, sums in CHALLENGE_FRAMES.items()]
    training = frames[np.logical_and.reduce(matches)]
    exact = all(sorted(training[gesture]) == sorted(sums) for gesture, sums in CHALLENGE_FRAMES.items())
    return set(training.index) if exact else set()
