"""Recordings of any sensor: a CSV or parquet file with a label per frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.limits import check_file, file_name, one_line, quote_text, shorten
from bench.corpora.read.rows import Table, categories_as_text, differs_from_previous
from bench.corpora.read.table import check_scales, describe_source, parse_grid, read_table_rows
from bench.corpora.spellings import background_doubts
from bench.errors import InputError
from touchbench_streams.recordings import Recordings, cut_into_captures, find_events

KNOWN_COLUMNS = ["label", "recording", "subject", "gesture", "frame"]


def read(path: Path, rate_hz: float, grid: str, full_scale: float = 1023.0) -> Corpus:
    """Read continuous recordings, with one row per frame.

    Each row has a ``label``: a gesture; nothing for background; or ``?`` for a doubtful frame.
    Words such as ``nan`` stand for background, too; ``0`` and ``rest`` do if no label is empty.
    Each run of equal labels is an event. Columns ``recording`` and ``subject`` are optional; a new
    recording begins where one of them changes. A column ``frame`` is optional, too; if there is
    one, it must increase by one within a recording. Other columns are conditions and stay the same
    within a recording. Channels are read as in `bench.corpora.read.table.read`.

    Args:
        path: the file.
        rate_hz: frames per second.
        grid: ``ROWSxCOLS``.
        full_scale: largest value that the sensor gives.

    Returns:
        Captures of all events, doubtful stretches and gaps
        (`touchbench_streams.recordings.cut_into_captures`), with frames of uint16 or float32.
        Without a column ``subject`` the subject is ``"1"``.

    Raises:
        InputError: the file does not fit; the message names the line.
    """
    path = Path(path)
    check_scales(rate_hz, full_scale)
    size = parse_grid(grid)
    check_file(path)
    rows, warnings = read_table_rows(
        path, size, full_scale, ["label"], KNOWN_COLUMNS, optional="label"
    )
    labels = rows.labels
    if "gesture" in labels:
        raise InputError(
            f"{file_name(path)}: label names the gesture of each frame; delete the column gesture"
        )
    gestures = _labels_as_text(labels.pop("label"), file_name(path))
    warnings = [*warnings, *background_doubts(pd.Series(gestures).value_counts().to_dict())]
    rows.check_filled()
    if "subject" not in labels:
        labels["subject"] = "1"
        warnings = [*warnings, "no column subject: all recordings are treated as one subject"]
    frame = rows.take_frame_numbers() if "frame" in labels else None
    starts = _find_recording_starts(rows, frame)
    captures = categories_as_text(labels.iloc[starts].reset_index(drop=True))
    captures.insert(0, "subject", captures.pop("subject"))
    captures.insert(1, "gesture", "")
    if "recording" in captures:
        captures["recording"] = captures["recording"].astype(str)
    lengths = np.diff(starts, append=len(gestures))
    corpus = Corpus(rows.values.reshape(-1, *size), starts, lengths, captures, rate_hz, full_scale)
    corpus = describe_source(corpus, path, warnings, "recording")
    return cut_into_captures(Recordings(corpus, find_events(gestures, lengths)))


def _labels_as_text(column: pd.Series, name: str) -> np.ndarray:
    """Labels as text, ``""`` for none, object [frames]."""
    if not isinstance(column.dtype, pd.CategoricalDtype) and column.dtype.kind not in "iu":
        kind = one_line(column.dtype, 40)
        raise InputError(f"{name}: label is of type {kind}; save it as text or whole numbers")
    return column.astype("string").fillna("").to_numpy(dtype=object)


def _find_recording_starts(rows: Table, frame: np.ndarray | None) -> np.ndarray:
    """Rows at which recordings begin, int64 [recordings]."""
    labels = rows.labels
    changed = {name: differs_from_previous(labels[name]) for name in labels}
    names = [name for name in ("recording", "subject") if name in labels]
    begins = np.logical_or.reduce([changed[name] for name in names])
    begins[0] = True
    starts = np.flatnonzero(begins)
    is_repeated = labels.iloc[starts].duplicated(names).to_numpy()
    if is_repeated.any():
        row = starts[np.argmax(is_repeated)]
        name = quote_text(str(labels[names[0]].iloc[row]))
        hint = "keep its frames together"
        if len(names) == 1:
            hint += ", or add a column recording"
        rows.refuse_row(row, f"{names[0]} {name} begins a second time; {hint}")
    for name in labels.columns.difference(names, sort=False):
        if len(wrong := np.flatnonzero(changed[name] & ~begins)):
            hint = "delete the column, or begin a new recording there"
            rows.refuse_row(wrong[0], f"{shorten(str(name))} changes within a recording; {hint}")
    if frame is not None:
        wrong = np.flatnonzero(~begins & (np.diff(frame, prepend=0) != 1))
        if len(wrong):
            rows.refuse_frame_step(wrong[0], frame)
    return starts
