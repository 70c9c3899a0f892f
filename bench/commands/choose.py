"""The command ``bench choose``: the cheapest system that is within one standard error of the best one.

It reads tracked runs.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench import few, pareto
from bench.amounts import convert, quantity
from bench.arguments import parse
from bench.candidate import Losses, Wish
from bench.commands.printing import output, say, then
from bench.comparable import MARKED, notes_on, several
from bench.errors import InputError, nearest
from bench.measures import Cost, Measure, Row, budgets, costs, costs_of, text
from bench.options import SMALL, keys, makers
from bench.outcomes.candidates import Candidates, candidates, complete_on, elsewhere, missing, repeated
from bench.outcomes.choice import Choice, decide, details, named, points, prices, scope, verdict
from bench.outcomes.expected import Expected, expectation, expected
from bench.outcomes.runs import asked_of, every_result, plain, without_runs
from bench.outcomes.store import connect
from bench.progress import warn
from bench.registry import classes
from bench.result import Result
from bench.scene_file import EVERY, Scene, read_scene
from bench.table import Table, rows_of
from bench.words import Values, typed

SHOWN = 3  # of systems and commands that a sentence names
BRIEF = 5  # sentences without why=yes, beside those on what else there is and what to type next
FIT = ("data", "where", "target", "model", "features", "seed")  # keys of bench fit that a run has


@dataclass(frozen=True)
class Chosen:
    """A choice and its candidates.

    Attributes:
        choice: result of `bench.outcomes.choice.decide`.
        among: the candidates.
        by: the cost to minimise.
        budgets: budget of each cost.
        margin: points that do not matter, or None.
        clock: clock of the target in MHz, or None.
        scene: reactions, faults and notes of the scene.
        expected: expectations for new people; None if nothing fits or there are too few people.
        lacking: commands that measure what is not stored, by what they measure, in words.
        growth: sentence on more training people, empty if no learning curve is stored.
        notes: sentences on the board of the scene.
        why: True to print all sentences.
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
    why: bool = False

    @property
    def system(self) -> str | None:
        """Name of the chosen system, None if nothing fits the budgets."""
        chosen = self.choice.chosen
        return None if chosen is None else str(self.choice.table.loc[chosen, "system"])

    @property
    def watched(self) -> bool:
        """True for a choice among runs on recordings."""
        return bool(self.kind.recordings)

    @property
    def kind(self) -> Any:
        """Kind of run of the candidates."""
        return kind_of(self.among.first)

    def __str__(self) -> str:
        return "\n".join([f"{self.among.context}:", *self.lines()])

    def lines(self) -> list[str]:
        """The choice, its reason and what to expect, or the binding budgets and a remedy; all with ``why``."""
        brief, every = self._brief(), self._every()
        lines = every if self.why else brief
        more = 0 if self.why else sum(line not in brief for line in every)
        lines = [*lines, *([f"{several(more, 'more sentence')} with why=yes."] if more else [])]
        if self.choice.chosen is None:
            lines.append(f"Try a small system that is accurate on real touch: bench {_command(self.watched)} {SMALL}")
        return lines

    @property
    def _verdict(self) -> list[str]:
        """The choice, what its kind of run tells of it, and the reason."""
        first, *reason = verdict(self.choice, self.by, self.margin, self.among.subjects.shape[1])
        chosen = self.choice.chosen
        told = "" if chosen is None else self.kind.chosen(self.among.table.loc[chosen].to_dict())
        return [first, *([told] if told else []), *reason]

    @property
    def _scope(self) -> list[str]:
        return [] if self.choice.chosen is None else scope(self.among.subjects.shape[1], self.among.mixed)

    def _brief(self) -> list[str]:
        """At most `BRIEF` sentences."""
        if self.system is None:
            lacking = [f"{what} is not stored. To measure it: {first}." for what, (first, *_) in self.lacking.items()]
            return [*self._verdict, *prices(self.choice, binding=True), *lacking[:1]][:BRIEF]
        expect = expectation(self.expected, self.among, self.choice.chosen)[:1]
        notes = notes_on(self.system, str(self.among.first["data"]))
        notes += [MARKED] * any(MARKED in notes_on(str(name), "") for name in self.among.table["system"])
        footnotes = dict.fromkeys(f"{note.rstrip('.')}." for note in notes)
        return [*self._verdict, *expect, *self._scope, *footnotes][:BRIEF]

    def _every(self) -> list[str]:
        """All sentences but the remedy."""
        table = self.among.table
        lines = [*self._verdict, *details(self.choice, self.by, self.among.subjects.shape[1]), *self._scope]
        lines += [*expectation(self.expected, self.among, self.choice.chosen), *([self.growth] if self.growth else [])]
        if self.clock is not None:
            timed = f"for {table['cycles'].notna().sum()} of {several(len(table), 'system')}"
            lines.append(f"Decision time is touch before the decision, plus cycles at {self.clock:g} MHz {timed}.")
        elif "decision" in {self.by, *self.budgets}:
            lines.append("Decision time is touch before the decision, without computing time on this machine.")
        lines += [*self._dominated(), *self.notes, *self._meaning(), *self.among.notes]
        data = str(self.among.first["data"])
        notes = dict.fromkeys(note for system in table["system"] for note in notes_on(str(system), data))
        lines += [f"{note.rstrip('.')}." for note in notes]
        for what, commands in self.lacking.items():
            more = f"; and {len(commands) - SHOWN} more" if len(commands) > SHOWN else ""
            lines.append(f"{what} is not stored. To measure it: {'; '.join(commands[:SHOWN])}{more}.")
        return lines

    __repr__ = __str__

    def _dominated(self) -> list[str]:
        """The candidates that are no better than another one in anything that was asked for."""
        asked = list(dict.fromkeys([self.by, *self.budgets]))
        table = self.among.table
        burdens = np.column_stack([costs()[name].burden(table[name].to_numpy(float)) for name in asked])
        by = pareto.dominated_by(table["accuracy"].round(9).to_numpy(float), burdens)
        rows, worse = rows_of(table), [int(i) for i in np.flatnonzero(by >= 0)]
        if not worse:
            return []
        pairs = [f"{named(rows[i])} (by {named(rows[by[i]])})" for i in worse]
        more = f"; and {len(pairs) - SHOWN} more" if len(pairs) > SHOWN else ""
        return [
            f"No better than another system in score and {', '.join(costs()[name].noun for name in asked)}: "
            f"{'; '.join(pairs[:SHOWN])}{more}."
        ]

    def _meaning(self) -> list[str]:
        """What the score and the losses are of, where that is not the accuracy of gestures in captures."""
        lines, reactions = [], self.scene.reactions
        if self.kind.meaning:
            lines.append(self.kind.meaning)
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
    values = parse(arguments, keys("choose"))
    result = chosen(values)
    _print(result)
    return 0 if result.system else 1


def chosen(values: Values) -> Chosen:
    """The choice among tracked runs.

    Raises:
        InputError: something in the values cannot be used, or no run is tracked for them.
    """
    if dotted := [k for k in values if "." in k and not k.startswith("protocol.")]:
        raise InputError(f"{dotted[0]}= runs a system, and bench choose reads stored runs; leave {dotted[0]}= out")
    scene = read_scene(str(values["scene"])) if "scene" in values else Scene()
    values = {**scene.values, **values}
    by, unit = _one_of("by", values, costs()), _one_of("unit", values, ("capture", "window"))
    batch = _one_of("batch", values, ("no", "yes")) == "yes"
    limits = {cost.key: cost.typed(values[key]) for key, cost in budgets().items() if key in values}
    asked_costs = [costs()[name] for name in (by, *limits)]
    if scene.faults is None and any(cost.losses for cost in asked_costs):
        scene = replace(scene, faults=Losses(EVERY))
    watched = any(cost.runs == "recordings" for cost in asked_costs)
    if watched:
        _check_watched(values, by, unit, limits)
    if scene.faults is not None and unit == "window":
        raise InputError("unit=window: losses under faults are of whole captures; leave it or the faults out")
    margin = quantity("margin", values["margin"]) if "margin" in values else None
    counted = "clock" in values and "cycles" in costs()  # a board of a scene has a clock, whatever is counted
    clock = quantity("clock", values["clock"], "MHz") if counted else None
    asked = asked_of(values)
    if "shots" in values:
        shots = convert("shots", values["shots"], 0)
        if shots < 0:
            raise InputError(f"shots={shots}: give 0 or more")
        asked = {"protocol": ["personal"], **asked, "shots": [str(shots)]}
        if wrong := {*asked["protocol"]} - {"personal", "transfer"}:
            raise InputError(f"protocol={min(wrong)}: it has no shots; leave protocol= or shots out")
        if watched:
            raise InputError(f"shots={shots}: bench {_command(True)} has no captures of a new person; leave shots out")
    results = every_result(connect())
    for part in without_runs([results], asked):
        warn(f"warning: {part}: no run is stored")
    most = limits.get("decision", np.inf if by == "decision" else None)
    among = candidates(
        results,
        asked,
        Wish(scene.reactions, most, unit == "window"),
        clock=clock,
        batch=batch,
        recordings=watched,
        losses=scene.faults,
    )
    processors = sorted(set(among.table["cpu"]))
    if "predict" in {by, *limits} and len(processors) > 1:
        warn(f"warning: computing times come from several processors: {'; '.join(processors)}")
    choice = decide(among.table, among.subjects, by, limits, margin)
    one = None if choice.chosen is None else expected(among.people, choice.chosen, by, limits, margin)
    growth = "" if choice.chosen is None else _growth(results, among, choice.chosen, scene)
    lacking = _lacking(among, [by, *limits], scene)
    if (watched or "shots" in values) and not {"model", "features"} & {*asked}:
        more = {} if watched else {"protocol": "personal", "protocol.shots": asked["shots"][0]}
        others = [r for r in plain(results) if not kind_of(r).recordings]
        if commands := elsewhere(others, among.first, among.table, _command(watched), more):
            what = "in recordings" if watched else "with labels of a new person"
            lacking[f"The score of {several(len(commands), 'other system')} {what}"] = commands
    if choice.chosen is not None and not growth and "scene" in values:
        lacking |= _curve(among, choice.chosen)
    notes = scene.board.sentences(values) if scene.board else []
    why = _one_of("why", values, ("no", "yes")) == "yes"
    return Chosen(choice, among, by, limits, margin, clock, scene, one, lacking, growth, notes, why)


def _lacking(among: Candidates, asked: list[str], scene: Scene) -> dict[str, list[str]]:
    """Commands that measure costs which are asked for and not stored, by what they measure."""
    lossy = [name for name, cost in costs().items() if cost.losses]
    wanted = [*dict.fromkeys([*asked, *lossy[: scene.faults is not None]])]
    first = {costs()[name].command: name for name in reversed(lossy) if name in wanted}  # which measures all
    wanted = [name for name in wanted if name not in lossy or first[costs()[name].command] == name]
    return {
        f"The {costs()[cost].noun} of {several(len(commands), 'system')}": commands
        for cost, commands in missing(among.table, wanted, scene.faults).items()
    }


def _curve(among: Candidates, chosen: int) -> dict[str, list[str]]:
    """Commands that measure what more people promise, by that in words; none where there are too few people."""
    trained = repeated(among.table["arguments"][chosen], impersonal=True)
    if not trained or among.mixed or among.subjects.shape[1] < few.INTERVAL:
        return {}
    every = (c.promise(trained, among.subjects.shape[1] - 1) for c in classes("circumstances").values())
    return {what: [command] for what, command in filter(None, every)}


def _growth(results: Sequence[Result], among: Candidates, chosen: int, scene: Scene) -> str:
    """What circumstances promise for the chosen system, such as the gain of more training people, in a sentence."""

    def same(r: Result) -> bool:
        alike = r["protocol_label"] == among.first["protocol_label"] or r["protocol_name"] == "loso"
        return alike and complete_on(r, among.first) and r.system == among.table["system"][chosen]

    for circumstance in classes("circumstances").values():
        for result in reversed(results):
            if circumstance.holds(result) and same(result):
                if sentence := circumstance.told(result, scene.reactions):
                    return sentence
    return ""


def kind_of(result: Result) -> Any:
    """The kind of a run."""
    return next(kind for kind in classes("kinds").values() if kind.tag == result.kind)


def _command(recordings: bool) -> str:
    """The command that makes runs on captures, or on recordings."""
    return next(name for name, kind in classes("kinds").items() if kind.recordings == recordings)


def _check_watched(values: Values, by: str, unit: str, limits: dict[str, float]) -> None:
    """Refuse keys that runs on recordings cannot be compared by.

    Raises:
        InputError: there is one.
    """
    given = next((k for k, cost in budgets().items() if cost.runs == "recordings" and k in values), "by")
    unwatched = [name for name, cost in costs().items() if not cost.watched]
    wrong = [f"by={by}"] * (by in unwatched) + [f"{costs()[k].budget}=" for k in unwatched if k in limits]
    wrong += [f"unit={unit}"] * (unit == "window") + ["clock="] * ("clock" in values)
    if wrong:
        command = _command(True)
        raise InputError(
            f"{wrong[0]}: runs of bench {command}, which {given}= compares, have no such value; leave it out"
        )


def _one_of(key: str, values: Values, names: Collection[str]) -> str:
    """The value of a key that takes some names, the first of them where it is not there."""
    first, *_ = names
    name = str(values.get(key, first))
    name = {"true": "yes", "false": "no"}.get(name.lower(), name)  # also from Python
    if name not in names:
        raise InputError(f"{key}={name}: {nearest(name, names)}")
    return name


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


def _print(result: Chosen) -> None:
    table = result.choice.table
    table_of(result).print(output())
    if 0 < table["linked"].sum() < len(table):
        output().print("* as linked in C, with code; other sizes exclude code", style="dim")
    say(*result.lines())
    if result.choice.chosen is not None:
        one = table.loc[result.choice.chosen]
        trained = {k: v for k, v in json.loads(one["arguments"] or "{}").items() if k.split(".")[0] in FIT}
        # a search is not trained again, and a system that needs conditions is not saved
        once = trained and one["command"] in makers() and not one["conditions"]
        then(typed("fit", trained | {"out": "chosen"}) if once else "bench report")
