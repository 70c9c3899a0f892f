"""Candidates of a choice: every way in which a stored system labels captures, with its costs."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from bench.corpora.fault_names import SEVERITIES
from bench.errors import InputError
from bench.ground.registry import views_of_circumstances, views_of_runs
from bench.ground.typed import format_arguments, format_command
from bench.reading.frame import selecting_arguments
from bench.reading.reactions import Reactions
from bench.reading.runs import COLUMN_OF_KEY, NothingTracked, one_run_per_system, select_runs
from bench.values.candidate import Candidate
from bench.values.measures import Cost, Interval, all_costs, costs_of_run_kind
from bench.values.result import CONDITIONS_TAG, Result, comparison_key, format_count, seed_number
from bench.values.sentences import render_sentences

TAGS = {  # columns of a candidate that repeat a tag of its run of the lowest seed
    "command": "touchbench.command",
    "arguments": "touchbench.arguments",
    "conditions": CONDITIONS_TAG,
}
EACH_GESTURE = Reactions()
# Keys of a run that other commands repeat.
REPEATED_KEYS = ("data", "where", "target", "also", "skin", "protocol", "model", "features", "seed")
Way = list[tuple[Candidate, Result]]  # one way in which a system labels, for each seed


@dataclass(frozen=True)
class Candidates:
    """The candidates of a choice, on the same captures under the same protocol.

    Args:
        table: a row per candidate: ``system``, ``unit``, ``accuracy`` (the score in percent, mean
            over subjects), every cost of `bench.values.measures.costs_of_run_kind` in its unit, NaN
            if unknown, ``linked`` (True for linked bytes, with code), ``cpu`` and keys of `TAGS`.
        subjects: scores in percent [candidates, subjects].
        losses: points lost in each case [candidates, cases, subjects]; NaN if not stored.
        counts: events, and hours in which they count [2, candidates, people], also of people
            without a score.
        first: a run of the candidates.
        notes: excluded runs with reasons, in sentences.
    """

    table: pd.DataFrame
    subjects: pd.DataFrame
    losses: np.ndarray
    counts: np.ndarray
    first: Result
    notes: list[str]

    @property
    def context(self) -> str:
        """Captures and protocol, in words."""
        return ", ".join(self.first.context)

    @property
    def mixes_subjects(self) -> bool:
        """True if training and test captures share subjects."""
        return self.first.mixes_subjects

    @property
    def hidden_costs(self) -> set[str]:
        """Costs of the skin, if all candidates have one as costly: no table shows them unasked."""
        if self.table["bits_per_s"].nunique() > 1:
            return set()
        return {name for name, cost in all_costs().items() if cost.scene_line[0] == "skin"}

    def without_person(self, person: int, names: Iterable[str]) -> Candidates:
        """The candidates without a person; the named costs that depend on people are new."""
        subjects = self.subjects.drop(columns=self.subjects.columns[person])
        losses, counts = (np.delete(each, person, axis=-1) for each in (self.losses, self.counts))
        others = replace(self, subjects=subjects, losses=losses, counts=counts)
        return others.with_people_costs(names)

    def with_people_costs(self, names: Iterable[str]) -> Candidates:
        """The candidates with those of the named costs that depend on people."""
        functions = {name: all_costs()[name].of_people for name in names}
        amounts = {name: of_people(self) for name, of_people in functions.items() if of_people}
        return replace(self, table=self.table.assign(**amounts))

    def mean_of_lowest(self, count: int) -> np.ndarray:
        """Mean of the lowest scores [candidates]; NaN if a person has none."""
        scores = self.subjects.to_numpy(float)
        lowest = np.sort(scores)[:, :count].mean(axis=1)
        return np.where(np.isnan(scores).any(axis=1), np.nan, lowest)

    def mean_losses(self) -> np.ndarray:
        """Mean points lost in each case [candidates, cases]."""
        if not self.losses.shape[1]:
            return np.full((len(self.table), 1), np.nan)
        return self.losses.mean(axis=2)

    def events_per_hour(self) -> np.ndarray:
        """Events per hour [candidates]."""
        unknown = np.full((2, len(self.table)), np.nan)
        events, hours = self.counts.sum(axis=2) if len(self.counts) else unknown
        return np.divide(events, hours, out=np.full(len(hours), np.nan), where=hours > 0)


def find_candidates(
    results: Sequence[Result],
    selection: Mapping[str, list[str]],
    *,
    reactions: Reactions = EACH_GESTURE,
    latest_ms: float | None = None,
    windows: bool = False,
    clock: float | None = None,
    batch: bool = False,
    run_kind: str = "",
    faults: Sequence[str] = (),
    severity: int = SEVERITIES,
) -> Candidates:
    """Find every way in which a stored system labels captures; its seeds are averaged.

    Args:
        results: stored runs.
        selection: values of the keys that select among them.
        reactions: reactions that are scored.
        latest_ms: latest decision in ms of touch that is soon enough. ``inf`` gives a candidate for
            each time of decision, None whole captures only.
        windows: score single windows instead of captures.
        clock: clock of the target in MHz, which turns instruction counts into times.
        batch: include systems whose predictions depend on other test captures.
        run_kind: key of the kind of run that is compared; empty for runs on captures.
        faults: faults over which losses are taken.
        severity: their highest severity; lower ones count, too.

    Raises:
        NothingTracked: no run is left.
    """
    all_views = views_of_runs()
    views = {
        tag: view
        for tag, view in all_views.items()
        if (tag if view.shows_run_kind else "") == run_kind
    }
    offered = [r for r in results if r.kind in views and views[r.kind].has_candidate(r)]
    if windows:
        offered = [r for r in offered if r.metrics.get("windows", 0) > 0]
    command = next(iter(views.values())).key
    runs, notes = comparable_runs(offered, selection, batch, command)
    ways = _ways_of_systems(runs, views, reactions, latest_ms, windows)
    if not ways:
        raise _no_run_error(command, selection, notes)
    system_costs: dict[str, dict[str, float]] = {}
    for r in runs:
        system_costs.setdefault(str(r["system"]), {}).update(views[r.kind].shared_costs(r))
    seeds = [seed for way in ways for seed in way]
    numbers = [number for number, way in enumerate(ways) for _ in way]

    def mean_over_seeds(rows: Iterable[Mapping[str, Any] | pd.Series]) -> pd.DataFrame:
        table = pd.DataFrame([dict(row.items()) for row in rows], dtype=float)
        return table.groupby(numbers).mean()

    table = pd.DataFrame([_describe_way(way, system_costs) for way in ways])
    same = table.duplicated(["system", "unit"], keep=False)  # such as early decisions with two hops
    apart = pd.Series([", ".join(way[0][0].apart) for way in ways])
    table.loc[same & (apart != ""), "unit"] += ", " + apart
    subjects = mean_over_seeds(candidate.scores for candidate, _ in seeds)
    amounts = mean_over_seeds(
        _costs_of_candidate(candidate, r.metrics | system_costs[str(r["system"])], run_kind)
        for candidate, r in seeds
    )
    table = pd.concat([table.assign(accuracy=subjects.mean(axis=1)), amounts], axis=1)
    for name in map(str, amounts):
        slower = all_costs()[name].at_clock
        if clock is not None and slower in table:
            table[slower] += (table[name] / clock).fillna(0)  # thousands by MHz: ms
    lost = _points_lost(results, runs[0], table, [*subjects], faults, severity, reactions)
    kinds = zip(*(candidate.counts for candidate, _ in seeds), strict=True)
    counts = [mean_over_seeds(kind) for kind in kinds]
    unscored = {str(name) for part in counts for name in part} - {*subjects}
    people = [*subjects, *sorted(unscored)]
    counted = np.array([part.reindex(columns=people) for part in counts])
    counted = counted.reshape(-1, len(ways), len(people))
    candidates = Candidates(table, subjects, lost, counted, runs[0], notes)
    return candidates.with_people_costs(costs_of_run_kind(run_kind))


def _ways_of_systems(
    runs: Sequence[Result],
    views: Mapping[str, Any],
    reactions: Reactions,
    latest_ms: float | None,
    windows: bool,
) -> list[Way]:
    """The ways in which systems label, by system; the last run of each way and seed counts."""
    clean = {id(r) for r in one_run_per_system(runs)}
    ways: dict[tuple, dict[str, tuple[Candidate, Result]]] = {}
    for r in runs:
        view = views[r.kind]
        candidates: list[Candidate] = []
        if id(r) in clean:
            candidates += view.clean_candidates(r, reactions, windows)
        if not windows:
            candidates += view.candidates(r, reactions, latest_ms)
        for each in candidates:
            key = (str(r["system"]), each.mark, each.apart, each.unit)
            ways.setdefault(key, {})[r["seed"]] = (each, r)
    order = sorted(ways, key=lambda key: key[:3])
    return [[ways[key][seed] for seed in sorted(ways[key], key=seed_number)] for key in order]


def _describe_way(way: Way, system_costs: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """The row of a candidate, without its numbers."""
    candidate, runs = way[0][0], [r for _, r in way]
    first = runs[0]  # of the lowest seed, which other commands repeat
    shared = system_costs[str(first["system"])].items()
    linked = any(r.metrics.get(name, value) != value for r in runs for name, value in shared)
    row: dict[str, Any] = {"system": first.system, "unit": candidate.unit}
    row |= {"mark": candidate.mark, "whole": candidate.whole}
    row |= {column: str(first.get(name, "")) for column, name in TAGS.items()}
    row["linked"] = linked or "flash" in candidate.stored
    row["shipped"] = json.dumps(dict(candidate.fit_keys))
    row["cpu"] = ", ".join(sorted({r["cpu"] for r in runs}))
    return row


def _costs_of_candidate(
    candidate: Candidate, metrics: Mapping[str, float], run_kind: str
) -> dict[str, Any]:
    """Costs of a candidate that do not depend on people, by name.

    The time of a decision is the touch that it needs; computing time here is another cost.
    """
    costs = costs_of_run_kind(run_kind)
    fixed = {name: cost for name, cost in costs.items() if cost.of_people is None}
    others = {n: stored for n, stored in candidate.stored.items() if n in fixed}
    numbers = {fixed[n].source_name: metrics.get(stored) for n, stored in others.items()}
    values = {name: cost.value_of_row({**metrics, **numbers}) for name, cost in fixed.items()}
    amounts = {n: v.value if isinstance(v, Interval) else v for n, v in values.items()}
    return amounts | dict(candidate.costs)


def _points_lost(
    results: Sequence[Result],
    first: Result,
    table: pd.DataFrame,
    subjects: list[str],
    faults: Sequence[str],
    severity: int,
    reactions: Reactions,
) -> np.ndarray:
    """Points that each candidate loses in each case of a fault [candidates, cases, subjects].

    NaN where no complete result is of all faults, and for windows and early decisions. Seeds are
    averaged.
    """
    lost = np.full((len(table), len(faults) * severity, len(subjects)), np.nan)
    if not faults:
        return lost
    rows = table[table["whole"]].groupby("system").groups
    runs: dict[str, list[Result]] = {str(system): [] for system in rows}
    for r in results:
        if r.is_complete and r.values_to_agree == first.values_to_agree and r.system in runs:
            runs[r.system].append(r)
    for view in views_of_circumstances():
        for system, numbers in rows.items():
            system_runs = [r for r in runs[str(system)] if view.applies_to(r)]
            seeds = dict.fromkeys(r["seed"] for r in system_runs)
            of_seeds = [[r for r in system_runs if r["seed"] == seed] for seed in seeds]
            parts = [view.losses_by_subject(each, faults, severity, reactions) for each in of_seeds]
            points = [part.reindex(columns=subjects) for part in parts if part is not None]
            if points:
                lost[numbers.to_numpy()] = np.mean([part.to_numpy() for part in points], axis=0)
    return lost


def measuring_commands(
    table: pd.DataFrame, names: Iterable[str], faults: Sequence[str]
) -> dict[str, list[str]]:
    """Commands that measure those of the named costs that are not stored, by what they measure."""
    wanted: dict[str, Cost] = {}
    losses = [name for name, cost in all_costs().items() if cost.is_fault_loss and faults]
    for name in (*names, *losses):
        cost = all_costs()[name]
        if cost.command:
            wanted.setdefault(cost.command, cost)
    commands: dict[str, list[str]] = {}
    plain = table[table["whole"] & (table["mark"] == "")]
    for cost in wanted.values():
        command, *words = cost.command.format(faults=",".join(faults)).split()
        keys = dict(word.split("=", 1) for word in words)
        typed = plain["arguments"][plain[cost.key].isna() & (plain["arguments"] != "")]
        lines = [format_command(command, repeated_arguments(text) | keys) for text in typed]
        lines = [*dict.fromkeys(lines)]
        if lines:
            commands[f"The {cost.noun} of {format_count(len(lines), 'system')}"] = lines
    return commands


def repeated_arguments(text: str) -> dict[str, str]:
    """Arguments of a run, stored as JSON, that another command repeats."""
    arguments = json.loads(text or "{}")
    return {key: value for key, value in arguments.items() if key.split(".")[0] in REPEATED_KEYS}


def comparable_runs(
    results: Sequence[Result],
    selection: Mapping[str, list[str]],
    batch: bool = False,
    command: str = "run",
) -> tuple[list[Result], list[str]]:
    """The selected complete results that may be compared, and sentences on those left out."""
    for key in selection:
        column = COLUMN_OF_KEY.get(key, key)
        if column.startswith("protocol.") and not any(column in r for r in results):
            raise InputError(
                f"{key}: no stored run has this parameter; leave it out or run that protocol"
            )
    selected = select_runs(results, {"target": ["gesture"], **selection})
    complete = [r for r in selected if r.is_complete]
    notes: list[str] = []
    if complete and "protocol_label" not in selection:
        complete, notes = _newest_comparable(complete)
    contexts = {r.values_to_agree for r in complete}
    failed = [
        r for r in selected if not r.is_complete and (r.values_to_agree in contexts or not complete)
    ]
    lacking = {r["system"] for r in failed} - {r["system"] for r in complete}
    if lacking:
        notes += render_sentences("bench.reading", "choice", "failed", names=sorted(lacking))
    dependent = sorted({r["system"] for r in complete if not r.predicts_alone})
    if dependent and not batch:
        complete = [r for r in complete if r["system"] not in dependent]
        notes += render_sentences("bench.reading", "choice", "batch", names=dependent)
    if not complete:
        raise _no_run_error(command, selection, notes)
    return complete, notes


def _no_run_error(command: str, selection: Collection[str], notes: Sequence[str]) -> NothingTracked:
    reasons = "".join(f". {note.removesuffix('.')}" for note in notes)
    values = " for these values" if selection else ""
    return NothingTracked(
        f"no complete run is stored{values}; make one with bench {command}, then choose{reasons}"
    )


def _newest_comparable(results: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """The results on the captures and under the protocol of the newest, and notes on the others.

    Parameters that results of a kind must share are those of the newest of this kind.
    """
    settings = [*{r.values_to_agree: r for r in results}.values()]
    arguments = [format_arguments(selecting_arguments(r, settings)) for r in settings]
    arguments = [*dict.fromkeys(arguments)]
    if len(arguments) > 1:
        raise InputError(
            "runs on different captures or protocols cannot be compared; "
            f"name one of: {'; '.join(arguments[:4])}"
        )
    views, by_age = views_of_runs(), sorted(results, key=lambda r: (not r.is_stale, r["started"]))
    newest = comparison_key(by_age[-1], ["protocol"])
    same = [r for r in by_age if comparison_key(r, ["protocol"]) == newest]
    last = {r.kind: r for r in same}
    kept: set[Result] = set()
    different: dict[str, None] = {}  # names of shared parameters that differ
    for r in same:
        names = views[r.kind].shared_parameters
        changed = [name for name in names if r.get(name) != last[r.kind].get(name)]
        different |= {name.rpartition(".")[2]: None for name in changed}
        kept |= set() if changed else {r}
    others = [r for r in results if r not in kept]
    if not others:
        return [*results], []
    values: dict[str, Any] = {"others": len(others), "data": by_age[-1]["data"]}
    values["apart"] = [f"with another {name}" for name in different]
    values["versions"] = [*dict.fromkeys(str(r["corpus_digest"])[:8] for r in others)]
    notes = render_sentences("bench.reading", "choice", "older", **values)
    return [r for r in results if r in kept], notes
