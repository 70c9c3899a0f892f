"""The choice among stored runs: the table, the chosen system, and all sentences on it (``templates/choice.jinja``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench import few, pareto
from bench.candidate import Losses, Wish
from bench.comparable import MARKED, notes_on, several
from bench.errors import InputError
from bench.measures import budgets as budgets_by_key
from bench.measures import costs
from bench.outcomes.candidates import Candidates, candidates, complete_on, elsewhere, missing, repeated
from bench.outcomes.choice import Choice, decide, details, prices, said, scope, verdict
from bench.outcomes.expected import Expected, expectation, expected
from bench.outcomes.runs import plain, without_runs
from bench.progress import warn
from bench.registry import classes
from bench.result import Result
from bench.scene_file import EVERY, Scene
from bench.table import rows_of
from bench.words import SMALL

SHOWN = 3  # of systems and commands that a sentence names
BRIEF = 5  # sentences without why=yes, beside those on what else there is and what to type next


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
        command = None if self.choice.chosen is not None else f"{_command(self.watched)} {SMALL}"
        return [*lines, *said("rest", more=more, command=command)]

    @property
    def _verdict(self) -> list[str]:
        """The choice, what its kind of run tells of it, and the reason."""
        chosen = self.choice.chosen
        told = "" if chosen is None else self.kind.chosen(self.among.table.loc[chosen].to_dict())
        return verdict(self.choice, self.by, self.margin, self.among.subjects.shape[1], told)

    @property
    def _scope(self) -> list[str]:
        return [] if self.choice.chosen is None else scope(self.among.subjects.shape[1], self.among.mixed)

    def _brief(self) -> list[str]:
        """At most `BRIEF` sentences."""
        if self.system is None:
            first = {what: commands[:1] for what, commands in self.lacking.items()}
            lacking = said("lacking", lacking=first, shown=1)
            return [*self._verdict, *prices(self.choice, binding=True), *lacking[:1]][:BRIEF]
        expect = expectation(self.expected, self.among, self.choice.chosen)[:1]
        notes = notes_on(self.system, str(self.among.first["data"]))
        notes += [MARKED] * any(MARKED in notes_on(str(name), "") for name in self.among.table["system"])
        footnotes = dict.fromkeys(f"{note.rstrip('.')}." for note in notes)
        return [*self._verdict, *expect, *self._scope, *footnotes][:BRIEF]

    def _every(self) -> list[str]:
        """All sentences but the remedy."""
        table, data = self.among.table, str(self.among.first["data"])
        notes = dict.fromkeys(note for system in table["system"] for note in notes_on(str(system), data))
        return [
            *self._verdict,
            *details(self.choice, self.by, self.among.subjects.shape[1]),
            *self._scope,
            *expectation(self.expected, self.among, self.choice.chosen),
            *([self.growth] if self.growth else []),
            *self._computed(),
            *self.notes,
            *self._meaning(),
            *self.among.notes,
            *(f"{note.rstrip('.')}." for note in notes),
            *said("lacking", lacking=self.lacking, shown=SHOWN),
        ]

    __repr__ = __str__

    def _computed(self) -> list[str]:
        """What decision times are of, and candidates that are no better than another one in anything that was asked."""
        asked = list(dict.fromkeys([self.by, *self.budgets]))
        table = self.among.table
        burdens = np.column_stack([costs()[name].burden(table[name].to_numpy(float)) for name in asked])
        by = pareto.dominated_by(table["accuracy"].round(9).to_numpy(float), burdens)
        rows = rows_of(table)
        return said(
            "computed",
            clock=self.clock,
            timed=int(table["cycles"].notna().sum()) if self.clock is not None else 0,
            systems=len(table),
            decision="decision" in asked,
            costs=[costs()[name].noun for name in asked],
            worse=[(rows[i], rows[by[i]]) for i in np.flatnonzero(by >= 0)],
            shown=SHOWN,
        )

    def _meaning(self) -> list[str]:
        """What the score and the losses are of, where that is not the accuracy of gestures in captures."""
        reactions, faults = self.scene.reactions, self.scene.faults
        listed = {gesture for members in reactions.groups.values() for gesture in members}
        every = faults is not None and {*faults.names} == {*EVERY}
        return said(
            "meaning",
            kind=self.kind.meaning,
            reactions=reactions,
            unlisted={*self.among.gestures} - listed,
            faults=faults,
            names=["all faults"] if every else list(faults.names) if faults else [],
        )


def chosen(
    results: Sequence[Result],
    asked: Mapping[str, list[str]],
    by: str,
    budgets: Mapping[str, float],
    *,
    scene: Scene | None = None,
    margin: float | None = None,
    clock: float | None = None,
    unit: str = "capture",
    batch: bool = False,
    shots: int | None = None,
    notes: Sequence[str] = (),
    why: bool = False,
) -> Chosen:
    """The choice among stored runs.

    Args:
        results: results of all kinds.
        asked: the runs to choose among, as `bench.outcomes.runs.selected` takes them.
        by: the cost to minimise.
        budgets: budget of each cost.
        scene: reactions and faults; None without one.
        margin: points that do not matter, or None.
        clock: clock of the target in MHz, or None.
        unit: ``capture`` or ``window``.
        batch: True to include systems whose labels depend on other test captures.
        shots: labelled captures of a new person, or None.
        notes: sentences on the board of the scene.
        why: True to print all sentences.

    Raises:
        InputError: some of this excludes another, or no run is stored for it.
    """
    limits, promised, scene = dict(budgets), scene is not None, scene or Scene()
    asked_costs = [costs()[name] for name in (by, *limits)]
    if scene.faults is None and any(cost.losses for cost in asked_costs):
        scene = replace(scene, faults=Losses(EVERY))
    watched = any(cost.runs == "recordings" for cost in asked_costs)
    if watched:
        _check_watched(by, unit, limits, clock)
    if scene.faults is not None and unit == "window":
        raise InputError("unit=window: losses under faults are of whole captures; leave it or the faults out")
    if shots is not None:
        if shots < 0:
            raise InputError(f"shots={shots}: give 0 or more")
        asked = {"protocol": ["personal"], **asked, "shots": [str(shots)]}
        if wrong := {*asked["protocol"]} - {"personal", "transfer"}:
            raise InputError(f"protocol={min(wrong)}: it has no shots; leave protocol= or shots out")
        if watched:
            raise InputError(f"shots={shots}: bench {_command(True)} has no captures of a new person; leave shots out")
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
    if (watched or shots is not None) and not {"model", "features"} & {*asked}:
        more = {} if watched else {"protocol": "personal", "protocol.shots": asked["shots"][0]}
        others = [r for r in plain(results) if not kind_of(r).recordings]
        if commands := elsewhere(others, among.first, among.table, _command(watched), more):
            what = "in recordings" if watched else "with labels of a new person"
            lacking[f"The score of {several(len(commands), 'other system')} {what}"] = commands
    if choice.chosen is not None and not growth and promised:
        lacking |= _curve(among, choice.chosen)
    return Chosen(choice, among, by, limits, margin, clock, scene, one, lacking, growth, [*notes], why)


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


def _check_watched(by: str, unit: str, limits: Mapping[str, float], clock: float | None) -> None:
    """Refuse keys that runs on recordings cannot be compared by.

    Raises:
        InputError: there is one.
    """
    given = next((k for k, cost in budgets_by_key().items() if cost.runs == "recordings" and cost.key in limits), "by")
    unwatched = [name for name, cost in costs().items() if not cost.watched]
    wrong = [f"by={by}"] * (by in unwatched) + [f"{costs()[k].budget}=" for k in unwatched if k in limits]
    wrong += [f"unit={unit}"] * (unit == "window") + ["clock="] * (clock is not None)
    if wrong:
        command = _command(True)
        raise InputError(
            f"{wrong[0]}: runs of bench {command}, which {given}= compares, have no such value; leave it out"
        )
