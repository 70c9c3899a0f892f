"""The command ``bench choose``: the cheapest system that is within one standard error of the best one.

It reads tracked runs; with ``over=`` it makes runs, see `bench.commands.smallest`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bench.arguments import BACKEND, Values, convert, items, parse, typed
from bench.commands.printing import grid, one_label, output, say, show, then
from bench.costs import BUDGETS, COSTS, quantity
from bench.errors import InputError, nearest
from bench.options import SMALL, keys
from bench.outcomes.choice import Choice, amount, candidates, decide, points, sentences
from bench.outcomes.comparable import MARK, MARKED
from bench.outcomes.runs import of_kinds, without_runs
from bench.outcomes.store import connect
from bench.progress import warn

AMONG = ("data", "where", "target", "protocol", "model", "features")  # of tracked runs
KEYS = keys("choose")
UNITS = ("capture", "window")
FIT = ("data", "where", "target", "model", "features", "seed")  # keys of bench fit that a run has
HINTS = {  # by cost, the kind of run that makes it known or lower, and what to type
    "decision": ("stream", "bench stream replays systems, which can then decide early."),
    "cycles": ("chip", "bench chip exports systems to C and counts their cycles."),
}
MEGAHERTZ = {"kHz": 1e-3, "MHz": 1.0, "GHz": 1e3}


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
        advice: which runs are left out, and which commands may find more.
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
        from bench.commands.smallest import smallest  # all that runs folds, which choosing among runs does not need

        outcomes = smallest(values)
        code = show(outcomes)
        one_label(outcomes)
        then("bench choose")
        return code
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
    made = {"stream", "chip"} if unit == "window" else set(found.table["kind"])
    hints = [hint for cost, (kind, hint) in HINTS.items() if cost in {by, *budgets} and kind not in made]
    advice = [*found.notes, *hints]
    if choice.chosen is None:
        advice.append(f"A small system that is accurate on real touch: bench run {SMALL}")
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
        one = found.choice.table.loc[found.choice.chosen]
        trained = {k: v for k, v in json.loads(one["arguments"] or "{}").items() if k.split(".")[0] in FIT}
        # a search is not trained again, and a system that needs conditions is not saved
        once = trained and one["command"] in ("run", "stream", "chip") and not one.get("conditions")
        then(typed("fit", trained | {"out": "chosen"}) if once else "bench report")
