"""The command ``bench choose``: the cheapest system that is not measurably worse than the best one.

Without ``over=`` it reads tracked runs; with it, it makes runs whose every fold chooses the smallest value of one
parameter on training subjects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape
from rich.table import Table

from bench.commands.printing import output, show
from bench.commands.run import evaluated
from bench.errors import InputError, nearest
from bench.outcomes.choice import Choice, amount, candidates, decide, sentences
from bench.outcomes.store import connect
from bench.plan.arguments import BACKEND, Values, backend_of, convert, items, parse
from bench.plan.arguments import KEYS as RUN_KEYS
from bench.plan.cells import Cell, cells
from bench.quantities import BUDGETS, COSTS, quantity
from bench.registry import parameters
from bench.work.loop import Outcome, warn
from models import contract

if TYPE_CHECKING:
    from models.space import How, Tuning

AMONG = ("data", "where", "target", "protocol", "model", "features")  # of tracked runs
KEYS = RUN_KEYS | {"over", "inner", "by", "margin", "shots", *BUDGETS}
SHARES = (0.125, 0.25, 0.5, 1.0)  # of a parameter's default, where no values are given


@dataclass(frozen=True)
class Chosen:
    """A choice with what it was made among.

    Attributes:
        choice: as `bench.outcomes.choice.decide` made it.
        about: data, subset and protocol, in words.
        by: the cost that is to be low.
        budgets: the most of each cost.
        margin: points that do not matter, or None.
        subjects: number of them.
    """

    choice: Choice
    about: str
    by: str
    budgets: dict[str, float]
    margin: float | None
    subjects: int

    @property
    def system(self) -> str | None:
        """What is chosen, None if nothing fits the budgets."""
        chosen = self.choice.chosen
        return None if chosen is None else str(self.choice.table.loc[chosen, "system"])

    def __str__(self) -> str:
        return "\n".join([f"{self.about}:", *sentences(self.choice, self.by, self.margin, self.subjects)])

    __repr__ = __str__


def choose(arguments: list[str]) -> int:
    """Print the choice and its reason; exit code 1 if nothing fits the budgets.

    Raises:
        InputError: something in the arguments cannot be used, or no run is tracked for them.
    """
    values = parse(arguments, KEYS)
    if "over" in values:
        return show(smallest(values))
    found = chosen(values)
    _print(found)
    return 0 if found.system else 1


def chosen(values: Values) -> Chosen:
    """The choice among tracked runs.

    Raises:
        InputError: something in the values cannot be used, or no run is tracked for them.
    """
    if given := [k for k in values if k in {*BACKEND, "inner", "seed"} or ("." in k and not k.startswith("protocol."))]:
        raise InputError(f"{given[0]}= is for over=; without it, nothing is run")
    by = str(values.get("by", "flash"))
    if by not in COSTS:
        raise InputError(f"by={by}: {nearest(by, COSTS)}")
    budgets = {BUDGETS[k]: quantity(k, values[k]) for k in BUDGETS if k in values}
    margin = quantity("margin", values["margin"]) if "margin" in values else None
    asked = {k: items(k, values[k]) for k in AMONG if k in values}
    if "shots" in values:
        shots = convert("shots", values["shots"], 0)
        if shots < 0:
            raise InputError(f"shots={shots}: give 0 or more")
        asked |= {"shots": [str(shots)], "protocol": asked.get("protocol", ["personal"])}
    asked |= {k: items(k, v) for k, v in values.items() if k.startswith("protocol.")}
    found, about, subjects = candidates(connect(), asked, budgets.get("decision"), by == "decision")
    if (by == "predict" or "predict" in budgets) and found["cpu"].nunique() > 1:
        warn(f"warning: times are of several processors: {'; '.join(sorted(set(found['cpu'])))}")
    return Chosen(decide(found, subjects, by, budgets, margin), about, by, budgets, margin, len(subjects.columns))


def _print(found: Chosen) -> None:
    out = output()
    within = ", ".join(f"{k} at most {amount(k, v)}" for k, v in found.budgets.items()) or "no budget"
    table = Table(title=f"{found.about}; {within}; cheapest by {found.by} first")
    for name in ("system", "labels", "accuracy %", "below the best", *COSTS, "verdict"):
        table.add_column(name, justify="left" if name in ("system", "labels", "verdict") else "right")
    for row in found.choice.table.to_dict("records"):
        loss = "-" if np.isnan(row["loss"]) else f"{row['loss']:.1f} ± {row['error']:.1f}"
        amounts = [amount(k, row[k]) for k in COSTS]
        table.add_row(escape(row["system"]), row["unit"], f"{row['accuracy']:.1f}", loss, *amounts, row["verdict"])
    out.print(table)
    for line in sentences(found.choice, found.by, found.margin, found.subjects):
        out.print(line, markup=False, highlight=False, soft_wrap=True)


def smallest(values: Values) -> list[Outcome]:
    """Run each system with the smallest value that suffices, chosen in every fold, beside the system as it is."""
    if given := {"by", "margin", "shots", *BUDGETS} & set(values):
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
    if contract.searches(cell.estimator()):
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
