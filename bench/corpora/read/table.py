"""Captures of any sensor: a long CSV or parquet file, or arrays in a ``.npz`` file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from bench.corpora.corpus import RESERVED, Corpus
from bench.corpora.read.channel_columns import channels_of
from bench.corpora.read.csv_text import FrameFile, capture_starts
from bench.corpora.read.frame_rows import words_of
from bench.corpora.read.limits import SYNTHETIC, called, check_conditions, plain, short
from bench.corpora.read.npz import read_arrays
from bench.corpora.read.parquet import ParquetFile
from bench.corpora.read.sensor_values import check, checked, smallest
from bench.errors import InputError

LABELS = ["subject", "gesture", "frame"]


def read(path: Path, rate_hz: float, grid: str = "", full_scale: float = 1023.0) -> Corpus:
    """Read captures of any grid, rate and length.

    A CSV or parquet file has one row per frame: ``subject``, ``gesture``, ``frame`` (from 0 or 1, up by one within a
    capture), any columns of conditions, and last the channels in row-major order. Channels that are numbered, such as
    ch1, ch2, ..., are read in the order of their numbers (see `channels_of`). A ``.npz`` file has ``frames``
    [total, rows, cols], ``offsets`` [captures + 1], ``subject`` and ``gesture`` [captures], and any other arrays of
    that length as conditions. Spaces around labels are no part of them; no label is empty, longer than 200 characters
    or holds characters that cannot be seen. Numbers are decimal, such as 7, 0.25 or 1e3.

    A column ``synthetic`` (true or false, 1 or 0) marks generated captures: a corpus with any is said to be synthetic.
    It becomes a condition only where captures differ in it.

    Args:
        path: the file.
        rate_hz: frames per second.
        grid: ``ROWSxCOLS``; a ``.npz`` file knows its own.
        full_scale: largest value that the sensor gives.

    Returns:
        uint16 frames when all values are whole numbers up to 65535, else float32, which holds whole numbers up to
        16777216; larger ones that it would change are refused. A CSV file's numbers are first read as float64.

    Raises:
        InputError: the file does not fit; the message names the line, or the array.
    """
    path = Path(path)
    if not (0 < rate_hz < np.inf and 0 < full_scale < np.inf):
        raise InputError(f"rate_hz={rate_hz:g} full_scale={full_scale:g}: give numbers above 0")
    least, most = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
    if not least <= full_scale <= most:
        raise InputError(f"full_scale={full_scale:g}: frames hold numbers from {least:.2g} to {most:.2g}; scale yours")
    size = _size(grid) if grid else None
    if size is None and path.suffix.lower() != ".npz" and path.is_file():
        raise InputError(f"{called(path)}: give the grid of the sensor, such as grid=8x8")
    frames, starts, lengths, captures, warnings = _file(path, size, full_scale, LABELS)
    if taken := [n for n in captures if n in RESERVED or n.startswith("p_")]:
        name = short(taken[0])
        raise InputError(f"{called(path)}: a condition cannot be called {name}, which predictions need; rename it")
    for label in ("subject", "gesture"):
        if captures[label].dtype != "str":
            captures[label] = captures[label].astype(str)
    made = _generated(captures, called(path))
    info = {"source": plain(path.name, 200), "licence": "the user's own", "synthetic": made, "warnings": warnings}
    return Corpus(frames, starts, lengths, captures, float(rate_hz), float(full_scale), "table", info=info)


def _generated(captures: pd.DataFrame, name: str) -> bool:
    """Whether any capture is marked as generated; a mark that is the same for all is taken out of the columns."""
    if SYNTHETIC not in captures:
        return False
    marks = captures[SYNTHETIC].astype(str).str.lower().replace({"1": "true", "0": "false"})
    if len(wrong := np.flatnonzero(~marks.isin(["true", "false"]))):
        given = plain(captures[SYNTHETIC].iloc[wrong[0]], 40)
        raise InputError(
            f"{name}: {SYNTHETIC} is {given} in capture {wrong[0] + 1}; give true for generated captures, else false"
        )
    if marks.nunique() == 1:
        del captures[SYNTHETIC]
    return bool((marks == "true").any())


def read_unlabelled(path: Path, rate_hz: float, grid: tuple[int, int], full_scale: float) -> Corpus:
    """Captures that are to be labelled: as `read`, but ``subject`` and ``gesture`` may be missing.

    Returns:
        A corpus with a column ``capture``: that of the file, or numbers from 1; and ``subject`` and ``gesture`` where
        the file has them.

    Raises:
        InputError: the file does not fit; the message names the line, or the array.
    """
    *parts, _ = _file(Path(path), grid, full_scale, ["frame"])
    return _unlabelled(*parts, rate_hz, full_scale)


def from_frame(
    table: pd.DataFrame, channels: list[str], rate_hz: float, grid: tuple[int, int], full_scale: float, label: str
) -> Corpus:
    """Captures of a table with one row per frame: columns ``capture``, ``frame`` or both, and the channels.

    Without ``frame`` rows of the same ``capture`` follow one another as frames.

    Returns:
        A corpus with a column ``capture``: that of the table, or numbers from 1.

    Raises:
        InputError: a column or a value that does not fit; the message calls the table ``label``.
    """
    names = [n for n in ("capture", "frame") if n in table]
    if not names:
        raise InputError(f"{label}: no column capture or frame; add one, so that captures can be told apart")
    if not len(table):
        raise InputError(f"{label}: there are no frames in it")
    channels_of([str(column) for column in table], grid, label)  # refuses channels that are missing or extra
    if missing := [name for name in channels if name not in table]:
        raise InputError(f"{label}: no column {missing[0]}; channels are {channels[0]} to {channels[-1]}, row by row")
    if "frame" not in table:
        run = (table["capture"] != table["capture"].shift()).cumsum()
        table = table.assign(frame=table.groupby(run).cumcount())
    table = table[[*names, *({"frame"} - set(names)), *channels]]
    labels, values = _of_table(table, len(channels), full_scale, label)
    return _unlabelled(*_cut(labels, values, grid, label, "row"), rate_hz, full_scale)


def _unlabelled(
    frames: np.ndarray,
    starts: np.ndarray,
    lengths: np.ndarray,
    captures: pd.DataFrame,
    rate_hz: float,
    full_scale: float,
) -> Corpus:
    names = captures["capture"] if "capture" in captures else np.arange(1, len(starts) + 1)
    about = pd.DataFrame({"capture": np.asarray(names).astype(str)})
    for name in ("subject", "gesture"):
        if name in captures:
            about[name] = captures[name].astype(str).to_numpy()
    return Corpus(frames, starts, lengths, about, rate_hz, full_scale, "unlabelled")


def _file(
    path: Path, size: tuple[int, int] | None, full_scale: float, required: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, pd.DataFrame, list[str]]:
    """Frames, starts, lengths and columns of the captures of a file, which must have the required columns; warnings."""
    if not path.is_file():
        what = "a folder" if path.is_dir() else "not a plain file" if path.exists() else "there is no such file"
        raise InputError(f"{plain(path, 160)}: {what}; give the path of a file")
    if path.suffix.lower() == ".npz":
        return *_arrays(path, size, full_scale, required), []
    name = called(path)
    parquet = path.suffix.lower() == ".parquet"
    file = ParquetFile(path) if parquet else FrameFile(path, name)
    file.require(required)
    where = name if parquet else f"{name}, line 1"
    channels = channels_of(file.columns, size, where)
    _check_layout(file.columns, channels, where, required)
    if isinstance(file, ParquetFile):
        labels, values = file.read(channels, full_scale)
        labels = _with_frames(labels, name)
    else:
        labels, values = file.read(["frame"], channels, full_scale, fractions=True)
    chosen = set(channels)
    moved = [column for column in file.columns if column in chosen] != channels
    warnings = [f"channels are read in the order of their numbers, {channels[0]} to {channels[-1]}"] if moved else []
    return *_cut(labels, values, size, name, "row" if parquet else "line"), warnings


def _size(grid: str) -> tuple[int, int]:
    if not (match := re.fullmatch(r"([1-9][0-9]{0,6})x([1-9][0-9]{0,6})", grid)):
        raise InputError(f"grid={plain(grid)}: give rows and columns, such as grid=8x8")
    return int(match[1]), int(match[2])


def _cut(
    labels: pd.DataFrame, values: np.ndarray, size: tuple[int, int], name: str, unit: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, pd.DataFrame]:
    """Rows as captures, which begin where the frame number starts again."""
    frame = labels.pop("frame").to_numpy()
    if (origin := int(frame[0])) not in (0, 1):
        first = "line 2" if unit == "line" else "row 1"
        raise InputError(f"{name}, {first}: a capture starts at frame {origin} instead of 0 or 1; restore its frames")
    starts = capture_starts(labels, frame, origin, name, unit)
    captures = _plain(labels.iloc[starts].reset_index(drop=True))
    return values.reshape(-1, *size), starts, np.diff(starts, append=len(frame)), captures


def _plain(captures: pd.DataFrame) -> pd.DataFrame:
    """Text instead of the categories that come from the readers: plain columns are what a query wants."""
    for column in captures:
        if isinstance(captures[column].dtype, pd.CategoricalDtype):
            captures[column] = captures[column].cat.categories.astype(str).take(captures[column].cat.codes)
    return captures


def _check_layout(columns: list[str], channels: list[str], where: str, required: list[str]) -> None:
    if len(columns) < len(channels) + len(required) or {*LABELS, *required} & set(channels):
        raise InputError(
            f"{where}: {len(columns)} columns cannot hold {', '.join(required)} and then {len(channels)} channels; "
            "check grid= and put the channels last"
        )


def _with_frames(labels: pd.DataFrame, name: str) -> pd.DataFrame:
    """Labels without gaps, and with whole numbers for frames."""
    if labels.isna().any(axis=None):
        row, column = np.argwhere(labels.isna().to_numpy())[0]
        raise InputError(f"{name}, row {row + 1}: {short(str(labels.columns[column]))} is empty; fill the cell")
    frame = labels["frame"].to_numpy(dtype=np.float64)
    if len(wrong := np.flatnonzero(~(np.abs(frame) < 2**53) | (frame != np.round(frame)))):
        raise InputError(f"{name}, row {wrong[0] + 1}: frame is {frame[wrong[0]]}, not a whole number; correct it")
    return labels.assign(frame=frame.astype(np.int64))


def _of_table(table: pd.DataFrame, channels: int, full_scale: float, name: str) -> tuple[pd.DataFrame, np.ndarray]:
    """Labels and values of a table with the channels last."""
    labels = table.iloc[:, :-channels]
    if taken := [n for n in labels if not pd.api.types.is_scalar(labels[n].iloc[0])]:
        raise InputError(f"{name}: {taken[0]} holds lists or arrays; give one value per frame")
    columns = []
    for i, (column, series) in enumerate(table.items()):
        if column != "frame" and i < labels.shape[1]:
            continue
        kind = pd.api.types
        if not kind.is_numeric_dtype(series) or kind.is_bool_dtype(series) or kind.is_complex_dtype(series):
            raise InputError(f"{name}: {plain(column, 60)} is not a column of numbers; correct the column")
        if i >= labels.shape[1]:
            values = (
                series.to_numpy() if isinstance(series.dtype, np.dtype) else series.to_numpy(float, na_value=np.nan)
            )
            check(values[:, None], full_scale, f"{name}, row", 1, [str(column)])
            columns.append(values)
    block = np.stack(columns, axis=1)
    return _with_frames(labels, name), block.astype(smallest(block))


def _arrays(
    path: Path, size: tuple[int, int] | None, full_scale: float, required: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, pd.DataFrame]:
    name = called(path)
    arrays = read_arrays(path)
    if missing := [n for n in ("frames", "offsets", *(r for r in required if r != "frame")) if n not in arrays]:
        raise InputError(f"{name}: no array {', '.join(missing)}; save it with np.savez")
    frames, offsets = arrays.pop("frames"), arrays.pop("offsets")
    if frames.ndim != 3 or 0 in frames.shape:
        raise InputError(f"{name}: frames has shape {plain(frames.shape)} instead of [total, rows, cols]")
    if size is not None and frames.shape[1:] != size:
        raise InputError(f"{name}: frames are {frames.shape[1]}x{frames.shape[2]}, grid= says {size[0]}x{size[1]}")
    whole = offsets.ndim == 1 and len(offsets) > 1 and offsets.dtype.kind in "iu"
    if whole:
        within = ((offsets >= 0) & (offsets <= len(frames))).all()  # else differences could wrap
        offsets = offsets.astype(np.int64)
        whole = within and offsets[0] == 0 and offsets[-1] == len(frames) and (np.diff(offsets) > 0).all()
    if not whole:
        raise InputError(f"{name}: offsets must rise from 0 to {len(frames)}, one more of them than captures")
    if wrong := [n for n, a in arrays.items() if a.shape != (len(offsets) - 1,)]:
        shape = plain(arrays[wrong[0]].shape)
        raise InputError(f"{name}: {short(wrong[0])} has shape {shape}, captures are {len(offsets) - 1}")
    check_conditions(len(arrays), name)
    about = _plain(pd.DataFrame({n: _condition(array, n, name) for n, array in arrays.items()}))
    if frames.dtype.kind not in "iuf":
        raise InputError(f"{name}: frames are of type {plain(frames.dtype, 40)}; save them as numbers")
    values = checked(frames, full_scale, name, "frame")
    return values, offsets[:-1], np.diff(offsets), about


def _condition(array: np.ndarray, column: str, name: str) -> np.ndarray | pd.Categorical:
    """Labels or numbers of the captures in types that tables can hold."""
    kinds, wanted = ("USiu", "text or whole numbers") if column in LABELS else ("USiufb", "text or numbers")
    if array.dtype.kind not in kinds:
        raise InputError(f"{name}: {short(column)} is of type {plain(array.dtype, 40)}; save it as {wanted}")
    if array.dtype.kind in "US":
        return _words(array, column, name)
    if array.dtype.kind == "b":
        return array.view(np.uint8) != 0  # a byte that is neither 0 nor 1 is no truth value
    if array.dtype.itemsize > 8:  # long doubles
        double = array.astype(np.float64)
        changed = np.flatnonzero((double != array) & ~np.isnan(array))
        if len(changed):
            where = f"{name}, capture {changed[0] + 1}"
            raise InputError(f"{where}: {short(column)} is {array[changed[0]]}, which float64 cannot hold; round it")
        return double
    return array


def _words(array: np.ndarray, column: str, name: str) -> pd.Categorical:
    width, most = (np.uint32, 0x10FFFF) if array.dtype.kind == "U" else (np.uint8, 255)
    codes = np.ascontiguousarray(array).view(width).reshape(len(array), -1)
    ended = (codes[:, :-1] == 0) & (codes[:, 1:] != 0)  # NumPy ends a text where only zeros follow, others at the first
    strange = (codes > most) | ((codes >= 0xD800) & (codes < 0xE000))  # numbers of no character
    if len(wrong := np.flatnonzero(ended.any(axis=1) | strange.any(axis=1))):
        raise InputError(f"{name}, capture {wrong[0] + 1}: {short(column)} is not text; save it again")
    return words_of(pa.array(array), column, f"{name}, capture")
