"""Captures of any sensor: a long CSV or parquet file, or arrays in a ``.npz`` file."""

from __future__ import annotations

import re
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.corpus import RESERVED, Corpus
from bench.corpora.text import FrameFile, capture_starts
from bench.errors import InputError

LABELS = ["subject", "gesture", "frame"]


def read(path: Path, rate_hz: float, grid: str = "", full_scale: float = 1023.0) -> Corpus:
    """Read captures of any grid, rate and length.

    A CSV or parquet file has one row per frame: ``subject``, ``gesture``, ``frame`` (from 0 or 1, up by one within a
    capture), any columns of conditions, and last the channels in row-major order. A ``.npz`` file has ``frames``
    [total, rows, cols], ``offsets`` [captures + 1], ``subject`` and ``gesture`` [captures], and any other arrays of
    that length as conditions.

    Args:
        path: the file.
        rate_hz: frames per second.
        grid: ``ROWSxCOLS``; a ``.npz`` file knows its own.
        full_scale: largest value that the sensor gives.

    Returns:
        uint16 frames when all values are whole numbers up to 65535, else float32.

    Raises:
        InputError: the file does not fit; the message names the line, or the array.
    """
    path = Path(path)
    if not (0 < rate_hz < np.inf and 0 < full_scale < np.inf):
        raise InputError(f"rate_hz={rate_hz:g} full_scale={full_scale:g}: give numbers above 0")
    size = _size(grid) if grid else None
    if size is None and path.suffix != ".npz" and path.is_file():
        raise InputError(f"{path.name}: give the grid of the sensor, such as grid=8x8")
    frames, starts, lengths, captures = _file(path, size, full_scale, LABELS)
    if taken := [n for n in captures if n in RESERVED or n.startswith("p_")]:
        raise InputError(f"{path.name}: a condition cannot be called {taken[0]}, which predictions need; rename it")
    captures["subject"] = captures["subject"].astype(str)
    captures["gesture"] = captures["gesture"].astype(str)
    info = {"source": path.name, "licence": "the user's own", "synthetic": False, "warnings": []}
    return Corpus(frames, starts, lengths, captures, float(rate_hz), float(full_scale), "table", info=info)


def read_unlabelled(path: Path, rate_hz: float, grid: tuple[int, int], full_scale: float) -> Corpus:
    """Captures that are to be labelled: as `read`, but ``subject`` and ``gesture`` may be missing.

    Returns:
        A corpus with a column ``capture``: that of the file, or numbers from 1.

    Raises:
        InputError: the file does not fit; the message names the line, or the array.
    """
    return _unlabelled(*_file(Path(path), grid, full_scale, ["frame"]), rate_hz, full_scale)


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
    if "frame" not in table:
        run = (table["capture"] != table["capture"].shift()).cumsum()
        table = table.assign(frame=table.groupby(run).cumcount())
    table = table[[*names, *({"frame"} - set(names)), *channels]]
    labels, values = _of_table(table, len(channels), full_scale, label)
    return _unlabelled(*_cut(labels, values, grid, label), rate_hz, full_scale)


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
    return Corpus(frames, starts, lengths, about, rate_hz, full_scale, "unlabelled")


def _file(
    path: Path, size: tuple[int, int] | None, full_scale: float, required: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, pd.DataFrame]:
    """Frames, starts, lengths and columns of the captures of a file, which must have the required columns."""
    if not path.is_file():
        raise InputError(f"{path}: {'a folder' if path.is_dir() else 'there is no such file'}; give the path of a file")
    if path.suffix == ".npz":
        return _arrays(path, size, full_scale, required)
    return _rows(path, size, full_scale, required)


def _size(grid: str) -> tuple[int, int]:
    if not (match := re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", grid)):
        raise InputError(f"grid={grid}: give rows and columns, such as grid=8x8")
    return int(match[1]), int(match[2])


def _rows(
    path: Path, size: tuple[int, int], full_scale: float, required: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, pd.DataFrame]:
    channels = size[0] * size[1]
    if path.suffix == ".parquet":
        labels, values = _parquet(path, channels, full_scale, required)
    else:
        file = FrameFile(path, path.name)
        file.require(required)
        _check_layout(file.columns, channels, path.name, required)
        labels, values = file.read(["frame"], file.columns[-channels:], full_scale, fractions=True)
    return _cut(labels, values, size, path.name)


def _cut(
    labels: pd.DataFrame, values: np.ndarray, size: tuple[int, int], name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, pd.DataFrame]:
    """Rows as captures, which begin where the frame number starts again."""
    frame = labels.pop("frame").to_numpy()
    if (origin := int(frame[0])) not in (0, 1):
        raise InputError(f"{name}, line 2: a capture starts at frame {origin} instead of 0 or 1; restore its frames")
    starts = capture_starts(labels, frame, origin, name)
    captures = labels.iloc[starts].reset_index(drop=True)
    for column in captures:  # categories come from the reader, plain columns are what a query wants
        if isinstance(captures[column].dtype, pd.CategoricalDtype):
            captures[column] = captures[column].astype(str).str.strip()
    return values.reshape(-1, *size), starts, np.diff(starts, append=len(frame)), captures


def _check_layout(columns: list[str], channels: int, name: str, required: list[str]) -> None:
    if len(columns) < channels + len(required) or {*LABELS, *required} & set(columns[-channels:]):
        raise InputError(
            f"{name}, line 1: {len(columns)} columns cannot hold {', '.join(required)} and then {channels} channels; "
            "check grid= and put the channels last"
        )


def _parquet(path: Path, channels: int, full_scale: float, required: list[str]) -> tuple[pd.DataFrame, np.ndarray]:
    try:
        table = pd.read_parquet(path)
    except (OSError, ValueError) as e:
        raise InputError(f"{path.name}: not a readable parquet file ({e}); save it again") from e
    table.columns = [str(name).strip() for name in table.columns]
    if len(twice := table.columns[table.columns.duplicated()]):
        raise InputError(f"{path.name}: column {twice[0]!r} stands twice; rename one")
    if missing := [n for n in required if n not in table]:
        raise InputError(f"{path.name}: no column {', '.join(missing)}; add it")
    _check_layout(list(table.columns), channels, path.name, required)
    if not len(table):
        raise InputError(f"{path.name}: there are no frames in it")
    return _of_table(table, channels, full_scale, path.name)


def _of_table(table: pd.DataFrame, channels: int, full_scale: float, name: str) -> tuple[pd.DataFrame, np.ndarray]:
    """Labels and values of a table with the channels last."""
    labels, values = table.iloc[:, :-channels].copy(), table.iloc[:, -channels:]
    if labels.isna().any(axis=None):
        row, column = np.argwhere(labels.isna().to_numpy())[0]
        raise InputError(f"{name}, row {row + 1}: {labels.columns[column]} is empty; fill the cell")
    if taken := [n for n in labels if not pd.api.types.is_scalar(labels[n].iloc[0])]:
        raise InputError(f"{name}: {taken[0]} holds lists or arrays; give one value per frame")
    if words := [n for n in ["frame", *values] if not pd.api.types.is_numeric_dtype(table[n])]:
        raise InputError(f"{name}: {words[0]} is not a column of numbers; correct the column")
    frame = labels["frame"].to_numpy(dtype=np.float64)
    if len(wrong := np.flatnonzero(frame != np.round(frame))):
        raise InputError(f"{name}, row {wrong[0] + 1}: frame is {frame[wrong[0]]}, not a whole number; correct it")
    labels["frame"] = frame.astype(np.int64)
    values = values.to_numpy(dtype=np.float64)
    return labels, checked(values, full_scale, name, "row")


def _arrays(
    path: Path, size: tuple[int, int] | None, full_scale: float, required: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, pd.DataFrame]:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, TypeError, RuntimeError, zipfile.BadZipFile, zlib.error, EOFError) as e:
        # TypeError: a single array, as np.save writes it; RuntimeError: an encrypted member
        raise InputError(f"{path.name}: not a .npz file of plain arrays ({e}); save it without objects") from e
    if other := [n for n, a in arrays.items() if not isinstance(a, np.ndarray)]:
        raise InputError(f"{path.name}: {other[0]} is not an array; save the file with np.savez")
    if missing := [n for n in ("frames", "offsets", *(r for r in required if r != "frame")) if n not in arrays]:
        raise InputError(f"{path.name}: no array {', '.join(missing)}; save it with np.savez")
    frames, offsets = arrays.pop("frames"), arrays.pop("offsets")
    if frames.ndim != 3 or 0 in frames.shape:
        raise InputError(f"{path.name}: frames has shape {frames.shape} instead of [total, rows, cols]")
    if size is not None and frames.shape[1:] != size:
        raise InputError(f"{path.name}: frames are {frames.shape[1]}x{frames.shape[2]}, grid= says {size[0]}x{size[1]}")
    whole = offsets.ndim == 1 and len(offsets) > 1 and np.issubdtype(offsets.dtype, np.integer)
    offsets = offsets.astype(np.int64) if whole else offsets  # unsigned differences would wrap
    if not whole or offsets[0] != 0 or offsets[-1] != len(frames) or (np.diff(offsets) < 1).any():
        raise InputError(f"{path.name}: offsets must rise from 0 to {len(frames)}, one more of them than captures")
    if wrong := [n for n, a in arrays.items() if a.shape != (len(offsets) - 1,)]:
        raise InputError(f"{path.name}: {wrong[0]} has shape {arrays[wrong[0]].shape}, captures are {len(offsets) - 1}")
    for name, array in arrays.items():
        kinds, wanted = ("USiu", "text or whole numbers") if name in LABELS else ("USiufb", "text or numbers")
        if array.dtype.kind not in kinds:
            raise InputError(f"{path.name}: {name} is of type {array.dtype}; save it as {wanted}")
        if array.dtype.kind in "US" and (array == array.dtype.type()).any():
            empty = np.flatnonzero(array == array.dtype.type())[0]
            raise InputError(f"{path.name}, capture {empty + 1}: {name} is empty; fill it")
        if array.dtype.kind == "S":
            try:
                arrays[name] = np.char.decode(array, "utf-8")
            except UnicodeDecodeError as e:
                raise InputError(f"{path.name}: {name} is not text in UTF-8; save it as text") from e
    if frames.dtype.kind not in "iuf":
        raise InputError(f"{path.name}: frames are of type {frames.dtype}; save them as numbers")
    values = checked(frames.reshape(len(frames), -1), full_scale, path.name, "frame").reshape(frames.shape)
    return values, offsets[:-1], np.diff(offsets), pd.DataFrame(arrays)


def checked(values: np.ndarray, full_scale: float, name: str, unit: str) -> np.ndarray:
    """Values as they are stored, or an `InputError` for the first one that is not within 0..full_scale."""
    good = (values >= 0) & (values <= full_scale)
    if not good.all():
        row, column = np.argwhere(~good)[0]
        raise InputError(
            f"{name}, {unit} {row + 1}: channel {column + 1} is {values[row, column]}, not within 0 and the full scale "
            f"{full_scale:g}; correct it or give full_scale="
        )
    whole = np.issubdtype(values.dtype, np.integer) or (values == np.round(values)).all()
    return values.astype(np.uint16 if whole and float(values.max()) <= 65535 else np.float32)
