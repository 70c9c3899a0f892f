"""Columns of text that arrive in parts, each word kept once."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow as pa

from bench.corpora.limits import flaw, plain
from bench.errors import InputError


class Words:
    """A column of labels.

    Attributes:
        known: the words, in the order in which they were met.
    """

    def __init__(self) -> None:
        self.known: dict[str, int] = {}
        self._codes: list[np.ndarray] = []

    def add(self, words: list[str], codes: np.ndarray) -> None:
        """Append rows.

        Args:
            words: of these rows; a word may stand twice.
            codes: position of each row's word.
        """
        places = np.array([self.known.setdefault(word, len(self.known)) for word in words], np.int32)
        self._codes.append(places[codes])

    def column(self) -> pd.Categorical:
        """All rows."""
        return pd.Categorical.from_codes(np.concatenate(self._codes), list(self.known))


def words_of(column: pa.Array, name: str, where: str, row: int = 0) -> tuple[list[str], np.ndarray]:
    """The words of some rows without spaces around them, and the code of each row.

    Args:
        column: text, or bytes that should be text, perhaps as a dictionary.
        name: of the column.
        where: what messages call the file and a row: ``my.parquet, row``.
        row: number of the first row in the file, from 0.

    Raises:
        InputError: a label that cannot be; the message names its row.
    """
    coded = column if pa.types.is_dictionary(column.type) else column.dictionary_encode()
    if coded.null_count:
        empty = int(np.flatnonzero(coded.is_null().to_numpy(zero_copy_only=False))[0])
        raise InputError(f"{where} {row + empty + 1}: {plain(name, 60)} is empty; fill it")
    used, codes = np.unique(coded.indices.to_numpy(), return_inverse=True)
    words = []
    for i, content in enumerate(coded.dictionary.take(pa.array(used)).cast(pa.large_binary()).to_pylist()):
        try:
            word = (content or b"").decode().strip()
            wrong = flaw(word)
        except UnicodeDecodeError:
            wrong = "is not text in UTF-8; save it as text"
        if wrong:
            raise InputError(f"{where} {row + int(np.flatnonzero(codes == i)[0]) + 1}: {plain(name, 60)} {wrong}")
        words.append(word)
    return words, codes
