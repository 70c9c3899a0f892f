"""The command ``bench tune``: run systems with their parameters searched in every training part."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from bench import contract
from bench.commands.run import is_dry, print_results, run_cells
from bench.commands.run_grids import print_missing_runs
from bench.errors import InputError, suggest_names
from bench.grammar.options import make_executor, typed_settings
from bench.ground.registry import parameter_defaults
from bench.ground.typed import DEFAULTS, Values, format_value, parse_value, split_values
from bench.models.space import Space, Tuning
from bench.plan.cells import Cell, Part
from bench.plan.grid import accepted_parameters, make_cells, refuse_unknown
from bench.plan.plan import make_plans
from bench.values.result import Result

SHARES = (0.125, 0.25, 0.5, 1.0)  # of a parameter's default, where smallest= has no values to try


def command(values: Values) -> int:
    """Search, fit and test systems; the exit code is that of ``bench run``."""
    if is_dry(values):
        executor = make_executor(values)
        return print_missing_runs(make_plans(_make_searches(values), executor.jobs), executor)
    return print_results("run", run_searches(values))


def run_searches(values: Values) -> list[Result]:
    """Run the searches of typed values; return a result for each."""
    return run_cells(_make_searches(values), make_executor(values))


def _make_searches(values: Values) -> list[Cell]:
    """Make the cells of typed values, each with its search."""
    return _search_smallest(values) if "smallest" in values else _search_best(values)


def _search_best(values: Values) -> list[Cell]:
    """Make a search of the best values of parameters, for each system and seed."""
    settings = typed_settings("tune", values)
    limits = {key: settings[key] for key in ("trials", "inner", "seconds") if key in values}
    listed = {k.partition(".")[2]: v for k, v in values.items() if k.startswith("model.")}
    if "seed" in listed:
        raise InputError(
            f"model.seed={listed['seed']}: give seed= instead, which also sets the seed of the "
            "search"
        )
    searched = {*settings, "seed", *(f"model.{name}" for name in listed)}
    cells = _make_searchable_cells({k: v for k, v in values.items() if k not in searched})
    factories = [cell.model.factory for cell in cells]
    accepted = {name for each in factories for name in accepted_parameters("model", each)}
    refuse_unknown(f"model={values.get('model', DEFAULTS['model'])}", listed, accepted)
    seeds = split_values("seed", values.get("seed", DEFAULTS["seed"]))
    seeds = [parse_value("seed", text, 0) for text in seeds]
    searches = [_search_of_best(cell, listed, limits, settings["trials"]) for cell in cells]
    return [
        replace(cell, tuning=search | {"seed": seed})
        for cell, search in zip(cells, searches, strict=True)
        for seed in seeds
    ]


def _search_smallest(values: Values) -> list[Cell]:
    """Make a search of the smallest value that suffices, for each system, and the system itself."""
    if limits := [key for key in ("trials", "seconds") if key in values]:
        raise InputError(
            f"{limits[0]}= ends a search, and smallest= tries every value; leave one of them out"
        )
    settings = typed_settings("tune", values)
    name = settings["smallest"]
    searched = (*settings, f"model.{name}")
    cells = []
    for cell in _make_searchable_cells({k: v for k, v in values.items() if k not in searched}):
        search = _search_of_smallest(cell, name, values.get(f"model.{name}"), settings["inner"])
        cells += [replace(cell, tuning=search), cell]
    return cells


def _make_searchable_cells(values: Values) -> list[Cell]:
    """Make the cells of typed values; refuse systems whose parameters cannot be searched."""
    cells = make_cells(values)
    for cell in cells:
        name = cell.model.short_name
        if cell.model.instance is not None:
            raise InputError(
                f"model={name}: an object has fixed parameters; give the name of its class or "
                "factory"
            )
        _refuse_self_searching(cell)
    return cells


def _refuse_self_searching(cell: Cell, key: str = "") -> None:
    """Refuse a system that tunes itself, with a key that makes it do so."""
    if contract.searches_itself(cell.untrained_system):
        words = f"model={cell.model.short_name}{key}"
        raise InputError(f"{words} searches by itself; use bench run {words}")


def _parse_list(model: Part, name: str, listed: object, default: object) -> list[object]:
    """Parse listed values of a parameter, each of the type of the default.

    Several names together stay joined by +.
    """
    key = f"model.{name}"
    values = [model.parse(key, value, default) for value in split_values(key, listed)]
    values = [format_value(value) if isinstance(value, tuple) else value for value in values]
    if repeated := [value for value in values if values.count(value) > 1]:
        raise InputError(
            f"{key}: the value {repeated[0]} stands twice; give different ones, or one to fix it"
        )
    return values


def _search_of_best(
    cell: Cell, listed: dict[str, object], limits: dict[str, object], trials: int
) -> Tuning:
    """Search the lists of parameters that have several values, else the declared ranges."""
    defaults = accepted_parameters("model", cell.model.factory)
    space: Space = {
        k: _parse_list(cell.model, k, v, defaults[k]) for k, v in listed.items() if k in defaults
    }
    for name, values in space.items():
        if True in values and isinstance(defaults[name], bool):
            model = replace(cell.model, parameters=cell.model.parameters | {name: True})
            _refuse_self_searching(replace(cell, model=model), f" model.{name}=yes")
    if all(len(values) == 1 for values in space.values()):  # single values are fixed
        declared = contract.search_space(cell.model.factory)
        if declared is None:
            names = [key for key in defaults if key not in ("seed", "device", "batch")]
            raise InputError(
                f"model={cell.model.short_name} declares no ranges to search; list values such as "
                f"model.{[*names, 'parameter'][0]}=1,2, or give the model an attribute space"
            )
        space = {**declared, **space}
    is_grid = all(isinstance(values, list) for values in space.values())
    return {"space": space, **limits} if is_grid else {"space": space, "trials": trials, **limits}


def _search_of_smallest(cell: Cell, name: str, listed: object, inner: str) -> Tuning:
    """Search the smallest value of a parameter, or the fewest features; others stay as they are."""
    model, defaults = cell.model, parameter_defaults(cell.model.factory)
    fixed = {k: [v] for k, v in model.parameters.items() if v != defaults[k] and k != "seed"}
    seed = cell.seed if "seed" in model.parameters else 0
    how = {"inner": inner, "objective": "smallest", "smallest": name, "seed": seed}
    if name == "features":
        if not cell.features:
            raise InputError(
                f"smallest=features: model={model.short_name} uses no feature set; give one of its "
                "parameters"
            )
        return {"space": fixed, **how}
    if name == "seed" or name not in defaults:
        advice = suggest_names(name, [*(set(defaults) - {"seed"}), "features"])
        raise InputError(f"smallest={name}: {advice}")
    default = defaults[name]
    if isinstance(default, bool) or not isinstance(default, int | float):
        raise InputError(
            f"smallest={name}: not a number, so it has no sizes; give a numeric parameter"
        )
    sizes: set[Any]
    if listed is None:
        sizes = {type(default)(default * share) for share in SHARES} - {0}
    else:
        sizes = {*_parse_list(cell.model, name, listed, default)}
    if not sizes:
        raise InputError(
            f"smallest={name}: its default is {default}; give values, such as model.{name}=1,2"
        )
    return {"space": {**fixed, name: sorted(sizes)}, **how}
