"""The choice of a system: the cheapest within one standard error of the best one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from bench.arguments import quoted
from bench.costs import COSTS, WATCHED
from bench.errors import InputError
from bench.outcomes import scores
from bench.outcomes.comparable import BATCH, COMPARABLE, CONDITIONS, Row, context_of, facts_of, system_of
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
from bench.outcomes.stopping import standing
from bench.outcomes.store import Store
from bench.paired import FEW_SUBJECTS, TOLERANCE, mean_and_error, within_one_standard_error

Amount = TypeVar("Amount", float, pd.Series)
KINDS = ("cell", "chip", "stream")  # of runs whose systems are candidates
WATCH = "watch"  # kind of run whose systems are candidates for budgets of `WATCHED`
IN_RECORDINGS = "touches in recordings"  # unit of their accuracy
USUAL_AIM = 5.0  # false alarms per hour that bench watch learns for by default
TAGS = {  # columns of a candidate that repeat a tag of its last run
    "kind": "touchbench.kind",
    "command": "touchbench.command",
    "arguments": "touchbench.arguments",
    "conditions": CONDITIONS,
}
WORDS = {  # an amount of a cost
    "flash": "of flash",
    "ram": "of RAM",
    "predict": "of computing time",
    "decision": "until the decision",
    "cycles": "instructions",
}
NOUNS = {"flash": "flash", "ram": "RAM", "predict": "computing time", "decision": "decision time"}
NOUNS |= {"cycles": "instruction count", "false_alarms": "false-alarm rate", "latency": "latency"}
UNKNOWN = {  # why a cost is not known
    "flash": "their size cannot be counted",
    "ram": "their memory cannot be counted",
    "predict": "no timing is available for exported C",
    "decision": "it was not measured",
    "cycles": "only bench chip counts them",
    "false_alarms": "the recordings have no background",
    "latency": "no touch was found",
}
ALL_COSTS = COSTS | WATCHED


@dataclass(frozen=True)
class Candidates:
    """The candidates of a store, on the same captures under the same protocol.

    Attributes:
        table: one row per candidate (``system``, ``unit``, ``accuracy`` in percent as a mean over subjects, ``flash``
            and ``ram`` in kB, ``predict`` and ``decision`` in ms, ``cycles`` in thousands of instructions, ``linked``,
            True for linked bytes, with code, ``cpu`` and the keys of `TAGS`; NaN for unknown costs).
        context: captures and protocol, in words.
        subjects: accuracies in percent [candidates, subjects].
        mixed: True if training and test captures share subjects.
        notes: excluded runs with reasons, in sentences.
    """

    table: pd.DataFrame
    context: str
    subjects: pd.DataFrame
    mixed: bool
    notes: list[str]


@dataclass(frozen=True)
class Budget:
    """The effect of one budget on the candidates.

    Attributes:
        cost: name of the cost.
        most: largest allowed value.
        over: number of candidates that need more.
        unknown: number of candidates with unknown cost.
        least: index of the candidate that needs least, None if no cost is measured.
        without: index of the best one that fits all the other budgets, None if none does.
        gain: accuracy of that candidate minus that of the best one that fits all budgets, mean over subjects in points;
            NaN if none does.
        error: the standard error of that.
    """

    cost: str
    most: float
    over: int
    unknown: int
    least: int | None
    without: int | None
    gain: float
    error: float


@dataclass(frozen=True)
class Choice:
    """The result of a choice.

    Attributes:
        table: candidates with ``loss`` (mean over subjects of best minus own accuracy, in points), ``error`` (its
            standard error) and ``verdict``, cheapest first; those with unknown cost come last.
        chosen: index in it, None if no candidate fits the budgets.
        best: index of the most accurate one that fits them.
        costlier: index of the next costlier one that fits them and is more accurate than the chosen, None if there is
            none.
        unranked: indices of those that fit the budgets but have an unknown cost, most accurate first.
        budgets: effect of each budget.
    """

    table: pd.DataFrame
    chosen: int | None
    best: int | None
    costlier: int | None
    unranked: list[int] = field(default_factory=list)
    budgets: list[Budget] = field(default_factory=list)


def candidates(
    store: Store,
    asked: Mapping[str, list[str]],
    most: float | None = None,
    *,
    windows: bool = False,
    clock: float | None = None,
    batch: bool = False,
    watched: bool = False,
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
        runs_of: `bench.outcomes.runs.tracked` by kind, if already read.

    Raises:
        NothingTracked: no complete run is tracked for these values.
        InputError: runs on several corpora or protocols are, or a table of one is gone.
    """
    kinds = ["cell"] if windows else [kind for kind in KINDS if kind != "stream" or most is not None]
    kinds, costs_of = ([WATCH], ALL_COSTS) if watched else (kinds, COSTS)
    tables = of_kinds(store, kinds) if runs_of is None else {kind: runs_of[kind] for kind in kinds if kind in runs_of}
    if not tables:
        tracked(store, kinds[0])  # which says so
    runs, notes = eligible([*tables.values()], asked, windows, batch, "watch" if watched else "run")
    linked = _linked(runs)
    options = runs.reindex(columns=["stream.hop_ms", "chip.bits", "watch.false_alarms"]).fillna("")
    same = [runs["system"], runs["touchbench.kind"], *(options[name] for name in options)]
    rows, accuracies = [], []
    for (system, kind, *_), group in runs.groupby(same, sort=True):
        seeds = [{**run, **linked.get(str(system), {})} for run in rows_of(group)]
        ways = [_ways(store, run, most, windows) for run in seeds]
        tags = {column: tag if isinstance(tag := seeds[-1].get(name), str) else "" for column, name in TAGS.items()}
        last = {**tags, "linked": kind == "chip" or system in linked, "cpu": ", ".join(sorted(set(group["cpu"])))}
        for unit in ways[0]:
            costs = pd.DataFrame([way[unit][0] for way in ways]).mean().reindex([*costs_of])
            rows.append({"system": system_of(seeds[-1]), "unit": unit, **costs, **last})
            accuracies.append(pd.concat([way[unit][1] for way in ways], axis=1).mean(axis=1))
    subjects = pd.DataFrame(accuracies).reset_index(drop=True)
    table = pd.DataFrame(rows).assign(accuracy=subjects.mean(axis=1))
    if clock is not None:
        table["decision"] += (table["cycles"] / clock).fillna(0)  # thousands by MHz: ms
    mixed = any(facts_of(run).mixes_subjects for run in rows_of(runs))
    return Candidates(table, ", ".join(context_of(rows_of(runs)[0])), subjects, mixed, notes)


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


def _ways(store: Store, run: Row, most: float | None, windows: bool) -> dict[str, tuple[dict[str, float], pd.Series]]:
    """Costs and accuracy by subject, in percent, of each way in which a run labels; arguments as of `candidates`.

    The time of a decision is the touch that it needs: computing time on this machine is another cost.
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
        aim = float(run["watch.false_alarms"])
        unit = IN_RECORDINGS + ("" if aim == USUAL_AIM else f", false_alarms={aim:g}")
        return {unit: (costs, 100 * shares["end_correct"].dropna())}
    if kind == "cell" and not windows:
        costs |= {"predict": run["predict_ms_p50"], "decision": run["capture_ms"]}
        accuracy = pd.Series(subject_accuracy(store, run))  # reading the predictions of 1000 runs takes a minute
        return {"capture": (costs, accuracy if len(accuracy) else _percents(scores.captures(pd.read_parquet(path))))}
    table = pd.read_parquet(path)
    if kind == "cell":
        costs |= {"predict": run["decide_ms_p50"], "decision": run["observed_ms"]}
        return {"window": (costs, _percents(scores.windows(table)))}
    if kind == "chip":
        costs = {name: run[f"chip_{name}_bytes"] / 1000 for name in ("flash", "ram")}
        costs |= {"cycles": run["chip_most_instructions"] / 1000, "decision": run["capture_ms"]}
        return {f"in C, {run['chip.bits']} bits": (costs, _percents(scores.captures(table)))}
    costs |= {"predict": run["decide_ms_p50"]}
    instants = pd.read_csv(needed(store, run, "instants.csv"))["ms"].tolist()
    decided = [*zip(instants, np.sort(table["instant"].unique()), strict=True)]  # ms, frames
    if most is not None and np.isfinite(most):  # the last that is soon enough, else the first
        decided = [one for one in decided if _within(one[0], most)][-1:] or decided[:1]
    return {
        f"first {ms:.0f} ms": (costs | {"decision": ms}, _percents(standing(table, frames))) for ms, frames in decided
    }


def _percents(labelled: pd.DataFrame) -> pd.Series:
    """Accuracy in percent by subject."""
    return scores.per_subject(labelled).set_index("subject")["accuracy"].rename(index=str) * 100


def decide(
    table: pd.DataFrame, subjects: pd.DataFrame, by: str, budgets: dict[str, float], margin: float | None
) -> Choice:
    """Take the cheapest candidate whose accuracy is not below that of the best.

    Not below means: the mean over subjects of the difference is at most its standard error; or, with a margin, a
    one-sided paired t-test finds it smaller than the margin (p < 0.05). The best one is sought among those that fit the
    budgets; a candidate whose cost is not known fits no budget of it. One whose cost ``by`` is not known cannot be the
    cheapest, so neither chosen nor the best is such a one; its loss is told.

    Args:
        table: candidates with ``accuracy`` and a column per cost, as `candidates` gives them.
        subjects: accuracies in percent [candidates, subjects].
        by: the cost that is to be low.
        budgets: the most of each cost.
        margin: points of accuracy that do not matter, or None for the rule of one standard error.
    """
    accuracy = table["accuracy"].round(9)  # equal sums in another order are ties
    verdicts = [_excess(row, budgets) for row in rows_of(table)]
    table = table.assign(verdict=verdicts, loss=np.nan, error=np.nan, accuracy=accuracy)
    fits = table[table["verdict"] == ""]
    unranked = [int(i) for i in fits[fits[by].isna()].sort_values("accuracy", ascending=False).index]
    best = _best(table, by, budgets)
    limits = [_limit(table, subjects, by, budgets, cost, best) for cost in budgets]
    if best is None:
        table.loc[unranked, "verdict"] = f"{by} unknown"
        return Choice(table.sort_values(by), None, None, None, unranked, limits)
    near = []
    for i in fits.index:
        losses = (subjects.loc[best] - subjects.loc[i]).to_numpy()
        table.loc[i, ["loss", "error"]] = mean_and_error(losses)
        if i == best or _not_below(losses, margin):
            near.append(i)
    table = table.sort_values([by, "accuracy"], ascending=[True, False])
    ranked = [i for i in table.index if i in fits.index and i not in unranked]
    chosen = next(i for i in ranked if i in near)
    dearer = [i for i in ranked if table[by][i] > table[by][chosen]]
    for i in fits.index:
        verdict = "the best" if i == best else "near the best" if i in near else "below the best"
        if i in unranked:
            verdict += f", {by} unknown"
        elif i in near:
            verdict += ", costlier" if i in dearer else ", equally cheap"
        table.loc[i, "verdict"] = "chosen" if i == chosen else verdict
    costlier = next((i for i in dearer if accuracy[i] > accuracy[chosen]), None)
    return Choice(table, chosen, best, costlier, unranked, limits)


def _excess(row: Row, budgets: Mapping[str, float]) -> str:
    """By which budgets a candidate is ruled out; empty for none."""
    over = [
        f"{cost.replace('_', ' ')} {' > '.join(apart(cost, row[cost], most))}"
        if np.isfinite(row[cost])
        else f"{cost.replace('_', ' ')} unknown"
        for cost, most in budgets.items()
        if not _within(row[cost], most)
    ]
    return "ruled out: " + ", ".join(over) if over else ""


def _within(cost: Amount, most: float) -> Amount:
    """Whether a cost is within its budget: not where it is NaN, and rounding is no excess."""
    return cost <= most * (1 + TOLERANCE)


def _best(table: pd.DataFrame, by: str, budgets: Mapping[str, float]) -> int | None:
    """The most accurate one that fits and whose cost is known; of equal ones the cheapest."""
    within = np.ones(len(table), dtype=bool)
    for cost, most in budgets.items():
        within &= _within(table[cost], most).to_numpy()
    ranked = table[within].dropna(subset=[by]).sort_values(by)
    return int(ranked.index[int(ranked["accuracy"].round(9).argmax())]) if len(ranked) else None


def _limit(
    table: pd.DataFrame, subjects: pd.DataFrame, by: str, budgets: dict[str, float], cost: str, best: int | None
) -> Budget:
    """What one of the budgets does."""
    most, amounts = budgets[cost], table[cost].dropna()
    least = int(amounts.index[int(amounts.argmin())]) if len(amounts) else None
    without = _best(table, by, {k: v for k, v in budgets.items() if k != cost})
    gain = error = np.nan
    if best is not None and without is not None:
        gain, error = mean_and_error((subjects.loc[without] - subjects.loc[best]).to_numpy())
    over = int((~_within(amounts, most)).sum())
    return Budget(cost, most, over, len(table) - len(amounts), least, without, gain, error)


def _not_below(losses: np.ndarray, margin: float | None) -> bool:
    if margin is None:
        return within_one_standard_error(losses)
    if len(losses) < 2:
        return False
    if not losses.std():
        return bool(losses.mean() < margin)
    from scipy.stats import ttest_1samp  # heavy

    return bool(ttest_1samp(losses, margin, alternative="less").pvalue < 0.05)


def amount(cost: str, value: float) -> str:
    """A cost with its unit, as people read it."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.3g} {ALL_COSTS[cost]}" if value < 100 else f"{value:.0f} {ALL_COSTS[cost]}"


def apart(cost: str, one: float, other: float) -> tuple[str, str]:
    """Two amounts of a cost with enough digits to differ."""
    texts = amount(cost, one), amount(cost, other)
    digits = 4
    while texts[0] == texts[1] and one != other and digits < 17:
        texts = f"{one:.{digits}g} {ALL_COSTS[cost]}", f"{other:.{digits}g} {ALL_COSTS[cost]}"
        digits += 1
    return texts


def points(mean: float, error: float) -> str:
    """A difference in points with its standard error, which a single subject does not have."""
    text = f"{mean:.1f}" if round(mean, 1) or abs(mean) < 1e-9 else f"{mean:.1g}"
    return text if np.isnan(error) else f"{text} ± {error:.1f}"


def named(row: Mapping[Any, Any]) -> str:
    """A candidate: the system, and in brackets its unit unless that is whole captures."""
    unit = "one window" if row["unit"] == "window" else row["unit"]
    return str(row["system"]) + ("" if unit == "capture" else f" ({unit})")


def sentences(choice: Choice, by: str, margin: float | None, subjects: int, mixed: bool = False) -> list[str]:
    """The choice, its reason, the cost of the next better system and of each budget, and its scope.

    Args:
        choice: result of `decide`.
        by: the cost that is to be low.
        margin: points of accuracy that do not matter, or None.
        subjects: number of them.
        mixed: True if training and test captures share subjects.
    """
    rows = dict(zip(choice.table.index, rows_of(choice.table), strict=True))
    limits = [_limited(limit, rows, choice.best) for limit in choice.budgets]
    if choice.chosen is None or choice.best is None:
        if choice.unranked:
            return [
                f"Nothing can be chosen: the {NOUNS[by]} of every system that fits is unknown ({UNKNOWN[by]}).",
                *limits,
            ]
        return ["Nothing fits the budgets.", *limits]
    chosen, best = rows[choice.chosen], rows[choice.best]
    lines = [f"Choose {named(chosen)}: {chosen['accuracy']:.1f} % with {amount(by, chosen[by])} {WORDS[by]}."]
    fits = "that fits" + (f" and has a known {NOUNS[by]}" if choice.unranked else "")
    near, none_near, proof = "within one standard error of", "is within one standard error", ""
    if margin is not None:
        near, none_near = (f"{word} less than {margin:g} points" for word in ("that loses", "is shown to lose"))
        near, none_near, proof = f"{near} to", f"{none_near} (p < 0.05)", ", p < 0.05"
    if choice.chosen == choice.best or subjects < 2:
        cheaper = f", and no cheaper one {none_near}" if subjects > 1 else ""
        lines.append(f"No system {fits} is more accurate{cheaper}.")
    else:
        of_best = named(best).replace(" (", ", ").removesuffix(")") + f", {best['accuracy']:.1f} %"
        lines += [
            f"It is the cheapest system {near} the best one {fits} ({of_best}{proof}).",
            f"It loses {points(chosen['loss'], chosen['error'])} points (mean ± standard error over {subjects} "
            "subjects).",
        ]
    if choice.costlier is not None:
        better = rows[choice.costlier]
        more, less = apart(by, better[by], chosen[by])
        gain = points(better["accuracy"] - chosen["accuracy"], np.nan)
        lines.append(
            f"The next better system, {named(better)}, gains {gain} points but needs {more} {WORDS[by]} instead of "
            f"{less}."
        )
    if choice.unranked:
        first = rows[choice.unranked[0]]
        lines.append(
            f"{several(len(choice.unranked), 'system')} cannot be chosen, because the {NOUNS[by]} is unknown "
            f"({UNKNOWN[by]}). The most accurate of these is {named(first)}, {first['accuracy']:.1f} %."
        )
    lines += limits
    if subjects < FEW_SUBJECTS:
        alone = ", so there is no standard error" if subjects == 1 else ""
        lines.append(f"Only {several(subjects, 'subject')}{alone}: the order may differ for other people.")
    if mixed:
        lines.append("Training and test captures come from the same subjects: expect lower accuracy for a new person.")
    return lines


def _limited(limit: Budget, rows: Mapping[int, Row], best: int | None) -> str:
    """What a budget costs, or where nothing fits, how far the systems are from it."""
    cost, count = limit.cost, limit.over + limit.unknown
    head = f"The budget of {amount(cost, limit.most)} for {NOUNS[cost]}"
    unknown = f" ({limit.unknown} with unknown {NOUNS[cost]}: {UNKNOWN[cost]})" if limit.unknown else ""
    without = "no system fits either"
    if limit.without is not None:
        row = rows[limit.without]
        without = f"the best system that fits is {named(row)}, {row['accuracy']:.1f} %"
    if best is not None:
        price = f"costs {points(limit.gain, limit.error)} points: without it, {without}."
        if limit.without == best:
            price = "costs nothing: without it, the best system is the same."
        return f"{head} {price}" + (f" It rules out {several(count, 'system')}{unknown}." if unknown else "")
    if not count:
        return f"{head} rules out no system."
    lines = [f"{head} rules out {count} of {several(len(rows), 'system')}{unknown}."]
    if limit.least is not None:
        row = rows[limit.least]
        lines.append(f"The lowest {NOUNS[cost]} is {apart(cost, row[cost], limit.most)[0]} ({named(row)}).")
    return " ".join([*lines, f"Without this budget, {without}."])


def several(number: int, noun: str) -> str:
    """A number with its noun, in the plural unless it is 1."""
    return f"{number} {noun}{'s' if number != 1 else ''}"
