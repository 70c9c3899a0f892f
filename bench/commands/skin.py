"""The command ``bench skin``: search the smallest skin that a system needs."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.commands.printing import (
    print_lines,
    print_next_commands,
    refuse_unwritable,
    results_console,
)
from bench.commands.run import run_complete
from bench.commands.skin_taxels import order_taxels
from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.library import open_corpus
from bench.errors import InputError
from bench.grammar.options import typed_settings
from bench.ground.typed import Values, format_command
from bench.plan.cells import Cell, Part
from bench.plan.grid import make_cells
from bench.plan.plan import load_captures
from bench.reading.choice import format_points
from bench.reading.designs import (
    HOW,
    Designs,
    TaxelOrder,
    best_half,
    changed_property,
    cheapest_design,
    format_design,
    pair_accuracies,
)
from bench.values.intervals import mean_and_error, mean_interval
from bench.values.measures import Cost, Measure, all_costs, text_measure
from bench.values.table import Table

# Tried if no design is typed: grids of at most half of the taxels, periods in frames, and bits
GRIDS, PERIODS, BITS = ((8, 8), (4, 4), (2, 2)), (2, 3), (6, 4)
BITS_OF_DECIMALS = 10  # of their finest design, as recorded steps are unknown
FEW = 8  # designs that all stay in the search
MOST_APART = 3  # rounds of the search, each with other pairs of people


def command(values: Values) -> int:
    """Search designs, print and draw them."""
    from bench.reports.designs import draw_designs, draw_orders

    settings = typed_settings("skin", values)
    out = Path(settings["out"])
    with refuse_unwritable(out):
        out.mkdir(parents=True, exist_ok=True)
    if settings["wired"]:
        if "by" in values:
            raise InputError("by= and wired= exclude each other; leave one of them out")
        orders = search_taxels(values)
        with refuse_unwritable(out):
            path = draw_orders(orders, out)
        print_lines(*(line for order in orders for line in order.lines()), str(path))
        return 0
    designs = search_designs(values)
    with refuse_unwritable(out):
        paths = draw_designs(designs, out)
    table_of_front(designs).print(results_console())
    if designs.single_changes():
        table_of_properties(designs).print(results_console())
    print_lines(*describe_choice(designs), *map(str, paths))
    best = designs.results[designs.chosen]
    context = {"data": best["data"], "where": best["where"], "protocol": "loso"}
    context |= {"by": designs.cost.key}
    print_next_commands(format_command("choose", context))
    return 0


def search_designs(values: Values) -> Designs:
    """Choose a design for each person on others, and test all that stay in the search on all.

    Each round tests the designs that stay on further pairs of people; of many, the better half
    stays. Which ones stay for a person depends on others alone.
    """
    settings = typed_settings("skin", values)
    cost = all_costs()[settings["by"]]
    cells = _make_designs({k: v for k, v in values.items() if k not in settings})
    recorded = cells[0]
    captures = load_captures(
        recorded.data, recorded.data_parameters, recorded.where, recorded.target
    )
    people = [*dict.fromkeys(captures.subjects)]
    inner = np.full((len(cells), len(people), len(people)), np.nan)
    stays, amounts = np.ones((len(cells), len(people)), bool), np.full(len(cells), np.nan)
    for apart in range(1, min(MOST_APART, len(people) // 2) + 1):
        places = np.flatnonzero(stays.any(axis=1))
        pairs = Part("protocols", "pairs", {"apart": apart})
        results = run_complete([replace(cells[i], protocol=pairs) for i in places], values)
        amounts[places] = [cost.value_of_row(result) for result in results]
        if not np.isfinite(amounts[0]):
            raise InputError(f"by={cost.key}: {recorded.system_name()}: {cost.why_unknown}")
        for i, result in zip(places, results, strict=True):
            accuracies = pair_accuracies(result, people)
            inner[i] = np.where(np.isnan(accuracies), inner[i], accuracies)
        for person in range(len(people)) if len(cells) > FEW else ():
            kept = np.flatnonzero(stays[:, person])
            mean = np.nanmean(inner[kept, person], axis=1)
            stays[kept, person] = best_half(mean, cost.as_burden(amounts[kept]))
    choices = []
    for person, candidates in enumerate(map(np.flatnonzero, stays.T)):
        tested = inner[candidates, person]
        tested = tested[:, np.isfinite(tested[0])]
        choices.append(candidates[cheapest_design(tested, cost.as_burden(amounts[candidates]))])
    options = [_changed_options(cell, captures) for cell in cells]
    alone = [bool(changed_property(each)) for each in options]
    places = np.flatnonzero(stays.any(axis=1) | np.array(alone))
    results = run_complete([cells[i] for i in places], values)
    shown = [options[i] for i in places]
    shown_amounts = np.array([cost.value_of_row(result) for result in results], float)
    order = [people.index(name) for name in results[0].accuracy_by_subject]
    choices_in_order = np.searchsorted(places, choices)[order]
    return Designs(shown, results, cost, shown_amounts, choices_in_order)


def search_taxels(values: Values) -> list[TaxelOrder]:
    """Choose which taxels of one design to wire, for two halves of people."""
    settings = typed_settings("skin", values)
    cell = _only_cell({k: v for k, v in values.items() if k not in settings})
    return order_taxels(cell, settings["wired"], values)


def _only_cell(values: Values) -> Cell:
    """The cell of values that name one system on one corpus and one design."""
    cells = make_cells(values)
    if len(cells) > 1:
        names = " and ".join(cell.title() for cell in cells[:2])
        raise InputError(f"give one system on one corpus, with wired= one design; not {names}")
    return cells[0]


def _make_designs(values: Values) -> list[Cell]:
    """Make the cells of all designs, the recorded one first."""
    for key in ("protocol", "skin"):
        if key in values:
            raise InputError(f"{key}={values[key]}: bench skin sets it; leave it out")
    typed = {key: value for key, value in values.items() if key.startswith("skin.")}
    untyped = {key: value for key, value in values.items() if key not in typed}
    recorded = _only_cell(untyped)
    usual = typed or usual_designs(open_corpus(recorded.data, recorded.data_parameters))
    designs = make_cells({**values, **usual})
    return [recorded, *(cell for cell in designs if cell.skin)]


def _changed_options(cell: Cell, captures: Corpus) -> dict[str, object]:
    """Options of a design that differ from the skin that recorded the captures."""
    recorded = {"grid": "x".join(map(str, captures.grid)), "rate_hz": captures.rate_hz}
    options = cell.skin.changed_parameters() if cell.skin else {}
    return {name: value for name, value in options.items() if value != recorded.get(name)}


def usual_designs(corpus: Corpus) -> dict[str, object]:
    """Values of designs that a recorded skin can stand for, each property also as recorded."""
    rows, cols = corpus.grid
    grids = [f"{r}x{c}" for r, c in GRIDS if r <= rows and c <= cols and 2 * r * c <= rows * cols]
    rates = [corpus.rate_hz / period for period in PERIODS]
    is_whole = shared_frames(corpus)[0].dtype.kind in "iu"
    bits = [n for n in BITS if n < math.log2(corpus.full_scale + 1) or not is_whole]
    finest = 0 if is_whole else BITS_OF_DECIMALS
    how = {"skin.curve": "log"}
    return {
        "skin.grid": ["", *grids],
        "skin.rate_hz": [0, *rates],
        "skin.bits": [finest, *bits],
    } | how


def table_of_front(designs: Designs) -> Table:
    """Table of the designs on the Pareto front, and the recorded one; the chosen one is bold."""
    places = [*dict.fromkeys([0, *designs.front[::-1].tolist()])]
    recorded = designs.results[0]
    title = f"{', '.join(recorded.context)}: {recorded.system}\nNo other design is at least as "
    title += f"accurate with {designs.cost.noun} as low; bold: the cheapest within one standard "
    title += "error of the recorded skin"
    bold = [row for row, i in enumerate(places) if i == designs.chosen]
    columns = [text_measure("design"), *_cost_columns(designs.cost), *_ACCURACY]
    return Table(columns, [designs.row(i) for i in places], title, bold)


def table_of_properties(designs: Designs) -> Table:
    """Table of the designs that change one property alone."""
    rows = [designs.row(i, name) for name, each in designs.single_changes().items() for i in each]
    columns = [text_measure("property"), text_measure("design"), *_ACCURACY]
    return Table(columns, rows, "One property alone, against the recorded skin")


_ACCURACY = (
    Measure("mean", "accuracy %", ends="mean"),
    text_measure("points", source=lambda row: format_points(row["points"], row["error"])),
)


def _cost_columns(cost: Cost) -> list[Measure]:
    """Columns of the cost of the choice and of other costs of the skin, which may be left out."""
    keys = dict.fromkeys((cost.key, "values_per_s", "taxels", "wires", "bits_per_s"))
    return [
        replace(all_costs()[key], heading=all_costs()[key].title, spare=3 * (key != cost.key))
        for key in keys
    ]


def describe_choice(designs: Designs) -> list[str]:
    """Sentences on the choice, on what a new person would get, and on the limits of recording."""
    chosen, cost = designs.row(designs.chosen), designs.cost
    amount, recorded = designs.amounts[[designs.chosen, 0]]
    names = Counter(format_design(designs.options[i]) for i in designs.choices)
    listed = "; ".join(f"{name} ({count}x)" for name, count in names.most_common())
    nested, as_recorded = designs.new_person()
    low, high = np.clip(mean_interval(nested), 0, 100)
    interval = "" if np.isnan(low) else f" [{low:.1f}, {high:.1f}]"
    mean = designs.amounts[designs.choices].mean()
    lines = [
        f"Chosen on all people: {chosen['design']}: {cost.format_amount(amount)} {cost.phrase} "
        f"instead of {cost.format_amount(recorded)}, {chosen['mean']:.1f} %, "
        f"{format_points(chosen['points'], chosen['error'])} points. These people chose it: this "
        "is optimistic.",
        f"Chosen on others for each person: {nested.mean():.1f} %{interval}, "
        f"{format_points(*mean_and_error(nested - as_recorded))} points, with "
        f"{cost.format_amount(mean)} {cost.phrase} on average: {listed}.",
    ]
    for name, places in designs.single_changes().items():
        if name in HOW:
            continue
        finest, same = places[0], designs.same_at_full(places[0])
        gain, error = mean_and_error(designs.accuracy[same] - designs.accuracy[finest])
        with_how = f" with {format_design(designs.options[same])}" if same else ""
        words = f"{name}: the recorded skin{with_how} gains {format_points(gain, error)} points "
        words += f"over {format_design(designs.options[finest])}"
        no_sign = "so nothing shows that a finer skin would gain"
        limits = "so a finer skin may gain more" if gain > error else no_sign
        lines.append(f"{words}, {limits}.")
    return lines
