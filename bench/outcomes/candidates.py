"""The candidates of a choice: every way in which a stored system labels captures, with its costs."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from bench.candidate import Candidate, Losses, Wish
from bench.comparable import COMPARABLE, CONDITIONS, Row, alike, context_of, facts_of, seed_number
from bench.errors import InputError
from bench.measures import Interval, costs, costs_of
from bench.outcomes.reactions import Reactions
from bench.outcomes.runs import COLUMNS, NothingTracked, plain, selected
from bench.registry import circumstance_views, run_views
from bench.result import Result
from bench.sentences import sentences
from bench.words import quoted, typed

TAGS = {  # columns of a candidate that repeat a tag of its last run
    "command": "touchbench.command",
    "arguments": "touchbench.arguments",
    "conditions": CONDITIONS,
}
PLAIN = Reactions()
TAKEN = ("data", "where", "target", "protocol", "model", "features", "seed")  # keys of a run that others repeat


@dataclass(frozen=True)
class People:
    """What each person contributes to the score and to the costs of each candidate.

    Attributes:
        scores: in percent [candidates, subjects].
        losses: points lost in each case [candidates, cases, subjects]; NaN where not stored.
        counts: events, and hours in which they count [2, candidates, people]; also of people without a score.
    """

    scores: np.ndarray
    losses: np.ndarray
    counts: np.ndarray

    def without(self, subject: int) -> People:
        """The same without one subject."""
        return People(*(np.delete(part, subject, axis=-1) for part in (self.scores, self.losses, self.counts)))

    def lowest(self, count: int) -> np.ndarray:
        """Mean of the lowest scores [candidates]; NaN where a person has none."""
        return np.where(np.isnan(self.scores).any(axis=1), np.nan, np.sort(self.scores)[:, :count].mean(axis=1))

    def loss(self) -> np.ndarray:
        """Mean points lost in each case [candidates, cases]."""
        return self.losses.mean(axis=2) if self.losses.shape[1] else np.full((len(self.scores), 1), np.nan)

    def rate(self) -> np.ndarray:
        """Events per hour [candidates]."""
        events, hours = self.counts.sum(axis=2) if len(self.counts) else np.full((2, len(self.scores)), np.nan)
        return np.divide(events, hours, out=np.full(len(hours), np.nan), where=hours > 0)

    def cost(self, name: str) -> np.ndarray | None:
        """A cost that depends on which people are counted [candidates]; None for any other."""
        among = costs()[name].among
        return None if among is None else among(self)


@dataclass(frozen=True)
class Candidates:
    """The candidates of a store, on the same captures under the same protocol.

    Attributes:
        table: one row per candidate (``system``, ``unit``, ``accuracy``, the score in percent as a mean over subjects,
            every cost of `bench.measures.costs_of` in its unit, NaN where it is unknown, ``linked``, True for linked
            bytes, with code, ``cpu`` and the keys of `TAGS`).
        context: captures and protocol, in words.
        subjects: scores in percent [candidates, subjects].
        people: contribution of each person to scores and costs, in the order of these two.
        gestures: all gestures; empty if each is its own reaction and all mistakes cost the same.
        first: a run of the candidates.
        mixed: True if training and test captures share subjects.
        notes: excluded runs with reasons, in sentences.
    """

    table: pd.DataFrame
    context: str
    subjects: pd.DataFrame
    people: People
    gestures: tuple[str, ...]
    first: Result
    mixed: bool
    notes: list[str]


def candidates(
    results: Sequence[Result],
    asked: Mapping[str, list[str]],
    wish: Wish | None = None,
    *,
    clock: float | None = None,
    batch: bool = False,
    study: str = "",
    losses: Losses | None = None,
) -> Candidates:
    """Every way in which a system labels, as the kinds of run give them; the seeds of a system are averaged."""
    wish = wish or Wish(PLAIN)
    kinds = {tag: view for tag, view in run_views().items() if (tag if view.apart else "") == study}
    every = [r for r in results if r.kind in kinds and kinds[r.kind].offers(r, wish)]
    command = next(iter(kinds.values())).key
    if not study:
        command += "".join(f" protocol=personal protocol.shots={number}" for number in asked.get("shots", []))
    chosen, notes = eligible(every, asked, batch, command)
    ways = _ways(chosen, wish, kinds)
    if not ways:
        raise _nothing(command, asked, notes)
    lent: dict[str, dict[str, float]] = {}
    for r in chosen:
        lent.setdefault(str(r["system"]), {}).update(kinds[r.kind].lends(r))
    mine = costs_of(study)
    fixed = [name for name, cost in mine.items() if cost.among is None]
    table = pd.DataFrame([_row(seeds, lent[str(seeds[0][1]["system"])], fixed) for seeds in ways])
    same = table.duplicated(["system", "unit"], keep=False)  # such as early decisions with two hops
    apart = pd.Series([", ".join(seeds[0][0].apart) for seeds in ways])
    table.loc[same & (apart != ""), "unit"] += ", " + apart
    subjects = pd.DataFrame([_mean([way.scores for way, _ in seeds]) for seeds in ways]).reset_index(drop=True)
    table["accuracy"] = subjects.mean(axis=1)
    if clock is not None and "cycles" in table:
        table["decision"] += (table["cycles"] / clock).fillna(0)  # thousands by MHz: ms
    lost = np.empty((len(table), 0, subjects.shape[1]))
    if losses is not None:
        lost = _losses(results, chosen[0], table, [*subjects], losses, wish.reactions)
    people = People(subjects.to_numpy(float), lost, _counts(ways, [*subjects]))
    table = table.assign(**{name: people.cost(name) for name, cost in mine.items() if cost.among is not None})
    mixed = any(facts_of(r).mixes_subjects for r in chosen)
    gestures = () if wish.reactions.plain else kinds[chosen[0].kind].gestures(chosen[0])
    return Candidates(table, ", ".join(context_of(chosen[0])), subjects, people, gestures, chosen[0], mixed, notes)


Way = list[tuple[Candidate, Result]]  # of each seed


def _ways(results: Sequence[Result], wish: Wish, kinds: Mapping[str, Any]) -> list[Way]:
    """The ways in which systems label, by system; of one way and seed, the last run counts."""
    as_they_are = {id(r) for r in plain(results)}
    ways: dict[tuple, dict[str, tuple[Candidate, Result]]] = {}
    for r in results:
        for way in kinds[r.kind].candidates(r, replace(wish, plain=id(r) in as_they_are)):
            ways.setdefault((str(r["system"]), way.mark, way.apart, way.unit), {})[r["seed"]] = way, r
    order = sorted(ways, key=lambda key: key[:3])
    return [[ways[key][seed] for seed in sorted(ways[key], key=seed_number)] for key in order]


def _row(seeds: Way, lent: Mapping[str, float], fixed: Sequence[str]) -> dict[str, Any]:
    """A candidate from its seeds: means of its costs, and what is told of it."""
    (way, _), runs = seeds[0], [r for _, r in seeds]
    last = max(runs, key=lambda r: r["started"])
    amounts = [_amounts({**r, **lent}, each) for each, r in seeds]
    stored = np.array([[amount.get(name) for name in fixed] for amount in amounts], float)  # NaN for None
    known = ~np.isnan(stored)
    means = np.where(known, stored, 0).sum(axis=0) / np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    changed = any(r.metrics.get(name, value) != value for r in runs for name, value in lent.items())
    return {
        "system": last.system,
        "unit": way.unit,
        **dict(zip(fixed, means.tolist(), strict=True)),
        **{column: str(last.get(name, "")) for column, name in TAGS.items()},
        "linked": way.linked or changed,
        "mark": way.mark,
        "whole": way.whole,
        "shipped": json.dumps(dict(way.shipped)),
        "cpu": ", ".join(sorted({r["cpu"] for r in runs})),
    }


def _mean(parts: Sequence[pd.Series]) -> pd.Series:
    """Mean over seeds by subject."""
    first = parts[0]
    if len(parts) == 1:
        return first
    if all(part.index.equals(first.index) and part.notna().all() for part in parts):  # quicker for thousands of runs
        return pd.Series(np.stack([part.to_numpy(float) for part in parts], axis=1).mean(axis=1), first.index)
    return pd.concat(parts, axis=1).mean(axis=1)


def _counts(ways: Sequence[Way], subjects: list[str]) -> np.ndarray:
    """What is counted of each person [kinds of counts, candidates, people]; those without a score come last."""
    counted = [[_mean(each) for each in zip(*(way.counts for way, _ in seeds), strict=True)] for seeds in ways]
    if not counted[0]:
        return np.empty((0, len(ways), len(subjects)))
    others = sorted({name for parts in counted for each in parts for name in each.index} - {*subjects})
    order = [*subjects, *others]
    return np.array([[each.reindex(order) for each in parts] for parts in counted], float).transpose(1, 0, 2)


def _losses(
    results: Sequence[Result],
    context: Result,
    table: pd.DataFrame,
    subjects: list[str],
    losses: Losses,
    reactions: Reactions,
) -> np.ndarray:
    """Points that each candidate loses under each fault at each severity, float [candidates, cases, subjects].

    NaN where no complete result is of all faults, and for windows and early decisions. Seeds are averaged. Systems
    with captures of a new person are tested under faults without these captures.
    """
    lost = np.full((len(table), len(losses.circumstances), len(subjects)), np.nan)
    personal = str(context["protocol"]).startswith("personal")
    name, protocol = ("protocol_name", "loso") if personal else ("protocol_label", context["protocol_label"])
    for circumstance in circumstance_views():
        by_system: dict[str, dict[str, list[Result]]] = {}
        for r in results:
            if circumstance.holds(r) and r[name] == protocol and complete_on(r, context):
                by_system.setdefault(r.system, {}).setdefault(r["seed"], []).append(r)
        for system, seeds in by_system.items():
            rows = (table["system"] == system) & table["whole"]
            parts = [circumstance.lost(each, losses, reactions) for each in seeds.values()] if rows.any() else []
            if known := [part.reindex(columns=subjects).to_numpy() for part in parts if part is not None]:
                lost[rows.to_numpy()] = np.mean(known, axis=0)
    return lost


def complete_on(result: Result, context: Result) -> bool:
    """Whether a result is complete and on the captures of another one."""
    same = (name for name in COMPARABLE if name != "protocol_label")
    return result.complete and all(result[name] == context[name] for name in same)


def missing(table: pd.DataFrame, wanted: Collection[str], losses: Losses | None) -> dict[str, list[str]]:
    """Commands that measure what is not stored, by cost."""
    commands: dict[str, list[str]] = {}
    for name in wanted:
        cost = costs()[name]
        lacking = table[table[name].isna() & table["whole"] & (table["mark"] == "")]
        if not cost.command or (cost.losses and losses is None):
            continue
        command, *more = cost.command.format(faults=",".join(losses.names if losses else ())).split()
        given = dict(word.split("=", 1) for word in more)
        lines = [typed(command, repeated(t, impersonal=cost.losses) | given) for t in lacking["arguments"] if t]
        if lines:
            commands[name] = list(dict.fromkeys(lines))
    return commands


def repeated(text: str, impersonal: bool = False) -> dict[str, str]:
    """Arguments of a run that another command repeats."""
    given = {k: v for k, v in json.loads(text or "{}").items() if k.split(".")[0] in TAKEN}
    if impersonal and given.get("protocol", "").startswith("personal"):
        given = {k: v for k, v in given.items() if not k.startswith("protocol.")} | {"protocol": "loso"}
    return given


def eligible(
    results: Sequence[Result],
    asked: Mapping[str, list[str]],
    batch: bool = False,
    command: str = "run",
) -> tuple[list[Result], list[str]]:
    """The complete results among which can be chosen, and which others are left out, in sentences."""
    kept = _asked(results, asked)
    complete = [r for r in kept if r.complete]
    notes: list[str] = []
    if complete and "protocol_label" not in asked:
        complete, notes = _newest(complete)
    same, systems = {r.comparable for r in complete}, {r["system"] for r in complete}
    here = [r for r in kept if not r.complete and (r.comparable in same or not complete)]
    if failed := {r["system"] for r in here} - systems:
        notes += sentences("bench.outcomes", "choice", "failed", names=sorted(failed))
    if not batch and (names := sorted({r["system"] for r in complete if not r.alone})):
        complete = [r for r in complete if r["system"] not in names]
        notes += sentences("bench.outcomes", "choice", "batch", names=names)
    if not complete:
        raise _nothing(command, asked, notes)
    return complete, notes


def _nothing(command: str, asked: Collection[str], notes: Sequence[str]) -> NothingTracked:
    why = "".join(f". {note.removesuffix('.')}" for note in notes)
    values = " for these values" if asked else ""
    return NothingTracked(f"no complete run is stored{values}; make one with bench {command}, then choose{why}")


def _asked(results: Sequence[Result], asked: Mapping[str, list[str]]) -> list[Result]:
    """The results that were asked for."""
    for key in asked:
        if (name := COLUMNS.get(key, key)).startswith("protocol.") and not any(name in r for r in results):
            raise InputError(f"{key}: no stored run has this parameter; leave it out or run that protocol")
    if "shots" in asked:
        results = [r for r in results if r.get("protocol.unlabelled") != "True"]
    return selected(results, {"target": ["gesture"], **asked})


def _newest(results: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """The results on the captures and under the protocol of the newest, and how many others are left out.

    Parameters that results of a kind share are those of the newest of this kind.
    """
    arguments = list(dict.fromkeys(_arguments(results)))
    if len(arguments) > 1:
        raise InputError(
            f"runs on different captures or protocols cannot be compared; name one of: {'; '.join(arguments[:4])}"
        )
    kinds = run_views()
    newest = max(results, key=lambda r: r["started"])
    here = [r for r in results if alike(r, ["protocol"]) == alike(newest, ["protocol"])]
    last = {r.kind: alike(r, kinds[r.kind].alike) for r in sorted(here, key=lambda r: r["started"])}
    kept = [r for r in here if alike(r, kinds[r.kind].alike) == last[r.kind]]
    notes = []
    if len(kept) < len(results):
        mine = {id(r) for r in kept}
        others = [r for r in results if id(r) not in mine]
        apart = dict.fromkeys(filter(None, (kinds[r.kind].other for r in others)))
        versions = [*dict.fromkeys(str(r["corpus_digest"])[:8] for r in others)]
        told = {"others": len(others), "data": newest["data"], "apart": [*apart], "versions": versions}
        notes += sentences("bench.outcomes", "choice", "older", **told)
    return kept, notes


def _arguments(results: Sequence[Result]) -> list[str]:
    """Arguments of `bench choose` that select the captures and the protocol of each result."""
    parameters = list(dict.fromkeys(name for r in results for name in r.about if name.startswith("protocol.")))
    values: dict[tuple[str, str], set[str]] = {}
    for r in results:
        for name in parameters:
            if name in r:
                values.setdefault((r["protocol_name"], name), set()).add(r[name])
    texts = []
    for r in results:
        selecting = {"data": str(r["data"]), "where": str(r["subset"])}
        selecting |= {"protocol": str(r["protocol"]).partition("[")[0]}
        selecting |= {"target": str(r["target"])} if r["target"] != "gesture" else {}
        several_of = [name for name in parameters if len(values.get((r["protocol_name"], name), ())) > 1 and name in r]
        selecting |= {name: str(r[name]) for name in several_of}
        texts.append(" ".join(f"{key}={quoted(value)}" for key, value in selecting.items()))
    return texts


def _amounts(run: Row, way: Candidate) -> dict[str, Any]:
    """The costs of one way in which a run labels, by name.

    The time of a decision is the touch that it needs: computing time on this machine is another cost.
    """
    amounts: dict[str, Any] = {}
    for name, cost in costs().items():
        if cost.among is None and way.stored.get(name) != "":
            cell = (replace(cost, read=way.stored[name]) if name in way.stored else cost).cell(run)
            amounts[name] = cell.value if isinstance(cell, Interval) else cell
    return amounts | dict(way.costs)
