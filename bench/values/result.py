"""A finished run as a value, what may be compared with it, and how tables name it.

The loop makes a `Result` from the folds, `bench.reading.runs.stored` from MLflow. Comparison, statistics, choice,
gate and page take results and nothing else. It is a mapping of tags, parameters and numbers by name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from bench.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

BATCH, CONDITIONS = "touchbench.depends_on_batch", "touchbench.conditions"  # tags of a run
MARK = "\N{DAGGER}"  # behind the name of a system whose predictions depend on the batch
MARKED = f"{MARK} predictions depend on other test captures; not compared with other systems"
MIXED_MARK = "\N{DOUBLE DAGGER}"  # behind a protocol that mixes subjects
MIXED = "Training and test captures come from the same subjects: expect lower accuracy for a new person."
DESIGNED = (
    "The systems reflex, touchnet and rocket and the features touch were designed on seven of HAART's ten people, the "
    "training subjects of its challenge split. LOSO tests on these seven, too."
)
MAYBE_TWICE = (
    "Whether a person is in more than one of the joined corpora is unknown; each counts as another."
)
Row = Mapping[
    str, Any
]  # of a run: tags and parameters, which are text, and metrics; nan for what it has not
COMPARABLE = (
    "data",
    "corpus_digest",
    "subset",
    "target",
    "protocol_label",
)  # tags, with the digest of the parameters
SAME_SYSTEM = ("protocol", "system", "seed")  # besides, what makes two runs repetitions of one
FAILED = "touchbench.failed"  # of a run: circumstances that failed in a fold
COUNTS = ("folds", "folds_failed")  # numbers that every result has
SMALL = 1000  # rows of a table that stays in memory once it was read


def notes_on(system: str, data: str) -> list[str]:
    """The footnotes of a system that a table names."""
    ours = re.search(r"(?<![\w.])(reflex|rocket|touch|touchnet)(?![\w.])", system) is not None
    designed = ours and any(part.split("-")[0] == "haart" for part in data.split("+"))
    return [DESIGNED] * designed + [MAYBE_TWICE] * ("+" in data) + [MARKED] * system.endswith(MARK)


def alike(run: Row, names: Iterable[str] = ()) -> tuple[str, ...]:
    """What must agree for two runs to be compared: captures, protocol, and parameters such as the way of replay."""
    return tuple(str(run.get(name, "")) for name in (*COMPARABLE, *names))


def shared(run: Row, same: Mapping[str, tuple[str, str]]) -> list[str]:
    """Further parameters that must agree, in words; those with their usual value are left out."""
    values = {name: str(run.get(name, "")) for name in same}
    return [
        words.format(values[name])
        for name, (words, usual) in same.items()
        if values[name] not in ("", usual)
    ]


def seed_number(seed: str) -> int:
    """A tracked seed as a number to sort by, 0 for a system that has none."""
    return int(seed) if seed.lstrip("-").isdecimal() else 0


def several(number: int, noun: str) -> str:
    """A number with its noun, in the plural unless it is 1."""
    return f"{number} {noun}{'s' if number != 1 else ''}"


class Tables(Mapping[str, "pd.DataFrame"]):
    """The tables of a run by name, such as ``predictions`` or ``per_subject``; each is read when it is asked for."""

    def __init__(
        self,
        kept: Mapping[str, pd.DataFrame],
        # a table, or some of its columns, None where there is none of its name
        read: Callable[..., Any] = lambda name, columns=(): None,
        missing: str = "this run is missing; run it again",  # behind ``<table> of``
        names: Callable[[], Iterable[str]] = tuple,  # of the tables that are not in memory
    ) -> None:
        self._kept, self._read, self._names, self.missing = dict(kept), read, names, missing

    def __getitem__(self, name: str) -> pd.DataFrame:
        """A table; an `InputError` where it is not there."""
        if (table := self.get(name)) is None:
            raise InputError(f"{name} of {self.missing}")
        return table

    def get(self, name: str, default: Any = None) -> Any:
        """A table, or the default where there is none of its name."""
        table = self._kept.get(name)
        if table is None and (table := self._read(name)) is not None and len(table) <= SMALL:
            self._kept[name] = (
                table  # a command may read the predictions of a thousand runs, which are not kept
            )
        return default if table is None else table

    def columns(self, name: str, columns: Sequence[str]) -> list[np.ndarray] | None:
        """Some columns of a table, without the others; None where there is none of its name."""
        table = self._kept[name] if name in self._kept else self._read(name, columns)
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
        return iter(self.about | self.metrics)

    def __len__(self) -> int:
        return len(self.about | self.metrics)

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
        """The system as tables name it: with the conditions that it uses, and a mark if it depends on the batch."""
        conditions = self.about.get(CONDITIONS)
        uses = (
            f" (uses {conditions.replace(',', ', ')})"
            if isinstance(conditions, str) and conditions
            else ""
        )
        return str(self.about["system"]) + uses + f" {MARK}" * (not self.alone)

    @property
    def method(self) -> str:
        """System, and its seed where that is not the usual one."""
        return self.system + (
            f", seed {self.about['seed']}" if self.about["seed"] not in ("0", "none") else ""
        )

    @property
    def context(self) -> tuple[str, str, str]:
        """Data, subset with the target, and protocol in words."""
        data = str(self.about["data"]) + " (synthetic)" * (self.about["synthetic"] == "true")
        target = f", {self.about['target']}" if self.about["target"] != "gesture" else ""
        return data, str(self.about["subset"]) + target, str(self.about["protocol_label"])

    @property
    def comparable(self) -> tuple[str, ...]:
        """Values that two results share if they may be compared."""
        return alike(self.about)

    @property
    def mixed(self) -> bool:
        """True if a fold has captures of one subject on both sides."""
        return self.about.get("mixes_subjects") == "true"

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
        return self.about.get(BATCH) != "true"

    @property
    def folds(self) -> str:
        """Finished folds of all folds."""
        done, failed = (int(self.metrics.get(name, 0)) for name in COUNTS)
        return f"{done}/{done + failed}"
