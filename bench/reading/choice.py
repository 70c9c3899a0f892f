"""The choice among stored runs: the cheapest system within one standard error of the best one.

Its sentences are in ``templates/choice.jinja``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bench.corpora.fault_names import FAULT_NAMES
from bench.errors import InputError
from bench.ground.progress import warn
from bench.ground.registry import views_of_runs
from bench.ground.typed import SMALL_SYSTEM, format_command
from bench.reading.candidates import (
    Candidates,
    find_candidates,
    measuring_commands,
    repeated_arguments,
)
from bench.reading.captures import stale_sentences
from bench.reading.rule import judge_candidates, meets_budget, pick_candidate
from bench.reading.runs import NothingTracked, select_runs, warn_of_missing_runs
from bench.reading.scene import Scene
from bench.values import few
from bench.values.intervals import mean_and_error, mean_interval
from bench.values.measures import all_costs, costs_of_run_kind
from bench.values.result import BATCH_NOTE, MIXED_NOTE, footnotes_of_system
from bench.values.sentences import render_sentences
from bench.values.table import rows_of_frame

COMMANDS = 3  # commands that a sentence names
BRIEF = 5  # sentences without why=yes, before those on what else there is and what to type next


@dataclass(frozen=True, repr=False, eq=False)
class Choice:
    """The choice of ``bench choose``; prints as sentences.

    Attributes:
        candidates: the compared candidates.
        by: cost that is minimised.
        budgets: budget of each cost.
        margin: points of accuracy that do not matter; None for one standard error.
        table: the candidates, cheapest first, with ``loss`` (mean over subjects of best minus own
            accuracy, in points), ``error`` (its standard error) and ``verdict``; those with unknown
            cost come last.
        chosen: index of the chosen candidate; None if none fits the budgets.
        best: index of the most accurate one that fits them.
        costlier: index of the next costlier one that fits them and is more accurate.
        unranked: those that fit them but have an unknown cost, most accurate first.
        clock: clock of the target in MHz.
        scene: reactions and faults.
        missing: commands that measure what is not stored, by what they measure, in words.
        notes: sentences on the board of the scene.
        why: whether all sentences are printed.
    """

    candidates: Candidates
    by: str
    budgets: Mapping[str, float]
    margin: float | None
    table: pd.DataFrame
    chosen: int | None
    best: int | None
    costlier: int | None
    unranked: list[int]
    clock: float | None = None
    scene: Scene = field(default_factory=Scene)
    missing: Mapping[str, list[str]] = field(default_factory=dict)
    notes: Sequence[str] = ()
    why: bool = False

    @property
    def system(self) -> str | None:
        """Name of the chosen system, None if nothing fits the budgets."""
        return None if self.chosen is None else str(self.table.loc[self.chosen, "system"])

    @property
    def study(self) -> str:
        """The kind of the compared runs; empty for runs on captures."""
        return self._view.tag if self._view.shows_run_kind else ""

    @property
    def _view(self) -> Any:
        return views_of_runs()[self.candidates.first.kind]

    @cached_property
    def limits(self) -> list[dict[str, Any]]:
        """The effect of each budget.

        Keys are ``cost``, ``budget``, ``over`` (number of candidates outside of it), ``unknown``
        (number of those whose cost is unknown), ``least`` (index of the candidate with the best
        amount), ``without`` (index of the best one that fits all other budgets), and ``gain``
        (accuracy of that one minus that of the best one that fits all, mean over subjects in
        points) with its standard ``error``.
        """
        return [self._effect_of_budget(name) for name in self.budgets]

    def _effect_of_budget(self, name: str) -> dict[str, Any]:
        table, scores = self.candidates.table, self.candidates.subjects.to_numpy(float)
        cost, budget, amounts = all_costs()[name], self.budgets[name], table[name].dropna()
        least = int(cost.as_burden(amounts).idxmin()) if len(amounts) else None
        others = {key: value for key, value in self.budgets.items() if key != name}
        _, without, _ = pick_candidate(table, scores, self.by, others)
        gain = error = np.nan
        if self.best is not None and without is not None:
            gain, error = mean_and_error(scores[without] - scores[self.best])
        over = int((~meets_budget(name, amounts.to_numpy(), budget)).sum())
        effect = {"cost": cost, "budget": budget, "over": over, "least": least, "without": without}
        return effect | {"unknown": len(table) - len(amounts), "gain": gain, "error": error}

    @property
    def binding_limits(self) -> list[dict[str, Any]]:
        """The effects of budgets that rule out a candidate."""
        return [limit for limit in self.limits if limit["over"] or limit["unknown"]]

    @cached_property
    def left_out_scores(self) -> np.ndarray | None:
        """Score in percent of each person with the system that is chosen without this person.

        NaN where none is chosen. Scores and costs of people are computed again from the other
        people; latency and decision time, which are medians of all people, do not change. None
        where nothing is chosen, for too few people, or for one candidate.
        """
        scores = self.candidates.subjects.to_numpy(float)
        people = scores.shape[1]
        if self.chosen is None or people < few.FEWEST_FOR_INTERVAL or len(scores) < 2:
            return None
        left_out = np.full(people, np.nan)
        for person, candidate in enumerate(self.choices_without_each()):
            if candidate is not None:
                left_out[person] = scores[candidate, person]
        return left_out

    def choices_without_each(self) -> Iterator[int | None]:
        """The candidate that is chosen without each person, None where none is."""
        for person in range(len(self.candidates.subjects.columns)):
            others = self.candidates.without_person(person, {self.by, *self.budgets})
            scores = others.subjects.to_numpy(float)
            yield pick_candidate(others.table, scores, self.by, self.budgets, self.margin)[0]

    def __str__(self) -> str:
        return "\n".join([f"{self.candidates.context}:", *self.lines()])

    __repr__ = __str__

    def lines(self) -> list[str]:
        """The choice, its reason and what to expect, or the budgets that rule all out."""
        expectation, scope = self.expectation_sentences(), self._render_blocks("scope")
        stale = stale_sentences([self.candidates.first])
        every = [
            *self._render_blocks("verdict details prices"),
            *expectation,
            *scope,
            *self._meaning_sentences(),
        ]
        every += [*self.notes, *self.candidates.notes]
        every += self._footnotes_of_systems(self.candidates.table["system"])
        every += choice_sentences("missing", missing=self.missing, shown=COMMANDS)
        remedy = None
        if self.chosen is None:
            remedy = f"{self._view.key} data={self.candidates.first['data']} {SMALL_SYSTEM}"
        if self.why:
            return [*every, *choice_sentences("rest", more=0, command=remedy), *stale]
        if self.chosen is None:
            first = {what: commands[:1] for what, commands in self.missing.items()}
            brief = self.why_nothing_fits()
            brief += choice_sentences("missing", missing=first, shown=1)[:1]
        else:
            brief = [*self._render_blocks("verdict"), *expectation[:1], *scope]
            brief += self._footnotes_of_systems([self.system or ""])
        more = sum(line not in brief[:BRIEF] for line in every)
        return [*brief[:BRIEF], *choice_sentences("rest", more=more, command=remedy), *stale]

    def reason_sentences(self) -> list[str]:
        """The choice, its reason, the price of the next better system and of budgets, its scope."""
        return self._render_blocks("verdict details prices scope")

    def why_nothing_fits(self) -> list[str]:
        """The budgets that rule candidates out, where none fits."""
        return self._render_blocks("verdict prices", self.binding_limits)

    def expectation_sentences(self) -> list[str]:
        """What to expect for new people, and the worst person, in sentences."""
        scores = self.left_out_scores
        if scores is None:
            return []
        low, high = mean_interval(scores)
        return choice_sentences(
            "expectation",
            people=len(scores),
            failed=int(np.isnan(scores).sum()),
            mean=scores.mean(),
            interval=(low, min(high, 100.0)),
            chosen=self.candidates.table.loc[self.chosen],
            own=self.candidates.subjects.loc[self.chosen],
            mixed=self.candidates.mixes_subjects,
        )

    def _render_blocks(
        self, blocks: str, limits: Sequence[dict[str, Any]] | None = None
    ) -> list[str]:
        """Sentences of some blocks on the choice; ``limits`` replace those of all budgets."""
        rows = dict(zip(self.table.index, rows_of_frame(self.table), strict=True)) | {None: None}
        chosen, subjects = rows[self.chosen], self.candidates.subjects.shape[1]
        return choice_sentences(
            blocks,
            cost=all_costs()[self.by],
            by=self.by,
            margin=self.margin,
            subjects=subjects,
            rows=rows,
            chosen=chosen,
            best=rows[self.best],
            costlier=rows[self.costlier],
            unranked=[rows[i] for i in self.unranked],
            limits=self.limits if limits is None else limits,
            candidates=len(self.table),
            study_sentence=self._view.describe_choice(chosen) if chosen else "",
            few=few.too_few_sentence(subjects),
            mixed=MIXED_NOTE if self.candidates.mixes_subjects else "",
        )

    def _footnotes_of_systems(self, systems: Iterable[str]) -> list[str]:
        """Footnotes of some systems, and that on marked ones if any candidate is marked."""
        data = str(self.candidates.first["data"])
        notes = [note for system in systems for note in footnotes_of_system(str(system), data)]
        every = (footnotes_of_system(str(s), data) for s in self.candidates.table["system"])
        if any(BATCH_NOTE in each for each in every):
            notes.append(BATCH_NOTE)
        return [*dict.fromkeys(f"{note.rstrip('.')}." for note in notes)]

    def _meaning_sentences(self) -> list[str]:
        """What decision times, the score and the losses are of, where that is not usual."""
        reactions, table = self.scene.reactions, self.candidates.table
        counted = [name for name, cost in all_costs().items() if cost.at_clock and name in table]
        unlisted = set[str]()
        if not reactions.is_default:
            gestures = self._view.gesture_names(self.candidates.first)
            unlisted = {*gestures}.difference(*reactions.groups.values())
        faults = [*self.scene.faults]
        return choice_sentences(
            "meaning",
            clock=self.clock,
            systems=len(table),
            timed=int(table[counted].notna().any(axis=1).sum()),
            decision="decision" in {self.by, *self.budgets},
            reactions=reactions,
            unlisted=unlisted,
            faults=["all faults"] if {*faults} == {*FAULT_NAMES} else faults,
            severity=self.scene.severity,
        )


def choose_candidate(
    candidates: Candidates, by: str, budgets: Mapping[str, float], margin: float | None = None
) -> Choice:
    """Choose among candidates (`bench.reading.rule.pick_candidate`), with a verdict on each."""
    scores = candidates.subjects.to_numpy(float)
    judged = judge_candidates(candidates.table, scores, by, budgets, margin)
    return Choice(candidates, by, budgets, margin, **judged)


def format_points(mean: float, error: float = np.nan) -> str:
    """A difference in points with its standard error, which a single subject does not have."""
    text = f"{mean:.1f}" if round(mean, 1) or abs(mean) < 1e-9 else f"{mean:.1g}"
    return text if np.isnan(error) else f"{text} ± {error:.1f}"


def candidate_name(row: Mapping[Any, Any], comma: str = "") -> str:
    """The system, and its unit in brackets or behind a comma, unless that is whole captures."""
    unit = "one window" if row["unit"] == "window" else row["unit"]
    words = f"{comma}{unit}" if comma else f" ({unit})"
    return str(row["system"]) + ("" if unit == "capture" else words)


def choice_sentences(blocks: str, **values: object) -> list[str]:
    """Sentences of some blocks of ``templates/choice.jinja``."""
    values |= {"name": candidate_name, "points": format_points}
    lines: list[str] = []
    for block in blocks.split():
        lines += render_sentences("bench.reading", "choice", block, **values)
    return lines


def choose_from_runs(
    results: Sequence[Any],
    selection: Mapping[str, list[str]],
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
    run_kind: str = "",
) -> Choice:
    """Choose among stored runs, as ``bench choose`` does with these keys.

    ``run_kind`` is the kind of runs that is compared; "" for that of the budgets, if one has it.
    """
    scene, costs = scene or Scene(), [all_costs()[name] for name in (by, *budgets)]
    if not scene.faults and any(cost.is_fault_loss for cost in costs):
        scene = replace(scene, faults=FAULT_NAMES)
    run_kinds = [cost.measured_on[0] for cost in costs if "captures" not in cost.measured_on]
    run_kind = run_kind or next(iter(run_kinds), "")
    if run_kind:
        _check_run_kind(run_kind, by, unit, budgets, clock)
    if scene.faults and unit == "window":
        raise InputError(
            "unit=window: losses under faults are of whole captures; leave it or the faults out"
        )
    warn_of_missing_runs(results, selection)
    try:
        candidates = find_candidates(
            results,
            selection,
            reactions=scene.reactions,
            latest_ms=budgets.get("decision", np.inf if by == "decision" else None),
            windows=unit == "window",
            clock=clock,
            batch=batch,
            run_kind=run_kind,
            faults=scene.faults,
            severity=scene.severity,
        )
    except NothingTracked as e:
        raise NothingTracked(_missing_runs_command(results, selection, run_kind) or str(e)) from e
    processors = sorted(set(candidates.table["cpu"]))
    if "predict" in {by, *budgets} and len(processors) > 1:
        warn(f"warning: computing times come from several processors: {'; '.join(processors)}")
    choice = choose_candidate(candidates, by, dict(budgets), margin)
    missing = {}
    if not candidates.first.is_stale:  # else the commands would measure other captures
        missing = measuring_commands(candidates.table, [by, *budgets], scene.faults)
    return replace(choice, clock=clock, scene=scene, missing=missing, notes=[*notes], why=why)


def _missing_runs_command(
    results: Sequence[Any], selection: Mapping[str, list[str]], run_kind: str
) -> str:
    """The command that makes runs of a kind from stored runs on captures; empty without any."""
    views = views_of_runs()
    selected = select_runs(results, {"target": ["gesture"], **selection})
    runs = [
        r
        for r in selected
        if r.is_complete and r.kind in views and not views[r.kind].shows_run_kind
    ]
    if not run_kind or not runs:
        return ""
    key = views[run_kind].key
    command = format_command(key, repeated_arguments(runs[0]["touchbench.arguments"]))
    return f"no run of bench {key} is stored; make one with: {command}"


def _check_run_kind(
    run_kind: str, by: str, unit: str, budgets: Mapping[str, float], clock: float | None
) -> None:
    """Refuse keys by which runs of a kind cannot be compared."""
    costs = all_costs()
    unknown = [name for name in costs if name not in costs_of_run_kind(run_kind)]
    wrong = [f"by={by}"] if by in unknown else []
    wrong += [f"{costs[name].budget_key}=" for name in unknown if name in budgets]
    wrong += [f"unit={unit}"] if unit == "window" else []
    wrong += ["clock="] if clock is not None else []
    if wrong:
        keys = [costs[name].budget_key for name in budgets if run_kind in costs[name].measured_on]
        runs = f"runs of bench {views_of_runs()[run_kind].key}, which {[*keys, 'by'][0]}= compares"
        raise InputError(f"{wrong[0]}: {runs}, have no such value; leave it out")
