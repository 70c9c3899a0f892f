"""The corpus: ragged captures of a pressure grid, sliced without copying frames.

Features, models and protocols may know nothing else of the harness. A system that predicts gets a
*blind* corpus (`Corpus.blind`): frames, lengths, rate, full scale and grid, and nothing that tells
whose capture it is.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import pandas as pd

from bench.errors import HiddenError, InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SATURATED_ONE_IN = 10  # a frame is saturated if one of so many taxels reads full scale; not tuned
NEGATIVE_SHARE = 0.02  # of full scale; smaller negative readings of a live sensor are taken for 0
COPY = 1 << 40  # a piece is COPY x the number of its copy + its first frame
RESERVED = {"fold", "capture", "start", "frames", "true", "predicted"}  # columns of predictions
PROBABILITY = "p_"  # prefix of the columns of probabilities
SOURCE = "corpus"  # column of joined corpora: where a capture comes from
NO_ARRAY = "iterate over it: each capture is an array [frames, rows, cols]"
VISIBLE = ("lengths", "rate_hz", "full_scale", "visible")  # fields that a blind corpus has, too


def _hidden_property(name: str) -> Any:
    """An attribute of a `Corpus` that a blind one does not have."""

    def get_field(corpus: Corpus) -> object:
        corpus._refuse_if_blind(name)
        return corpus.__dict__[f"_{name}"]

    return property(get_field)


def reserved_names(columns: Iterable[str], more: Collection[str] = ()) -> list[str]:
    """The columns that captures cannot have, because results or ``more`` use their names."""
    return [
        name
        for name in columns
        if name in RESERVED or name in more or str(name).startswith(PROBABILITY)
    ]


class Corpus:
    """Captures of touch on one sensor grid; immutable.

    A slice shares its frames with the corpus it was cut from; `frames` and `starts` cover its own
    captures only. Indexing with an integer gives the frames of one capture, indexing with an array,
    a mask or a slice gives a `Corpus`. With ``len`` and ``shape``, scikit-learn takes it as ``X``.

    A blind corpus (`blind`) has frames, starts, lengths, rate_hz, full_scale and grid. Any other
    attribute raises a `bench.errors.HiddenError`.

    Args:
        frames: uint16 or float32 [total_frames, rows, cols], sensor values 0..full_scale; row 0 is
            the top.
        starts: int64 [captures], first frame of each capture in ``frames``.
        lengths: int64 [captures], number of frames of each capture, at least 1.
        captures: one row per capture: ``subject``, ``gesture`` (str) and any conditions (variant,
            cover, split, ...).
        rate_hz: frames per second.
        full_scale: the largest value that the sensor can give.
        name: the name under which the corpus was imported.
        digest: content hash of the whole corpus, ``""`` for one that was never stored.
        index: int64 [captures], position of each capture in the whole corpus; by default from 0.
        info: source, licence, synthetic (bool), warnings (list of str).
        path: the folder that the frames are mapped from, or None when they are in memory.
        target: the columns of ``captures`` that make up the class, joined by ``+``.
        steps: changes to the captures since they were stored (`bench.models.steps`), in order.
            Several captures may then come from one stored capture and have its ``index``.
        piece: int64 [captures], number of the capture among all with its ``index``; 0 before any
            step.

    Attributes:
        visible: columns that a blind corpus has; None for a corpus that is not blind.
    """

    name: str = _hidden_property("name")
    digest: str = _hidden_property("digest")
    index: np.ndarray = _hidden_property("index")
    info: dict = _hidden_property("info")
    path: Path | None = _hidden_property("path")
    target: str = _hidden_property("target")
    steps: tuple[Callable[[Corpus], Corpus], ...] = _hidden_property("steps")
    piece: np.ndarray = _hidden_property("piece")

    def __init__(
        self,
        frames: np.ndarray,
        starts: np.ndarray,
        lengths: np.ndarray,
        captures: pd.DataFrame,
        rate_hz: float,
        full_scale: float = 1023.0,
        name: str = "unnamed",
        digest: str = "",
        index: np.ndarray | None = None,
        info: dict | None = None,
        path: Path | None = None,
        target: str = "gesture",
        steps: tuple[Callable[[Corpus], Corpus], ...] = (),
        piece: np.ndarray | None = None,
    ) -> None:
        self.__dict__.update(
            _frames=frames,
            _starts=starts,
            lengths=lengths,
            _captures=captures,
            rate_hz=rate_hz,
            full_scale=full_scale,
            _name=name,
            _digest=digest,
            _index=np.arange(len(starts)) if index is None else index,
            _info={} if info is None else info,
            _path=path,
            _target=target,
            _steps=steps,
            _piece=np.zeros(len(starts), dtype=np.int64) if piece is None else piece,
            visible=None,
        )

    if TYPE_CHECKING:
        lengths: np.ndarray
        rate_hz: float
        full_scale: float
        _frames: np.ndarray
        _starts: np.ndarray
        _captures: pd.DataFrame
        visible: tuple[str, ...] | None

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(
            f"{name}: a Corpus does not change; with_fields({name}=...) gives another one"
        )

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"X.{name}: a Corpus is no array; {NO_ARRAY}")

    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise TypeError(f"captures of different lengths are no array; {NO_ARRAY}")

    @classmethod
    def from_captures(
        cls, arrays: Iterable[np.ndarray], captures: pd.DataFrame, rate_hz: float, **fields: Any
    ) -> Corpus:
        """Build an in-memory corpus from one array [frames, rows, cols] per capture."""
        arrays = list(arrays)
        lengths = np.array([len(a) for a in arrays], dtype=np.int64)
        starts = np.cumsum(lengths) - lengths
        return cls(
            np.concatenate(arrays),
            starts,
            lengths,
            captures.reset_index(drop=True),
            rate_hz,
            **fields,
        )

    def with_fields(self, **fields: object) -> Corpus:
        """A corpus with some of the constructor's arguments replaced; a blind corpus stays blind.

        Frames and starts that are not replaced are shared. New frames without new starts hold one
        capture after another.

        Raises:
            TypeError: the constructor has no such argument.
        """
        if "visible" in fields:
            raise TypeError("a Corpus has no visible; blind() hides what a prediction must not use")
        if "frames" in fields and "starts" not in fields:
            lengths = np.asarray(fields.get("lengths", self.lengths))
            fields["starts"] = np.cumsum(lengths) - lengths
        return self._copy_with(**fields)

    def _copy_with(self, **fields: object) -> Corpus:
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__)
        new.__dict__.pop("_compacted", None)
        for name, value in fields.items():
            key = name if name in VISIBLE else f"_{name}"
            if key not in new.__dict__:
                raise TypeError(f"a Corpus has no {name}")
            new.__dict__[key] = value
        return new

    def blind(self, visible: tuple[str, ...] = ()) -> Corpus:
        """The captures as a system gets them to predict: without labels, subjects and origin.

        Args:
            visible: columns of ``captures`` that the system declares to need
                (`bench.contract.required_conditions`); a blind corpus gains none.
        """
        if self.visible is not None:
            visible = tuple(name for name in visible if name in self.visible)
        return self._copy_with(visible=tuple(visible))

    @property
    def is_blind(self) -> bool:
        """True for captures without labels, as in prediction."""
        return self.visible is not None

    def _refuse_if_blind(self, name: str) -> None:
        if self.visible is not None:
            raise HiddenError(
                f"X.{name} is hidden in prediction, which may use frames, starts, lengths, "
                "rate_hz, full_scale and grid; a system that needs a condition declares it: "
                "conditions = ('cover',)"
            )

    @property
    def is_joined(self) -> bool:
        """True for captures of several corpora."""
        return "parts" in self.__dict__["_info"]

    @property
    def sources(self) -> np.ndarray:
        """Name of the corpus that each capture comes from, str [captures].

        A blind corpus has it: a robot knows its sensor.
        """
        if self.is_joined:
            return self._captures[SOURCE].to_numpy(dtype=object)
        return np.full(len(self), self.__dict__["_name"], dtype=object)

    @property
    def is_added(self) -> np.ndarray:
        """True for captures of ``also=``, which are never tested, bool [captures]."""
        return np.isin(self.sources.astype(str), self.__dict__["_info"].get("also", []))

    def __len__(self) -> int:
        return len(self._starts)

    @property
    def shape(self) -> tuple[int]:
        """(captures,); scikit-learn indexes objects with a shape as arrays."""
        return (len(self),)

    @property
    def grid(self) -> tuple[int, int]:
        """(rows, cols) of the sensor."""
        return self._frames.shape[1:]

    @property
    def frames(self) -> np.ndarray:
        """Frames of these captures [frames, rows, cols]; a copy if the corpus is a slice."""
        return self._compact_frames()[0]

    @property
    def starts(self) -> np.ndarray:
        """First frame of each capture in `frames`, int64 [captures]."""
        return self._compact_frames()[1]

    def _compact_frames(self) -> tuple[np.ndarray, np.ndarray]:
        if (compacted := self.__dict__.get("_compacted")) is None:
            first = np.cumsum(self.lengths) - self.lengths
            frames = self._frames
            if self.lengths.sum() != len(frames) or not np.array_equal(self._starts, first):
                frames = np.concatenate([frames[:0], *self])
            compacted = self.__dict__["_compacted"] = frames, first
        return compacted

    @property
    def captures(self) -> pd.DataFrame:
        """Subject, gesture and conditions of each capture; if blind, the visible columns."""
        if self.visible is None:
            return self._captures
        if not self.visible:
            self._refuse_if_blind("captures")
        return self._captures[[*self.visible]]

    @property
    def synthetic(self) -> bool:
        """True for generated captures; every output made from them must be marked."""
        return bool(self.info.get("synthetic"))

    @property
    def gestures(self) -> np.ndarray:
        """Class label of each capture, str [captures]."""
        self._refuse_if_blind("gestures")
        labels, *rest = (self.captures[c].astype(str) for c in self.target.split("+"))
        for column in rest:
            labels = labels.str.cat(column, sep=" ")
        return labels.to_numpy(dtype=object)

    @property
    def subjects(self) -> np.ndarray:
        """Subject of each capture, str [captures]."""
        self._refuse_if_blind("subjects")
        return self.captures["subject"].to_numpy(dtype=object)

    @overload
    def __getitem__(self, key: int | np.integer) -> np.ndarray: ...

    @overload
    def __getitem__(self, key: slice | np.ndarray | list | tuple) -> Corpus: ...

    def __getitem__(
        self, key: int | np.integer | slice | np.ndarray | list | tuple
    ) -> np.ndarray | Corpus:
        if isinstance(key, tuple):  # scikit-learn asks for X[indices, ...]
            key = key[0]
        if isinstance(key, (int, np.integer)):
            start = self._starts[key]
            return self._frames[start : start + self.lengths[key]]
        if not isinstance(key, slice):
            key = np.asarray(key)
        return self.with_fields(
            starts=self._starts[key],
            lengths=self.lengths[key],
            captures=self._captures.iloc[key].reset_index(drop=True),
            index=self.__dict__["_index"][key],
            piece=self.__dict__["_piece"][key],
        )

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[i] for i in range(len(self)))

    def select(self, where: str) -> Corpus:
        """Captures that satisfy a condition, such as ``cover == 'fur' and subject in ['1', '2']``.

        A condition can do nothing except compare: it is the part of pandas' queries that
        `bench.corpora.where` evaluates.

        Raises:
            InputError: it is no condition on these columns, or no capture satisfies it.
        """
        self._refuse_if_blind("select")
        # Imported here, so that a change of its messages is no change of the Corpus.
        from bench.corpora.where import where_mask

        return self[np.flatnonzero(where_mask(where, self.captures, self.name))]

    def with_target(self, target: str) -> Corpus:
        """The same captures with other class columns: ``variant``, or ``gesture+variant``.

        Raises:
            InputError: a column is missing, or empty for some capture.
        """
        self._refuse_if_blind("with_target")
        for column in target.split("+"):
            if column not in self.captures or self.captures[column].isna().any():
                known = ", ".join(map(str, self.captures.dropna(axis=1)))
                raise InputError(
                    f"target={target}: {self.name} has no full column {column!r}; known: {known}"
                )
        return self.with_fields(target=target)

    def detach(self) -> Corpus:
        """A copy in memory without identity for caches, like captures from a robot."""
        return self.with_fields(
            frames=np.array(self.frames),
            digest="",
            path=None,
            index=np.arange(len(self)),
            piece=np.zeros(len(self), dtype=np.int64),
            steps=(),
        )

    def __repr__(self) -> str:
        rows, cols = self.grid
        frames = f"{int(self.lengths.sum())} frames of {rows}x{cols} at {self.rate_hz:g} Hz"
        if self.visible is not None:
            return f"<Corpus for prediction: {len(self)} captures, {frames}>"
        kind = "synthetic " if self.synthetic else ""
        return (
            f"<{kind}Corpus {self.name}: {len(self)} captures of {len(set(self.subjects))} "
            f"subjects, {len(set(self.gestures))} {self.target}s, {frames}>"
        )

    def plot(self, capture: int = 0) -> Figure:
        """Draw one capture: its mean pressure on the grid, and the summed pressure over time."""
        self._refuse_if_blind("plot")
        from matplotlib.figure import Figure

        row, frames = self.captures.iloc[capture], self[capture].astype(np.float64)
        words = ", ".join(f"{name} {row[name]}" for name in ("subject", "gesture") if name in row)
        name = f"{self.name} (synthetic)" if self.synthetic else self.name
        figure = Figure(figsize=(8, 3), layout="constrained")
        figure.suptitle(f"{name}, capture {capture}: {words}", fontsize=10)
        grid, course = figure.subplots(1, 2, width_ratios=(1, 2))
        image = grid.imshow(frames.mean(axis=0), cmap="magma", vmin=0)
        grid.set(title="mean pressure", xticks=[], yticks=[])
        figure.colorbar(image, ax=grid, shrink=0.8, label="sensor value")
        course.plot(np.arange(len(frames)) / self.rate_hz, frames.sum(axis=(1, 2)), linewidth=1)
        course.set(title="pressure summed over the taxels", xlabel="s", ylim=(0, None))
        course.grid(alpha=0.25)
        return figure


def unblind(corpus: Corpus) -> Corpus:
    """The same captures with labels, subjects and origin, for caches and checks of the harness."""
    return corpus._copy_with(visible=None)


def shared_frames(corpus: Corpus) -> tuple[np.ndarray, np.ndarray]:
    """Frames that a corpus shares with others, and the first frame of each of its captures.

    Returns:
        Frames [total_frames, rows, cols], not copied, and starts int64 [captures].
    """
    return corpus._frames, corpus._starts


def untrained_classes(labels: np.ndarray, train: np.ndarray, test: np.ndarray) -> list[str]:
    """Classes of test captures that no training capture has, sorted; sides are positions."""
    return sorted({*map(str, pd.unique(labels[test]))} - {*map(str, pd.unique(labels[train]))})
