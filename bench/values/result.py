"""A finished run as a value, what may be compared with it, and how tables name it.

The loop makes a `Result` from the folds, `bench.reading.runs.load_results_on_captures` from MLflow. Comparison, statistics, choice,
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

BATCH_TAG, CONDITIONS_TAG = "touchbench.depends_on_batch", "touchbench.conditions"  # tags of a run
BATCH_MARK = "\N{DAGGER}"  # behind the name of a system whose predictions depend on the batch
BATCH_NOTE = (
    f"{BATCH_MARK} predictions depend on other test captures; not compared with other systems"
)
MIXED_MARK = "\N{DOUBLE DAGGER}"  # behind a protocol that mixes subjects
MIXED_NOTE = "Training and test captures come from the same subjects: expect lower accuracy for a new person."
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
COMPARISON_TAGS = (
    "data",
    "corpus_digest",
    "subset",
    "target",
    "protocol_label",
)  # tags, with the digest of the parameters
REPETITION_TAGS = ("protocol", "system", "seed")  # besides, what makes two runs repetitions of one
FAILED_TAG = "touchbench.failed"  # of a run: circumstances that failed in a fold
LABELS_TABLE = "labels"  # of a run: labels in the cases of circumstances
FOLD_COUNTS = ("folds", "folds_failed")  # numbers that every result has
KEPT_ROWS = 1000  # rows of a table that stays in memory once it was read


def footnotes_of_system(system: str, data: str) -> list[str]:
    """The footnotes of a system that a table names."""
    ours = re.search(r"(?<![\w.])(reflex|rocket|touch|touchnet)(?![\w.])", system) is not None
    designed = ours and any(part.split("-")[0] == "haart" for part in data.split("+"))
    return (
        [DESIGNED] * designed
        + [MAYBE_TWICE] * ("+" in data)
        + [BATCH_NOTE] * system.endswith(BATCH_MARK)
    )


def values_to_agree(run: Row, names: Iterable[str] = ()) -> tuple[str, ...]:
    """What must agree for two runs to be compared: captures, protocol, and parameters such as the way of replay."""
    return tuple(str(run.get(name, "")) for name in (*COMPARISON_TAGS, *names))


def setting_phrases(run: Row, same: Mapping[str, tuple[str, str]]) -> list[str]:
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


def format_count(number: int, noun: str) -> str:
    """A number with its noun, in the plural unless it is 1."""
    return f"{number} {noun}{'s' if number != 1 else ''}"


class RunTables(Mapping[str, "pd.DataFrame"]):
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
        if table is None and (table := self._read(name)) is not None and len(table) <= KEPT_ROWS:
            self._kept[name] = (
                table  # a command may read the predictions of a thousand runs, which are not kept
            )
        return default if table is None else table

    def read_columns(self, name: str, columns: Sequence[str]) -> list[np.ndarray] | None:
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
        attributes: Mapping[str, Any],
        metrics: Mapping[str, float],
        tables: Mapping[str, pd.DataFrame],
        errors: Mapping[str, Failure] | None = None,
    ) -> None:
        self.attributes, self.metrics, self.errors = dict(attributes), dict(metrics), dict(errors or {})
        self.tables = tables if isinstance(tables, RunTables) else RunTables(tables)

    def __getitem__(self, name: str) -> Any:
        return self.metrics[name] if name in self.metrics else self.attributes[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.attributes | self.metrics)

    def __len__(self) -> int:
        return len(self.attributes | self.metrics)

    @cached_property
    def accuracy_by_subject(self) -> dict[str, float]:
        """Accuracy of the captures of each subject, in percent, as the run stored it; empty if it is not there."""
        columns = self.tables.read_columns("per_subject", ("subject", "accuracy"))
        return {} if columns is None else dict(zip(columns[0], 100 * columns[1], strict=True))

    def __repr__(self) -> str:
        return f"Result({self.kind} {self.system_with_seed} on {', '.join(self.context)})"

    def __hash__(self) -> int:
        return id(self)

    def __eq__(self, other: object) -> bool:
        return self is other

    @property
    def kind(self) -> str:
        """Kind of run."""
        return str(self.attributes["touchbench.kind"])

    @property
    def system(self) -> str:
        """The system as tables name it: with the conditions that it uses, and a mark if it depends on the batch."""
        conditions = self.attributes.get(CONDITIONS_TAG)
        uses = (
            f" (uses {conditions.replace(',', ', ')})"
            if isinstance(conditions, str) and conditions
            else ""
        )
        return str(self.attributes["system"]) + uses + f" {BATCH_MARK}" * (not self.predicts_alone)

    @property
    def system_with_seed(self) -> str:
        """System, and its seed where that is not the usual one."""
        return self.system + (
            f", seed {self.attributes['seed']}" if self.attributes["seed"] not in ("0", "none") else ""
        )

    @property
    def context(self) -> tuple[str, str, str]:
        """Data, subset with the target, and protocol in words."""
        data = str(self.attributes["data"]) + " (synthetic)" * (self.attributes["synthetic"] == "true")
        target = f", {self.attributes['target']}" if self.attributes["target"] != "gesture" else ""
        return data, str(self.attributes["subset"]) + target, str(self.attributes["protocol_label"])

    @property
    def values_to_agree(self) -> tuple[str, ...]:
        """Values that two results share if they may be compared."""
        return values_to_agree(self.attributes)

    @property
    def mixes_subjects(self) -> bool:
        """True if a fold has captures of one subject on both sides."""
        return self.attributes.get("mixes_subjects") == "true"

    @property
    def has_scores(self) -> bool:
        """True unless every fold failed."""
        return len(self.metrics) > len(FOLD_COUNTS)

    @property
    def is_complete(self) -> bool:
        """True if no fold failed."""
        return self.attributes["status"] == "FINISHED"

    @property
    def failed_circumstances(self) -> list[str]:
        """Keys of circumstances that failed in a fold, of which it therefore has no numbers."""
        return [*filter(None, str(self.attributes.get(FAILED_TAG, "")).split(", "))]

    @property
    def predicts_alone(self) -> bool:
        """True if its predictions of a capture do not depend on the other captures predicted together."""
        return self.attributes.get(BATCH_TAG) != "true"

    @property
    def folds(self) -> str:
        """Finished folds of all folds."""
        done, failed = (int(self.metrics.get(name, 0)) for name in FOLD_COUNTS)
        return f"{done}/{done + failed}"
