"""A finished run as a value: what it is of, its numbers, its tables, and the folds that failed.

The loop makes it from the folds, `bench.outcomes.runs.stored` from MLflow. Comparison, statistics, choice, gate, page
take results and nothing else. It is a mapping of tags, parameters and numbers by name, as MLflow has
them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from bench.comparable import comparable, context_of, depends_on_batch, method_of, system_of
from bench.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd


SMALL = 1000  # rows of a table that stays in memory once it was read


class Tables(Mapping[str, "pd.DataFrame"]):
    """The tables of a run by name, such as ``predictions`` or ``per_subject``; each is read when it is asked for."""

    def __init__(
        self,
        kept: Mapping[str, pd.DataFrame],
        read: Callable[[str], pd.DataFrame | None] = lambda name: None,  # None where there is none of its name
        missing: str = "this run is missing; run it again",  # behind ``<table> of``
        names: Callable[[], Iterable[str]] = tuple,  # of the tables that are not in memory
        read_columns: Callable[[str, Sequence[str]], list[np.ndarray] | None] | None = None,
    ) -> None:
        self._kept, self._read, self.missing, self._names = dict(kept), read, missing, names
        self._read_columns = read_columns

    def __getitem__(self, name: str) -> pd.DataFrame:
        """A table; an `InputError` where it is not there."""
        table = self.get(name)
        if table is None:
            raise InputError(f"{name} of {self.missing}")
        return table

    def get(self, name: str, default: Any = None) -> Any:
        """A table, or the default where there is none of its name."""
        if name in self._kept:
            return self._kept[name]
        table = self._read(name)
        if table is None:
            return default
        if len(table) <= SMALL:  # a command may read the predictions of a thousand runs
            self._kept[name] = table
        return table

    def columns(self, name: str, columns: Sequence[str]) -> list[np.ndarray] | None:
        """Some columns of a table, without the others; None where there is none of its name."""
        if self._read_columns and name not in self._kept:
            return self._read_columns(name, columns)
        table = self.get(name)
        return None if table is None else [table[each].to_numpy() for each in columns]

    def __contains__(self, name: object) -> bool:
        return self.get(str(name)) is not None

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._names(), *self._kept)))

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Failure(NamedTuple):
    """The exception of a failed fold in one line, and the location of its traceback."""

    reason: str
    where: str


class Result(Mapping[str, Any]):
    """A finished run.

    Args:
        about: tags and parameters, which are text, with ``run_id``, ``status`` and ``started``.
        metrics: numbers by name.
        tables: tables by name.
        errors: failure of each failed fold, by fold name.
    """

    def __init__(
        self,
        about: Mapping[str, Any],
        metrics: Mapping[str, float],
        tables: Mapping[str, pd.DataFrame],
        errors: Mapping[str, Failure] | None = None,
    ) -> None:
        self.about, self.metrics, self.errors = dict(about), dict(metrics), dict(errors or {})
        self.tables = tables if isinstance(tables, Tables) else Tables(tables)

    def __getitem__(self, name: str) -> Any:
        return self.metrics[name] if name in self.metrics else self.about[name]

    def __iter__(self) -> Iterator[str]:
        yield from self.about
        yield from (name for name in self.metrics if name not in self.about)

    def __len__(self) -> int:
        return len(self.about.keys() | self.metrics.keys())

    @cached_property
    def people(self) -> dict[str, float]:
        """Accuracy of the captures of each subject, in percent, as the run stored it; empty if it is not there."""
        columns = self.tables.columns("per_subject", ("subject", "accuracy"))
        return {} if columns is None else dict(zip(columns[0], 100 * columns[1], strict=True))

    def __repr__(self) -> str:
        return f"Result({self.kind} {self.method} on {', '.join(self.context)})"

    def __hash__(self) -> int:
        return id(self)

    def __eq__(self, other: object) -> bool:
        return self is other

    @property
    def kind(self) -> str:
        """Kind of run."""
        return str(self.about["touchbench.kind"])

    @property
    def system(self) -> str:
        """The system as tables name it, with its marks."""
        return system_of(self.about)

    @property
    def method(self) -> str:
        """System, and its seed where that is not the usual one."""
        return method_of(self.about)

    @property
    def context(self) -> tuple[str, str, str]:
        """Data, subset and protocol in words."""
        return context_of(self.about)

    @property
    def comparable(self) -> tuple[str, ...]:
        """Values that two results share if they may be compared."""
        return comparable(self.about)

    @property
    def scored(self) -> bool:
        """True unless every fold failed."""
        return len(self.metrics) > len(COUNTS)

    @property
    def complete(self) -> bool:
        """True if no fold failed."""
        return self.about["status"] == "FINISHED"

    @property
    def failed(self) -> list[str]:
        """Keys of circumstances that failed in a fold, of which it therefore has no numbers."""
        return [*filter(None, str(self.about.get(FAILED, "")).split(", "))]

    @property
    def alone(self) -> bool:
        """True if its predictions of a capture do not depend on the other captures predicted together."""
        return not depends_on_batch(self.about)

    @property
    def folds(self) -> str:
        """Finished folds of all folds."""
        done, failed = (int(self.metrics.get(name, 0)) for name in COUNTS)
        return f"{done}/{done + failed}"


FAILED = "touchbench.failed"  # of a run: circumstances that failed in a fold
COUNTS = ("folds", "folds_failed")  # numbers that every result has
