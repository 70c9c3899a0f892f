"""The command ``bench choose``: the cheapest system that is within one standard error of the best one.

It reads tracked runs; with ``over=`` it makes runs, see `bench.commands.smallest`.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from bench import pareto
from bench.arguments import BACKEND, Values, convert, items, parse, typed
from bench.commands.printing import grid, one_label, output, say, show, then
from bench.costs import BUDGETS, COSTS, ROBUST, WATCH_BUDGETS, WATCHED, quantity
from bench.errors import InputError, nearest
from bench.options import SMALL, keys
from bench.outcomes.candidates import (
    KINDS,
    STRESS,
    WATCH,
    Candidates,
    Faults,
    candidates,
    complete_on,
    elsewhere,
    missing,
    repeated,
)
from bench.outcomes.choice import NOUNS, Choice, amount, decide, named, points, sentences
from bench.outcomes.comparable import MARK, MARKED, several, system_of
from bench.outcomes.expected import Expected, expectation, expected, more_people
from bench.outcomes.runs import needed, of_kinds, rows_of, without_runs
from bench.outcomes.store import Store, connect
from bench.progress import warn
from bench.scene_file import EVERY, Scene, read_scene

AMONG = ("data", "where", "target", "protocol", "model", "features")  # of tracked runs
KEYS = keys("choose")
RUNNING = {*BACKEND, "inner", "seed"}  # keys that are of use with over= alone
SHOWN = 3  # of systems and commands that a sentence names
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
        scene: reactions, faults and notes of the scene.
        expected: expectations for new people; None if nothing fits or there are too few people.
        lacking: commands that measure what is not stored, by what they measure, in words.
        growth: sentence on more training people, empty if no learning curve is stored.
        notes: sentences on the board of the scene.
    """

    choice: Choice
    among: Candidates
    by: str
    budgets: dict[str, float]
    margin: float | None
    clock: float | None = None
    scene: Scene = Scene()
    expected: Expected | None = None
    lacking: Mapping[str, list[str]] = field(default_factory=dict)
    growth: str = ""
    notes: list[str] = field(default_factory=list)

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
        lines += [*expectation(self.expected, self.among, self.choice.chosen), *([self.growth] if self.growth else [])]
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
        lines += [*self._dominated(), *self.notes, *self._meaning(), *self.among.notes]
        for what, commands in self.lacking.items():
            more = f"; and {len(commands) - SHOWN} more" if len(commands) > SHOWN else ""
            lines.append(f"{what} is not stored. To measure it: {'; '.join(commands[:SHOWN])}{more}.")
        if self.choice.chosen is None:
            command = "watch" if self.watched else "run"
            lines.append(f"Try a small system that is accurate on real touch: bench {command} {SMALL}")
        return lines

    __repr__ = __str__

    def _dominated(self) -> list[str]:
        """The candidates that are no better than another one in anything that was asked for."""
        asked = list(dict.fromkeys([self.by, *self.budgets]))
        table = self.among.table
        by = pareto.dominated_by(table["accuracy"].round(9).to_numpy(float), table[asked].to_numpy(float))
        rows, worse = rows_of(table), [int(i) for i in np.flatnonzero(by >= 0)]
        if not worse:
            return []
        pairs = [f"{named(rows[i])} (by {named(rows[by[i]])})" for i in worse]
        more = f"; and {len(pairs) - SHOWN} more" if len(pairs) > SHOWN else ""
        return [
            f"No better than another system in score and {', '.join(NOUNS[name] for name in asked)}: "
            f"{'; '.join(pairs[:SHOWN])}{more}."
        ]

    def _meaning(self) -> list[str]:
        """What the score and the losses are of, where that is not the accuracy of gestures in captures."""
        lines, reactions = [], self.scene.reactions
        if self.watched:
            lines.append("The score is of touches in recordings, with the label at the end.")
        if reactions.weighted:
            costs = [f"{true} taken for {k} {v:g}" for true, row in reactions.costs.items() for k, v in row.items()]
            costs += [f"doing nothing {reactions.silence:g}", "any other mistake 1"]
            lines.append(f"The score is 100 less 100 times the mean cost: {', '.join(costs)}; the right reaction 0.")
            if not reactions.silence:
                lines.append("Doing nothing costs nothing here, so a robot that never reacts scores 100 %.")
        if not reactions.plain:
            groups = [f"{name} ({', '.join(members)})" for name, members in reactions.groups.items()]
            if {*self.among.gestures} - {g for members in reactions.groups.values() for g in members}:
                groups.append(f"unlisted gestures are {'ignored' if reactions.ignored else 'their own reaction'}")
            lines.append(f"Reactions: {'; '.join(groups)}.")
        faults = self.scene.faults
        if faults is not None:
            names = "all faults" if {*faults.names} == {*EVERY} else ", ".join(faults.names)
            lines.append(
                f"Losses are of whole captures under {names}, severities 1 to {faults.severity}, without labels of a "
                "new person; the reaction is that to the most probable gesture."
            )
        return lines


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
    scene = read_scene(str(values["scene"])) if "scene" in values else Scene()
    values = {**scene.values, **values}
    by, unit = _one_of("by", values, COSTS | ROBUST | WATCHED), _one_of("unit", values, ("capture", "window"))
    batch = _one_of("batch", values, ("no", "yes")) == "yes"
    every = BUDGETS | WATCH_BUDGETS
    if scene.faults is None and any("fault" in cost for cost in (by, *(every[k] for k in every if k in values))):
        scene = replace(scene, faults=Faults(EVERY))
    budgets = {every[k]: quantity(k, values[k]) for k in every if k in values}
    watched = bool({*WATCHED} & {by, *budgets})
    if watched:
        _check_watched(values, by, unit, budgets)
    if scene.faults is not None and unit == "window":
        raise InputError("unit=window: losses under faults are of whole captures; leave it or the faults out")
    margin, clock = (quantity(k, values[k]) if k in values else None for k in ("margin", "clock"))
    asked = {k: items(k, v) for k, v in values.items() if k in AMONG or k.startswith("protocol.")}
    if "shots" in values:
        shots = convert("shots", values["shots"], 0)
        if shots < 0:
            raise InputError(f"shots={shots}: give 0 or more")
        asked = {"protocol": ["personal"], **asked, "shots": [str(shots)]}
        if wrong := {*asked["protocol"]} - {"personal", "transfer"}:
            raise InputError(f"protocol={min(wrong)}: it has no shots; leave protocol= or shots out")
        if watched:
            raise InputError(f"shots={shots}: bench watch has no captures of a new person; leave shots out")
    store = connect()
    runs_of = of_kinds(store, [*([WATCH, "cell"] if watched else KINDS), STRESS])
    for part in without_runs([runs_of[kind] for kind in runs_of if kind != STRESS], asked):
        warn(f"warning: {part}: no run is stored")
    most = budgets.get("decision", np.inf if by == "decision" else None)
    among = candidates(
        store,
        asked,
        most,
        windows=unit == "window",
        clock=clock,
        batch=batch,
        watched=watched,
        reactions=scene.reactions,
        faults=scene.faults,
        runs_of=runs_of,
    )
    processors = sorted(set(among.table["cpu"]))
    if "predict" in {by, *budgets} and len(processors) > 1:
        warn(f"warning: computing times come from several processors: {'; '.join(processors)}")
    choice = decide(among.table, among.subjects, by, budgets, margin)
    one = None if choice.chosen is None else expected(among.people, choice.chosen, by, budgets, margin)
    growth = "" if choice.chosen is None else _growth(store, runs_of.get(STRESS), among, choice.chosen, scene)
    lacking = _lacking(among, [by, *budgets], scene)
    if (watched or "shots" in values) and "cell" in runs_of and not {"model", "features"} & {*asked}:
        more = {} if watched else {"protocol": "personal", "protocol.shots": asked["shots"][0]}
        if commands := elsewhere(runs_of["cell"], among.first, among.table, "watch" if watched else "run", more):
            what = "in recordings" if watched else "with labels of a new person"
            lacking[f"The score of {several(len(commands), 'other system')} {what}"] = commands
    if choice.chosen is not None and not growth and "scene" in values and (command := _curve(among, choice.chosen)):
        lacking["The gain of more people"] = [command]
    notes = scene.board.sentences(values) if scene.board else []
    return Chosen(choice, among, by, budgets, margin, clock, scene, one, lacking, growth, notes)


def _lacking(among: Candidates, costs: list[str], scene: Scene) -> dict[str, list[str]]:
    """Commands that measure costs which are asked for and not stored, by what they measure."""
    wanted = [*dict.fromkeys([*costs, *["fault_loss"] * (scene.faults is not None)])]
    wanted = [cost for cost in wanted if cost != "worst_fault" or "fault_loss" not in wanted]  # by the same command
    return {
        f"The {NOUNS[cost]} of {several(len(commands), 'system')}": commands
        for cost, commands in missing(among.table, wanted, scene.faults).items()
    }


def _curve(among: Candidates, chosen: int) -> str:
    """The command that measures a learning curve of the chosen system, empty where there are too few people for one."""
    trained = repeated(among.table["arguments"][chosen], impersonal=True)
    others = among.subjects.shape[1] - 1
    numbers = sorted({n for n in (2, max(3, others // 2), max(3, 2 * others // 3)) if n < others})
    if not trained or len(numbers) < 2 or among.mixed:
        return ""
    return typed("stress", trained | {"faults": "none", "train_subjects": ",".join(map(str, numbers))})


def _growth(store: Store, runs: pd.DataFrame | None, among: Candidates, chosen: int, scene: Scene) -> str:
    """The gain of more training people in a sentence, empty if no learning curve of the chosen system is stored."""
    if runs is None or "train_subjects" not in runs:
        return ""
    same = runs["protocol_label"] == among.first["protocol_label"]
    kept = complete_on(runs, among.first) & (same | (runs["protocol_name"] == "loso"))
    kept &= np.array([system_of(run) == among.table["system"][chosen] for run in rows_of(runs)])
    for run in rows_of(runs[kept & (runs["train_subjects"] != "all")])[::-1]:
        result = more_people(pd.read_parquet(needed(store, run, "stress.parquet")), scene.reactions)
        if result is not None:
            most, gains = result
            words = [f"{r.more} more add {r.gain:.1f} [{r.low:.1f}, {r.high:.1f}]" for r in gains.itertuples()]
            return (
                f"By its learning curve on captures, {run['protocol_label']}: {', '.join(words)} points to a training "
                f"set of {most} people (fit of a - b / people; 95 % intervals over people)."
            )
    return ""


def _check_watched(values: Values, by: str, unit: str, budgets: dict[str, float]) -> None:
    """Refuse keys that runs of ``bench watch`` cannot be compared by.

    Raises:
        InputError: there is one.
    """
    given = next((k for k in WATCH_BUDGETS if k in values), "by")
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
        score = f"{'score' if result.scene.reactions.weighted else 'accuracy'} %"
        cells = {"system": row["system"], "input": row["unit"], score: f"{row['accuracy']:.1f}"}
        asked = {result.by, *result.budgets, *(("fault_loss", "worst_fault") if result.scene.faults else ())}
        known = [k for k in (*WATCHED, *COSTS) if k in table and not (result.watched and k in UNWATCHED)]
        known += [k for k in ROBUST if k in asked]
        costs = {
            k.replace("_", " "): amount(k, row[k]) + "*" * (row["linked"] and k in ("flash", "ram")) for k in known
        }
        rows.append(cells | {"below best": loss} | costs | {"verdict": row["verdict"]})
    spare = [k for k in ("cycles", "predict", "ram", "decision", "flash") if k != by and k not in result.budgets]
    bold = np.flatnonzero(table.index == result.choice.chosen).tolist()
    kind = "score" if result.scene.reactions.weighted else "accuracy"
    title = f"{result.among.context}; {within}; lowest {by.replace('_', ' ')} first; {kind} is the mean over subjects"
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
