"""The command ``bench choose``: find the cheapest system within one standard error of the best."""

from __future__ import annotations

import json
from typing import Any

from bench.commands.printing import print_lines, print_next_commands, results_console
from bench.grammar.options import FIT_OPTIONS, cost_limits, run_commands, typed_settings
from bench.ground.typed import Values, format_command
from bench.reading.candidates import repeated_arguments
from bench.reading.choice import Choice, choose_from_runs, format_points
from bench.reading.runs import load_results, parse_selection
from bench.reading.scene import read_scene
from bench.store.client import connect
from bench.values.measures import Cost, Measure, Row, all_costs, costs_of_run_kind, text_measure
from bench.values.table import Table, rows_of_frame


def command(values: Values) -> int:
    """Print the choice and its reasons; exit code 1 if nothing fits the budgets."""
    if typed_settings("choose", values)["groups"]:
        from bench.commands.choose_groups import print_groups

        return print_groups(values)
    result = choose_from_values(values)
    table_of_candidates(result).print(results_console())
    if 0 < result.table["linked"].sum() < len(result.table):
        results_console().print(
            "* as linked in C, with code; other sizes exclude code", style="dim"
        )
    print_lines(*result.lines())
    if result.system is None:
        return 1
    print_next_commands(_next_command(result))
    return 0


def choose_from_values(values: Values) -> Choice:
    """Choose among stored runs, by typed values and the scene that they name."""
    scene = read_scene(str(values["scene"])) if "scene" in values else None
    values = {**scene.values, **values} if scene else values
    settings = typed_settings("choose", values)
    selection = parse_selection(values)
    how: dict[str, Any] = {
        key: settings.get(key) for key in ("margin", "clock", "unit", "batch", "why")
    }
    return choose_from_runs(
        load_results(connect(), selection),
        selection,
        settings["by"],
        cost_limits(settings),
        scene=scene,
        notes=scene.board.budget_sentences(values) if scene and scene.board else [],
        **how,
    )


def _next_command(result: Choice) -> str:
    """The command that trains the chosen system, or else ``bench report``.

    A search is not trained again, and a system that needs conditions is not saved.
    """
    chosen = result.table.loc[result.chosen]
    keys = {option.key for option in FIT_OPTIONS}
    arguments = json.loads(chosen["arguments"] or "{}")
    arguments = {k: v for k, v in arguments.items() if k.partition(".")[0] in keys}
    if not arguments or chosen["command"] not in run_commands() or chosen["conditions"]:
        return "bench report"
    if result.candidates.first.is_stale:  # a fit would learn other captures than these
        return format_command(str(chosen["command"]), repeated_arguments(str(chosen["arguments"])))
    shipped = json.loads(str(chosen["shipped"]))
    return format_command("fit", arguments | shipped | {"out": "chosen"})


def table_of_candidates(result: Choice) -> Table:
    """Table of the candidates of a choice."""
    by, words = all_costs()[result.by], {"low": "at most", "high": "at least"}
    limits = []
    for key, value in result.budgets.items():
        cost = all_costs()[key]
        limits.append(f"{cost.title} {words[cost.better]} {cost.format_amount(value)}")
    score = "score" if result.scene.reactions.is_weighted else "accuracy"
    columns = [
        text_measure("system"),
        text_measure("unit", "input"),
        Measure("accuracy", f"{score} %"),
        Measure("loss", "below best", _format_loss),
        *(_cost_column(cost, result) for cost in _shown_costs(result)),
        text_measure("verdict"),
    ]
    title = (
        f"{result.candidates.context}; {', '.join(limits) or 'no budget'}; "
        f"{by.best_word} {by.title} first; {score} is the mean over subjects"
    )
    bold = [i for i, index in enumerate(result.table.index) if index == result.chosen]
    return Table(columns, rows_of_frame(result.table), title, bold)


def _shown_costs(result: Choice) -> list[Cost]:
    """The costs of all systems, and those that a budget, ``by=`` or a scene names."""
    costs = costs_of_run_kind(result.study).values()
    hidden = result.candidates.hidden_costs
    shown = [cost for cost in costs if cost.scene_line[0] not in ("faults", "people")]
    shown = [cost for cost in shown if cost.key not in hidden]
    shown.sort(key=lambda cost: "captures" in cost.measured_on)
    named = {result.by, *result.budgets}
    for key, cost in all_costs().items():
        is_named = key in named or (cost.is_fault_loss and result.scene.faults)
        if is_named and cost not in shown:
            shown.append(cost)
    return shown


def _cost_column(cost: Cost, result: Choice) -> Measure:
    """Column of a cost; those that the choice depends on are left out last."""

    def format_cost(row: Row) -> str:
        is_linked = row["linked"] and cost.key in ("flash", "ram")
        return cost.format_amount(row[cost.key]) + "*" * bool(is_linked)

    is_kept = cost.key in (result.by, *result.budgets) or cost.scene_line[0] != "budget"
    return Measure(cost.key, cost.title, format_cost, spare=0 if is_kept else cost.spare or 3)


def _format_loss(row: Row) -> str | None:
    """Points below the best candidate, with their standard error; None for NaN."""
    return format_points(row["loss"], row["error"]) if row["loss"] == row["loss"] else None
