"""Systems that were not run yet, and how large they will be, of those that do not grow with the captures."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.plan.arguments import Values
from bench.plan.cells import Cell, cells
from bench.registry import load, names
from bench.work.fold import computing
from models import contract
from models.sizes import sizes

SETS = ("jung28", "jung54")  # feature sets of whole captures that are small
FEW, MORE = 2, 8  # captures of each class


def known_sizes(cell: Cell, corpus: Corpus) -> dict[str, float] | None:
    """Flash and RAM in kB as `bench run` counts them, None if they are not known before the system is run.

    It is fitted twice, to four times as many captures the second time, and to shuffled labels the first: whatever
    keeps captures, grows on them or chooses its size gets another one. What is as large both times is as large on the
    whole corpus. What the numbers are does not matter, so a network learns for one epoch or update.

    Args:
        cell: the system.
        corpus: all captures: a window may be as long as the longest.
    """
    try:
        found = [_fitted(cell, corpus, number, shuffled=number == FEW) for number in (FEW, MORE)]
    except Exception:  # a system may refuse so few captures in any way that it likes
        return None
    return found[0] if found[0] == found[1] else None


def _fitted(cell: Cell, corpus: Corpus, number: int, shuffled: bool) -> dict[str, float] | None:
    """Sizes after a fit to so many captures of each class; None of what searches its size."""
    quick = {name: 1 for name in ("epochs", "updates") if name in cell.model.parameters}
    cell = replace(cell, model=replace(cell.model, parameters=cell.model.parameters | quick))
    estimator = cell.estimator()
    if contract.searches(estimator):
        return None
    few = corpus[_spread(corpus, number)].detached()  # the cache would compute the features of all captures
    labels = np.random.default_rng(0).permutation(few.gestures) if shuffled else few.gestures
    with computing(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of so few captures
        estimator.fit(few, labels)
    last = estimator.steps[-1][1] if isinstance(estimator, Pipeline) else estimator
    if "tree_" in vars(last):  # cut back, it may be its root alone both times
        return None
    found = sizes(estimator, corpus.grid[0] * corpus.grid[1], int(corpus.lengths.max()))
    return {name: found[f"{name}_bytes"] / 1000 for name in ("flash", "ram")}


def _spread(corpus: Corpus, number: int) -> np.ndarray:
    """Positions of so many captures of each class, of as many subjects as there are, the longest of each first."""
    table = pd.DataFrame({"class": corpus.gestures, "subject": corpus.subjects, "frames": corpus.lengths})
    table = table.sort_values("frames", ascending=False, kind="stable")
    turn = table.groupby(["class", "subject"]).cumcount()
    return np.sort(table.loc[turn.sort_values(kind="stable").index].groupby("class").head(number).index.to_numpy())


def unrun(on: Values, asked: Mapping[str, list], run: set[str]) -> list[Cell]:
    """Systems with their usual parameters that were not run yet.

    Args:
        on: arguments for data, subset, target and protocol.
        asked: names of ``model`` and ``features`` to stay among; without them every model, on `SETS`.
        run: systems that were run, as tables name them.

    Raises:
        InputError: there is no such model or feature set.
    """
    among = {key: asked[key] for key in ("model", "features") if key in asked}
    if "model" not in asked:
        among = {"features": list(SETS), **among, "model": [name for name in names("models") if _installed(name)]}
    return [cell for cell in cells({**on, **among}) if cell.system() not in run]


def _installed(model: str) -> bool:
    """Whether all that a model imports is here."""
    try:
        load("models", model)
    except InputError:
        return False
    return True
