"""The candidates of a choice: every way in which a stored system labels captures, with its costs."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.ground.registry import circumstance_views, run_views
from bench.ground.words import spelled, typed
from bench.reading.frame import selecting
from bench.reading.reactions import Reactions
from bench.reading.runs import COLUMNS, NothingTracked, plain, selected
from bench.values.candidate import Candidate, Losses, Wish
from bench.values.measures import Interval, costs, costs_of
from bench.values.result import CONDITIONS, Result, alike, seed_number, several
from bench.values.sentences import sentences

TAGS = {  # columns of a candidate that repeat a tag of its last run
    "command": "touchbench.command",
    "arguments": "touchbench.arguments",
    "conditions": CONDITIONS,
}
PLAIN = Reactions()
TAKEN = (
    "data",
    "where",
    "target",
    "protocol",
    "model",
    "features",
    "seed",
)  # keys of a run that others repeat
Way = list[tuple[Candidate, Result]]  # one way in which a system labels, of each seed


@dataclass(frozen=True)
class Candidates:
    """The candidates of a store, on the same captures under the same protocol."""

    # a row per candidate: ``system``, ``unit``, ``accuracy`` (the score in percent as a mean over subjects), every cost
    # of `bench.values.measures.costs_of` in its unit, NaN where it is unknown, ``linked`` (True for linked bytes, with code),
    # ``cpu`` and the keys of `TAGS`
    table: pd.DataFrame
    subjects: pd.DataFrame  # scores in percent [candidates, subjects]
    losses: (
        np.ndarray
    )  # points lost in each case [candidates, cases, subjects]; NaN where not stored
    counts: np.ndarray  # events, and hours in which they count [2, candidates, people]; also of people without a score
    first: Result  # a run of the candidates
    notes: list[str]  # excluded runs with reasons, in sentences

    @property
    def context(self) -> str:
        """Captures and protocol, in words."""
        return ", ".join(self.first.context)

    @property
    def mixed(self) -> bool:
        """True if training and test captures share subjects."""
        return self.first.mixed

    def without(self, person: int, names: Iterable[str]) -> Candidates:
        """The candidates without one person. Costs of these ``names`` that depend on people are computed again."""
        kept = self.subjects.drop(columns=self.subjects.columns[person])
        lost, counts = (np.delete(part, person, axis=-1) for part in (self.losses, self.counts))
        return replace(self, subjects=kept, losses=lost, counts=counts).with_costs(names)

    def with_costs(self, names: Iterable[str]) -> Candidates:
        """The candidates with the costs of these ``names`` that depend on which people are counted."""
        among = {name: among(self) for name in names if (among := costs()[name].among) is not None}
        return replace(self, table=self.table.assign(**among))

    def lowest(self, count: int) -> np.ndarray:
        """Mean of the lowest scores [candidates]; NaN where a person has none."""
        scores = self.subjects.to_numpy(float)
        return np.where(
            np.isnan(scores).any(axis=1), np.nan, np.sort(scores)[:, :count].mean(axis=1)
        )

    def loss(self) -> np.ndarray:
        """Mean points lost in each case [candidates, cases]."""
        return (
            self.losses.mean(axis=2)
            if self.losses.shape[1]
            else np.full((len(self.table), 1), np.nan)
        )

    def rate(self) -> np.ndarray:
        """Events per hour [candidates]."""
        events, hours = (
            self.counts.sum(axis=2) if len(self.counts) else np.full((2, len(self.table)), np.nan)
        )
        return np.divide(events, hours, out=np.full(len(hours), np.nan), where=hours > 0)


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
    chosen, notes = eligible(every, asked, batch, command)
    lent: dict[str, dict[str, float]] = {}
    for r in chosen:
        lent.setdefault(str(r["system"]), {}).update(kinds[r.kind].lends(r))
    ways = _ways(chosen, wish, kinds)
    if not ways:
        raise _nothing(command, asked, notes)
    number = np.repeat(range(len(ways)), [*map(len, ways)])  # of the candidate of each seed
    each = [(way, r, lent[str(r["system"])]) for seeds in ways for way, r in seeds]

    def over_seeds(numbers: Iterable[Mapping[str, Any] | pd.Series]) -> pd.DataFrame:
        return (
            pd.DataFrame([dict(one.items()) for one in numbers], dtype=float).groupby(number).mean()
        )

    table = pd.DataFrame([_about(seeds, lent[str(seeds[0][1]["system"])]) for seeds in ways])
    same = table.duplicated(["system", "unit"], keep=False)  # such as early decisions with two hops
    apart = pd.Series([", ".join(seeds[0][0].apart) for seeds in ways])
    table.loc[same & (apart != ""), "unit"] += ", " + apart
    subjects = over_seeds(way.scores for way, *_ in each)
    amounts = over_seeds(_amounts(r.metrics | others, way, study) for way, r, others in each)
    table = pd.concat([table.assign(accuracy=subjects.mean(axis=1)), amounts], axis=1)
    for name in map(str, amounts):
        if clock is not None and (slower := costs()[name].at_clock) in table:
            table[slower] += (table[name] / clock).fillna(0)  # thousands by MHz: ms
    lost = np.empty((len(table), 0, subjects.shape[1]))
    if losses is not None:
        lost = _losses(results, chosen[0], table, [*subjects], losses, wish.reactions)
    counts = [over_seeds(kind) for kind in zip(*(way.counts for way, *_ in each), strict=True)]
    order = [*subjects, *sorted({str(name) for part in counts for name in part} - {*subjects})]
    counted = np.array([part.reindex(columns=order) for part in counts]).reshape(
        -1, len(ways), len(order)
    )
    return Candidates(table, subjects, lost, counted, chosen[0], notes).with_costs(costs_of(study))


def _ways(results: Sequence[Result], wish: Wish, kinds: Mapping[str, Any]) -> list[Way]:
    """The ways in which systems label, by system; of one way and seed, the last run counts."""
    as_they_are = {id(r) for r in plain(results)}
    ways: dict[tuple, dict[str, tuple[Candidate, Result]]] = {}
    for r in results:
        for way in kinds[r.kind].candidates(r, replace(wish, plain=id(r) in as_they_are)):
            ways.setdefault((str(r["system"]), way.mark, way.apart, way.unit), {})[r["seed"]] = (
                way,
                r,
            )
    order = sorted(ways, key=lambda key: key[:3])
    return [[ways[key][seed] for seed in sorted(ways[key], key=seed_number)] for key in order]


def _about(seeds: Way, lent: Mapping[str, float]) -> dict[str, Any]:
    """A candidate, without its numbers."""
    way, runs = seeds[0][0], [r for _, r in seeds]
    last = max(runs, key=lambda r: r["started"])
    changed = any(r.metrics.get(name, value) != value for r in runs for name, value in lent.items())
    return {
        **{"system": last.system, "unit": way.unit, "mark": way.mark, "whole": way.whole},
        **{column: str(last.get(name, "")) for column, name in TAGS.items()},
        **{"linked": way.linked or changed, "shipped": json.dumps(dict(way.shipped))},
        "cpu": ", ".join(sorted({r["cpu"] for r in runs})),
    }


def _amounts(numbers: Mapping[str, float], way: Candidate, study: str) -> dict[str, Any]:
    """The costs of one way in which a run labels that do not depend on people, by name.

    The time of a decision is the touch that it needs: computing time on this machine is another cost.
    """
    fixed = {name: cost for name, cost in costs_of(study).items() if cost.among is None}
    own = {
        **numbers,
        **{fixed[name].source: numbers.get(at) for name, at in way.stored.items() if name in fixed},
    }
    cells = {name: cost.cell(own) for name, cost in fixed.items()}
    return {name: c.value if isinstance(c, Interval) else c for name, c in cells.items()} | dict(
        way.costs
    )


def _losses(
    results: Sequence[Result],
    context: Result,
    table: pd.DataFrame,
    subjects: list[str],
    losses: Losses,
    reactions: Reactions,
) -> np.ndarray:
    """Points that each candidate loses under each fault at each severity, float [candidates, cases, subjects].

    NaN where no complete result is of all faults, and for windows and early decisions. Seeds are averaged.
    """
    lost = np.full((len(table), len(losses.circumstances), len(subjects)), np.nan)
    whole = table[table["whole"]].groupby("system").groups
    for circumstance in circumstance_views():
        by_seed: dict[str, dict[str, list[Result]]] = {str(system): {} for system in whole}
        for r in results:
            if (
                circumstance.holds(r)
                and r.complete
                and r.comparable == context.comparable
                and r.system in by_seed
            ):
                by_seed[r.system].setdefault(r["seed"], []).append(r)
        for system, seeds in by_seed.items():
            parts = [circumstance.lost(each, losses, reactions) for each in seeds.values()]
            if known := [
                part.reindex(columns=subjects).to_numpy() for part in parts if part is not None
            ]:
                lost[whole[system].to_numpy()] = np.mean(known, axis=0)
    return lost


def missing(
    table: pd.DataFrame, asked: Iterable[str], losses: Losses | None
) -> dict[str, list[str]]:
    """Commands that measure costs which are asked for and not stored, by what they measure, in words."""
    lossy = [name for name, cost in costs().items() if cost.losses and losses is not None]
    wanted = {
        cost.command: cost
        for cost in reversed([costs()[name] for name in (*asked, *lossy)])
        if cost.command
    }
    commands: dict[str, list[str]] = {}
    for cost in reversed(wanted.values()):  # the first of those that one command measures
        command, *more = cost.command.format(
            faults=",".join(losses.names if losses else ())
        ).split()
        given = dict(word.split("=", 1) for word in more)
        lacking = table["arguments"][
            table[cost.key].isna() & table["whole"] & (table["mark"] == "")
        ]
        lines = dict.fromkeys(typed(command, repeated(text) | given) for text in lacking if text)
        if lines:
            commands[f"The {cost.noun} of {several(len(lines), 'system')}"] = [*lines]
    return commands


def repeated(text: str) -> dict[str, str]:
    """Arguments of a run that another command repeats."""
    return {k: v for k, v in json.loads(text or "{}").items() if k.split(".")[0] in TAKEN}


def eligible(
    results: Sequence[Result],
    asked: Mapping[str, list[str]],
    batch: bool = False,
    command: str = "run",
) -> tuple[list[Result], list[str]]:
    """The complete results among which can be chosen, and which others are left out, in sentences."""
    for key in asked:
        if (name := COLUMNS.get(key, key)).startswith("protocol.") and not any(
            name in r for r in results
        ):
            raise InputError(
                f"{key}: no stored run has this parameter; leave it out or run that protocol"
            )
    kept = selected(results, {"target": ["gesture"], **asked})
    complete = [r for r in kept if r.complete]
    notes: list[str] = []
    if complete and "protocol_label" not in asked:
        complete, notes = _newest(complete)
    same = {r.comparable for r in complete}
    here = [r for r in kept if not r.complete and (r.comparable in same or not complete)]
    if failed := {r["system"] for r in here} - {r["system"] for r in complete}:
        notes += sentences("bench.reading", "choice", "failed", names=sorted(failed))
    if not batch and (names := sorted({r["system"] for r in complete if not r.alone})):
        complete = [r for r in complete if r["system"] not in names]
        notes += sentences("bench.reading", "choice", "batch", names=names)
    if not complete:
        raise _nothing(command, asked, notes)
    return complete, notes


def _nothing(command: str, asked: Collection[str], notes: Sequence[str]) -> NothingTracked:
    why = "".join(f". {note.removesuffix('.')}" for note in notes)
    values = " for these values" if asked else ""
    return NothingTracked(
        f"no complete run is stored{values}; make one with bench {command}, then choose{why}"
    )


def _newest(results: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """The results on the captures and under the protocol of the newest, and how many others are left out.

    Parameters that results of a kind share are those of the newest of this kind.
    """
    apart = [*{r.comparable: r for r in results}.values()]
    arguments = [*dict.fromkeys(spelled(selecting(r, apart)) for r in apart)]
    if len(arguments) > 1:
        raise InputError(
            f"runs on different captures or protocols cannot be compared; name one of: {'; '.join(arguments[:4])}"
        )
    kinds, by_age = run_views(), sorted(results, key=lambda r: r["started"])
    newest = alike(by_age[-1], ["protocol"])
    same = [r for r in by_age if alike(r, ["protocol"]) == newest]
    last = {r.kind: alike(r, kinds[r.kind].alike) for r in same}
    kept = {r for r in same if alike(r, kinds[r.kind].alike) == last[r.kind]}
    others = [r for r in results if r not in kept]
    told = {"others": len(others), "data": by_age[-1]["data"]}
    told |= {"apart": [*dict.fromkeys(filter(None, (kinds[r.kind].other for r in others)))]}
    told |= {"versions": [*dict.fromkeys(str(r["corpus_digest"])[:8] for r in others)]}
    notes = sentences("bench.reading", "choice", "older", **told) if others else []
    return [r for r in results if r in kept], notes
