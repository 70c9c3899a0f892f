"""A finished run as a value, which runs may be compared, and what tables say about a system.

`bench.running` makes a `Result` from folds; `bench.reading.runs` loads it from MLflow. All code
that compares, chooses or prints takes results and nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from bench.errors import InputError
from bench.ground.registry import notes_by_design

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

# Tags of a run
BATCH_TAG, CONDITIONS_TAG = "touchbench.depends_on_batch", "touchbench.conditions"
FAILED_TAG = "touchbench.failed"  # circumstances that failed in a fold
IMPORTS_TAG, CAPTURES_TAG = "touchbench.imports", "touchbench.captures"  # digests
NAME_TAG = "touchbench.name"  # short name of the system
GRIDS_TAG = "touchbench.grids"  # digests of the files that name the run; not part of its key
# Attribute: digest of the corpus as imported now, if the run is on earlier captures of it
SINCE_TAG = "touchbench.imported_since"
COMPARISON_TAGS = ("data", "corpus_digest", "subset", "target", "protocol_label")
REPETITION_TAGS = (
    "protocol",
    "system",
    "seed",
)  # equal in repetitions of a run, as are those above
BATCH_MARK = "\N{DAGGER}"  # behind the name of a system whose predictions depend on the batch
BATCH_NOTE = (
    f"{BATCH_MARK} predictions depend on other test captures; not compared with other systems"
)
MIXED_MARK = "\N{DOUBLE DAGGER}"  # behind a protocol that mixes subjects
MIXED_NOTE = (
    "Training and test captures come from the same subjects: "
    "expect lower accuracy for a new person."
)
JOINED_NOTE = (
    "Whether a person is in more than one of the joined corpora is unknown; each counts as another."
)
ALSO_MARK = "\N{MIDDLE DOT} also "  # in the name of a system that learns from other corpora, too
LABELS_TABLE = "labels"  # labels in the cases of circumstances
FOLD_COUNTS = ("folds", "folds_failed")  # numbers that every result has
KEPT_ROWS = 1000  # a table of a run stays in memory if it has at most so many rows

# Tags and parameters of a run, which are text, and its metrics; NaN for a missing one
Row = Mapping[str, Any]


def footnotes_of_system(system: str, data: str) -> list[str]:
    """Footnotes for the name of a system in a table of runs on ``data``."""
    corpora = {name.split("-")[0] for name in data.split("+")}
    notes = [note for _, (corpus, note) in _notes_by_design(system) if corpus in corpora]
    return [
        *dict.fromkeys(notes),
        *[JOINED_NOTE] * ("+" in data or ALSO_MARK in system),
        *[BATCH_NOTE] * system.endswith(BATCH_MARK),
    ]


def _notes_by_design(system: str) -> list[tuple[str, tuple[str, str]]]:
    """Registered parts of a system that were designed on a corpus, with this corpus and a note.

    The name of a part of a user's file has a dot if a registered part has the same name. The name
    of an object has parentheses.
    """
    registered = r"(?<![\w.])(\w+)(?![\w.(])"
    model = re.match(rf"(?:tuned )?{registered}", system)
    further = re.findall(registered, system[model.end() :] if model else system)
    designed = {group: notes_by_design(group) for group in ("models", "features")}
    names = [("models", model[1])] if model else []
    names += [(group, name) for name in further for group in designed]
    return [(name, designed[group][name]) for group, name in names if name in designed[group]]


def comparison_key(run: Row, parameters: Iterable[str] = ()) -> tuple[str, ...]:
    """Values that two runs share if they may be compared: captures, protocol, some parameters."""
    return tuple(str(run.get(name, "")) for name in (*COMPARISON_TAGS, *parameters))


def setting_phrases(run: Row, settings: Mapping[str, tuple[str, str]]) -> list[str]:
    """Describe parameters that compared runs share: name -> (format, value that is left out)."""
    phrases = []
    for name, (phrase, usual) in settings.items():
        if (value := str(run.get(name, ""))) not in ("", usual):
            phrases.append(phrase.format(value))
    return phrases


def seed_number(seed: str) -> int:
    """A tracked seed as a number to sort by; 0 for a system without one."""
    return int(seed) if seed.lstrip("-").isdecimal() else 0


def format_count(number: int, noun: str) -> str:
    """Write a number with its noun, in the plural unless it is 1."""
    return f"{number} {noun}{'s' if number != 1 else ''}"


class RunTables(Mapping[str, "pd.DataFrame"]):
    """Tables of a run by name, such as ``predictions`` or ``per_subject``, each read when needed.

    Args:
        tables: those in memory.
        read: from a name, and optionally some columns, to a table; None for an unknown name.
        missing: end of the message about a missing table, after ``<table> of``.
        list_names: lists the tables that are not in memory.
    """

    def __init__(
        self,
        tables: Mapping[str, pd.DataFrame],
        read: Callable[..., Any] = lambda name, columns=(): None,
        missing: str = "this run is missing; run it again",
        list_names: Callable[[], Iterable[str]] = tuple,
    ) -> None:
        self._tables, self.missing = dict(tables), missing
        self._read, self._list_names = read, list_names

    def __getitem__(self, name: str) -> pd.DataFrame:
        """A table; an `InputError` if it is missing."""
        if (table := self.get(name)) is None:
            raise InputError(f"{name} of {self.missing}")
        return table

    def get(self, name: str, default: Any = None) -> Any:
        """A table, or the default if it is missing."""
        if name in self._tables:
            return self._tables[name]
        if (table := self._read(name)) is None:
            return default
        if len(table) <= KEPT_ROWS:  # a command may read the predictions of a thousand runs
            self._tables[name] = table
        return table

    def read_columns(self, name: str, columns: Sequence[str]) -> list[np.ndarray] | None:
        """Some columns of a table, without reading the others; None if it is missing."""
        table = self._tables[name] if name in self._tables else self._read(name, columns)
        return None if table is None else [table[column].to_numpy() for column in columns]

    def __contains__(self, name: object) -> bool:
        return self.get(str(name)) is not None

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._list_names(), *self._tables)))

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Failure(NamedTuple):
    """The exception of a failed fold in one line, and the location of its traceback."""

    reason: str
    where: str


class Result(Mapping[str, Any]):
    """A finished run: a mapping of its tags, parameters and numbers by name.

    Args:
        attributes: tags and parameters, which are text, ``run_id``, ``status`` and ``started``.
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
        self.attributes, self.metrics = dict(attributes), dict(metrics)
        self.tables = tables if isinstance(tables, RunTables) else RunTables(tables)
        self.errors = dict(errors or {})

    def __getitem__(self, name: str) -> Any:
        return self.metrics[name] if name in self.metrics else self.attributes[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.attributes | self.metrics)

    def __len__(self) -> int:
        return len(self.attributes | self.metrics)

    @cached_property
    def accuracy_by_subject(self) -> dict[str, float]:
        """Accuracy on each subject in percent; empty if the run did not store it."""
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
        """Name of the system in tables, with the conditions that it uses, and `BATCH_MARK`.

        A short name is followed by the parts that were designed on a corpus, as these have a note.
        """
        name, short = str(self.attributes["system"]), self.attributes.get(NAME_TAG)
        if not isinstance(short, str) or not short:
            return self._with_marks(name)
        parts = dict.fromkeys(part for part, _ in _notes_by_design(name))
        return self._with_marks(" · ".join([short, *parts]))

    @property
    def full_name(self) -> str:
        """The same without a short name."""
        return self._with_marks(str(self.attributes["system"]))

    def _with_marks(self, name: str) -> str:
        conditions = self.attributes.get(CONDITIONS_TAG)
        if isinstance(conditions, str) and conditions:
            name += f" (uses {conditions.replace(',', ', ')})"
        return name if self.predicts_alone else f"{name} {BATCH_MARK}"

    @property
    def system_with_seed(self) -> str:
        """Name of the system, with its seed unless that is the usual one."""
        seed = self.attributes["seed"]
        return self.system if seed in ("0", "none") else f"{self.system}, seed {seed}"

    @property
    def context(self) -> tuple[str, str, str]:
        """Data, subset with the target, and protocol in words."""
        data, subset = str(self.attributes["data"]), str(self.attributes["subset"])
        if self.attributes["synthetic"] == "true":
            data += " (synthetic)"
        if self.attributes["target"] != "gesture":
            subset += f", {self.attributes['target']}"
        return data, subset, str(self.attributes["protocol_label"])

    @property
    def values_to_agree(self) -> tuple[str, ...]:
        """Values that two results share if they may be compared."""
        return comparison_key(self.attributes)

    @property
    def mixes_subjects(self) -> bool:
        """True if a subject has training and test captures in one fold."""
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
    def is_stale(self) -> bool:
        """True if its corpus was imported again since, with other captures."""
        return bool(self.attributes.get(SINCE_TAG))

    @property
    def failed_circumstances(self) -> list[str]:
        """Keys of the circumstances that failed in a fold; the run has no numbers of these."""
        return [*filter(None, str(self.attributes.get(FAILED_TAG, "")).split(", "))]

    @property
    def predicts_alone(self) -> bool:
        """True if the prediction of a capture does not depend on others predicted with it."""
        return self.attributes.get(BATCH_TAG) != "true"

    @property
    def folds(self) -> str:
        """Number of finished folds, of all."""
        done, failed = (int(self.metrics.get(name, 0)) for name in FOLD_COUNTS)
        return f"{done}/{done + failed}"
