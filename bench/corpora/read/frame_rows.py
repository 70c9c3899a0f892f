"""Rows of a table with one frame each, which come in batches: labels, and sensor values that are checked."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.types as kinds

from bench.corpora.read.limits import flaw, plain
from bench.corpora.read.sensor_values import check, smallest
from bench.errors import InputError

_TEXT = (kinds.is_string, kinds.is_large_string, kinds.is_binary, kinds.is_large_binary, kinds.is_fixed_size_binary)


def labels_and_values(
    batches: Iterable[pa.RecordBatch],
    names: list[str],
    channels: list[str],
    full_scale: float,
    where: str,
    first: int,
    blank: str = "",
) -> tuple[pd.DataFrame, np.ndarray]:
    """Labels and sensor values of every row.

    Args:
        batches: rows; of text each word once (a dictionary).
        names: names of the columns.
        channels: columns of sensor values, in their order; all others are labels.
        full_scale: largest sensor value allowed.
        where: the file and the word for a row in messages: ``my.csv, line``.
        first: number of the first row in the file.
        blank: column of text whose cells may be empty.

    Returns:
        Labels [rows] in file order, text as categories, and values [rows, channels], uint16 when every value is a whole
        number up to 65535, else float32.

    Raises:
        InputError: there are no rows, or a label or a value does not fit; the message names its row.
    """
    labels: dict[str, list[pd.Categorical | pa.Array]] = {}
    blocks = []
    for batch in batches:
        columns = dict(zip(names, batch.columns, strict=True))
        sensors = [columns.pop(name).to_numpy(zero_copy_only=False) for name in channels]  # a gap becomes NaN
        for name, column in zip(channels, sensors, strict=True):
            check(column[:, None], full_scale, where, first, [name])
        block = np.stack(sensors, axis=1)
        blocks.append(block.astype(smallest(block)))
        for name, column in columns.items():
            part = words_of(column, name, where, first, name == blank) if is_text(column.type) else column
            labels.setdefault(name, []).append(part)
        first += len(batch)
    if not blocks:
        raise InputError(f"{where.partition(',')[0]}: there are no frames in it; give one row per frame")
    table = {name: _joined(parts) for name, parts in labels.items()}
    return pd.DataFrame(table), np.concatenate(blocks)


def _joined(parts: list) -> pd.Categorical | np.ndarray | pd.api.extensions.ExtensionArray:
    """A column of labels from those of its batches; whole numbers stay whole where some are missing."""
    if isinstance(parts[0], pd.Categorical):
        return pd.api.types.union_categoricals(parts)
    column = pa.chunked_array(parts)
    if kinds.is_integer(column.type) and column.null_count:
        whole = pd.UInt64Dtype() if kinds.is_unsigned_integer(column.type) else pd.Int64Dtype()
        return column.to_pandas(types_mapper={column.type: whole}.get).array
    return column.to_pandas().to_numpy()


def is_text(kind: pa.DataType) -> bool:
    """Return True if a column holds text, or bytes that should be text."""
    kind = kind.value_type if kinds.is_dictionary(kind) else kind
    return any(test(kind) for test in _TEXT)


def check_types(schema: pa.Schema, names: list[str], numbers: set[str], label: str) -> None:
    """Refuse columns that are neither text nor numbers.

    Args:
        schema: schema of the columns.
        names: names of the columns in messages.
        numbers: columns that must hold numbers.
        label: name of the table in messages.

    Raises:
        InputError: such a column.
    """
    for name, field in zip(names, schema, strict=True):
        number, kind = name in numbers, field.type
        if kinds.is_dictionary(kind) and not number:
            kind = kind.value_type
        if number and not (kinds.is_integer(kind) or kinds.is_floating(kind)):
            raise InputError(f"{label}: {plain(name, 60)} is not a column of numbers; correct it")
        if not (is_text(kind) or kinds.is_primitive(kind) or kinds.is_decimal(kind)):
            raise InputError(f"{label}: {plain(name, 60)} holds {plain(kind, 40)}; give one text or number per frame")


def words_of(column: pa.Array, name: str, where: str, first: int = 1, blank: bool = False) -> pd.Categorical:
    """Labels without spaces around them.

    Args:
        column: text, or bytes that should be text, perhaps as a dictionary.
        name: name of the column.
        where: the file and the word for a row in messages: ``my.parquet, row``.
        first: number of the first row in the file.
        blank: True if cells may be empty.

    Raises:
        InputError: a label that cannot be; the message names its row.
    """
    coded = column if kinds.is_dictionary(column.type) else column.dictionary_encode()
    count = len(coded.dictionary)
    indices = coded.indices.cast(pa.int64()).fill_null(count).to_numpy()
    used = np.flatnonzero(np.bincount(indices))  # words of other rows are not looked at
    codes = np.searchsorted(used, indices)
    words = []
    contents = coded.dictionary.take(pa.array(used, mask=used == count)).cast(pa.large_binary())
    for i, content in enumerate(contents.to_pylist()):
        try:
            word = (content or b"").decode().strip()
            wrong = "" if blank and not word else flaw(word)
        except UnicodeDecodeError:
            wrong = "is not text in UTF-8; save it as text"
        if wrong:
            raise InputError(f"{where} {first + int(np.argmax(codes == i))}: {plain(name, 60)} {wrong}")
        words.append(word)
    merged, categories = pd.factorize(np.array(words, dtype=object))
    return pd.Categorical.from_codes(merged[codes], categories)


def capture_starts(labels: pd.DataFrame, frame: np.ndarray, origin: int, where: str, first: int) -> np.ndarray:
    """Rows at which captures begin: where the frame number is ``origin``; elsewhere it must go up by one.

    Args:
        labels: columns that stay the same within a capture.
        frame: frame number of each row.
        origin: frame number of the first frame of a capture.
        where: the file and the word for a row in messages: ``my.csv, line``.
        first: number of the first row in the file.

    Raises:
        InputError: a capture that starts at another frame, a duplicate or a missing frame.
    """
    changed = np.zeros(len(frame), dtype=bool)
    changed[0] = True
    for name in labels:
        codes = pd.factorize(labels[name])[0]
        changed[1:] |= codes[1:] != codes[:-1]
    starts = frame == origin
    wrong = np.flatnonzero(~starts & (changed | (np.diff(frame, prepend=origin - 1) != 1)))
    if len(wrong):
        row = wrong[0]
        if changed[row]:
            reason = f"a capture starts at frame {frame[row]} instead of {origin}; restore its first frames"
        else:
            reason = f"frame {frame[row]} follows frame {frame[row - 1]}; restore the frames or renumber them"
        raise InputError(f"{where} {first + row}: {reason}")
    return np.flatnonzero(starts)
