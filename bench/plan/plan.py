"""A cell with its captures and folds, and the number of processes: everything fixed before a run."""

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
from bench.corpora.corpus import Corpus, untrained
from bench.corpora.duplicates import repeated, seen_before, without
from bench.corpora.library import UNTAUGHT, open_corpus
from bench.errors import InputError
from bench.ground.words import quoted
from bench.plan.cells import Cell


@dataclass(eq=False)
class Fold:
    """A split of the captures of a corpus, by position."""

    name: str  # the tested subject, or a number
    train: np.ndarray  # positions of the training captures, int32 [captures]
    test: np.ndarray  # positions of the test captures, int32 [captures]
    pairs: Sequence[
        tuple[np.ndarray, np.ndarray]
    ] = ()  # of some protocols: further training captures, tested after


@dataclass(frozen=True)
class Plan:
    """The content of one run.

    Cached properties depend on corpus, folds and protocol, not on the system: `of` shares them.
    """

    cell: Cell  # the system and how it is tested
    corpus: Corpus
    folds: tuple[Fold, ...]  # all of them, in the order of the protocol
    workers: int  # processes
    threads: int  # of each process

    @cached_property
    def mixes_subjects(self) -> bool:
        """True if captures of a subject are on both sides of a fold: optimistic for a new person."""
        return mixes_subjects(self.corpus, self.folds)

    @cached_property
    def repeats(self) -> list[tuple[int, int]]:
        """Tested captures with the same frames as a training capture, and that one: a pair for each tested capture."""
        sides = [side for fold in self.folds for side in ((fold.train, fold.test), *fold.pairs)]
        return seen_before(repeated(self.corpus), sides, len(self.corpus))

    @cached_property
    def label(self) -> str:
        """The protocol in words, distinct for runs on other splits: it names a seed that is not the default."""
        part = self.cell.protocol
        if (own := getattr(self.cell.splitter, "label", None)) is None:
            return str(part) + ", subjects mixed" * self.mixes_subjects
        words, seed = own(self.corpus), part.changed().get("seed")
        return (
            words
            if seed is None or re.search(rf"\bseed {seed}\b", words)
            else f"{words}, seed {seed}"
        )

    @cached_property
    def facts(self) -> dict[str, str]:
        """Properties of the protocol for statistics and tables; ``""`` for missing ones."""
        published = getattr(self.cell.splitter, "official_split", None)
        official = published(self.corpus) if published else None
        ratio = shared_ratio(self.folds)
        return {
            "mixes_subjects": str(self.mixes_subjects).lower(),
            "test_over_train": "" if ratio is None else repr(ratio),
            "official_split": "" if official is None else str(official).lower(),
        }

    def of(self, cell: Cell) -> Plan:
        """The plan of another cell on the same captures with the same protocol."""
        for name in ("label", "facts", "_captures"):
            getattr(self, name)  # computed once, before the copy
        other = copy(self)
        vars(other).update(cell=cell)  # the class is frozen
        vars(other).pop("key", None)
        return other

    @cached_property
    def key(self) -> str:
        """Key of the run: everything that its stored numbers depend on (docs/notes/decisions.md, identity)."""
        return hashlib.sha256(
            json.dumps(self.identity(), sort_keys=True, default=str).encode()
        ).hexdigest()[:20]

    def identity(self) -> dict[str, object]:
        """Identity of its results: corpus, chosen captures, folds, cell, threads of a fold."""
        return self._captures | {"threads": self.threads} | self.cell.identity()

    @cached_property
    def _captures(self) -> dict[str, object]:
        """Identity of the captures and folds."""
        folds = hashlib.sha256()
        for fold in self.folds:
            for positions in (fold.train, fold.test, *itertools.chain.from_iterable(fold.pairs)):
                folds.update(
                    f"{fold.name} {len(positions)} ".encode()
                    + np.asarray(positions, np.int64).tobytes()
                )
        return {
            "digest": self.corpus.digest,
            "captures": hashlib.sha256(self.corpus.index.tobytes()).hexdigest(),
            "folds": folds.hexdigest(),
        }


def planned(cells: list[Cell], jobs: int | None) -> list[Plan]:
    """A plan for each cell; all that can be checked is checked before the first fold starts.

    Cells on the same captures with the same protocol share corpus, folds, and what is computed from them.
    """
    plans: list[Plan] = []
    first: dict[tuple, Plan] = {}
    for cell in cells:
        estimator, part = checked(cell), cell.protocol
        of_data = cell.data, repr(cell.data_parameters), cell.where, cell.target, cell.kind
        key = *of_data, repr(part), part.module, id(part.instance)
        new = key not in first
        corpus = corpus_of(cell) if new else first[key].corpus
        contract.check_conditions(estimator, corpus)
        if cell.circumstances and corpus.steps:
            keys = ", ".join(f"{circumstance.key}=" for circumstance in cell.circumstances)
            raise InputError(
                f"protocol={cell.protocol} tests windows, not captures; leave {keys} out"
            )
        if new:
            folds = tuple(folds_of(cell, corpus))
            first[key] = Plan(cell, corpus, folds, *share_cores(jobs, len(folds)))
            refuse_repeats(first[key])
        plans.append(first[key].of(cell))
        if contract.check_training.of(estimator):
            gestures = corpus.gestures
            for fold in plans[-1].folds:
                contract.check_training(estimator, corpus[fold.train], gestures[fold.train])
    return plans


def refuse_repeats(plan: Plan) -> None:
    """Refuse a protocol that separates people if a recording of two of them is on both sides of a fold."""
    cell, corpus = plan.cell, plan.corpus
    pairs = [(i, j) for i, j in plan.repeats if corpus.subjects[i] != corpus.subjects[j]]
    if not pairs or plan.mixes_subjects:
        return
    tested, trained = pairs[0]
    where = (
        f"({cell.where}) and ({without(corpus, tested)})" if cell.where else without(corpus, tested)
    )
    pair = " and ".join(
        f"{corpus.index[i]} (subject {corpus.subjects[i]})" for i in (tested, trained)
    )
    raise InputError(
        f"protocol={cell.protocol}: captures that are in training under another subject: {len(pairs)}, such as {pair}; "
        f'leave this one out with where="{where}"; for all: bench data show {cell.data}'
    )


def checked(cell: Cell) -> contract.System:
    """The untrained system of a cell, its parameters and those of its feature sets checked; it is not to be fitted."""
    for part in (cell.untrained, *cell.feature_sets().values()):
        contract.check(part)
    return cell.untrained


def corpus_of(cell: Cell) -> Corpus:
    """The captures that a cell is about, with others that its protocol trains on; at least two classes."""
    if cell.study and (own := cell.study.captures(cell)) is not None:
        return own
    corpus = captures_of(cell.data, cell.data_parameters, cell.where, cell.target)
    joined = getattr(cell.splitter, "joined", None)
    corpus = joined(corpus) if joined else corpus
    if len(set(corpus.gestures)) < 2:
        where = f" where={quoted(cell.where)}" if cell.where else ""
        raise InputError(
            f"data={cell.data}{where}: only one {corpus.target} is left; choose captures of two or more"
        )
    return corpus


def captures_of(data: str, parameters: dict[str, object], where: str, target: str) -> Corpus:
    """The captures of a corpus that satisfy a condition, with the classes of a target."""
    corpus = open_corpus(data, parameters)
    corpus = corpus.select(where) if where else corpus
    return corpus if target == "gesture" else corpus.with_target(target)


def folds_of(cell: Cell, corpus: Corpus) -> list[Fold]:
    """All folds of a protocol, named after the tested subject where there is just one; none tests an unknown class."""
    gestures, subjects = corpus.gestures, corpus.subjects
    with warnings.catch_warnings():  # of a splitter that needs no subjects
        warnings.filterwarnings("ignore", "The groups parameter is ignored by")
        split: Iterable[Any] = cell.splitter.split(corpus, gestures, subjects)
        folds = [
            Fold("", _positions(train), _positions(test), *pairs) for train, test, *pairs in split
        ]
    numbers, tested = (
        [f"fold{i + 1:02d}" for i in range(len(folds))],
        [pd.unique(subjects[f.test]) for f in folds],
    )
    mixed = mixes_subjects(corpus, folds)
    alone = [
        who[0] if len(who) == 1 and not mixed else n for n, who in zip(numbers, tested, strict=True)
    ]
    distinct = len({*alone}) == len(folds)  # random splits may test the same subject twice
    untaught = corpus.info.get(UNTAUGHT, [])
    taught = ~np.isin(gestures, untaught)
    for fold, name in zip(folds, alone if distinct else numbers, strict=True):
        fold.name, fold.train = name, fold.train[taught[fold.train]]
        if lacking := [
            label for label in untrained(gestures, fold.train, fold.test) if label not in untaught
        ]:
            leave = (
                ""
                if "+" in corpus.target
                else f"leave it out with where=\"{corpus.target} != '{lacking[0]}'\" or "
            )
            raise InputError(
                f"protocol={cell.protocol}: fold {fold.name} tests {corpus.target} {lacking[0]} but has no training "
                f"capture of it; {leave}choose another protocol"
            )
    return folds


def _positions(side: np.ndarray) -> np.ndarray:
    side = np.asarray(side)
    return (np.flatnonzero(side) if side.dtype == bool else side).astype(np.int32)


def mixes_subjects(corpus: Corpus, folds: list[Fold] | tuple[Fold, ...]) -> bool:
    """Return True if a fold trains and tests captures of the same subject."""
    codes = pd.factorize(corpus.subjects, use_na_sentinel=False)[0]
    return any(np.isin(codes[fold.test], codes[fold.train]).any() for fold in folds)


def shared_ratio(folds: tuple[Fold, ...]) -> float | None:
    """Tested by training captures over all folds, None where no two folds share training captures."""
    counts = np.bincount(
        np.concatenate([np.zeros(0, int), *(np.unique(fold.train) for fold in folds)])
    )
    shared = counts.max(initial=0) > 1
    return (
        sum(len(fold.test) for fold in folds) / sum(len(fold.train) for fold in folds)
        if shared
        else None
    )


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_cores(jobs: int | None, folds: int) -> tuple[int, int]:
    """Worker processes and threads in each, so that their product fits the cores."""
    cores = usable_cores()
    if jobs is not None and jobs < 1:
        raise InputError(
            f"jobs={jobs}: give at least 1, or leave it out for {cores} (the cores of this machine)"
        )
    jobs = min(jobs or cores, folds, cores)
    return jobs, max(1, cores // jobs)
