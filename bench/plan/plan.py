"""Plans: a cell with its captures, folds and number of processes. A plan fixes all of a run."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
import warnings
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus, reserved_names, untrained_classes
from bench.corpora.duplicates import excluding_condition, leaked_captures, repeated_groups
from bench.corpora.library import UNTAUGHT, captures_digest, import_digests, open_corpus
from bench.errors import InputError, one_line
from bench.features.base import FunctionFeatures
from bench.ground.typed import quote_value
from bench.plan.cells import Cell
from bench.plan.splits import Splitter
from bench.values.result import CAPTURES_TAG, IMPORTS_TAG

MOST_STORED = 8000  # characters of all arguments of a run, as MLflow stores them in one tag


@dataclass(eq=False)
class Fold:
    """A split of the captures of a corpus into training and test captures, by position.

    Some protocols test several systems in a fold: ``pairs`` has the further training captures of
    each, and the captures that it is then tested on.
    """

    name: str  # the tested subject, or a number
    train: np.ndarray  # positions of the training captures, int32 [captures]
    test: np.ndarray  # positions of the test captures, int32 [captures]
    pairs: Sequence[tuple[np.ndarray, np.ndarray]] = ()


@dataclass(frozen=True)
class Plan:
    """A run before it is made: a cell, the captures that it uses, and their folds.

    The cached properties depend on the captures, the folds and the protocol, not on the system.
    Plans of several systems share them (`with_cell`).
    """

    cell: Cell  # the system, and how it is tested
    corpus: Corpus  # the captures of the run
    folds: tuple[Fold, ...]  # all of them, in the order of the protocol
    workers: int  # processes
    threads: int  # of each process

    @cached_property
    def tested(self) -> Corpus:
        """The captures without those that are only in training."""
        is_added = self.corpus.is_added
        return self.corpus[~is_added] if is_added.any() else self.corpus

    @cached_property
    def mixes_subjects(self) -> bool:
        """True if a fold trains and tests on the same subject: optimistic for a new person."""
        return mixes_subjects(self.corpus, self.folds)

    @cached_property
    def repeated_captures(self) -> list[tuple[int, int]]:
        """Pairs of a tested capture and a training capture of its fold with the same frames."""
        sides = [side for fold in self.folds for side in ((fold.train, fold.test), *fold.pairs)]
        return leaked_captures(repeated_groups(self.corpus), sides, len(self.corpus))

    @cached_property
    def label(self) -> str:
        """The protocol in words; different for different splits, so it names an unusual seed."""
        part = self.cell.protocol
        own_label = getattr(self.cell.splitter, "label", None)
        if own_label is None:
            return f"{part}, subjects mixed" if self.mixes_subjects else str(part)
        words, seed = own_label(self.tested), part.changed_parameters().get("seed")
        if seed is None or re.search(rf"\bseed {seed}\b", words):
            return words
        return f"{words}, seed {seed}"

    @cached_property
    def facts(self) -> dict[str, str]:
        """Properties of captures and protocol, for tables; ``""`` for missing ones."""
        published = getattr(self.cell.splitter, "official_split", None)
        official = published(self.tested) if published else None
        ratio = ratio_of_test_to_training(self.folds)
        return {
            "mixes_subjects": str(self.mixes_subjects).lower(),
            "test_over_train": "" if ratio is None else repr(ratio),
            "official_split": "" if official is None else str(official).lower(),
            IMPORTS_TAG: import_digests(self.cell.data),
            CAPTURES_TAG: captures_digest(self.tested),
        }

    def with_cell(self, cell: Cell) -> Plan:
        """The plan of another cell on the same captures under the same protocol."""
        for name in ("label", "facts", "_captures_identity"):
            getattr(self, name)  # computed once, before the copy
        plan = copy(self)
        vars(plan).update(cell=cell)  # the class is frozen
        vars(plan).pop("key", None)
        return plan

    @cached_property
    def key(self) -> str:
        """Key of the run: a digest of all that its stored numbers depend on.

        docs/notes/decisions.md says what that is (identity).
        """
        text = json.dumps(self.identity(), sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    def identity(self) -> dict[str, object]:
        """Identity of the results: corpus, chosen captures, folds, cell, threads of a fold."""
        return self._captures_identity | {"threads": self.threads} | self.cell.identity()

    @cached_property
    def _captures_identity(self) -> dict[str, object]:
        """Identity of the captures and folds."""
        folds = hashlib.sha256()
        for fold in self.folds:
            for positions in (fold.train, fold.test, *itertools.chain.from_iterable(fold.pairs)):
                folds.update(f"{fold.name} {len(positions)} ".encode())
                folds.update(np.asarray(positions, np.int64).tobytes())
        return {
            "digest": self.corpus.digest,
            "captures": captures_digest(self.corpus),
            "folds": folds.hexdigest(),
        }


def make_plans(cells: Iterable[Cell], jobs: int | None) -> list[Plan]:
    """Make a plan for each cell, and check all that can be checked before the first fold starts.

    Cells on the same captures under the same protocol share corpus, folds, and what is computed
    from them.

    Raises:
        InputError: a system, its protocol and the captures do not fit together.
    """
    plans: list[Plan] = []
    first_plans: dict[tuple, Plan] = {}
    for cell in cells:
        estimator, protocol = check_system(cell), cell.protocol
        captures = cell.data, repr(cell.data_parameters), cell.where, cell.target, cell.also
        tested_by = repr(protocol), protocol.module, id(protocol.instance)
        group = *captures, cell.kind, repr(cell.skin), *tested_by
        is_first = group not in first_plans
        corpus = captures_of_cell(cell) if is_first else first_plans[group].corpus
        contract.check_conditions(estimator, corpus)
        if cell.circumstances and corpus.steps:
            keys = ", ".join(f"{circumstance.key}=" for circumstance in cell.circumstances)
            raise InputError(f"protocol={protocol} tests windows, not captures; leave {keys} out")
        if is_first:
            folds = tuple(make_folds(cell, corpus))
            first_plans[group] = Plan(cell, corpus, folds, *share_cores(jobs, len(folds)))
            _refuse_repeated_captures(first_plans[group])
        for features in cell.feature_sets().values():
            if isinstance(features, FunctionFeatures):
                one_of_each = np.unique(corpus.gestures, return_index=True)[1]
                features.check_captures(corpus[one_of_each])
        plan = first_plans[group].with_cell(cell)
        if contract.check_training.find_method(estimator):
            gestures = corpus.gestures
            for fold in plan.folds:
                contract.check_training(estimator, corpus[fold.train], gestures[fold.train])
        check_extensions(plan)
        plans.append(plan)
    return plans


def _refuse_repeated_captures(plan: Plan) -> None:
    """Refuse a split of people whose training part has a test capture under another subject."""
    cell, corpus = plan.cell, plan.corpus
    pairs = [(i, j) for i, j in plan.repeated_captures if corpus.subjects[i] != corpus.subjects[j]]
    if not pairs or plan.mixes_subjects:
        return
    tested, trained = pairs[0]
    where = excluding_condition(corpus, tested)
    if cell.where:
        where = f"({cell.where}) and ({where})"
    names = [f"{corpus.index[i]} (subject {corpus.subjects[i]})" for i in (tested, trained)]
    raise InputError(
        f"protocol={cell.protocol}: captures that are in training under another subject: "
        f"{len(pairs)}, such as {' and '.join(names)}; leave this one out with "
        f'where="{where}"; for all: bench data show {cell.data}'
    )


def check_extensions(plan: Plan) -> None:
    """Refuse captures and protocols with which the measurements of a cell are impossible."""
    cell, columns = plan.cell, frozenset[str]()
    if cell.extensions:
        from bench.values.stability import COLUMNS

        columns = COLUMNS if cell.circumstances else columns
    columns = columns.union(*(each.columns for each in cell.extensions))
    if taken := reserved_names(map(str, plan.corpus.captures), columns):
        raise InputError(
            f"{plan.corpus.name} has a column {min(taken)!r}, a name that tables of results use; "
            "rename the column and import again"
        )
    if cell.circumstances and any(fold.pairs for fold in plan.folds):
        raise InputError(
            f"protocol={cell.protocol} has several systems in a fold, "
            f"{cell.circumstances[0].key}= tests one; leave one of them out"
        )
    for extension in cell.extensions:
        extension.check_plan(plan)


def check_system(cell: Cell) -> contract.System:
    """Check the parameters of a system and of its feature sets; return it untrained, not to fit."""
    refuse_long_values(cell)
    name = cell.model.short_name
    try:
        system = cell.untrained_system
    except InputError:
        raise
    except Exception as e:  # a constructor of the user's may raise anything
        reason = one_line(f"{type(e).__name__}: {e}", 200)
        raise InputError(f"model={name}: it cannot be made: {reason}") from e
    contract.check_methods(name, system)
    contract.check_sklearn_values(name, system)
    for part in (system, *cell.feature_sets().values()):
        contract.check_parameters(part)
    return system


def refuse_long_values(cell: Cell) -> None:
    """Refuse typed values that the store would cut off, so that the run could not be found."""
    values = {"where": cell.where} if cell.objects else cell.arguments()
    if len(json.dumps(values)) > MOST_STORED:
        key = max(values, key=lambda key: len(values[key]))
        raise InputError(
            f"{key}= has {len(values[key])} characters; all values of a run may have {MOST_STORED} "
            "together: write a shorter one, or import these captures as a corpus of their own"
        )


def captures_of_cell(cell: Cell) -> Corpus:
    """Load the captures of a cell, with those that its protocol adds.

    Raises:
        InputError: they have fewer than two classes.
    """
    joined = getattr(cell.splitter, "joined", None)
    if cell.also:
        _check_added(cell, bool(joined))
    if cell.design and joined:
        raise InputError(
            f"protocol={cell.protocol}: its training captures come from another skin, which has "
            "no design; leave skin. out"
        )
    if cell.run_kind and (own := cell.run_kind.open_captures(cell)) is not None:
        return own
    captures = cell.data, cell.data_parameters, cell.where, cell.target, cell.design, cell.also
    corpus = load_captures(*captures)
    corpus = joined(corpus) if joined else corpus
    if len(set(corpus.gestures)) < 2:
        where = f" where={quote_value(cell.where)}" if cell.where else ""
        raise InputError(
            f"data={cell.data}{where}: only one {corpus.target} is left; choose captures of two "
            "or more"
        )
    return corpus


def _check_added(cell: Cell, has_own_captures: bool) -> None:
    """Refuse `also=` where its captures cannot be in training alone."""
    conflicts = {
        f"bench {cell.command}": cell.run_kind is not None,
        "skin.": cell.design is not None,
        f"target={cell.target}": cell.target != "gesture",
        f"protocol={cell.protocol}": has_own_captures,
    }
    for key, is_conflict in conflicts.items():
        if is_conflict:
            raise InputError(f"also= and {key} exclude each other; leave one of them out")


def load_captures(
    data: str,
    parameters: dict[str, object],
    where: str,
    target: str,
    design: Any = None,
    also: str = "",
) -> Corpus:
    """Load the captures of a corpus that satisfy a condition, with the classes of a target.

    With a design, as that skin measures them (`bench.corpora.skin`). With ``also``, captures of
    other corpora with the same classes follow, which are in training alone.
    """
    corpus = open_corpus(data, parameters, design, also)
    if where and also:
        tested = corpus[~corpus.is_added].select(where)
        is_used = corpus.is_added & np.isin(corpus.gestures, tested.gestures)
        corpus = corpus[is_used | np.isin(corpus.index, tested.index)]
    elif where:
        corpus = corpus.select(where)
    return corpus if target == "gesture" else corpus.with_target(target)


def make_folds(cell: Cell, corpus: Corpus) -> list[Fold]:
    """Split captures into the folds of a protocol.

    If no fold trains on its test subjects, a fold with one test subject is named after it. If two
    names would be equal, all folds are numbered.

    Raises:
        InputError: a fold tests a class that it does not train.
    """
    gestures, subjects = corpus.gestures, corpus.subjects
    with warnings.catch_warnings():  # of a splitter that needs no subjects
        warnings.filterwarnings("ignore", "The groups parameter is ignored by")
        folds = [
            Fold("", _as_positions(train), _as_positions(test), *pairs)
            for train, test, *pairs in split_captures(cell.splitter, corpus)
        ]
    names = numbers = [f"fold{i + 1:02d}" for i in range(len(folds))]
    if not mixes_subjects(corpus, folds):
        tested = [pd.unique(subjects[fold.test]) for fold in folds]
        pairs = zip(numbers, tested, strict=True)
        names = [people[0] if len(people) == 1 else number for number, people in pairs]
    if len({*names}) < len(folds):  # random splits may test a subject twice
        names = numbers
    untaught = corpus.info.get(UNTAUGHT, [])
    taught = ~np.isin(gestures, untaught)
    for fold, name in zip(folds, names, strict=True):
        fold.name, fold.train = name, fold.train[taught[fold.train]]
        unknown = untrained_classes(gestures, fold.train, fold.test)
        if lacking := [label for label in unknown if label not in untaught]:
            leave_out = f"leave it out with where=\"{corpus.target} != '{lacking[0]}'\" or "
            raise InputError(
                f"protocol={cell.protocol}: fold {fold.name} tests {corpus.target} {lacking[0]} "
                "but has no training capture of it; "
                f"{leave_out * ('+' not in corpus.target)}choose another protocol"
            )
    return folds


def split_captures(splitter: Splitter, corpus: Corpus) -> Iterable[Any]:
    """Folds of a splitter; captures of `also=` are in training in each, and are not split."""
    if not corpus.is_added.any():
        return splitter.split(corpus, corpus.gestures, corpus.subjects)
    own, added = np.flatnonzero(~corpus.is_added), np.flatnonzero(corpus.is_added)
    tested, splits = corpus[own], []
    folds: Iterable[Any] = splitter.split(tested, tested.gestures, tested.subjects)
    for train, test, *further in folds:
        sides = np.concatenate([own[train], added]), own[test]
        pairs = ([(own[shots], own[judged]) for shots, judged in each] for each in further)
        splits.append((*sides, *pairs))
    return splits


def _as_positions(side: np.ndarray) -> np.ndarray:
    """Positions of captures, of a mask too."""
    side = np.asarray(side)
    return (np.flatnonzero(side) if side.dtype == bool else side).astype(np.int32)


def mixes_subjects(corpus: Corpus, folds: Iterable[Fold]) -> bool:
    """Return True if a fold trains and tests captures of the same subject."""
    codes = pd.factorize(corpus.subjects, use_na_sentinel=False)[0]
    return any(np.isin(codes[fold.test], codes[fold.train]).any() for fold in folds)


def ratio_of_test_to_training(folds: Sequence[Fold]) -> float | None:
    """Tested by training captures over all folds; None if no two folds share training captures."""
    positions = [np.zeros(0, int), *(np.unique(fold.train) for fold in folds)]
    if np.bincount(np.concatenate(positions)).max(initial=0) <= 1:
        return None
    return sum(len(fold.test) for fold in folds) / sum(len(fold.train) for fold in folds)


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_cores(jobs: int | None, folds: int) -> tuple[int, int]:
    """Numbers of worker processes, and of threads in each, whose product fits the cores.

    Raises:
        InputError: ``jobs`` is below 1.
    """
    cores = usable_cores()
    if jobs is not None and jobs < 1:
        raise InputError(
            f"jobs={jobs}: give at least 1, or leave it out for {cores} (the cores of this machine)"
        )
    jobs = min(jobs or cores, folds, cores)
    return jobs, max(1, cores // jobs)
