"""The command ``bench tune``: like ``bench run``, with the parameters of each model searched in every training part."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from bench.commands.run import evaluated, is_dry, printed
from bench.errors import InputError, nearest
from bench.grammar.options import (
    COMPARE,
    DRY,
    WORK,
    Command,
    Option,
    backend_of,
    keys,
    parse,
    settings,
)
from bench.ground.registry import parameters
from bench.ground.words import DEFAULTS, Values, convert, items, text_of

if TYPE_CHECKING:
    from bench.models.space import Space, Tuning
    from bench.plan.cells import Cell
    from bench.values.result import Result

SHARES = (0.125, 0.25, 0.5, 1.0)  # of a parameter's default, where smallest= has no values to try
COMMAND = Command(
    COMPARE,
    "search the parameters of systems inside each training part",
    "Like bench run, but searches the parameters of each model in every training part, on inner folds of whole "
    "subjects. model.C=8,32,128 lists values; without lists, it searches the ranges that the model declares. "
    "Prints and stores the chosen values of each fold and every combination. smallest=X chooses the smallest value "
    "of the parameter X within one standard error of the best one, and runs the unchanged system beside it. It "
    "tries the values of model.X=, or an eighth, a quarter, a half and all of the default. An interrupted search "
    "continues where it stopped.",
    "bench tune data=haart protocol=loso model=svm features=jung54 trials=50\n"
    "bench tune data=haart protocol=challenge model=rf,xgb features=ta273\n"
    "bench tune data=haart protocol=loso model=cnn85 smallest=frames",
    options=(
        *WORK,
        DRY,
        Option(
            "trials",
            "count",
            50,
            "combinations to try in each fold; a grid of lists is tried completely",
        ),
        Option("seconds", "number", None, "seconds after which a fold starts no new combination"),
        Option(
            "smallest", "text", "", "parameter of model= to make as small as possible, or features"
        ),
        Option("inner", "text", "3", "inner folds: number of groups of training subjects, or loso"),
    ),
)


def command(arguments: list[str]) -> int:
    """Search, fit and score; exit code as of ``bench run``."""
    values = parse(arguments, keys("tune"))
    if is_dry(values):
        from bench.commands.grid import foreseen
        from bench.running.loop import prepared

        return foreseen(prepared(_cells(values), backend_of(values).jobs))
    return printed("run", searched(values))


def searched(values: Values) -> list[Result]:
    """The cells of some values, each a search."""
    return evaluated(_cells(values), backend_of(values))


def _cells(values: Values) -> list[Cell]:
    """The systems of some values, each to be searched."""
    return _smallest(values) if "smallest" in values else _tuned(values)


def _tuned(values: Values) -> list[Cell]:
    """A cell for each system and seed."""
    given = settings("tune", values)
    how = {k: given[k] for k in ("trials", "inner", "seconds") if k in values}
    params = {k.partition(".")[2]: v for k, v in values.items() if k.startswith("model.")}
    if "seed" in params:
        raise InputError(
            f"model.seed={params['seed']}: give seed= instead, which also sets the seed of the search"
        )
    untuned = _searchable(
        {
            k: v
            for k, v in values.items()
            if not k.startswith("model.") and k not in {*given, "seed"}
        }
    )
    names = {name for cell in untuned for name in _parameters(cell)}
    if unknown := [name for name in params if name not in names]:
        model = values.get("model", DEFAULTS["model"])
        raise InputError(
            f"model={model} has no parameter {unknown[0]!r}; {nearest(unknown[0], names)}"
        )
    seeds = [
        convert("seed", text, 0) for text in items("seed", values.get("seed", DEFAULTS["seed"]))
    ]
    tunings = [(cell, _tuning(cell, params, how, given["trials"])) for cell in untuned]
    return [
        replace(cell, tuning=tuning | {"seed": seed}) for cell, tuning in tunings for seed in seeds
    ]


def _smallest(values: Values) -> list[Cell]:
    """Each system with the smallest value that suffices, chosen in every fold, and beside it the unchanged system."""
    if wrong := [key for key in ("trials", "seconds") if key in values]:
        raise InputError(
            f"{wrong[0]}= ends a search, and smallest= tries every value; leave one of them out"
        )
    given = settings("tune", values)
    over, inner = given["smallest"], given["inner"]
    found = _searchable({k: v for k, v in values.items() if k not in (*given, f"model.{over}")})
    sizes = [_sizes(cell, over, values.get(f"model.{over}"), inner) for cell in found]
    return [
        each
        for cell, how in zip(found, sizes, strict=True)
        for each in (replace(cell, tuning=how), cell)
    ]


def _searchable(values: Values) -> list[Cell]:
    """The cells of some values, if a search can be around each."""
    from bench import contract
    from bench.plan.cells import cells

    found = cells(values)
    for cell in found:
        name = cell.model.short
        if cell.model.instance is not None:
            raise InputError(
                f"model={name}: an object has fixed parameters; give the name of its class or factory"
            )
        if contract.searches(cell.untrained):
            raise InputError(f"model={name} searches by itself; use bench run model={name}")
    return found


def _parameters(cell: Cell) -> dict[str, object]:
    """What a model takes, its own parameters first."""
    from bench.models.recipe import besides

    return parameters(cell.model.factory) | besides(cell.model.factory)


def _values(name: str, listed: object, default: object) -> list[object]:
    """The values of a list, each of the type of the default; several names together stay joined by +."""
    typed = [convert(f"model.{name}", value, default) for value in items(f"model.{name}", listed)]
    values = [text_of(value) if isinstance(value, tuple) else value for value in typed]
    if twice := [value for value in dict.fromkeys(values) if values.count(value) > 1]:
        raise InputError(
            f"model.{name}: the value {twice[0]} stands twice; give different ones, or one to fix it"
        )
    return values


def _tuning(cell: Cell, params: dict[str, object], how: dict[str, object], trials: int) -> Tuning:
    """How a search picks the best values: of lists where a parameter has several, else of the declared ranges."""
    from bench import contract

    name, defaults = cell.model.short, _parameters(cell)
    space: Space = {
        k: _values(k, values, defaults[k]) for k, values in params.items() if k in defaults
    }
    if all(len(values) == 1 for values in space.values()):  # single values are kept
        if (declared := contract.space(cell.model.factory)) is None:
            first = next(
                (key for key in defaults if key not in ("seed", "device", "batch")), "parameter"
            )
            raise InputError(
                f"model={name} declares no ranges to search; list values such as model.{first}=1,2, or give the model "
                "an attribute space"
            )
        space = {**declared, **space}
    is_grid = all(isinstance(values, list) for values in space.values())
    return {"space": space, **how} if is_grid else {"space": space, "trials": trials, **how}


def _sizes(cell: Cell, over: str, listed: object, inner: str) -> Tuning:
    """How a search picks the smallest value; all parameters but that one stay as they are."""
    model, usual = cell.model.short, parameters(cell.model.factory)
    space: Space = {
        k: [v] for k, v in cell.model.parameters.items() if v != usual[k] and k != "seed"
    }
    seed = cell.seed if "seed" in cell.model.parameters else 0
    how = {"inner": inner, "objective": "smallest", "smallest": over, "seed": seed}
    if over == "features":
        if not cell.features:
            raise InputError(
                f"smallest=features: model={model} uses no feature set; give one of its parameters"
            )
        return {"space": space, **how}
    default = usual.get(over)
    if over == "seed" or over not in usual:
        raise InputError(
            f"smallest={over}: {nearest(over, [*(set(usual) - {'seed'}), 'features'])}"
        )
    if isinstance(default, bool) or not isinstance(default, int | float):
        raise InputError(
            f"smallest={over}: not a number, so it has no sizes; give a numeric parameter"
        )
    if listed is None:
        sizes = {type(default)(default * share) for share in SHARES} - {0}
    else:
        sizes = {convert(f"model.{over}", text, default) for text in items(f"model.{over}", listed)}
    if not sizes:
        raise InputError(
            f"smallest={over}: its default is {default}; give values, such as model.{over}=1,2"
        )
    return {"space": space | {over: sorted(sizes)}, **how}
