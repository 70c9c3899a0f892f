"""The choice among stored runs: the cheapest system within one standard error of the best one.

Its sentences stand in ``templates/choice.jinja``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.ground.progress import warn
from bench.ground.registry import run_views
from bench.ground.words import SMALL, typed
from bench.reading.candidates import Candidates, candidates, missing, repeated
from bench.reading.runs import NothingTracked, selected, without_runs
from bench.reading.scene import EVERY, Scene
from bench.values import few
from bench.values.candidate import Losses, Wish
from bench.values.intervals import (
    TOLERANCE,
    interval,
    mean_and_error,
    shown_less,
    within_one_standard_error,
)
from bench.values.measures import costs, costs_of
from bench.values.result import MARKED, MIXED, Row, notes_on
from bench.values.sentences import sentences
from bench.values.table import rows_of

SHOWN = 3  # commands that a sentence names
BRIEF = 5  # sentences without why=yes, beside those on what else there is and what to type next


class Budget(NamedTuple):
    """The effect of one budget on the candidates."""

    cost: str
    budget: float
    over: int  # candidates outside of it
    unknown: int  # candidates whose cost is unknown
    least: int | None  # index of the candidate with the best amount
    without: int | None  # index of the best one that fits all other budgets
    gain: float  # accuracy of that one minus that of the best one that fits all, mean over subjects in points
    error: float  # the standard error of that


class Choice(NamedTuple):
    """The result of a choice."""

    # the candidates with ``loss`` (mean over subjects of best minus own accuracy, in points), ``error`` (its standard
    # error) and ``verdict``, cheapest first; those with unknown cost come last
    table: pd.DataFrame
    chosen: int | None  # index in it, None if no candidate fits the budgets
    best: int | None  # the most accurate one that fits them
    costlier: (
        int | None
    )  # the next costlier one that fits them and is more accurate than the chosen
    unranked: list[int]  # those that fit the budgets but have an unknown cost, most accurate first
    budgets: list[Budget]


def within(name: str, amounts: np.ndarray, budget: float) -> np.ndarray:
    """Whether amounts of a cost are within a budget: not where they are NaN, and rounding is no excess."""
    if costs()[name].better == "high":
        return amounts >= budget * (1 - TOLERANCE)
    return amounts <= budget * (1 + TOLERANCE)


def pick(
    table: pd.DataFrame,
    scores: np.ndarray,
    by: str,
    budgets: Mapping[str, float],
    margin: float | None = None,
) -> tuple[int | None, int | None, np.ndarray]:
    """The cheapest candidate within all budgets whose score is not below that of the best of these.

    Not below means: the mean over people of the difference is at most its standard error; or, with a margin, a
    one-sided paired t-test finds it smaller than the margin (p < 0.05); fewer than `bench.values.few.TEST` people show
    nothing.

    A candidate whose cost ``by`` is unknown is neither chosen nor the best, one whose cost with a budget is unknown
    does not fit. It gives the numbers of the chosen and of the best candidate, None where none fits, and which
    candidates that fit are not below the best, bool [candidates].
    """
    fits = np.ones(len(table), bool)
    for name, budget in budgets.items():
        fits &= within(name, table[name].to_numpy(float), budget)
    burden = costs()[by].burden(table[by].to_numpy(float))
    means = (
        pd.DataFrame(scores).mean(axis=1).round(9).to_numpy()
    )  # equal sums in another order are ties
    can = fits & np.isfinite(burden) & np.isfinite(means)
    if not can.any():
        return None, None, np.zeros(len(scores), bool)
    best = int(np.lexsort((burden, -np.where(can, means, -np.inf)))[0])
    lost = scores[best] - scores
    near = fits & (within_one_standard_error(lost) if margin is None else shown_less(lost, margin))
    near[best] = True
    return int(np.lexsort((-means, np.where(can & near, burden, np.inf)))[0]), best, near


def decide(
    table: pd.DataFrame,
    subjects: pd.DataFrame,
    by: str,
    budgets: Mapping[str, float],
    margin: float | None,
) -> Choice:
    """Take the cheapest candidate whose score is not below that of the best (`pick`), and say so of each."""
    scores, unknown = subjects.to_numpy(float), f"{costs()[by].title} unknown"
    chosen, best, near = pick(table, scores, by, budgets, margin)
    verdicts = [_excess(row, budgets) for row in rows_of(table)]
    fits, burden = (
        np.array([not verdict for verdict in verdicts]),
        costs()[by].burden(table[by].to_numpy(float)),
    )
    known, lost = ~np.isnan(burden), np.full((len(table), 2), np.nan)
    for i in np.flatnonzero(fits):
        words = [] if known[i] else [unknown]
        if best is not None:
            lost[i] = mean_and_error(scores[best] - scores[i])
            if near[i] and known[i]:
                words = ["costlier" if burden[i] > burden[chosen] else "equally cheap"]
            words.insert(
                0, "the best" if i == best else "near the best" if near[i] else "below the best"
            )
        verdicts[i] = "chosen" if i == chosen else ", ".join(words)
    accuracy = table["accuracy"].round(9)
    table = table.assign(
        verdict=verdicts, loss=lost[:, 0], error=lost[:, 1], accuracy=accuracy, burden=burden
    )
    unranked = table[fits & ~known].sort_values("accuracy", ascending=False).index
    order, costlier = table.sort_values("burden"), None
    if chosen is not None:
        order = table.sort_values(["burden", "accuracy"], ascending=[True, False])
        better = fits & (burden > burden[chosen]) & (accuracy > accuracy[chosen])
        costlier = next((int(i) for i in order.index if better[i]), None)
    limits = [_limit(table, scores, by, budgets, name, best) for name in budgets]
    return Choice(
        order.drop(columns="burden"), chosen, best, costlier, [*map(int, unranked)], limits
    )


def _excess(row: Row, budgets: Mapping[str, float]) -> str:
    """By which budgets a candidate is ruled out, with amounts if it is one; empty for none."""
    over = [
        costs()[name] for name, budget in budgets.items() if not within(name, row[name], budget)
    ]
    if len(over) > 1:
        return "ruled out: " + ", ".join(cost.title for cost in over)
    for cost in over:
        amounts = cost.apart(row[cost.key], budgets[cost.key])
        sign = ">" if cost.better == "low" else "<"
        return f"ruled out: {cost.title} " + (
            f" {sign} ".join(amounts) if np.isfinite(row[cost.key]) else "unknown"
        )
    return ""


def _limit(
    table: pd.DataFrame,
    scores: np.ndarray,
    by: str,
    budgets: Mapping[str, float],
    cost: str,
    best: int | None,
) -> Budget:
    """What one of the budgets does."""
    amounts = table[cost].dropna()
    least = (
        int(amounts.index[int(costs()[cost].burden(amounts).argmin())]) if len(amounts) else None
    )
    without = pick(table, scores, by, {k: v for k, v in budgets.items() if k != cost})[1]
    gain = error = np.nan
    if best is not None and without is not None:
        gain, error = mean_and_error(scores[without] - scores[best])
    over = int((~within(cost, amounts.to_numpy(), budgets[cost])).sum())
    return Budget(cost, budgets[cost], over, len(table) - len(amounts), least, without, gain, error)


def expected(
    among: Candidates,
    chosen: int | None,
    by: str,
    budgets: Mapping[str, float],
    margin: float | None,
) -> np.ndarray | None:
    """Score in percent of each person with the system that is chosen without this person; NaN where none is.

    Scores and costs of people are computed again from the people that are left; latency and decision time, which are
    medians of all people, do not change. None where nothing is chosen, for too few people, or for one candidate.
    """
    scores = among.subjects.to_numpy(float)
    if chosen is None or scores.shape[1] < few.INTERVAL or len(scores) < 2:
        return None
    others = without_each(among, by, budgets, margin)
    return np.array(
        [np.nan if other is None else scores[other, person] for person, other in enumerate(others)]
    )


def without_each(
    among: Candidates, by: str, budgets: Mapping[str, float], margin: float | None
) -> Iterator[int | None]:
    """The candidate that is chosen without each person, None where none is."""
    for person in range(len(among.subjects.columns)):
        left = among.without(person, {by, *budgets})
        yield pick(left.table, left.subjects.to_numpy(float), by, budgets, margin)[0]


# Sentences


def points(mean: float, error: float = np.nan) -> str:
    """A difference in points with its standard error, which a single subject does not have."""
    text = f"{mean:.1f}" if round(mean, 1) or abs(mean) < 1e-9 else f"{mean:.1g}"
    return text if np.isnan(error) else f"{text} ± {error:.1f}"


def named(row: Mapping[Any, Any], comma: str = "") -> str:
    """A candidate: the system, and in brackets or behind a comma its unit, unless that is whole captures."""
    unit = "one window" if row["unit"] == "window" else row["unit"]
    words = f"{comma}{unit}" if comma else f" ({unit})"
    return str(row["system"]) + ("" if unit == "capture" else words)


def said(blocks: str, **values: object) -> list[str]:
    """Sentences of some blocks of ``templates/choice.jinja``."""
    values |= {"named": named, "points": points}
    return [
        line
        for block in blocks.split()
        for line in sentences("bench.reading", "choice", block, **values)
    ]


def reasons(
    choice: Choice, by: str, margin: float | None, subjects: int, mixed: bool = False
) -> list[str]:
    """The choice, its reason, the cost of the next better system and of each budget, and its scope."""
    return said("verdict details prices scope", **told(choice, by, margin, subjects, mixed))


def told(
    choice: Choice, by: str, margin: float | None, subjects: int, mixed: bool
) -> dict[str, Any]:
    """The values of sentences on a choice."""
    rows = {None: None, **dict(zip(choice.table.index, rows_of(choice.table), strict=True))}
    return {
        **{"cost": costs()[by], "by": by, "margin": margin, "subjects": subjects, "told": ""},
        **{name: rows[getattr(choice, name)] for name in ("chosen", "best", "costlier")},
        "unranked": [rows[i] for i in choice.unranked],
        "limits": [
            (limit, costs()[limit.cost], rows[limit.without], rows[limit.least])
            for limit in choice.budgets
        ],
        **{
            "candidates": len(choice.table),
            "few": few.too_few(subjects),
            "mixed": MIXED if mixed else "",
        },
    }


def expectation(scores: np.ndarray | None, among: Candidates, chosen: int | None) -> list[str]:
    """What to expect for new people, and the worst person, in sentences."""
    if scores is None or chosen is None:
        return []
    low, high = interval(scores)
    values = {
        "people": len(scores),
        "failed": int(np.isnan(scores).sum()),
        "interval": (low, min(high, 100.0)),
    }
    values |= {"chosen": among.table.loc[chosen], "own": among.subjects.loc[chosen]}
    return said("expectation", mean=scores.mean(), mixed=among.mixed, **values)


# The choice of ``bench choose``


@dataclass(frozen=True)
class Chosen:
    """A choice and its candidates."""

    choice: Choice
    among: Candidates
    by: str  # the cost to minimise
    budgets: dict[str, float]  # of each cost
    margin: float | None  # points that do not matter
    clock: float | None  # of the target in MHz
    scene: Scene  # reactions and faults
    expected: (
        np.ndarray | None
    )  # score of each person that was left out; None if nothing fits or for too few people
    lacking: Mapping[
        str, list[str]
    ]  # commands that measure what is not stored, by what they measure, in words
    notes: list[str]  # sentences on the board of the scene
    why: bool  # whether all sentences are printed

    @property
    def system(self) -> str | None:
        """Name of the chosen system, None if nothing fits the budgets."""
        chosen = self.choice.chosen
        return None if chosen is None else str(self.choice.table.loc[chosen, "system"])

    @property
    def study(self) -> str:
        """The study whose runs it is among; empty for runs on captures."""
        return self._view.tag if self._view.apart else ""

    @property
    def _view(self) -> Any:
        return run_views()[self.among.first.kind]

    def __str__(self) -> str:
        return "\n".join([f"{self.among.context}:", *self.lines()])

    __repr__ = __str__

    def lines(self) -> list[str]:
        """The choice, its reason and what to expect, or the binding budgets and a remedy; all with ``why``."""
        values = told(
            self.choice, self.by, self.margin, self.among.subjects.shape[1], self.among.mixed
        )
        values |= {"told": self._view.chosen(values["chosen"]) if values["chosen"] else ""}
        expect, scope = (
            expectation(self.expected, self.among, self.choice.chosen),
            said("scope", **values),
        )
        every = [
            *said("verdict details prices", **values),
            *expect,
            *scope,
            *self._meaning(),
            *self.notes,
        ]
        every += [*self.among.notes, *self._footnotes(self.among.table["system"])]
        every += said("lacking", lacking=self.lacking, shown=SHOWN)
        if self.why:
            return [*every, *said("rest", more=0, command=self._remedy)]
        if self.choice.chosen is None:
            values["limits"] = [
                limit for limit in values["limits"] if limit[0].over or limit[0].unknown
            ]
            first = {what: commands[:1] for what, commands in self.lacking.items()}
            brief = [
                *said("verdict prices", **values),
                *said("lacking", lacking=first, shown=1)[:1],
            ]
        else:
            brief = [
                *said("verdict", **values),
                *expect[:1],
                *scope,
                *self._footnotes([self.system or ""]),
            ]
        more = sum(line not in brief[:BRIEF] for line in every)
        return [*brief[:BRIEF], *said("rest", more=more, command=self._remedy)]

    @property
    def _remedy(self) -> str | None:
        """The arguments of a small system to try, where nothing is chosen."""
        return (
            f"{self._view.key} data={self.among.first['data']} {SMALL}"
            if self.choice.chosen is None
            else None
        )

    def _footnotes(self, shown: Iterable[str]) -> list[str]:
        """Footnotes of some systems, and that on marked ones if any candidate is."""
        notes = {
            str(s): notes_on(str(s), str(self.among.first["data"]))
            for s in self.among.table["system"]
        }
        lines = [note for system in shown for note in notes[system]]
        lines += [MARKED] * any(MARKED in listed for listed in notes.values())
        return list(dict.fromkeys(f"{note.rstrip('.')}." for note in lines))

    def _meaning(self) -> list[str]:
        """What decision times, the score and the losses are of, where that is not usual."""
        reactions, faults, table = self.scene.reactions, self.scene.faults, self.among.table
        gestures = () if reactions.plain else self._view.gestures(self.among.first)
        counted = [name for name, cost in costs().items() if cost.at_clock and name in table]
        values: dict[str, Any] = {"clock": self.clock, "systems": len(table)}
        values["timed"] = int(table[counted].notna().any(axis=1).sum())
        values |= {"decision": "decision" in {self.by, *self.budgets}, "kind": self._view.meaning}
        values |= {
            "reactions": reactions,
            "unlisted": {*gestures}.difference(*reactions.groups.values()),
        }
        names = (
            []
            if faults is None
            else ["all faults"]
            if {*faults.names} == {*EVERY}
            else faults.names
        )
        return said("meaning", faults=faults, names=names, **values)


def choose(
    results: Sequence[Any],
    asked: Mapping[str, list[str]],
    by: str,
    budgets: Mapping[str, float],
    *,
    scene: Scene | None = None,
    margin: float | None = None,
    clock: float | None = None,
    unit: str = "capture",
    batch: bool = False,
    notes: Sequence[str] = (),
    why: bool = False,
) -> Chosen:
    """The choice among stored runs."""
    limits, scene = dict(budgets), scene or Scene()
    asked_costs = [costs()[name] for name in (by, *limits)]
    if scene.faults is None and any(cost.losses for cost in asked_costs):
        scene = replace(scene, faults=Losses(EVERY))
    study = next((cost.on[0] for cost in asked_costs if "captures" not in cost.on), "")
    if study:
        _check_study(study, by, unit, limits, clock)
    if scene.faults is not None and unit == "window":
        raise InputError(
            "unit=window: losses under faults are of whole captures; leave it or the faults out"
        )
    without_runs(results, asked)
    most = limits.get("decision", np.inf if by == "decision" else None)
    wish = Wish(scene.reactions, most, unit == "window")
    try:
        among = candidates(
            results, asked, wish, clock=clock, batch=batch, study=study, losses=scene.faults
        )
    except NothingTracked as e:
        raise NothingTracked(_unmeasured(results, asked, study) or str(e)) from e
    processors = sorted(set(among.table["cpu"]))
    if "predict" in {by, *limits} and len(processors) > 1:
        warn(f"warning: computing times come from several processors: {'; '.join(processors)}")
    choice = decide(among.table, among.subjects, by, limits, margin)
    others = expected(among, choice.chosen, by, limits, margin)
    lacking = missing(among.table, [by, *limits], scene.faults)
    return Chosen(choice, among, by, limits, margin, clock, scene, others, lacking, [*notes], why)


def _unmeasured(results: Sequence[Any], asked: Mapping[str, list[str]], study: str) -> str:
    """The command that measures a study, of the stored runs on captures; empty without any."""
    kept, kinds = selected(results, {"target": ["gesture"], **asked}), run_views()
    runs = [r for r in kept if r.complete and r.kind in kinds and not kinds[r.kind].apart]
    if not study or not runs:
        return ""
    measure = typed(kinds[study].key, repeated(runs[0]["touchbench.arguments"]))
    return f"no run of bench {kinds[study].key} is stored; make one with: {measure}"


def _check_study(
    study: str, by: str, unit: str, limits: Mapping[str, float], clock: float | None
) -> None:
    """Refuse keys that runs of a study cannot be compared by."""
    given = next((costs()[k].budget for k in limits if study in costs()[k].on), "by")
    unknown = [name for name in costs() if name not in costs_of(study)]
    wrong = [f"by={by}"] * (by in unknown) + [
        f"{costs()[k].budget}=" for k in unknown if k in limits
    ]
    wrong += [f"unit={unit}"] * (unit == "window") + ["clock="] * (clock is not None)
    if wrong:
        runs = f"runs of bench {run_views()[study].key}, which {given}= compares"
        raise InputError(f"{wrong[0]}: {runs}, have no such value; leave it out")
