"""The command ``bench choose``: the cheapest system that is within one standard error of the best one."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from bench.arguments import limits_of, parse, settings
from bench.commands.printing import output, say, then
from bench.errors import InputError
from bench.measures import Cost, Measure, Row, costs, costs_of, text
from bench.options import keys, makers
from bench.outcomes import choice as choices
from bench.outcomes.choice import Chosen, points
from bench.outcomes.runs import asked_of, every_result
from bench.outcomes.store import connect
from bench.scene_file import read_scene
from bench.table import Table, rows_of
from bench.words import Values, typed

FIT = ("data", "where", "target", "model", "features", "seed")  # keys of bench fit that a run has


def choose(arguments: list[str]) -> int:
    """Print the choice and its reason; exit code 1 if nothing fits the budgets.

    Raises:
        InputError: something in the arguments cannot be used, or no run is tracked for them.
    """
    result = chosen(parse(arguments, keys("choose")))
    table_of(result).print(output())
    if 0 < result.choice.table["linked"].sum() < len(result.choice.table):
        output().print("* as linked in C, with code; other sizes exclude code", style="dim")
    say(*result.lines())
    if result.system is None:
        return 1
    then(_next(result))
    return 0


def chosen(values: Values) -> Chosen:
    """The choice among tracked runs.

    Raises:
        InputError: something in the values cannot be used, or no run is tracked for them.
    """
    if dotted := [k for k in values if "." in k and not k.startswith("protocol.")]:
        raise InputError(f"{dotted[0]}= runs a system, and bench choose reads stored runs; leave {dotted[0]}= out")
    scene = read_scene(str(values["scene"])) if "scene" in values else None
    values = {**scene.values, **values} if scene else values
    given = settings("choose", values)
    how: dict[str, Any] = {key: given.get(key) for key in ("margin", "clock", "unit", "batch", "shots", "why")}
    notes = scene.board.sentences(values) if scene and scene.board else []
    asked = asked_of(values)
    return choices.choose(
        every_result(connect()), asked, given["by"], limits_of(given), scene=scene, notes=notes, **how
    )


def _next(result: Chosen) -> str:
    """The command that trains the chosen system, if one does.

    A search is not trained again, and a system that needs conditions is not saved.
    """
    one = result.choice.table.loc[result.choice.chosen]
    trained = {k: v for k, v in json.loads(one["arguments"] or "{}").items() if k.split(".")[0] in FIT}
    trained |= json.loads(str(one["shipped"])) if trained else {}
    once = trained and one["command"] in makers() and not one["conditions"]
    return typed("fit", trained | {"out": "chosen"}) if once else "bench report"


def table_of(result: Chosen) -> Table:
    """The candidates of a choice."""
    choice, by = result.choice, costs()[result.by]
    limits = [f"{costs()[k].title} {costs()[k].limit} {costs()[k].amount(v)}" for k, v in result.budgets.items()]
    score = "score" if result.scene.reactions.weighted else "accuracy"
    asked = {result.by, *result.budgets, *(k for k, c in costs().items() if c.losses and result.scene.faults)}
    shown = [cost for cost in costs_of(result.watched).values() if not (cost.losses or cost.section[0] == "people")]
    shown.sort(key=lambda cost: cost.runs != "recordings")
    shown += [cost for cost in costs().values() if cost.key in asked and cost not in shown]

    def column(cost: Cost) -> Measure:
        spare = 0 if cost.key == result.by or cost.key in result.budgets else cost.last

        def amount(row: Row) -> str:
            return cost.amount(row[cost.key]) + "*" * (bool(row["linked"]) and cost.key in ("flash", "ram"))

        return Measure(cost.key, cost.title, amount, spare=spare)

    def loss(row: Row) -> str | None:
        return points(row["loss"], row["error"]) if row["loss"] == row["loss"] else None

    columns = [
        text("system"),
        text("unit", "input"),
        Measure("accuracy", f"{score} %"),
        Measure("loss", "below best", loss),
        *map(column, shown),
        text("verdict"),
    ]
    title = (
        f"{result.among.context}; {', '.join(limits) or 'no budget'}; {by.extreme} {by.title} first; {score} is the "
        "mean over subjects"
    )
    bold = np.flatnonzero(choice.table.index == choice.chosen).tolist()
    return Table(columns, rows_of(choice.table), title, bold)
