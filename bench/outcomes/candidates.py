"""The candidates of a choice: every way in which a stored system labels captures, with its costs."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from pyarrow.parquet import read_schema

from bench.arguments import quoted, typed
from bench.costs import COSTS, ROBUST, WATCHED
from bench.errors import InputError
from bench.outcomes.comparable import BATCH, COMPARABLE, CONDITIONS, Row, context_of, facts_of, several, system_of
from bench.outcomes.pick import People, within
from bench.outcomes.reactions import Reactions, by_capture, by_decision
from bench.outcomes.runs import (
    COLUMNS,
    NothingTracked,
    needed,
    of_kinds,
    rows_of,
    selected,
    subject_accuracy,
    tracked,
)
from bench.outcomes.scores import classes_of
from bench.outcomes.stability import CLEAN, unharmed
from bench.outcomes.stopping import standing
from bench.outcomes.store import Store

KINDS = ("cell", "chip", "stream")  # of runs whose systems are candidates
WATCH = "watch"  # kind of run whose systems are candidates for budgets of `WATCHED`
STRESS = "stress"  # kind of run that knows losses under faults
IN_RECORDINGS = "touches in recordings"  # unit of their accuracy
BACKGROUND = "notouch"  # of recordings, if no other is named
USUAL_AIM = 5.0  # false alarms per hour that bench watch learns for by default
TAGS = {  # columns of a candidate that repeat a tag of its last run
    "kind": "touchbench.kind",
    "command": "touchbench.command",
    "arguments": "touchbench.arguments",
    "conditions": CONDITIONS,
}
PLAIN = Reactions()
TAKEN = ("data", "where", "target", "protocol", "model", "features", "seed")  # keys of a run that others repeat
SEVERITIES = 5  # of a fault


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
            ``flash`` and ``ram`` in kB, ``predict`` and ``decision`` in ms, ``cycles`` in thousands of instructions,
            ``fault_loss`` and ``worst_fault`` in points, ``worst_person`` and ``worst_tenth`` in percent (100 less
            their score), ``linked``, True for linked bytes, with code, ``cpu`` and the keys of `TAGS`; NaN for unknown
            costs).
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
    runs: list[list[Row]]
    gestures: tuple[str, ...]
    first: Row
    mixed: bool
    notes: list[str]


def candidates(
    store: Store,
    asked: Mapping[str, list[str]],
    most: float | None = None,
    *,
    windows: bool = False,
    clock: float | None = None,
    batch: bool = False,
    watched: bool = False,
    reactions: Reactions = PLAIN,
    faults: Faults | None = None,
    runs_of: Mapping[str, pd.DataFrame] | None = None,
) -> Candidates:
    """Every way in which a tracked system labels captures, or windows of them; the seeds of a system are averaged.

    Systems that ``bench chip`` has exported label as C, with bytes and instructions that were measured. Systems that
    ``bench stream`` has replayed label after the beginning of a capture.

    Args:
        store: store of the runs.
        asked: filters, as in `eligible`.
        most: ms of touch until a decision. A replayed system decides as late as that allows; with inf, each of its
            instants is a candidate; with None, replays are none.
        windows: label single windows, in percent of windows, of the systems that decide on such.
        clock: clock of the target in MHz: the measured cycles at this clock are part of the decision time.
        batch: True to include batch systems, as in `eligible`.
        watched: True for runs of ``bench watch`` alone, which no other choice has. Accuracy is then the share of
            touches whose label is correct at the end; the table also has ``false_alarms`` per hour of background and
            ``latency``, the median in ms.
        reactions: reactions of the robot to gestures, which are scored.
        faults: circumstances over which losses are taken; None for no losses.
        runs_of: `bench.outcomes.runs.tracked` by kind, if already read.

    Raises:
        NothingTracked: no complete run is tracked for these values.
        InputError: runs on several corpora or protocols are, a table of one is gone, or the reactions name a gesture
            that does not exist.
    """
    kinds = ["cell"] if windows else [kind for kind in KINDS if kind != "stream" or most is not None]
    kinds, costs_of = ([WATCH], COSTS | WATCHED) if watched else (kinds, COSTS)
    tables = of_kinds(store, kinds) if runs_of is None else {kind: runs_of[kind] for kind in kinds if kind in runs_of}
    if not tables:
        tracked(store, kinds[0])  # which says so
    shots = "".join(f" protocol=personal protocol.shots={number}" for number in asked.get("shots", []))
    runs, notes = eligible([*tables.values()], asked, windows, batch, "watch" if watched else f"run{shots}")
    linked = _linked(runs)
    options = runs.reindex(columns=["stream.hop_ms", "chip.bits", "watch.false_alarms"]).fillna("")
    same = [runs["system"], runs["touchbench.kind"], *(options[name] for name in options)]
    rows, accuracies, alarms = [], [], []
    behind: list[list[Row]] = []
    for (system, kind, *_), group in runs.groupby(same, sort=True):
        seeds = [{**run, **linked.get(str(system), {})} for run in rows_of(group)]
        ways = [_ways(store, run, most, windows, reactions) for run in seeds]
        tags = {column: tag if isinstance(tag := seeds[-1].get(name), str) else "" for column, name in TAGS.items()}
        last = {**tags, "linked": kind == "chip" or system in linked, "cpu": ", ".join(sorted(set(group["cpu"])))}
        for unit in ways[0]:
            costs = pd.DataFrame([way[unit][0] for way in ways]).mean().reindex([*costs_of])
            rows.append({"system": system_of(seeds[-1]), "unit": unit, **costs, **last})
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
    first = rows_of(runs)[0]
    losses = np.empty((len(table), 0, subjects.shape[1]))
    if faults is not None:
        stressed = of_kinds(store, [STRESS]) if runs_of is None else runs_of
        losses = _losses(store, stressed.get(STRESS), first, table, [*subjects], faults, reactions)
    counts = [[part.reindex(subjects.columns) for part in each] for each in alarms]
    shape = (len(table), 2, subjects.shape[1]) if watched else (0, 2, 0)
    fixed = {name: table[name].to_numpy(float) for name in costs_of if name != "false_alarms"}
    people = People(subjects.to_numpy(float), losses, np.reshape(counts, shape).transpose(1, 0, 2), fixed)
    everyone = np.arange(subjects.shape[1])[None]
    table = table.assign(**{name: people.cost(name, everyone)[0] for name in ROBUST})
    if watched:
        table["false_alarms"] = people.cost("false_alarms", everyone)[0]
    mixed = any(facts_of(run).mixes_subjects for run in rows_of(runs))
    gestures = () if reactions.plain else _gestures(store, first)
    return Candidates(table, ", ".join(context_of(first)), subjects, people, behind, gestures, first, mixed, notes)


def _gestures(store: Store, run: Row) -> tuple[str, ...]:
    """All gestures of the captures or recordings of a run."""
    if run["touchbench.kind"] != WATCH:
        path = needed(store, run, "predictions.parquet")
        return tuple(classes_of(pd.DataFrame(columns=read_schema(path).names)))  # without the rows
    touches = pd.read_csv(needed(store, run, "touches.csv"), usecols=["gesture"])
    return tuple(sorted({*touches["gesture"].astype(str), str(run["watch.background"]) or BACKGROUND}))


def _losses(
    store: Store,
    runs: pd.DataFrame | None,
    context: Row,
    table: pd.DataFrame,
    subjects: list[str],
    faults: Faults,
    reactions: Reactions,
) -> np.ndarray:
    """Points that each candidate loses under each fault at each severity, float [candidates, circumstances, subjects].

    NaN where no complete stored run tests all circumstances, and for windows and early decisions. Seeds are
    averaged. Systems with captures of a new person are tested under faults without these captures.

    Args:
        store: store of the runs.
        runs: runs of ``bench stress``, None for none.
        context: a run of the candidates.
        table: candidates.
        subjects: names of the subjects.
        faults: the circumstances.
        reactions: reactions that are scored.
    """
    losses = np.full((len(table), len(faults.circumstances), len(subjects)), np.nan)
    if runs is None:
        return losses
    tested = runs["protocol_label"] == context["protocol_label"]
    if str(context["protocol"]).startswith("personal"):
        tested = runs["protocol_name"] == "loso"
    runs = runs[tested & complete_on(runs, context)]
    for system, group in runs.groupby(pd.Series([system_of(run) for run in rows_of(runs)], runs.index, dtype=object)):
        rows = (table["system"] == system) & table["unit"].str.match("capture$|in C, 32 bits$|" + IN_RECORDINGS)
        parts = [_lost(store, seeds, faults, reactions) for _, seeds in group.groupby("seed")] if rows.any() else []
        if known := [part.reindex(columns=subjects).to_numpy() for part in parts if part is not None]:
            losses[rows.to_numpy()] = np.mean(known, axis=0)
    return losses


def _lost(store: Store, runs: pd.DataFrame, faults: Faults, reactions: Reactions) -> pd.DataFrame | None:
    """Points lost [circumstances, subjects] in some runs of one system; None if a circumstance is not in any of them.

    These runs store labels, so the reaction is that to the most probable gesture, also of clean captures.
    """
    tested = [(run, {*str(run.get("faults", "")).split(", ")}) for run in rows_of(runs.sort_values("started"))]
    if not {*faults.names} <= {name for _, names in tested for name in names}:
        return None  # without reading any table
    lost: dict[tuple[str, int], pd.Series] = {}
    for run, names in tested:
        if not names & {*faults.names}:
            continue
        columns = ["fold", "capture", "subject", "true", "predicted", "train_subjects", "fault", "severity"]
        asked = [("fault", "in", [CLEAN, *faults.names]), ("severity", "<=", faults.severity)]
        rows = pd.read_parquet(needed(store, run, "stress.parquet"), columns=columns, filters=asked)
        rows = pd.concat([unharmed(rows), rows[rows["fault"].isin(faults.names)]], ignore_index=True)
        keys = [rows["fault"], rows["severity"], rows["subject"].astype(str)]
        costs = 100 * pd.Series(reactions.mistakes(rows)).groupby(keys).mean().unstack()
        for fault, severity in {*costs.index} & {*faults.circumstances}:
            lost[fault, severity] = costs.loc[(fault, severity)] - costs.loc[(CLEAN, 0)]
    if not {*faults.circumstances} <= {*lost}:
        return None
    return pd.DataFrame({key: lost[key] for key in faults.circumstances}).T


def complete_on(runs: pd.DataFrame, context: Row) -> pd.Series:
    """Which runs are complete and on the captures of another run, bool [runs]."""
    same = {name: context[name] for name in COMPARABLE if name != "protocol_label"}
    return (runs["status"] == "FINISHED") & (runs[[*same]] == pd.Series(same)).all(axis=1)


def missing(table: pd.DataFrame, costs: Collection[str], faults: Faults | None) -> dict[str, list[str]]:
    """Commands that measure what is not stored, by cost.

    Args:
        table: candidates.
        costs: costs that were asked for.
        faults: circumstances over which losses are taken.
    """
    commands: dict[str, list[str]] = {}
    for cost in costs:
        lacking = table[table[cost].isna() & table["unit"].str.match("capture$|" + IN_RECORDINGS)]
        texts = [text for text in lacking["arguments"] if text]
        if cost == "cycles":
            lines = [typed("chip", repeated(text)) for text in texts]
        elif faults is not None and "fault" in cost:
            lines = [
                typed("stress", repeated(text, impersonal=True) | {"faults": ",".join(faults.names)}) for text in texts
            ]
        else:
            lines = []
        if lines:
            commands[cost] = list(dict.fromkeys(lines))
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


def elsewhere(runs: pd.DataFrame, context: Row, table: pd.DataFrame, command: str, more: Row) -> list[str]:
    """Commands that would make candidates of systems which ``bench run`` has evaluated, leaving each subject out.

    Args:
        runs: runs of ``bench run``.
        context: a run of the candidates.
        table: candidates.
        command: command that makes candidates.
        more: its further arguments.
    """
    kept = complete_on(runs, context) & (runs["protocol_name"] == "loso")
    others = [run for run in rows_of(runs[kept]) if system_of(run) not in {*table["system"]}]
    given = [repeated(text) for run in others if isinstance(text := run.get("touchbench.arguments"), str) and text]
    return list(dict.fromkeys(typed(command, each | dict(more)) for each in given))


def eligible(
    tables: list[pd.DataFrame],
    asked: Mapping[str, list[str]],
    windows: bool = False,
    batch: bool = False,
    command: str = "run",
) -> tuple[pd.DataFrame, list[str]]:
    """The complete runs among which can be chosen, and which others are left out, in sentences.

    Args:
        tables: `bench.outcomes.runs.tracked` of some kinds.
        asked: names of ``data``, ``protocol``, ``where``, ``target``, ``model``, ``features`` to choose among, and
            number of ``shots``; parameters of the protocol by their dotted names; or values of `COMPARABLE`.
        windows: True for runs that decide on windows only.
        batch: True to include systems whose predictions depend on the other captures of the batch.
        command: command that makes such runs.

    Raises:
        NothingTracked: there is none.
        InputError: they are on several corpora or protocols.
    """
    runs = _asked(tables, asked)
    if windows:
        runs = runs[runs["windows"] > 0] if "windows" in runs else runs.iloc[:0]
    complete = runs[runs["status"] == "FINISHED"]
    notes: list[str] = []
    if len(complete) and "protocol_label" not in asked:
        complete, notes = _newest(complete)
    failed = runs[(runs["status"] != "FINISHED") & ~runs["system"].isin(complete["system"])]
    if len(complete):
        failed = failed.merge(complete[[*COMPARABLE]].drop_duplicates())
    if names := sorted(set(failed["system"])):
        notes.append(f"Left out because folds failed: {'; '.join(names)}. Repeat the command to run these folds again.")
    if BATCH in complete and not batch:
        dependent = complete[BATCH] == "true"
        if names := sorted(set(complete["system"][dependent])):
            complete = complete[~complete["system"].isin(names)]
            notes.append(
                "Left out because predictions depend on other test captures: "
                f"{'; '.join(names)}. To include these systems, give batch=yes."
            )
    if not len(complete):
        why = "".join(f". {note.removesuffix('.')}" for note in notes)
        raise NothingTracked(
            f"no complete run is stored for these values; make one with bench {command}, then choose{why}"
        )
    return complete, notes


def _asked(tables: list[pd.DataFrame], asked: Mapping[str, list[str]]) -> pd.DataFrame:
    """The runs of all kinds that were asked for; replays only from the onset, and no gesture left out of training.

    Raises:
        InputError: no run of any kind has a parameter that was asked for.
    """
    columns = {COLUMNS.get(key, key): key for key in asked}
    for column, key in columns.items():
        if column.startswith("protocol.") and not any(column in runs for runs in tables):
            raise InputError(f"{key}: no stored run has this parameter; leave it out or run that protocol")
    parts = []
    for runs in (table for table in tables if columns.keys() <= {*table.columns}):
        if "shots" in asked and "protocol.unlabelled" in runs:
            runs = runs[runs["protocol.unlabelled"] != "True"]
        plain = {"stream.start": ["onset"], "watch.unknown": [""]}
        wanted = {"target": ["gesture"], **asked} | {name: value for name, value in plain.items() if name in runs}
        parts.append(selected(runs, wanted))
    return pd.concat(parts, ignore_index=True) if parts else tables[0].iloc[:0]


def _newest(runs: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The runs on the captures and under the protocol of the newest run, and how many others are left out.

    Raises:
        InputError: arguments of `bench choose` can tell them apart.
    """
    arguments = list(dict.fromkeys(_arguments(runs)))
    if len(arguments) > 1:
        raise InputError(
            f"runs on different captures or protocols cannot be compared; name one of: {'; '.join(arguments[:4])}"
        )
    same = [*COMPARABLE, "protocol", *(["watch.background"] if "watch.background" in runs else [])]
    newest = runs.sort_values("started").iloc[-1]
    kept = (runs[same] == newest[same]).all(axis=1)
    notes = []
    if not kept.all():
        versions = ", ".join(dict.fromkeys(digest[:8] for digest in runs["corpus_digest"][~kept]))
        notes.append(
            f"Left out: {several(int((~kept).sum()), 'older run')} on other captures of {newest['data']} or under "
            f"another version of the protocol{', or with another background' * ('watch.background' in same)} "
            f"(corpus {versions})."
        )
    return runs[kept], notes


def _arguments(runs: pd.DataFrame) -> list[str]:
    """Arguments of `bench choose` that select the captures and the protocol of each run."""
    parameters = [str(name) for name in runs if str(name).startswith("protocol.")]
    values = runs.groupby("protocol_name")[parameters].nunique() if parameters else pd.DataFrame()
    texts = []
    for run in rows_of(runs):
        protocol = str(run["protocol"]).partition("[")[0]
        selecting = {"data": str(run["data"]), "where": str(run["subset"]), "protocol": protocol}
        selecting |= {"target": str(run["target"])} if run["target"] != "gesture" else {}
        differing = [p for p in parameters if values.loc[run["protocol_name"], p] > 1 and isinstance(run[p], str)]
        selecting |= {p: str(run[p]) for p in differing}
        texts.append(" ".join(f"{key}={quoted(value)}" for key, value in selecting.items()))
    return texts


def _linked(runs: pd.DataFrame) -> dict[str, dict[str, float]]:
    """By system, bytes as linked of its C in 32 bits, whose labels are its own: the counted ones leave code out."""
    if "chip.bits" not in runs:
        return {}
    in_32_bits = runs[(runs["touchbench.kind"] == "chip") & (runs["chip.bits"] == "32")]
    return {
        str(run["system"]): {f"{name}_bytes": run[f"chip_{name}_bytes"] for name in ("flash", "ram")}
        for run in rows_of(in_32_bits)
    }


def _ways(
    store: Store, run: Row, most: float | None, windows: bool, reactions: Reactions
) -> dict[str, tuple[dict[str, float], list[pd.Series]]]:
    """Costs, and the score by subject, in percent, of each way in which a run labels; arguments as of `candidates`.

    The time of a decision is the touch that it needs: computing time on this machine is another cost. Runs of
    ``bench watch`` also give false alarms and hours of background by subject.
    """
    path, kind = needed(store, run, "predictions.parquet"), run["touchbench.kind"]
    costs = {name: run.get(f"{name}_bytes", np.nan) / 1000 for name in ("flash", "ram")}
    if kind == WATCH:
        costs |= {
            "predict": run.get("predict_ms_p50", np.nan),
            "false_alarms": run.get("false_alarms_per_hour", np.nan),
        }
        costs |= {"latency": 1000 * run.get("latency_s_p50", np.nan)}
        shares = pd.read_csv(needed(store, run, "per_subject.csv"), dtype={"subject": str}).set_index("subject")
        if "background_s" not in shares:
            raise InputError(f"{run['system']}: an older version stored this run of bench watch; run it again")
        score, hours = 100 * shares["end_correct"].dropna(), shares["background_s"] / 3600
        if not reactions.plain:
            touches = pd.read_csv(needed(store, run, "touches.csv"), dtype={"subject": str}, keep_default_na=False)
            reactions.of(_gestures(store, run))  # refuses other names
            score = reactions.scores(touches.rename(columns={"gesture": "true", "label": "predicted"}))
        aim = float(run["watch.false_alarms"])
        unit = IN_RECORDINGS + ("" if aim == USUAL_AIM else f", false_alarms={aim:g}")
        return {unit: (costs, [score, (shares["false_alarms_per_hour"] * hours).fillna(0), hours])}
    if kind == "cell" and not windows:
        costs |= {"predict": run["predict_ms_p50"], "decision": run["capture_ms"]}
        # What the run stored is the same and quick: reading the predictions of 1000 runs takes a minute.
        stored = pd.Series(subject_accuracy(store, run), dtype=float) if reactions.plain else pd.Series(dtype=float)
        return {"capture": (costs, [stored if len(stored) else _score(pd.read_parquet(path), reactions)])}
    table = pd.read_parquet(path)
    if kind == "cell":
        costs |= {"predict": run["decide_ms_p50"], "decision": run["observed_ms"]}
        return {"window": (costs, [reactions.scores(by_decision(table, reactions))])}
    if kind == "chip":
        costs = {name: run[f"chip_{name}_bytes"] / 1000 for name in ("flash", "ram")}
        costs |= {"cycles": run["chip_most_instructions"] / 1000, "decision": run["capture_ms"]}
        return {f"in C, {run['chip.bits']} bits": (costs, [_score(table, reactions)])}
    costs |= {"predict": run["decide_ms_p50"]}
    instants = pd.read_csv(needed(store, run, "instants.csv"))["ms"].tolist()
    decided = [*zip(instants, np.sort(table["instant"].unique()), strict=True)]  # ms, frames
    if most is not None and np.isfinite(most):  # the last that is soon enough, else the first
        decided = [one for one in decided if within(one[0], most)][-1:] or decided[:1]
    return {
        f"first {ms:.0f} ms": (
            costs | {"decision": ms},
            [reactions.scores(by_decision(standing(table, frames), reactions))],
        )
        for ms, frames in decided
    }


def _score(predictions: pd.DataFrame, reactions: Reactions) -> pd.Series:
    """Score in percent by subject, of whole captures."""
    return reactions.scores(by_capture(predictions, reactions))
