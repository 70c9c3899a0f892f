"""``bench choose over=``: runs whose every fold chooses the smallest value of one parameter on training subjects."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from bench import contract
from bench.arguments import Values, backend_of, convert, items
from bench.commands.run import evaluated
from bench.costs import BUDGETS
from bench.errors import InputError, nearest
from bench.plan.cells import Cell, cells
from bench.registry import parameters
from bench.work.loop import Outcome

if TYPE_CHECKING:
    from models.search.space import How, Tuning

SHARES = (0.125, 0.25, 0.5, 1.0)  # of a parameter's default, where no values are given


def smallest(values: Values) -> list[Outcome]:
    """Run each system with the smallest value that suffices, chosen in every fold, beside the system as it is."""
    if given := {"by", "margin", "shots", "unit", "clock", "batch", *BUDGETS} & set(values):
        raise InputError(f"{given.pop()}= chooses among tracked runs; leave it out, or leave out over=")
    over, inner = str(values["over"]), str(values.get("inner", "3"))
    listed = values.get(f"model.{over}")
    rest = {k: v for k, v in values.items() if k not in ("over", "inner", f"model.{over}")}
    whole = cells(rest)
    searches = [replace(cell, tuning=_tuning(cell, over, listed, inner)) for cell in whole]
    return evaluated([c for pair in zip(searches, whole, strict=True) for c in pair], backend_of(values))


def _tuning(cell: Cell, over: str, listed: object, inner: str) -> Tuning:
    """How a search picks the smallest value; all parameters but that one stay as they are.

    Raises:
        InputError: the model has no such parameter, or it has no sizes.
    """
    seed = cell.seed if "seed" in cell.model.parameters else 0
    how: How = {"inner": inner, "objective": "smallest", "over": over, "seed": seed}
    usual = parameters(cell.model.factory)
    fixed = {k: [v] for k, v in cell.model.parameters.items() if v != usual[k] and k != "seed"}
    if contract.searches(cell.untrained):
        raise InputError(f"model={cell.model.short} searches by itself; choose over= of a model that does not")
    if over == "features":
        if not cell.features:
            raise InputError(f"over=features: model={cell.model.short} takes none; choose over= one of its parameters")
        return {"space": {**fixed}, **how}
    if over not in usual or over == "seed":
        raise InputError(f"over={over}: {nearest(over, [*(set(usual) - {'seed'}), 'features'])}")
    default = usual[over]
    if isinstance(default, bool) or not isinstance(default, int | float):
        raise InputError(f"over={over}: it has no sizes to choose from; choose over= a parameter that is a number")
    kind = type(default)
    if listed is None:
        chosen = {kind(default * share) for share in SHARES} - {0}
    else:
        chosen = {convert(f"model.{over}", text, default) for text in items(f"model.{over}", listed)}
    if not chosen:
        raise InputError(f"over={over}: its default is {default}; give values, such as model.{over}=1,2")
    return {"space": {**fixed, over: sorted(chosen)}, **how}
