"""``bench skin wired=``: which taxels of a skin to wire, chosen one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from bench.commands.run import run_complete
from bench.corpora.skin import Design
from bench.errors import InputError, check_value
from bench.ground.typed import Values
from bench.plan.cells import Cell, Part
from bench.plan.plan import load_captures
from bench.reading.designs import TaxelOrder


def order_taxels(cell: Cell, count: int, values: Values) -> list[TaxelOrder]:
    """Add taxels one after the other, or remove them if that is shorter; for two halves of people.

    Each step takes the taxel with which the system is the most accurate on people of the half, each
    left out in turn. The accuracy on the other half is of systems trained on all but the person.
    Recorded taxels that lie in two of the design are wired to neither.

    Args:
        cell: the system on one design, whose taxels are all wired.
        count: number of taxels to be wired.
        values: typed values, which name the workers.
    """
    corpus = load_captures(cell.data, cell.data_parameters, cell.where, cell.target)
    people, design = [*dict.fromkeys(corpus.subjects)], cell.design or Design()
    if design.taxels:
        names = "+".join(design.taxels)
        raise InputError(f"skin.taxels={names}: wired= chooses the taxels; leave one of them out")
    shape = tuple(map(int, design.grid.split("x"))) if design.grid else corpus.grid
    if len(people) < 4:
        raise InputError(f"wired={count}: two halves of people need four; widen where=")
    number = shape[0] * shape[1]
    check_value("wired", count, 1 <= count < number, f"1 to {number - 1}")
    rows, cols = map(_taxel_of_line, corpus.grid, shape)
    merged = (rows[:, None] * shape[1] + cols).ravel()  # taxel of each recorded one
    is_whole = ((rows[:, None] >= 0) & (cols >= 0)).ravel()  # none lies in two taxels
    places = np.unique(merged[is_whole])
    recorded = "x".join(map(str, corpus.grid))
    advice = f"a grid of whole taxels of the recorded {recorded}"
    check_value("skin.grid", design.grid, len(places) == number, advice)
    is_adding = 2 * count <= number
    orders = []

    def wire(changed: Sequence[int], where: str) -> Cell:
        wired = 1 + np.flatnonzero(is_whole & (np.isin(merged, changed) == is_adding))
        runs = np.split(wired, np.flatnonzero(np.diff(wired) > 1) + 1)
        channels = tuple(f"{run[0]}-{run[-1]}" for run in runs)
        skin = Part("skins", "design", asdict(replace(design, taxels=channels)))
        return replace(cell, skin=skin, where=where)

    for half in (people[::2], people[1::2]):
        where = f"subject in {half}" if not cell.where else f"({cell.where}) and subject in {half}"
        path: list[int] = []
        for _ in range(count if is_adding else number - count):
            rest = [i for i in range(number) if i not in path]
            results = run_complete([wire([*path, i], where) for i in rest], values)
            means = [np.mean([*result.accuracy_by_subject.values()]) for result in results]
            path.append(rest[int(np.argmax(means))])
        steps = np.arange(1, len(path) + 1)
        results = run_complete([wire(path[:step], cell.where) for step in steps], values)
        others = [name for name in people if name not in half]
        accuracy = [[r.accuracy_by_subject[name] for name in others] for r in results]
        order = np.zeros(number, int)
        order[path] = steps
        wired = steps if is_adding else number - steps
        verb = "added" if is_adding else "removed"
        shares = np.array(accuracy)
        orders.append(TaxelOrder(half, verb, order.reshape(shape), wired.tolist(), shares))
    return orders


def _taxel_of_line(count: int, wanted: int) -> np.ndarray:
    """Merged line that each recorded one lies in; -1 for a line that lies in two."""
    lines = np.arange(count)
    first, last = lines * wanted // count, ((lines + 1) * wanted - 1) // count
    return np.where(first == last, first, -1)
