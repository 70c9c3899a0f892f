"""The command ``bench choose``: the cheapest system that is within one standard error of the best one.

It reads tracked runs; with ``over=`` it makes runs, see `bench.commands.smallest`.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from bench.arguments import BACKEND, Values, convert, items, parse, typed
from bench.commands.printing import grid, one_label, output, say, show, then
from bench.costs import BUDGETS, COSTS, WATCH_BUDGETS, WATCHED, quantity
from bench.errors import InputError, nearest
from bench.options import SMALL, keys
from bench.outcomes.choice import (
    KINDS,
    WATCH,
    Candidates,
    Choice,
    amount,
    candidates,
    decide,
    points,
    sentences,
    several,
)
from bench.outcomes.comparable import MARK, MARKED
from bench.outcomes.runs import of_kinds, without_runs
from bench.outcomes.store import connect
from bench.progress import warn

AMONG = ("data", "where", "target", "protocol", "model", "features")  # of tracked runs
KEYS = keys("choose")
RUNNING = {*BACKEND, "inner", "seed"}  # keys that are of use with over= alone
UNWATCHED = ("decision", "cycles")  # costs that a run of bench watch does not have
FIT = ("data", "where", "target", "model", "features", "seed")  # keys of bench fit that a run has


@dataclass(frozen=True)
class Chosen:
    """A choice and its candidates.

    Attributes:
        choice: result of `bench.outcomes.choice.decide`.
        among: the candidates.
        by: the cost that is to be low.
        budgets: the most of each cost.
        margin: points that do not matter, or None.
        clock: clock of the target in MHz, or None.
    """

    choice: Choice
    among: Candidates
    by: str
    budgets: dict[str, float]
    margin: float | None
    clock: float | None = None

    @property
    def system(self) -> str | None:
        """Name of the chosen system, None if nothing fits the budgets."""
        chosen = self.choice.chosen
        return None if chosen is None else str(self.choice.table.loc[chosen, "system"])

    @property
    def watched(self) -> bool:
        """True for a choice among runs of ``bench watch``."""
        return {*WATCHED} <= {*self.among.table}

    def __str__(self) -> str:
        return "\n".join([f"{self.among.context}:", *self.lines()])

    def lines(self) -> list[str]:
        """The choice and its reason, or the binding budget and a remedy."""
        subjects, table = self.among.subjects.shape[1], self.among.table
        lines = sentences(self.choice, self.by, self.margin, subjects, self.among.mixed)
        if self.watched and self.choice.chosen is not None:
            values = table[[*WATCHED]].to_numpy(float)[table.index.get_loc(self.choice.chosen)]
            alarms, latency = (
                amount(k, v).replace(" per", " false alarms per") for k, v in zip(WATCHED, values, strict=True)
            )
            lines.insert(1, f"It raises {alarms} of background; its median latency is {latency}.")
        if self.clock is not None:
            timed = f"for {table['cycles'].notna().sum()} of {several(len(table), 'system')}"
            lines.append(f"Decision time is touch before the decision, plus cycles at {self.clock:g} MHz {timed}.")
        elif "decision" in {self.by, *self.budgets}:
            lines.append("Decision time is touch before the decision, without computing time on this machine.")
        if self.watched:
            lines.append("Accuracy is the share of touches in recordings whose label is correct at the end.")
        lines += self.among.notes
        if self.choice.chosen is None:
            command = "watch" if self.watched else "run"
            lines.append(f"Try a small system that is accurate on real touch: bench {command} {SMALL}")
        return lines

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
    result = chosen(values)
    _print(result)
    return 0 if result.system else 1


def chosen(values: Values) -> Chosen:
    """The choice among tracked runs.

    Raises:
        InputError: something in the values cannot be used, or no run is tracked for them.
    """
    if running := [k for k in values if k in RUNNING or ("." in k and not k.startswith("protocol."))]:
        raise InputError(f"{running[0]}= needs over=, which runs systems; leave {running[0]}= out or add over=")
    by, unit = _one_of("by", values, COSTS), _one_of("unit", values, ("capture", "window"))
    batch = _one_of("batch", values, ("no", "yes")) == "yes"
    every = BUDGETS | WATCH_BUDGETS
    budgets = {every[k]: quantity(k, values[k]) for k in every if k in values}
    watched = bool({*WATCHED} & {*budgets})
    if watched:
        _check_watched(values, by, unit, budgets)
    margin, clock = (quantity(k, values[k]) if k in values else None for k in ("margin", "clock"))
    asked = {k: items(k, v) for k, v in values.items() if k in AMONG or k.startswith("protocol.")}
    if "shots" in values:
        shots = convert("shots", values["shots"], 0)
        if shots < 0:
            raise InputError(f"shots={shots}: give 0 or more")
        asked = {"protocol": ["personal"], **asked, "shots": [str(shots)]}
    store = connect()
    runs_of = of_kinds(store, [WATCH] if watched else KINDS)
    for lacking in without_runs(list(runs_of.values()), asked):
        warn(f"warning: {lacking}: no run is stored")
    most = budgets.get("decision", np.inf if by == "decision" else None)
    among = candidates(
        store, asked, most, windows=unit == "window", clock=clock, batch=batch, watched=watched, runs_of=runs_of
    )
    processors = sorted(set(among.table["cpu"]))
    if "predict" in {by, *budgets} and len(processors) > 1:
        warn(f"warning: computing times come from several processors: {'; '.join(processors)}")
    return Chosen(decide(among.table, among.subjects, by, budgets, margin), among, by, budgets, margin, clock)


def _check_watched(values: Values, by: str, unit: str, budgets: dict[str, float]) -> None:
    """Refuse keys that runs of ``bench watch`` cannot be compared by.

    Raises:
        InputError: there is one.
    """
    given = next(k for k in WATCH_BUDGETS if k in values)
    wrong = [f"by={by}"] * (by in UNWATCHED) + [f"max_{k}=" for k in UNWATCHED if k in budgets]
    wrong += [f"unit={unit}"] * (unit == "window") + ["clock="] * ("clock" in values)
    if wrong:
        raise InputError(f"{wrong[0]}: runs of bench watch, which {given}= compares, have no such value; leave it out")


def _one_of(key: str, values: Values, names: Collection[str]) -> str:
    """The value of a key that takes some names, the first of them where it is not there."""
    first, *_ = names
    name = str(values.get(key, first))
    name = {"true": "yes", "false": "no"}.get(name.lower(), name)  # also from Python
    if name not in names:
        raise InputError(f"{key}={name}: {nearest(name, names)}")
    return name


def _print(result: Chosen) -> None:
    table, by = result.choice.table, result.by
    limits = [f"{k.replace('_', ' ')} at most {amount(k, v)}" for k, v in result.budgets.items()]
    within = ", ".join(limits) or "no budget"
    rows = []
    for row in table.to_dict("records"):
        loss = "-" if np.isnan(row["loss"]) else points(row["loss"], row["error"])
        cells = {"system": row["system"], "input": row["unit"], "accuracy %": f"{row['accuracy']:.1f}"}
        known = [k for k in (*WATCHED, *COSTS) if k in table and not (result.watched and k in UNWATCHED)]
        costs = {
            k.replace("_", " "): amount(k, row[k]) + "*" * (row["linked"] and k in ("flash", "ram")) for k in known
        }
        rows.append(cells | {"below best": loss} | costs | {"verdict": row["verdict"]})
    spare = [k for k in ("cycles", "predict", "ram", "decision", "flash") if k != by and k not in result.budgets]
    bold = np.flatnonzero(table.index == result.choice.chosen).tolist()
    title = f"{result.among.context}; {within}; lowest {by} first; accuracy is the mean over subjects"
    grid(output(), title, rows, ("system", "input", "verdict"), spare, bold)
    if 0 < table["linked"].sum() < len(rows):
        output().print("* as linked in C, with code; other sizes exclude code", style="dim")
    say(*result.lines(), *([f"{MARKED}."] if table["system"].str.contains(MARK).any() else []))
    if result.choice.chosen is not None:
        one = table.loc[result.choice.chosen]
        trained = {k: v for k, v in json.loads(one["arguments"] or "{}").items() if k.split(".")[0] in FIT}
        # a search is not trained again, and a system that needs conditions is not saved
        once = trained and one["command"] in ("run", "stream", "chip", "watch") and not one["conditions"]
        then(typed("fit", trained | {"out": "chosen"}) if once else "bench report")
