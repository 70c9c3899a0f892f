"""The command ``bench choose``: the cheapest system that is within one standard error of the best one."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from bench.grammar.options import (
    BATCH,
    FIT_OPTIONS,
    START,
    STORED_OPTIONS,
    Command,
    Option,
    cost_limits,
    key_options,
    parse_arguments,
    run_commands,
    typed_settings,
)
from bench.ground.typed import Values, format_command
from bench.values.measures import Cost, Measure, Row, all_costs, costs_of_study, text_measure

if TYPE_CHECKING:
    from bench.reading.choice import Choice
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
        *STORED_OPTIONS,
        Option("scene", "text", "", "TOML file with a robot's needs, or companion, toy or handle"),
        Option(
            "by", "text", "flash", "cost to minimise"
        ),  # its values: `bench.values.measures.all_costs`
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
    from bench.commands.printing import print_lines, print_next_commands, results_console

    values = parse_arguments(arguments, key_options("choose"))
    if typed_settings("choose", values)["groups"]:
        from bench.commands.choose_groups import print_groups

        return print_groups(values)
    result = choose_from_values(values)
    table_of(result).print(results_console())
    if 0 < result.table["linked"].sum() < len(result.table):
        results_console().print(
            "* as linked in C, with code; other sizes exclude code", style="dim"
        )
    print_lines(*result.lines())
    if result.system is None:
        return 1
    print_next_commands(_next(result))
    return 0


def choose_from_values(values: Values) -> Choice:
    """The choice among tracked runs."""
    from bench.reading.choice import choose_from_runs
    from bench.reading.runs import load_results, parse_selection
    from bench.reading.scene import read_scene
    from bench.store.client import connect

    scene = read_scene(str(values["scene"])) if "scene" in values else None
    values = {**scene.values, **values} if scene else values
    given = typed_settings("choose", values)
    how: dict[str, Any] = {
        key: given.get(key) for key in ("margin", "clock", "unit", "batch", "why")
    }
    notes = scene.board.budget_sentences(values) if scene and scene.board else []
    asked = parse_selection(values)
    return choose_from_runs(
        load_results(connect(), asked),
        asked,
        given["by"],
        cost_limits(given),
        scene=scene,
        notes=notes,
        **how,
    )


def _next(result: Choice) -> str:
    """The command that trains the chosen system, if one does.

    A search is not trained again, and a system that needs conditions is not saved.
    """
    one = result.table.loc[result.chosen]
    fitted = {option.key for option in FIT_OPTIONS}
    trained = {
        k: v for k, v in json.loads(one["arguments"] or "{}").items() if k.split(".")[0] in fitted
    }
    trained |= json.loads(str(one["shipped"])) if trained else {}
    once = trained and one["command"] in run_commands() and not one["conditions"]
    return format_command("fit", trained | {"out": "chosen"}) if once else "bench report"


def table_of(result: Choice) -> Table:
    """The candidates of a choice."""
    from bench.reading.choice import format_points
    from bench.values.table import Table, rows_of_frame

    by = all_costs()[result.by]
    words, limited = (
        {"low": "at most", "high": "at least"},
        [(all_costs()[key], v) for key, v in result.budgets.items()],
    )
    limits = [
        f"{cost.title} {words[cost.better]} {cost.format_amount(value)}" for cost, value in limited
    ]
    score = "score" if result.scene.reactions.is_weighted else "accuracy"
    asked = {
        result.by,
        *result.budgets,
        *(k for k, c in all_costs().items() if c.is_fault_loss and result.scene.faults),
    }
    shown = [
        cost
        for cost in costs_of_study(result.study).values()
        if cost.scene_line[0] not in ("faults", "people")
    ]
    shown.sort(key=lambda cost: "captures" in cost.measured_on)
    shown += [cost for cost in all_costs().values() if cost.key in asked and cost not in shown]

    def column(cost: Cost) -> Measure:
        kept = cost.key in (result.by, *result.budgets) or cost.scene_line[0] != "budget"

        def amount(row: Row) -> str:
            return cost.format_amount(row[cost.key]) + "*" * (
                bool(row["linked"]) and cost.key in ("flash", "ram")
            )

        return Measure(cost.key, cost.title, amount, spare=0 if kept else cost.spare or 3)

    def loss(row: Row) -> str | None:
        return format_points(row["loss"], row["error"]) if row["loss"] == row["loss"] else None

    columns = [
        text_measure("system"),
        text_measure("unit", "input"),
        Measure("accuracy", f"{score} %"),
        Measure("loss", "below best", loss),
        *map(column, shown),
        text_measure("verdict"),
    ]
    title = f"{result.candidates.context}; {', '.join(limits) or 'no budget'}; {by.best_word} {by.title} first; "
    bold = [i for i, index in enumerate(result.table.index) if index == result.chosen]
    return Table(
        columns, rows_of_frame(result.table), f"{title}{score} is the mean over subjects", bold
    )
