"""The command ``bench tune``: like ``bench run``, with the parameters of each model searched in every training part."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

from bench import contract
from bench.arguments import Values, backend_of, convert, items, parse, text_of
from bench.commands.printing import one_label, show, then
from bench.commands.run import evaluated
from bench.errors import InputError, nearest
from bench.options import keys
from bench.plan.cells import Cell, cells
from bench.registry import parameters
from bench.work.loop import Outcome
from models.recipe import besides

if TYPE_CHECKING:
    from models.search.space import How, Space, Tuning

OPTIONS: How = {"trials": 50, "inner": "3", "budget": float("inf"), "objective": "accuracy"}
KEYS = keys("tune")


def tune(arguments: list[str]) -> int:
    """Search, fit and score; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    outcomes = searched(parse(arguments, KEYS))
    code = show(outcomes)
    one_label(outcomes)
    then("bench choose")
    return code


def searched(values: Values) -> list[Outcome]:
    """The cells of some values, each a search.

    Values of a model's parameters that are given are the ones that are tried; without a list of several among them, the
    ranges that the model declares are searched, and what is given is kept.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    # Of the type of the default, each of them.
    how = cast("How", {k: convert(k, values[k], default) for k, default in OPTIONS.items() if k in values})
    given = {k.partition(".")[2]: v for k, v in values.items() if k.startswith("model.")}
    if "seed" in given:
        raise InputError(f"model.seed={given['seed']}: give seed= instead, it is that of the search too")
    asked = cells({k: v for k, v in values.items() if not k.startswith("model.") and k != "seed" and k not in OPTIONS})
    known = {name for cell in asked for name in _parameters(cell)}
    for name in given:
        if name not in known:
            raise InputError(f"model={values.get('model', 'svm')} has no parameter {name!r}; {nearest(name, known)}")
    seeds = [convert("seed", text, 0) for text in items("seed", values.get("seed", "0"))]
    tuned = [replace(cell, tuning=_tuning(cell, given, how) | {"seed": seed}) for cell in asked for seed in seeds]
    return evaluated(tuned, backend_of(values))


def _parameters(cell: Cell) -> dict[str, object]:
    """What a model takes, its own parameters first."""
    if cell.model.given is not None:
        return cell.model.parameters
    return parameters(cell.model.factory) | besides(cell.model.factory)


def _values(name: str, given: object, usual: object) -> list[object]:
    """The values of a list, each of the type of the default; several names together stay joined by +."""
    found = [convert(f"model.{name}", value, usual) for value in items(f"model.{name}", given)]
    return [text_of(value) if isinstance(value, tuple) else value for value in found]


def _tuning(cell: Cell, given: dict[str, object], how: How) -> Tuning:
    name = cell.model.short
    if cell.model.given is not None:
        raise InputError(f"model={name}: an object is what it is; give its class or a factory by name to search")
    if contract.searches(cell.estimator()):
        raise InputError(f"model={name} searches by itself; use bench run model={name}")
    usual = _parameters(cell)
    listed = {name: list(dict.fromkeys(_values(name, given[name], usual[name]))) for name in given if name in usual}
    space: Space = {**listed}
    if all(len(values) == 1 for values in listed.values()):
        declared = contract.space(cell.model.factory)
        if declared is None:
            raise InputError(
                f"model={name} declares no ranges to search; list values, such as "
                f"model.{next(iter(usual), 'parameter')}=1,2, or give it an attribute space"
            )
        space = {**declared, **listed}
    whole = all(isinstance(values, list) for values in space.values())
    return {"space": space, **how} if whole else {"space": space, "trials": OPTIONS["trials"], **how}
