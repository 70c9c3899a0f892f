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
from bench.outcomes.pick import People
from bench.outcomes.reactions import Reactions
from bench.outcomes.runs import COLUMNS, NothingTracked, plain, selected
from bench.registry import classes
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
class Candidates:
    """The candidates of a store, on the same captures under the same protocol.

    Attributes:
        table: one row per candidate (``system``, ``unit``, ``accuracy``, the score in percent as a mean over subjects,
            every cost of `bench.measures.costs_of` in its unit, NaN where it is unknown, ``linked``, True for linked
            bytes, with code, ``cpu`` and the keys of `TAGS`).
        context: captures and protocol, in words.
        subjects: scores in percent [candidates, subjects].
        people: contribution of each subject to scores and costs, in the order of these two.
        runs: runs of each candidate, in the order of the table: one for each seed.
        gestures: all gestures; empty if each is its own reaction and all mistakes cost the same.
        first: a run of the candidates.
        mixed: True if training and test captures share subjects.
        notes: excluded runs with reasons, in sentences.
    """

    table: pd.DataFrame
    context: str
    subjects: pd.DataFrame
    people: People
    runs: list[list[Result]]
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
    recordings: bool = False,
    losses: Losses | None = None,
) -> Candidates:
    """Every way in which a system labels, as the kinds of run give them; the seeds of a system are averaged.

    Args:
        results: results of all kinds, from `bench.outcomes.runs.every_result`.
        asked: filters, as in `eligible`.
        wish: demands on these ways; None for whole captures, each gesture its own reaction.
        clock: clock of the target in MHz: the measured cycles at this clock are part of the decision time.
        batch: True to include batch systems, as in `eligible`.
        recordings: True for kinds of run on recordings alone, which no other choice has.
        losses: faults over which losses are taken; None for no losses.

    Raises:
        NothingTracked: no complete result is there for these values.
        InputError: results on several corpora or protocols are, a table of one is gone, or the reactions name a gesture
            that does not exist.
    """
    wish = wish or Wish(PLAIN)
    kinds = {kind.tag: (command, kind) for command, kind in classes("kinds").items() if kind.recordings == recordings}
    mine = costs_of(recordings)
    fixed = [name for name, cost in mine.items() if not cost.personal]
    every = [r for r in results if r.kind in kinds and kinds[r.kind][1].offers(r, wish)]
    shots = "".join(f" protocol=personal protocol.shots={number}" for number in asked.get("shots", []))
    command = next(iter(kinds.values()))[0]
    command += "" if recordings else shots
    chosen, notes = eligible(every, asked, batch, command)
    lent: dict[str, dict[str, float]] = {}
    for r in chosen:
        lent.setdefault(str(r["system"]), {}).update(kinds[r.kind][1].lends(r))
    as_they_are = {id(r) for r in plain(chosen)}
    ways: dict[tuple, dict[str, tuple[Candidate, Result]]] = {}
    for r in chosen:
        for way in kinds[r.kind][1].candidates(r, replace(wish, plain=id(r) in as_they_are)):
            ways.setdefault((r["system"], way.mark, way.apart, way.unit), {})[r["seed"]] = (way, r)
    if not ways:
        raise _nothing(command, asked, notes)
    order = [*ways]
    rows: list[dict[Any, Any]] = []
    accuracies: list[pd.Series] = []
    alarms: list[Any] = []
    behind: list[list[Result]] = []
    for key in sorted(order, key=lambda key: (key[:3], order.index(key))):
        seeds = [ways[key][seed] for seed in sorted(ways[key], key=seed_number)]
        last = max((r for _, r in seeds), key=lambda r: r["started"])
        more = lent[key[0]]
        amounts = [_amounts({**r, **more}, way) for way, r in seeds]
        tags = {column: str(last.get(name, "")) for column, name in TAGS.items()}
        changed = any(r.metrics.get(name, value) != value for _, r in seeds for name, value in more.items())
        rows.append(
            {"system": last.system, "unit": key[3]}
            | pd.DataFrame(amounts, dtype=float).mean().reindex(fixed).to_dict()
            | tags
            | {"linked": seeds[0][0].linked or changed, "mark": key[1], "whole": seeds[0][0].whole}
            | {"shipped": json.dumps(dict(seeds[0][0].shipped))}
            | {"cpu": ", ".join(sorted({r["cpu"] for _, r in seeds}))}
        )
        by_subject = [[way.scores, *way.counts] for way, _ in seeds]
        means = [pd.concat(parts, axis=1).mean(axis=1) for parts in zip(*by_subject, strict=True)]
        accuracies.append(means[0])
        alarms.append(means[1:])
        behind.append([r for _, r in seeds])
    subjects = pd.DataFrame(accuracies).reset_index(drop=True)
    table = pd.DataFrame(rows).assign(accuracy=subjects.mean(axis=1))
    if clock is not None:
        table["decision"] += (table["cycles"] / clock).fillna(0)  # thousands by MHz: ms
    lost = np.empty((len(table), 0, subjects.shape[1]))
    if losses is not None:
        lost = _losses(results, chosen[0], table, [*subjects], losses, wish.reactions)
    untouched = sorted({name for each in alarms for part in each for name in part.index} - {*subjects})
    counts = [[part.reindex([*subjects, *untouched]) for part in each] for each in alarms]
    shape = (len(table), 2, len(untouched) + subjects.shape[1]) if recordings else (0, 2, 0)
    alarmed = np.reshape(counts, shape).transpose(1, 0, 2)
    people = People(subjects.to_numpy(float), lost, alarmed, {k: table[k].to_numpy(float) for k in fixed})
    everyone = np.arange(subjects.shape[1])[None]
    table = table.assign(**{name: people.cost(name, everyone)[0] for name, cost in mine.items() if cost.personal})
    mixed = any(facts_of(r).mixes_subjects for r in chosen)
    gestures = () if wish.reactions.plain else kinds[chosen[0].kind][1].gestures(chosen[0])
    context = ", ".join(context_of(chosen[0]))
    return Candidates(table, context, subjects, people, behind, gestures, chosen[0], mixed, notes)


def _losses(
    results: Sequence[Result],
    context: Result,
    table: pd.DataFrame,
    subjects: list[str],
    losses: Losses,
    reactions: Reactions,
) -> np.ndarray:
    """Points that each candidate loses under each fault at each severity, float [candidates, circumstances, subjects].

    NaN where no complete result is of all circumstances, and for windows and early decisions. Seeds are averaged.
    Systems with captures of a new person are tested under faults without these captures.

    Args:
        results: results of all kinds.
        context: a result of the candidates.
        table: candidates.
        subjects: names of the subjects.
        losses: faults and severities.
        reactions: reactions that are scored.
    """
    lost = np.full((len(table), len(losses.circumstances), len(subjects)), np.nan)
    personal = str(context["protocol"]).startswith("personal")
    name, protocol = ("protocol_name", "loso") if personal else ("protocol_label", context["protocol_label"])
    for circumstance in classes("circumstances").values():
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
    """Commands that measure what is not stored, by cost.

    Args:
        table: candidates.
        wanted: costs that were asked for.
        losses: faults over which losses are taken.
    """
    commands: dict[str, list[str]] = {}
    for name in wanted:
        cost = costs()[name]
        lacking = table[table[name].isna() & table["whole"] & (table["mark"] == "")]
        texts = [text for text in lacking["arguments"] if text]
        if not cost.command or (cost.losses and losses is None):
            continue
        more = cost.asks(losses) if cost.asks else {}
        lines = [typed(cost.command, repeated(text, impersonal=cost.losses) | more) for text in texts]
        if lines:
            commands[name] = list(dict.fromkeys(lines))
    return commands


def repeated(text: str, impersonal: bool = False) -> dict[str, str]:
    """Arguments of a run that another command repeats.

    Args:
        text: arguments of the run as tracked.
        impersonal: True for commands that have no captures of a new person; they leave each subject out instead.
    """
    given = {k: v for k, v in json.loads(text or "{}").items() if k.split(".")[0] in TAKEN}
    if impersonal and given.get("protocol", "").startswith("personal"):
        given = {k: v for k, v in given.items() if not k.startswith("protocol.")} | {"protocol": "loso"}
    return given


def elsewhere(
    results: Sequence[Result], context: Result, table: pd.DataFrame, command: str, more: Mapping[str, str]
) -> list[str]:
    """Commands that would make candidates of systems which ``bench run`` has evaluated, leaving each subject out.

    Args:
        results: results of ``bench run``.
        context: a result of the candidates.
        table: candidates.
        command: command that makes candidates.
        more: its further arguments.
    """
    kept = [r for r in results if complete_on(r, context) and r["protocol_name"] == "loso"]
    others = [r for r in kept if r.system not in {*table["system"]}]
    given = [repeated(arguments) for r in others if (arguments := r.get("touchbench.arguments"))]
    return list(dict.fromkeys(typed(command, each | dict(more)) for each in given))


def eligible(
    results: Sequence[Result],
    asked: Mapping[str, list[str]],
    batch: bool = False,
    command: str = "run",
) -> tuple[list[Result], list[str]]:
    """The complete results among which can be chosen, and which others are left out, in sentences.

    Args:
        results: results of some kinds of run.
        asked: names of ``data``, ``protocol``, ``where``, ``target``, ``model``, ``features`` to choose among, and
            number of ``shots``; parameters of the protocol by their dotted names; or values of `COMPARABLE`.
        batch: True to include systems whose predictions depend on the other captures of the batch.
        command: command that makes such runs.

    Raises:
        NothingTracked: there is none.
        InputError: they are on several corpora or protocols.
    """
    kept = _asked(results, asked)
    complete = [r for r in kept if r.complete]
    notes: list[str] = []
    if complete and "protocol_label" not in asked:
        complete, notes = _newest(complete)
    same = {tuple(str(r[name]) for name in COMPARABLE) for r in complete}
    systems = {r["system"] for r in complete}
    failed = [r for r in kept if not r.complete and r["system"] not in systems]
    if complete:
        failed = [r for r in failed if tuple(str(r[name]) for name in COMPARABLE) in same]
    if names := sorted({r["system"] for r in failed}):
        notes += sentences("bench.outcomes", "choice", "failed", names=names)
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
    """The results that were asked for.

    Raises:
        InputError: no result has a parameter that was asked for.
    """
    for key in asked:
        if (name := COLUMNS.get(key, key)).startswith("protocol.") and not any(name in r for r in results):
            raise InputError(f"{key}: no stored run has this parameter; leave it out or run that protocol")
    if "shots" in asked:
        results = [r for r in results if r.get("protocol.unlabelled") != "True"]
    return selected(results, {"target": ["gesture"], **asked})


def _newest(results: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """The results on the captures and under the protocol of the newest, and how many others are left out.

    Parameters that results of a kind share are those of the newest of this kind.

    Raises:
        InputError: arguments of `bench choose` can tell them apart.
    """
    arguments = list(dict.fromkeys(_arguments(results)))
    if len(arguments) > 1:
        raise InputError(
            f"runs on different captures or protocols cannot be compared; name one of: {'; '.join(arguments[:4])}"
        )
    kinds = {kind.tag: kind for kind in classes("kinds").values()}
    newest = max(results, key=lambda r: r["started"])
    here = [r for r in results if alike(r, ["protocol"]) == alike(newest, ["protocol"])]
    last = {r.kind: alike(r, kinds[r.kind].alike) for r in sorted(here, key=lambda r: r["started"])}
    kept = [r for r in here if alike(r, kinds[r.kind].alike) == last[r.kind]]
    notes = []
    if others := [r for r in results if r not in kept]:
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
        selecting = {
            "data": str(r["data"]),
            "where": str(r["subset"]),
            "protocol": str(r["protocol"]).partition("[")[0],
        }
        selecting |= {"target": str(r["target"])} if r["target"] != "gesture" else {}
        several_of = [name for name in parameters if len(values.get((r["protocol_name"], name), ())) > 1 and name in r]
        selecting |= {name: str(r[name]) for name in several_of}
        texts.append(" ".join(f"{key}={quoted(value)}" for key, value in selecting.items()))
    return texts


def _amounts(run: Row, way: Candidate) -> dict[str, Any]:
    """The costs of one way in which a run labels, by name.

    The time of a decision is the touch that it needs: computing time on this machine is another cost.

    Args:
        run: the run.
        way: candidate, with the stored values that it has in place of those that costs name.
    """
    amounts: dict[str, Any] = {}
    for name, cost in costs().items():
        if not cost.personal and way.stored.get(name) != "":
            cell = (replace(cost, read=way.stored[name]) if name in way.stored else cost).cell(run)
            amounts[name] = cell.value if isinstance(cell, Interval) else cell
    return amounts | dict(way.costs)
