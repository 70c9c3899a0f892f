"""The command ``bench choose``: the cheapest system that is within one standard error of the best one."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from bench.grammar.options import (
    BATCH,
    FITTED,
    START,
    STORED,
    Command,
    Option,
    keys,
    limits_of,
    makers,
    parse,
    settings,
)
from bench.ground.words import Values, typed
from bench.values.measures import Cost, Measure, Row, costs, costs_of, text

if TYPE_CHECKING:
    from bench.reading.choice import Chosen
    from bench.values.table import Table

COMMAND = Command(
    START,
    "find the cheapest system within one standard error of the best",
    "Finds, among stored runs on the same captures, the cheapest system within one standard error of the most "
    "accurate one. This is the standard error of the paired difference over subjects. If no system fits the "
    "budgets, it prints the lowest cost for each budget; exit code 1. why=yes prints all reasons. Runs with failed "
    "folds, and older runs on other captures, are left out. 1 kB is 1000 bytes, 1 KiB is 1024. Sizes exclude code, "
    "except where a run linked the system in C, which also counts instructions. groups=yes "
    "merges gestures into fewer and fewer groups, the most confused first, and prints the accuracy with each number of "
    "groups; those of each subject are chosen on the other subjects.",
    "bench choose data=haart protocol=loso max_flash=256kB max_ram=32kB",
    options=(
        *STORED,
        Option("scene", "text", "", "TOML file with a robot's needs, or companion, toy or handle"),
        Option(
            "by", "text", "flash", "cost to minimise"
        ),  # its values: `bench.values.measures.costs`
        Option(
            "margin",
            "number",
            None,
            "accepted loss in points; a one-sided paired t-test replaces the standard error",
        ),
        Option("unit", "text", "capture", "unit of accuracy", ("capture", "window")),
        BATCH,
        Option(
            "why", "yes", False, "yes: also print what the choice depends on, and what is left out"
        ),
        Option(
            "groups",
            "yes",
            False,
            "yes: print instead which gestures the most accurate system can tell apart",
        ),
    ),
    budgets="all",
)


def command(arguments: list[str]) -> int:
    """Print the choice and its reason; exit code 1 if nothing fits the budgets."""
    from bench.commands.printing import output, say, then

    values = parse(arguments, keys("choose"))
    if settings("choose", values)["groups"]:
        from bench.commands.groups import printed

        return printed(values)
    result = chosen(values)
    table_of(result).print(output())
    if 0 < result.choice.table["linked"].sum() < len(result.choice.table):
        output().print("* as linked in C, with code; other sizes exclude code", style="dim")
    say(*result.lines())
    if result.system is None:
        return 1
    then(_next(result))
    return 0


def chosen(values: Values) -> Chosen:
    """The choice among tracked runs."""
    from bench.reading import choice as choices
    from bench.reading.runs import asked_of, every_result
    from bench.reading.scene import read_scene
    from bench.store.client import connect

    scene = read_scene(str(values["scene"])) if "scene" in values else None
    values = {**scene.values, **values} if scene else values
    given = settings("choose", values)
    how: dict[str, Any] = {
        key: given.get(key) for key in ("margin", "clock", "unit", "batch", "why")
    }
    notes = scene.board.sentences(values) if scene and scene.board else []
    asked = asked_of(values)
    return choices.choose(
        every_result(connect(), asked),
        asked,
        given["by"],
        limits_of(given),
        scene=scene,
        notes=notes,
        **how,
    )


def _next(result: Chosen) -> str:
    """The command that trains the chosen system, if one does.

    A search is not trained again, and a system that needs conditions is not saved.
    """
    one = result.choice.table.loc[result.choice.chosen]
    fitted = {option.key for option in FITTED}
    trained = {
        k: v for k, v in json.loads(one["arguments"] or "{}").items() if k.split(".")[0] in fitted
    }
    trained |= json.loads(str(one["shipped"])) if trained else {}
    once = trained and one["command"] in makers() and not one["conditions"]
    return typed("fit", trained | {"out": "chosen"}) if once else "bench report"


def table_of(result: Chosen) -> Table:
    """The candidates of a choice."""
    from bench.reading.choice import points
    from bench.values.table import Table, rows_of

    choice, by = result.choice, costs()[result.by]
    words, limited = (
        {"low": "at most", "high": "at least"},
        [(costs()[key], v) for key, v in result.budgets.items()],
    )
    limits = [f"{cost.title} {words[cost.better]} {cost.amount(value)}" for cost, value in limited]
    score = "score" if result.scene.reactions.weighted else "accuracy"
    asked = {
        result.by,
        *result.budgets,
        *(k for k, c in costs().items() if c.losses and result.scene.faults),
    }
    shown = [
        cost for cost in costs_of(result.study).values() if cost.line[0] not in ("faults", "people")
    ]
    shown.sort(key=lambda cost: "captures" in cost.on)
    shown += [cost for cost in costs().values() if cost.key in asked and cost not in shown]

    def column(cost: Cost) -> Measure:
        kept = cost.key in (result.by, *result.budgets) or cost.line[0] != "budget"

        def amount(row: Row) -> str:
            return cost.amount(row[cost.key]) + "*" * (
                bool(row["linked"]) and cost.key in ("flash", "ram")
            )

        return Measure(cost.key, cost.title, amount, spare=0 if kept else cost.spare or 3)

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
    title = f"{result.among.context}; {', '.join(limits) or 'no budget'}; {by.extreme} {by.title} first; "
    bold = [i for i, index in enumerate(choice.table.index) if index == choice.chosen]
    return Table(columns, rows_of(choice.table), f"{title}{score} is the mean over subjects", bold)
