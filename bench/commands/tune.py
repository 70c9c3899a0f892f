"""The command ``bench tune``: like ``bench run``, with the parameters of each model searched in every training part."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

from bench import contract
from bench.amounts import convert, text_of
from bench.arguments import backend_of, parse, settings
from bench.commands.kind import evaluated, printed
from bench.commands.smallest import smallest
from bench.errors import InputError, nearest
from bench.models.recipe import besides
from bench.options import keys
from bench.plan.cells import Cell, cells
from bench.registry import parameters
from bench.result import Result
from bench.words import DEFAULTS, Values, items

if TYPE_CHECKING:
    from bench.models.search.space import How, Space, Tuning


def tune(arguments: list[str]) -> int:
    """Search, fit and score; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    return printed("run", searched(parse(arguments, keys("tune"))))


def searched(values: Values) -> list[Result]:
    """The cells of some values, each a search.

    Listed values of a model's parameters are tried. Where no parameter has several, the ranges that the model declares
    are searched, and single values are kept. ``smallest`` of a parameter looks for its smallest value instead.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    if "smallest" in values:
        return smallest(values)
    given = settings("tune", values)
    how = cast("How", {k: given[k] for k in ("trials", "inner") if k in values})
    if given["seconds"]:
        how["seconds"] = given["seconds"]
    params = {k.partition(".")[2]: v for k, v in values.items() if k.startswith("model.")}
    if "seed" in params:
        raise InputError(f"model.seed={params['seed']}: give seed= instead, which also sets the seed of the search")
    own = {*given, "seed"}
    rest = {k: v for k, v in values.items() if not k.startswith("model.") and k not in own}
    untuned = cells(rest)
    names = {name for cell in untuned for name in _parameters(cell)}
    for name in params:
        if name not in names:
            raise InputError(
                f"model={values.get('model', DEFAULTS['model'])} has no parameter {name!r}; {nearest(name, names)}"
            )
    seeds = [convert("seed", text, 0) for text in items("seed", values.get("seed", DEFAULTS["seed"]))]
    tuned = [
        replace(cell, tuning=_tuning(cell, params, how, given["trials"]) | {"seed": seed})
        for cell in untuned
        for seed in seeds
    ]
    return evaluated(tuned, backend_of(values))


def _parameters(cell: Cell) -> dict[str, object]:
    """What a model takes, its own parameters first."""
    if cell.model.instance is not None:
        return cell.model.parameters
    return parameters(cell.model.factory) | besides(cell.model.factory)


def _values(name: str, listed: object, default: object) -> list[object]:
    """The values of a list, each of the type of the default; several names together stay joined by +."""
    values = [convert(f"model.{name}", value, default) for value in items(f"model.{name}", listed)]
    return list(dict.fromkeys(text_of(value) if isinstance(value, tuple) else value for value in values))


def _tuning(cell: Cell, params: dict[str, object], how: How, trials: int) -> Tuning:
    name = cell.model.short
    if cell.model.instance is not None:
        raise InputError(f"model={name}: an object has fixed parameters; give the name of its class or factory")
    if contract.searches(cell.untrained):
        raise InputError(f"model={name} searches by itself; use bench run model={name}")
    defaults = _parameters(cell)
    listed = {k: _values(k, values, defaults[k]) for k, values in params.items() if k in defaults}
    space: Space = {**listed}
    if all(len(values) == 1 for values in listed.values()):
        declared = contract.space(cell.model.factory)
        if declared is None:
            searchable = [key for key in defaults if key not in ("seed", "device", "batch")]
            raise InputError(
                f"model={name} declares no ranges to search; list values such as "
                f"model.{next(iter(searchable), 'parameter')}=1,2, or give the model an attribute space"
            )
        space = {**declared, **listed}
    is_grid = all(isinstance(values, list) for values in space.values())
    return {"space": space, **how} if is_grid else {"space": space, "trials": trials, **how}
