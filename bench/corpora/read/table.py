"""Captures of any sensor: a long CSV or parquet file, or arrays in a ``.npz`` file."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, reserved_names
from bench.corpora.read.archive import open_zip
from bench.corpora.read.limits import (
    SYNTHETIC,
    check_column_names,
    check_columns,
    check_condition_count,
    check_file,
    checked_values,
    file_name,
    first_names,
    one_line,
    shorten,
    source_info,
)
from bench.corpora.read.rows import CsvTable, PandasTable, ParquetTable, Table, categories_as_text
from bench.errors import InputError
from bench.ground.scratch import write_then_rename

LABELS = ["subject", "gesture", "frame"]
OURS = "ch"  # what saved systems call their channels: ch1, ch2, ...
_BROKEN = "not a .npz file of plain arrays ({}); save it again, without objects"


def read(path: Path, rate_hz: float, grid: str = "", full_scale: float = 1023.0) -> Corpus:
    """Read captures of any grid, rate and length.

    A CSV or parquet file has one row per frame: ``subject``, ``gesture``, ``frame`` (from 0 or 1, up by one within a
    capture), any columns of conditions, and last the channels in row-major order. Channels that are numbered, such as
    ch1, ch2, ..., are read in the order of their numbers. A ``.npz`` file has ``frames`` [total, rows, cols],
    ``offsets`` [captures + 1], ``subject`` and ``gesture`` [captures], and any other arrays of that length as
    conditions. A column ``synthetic`` (true or false, 1 or 0) marks generated captures; it becomes a condition only
    where captures differ in it.

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
    corpus, warned = _file(path, size, rate_hz, full_scale, LABELS)
    return describe_source(corpus, path, warned, "table")


def write_table(corpus: Corpus, path: Path) -> None:
    """Write captures as the table that `read` takes: CSV, or parquet where the name ends so."""
    captures = corpus.captures.assign(**{SYNTHETIC: "true"} if corpus.synthetic else {})
    table = captures.loc[captures.index.repeat(corpus.lengths)].reset_index(drop=True)
    table["frame"] = np.concatenate([np.arange(length) for length in corpus.lengths])
    frames = np.concatenate([*corpus]).reshape(len(table), -1)
    channels = pd.DataFrame(frames, columns=[f"ch{i}" for i in range(1, frames.shape[1] + 1)])
    table = pd.concat([table, channels], axis=1)
    try:
        with write_then_rename(path) as beside:
            table.to_parquet(beside, index=False) if path.suffix == ".parquet" else table.to_csv(
                beside, index=False
            )
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
        raise InputError(
            f"full_scale={full_scale:g}: frames hold numbers from {least:.2g} to {most:.2g}; scale yours"
        )


def parse_grid(grid: str) -> tuple[int, int]:
    """Rows and columns of ``8x8``."""
    if not (match := re.fullmatch(r"([1-9][0-9]{0,6})x([1-9][0-9]{0,6})", grid)):
        raise InputError(f"grid={one_line(grid)}: give rows and columns, such as grid=8x8")
    return int(match[1]), int(match[2])


def describe_source(corpus: Corpus, path: Path, warned: list[str], name: str) -> Corpus:
    """The captures of a file with name, source, licence and warnings, and whether any is marked as generated.

    A mark that is the same for all captures is taken out of the columns.
    """
    captures = corpus.captures
    if taken := reserved_names(captures):
        name = shorten(taken[0])
        raise InputError(
            f"{file_name(path)}: a condition cannot be called {name}, which predictions need; rename it"
        )
    for label in ("subject", "gesture"):
        captures[label] = captures[label].astype(str)
    synthetic = False
    if SYNTHETIC in captures:
        marks = captures[SYNTHETIC].astype(str).str.lower().replace({"1": "true", "0": "false"})
        if len(wrong := np.flatnonzero(~marks.isin(["true", "false"]))):
            mark = one_line(captures[SYNTHETIC].iloc[wrong[0]], 40)
            raise InputError(
                f"{file_name(path)}: {SYNTHETIC} is {mark} in capture {wrong[0] + 1}; give true for generated captures, "
                "else false"
            )
        synthetic = bool((marks == "true").any())
        if marks.nunique() == 1:
            del captures[SYNTHETIC]
    info = source_info(path, "", "the user's own", warned, synthetic)
    return corpus.with_fields(captures=captures, name=name, info=info)


def read_unlabelled(path: Path, rate_hz: float, grid: tuple[int, int], full_scale: float) -> Corpus:
    """Captures that are to be labelled: as `read`, but ``subject`` and ``gesture`` may be missing.

    A column ``capture`` is that of the file, or numbers from 1.
    """
    return _unlabelled(_file(Path(path), grid, rate_hz, full_scale, ["frame"])[0])


def corpus_from_table(
    table: pd.DataFrame,
    channels: list[str],
    rate_hz: float,
    grid: tuple[int, int],
    full_scale: float,
    label: str,
) -> Corpus:
    """Captures of a table with one row per frame: columns ``capture``, ``frame`` or both, and the channels.

    Without ``frame`` rows of the same ``capture`` follow one another as frames. The column ``capture`` of the corpus is
    that of the table, or numbers from 1.
    """
    names = [n for n in ("capture", "frame") if n in table]
    if not names:
        raise InputError(
            f"{label}: no column capture or frame; add one, so that captures can be separated"
        )
    channel_columns(
        [str(column) for column in table], grid, label
    )  # refuses channels that are missing or extra
    check_columns([str(column) for column in table], channels, label)
    if "frame" not in table:
        run = (table["capture"] != table["capture"].shift()).cumsum()
        table = table.assign(frame=table.groupby(run).cumcount())
    names = [*names, *({"frame"} - set(names)), *channels]
    return _unlabelled(
        _cut(
            PandasTable(table[names], label).read_rows(channels, full_scale),
            grid,
            rate_hz,
            full_scale,
        )
    )


def _unlabelled(corpus: Corpus) -> Corpus:
    captures = corpus.captures
    names = captures["capture"] if "capture" in captures else np.arange(1, len(corpus) + 1)
    kept = pd.DataFrame({"capture": np.asarray(names).astype(str)})
    for name in ("subject", "gesture"):
        if name in captures:
            kept[name] = captures[name].astype(str).to_numpy()
    return corpus.with_fields(captures=kept, name="unlabelled")


def _file(
    path: Path, size: tuple[int, int] | None, rate_hz: float, full_scale: float, required: list[str]
) -> tuple[Corpus, list[str]]:
    """Captures of a file, which must have the required columns, and warnings."""
    check_file(path)
    if path.suffix.lower() == ".npz":
        return _arrays(
            path, size, rate_hz, full_scale, [name for name in required if name != "frame"]
        ), []
    if size is None:
        raise InputError(f"{file_name(path)}: give the grid of the sensor, such as grid=8x8")
    rows, warned = read_table_rows(path, size, full_scale, required, [*LABELS, *required])
    return _cut(rows, size, rate_hz, full_scale), warned


def read_table_rows(
    path: Path,
    size: tuple[int, int],
    full_scale: float,
    required: list[str],
    known: list[str],
    blank: str = "",
) -> tuple[Table, list[str]]:
    """Rows of a CSV or parquet file with one frame each, and warnings.

    Columns of labels that the file must have are ``required``; those that are ``known`` are never channels; cells of
    the column ``blank`` may be empty.
    """
    table: Table = (
        ParquetTable(path) if path.suffix.lower() == ".parquet" else CsvTable(path, file_name(path))
    )
    check_columns(table.columns, required, table.header_prefix)
    channels = channel_columns(table.columns, size, table.header_prefix)
    if len(table.columns) < len(channels) + len(required) or {*known} & set(channels):
        raise InputError(
            f"{table.header_prefix}: {len(table.columns)} columns cannot hold {', '.join(required)} and then {len(channels)} "
            "channels; check grid= and put the channels last"
        )
    chosen = set(channels)
    moved = [column for column in table.columns if column in chosen] != channels
    warned = (
        [f"channels are read in the order of their numbers, {channels[0]} to {channels[-1]}"]
        if moved
        else []
    )
    return table.read_rows(channels, full_scale, blank), warned


def _cut(rows: Table, size: tuple[int, int], rate_hz: float, full_scale: float) -> Corpus:
    """Rows as captures, which begin where the frame number starts again."""
    rows.check_filled()
    frame = rows.take_frame_numbers()
    if (origin := int(frame[0])) not in (0, 1):
        rows.refuse_row(
            0, f"a capture starts at frame {origin} instead of 0 or 1; restore its frames"
        )
    captures, starts, lengths = rows.split_captures([*rows.labels], frame, origin)
    return Corpus(rows.values.reshape(-1, *size), starts, lengths, captures, rate_hz, full_scale)


def channel_columns(columns: list[str], grid: tuple[int, int], where: str) -> list[str]:
    """The columns of the channels, row by row.

    Channels whose names differ in one number at the end (ch1, ch2, ... or cell0, cell1, ...) are taken in the order of
    that number, if most of the last columns are such. The numbers begin with 0 or 1 and have no gap. Channels with
    other names are the last columns, in file order.
    """
    count = grid[0] * grid[1]
    named = {
        name: match
        for name in columns
        if (match := re.fullmatch(r"(.*?)([0-9]{1,9})", name, re.DOTALL))
    }
    last = Counter(named[name][1] for name in columns[-count:] if name in named)
    stem, most = (last.most_common(1) or [("", 0)])[0]
    if any(match[1] == OURS for match in named.values()):
        stem = OURS
    elif 2 * most <= count or count == 1:
        return columns[-count:]
    numbers = {name: int(match[2]) for name, match in named.items() if match[1] == stem}
    first = 0 if 0 in numbers.values() else 1
    by_number = {n: name for name, n in reversed(numbers.items()) if first <= n < first + count}
    extra = [name for name, n in numbers.items() if by_number.get(n) != name]
    missing = [
        f"{stem}{number}" for number in range(first, first + count) if number not in by_number
    ]
    wrong = [
        f"{what}: {first_names(names)}"
        for what, names in (("missing", missing), ("extra", extra))
        if names
    ]
    if wrong:
        raise InputError(
            f"{where}: a grid of {grid[0]}x{grid[1]} has {count} channels, {shorten(stem)}{first} to "
            f"{shorten(stem)}{first + count - 1}; {', '.join(wrong)}; correct the columns or the grid"
        )
    return [by_number[number] for number in sorted(by_number)]


def _arrays(
    path: Path, size: tuple[int, int] | None, rate_hz: float, full_scale: float, required: list[str]
) -> Corpus:
    """Captures of a ``.npz`` file."""
    name, arrays = file_name(path), _members(path)
    if missing := [n for n in ("frames", "offsets", *required) if n not in arrays]:
        raise InputError(f"{name}: no array {', '.join(missing)}; save it with np.savez")
    frames, offsets = arrays.pop("frames"), arrays.pop("offsets")
    if frames.ndim != 3 or 0 in frames.shape or frames.dtype.kind not in "iuf":
        raise InputError(
            f"{name}: frames has shape {one_line(frames.shape)} and type {one_line(frames.dtype, 40)}; save numbers [total, "
            "rows, cols]"
        )
    if size is not None and frames.shape[1:] != size:
        raise InputError(
            f"{name}: frames are {frames.shape[1]}x{frames.shape[2]}, grid= says {size[0]}x{size[1]}"
        )
    whole = offsets.ndim == 1 and len(offsets) > 1 and offsets.dtype.kind in "iu"
    # Each is compared with the next, as differences may wrap.
    if not (
        whole
        and offsets[0] == 0
        and offsets[-1] == len(frames)
        and (offsets[1:] > offsets[:-1]).all()
    ):
        raise InputError(
            f"{name}: offsets must rise from 0 to {len(frames)}, one more of them than captures"
        )
    if wrong := [n for n, a in arrays.items() if a.shape != (len(offsets) - 1,)]:
        shape = one_line(arrays[wrong[0]].shape)
        raise InputError(
            f"{name}: {shorten(wrong[0])} has shape {shape}, captures are {len(offsets) - 1}"
        )
    check_condition_count(len(arrays), name)
    captures = categories_as_text(_conditions(arrays, name))
    values, starts = checked_values(frames, full_scale, name, "frame"), offsets.astype(np.int64)
    return Corpus(values, starts[:-1], np.diff(starts), captures, rate_hz, full_scale)


def _members(path: Path) -> dict[str, np.ndarray]:
    """All arrays of a ``.npz`` file by name, in the byte order of this machine."""
    arrays = {}
    with open_zip(path, _BROKEN) as (archive, members), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about headers that Python 2 wrote
        for member in members:
            if not member.filename.endswith(".npy"):
                name = one_line(member.filename, 60)
                raise InputError(
                    f"{file_name(path)}: {name} is not an array; save the file with np.savez"
                )
        check_column_names(
            [member.filename.removesuffix(".npy") for member in members], file_name(path)
        )
        for member in members:
            with archive.open(member) as file:
                array = np.lib.format.read_array(file, allow_pickle=False)
                if file.read(1) or not array.dtype.itemsize:
                    raise ValueError(
                        f"{one_line(member.filename, 40)} is not of the size that its header says"
                    )
            arrays[member.filename.removesuffix(".npy")] = array.astype(
                array.dtype.newbyteorder("="), copy=False
            )
    return arrays


def _conditions(arrays: dict[str, np.ndarray], name: str) -> pd.DataFrame:
    """Labels and numbers of the captures."""
    columns: dict[str, object] = {}
    for column, array in arrays.items():
        allowed, wanted = (
            ("USiu", "text or whole numbers") if column in LABELS else ("USiufb", "text or numbers")
        )
        text = array.dtype.kind in "US"
        if array.dtype.kind not in allowed or (array.dtype.itemsize > 8 and not text):
            raise InputError(
                f"{name}: {shorten(column)} is of type {one_line(array.dtype, 40)}; save it as {wanted}"
            )
        truth = array.dtype.kind == "b"  # a byte that is neither 0 nor 1 is no truth value
        # NumPy's own conversion ends a text at its first zero.
        columns[column] = array.tolist() if text else array.view(np.uint8) != 0 if truth else array
    return PandasTable(pd.DataFrame(columns), name, "capture").label_columns()
