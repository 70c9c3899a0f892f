"""``bench tune smallest=``: runs whose every fold chooses the smallest value of one parameter on training subjects."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from bench import contract
from bench.amounts import convert
from bench.arguments import backend_of, settings
from bench.commands.kind import evaluated
from bench.errors import InputError, nearest
from bench.plan.cells import Cell, cells
from bench.registry import parameters
from bench.result import Result
from bench.words import Values, items

if TYPE_CHECKING:
    from bench.models.search.space import How, Tuning

SHARES = (0.125, 0.25, 0.5, 1.0)  # of a parameter's default, where no values are typed


def smallest(values: Values) -> list[Result]:
    """Run each system with the smallest value that suffices, chosen in every fold, beside the unchanged system.

    Raises:
        InputError: a value cannot be used, or a key ends a search, which this one does not need.
    """
    if wrong := [key for key in ("trials", "seconds") if key in values]:
        raise InputError(f"{wrong[0]}= ends a search, and smallest= tries every value; leave one of them out")
    given = settings("tune", values)
    over, inner = given["smallest"], given["inner"]
    rest = {k: v for k, v in values.items() if k not in ("smallest", "inner", f"model.{over}")}
    pairs = [
        (replace(cell, tuning=_tuning(cell, over, values.get(f"model.{over}"), inner)), cell) for cell in cells(rest)
    ]
    return evaluated([cell for pair in pairs for cell in pair], backend_of(values))


def _tuning(cell: Cell, over: str, listed: object, inner: str) -> Tuning:
    """How a search picks the smallest value; all parameters but that one stay as they are."""
    model, usual = cell.model.short, parameters(cell.model.factory)
    if contract.searches(cell.untrained):
        raise InputError(f"model={model} searches by itself; give smallest= of a model that does not")
    space = {k: [v] for k, v in cell.model.parameters.items() if v != usual[k] and k != "seed"}
    seed = cell.seed if "seed" in cell.model.parameters else 0
    how: How = {"inner": inner, "objective": "smallest", "smallest": over, "seed": seed}
    if over == "features":
        if not cell.features:
            raise InputError(f"smallest=features: model={model} uses no feature set; give one of its parameters")
        return {"space": {**space}, **how}
    default = usual.get(over)
    if over == "seed" or over not in usual:
        raise InputError(f"smallest={over}: {nearest(over, [*(set(usual) - {'seed'}), 'features'])}")
    if isinstance(default, bool) or not isinstance(default, int | float):
        raise InputError(f"smallest={over}: not a number, so it has no sizes; give a numeric parameter")
    if listed is None:
        sizes = {type(default)(default * share) for share in SHARES} - {0}
    else:
        sizes = {convert(f"model.{over}", text, default) for text in items(f"model.{over}", listed)}
    if not sizes:
        raise InputError(f"smallest={over}: its default is {default}; give values, such as model.{over}=1,2")
    return {"space": {**space, over: sorted(sizes)}, **how}
