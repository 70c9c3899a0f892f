"""The command ``bench choose``: the cheapest system that is within one standard error of the best one.

Without ``over=`` it reads tracked runs; with it, it makes runs whose every fold chooses the smallest value of one
parameter on training subjects.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.commands import closing
from bench.commands.printing import grid, output, say, show, then
from bench.commands.run import evaluated
from bench.errors import InputError, nearest
from bench.outcomes.advice import FIRST, MOST_AT_HAND, SECOND, WHAT, at_hand, compared_on, is_first, merged
from bench.outcomes.choice import Choice, amount, candidates, decide, points, sentences
from bench.outcomes.comparable import MARK, MARKED
from bench.outcomes.runs import NothingTracked, of_kinds, without_runs
from bench.outcomes.store import connect
from bench.plan.arguments import BACKEND, Values, backend_of, convert, items, parse, typed
from bench.plan.arguments import KEYS as RUN_KEYS
from bench.plan.cells import Cell, cells
from bench.quantities import BUDGETS, COSTS, quantity
from bench.registry import parameters
from bench.work.loop import Outcome, warn
from models import contract

if TYPE_CHECKING:
    from models.space import How, Tuning

AMONG = ("data", "where", "target", "protocol", "model", "features")  # of tracked runs
KEYS = RUN_KEYS | {"over", "inner", "by", "margin", "shots", "unit", "clock", "batch", *BUDGETS}
UNITS = ("capture", "window")
WINDOW = FIRST["model.window"]  # seconds, of a model that is to label windows
MEGAHERTZ = {"kHz": 1e-3, "MHz": 1.0, "GHz": 1e3}
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
        mixed: whether training and test captures come from the same subjects.
        advice: which runs are left out, what may fit besides, and the commands that run it.
    """

    choice: Choice
    about: str
    by: str
    budgets: dict[str, float]
    margin: float | None
    subjects: int
    mixed: bool = False
    advice: list[str] = field(default_factory=list)

    @property
    def system(self) -> str | None:
        """What is chosen, None if nothing fits the budgets."""
        chosen = self.choice.chosen
        return None if chosen is None else str(self.choice.table.loc[chosen, "system"])

    def __str__(self) -> str:
        return "\n".join([f"{self.about}:", *self.lines()])

    def lines(self) -> list[str]:
        """The choice and its reason, or what binds and what to do."""
        return [*sentences(self.choice, self.by, self.margin, self.subjects, self.mixed), *self.advice]

    __repr__ = __str__


def choose(arguments: list[str]) -> int:
    """Print the choice and its reason; exit code 1 if nothing fits the budgets.

    Raises:
        InputError: something in the arguments cannot be used, or no run is tracked for them.
    """
    values = parse(arguments, KEYS)
    if "over" in values:
        outcomes = smallest(values)
        code = show(outcomes)
        closing.evaluated(outcomes)
        return code
    try:
        found = chosen(values)
    except NothingTracked:
        steps = first_steps(values)
        print("A first comparison:", *steps, sep="\n  ")
        raise
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
    unit = str(values.get("unit", "capture"))
    if unit not in UNITS:
        raise InputError(f"unit={unit}: {nearest(unit, UNITS)}")
    budgets = {BUDGETS[k]: quantity(k, values[k]) for k in BUDGETS if k in values}
    margin = quantity("margin", values["margin"]) if "margin" in values else None
    clock = _clock(str(values["clock"])) if "clock" in values else None
    text = str(values.get("batch", "no")).lower()
    batch = {"true": "yes", "false": "no"}.get(text, text)
    if batch not in ("yes", "no"):
        raise InputError(f"batch={batch}: give yes or no")
    asked = {k: items(k, values[k]) for k in AMONG if k in values}
    if "shots" in values:
        shots = convert("shots", values["shots"], 0)
        if shots < 0:
            raise InputError(f"shots={shots}: give 0 or more")
        asked |= {"shots": [str(shots)], "protocol": asked.get("protocol", ["personal"])}
    asked |= {k: items(k, v) for k, v in values.items() if k.startswith("protocol.")}
    store = connect()
    runs_of = of_kinds(store, ("cell", "chip", "stream"))
    for lacking in without_runs(list(runs_of.values()), asked):
        warn(f"warning: {lacking}: no run of it is tracked")
    found = candidates(
        store, asked, budgets.get("decision"), by == "decision", runs_of, unit == "window", clock, batch == "yes"
    )
    if (by == "predict" or "predict" in budgets) and found.table["cpu"].nunique() > 1:
        warn(f"warning: times are of several processors: {'; '.join(sorted(set(found.table['cpu'])))}")
    choice = decide(found.table, found.subjects, by, budgets, margin)
    advice = [*found.notes, *_advice(choice, by, budgets, unit == "window")]
    if clock is not None or "decision" in {by, *budgets}:
        advice.insert(0, _decision_time(found.table, clock))
    chosen = "" if choice.chosen is None else str(choice.table["unit"][choice.chosen])
    if "decision" in budgets and chosen.startswith("first"):
        advice.append(
            "That is the last replayed moment within the budget; bench stream with a smaller hop_ms= has more."
        )
    if unit == "capture" and "decision" in {by, *budgets} and choice.table["windows"].any():
        advice.append("One window alone is labelled sooner, and is scored in percent of windows: see unit=window.")
    return Chosen(choice, found.about, by, budgets, margin, len(found.subjects.columns), found.mixed, advice)


def _clock(text: str) -> float:
    """A clock in MHz.

    Raises:
        InputError: it is no number above 0 with a unit.
    """
    number, unit = text[:-3].strip(), text[-3:]
    try:
        value = float(number) * MEGAHERTZ[unit]
        if not 0 < value < float("inf"):
            raise ValueError(text)
    except (ValueError, KeyError) as e:
        raise InputError(f"clock={text}: give a number above 0 and kHz, MHz or GHz, such as 64MHz") from e
    return value


def _decision_time(table: pd.DataFrame, clock: float | None) -> str:
    """What the time until a decision consists of."""
    touch = "The time until a decision is the touch that it needs"
    if clock is None:
        return f"{touch}; computing time on this machine is not part of it."
    timed = int(table["cycles"].notna().sum())
    return f"{touch}; for {timed} of {len(table)} candidates, plus the measured cycles at {clock:g} MHz."


def first_steps(values: Values) -> list[str]:
    """Commands that make a first comparison of what was asked for, and choose.

    Raises:
        InputError: there is no such model, feature set or corpus.
    """
    given = {k: str(v) for k, v in values.items()}
    on = {k: v for k, v in given.items() if k.split(".")[0] in WHAT and (k, v) != ("where", "all")}
    if "shots" in given:
        on = {"protocol": "personal", **on, "protocol.shots": given["shots"]}
    systems: dict[str, str] = {k: given[k] for k in ("model", "features") if k in given}
    if "model" not in given:
        systems = FIRST | systems
    cells(on | systems)  # refuses names that nothing has
    if given.get("unit") == "window" and "model" in given:
        try:
            for cell in cells(on | systems | {"model.window": WINDOW}):
                contract.check(cell.estimator())
        except InputError:  # some cut their own
            pass
        else:
            systems |= {"model.window": WINDOW}
    kinds = _kinds({given.get("by", "flash"), *(BUDGETS[k] for k in BUDGETS if k in given)})
    commands = [typed(kind, on | systems) for kind in ("run", *kinds)]
    if systems == FIRST and given.get("unit") != "window":
        commands.insert(0, typed("run", on | SECOND))
    return [*commands, typed("choose", given)]


def _kinds(costs: set[str]) -> list[str]:
    """Kinds of run, besides those of ``bench run``, that make these costs known, or lower."""
    return [kind for cost, kind in (("decision", "stream"), ("cycles", "chip")) if cost in costs]


def _advice(choice: Choice, by: str, budgets: dict[str, float], windows: bool) -> list[str]:
    """What may fit besides, and the commands that run it.

    It is told where nothing fits, and of a budget for which runs of a kind are needed that nobody has made.
    """
    table, fits = choice.table, choice.chosen is not None
    kinds = [] if windows else _kinds({*budgets} if fits else {by, *budgets})  # single windows are of bench run alone
    if fits:
        kinds = [kind for kind in kinds if kind not in set(table["kind"])]
    if fits and not kinds:
        return []
    said = []
    if {"cycles", "predict"} <= {*budgets}:
        said.append(
            "bench chip measures cycles and bench run measures predict, so no candidate has both: give one of them."
        )
    if not (on := compared_on(table)):
        return [*said, "The runs were made from Python with objects, so there is no command for more of them."]
    for kind in kinds:
        runs = at_hand(table, kind, {k: v for k, v in budgets.items() if k in ("flash", "ram")})
        if kind == "chip":
            runs = [each for each in runs if all(closing.has_c(cell.estimator()) for cell in cells(each))]
        why = {"stream": "Replayed, a system can decide early", "chip": "Exported to C, a system has cycles"}
        if runs:
            more = f"; the {MOST_AT_HAND} most accurate" if len(runs) > MOST_AT_HAND else ""
            said.append(f"{why[kind]}. Not done yet for {len(runs)} tracked systems{more}:")
            said += [f"  {typed(kind, arguments)}" for arguments in merged(runs[:MOST_AT_HAND])]
    if not fits and not any(is_first(json.loads(text or "{}")) for text in table["arguments"]):
        said += ["A small system that is accurate on real touch:", f"  {typed('run', on | FIRST)}"]
    return said


def _print(found: Chosen) -> None:
    within = ", ".join(f"{k} at most {amount(k, v)}" for k, v in found.budgets.items()) or "no budget"
    rows = []
    for row in found.choice.table.to_dict("records"):
        loss = "-" if np.isnan(row["loss"]) else points(row["loss"], row["error"])
        row_of = {"system": row["system"], "labels": row["unit"], "accuracy %": f"{row['accuracy']:.1f}"}
        costs = {k: amount(k, row[k]) + "*" * (row["linked"] and k in ("flash", "ram")) for k in COSTS}
        row_of |= {"below best": loss} | costs | {"verdict": row["verdict"]}
        rows.append(row_of)
    spare = [k for k in ("cycles", "predict", "ram", "decision", "flash") if k != found.by and k not in found.budgets]
    bold = [i for i, index in enumerate(found.choice.table.index) if index == found.choice.chosen]
    title = f"{found.about}; {within}; cheapest by {found.by} first; accuracy is the mean over subjects"
    grid(output(), title, rows, ("system", "labels", "verdict"), spare, bold)
    if 0 < found.choice.table["linked"].sum() < len(rows):
        output().print("* as linked in C, code included; the other sizes are counted without code", style="dim")
    say(*found.lines(), *([f"{MARKED}."] if any(MARK in row["system"] for row in rows) else []))
    if found.choice.chosen is not None:
        one = dict(found.choice.table.loc[found.choice.chosen])
        steps = (
            []
            if one.get("conditions")
            else closing.shipped(json.loads(one["arguments"] or "{}"), one["command"], one["unit"])
        )
        most = {f"max_{cost}": f"{limit:g}{COSTS[cost]}" for cost, limit in found.budgets.items()}
        then(*steps, *([typed("report", most)] if most else []))


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
