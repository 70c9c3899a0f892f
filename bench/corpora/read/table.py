"""Captures of any sensor: a long CSV or parquet file, or arrays in a ``.npz`` file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, reserved_names
from bench.corpora.read.archive import open_zip
from bench.corpora.read.channels import CHANNEL, channel_columns
from bench.corpora.read.limits import (
    SYNTHETIC,
    check_column_names,
    check_columns,
    check_condition_count,
    check_file,
    checked_values,
    file_name,
    source_info,
)
from bench.corpora.read.rows import (
    CsvTable,
    Table,
    categories_as_text,
    table_from_pandas,
    table_from_parquet,
)
from bench.errors import InputError, one_line, shorten
from bench.ground.scratch import write_then_rename

LABELS = ["subject", "gesture", "frame"]
CAPTURE_COLUMNS = ["capture", "subject", "gesture"]  # a change begins a capture
BROKEN = "not a .npz file of plain arrays ({}); save it again, without objects"


def read(path: Path, rate_hz: float, grid: str = "", full_scale: float = 1023.0) -> Corpus:
    """Read captures of any grid, rate and length.

    A CSV or parquet file has one row per frame: ``subject``, ``gesture``, ``frame`` (from 0 or 1,
    up by one within a capture), any columns of conditions, and last the channels in row-major
    order. Channels that are numbered, such as ch1, ch2, ..., are read in the order of their
    numbers. A ``.npz`` file has ``frames`` [total, rows, cols], ``offsets`` [captures + 1],
    ``subject`` and ``gesture`` [captures], and any other arrays of that length as conditions. A
    column ``synthetic`` (true or false, 1 or 0) marks generated captures; it becomes a condition
    only if captures differ in it.

    Args:
        path: the file.
        rate_hz: frames per second.
        grid: ``ROWSxCOLS``; a ``.npz`` file contains its own.
        full_scale: largest value that the sensor gives.

    Raises:
        InputError: the file does not fit; the message names the line, or the array.
    """
    path = Path(path)
    check_scales(rate_hz, full_scale)
    size = parse_grid(grid) if grid else None
    corpus, warnings = _read_file(path, size, rate_hz, full_scale, LABELS)
    return describe_source(corpus, path, warnings, "table")


def write_table(corpus: Corpus, path: Path) -> None:
    """Write captures as a table that `read` accepts: parquet if the name ends so, else CSV."""
    captures = corpus.captures.assign(**{SYNTHETIC: "true"} if corpus.synthetic else {})
    table = captures.loc[captures.index.repeat(corpus.lengths)].reset_index(drop=True)
    table["frame"] = np.concatenate([np.arange(length) for length in corpus.lengths])
    frames = np.concatenate([*corpus]).reshape(len(table), -1)
    names = [f"{CHANNEL}{number}" for number in range(1, frames.shape[1] + 1)]
    table = pd.concat([table, pd.DataFrame(frames, columns=names)], axis=1)
    write = table.to_parquet if path.suffix == ".parquet" else table.to_csv
    try:
        with write_then_rename(path) as beside:
            write(beside, index=False)
    except OSError as e:
        raise InputError(
            f"{one_line(path, 160)} cannot be written ({e.strerror or e}); choose another place"
        ) from e


def check_scales(rate_hz: float, full_scale: float) -> None:
    """Refuse a rate or a full scale that cannot be."""
    if not (0 < rate_hz < np.inf):
        raise InputError(f"rate_hz={rate_hz:g}: give a number above 0")
    least, most = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
    if not least <= full_scale <= most:
        raise InputError(f"full_scale={full_scale:g}: give a number from {least:.2g} to {most:.2g}")


def parse_grid(grid: str) -> tuple[int, int]:
    """Rows and columns of ``8x8``."""
    if not (match := re.fullmatch(r"([1-9][0-9]{0,6})x([1-9][0-9]{0,6})", grid)):
        raise InputError(f"grid={one_line(grid)}: give rows and columns, such as grid=8x8")
    return int(match[1]), int(match[2])


def describe_source(corpus: Corpus, path: Path, warnings: list[str], name: str) -> Corpus:
    """The captures of a file with labels as text, their name and ``info``.

    A column ``synthetic`` that is the same for all captures becomes part of the ``info``.

    Raises:
        InputError: a column has a name that results need, or ``synthetic`` is neither true nor
            false.
    """
    captures = corpus.captures
    if reserved := reserved_names(captures):
        raise InputError(
            f"{file_name(path)}: a condition cannot be called {shorten(reserved[0])}, "
            "which predictions need; rename it"
        )
    captures = captures.astype(str)  # as a CSV file has it, whatever the file
    marks = pd.Series("false", captures.index)
    if SYNTHETIC in captures:
        marks = captures[SYNTHETIC].str.lower().replace({"1": "true", "0": "false"})
        if len(wrong := np.flatnonzero(~marks.isin(["true", "false"]))):
            mark = one_line(captures[SYNTHETIC].iloc[wrong[0]], 40)
            raise InputError(
                f"{file_name(path)}: {SYNTHETIC} is {mark} in capture {wrong[0] + 1}; "
                "give true for generated captures, else false"
            )
        if marks.nunique() == 1:
            del captures[SYNTHETIC]
    info = source_info(path, "", "the user's own", warnings, bool((marks == "true").any()))
    return corpus.with_fields(captures=captures, name=name, info=info)


def read_unlabelled(path: Path, rate_hz: float, grid: tuple[int, int], full_scale: float) -> Corpus:
    """Read captures to predict: as `read`, but ``subject`` and ``gesture`` may be missing.

    The column ``capture`` is that of the file, or numbers from 1.
    """
    corpus, _ = _read_file(Path(path), grid, rate_hz, full_scale, ["frame"])
    return _as_unlabelled(corpus)


def corpus_from_table(
    table: pd.DataFrame,
    channels: list[str],
    rate_hz: float,
    grid: tuple[int, int],
    full_scale: float,
    label: str,
) -> Corpus:
    """Captures of a table with one row per frame: ``capture``, ``frame`` or both, and channels.

    Without ``frame``, rows of the same ``capture`` follow one another as frames. The column
    ``capture`` of the corpus is that of the table, or numbers from 1.

    Args:
        table: the table.
        channels: columns of the channels, row by row.
        rate_hz: frames per second.
        grid: rows and columns of the sensor.
        full_scale: largest value that the sensor gives.
        label: name of the table in messages.

    Raises:
        InputError: a column is missing, or a value does not fit.
    """
    names = [name for name in ("capture", "frame") if name in table]
    if not names:
        raise InputError(
            f"{label}: no column capture or frame; add one, so that captures can be separated"
        )
    columns = [str(column) for column in table]
    channel_columns(columns, grid, label)  # refuses missing and extra channels
    check_columns(columns, channels, label)
    if "frame" not in table:
        capture = (table["capture"] != table["capture"].shift()).cumsum()
        table = table.assign(frame=table.groupby(capture).cumcount())
        names.append("frame")
    rows = table_from_pandas(table[[*names, *channels]], label).read_rows(channels, full_scale)
    return _as_unlabelled(_as_captures(rows, grid, rate_hz, full_scale))


def _as_unlabelled(corpus: Corpus) -> Corpus:
    """Captures with the columns capture, subject and gesture, as text."""
    captures = corpus.captures
    if "capture" not in captures:
        captures = captures.assign(capture=np.arange(1, len(corpus) + 1))
    kept = [name for name in ("capture", "subject", "gesture") if name in captures]
    return corpus.with_fields(captures=captures[kept].astype(str), name="unlabelled")


def _read_file(
    path: Path, size: tuple[int, int] | None, rate_hz: float, full_scale: float, required: list[str]
) -> tuple[Corpus, list[str]]:
    """Captures of a file, which must have the required columns, and warnings."""
    check_file(path)
    if path.suffix.lower() == ".npz":
        required = [name for name in required if name != "frame"]
        return _read_arrays(path, size, rate_hz, full_scale, required), []
    if size is None:
        raise InputError(f"{file_name(path)}: give the grid of the sensor, such as grid=8x8")
    rows, warnings = read_table_rows(path, size, full_scale, required, [*LABELS, *required])
    corpus = _as_captures(rows, size, rate_hz, full_scale)
    return corpus, [*warnings, *rows.notes]


def read_table_rows(
    path: Path,
    size: tuple[int, int],
    full_scale: float,
    required: list[str],
    labels: list[str],
    optional: str = "",
) -> tuple[Table, list[str]]:
    """Rows of a CSV or parquet file with one frame each, and warnings.

    Args:
        path: the file.
        size: rows and columns of the sensor.
        full_scale: largest value that the sensor gives.
        required: columns that the file must have.
        labels: columns that are never channels.
        optional: column in which cells may be empty.
    """
    is_parquet = path.suffix.lower() == ".parquet"
    table: Table = table_from_parquet(path) if is_parquet else CsvTable(path, file_name(path))
    check_columns(table.columns, required, table.header_prefix)
    channels = channel_columns(table.columns, size, table.header_prefix)
    too_few = len(table.columns) < len(channels) + len(required)
    if too_few or {*labels} & set(channels):
        raise InputError(
            f"{table.header_prefix}: {len(table.columns)} columns cannot hold "
            f"{', '.join(required)} and then {len(channels)} channels; "
            "check grid= and put the channels last"
        )
    warnings, names = [], set(channels)
    if [column for column in table.columns if column in names] != channels:
        warnings.append(
            f"channels are read in the order of their numbers, {channels[0]} to {channels[-1]}"
        )
    return table.read_rows(channels, full_scale, optional), warnings


def _as_captures(rows: Table, size: tuple[int, int], rate_hz: float, full_scale: float) -> Corpus:
    """Rows as captures, which begin where the frame number starts again."""
    rows.check_filled()
    frame = rows.take_frame_numbers()
    rows.check_constant([*rows.labels.columns.difference(CAPTURE_COLUMNS, sort=False)], frame)
    if (origin := int(frame[0])) not in (0, 1):
        rows.refuse_row(
            0, f"a capture starts at frame {origin} instead of 0 or 1; restore its frames"
        )
    frame = rows.unwrap_frame_numbers([*rows.labels], frame, origin)
    captures, starts, lengths = rows.split_captures([*rows.labels], frame, origin)
    return Corpus(rows.values.reshape(-1, *size), starts, lengths, captures, rate_hz, full_scale)


def _read_arrays(
    path: Path, size: tuple[int, int] | None, rate_hz: float, full_scale: float, required: list[str]
) -> Corpus:
    """Captures of a ``.npz`` file."""
    name, arrays = file_name(path), _load_arrays(path)
    if missing := [key for key in ("frames", "offsets", *required) if key not in arrays]:
        raise InputError(f"{name}: no array {', '.join(missing)}; save it with np.savez")
    frames, offsets = arrays.pop("frames"), arrays.pop("offsets")
    if frames.ndim != 3 or 0 in frames.shape or frames.dtype.kind not in "iuf":
        raise InputError(
            f"{name}: frames has shape {one_line(frames.shape)} and type "
            f"{one_line(frames.dtype, 40)}; save numbers [total, rows, cols]"
        )
    if size is not None and frames.shape[1:] != size:
        rows, cols = frames.shape[1:]
        raise InputError(f"{name}: frames are {rows}x{cols}, grid= says {size[0]}x{size[1]}")
    is_whole = offsets.ndim == 1 and len(offsets) > 1 and offsets.dtype.kind in "iu"
    ends = is_whole and offsets[0] == 0 and offsets[-1] == len(frames)
    if not (ends and (offsets[1:] > offsets[:-1]).all()):  # differences may wrap
        raise InputError(
            f"{name}: offsets must rise from 0 to {len(frames)}, one more of them than captures"
        )
    count = len(offsets) - 1
    check_condition_count(len(arrays), name)
    for key, array in arrays.items():
        kinds = "USiu" if key in LABELS else "USiufb"
        if array.shape != (count,) or array.dtype.kind not in kinds:
            raise InputError(
                f"{name}: {shorten(key)} has shape {one_line(array.shape)} and type "
                f"{one_line(array.dtype, 40)}; save a text or number for each of {count} captures"
            )
    columns = {  # NumPy's own conversion ends a text at its first zero
        key: array.tolist() if array.dtype.kind in "US" else array for key, array in arrays.items()
    }
    captures = table_from_pandas(pd.DataFrame(columns), name, "capture").label_columns()
    values = checked_values(frames, full_scale, name, "frame")
    starts, lengths = offsets[:-1].astype(np.int64), np.diff(offsets.astype(np.int64))
    return Corpus(values, starts, lengths, categories_as_text(captures), rate_hz, full_scale)


def _load_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of a ``.npz`` file by name, in the byte order of this machine."""
    with open_zip(path, BROKEN) as (_, members), np.load(path, allow_pickle=False) as file:
        names = [member.filename.removesuffix(".npy") for member in members]
        check_column_names(names, file_name(path))
        arrays = {name: file[name] for name in names}
        return {name: a.astype(a.dtype.newbyteorder("="), copy=False) for name, a in arrays.items()}
