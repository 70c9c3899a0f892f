"""The candidates of a choice: every way in which a stored system labels captures, with its costs."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from bench.arguments import quoted, typed
from bench.comparable import COMPARABLE, CONDITIONS, Row, context_of, facts_of, several
from bench.errors import InputError
from bench.measures import Interval, costs, costs_of
from bench.outcomes.pick import People, within
from bench.outcomes.reactions import Reactions, by_capture, by_decision
from bench.outcomes.runs import COLUMNS, NothingTracked, selected, subject_accuracy
from bench.outcomes.scores import classes_of
from bench.outcomes.stability import unharmed
from bench.outcomes.stopping import standing
from bench.result import Result
from bench.usual import CLEAN, FALSE_ALARMS, NO_TOUCH, SEVERITIES

KINDS = ("cell", "chip", "stream")  # of runs whose systems are candidates
WATCH = "watch"  # kind of run whose systems are candidates for costs of recordings
STRESS = "stress"  # kind of run that knows losses under faults
IN_RECORDINGS = "touches in recordings"  # unit of their accuracy
TAGS = {  # columns of a candidate that repeat a tag of its last run
    "kind": "touchbench.kind",
    "command": "touchbench.command",
    "arguments": "touchbench.arguments",
    "conditions": CONDITIONS,
}
PLAIN = Reactions()
TAKEN = ("data", "where", "target", "protocol", "model", "features", "seed")  # keys of a run that others repeat


@dataclass(frozen=True)
class Faults:
    """The circumstances over which losses are taken.

    Attributes:
        names: faults of ``bench stress``.
        severity: highest severity; lower ones count, too.
    """

    names: tuple[str, ...]
    severity: int = SEVERITIES

    @property
    def circumstances(self) -> list[tuple[str, int]]:
        """Every fault at every severity."""
        return [(name, severity) for name in self.names for severity in range(1, self.severity + 1)]


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
    results: Mapping[str, Sequence[Result]],
    asked: Mapping[str, list[str]],
    most: float | None = None,
    *,
    windows: bool = False,
    clock: float | None = None,
    batch: bool = False,
    watched: bool = False,
    reactions: Reactions = PLAIN,
    faults: Faults | None = None,
) -> Candidates:
    """Every way in which a system labels captures, or windows of them; the seeds of a system are averaged.

    Systems that ``bench chip`` has exported label as C, with bytes and instructions that were measured. Systems that
    ``bench stream`` has replayed label after the beginning of a capture.

    Args:
        results: results by kind of run, from `bench.outcomes.runs.of_kinds`.
        asked: filters, as in `eligible`.
        most: ms of touch until a decision. A replayed system decides as late as that allows; with inf, each of its
            instants is a candidate; with None, replays are none.
        windows: label single windows, in percent of windows, of the systems that decide on such.
        clock: clock of the target in MHz: the measured cycles at this clock are part of the decision time.
        batch: True to include batch systems, as in `eligible`.
        watched: True for runs of ``bench watch`` alone, which no other choice has. Accuracy is then the share of
            touches whose label is correct at the end; the table also has the costs of recordings.
        reactions: reactions of the robot to gestures, which are scored.
        faults: circumstances over which losses are taken; None for no losses.

    Raises:
        NothingTracked: no complete result is there for these values.
        InputError: results on several corpora or protocols are, a table of one is gone, or the reactions name a gesture
            that does not exist.
    """
    kinds = ["cell"] if windows else [kind for kind in KINDS if kind != "stream" or most is not None]
    kinds = [WATCH] if watched else kinds
    mine = costs_of(watched)
    fixed = [name for name, cost in mine.items() if not cost.personal]
    shots = "".join(f" protocol=personal protocol.shots={number}" for number in asked.get("shots", []))
    every = [result for kind in kinds for result in results.get(kind, ())]
    chosen, notes = eligible(every, asked, windows, batch, "watch" if watched else f"run{shots}")
    linked = _linked(chosen)
    options = ("stream.hop_ms", "chip.bits", "watch.false_alarms")
    groups: dict[tuple[str, ...], list[Result]] = {}
    for r in chosen:
        groups.setdefault((r["system"], r.kind, *(str(r.get(name, "")) for name in options)), []).append(r)
    rows, accuracies, alarms = [], [], []
    behind: list[list[Result]] = []
    for (system, kind, *_), seeds in sorted(groups.items(), key=lambda group: group[0]):
        ways = [_ways(r, {**r, **linked.get(system, {})}, most, windows, reactions) for r in seeds]
        tags = {column: str(seeds[-1].get(name, "")) for column, name in TAGS.items()}
        last = {
            **tags,
            "linked": kind == "chip" or system in linked,
            "cpu": ", ".join(sorted({r["cpu"] for r in seeds})),
        }
        for unit in ways[0]:
            amounts = pd.DataFrame([way[unit][0] for way in ways], dtype=float).mean().reindex(fixed)
            rows.append({"system": seeds[-1].system, "unit": unit, **amounts, **last})
            by_subject = [
                pd.concat([way[unit][1][k] for way in ways], axis=1).mean(axis=1) for k in range(len(ways[0][unit][1]))
            ]
            accuracies.append(by_subject[0])
            alarms.append(by_subject[1:])
            behind.append([*seeds])
    subjects = pd.DataFrame(accuracies).reset_index(drop=True)
    table = pd.DataFrame(rows).assign(accuracy=subjects.mean(axis=1))
    if clock is not None:
        table["decision"] += (table["cycles"] / clock).fillna(0)  # thousands by MHz: ms
    losses = np.empty((len(table), 0, subjects.shape[1]))
    if faults is not None:
        losses = _losses(results.get(STRESS, ()), chosen[0], table, [*subjects], faults, reactions)
    counts = [[part.reindex(subjects.columns) for part in each] for each in alarms]
    shape = (len(table), 2, subjects.shape[1]) if watched else (0, 2, 0)
    alarmed = np.reshape(counts, shape).transpose(1, 0, 2)
    people = People(subjects.to_numpy(float), losses, alarmed, {k: table[k].to_numpy(float) for k in fixed})
    everyone = np.arange(subjects.shape[1])[None]
    table = table.assign(**{name: people.cost(name, everyone)[0] for name, cost in mine.items() if cost.personal})
    mixed = any(facts_of(r).mixes_subjects for r in chosen)
    gestures = () if reactions.plain else _gestures(chosen[0])
    context = ", ".join(context_of(chosen[0]))
    return Candidates(table, context, subjects, people, behind, gestures, chosen[0], mixed, notes)


def _gestures(result: Result) -> tuple[str, ...]:
    """All gestures of the captures or recordings of a run."""
    if result.kind != WATCH:
        return tuple(classes_of(result.tables["predictions"]))
    touches = result.tables["touches"]
    return tuple(sorted({*touches["gesture"].astype(str), str(result["watch.background"]) or NO_TOUCH}))


def _losses(
    results: Sequence[Result],
    context: Result,
    table: pd.DataFrame,
    subjects: list[str],
    faults: Faults,
    reactions: Reactions,
) -> np.ndarray:
    """Points that each candidate loses under each fault at each severity, float [candidates, circumstances, subjects].

    NaN where no complete result is of all circumstances, and for windows and early decisions. Seeds are averaged.
    Systems with captures of a new person are tested under faults without these captures.

    Args:
        results: results of ``bench stress``.
        context: a result of the candidates.
        table: candidates.
        subjects: names of the subjects.
        faults: the circumstances.
        reactions: reactions that are scored.
    """
    losses = np.full((len(table), len(faults.circumstances), len(subjects)), np.nan)
    personal = str(context["protocol"]).startswith("personal")
    name, protocol = ("protocol_name", "loso") if personal else ("protocol_label", context["protocol_label"])
    by_system: dict[str, dict[str, list[Result]]] = {}
    for r in results:
        if r[name] == protocol and complete_on(r, context):
            by_system.setdefault(r.system, {}).setdefault(r["seed"], []).append(r)
    for system, seeds in by_system.items():
        rows = (table["system"] == system) & table["unit"].str.match("capture$|in C, 32 bits$|" + IN_RECORDINGS)
        parts = [_lost(each, faults, reactions) for each in seeds.values()] if rows.any() else []
        if known := [part.reindex(columns=subjects).to_numpy() for part in parts if part is not None]:
            losses[rows.to_numpy()] = np.mean(known, axis=0)
    return losses


def _lost(results: Sequence[Result], faults: Faults, reactions: Reactions) -> pd.DataFrame | None:
    """Points lost [circumstances, subjects] in some runs of one system; None if a circumstance is not in any of them.

    These runs store labels, so the reaction is that to the most probable gesture, also of clean captures.
    """
    tested = [(r, {*str(r.get("faults", "")).split(", ")}) for r in sorted(results, key=lambda r: r["started"])]
    if not {*faults.names} <= {name for _, names in tested for name in names}:
        return None  # without reading any table
    lost: dict[tuple[str, int], pd.Series] = {}
    for result, names in tested:
        if not names & {*faults.names}:
            continue
        table = result.tables["stress"]
        asked = table["fault"].isin(faults.names) & (table["severity"] <= faults.severity)
        rows = pd.concat([unharmed(table), table[asked]], ignore_index=True)
        keys = [rows["fault"], rows["severity"], rows["subject"].astype(str)]
        mean = 100 * pd.Series(reactions.mistakes(rows)).groupby(keys).mean().unstack()
        for fault, severity in {*mean.index} & {*faults.circumstances}:
            lost[fault, severity] = mean.loc[(fault, severity)] - mean.loc[(CLEAN, 0)]
    if not {*faults.circumstances} <= {*lost}:
        return None
    return pd.DataFrame({key: lost[key] for key in faults.circumstances}).T


def complete_on(result: Result, context: Result) -> bool:
    """Whether a result is complete and on the captures of another one."""
    same = (name for name in COMPARABLE if name != "protocol_label")
    return result.complete and all(result[name] == context[name] for name in same)


def missing(table: pd.DataFrame, wanted: Collection[str], faults: Faults | None) -> dict[str, list[str]]:
    """Commands that measure what is not stored, by cost.

    Args:
        table: candidates.
        wanted: costs that were asked for.
        faults: circumstances over which losses are taken.
    """
    commands: dict[str, list[str]] = {}
    for name in wanted:
        cost = costs()[name]
        lacking = table[table[name].isna() & table["unit"].str.match("capture$|" + IN_RECORDINGS)]
        texts = [text for text in lacking["arguments"] if text]
        if not cost.command or (cost.stress and faults is None):
            continue
        more = {"faults": ",".join(faults.names)} if cost.stress and faults is not None else {}
        lines = [typed(cost.command, repeated(text, impersonal=cost.stress) | more) for text in texts]
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
    windows: bool = False,
    batch: bool = False,
    command: str = "run",
) -> tuple[list[Result], list[str]]:
    """The complete results among which can be chosen, and which others are left out, in sentences.

    Args:
        results: results of some kinds of run.
        asked: names of ``data``, ``protocol``, ``where``, ``target``, ``model``, ``features`` to choose among, and
            number of ``shots``; parameters of the protocol by their dotted names; or values of `COMPARABLE`.
        windows: True for results that decide on windows only.
        batch: True to include systems whose predictions depend on the other captures of the batch.
        command: command that makes such runs.

    Raises:
        NothingTracked: there is none.
        InputError: they are on several corpora or protocols.
    """
    kept = _asked(results, asked)
    if windows:
        kept = [r for r in kept if r.get("windows", 0) > 0]
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
        notes.append(f"Left out because folds failed: {'; '.join(names)}. Repeat the command to run these folds again.")
    if not batch and (names := sorted({r["system"] for r in complete if not r.alone})):
        complete = [r for r in complete if r["system"] not in names]
        notes.append(
            "Left out because predictions depend on other test captures: "
            f"{'; '.join(names)}. To include these systems, give batch=yes."
        )
    if not complete:
        why = "".join(f". {note.removesuffix('.')}" for note in notes)
        raise NothingTracked(
            f"no complete run is stored for these values; make one with bench {command}, then choose{why}"
        )
    return complete, notes


def _asked(results: Sequence[Result], asked: Mapping[str, list[str]]) -> list[Result]:
    """The results that were asked for; replays only from the onset, and no gesture left out of training.

    Raises:
        InputError: no result has a parameter that was asked for.
    """
    for key in asked:
        if (name := COLUMNS.get(key, key)).startswith("protocol.") and not any(name in r for r in results):
            raise InputError(f"{key}: no stored run has this parameter; leave it out or run that protocol")
    if "shots" in asked:
        results = [r for r in results if r.get("protocol.unlabelled") != "True"]
    plain = {"stream.start": "onset", "watch.unknown": ""}
    results = [r for r in results if all(r.get(name, value) == value for name, value in plain.items())]
    return selected(results, {"target": ["gesture"], **asked})


def _newest(results: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """The results on the captures and under the protocol of the newest, and how many others are left out.

    Raises:
        InputError: arguments of `bench choose` can tell them apart.
    """
    arguments = list(dict.fromkeys(_arguments(results)))
    if len(arguments) > 1:
        raise InputError(
            f"runs on different captures or protocols cannot be compared; name one of: {'; '.join(arguments[:4])}"
        )
    watched = any("watch.background" in r for r in results)
    same = [*COMPARABLE, "protocol", *(["watch.background"] if watched else [])]
    newest = max(results, key=lambda r: r["started"])
    kept = [r for r in results if all(r.get(name) == newest.get(name) for name in same)]
    notes = []
    if others := [r for r in results if r not in kept]:
        versions = ", ".join(dict.fromkeys(str(r["corpus_digest"])[:8] for r in others))
        notes.append(
            f"Left out: {several(len(others), 'older run')} on other captures of {newest['data']} or under "
            f"another version of the protocol{', or with another background' * watched} (corpus {versions})."
        )
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


def _linked(results: Sequence[Result]) -> dict[str, dict[str, float]]:
    """By system, bytes as linked of its C in 32 bits, whose labels are its own: the counted ones leave code out."""
    in_32_bits = [r for r in results if r.kind == "chip" and r["chip.bits"] == "32"]
    return {
        str(r["system"]): {f"{name}_bytes": r[f"chip_{name}_bytes"] for name in ("flash", "ram")} for r in in_32_bits
    }


def _ways(
    result: Result, run: Row, most: float | None, windows: bool, reactions: Reactions
) -> dict[str, tuple[dict[str, float], list[pd.Series]]]:
    """Costs, and the score by subject, in percent, of each way in which a run labels.

    ``run`` has the numbers of the result, with linked bytes where they are known; other arguments as of `candidates`.

    The time of a decision is the touch that it needs: computing time on this machine is another cost. Runs of
    ``bench watch`` also give false alarms and hours of background by subject.
    """
    kind = result.kind
    if kind == WATCH:
        shares = result.tables["per_subject"].set_index("subject")
        if "background_s" not in shares:
            raise InputError(f"{run['system']}: an older version stored this run of bench watch; run it again")
        score, hours = 100 * shares["end_correct"].dropna(), shares["background_s"] / 3600
        if not reactions.plain:
            reactions.of(_gestures(result))  # refuses other names
            score = reactions.scores(result.tables["touches"].rename(columns={"gesture": "true", "label": "predicted"}))
        aim = float(run["watch.false_alarms"])
        unit = IN_RECORDINGS + ("" if aim == FALSE_ALARMS else f", false_alarms={aim:g}")
        alarms = (shares["false_alarms_per_hour"] * hours).fillna(0)
        return {unit: (_amounts(run, decision="", cycles=""), [score, alarms, hours])}
    if kind == "cell" and not windows:
        # What the run stored is the same and quick: reading the predictions of 1000 runs takes a minute.
        stored = pd.Series(subject_accuracy(result), dtype=float) if reactions.plain else pd.Series(dtype=float)
        scored = stored if len(stored) else _score(result.tables["predictions"], reactions)
        return {"capture": (_amounts(run), [scored])}
    table = result.tables["predictions"]
    if kind == "cell":
        amounts = _amounts(run, predict="decide_ms_p50", decision="observed_ms")
        return {"window": (amounts, [reactions.scores(by_decision(table, reactions))])}
    if kind == "chip":
        amounts = _amounts(run, flash="chip_flash_bytes", ram="chip_ram_bytes", predict="")
        return {f"in C, {run['chip.bits']} bits": (amounts, [_score(table, reactions)])}
    amounts = _amounts(run, predict="decide_ms_p50", decision="")
    instants = result.tables["instants"]["ms"].tolist()
    decided = [*zip(instants, np.sort(table["instant"].unique()), strict=True)]  # ms, frames
    if most is not None and np.isfinite(most):  # the last that is soon enough, else the first
        decided = [one for one in decided if within("decision", one[0], most)][-1:] or decided[:1]
    return {
        f"first {ms:.0f} ms": (
            amounts | {"decision": ms},
            [reactions.scores(by_decision(standing(table, frames), reactions))],
        )
        for ms, frames in decided
    }


def _amounts(run: Row, **stored: str) -> dict[str, Any]:
    """The costs of one way in which a run labels, by name.

    Args:
        run: the run.
        stored: names of stored values that this way has in place of those that its costs name; empty for none.
    """
    amounts: dict[str, Any] = {}
    for name, cost in costs().items():
        if not cost.personal and stored.get(name) != "":
            cell = (replace(cost, read=stored[name]) if name in stored else cost).cell(run)
            amounts[name] = cell.value if isinstance(cell, Interval) else cell
    return amounts


def _score(predictions: pd.DataFrame, reactions: Reactions) -> pd.Series:
    """Score in percent by subject, of whole captures."""
    return reactions.scores(by_capture(predictions, reactions))
