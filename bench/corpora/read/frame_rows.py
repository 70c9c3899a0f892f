"""Rows of a table with one frame each, which come in batches: labels, and sensor values that are checked."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.types as kinds

from bench.corpora.read.limits import flaw, plain
from bench.corpora.read.sensor_values import check, smallest
from bench.errors import InputError

_TEXT = (kinds.is_string, kinds.is_large_string, kinds.is_binary, kinds.is_large_binary, kinds.is_fixed_size_binary)


class Rows:
    """Labels and sensor values of the rows so far.

    Args:
        where: what messages call the file and a row: ``my.csv, line``.
        first: number of the first row in the file.
        channels: columns of sensor values, in their order; all others are labels.
        full_scale: largest sensor value allowed.
    """

    def __init__(self, where: str, first: int, channels: list[str], full_scale: float) -> None:
        self.where, self.channels, self.full_scale = where, channels, full_scale
        self._next = first
        self._labels: dict[str, list[pd.Categorical | pa.Array]] = {}
        self._values: list[np.ndarray] = []

    def add(self, names: list[str], batch: pa.RecordBatch) -> None:
        """Append rows.

        Args:
            names: of the columns.
            batch: the columns; of text each word once (a dictionary).

        Raises:
            InputError: a label or a value that does not fit; the message names its row.
        """
        columns = dict(zip(names, batch.columns, strict=True))
        sensors = [columns.pop(name).to_numpy(zero_copy_only=False) for name in self.channels]  # a gap becomes NaN
        for name, column in zip(self.channels, sensors, strict=True):
            check(column[:, None], self.full_scale, self.where, self._next, [name])
        values = np.stack(sensors, axis=1)
        for name, column in columns.items():
            labels = words_of(column, name, self.where, self._next) if is_text(column.type) else column
            self._labels.setdefault(name, []).append(labels)
        self._values.append(values.astype(smallest(values)))
        self._next += len(batch)

    def result(self) -> tuple[pd.DataFrame, np.ndarray]:
        """Labels [rows] in file order, text as categories, and values [rows, channels] in the smallest type.

        Raises:
            InputError: there are no rows.
        """
        if not self._values:
            raise InputError(f"{self.where.partition(',')[0]}: there are no frames in it; give one row per frame")
        labels = {}
        for name, parts in self._labels.items():
            text = isinstance(parts[0], pd.Categorical)
            labels[name] = (
                pd.api.types.union_categoricals(parts) if text else pa.chunked_array(parts).to_pandas().to_numpy()
            )
        return pd.DataFrame(labels), np.concatenate(self._values)


def is_text(kind: pa.DataType) -> bool:
    """Whether a column holds text, or bytes that should be text."""
    kind = kind.value_type if kinds.is_dictionary(kind) else kind
    return any(test(kind) for test in _TEXT)


def words_of(column: pa.Array, name: str, where: str, first: int = 1) -> pd.Categorical:
    """Labels without spaces around them.

    Args:
        column: text, or bytes that should be text, perhaps as a dictionary.
        name: of the column.
        where: what messages call the file and a row: ``my.parquet, row``.
        first: number of the first row in the file.

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
            wrong = flaw(word)
        except UnicodeDecodeError:
            wrong = "is not text in UTF-8; save it as text"
        if wrong:
            raise InputError(f"{where} {first + int(np.argmax(codes == i))}: {plain(name, 60)} {wrong}")
        words.append(word)
    merged, categories = pd.factorize(np.array(words, dtype=object))
    return pd.Categorical.from_codes(merged[codes], categories)
