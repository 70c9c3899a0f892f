"""Columns of text that arrive in parts, each word kept once."""

from __future__ import annotations

import numpy as np
import pandas as pd


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
