"""The command ``bench tune``: like ``bench run``, with the parameters of each model searched in every training part."""

from __future__ import annotations

from dataclasses import replace

from bench.cells import PARTS, Cell, cells, convert, items, parse
from bench.errors import InputError
from bench.registry import load, nearest, parameters
from bench.run import execute, jobs_of
from models.tuning import Search

OPTIONS = {"trials": 50, "inner": "3", "budget": float("inf"), "objective": "accuracy"}
KEYS = {"data", "where", "target", "seed", "jobs", *OPTIONS, *PARTS}


def tune(arguments: list[str]) -> int:
    """Search, fit and score; exit code as of ``bench run``.

    Values of a model's parameters that are given on the command line are the ones that are tried; without a list of
    several among them, the ranges that the model declares are searched, and what is given is kept.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    values = parse(arguments, KEYS)
    how = {k: convert(k, values[k], default) for k, default in OPTIONS.items() if k in values}
    given = {k.partition(".")[2]: v for k, v in values.items() if k.startswith("model.")}
    if "seed" in given:
        raise InputError(f"model.seed={given['seed']}: give seed= instead, it is that of the search too")
    asked = cells({k: v for k, v in values.items() if not k.startswith("model.") and k != "seed"})
    known = {name for cell in asked for name in cell.model.parameters}
    for name in given:
        if name not in known:
            raise InputError(f"model={values.get('model', 'svm')} has no parameter {name!r}; {nearest(name, known)}")
    seeds = [convert("seed", text, 0) for text in items("seed", values.get("seed", "0"))]
    tuned = [replace(cell, tuning=_tuning(cell, given, how) | {"seed": seed}) for cell in asked for seed in seeds]
    return execute(tuned, jobs_of(values))


def _tuning(cell: Cell, given: dict[str, str], how: dict[str, object]) -> dict[str, object]:
    model = load("models", cell.model.name)
    usual = parameters(model)
    if isinstance(cell.estimator(), Search):
        raise InputError(f"model={cell.model.name} searches by itself; use bench run model={cell.model.name}")
    space = {
        name: list(
            dict.fromkeys(convert(f"model.{name}", value, usual[name]) for value in items(f"model.{name}", text))
        )
        for name, text in given.items()
        if name in usual
    }
    if all(len(values) == 1 for values in space.values()):
        if not hasattr(model, "space"):
            raise InputError(
                f"model={cell.model.name} declares no ranges to search; list values, such as "
                f"model.{next(iter(usual), 'parameter')}=1,2, or give it an attribute space"
            )
        space = dict(model.space) | space
    whole = all(isinstance(values, list) for values in space.values())
    return {"space": space} | ({} if whole else {"trials": OPTIONS["trials"]}) | how
