"""The corpus: ragged captures of a pressure grid, sliced without copying frames. A value: it knows no disk.

Everything that features, models and protocols may know of the harness is on this page.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np
import pandas as pd

from bench.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COPY = 1 << 40  # of a piece: times the number of the copy, and below that its first frame
RESERVED = frozenset({"fold", "capture", "start", "frames", "true", "predicted"})  # columns that predictions need


@dataclass(frozen=True, eq=False)
class Corpus:
    """Captures of touch on one sensor grid.

    A slice shares ``frames`` with the corpus it was cut from: a capture is addressed by its start and length, so
    captures of a slice need not lie next to each other. Indexing with an integer gives the frames of one capture,
    indexing with an array, a mask or a slice gives a `Corpus`; with ``len`` and ``shape`` that is what scikit-learn
    needs to use a corpus as ``X``.

    Attributes:
        frames: uint16 or float32 [total_frames, rows, cols], sensor values 0..full_scale; row 0 is the top.
        starts: int64 [captures], first frame of each capture in ``frames``.
        lengths: int64 [captures], number of frames of each capture, at least 1.
        captures: one row per capture: ``subject``, ``gesture`` (str) and any conditions (variant, cover, split, ...).
        rate_hz: frames per second.
        full_scale: the largest value that the sensor can give.
        name: the name under which the corpus was imported.
        digest: content hash of the whole corpus, ``""`` for one that was never stored.
        index: int64 [captures], position of each capture in the whole corpus.
        info: source, licence, synthetic (bool), warnings (list of str).
        path: the folder that the frames are mapped from, or None when they are in memory.
        target: the columns of ``captures`` that make up the class, joined by ``+``.
        steps: what was done to the captures since they were stored (`bench.corpora.steps`), in order. Several captures
            may then come from one stored capture and have its ``index``.
        piece: int64 [captures], tells those of one ``index`` apart; 0 before any step.
    """

    frames: np.ndarray
    starts: np.ndarray
    lengths: np.ndarray
    captures: pd.DataFrame
    rate_hz: float
    full_scale: float = 1023.0
    name: str = "unnamed"
    digest: str = ""
    index: np.ndarray = None  # type: ignore[assignment]  # all captures, filled in below
    info: dict = field(default_factory=dict)
    path: Path | None = None
    target: str = "gesture"
    steps: tuple[Callable[[Corpus], Corpus], ...] = ()
    piece: np.ndarray = None  # type: ignore[assignment]  # as index

    def __post_init__(self) -> None:
        if self.index is None:
            object.__setattr__(self, "index", np.arange(len(self.starts)))
        if self.piece is None:
            object.__setattr__(self, "piece", np.zeros(len(self.starts), dtype=np.int64))

    @classmethod
    def from_captures(
        cls, arrays: Iterable[np.ndarray], captures: pd.DataFrame, rate_hz: float, **fields: object
    ) -> Corpus:
        """Build an in-memory corpus from one array [frames, rows, cols] per capture."""
        arrays = list(arrays)
        lengths = np.array([len(a) for a in arrays], dtype=np.int64)
        starts = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)
        return cls(np.concatenate(arrays), starts, lengths, captures.reset_index(drop=True), rate_hz, **fields)

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def shape(self) -> tuple[int]:
        """(captures,); scikit-learn indexes whatever has a shape as an array."""
        return (len(self),)

    @property
    def grid(self) -> tuple[int, int]:
        """(rows, cols) of the sensor."""
        return self.frames.shape[1:]

    @property
    def synthetic(self) -> bool:
        """Whether the captures were generated; every output made from them must say so."""
        return bool(self.info.get("synthetic"))

    @property
    def gestures(self) -> np.ndarray:
        """Class label of each capture, str [captures]."""
        first, *rest = (self.captures[c].astype(str) for c in self.target.split("+"))
        return (first.str.cat(rest, sep=" ") if rest else first).to_numpy(dtype=object)

    @property
    def subjects(self) -> np.ndarray:
        """Subject of each capture, str [captures]."""
        return self.captures["subject"].to_numpy(dtype=object)

    @overload
    def __getitem__(self, key: int | np.integer) -> np.ndarray: ...

    @overload
    def __getitem__(self, key: slice | np.ndarray | list | tuple) -> Corpus: ...

    def __getitem__(self, key: int | np.integer | slice | np.ndarray | list | tuple) -> np.ndarray | Corpus:
        if isinstance(key, tuple):  # scikit-learn asks for X[indices, ...]
            key = key[0]
        if isinstance(key, (int, np.integer)):
            start = self.starts[key]
            return self.frames[start : start + self.lengths[key]]
        if not isinstance(key, slice):
            key = np.asarray(key)
        return replace(
            self,
            starts=self.starts[key],
            lengths=self.lengths[key],
            captures=self.captures.iloc[key].reset_index(drop=True),
            index=self.index[key],
            piece=self.piece[key],
        )

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[i] for i in range(len(self)))

    def select(self, where: str) -> Corpus:
        """Captures whose columns satisfy a condition such as ``variant == 'rough' and subject in ['1', '2']``.

        A condition compares, and can do nothing else: what it may hold is the part of pandas' queries that
        `bench.corpora.where` computes.

        Raises:
            InputError: it is no condition on these columns, or no capture satisfies it.
        """
        from bench.corpora.where import chosen  # here, so that a change of its messages is no change of the Corpus

        return self[np.flatnonzero(chosen(where, self.captures, self.name))]

    def with_target(self, target: str) -> Corpus:
        """The same captures, told apart by other columns: ``variant``, or ``gesture+variant``.

        Raises:
            InputError: a column is not there, or says nothing of some capture.
        """
        for column in target.split("+"):
            if column not in self.captures or self.captures[column].isna().any():
                whole = [c for c in self.captures if self.captures[c].notna().all()]
                raise InputError(
                    f"target={target}: {self.name} has no full column {column!r}; known: {', '.join(whole)}"
                )
        return replace(self, target=target)

    def detached(self) -> Corpus:
        """A copy in memory that no cache knows, as a robot would hand it over."""
        same = {name: getattr(self, name) for name in ("full_scale", "name", "info", "target")}
        return Corpus.from_captures(self, self.captures, self.rate_hz, **same)

    def __repr__(self) -> str:
        kind = "synthetic " if self.synthetic else ""
        rows, cols = self.grid
        return (
            f"<{kind}Corpus {self.name}: {len(self)} captures of {len(set(self.subjects))} subjects, "
            f"{len(set(self.gestures))} {self.target}s, {int(self.lengths.sum())} frames of {rows}x{cols} "
            f"at {self.rate_hz:g} Hz>"
        )

    def plot(self, capture: int = 0) -> Figure:
        """A picture of one capture: its mean pressure on the grid, and the summed pressure over time.

        Args:
            capture: its position in this corpus.

        Returns:
            A matplotlib figure.
        """
        from bench.corpora.picture import picture

        about = self.captures.iloc[capture]
        words = ", ".join(f"{name} {about[name]}" for name in ("subject", "gesture") if name in about)
        kind = " (synthetic)" if self.synthetic else ""
        return picture(self[capture], self.rate_hz, f"{self.name}{kind}, capture {capture}: {words}")
