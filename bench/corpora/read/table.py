"""Captures of any sensor: a long CSV or parquet file, or arrays in a ``.npz`` file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from bench.corpora.corpus import Corpus, reserved
from bench.corpora.read.channel_columns import channels_of
from bench.corpora.read.csv_text import FrameFile
from bench.corpora.read.frame_rows import capture_starts, check_types, labels_and_values, words_of
from bench.corpora.read.limits import SYNTHETIC, called, check_columns, check_conditions, check_file, plain, short
from bench.corpora.read.npz import read_arrays
from bench.corpora.read.parquet import ParquetFile
from bench.corpora.read.sensor_values import checked
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
        grid: ``ROWSxCOLS``; a ``.npz`` file contains its own.
        full_scale: largest value that the sensor gives.

    Returns:
        uint16 frames when all values are whole numbers up to 65535, else float32, which holds whole numbers up to
        16777216; larger ones that it would change are refused. A CSV file's numbers are first read as float64.

    Raises:
        InputError: the file does not fit; the message names the line, or the array.
    """
    path = Path(path)
    check_scales(rate_hz, full_scale)
    size = size_of(grid) if grid else None
    corpus, warnings = _file(path, size, rate_hz, full_scale, LABELS)
    return described(corpus, path, warnings, "table")


def check_scales(rate_hz: float, full_scale: float) -> None:
    """Refuse a rate or a full scale that cannot be.

    Raises:
        InputError: one is out of range.
    """
    if not (0 < rate_hz < np.inf):
        raise InputError(f"rate_hz={rate_hz:g}: give a number above 0")
    least, most = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
    if not least <= full_scale <= most:
        raise InputError(f"full_scale={full_scale:g}: frames hold numbers from {least:.2g} to {most:.2g}; scale yours")


def described(corpus: Corpus, path: Path, warnings: list[str], name: str) -> Corpus:
    """A corpus with its source, licence and warnings, and whether it is synthetic.

    Args:
        corpus: the captures of the file.
        path: the file.
        warnings: warnings of the reader.
        name: name of the corpus.

    Raises:
        InputError: a condition has a reserved name, or a mark ``synthetic`` is neither true nor false.
    """
    captures = corpus.captures
    if taken := reserved(captures):
        name = short(taken[0])
        raise InputError(f"{called(path)}: a condition cannot be called {name}, which predictions need; rename it")
    for label in ("subject", "gesture"):
        captures[label] = captures[label].astype(str)
    synthetic = _synthetic(captures, called(path))
    info = {"source": plain(path.name, 200), "licence": "the user's own", "synthetic": synthetic, "warnings": warnings}
    return corpus.changed(captures=captures, name=name, info=info)


def _synthetic(captures: pd.DataFrame, name: str) -> bool:
    """Whether any capture is marked as generated; a mark that is the same for all is taken out of the columns."""
    if SYNTHETIC not in captures:
        return False
    marks = captures[SYNTHETIC].astype(str).str.lower().replace({"1": "true", "0": "false"})
    if len(wrong := np.flatnonzero(~marks.isin(["true", "false"]))):
        mark = plain(captures[SYNTHETIC].iloc[wrong[0]], 40)
        raise InputError(
            f"{name}: {SYNTHETIC} is {mark} in capture {wrong[0] + 1}; give true for generated captures, else false"
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
    return _unlabelled(_file(Path(path), grid, rate_hz, full_scale, ["frame"])[0])


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
        raise InputError(f"{label}: no column capture or frame; add one, so that captures can be separated")
    channels_of([str(column) for column in table], grid, label)  # refuses channels that are missing or extra
    check_columns([str(column) for column in table], channels, label)
    if "frame" not in table:
        run = (table["capture"] != table["capture"].shift()).cumsum()
        table = table.assign(frame=table.groupby(run).cumcount())
    names = [*names, *({"frame"} - set(names)), *channels]
    try:
        rows = pa.Table.from_pandas(table[names], preserve_index=False).combine_chunks()
    except (pa.ArrowException, TypeError, ValueError) as e:
        raise InputError(f"{label}: a column holds mixed or unknown values ({plain(e)}); correct it") from e
    check_types(rows.schema, names, {*channels, "frame"}, label)
    batches = rows.to_batches() if len(rows) else []
    labels, values = labels_and_values(batches, names, channels, full_scale, f"{label}, row", first=1)
    return _unlabelled(_cut(labels, values, grid, rate_hz, full_scale, f"{label}, row", 1))


def _unlabelled(corpus: Corpus) -> Corpus:
    captures = corpus.captures
    names = captures["capture"] if "capture" in captures else np.arange(1, len(corpus) + 1)
    kept = pd.DataFrame({"capture": np.asarray(names).astype(str)})
    for name in ("subject", "gesture"):
        if name in captures:
            kept[name] = captures[name].astype(str).to_numpy()
    return corpus.changed(captures=kept, name="unlabelled")


def _file(
    path: Path, size: tuple[int, int] | None, rate_hz: float, full_scale: float, required: list[str]
) -> tuple[Corpus, list[str]]:
    """Captures of a file, which must have the required columns, and warnings."""
    check_file(path)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return _arrays(path, size, rate_hz, full_scale, [name for name in required if name != "frame"]), []
    if size is None:
        raise InputError(f"{called(path)}: give the grid of the sensor, such as grid=8x8")
    labels, values, where, first, warnings = rows_of(path, size, full_scale, required, [*LABELS, *required])
    return _cut(labels, values, size, rate_hz, full_scale, where, first), warnings


def rows_of(
    path: Path, size: tuple[int, int], full_scale: float, required: list[str], known: list[str], blank: str = ""
) -> tuple[pd.DataFrame, np.ndarray, str, int, list[str]]:
    """Rows of a CSV or parquet file with one frame each.

    Args:
        path: the file.
        size: (rows, cols) of the sensor.
        full_scale: largest value that the sensor gives.
        required: columns of labels that the file must have.
        known: columns that are labels and never channels.
        blank: column of text whose cells may be empty.

    Returns:
        Labels [rows]; values [rows, channels]; the file and the word for a row in messages; the number of the first
        row; warnings.

    Raises:
        InputError: a column or a value that does not fit.
    """
    file = ParquetFile(path) if path.suffix.lower() == ".parquet" else FrameFile(path, called(path))
    check_columns(file.columns, required, file.header)
    channels = channels_of(file.columns, size, file.header)
    if len(file.columns) < len(channels) + len(required) or {*known} & set(channels):
        raise InputError(
            f"{file.header}: {len(file.columns)} columns cannot hold {', '.join(required)} and then {len(channels)} "
            "channels; check grid= and put the channels last"
        )
    if isinstance(file, ParquetFile):
        where, first = f"{called(path)}, row", 1
        labels, values = file.read(channels, full_scale, blank)
    else:
        where, first = f"{called(path)}, line", 2
        counts = [name for name in file.columns if name == "frame"]
        labels, values = file.read(counts, channels, full_scale, True, blank)
    chosen = set(channels)
    moved = [column for column in file.columns if column in chosen] != channels
    warnings = [f"channels are read in the order of their numbers, {channels[0]} to {channels[-1]}"] if moved else []
    return labels, values, where, first, warnings


def size_of(grid: str) -> tuple[int, int]:
    """Rows and columns of ``8x8``.

    Raises:
        InputError: it is not of that form.
    """
    if not (match := re.fullmatch(r"([1-9][0-9]{0,6})x([1-9][0-9]{0,6})", grid)):
        raise InputError(f"grid={plain(grid)}: give rows and columns, such as grid=8x8")
    return int(match[1]), int(match[2])


def _cut(
    labels: pd.DataFrame,
    values: np.ndarray,
    size: tuple[int, int],
    rate_hz: float,
    full_scale: float,
    where: str,
    first: int,
) -> Corpus:
    """Rows as captures, which begin where the frame number starts again; ``where`` and ``first`` name the first row."""
    check_filled(labels, where, first)
    frame = frame_numbers(labels.pop("frame").to_numpy(), where, first)
    if (origin := int(frame[0])) not in (0, 1):
        raise InputError(f"{where} {first}: a capture starts at frame {origin} instead of 0 or 1; restore its frames")
    starts = capture_starts(labels, frame, origin, where, first)
    captures = without_categories(labels.iloc[starts].reset_index(drop=True))
    lengths = np.diff(starts, append=len(frame))
    return Corpus(values.reshape(-1, *size), starts, lengths, captures, rate_hz, full_scale)


def check_filled(labels: pd.DataFrame, where: str, first: int) -> None:
    """Refuse labels that are missing.

    Raises:
        InputError: the first one; ``where`` and ``first`` name its row.
    """
    if labels.isna().any(axis=None):
        row, column = np.argwhere(labels.isna().to_numpy())[0]
        raise InputError(f"{where} {first + row}: {short(str(labels.columns[column]))} is empty; fill the cell")


def frame_numbers(numbers: np.ndarray, where: str, first: int) -> np.ndarray:
    """The column ``frame`` as int64 [rows].

    Raises:
        InputError: one is not a whole number; ``where`` and ``first`` name its row.
    """
    if len(wrong := np.flatnonzero(~(np.abs(numbers.astype(float)) < 2**53) | (numbers != np.round(numbers)))):
        raise InputError(f"{where} {first + wrong[0]}: frame is {numbers[wrong[0]]}, not a whole number; correct it")
    return numbers.astype(np.int64)


def without_categories(captures: pd.DataFrame) -> pd.DataFrame:
    """Text instead of the categories that come from the readers: plain columns are what a query wants."""
    for column in captures:
        if isinstance(captures[column].dtype, pd.CategoricalDtype):
            captures[column] = captures[column].cat.categories.astype(str).take(captures[column].cat.codes)
    return captures


def _arrays(path: Path, size: tuple[int, int] | None, rate_hz: float, full_scale: float, required: list[str]) -> Corpus:
    name = called(path)
    arrays = read_arrays(path)
    if missing := [n for n in ("frames", "offsets", *required) if n not in arrays]:
        raise InputError(f"{name}: no array {', '.join(missing)}; save it with np.savez")
    frames, offsets = arrays.pop("frames"), arrays.pop("offsets")
    if frames.ndim != 3 or 0 in frames.shape or frames.dtype.kind not in "iuf":
        raise InputError(
            f"{name}: frames has shape {plain(frames.shape)} and type {plain(frames.dtype, 40)}; save numbers [total, "
            "rows, cols]"
        )
    if size is not None and frames.shape[1:] != size:
        raise InputError(f"{name}: frames are {frames.shape[1]}x{frames.shape[2]}, grid= says {size[0]}x{size[1]}")
    if offsets.ndim != 1 or len(offsets) < 2 or offsets.dtype.kind not in "iu" or not _rise(offsets, len(frames)):
        raise InputError(f"{name}: offsets must rise from 0 to {len(frames)}, one more of them than captures")
    if wrong := [n for n, a in arrays.items() if a.shape != (len(offsets) - 1,)]:
        shape = plain(arrays[wrong[0]].shape)
        raise InputError(f"{name}: {short(wrong[0])} has shape {shape}, captures are {len(offsets) - 1}")
    check_conditions(len(arrays), name)
    captures = without_categories(pd.DataFrame({n: _condition(array, n, name) for n, array in arrays.items()}))
    values, starts = checked(frames, full_scale, name, "frame"), offsets.astype(np.int64)
    return Corpus(values, starts[:-1], np.diff(starts), captures, rate_hz, full_scale)


def _rise(offsets: np.ndarray, total: int) -> bool:
    """Whether offsets rise from 0 to the number of all frames, each compared with the next, as differences may wrap."""
    return offsets[0] == 0 and offsets[-1] == total and bool((offsets[1:] > offsets[:-1]).all())


def _condition(array: np.ndarray, column: str, name: str) -> np.ndarray | pd.Categorical:
    """Labels or numbers of the captures in types that tables can hold."""
    kinds, wanted = ("USiu", "text or whole numbers") if column in LABELS else ("USiufb", "text or numbers")
    if array.dtype.kind not in kinds:
        raise InputError(f"{name}: {short(column)} is of type {plain(array.dtype, 40)}; save it as {wanted}")
    if array.dtype.kind in "US":
        try:
            words = pa.array(array.tolist())  # not NumPy's own conversion, which ends a text at its first zero
        except (ValueError, SystemError) as e:  # numbers of no character
            raise InputError(f"{name}: {short(column)} is not text; save it again") from e
        return words_of(words, column, f"{name}, capture")
    if array.dtype.kind == "b":
        return array.view(np.uint8) != 0  # a byte that is neither 0 nor 1 is no truth value
    if array.dtype.itemsize > 8:  # long doubles
        double = array.astype(np.float64)
        if not np.array_equal(double, array, equal_nan=True):
            raise InputError(f"{name}: {short(column)} holds numbers that float64 cannot hold; round them")
        return double
    return array
