"""Which system to take: the cheapest that is within one standard error of the best one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy.stats import ttest_1samp

from bench.errors import InputError
from bench.outcomes import scores
from bench.outcomes.comparable import COMPARABLE, Row, context_of
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
from bench.paired import mean_and_error, within_one_standard_error
from bench.plan.arguments import labelled, quoted
from bench.quantities import COSTS

SAID = {"capture": "whole captures", "window": "one window"}
FEW_SUBJECTS = 6  # with five, no sign test can reach p < 0.05
ORIGIN = {
    "kind": "touchbench.kind",
    "digest": "corpus_digest",
    "command": "touchbench.command",
    "arguments": "touchbench.arguments",
}
UNKNOWN = {  # why a cost is not known
    "flash": "their runs are older than its count",
    "ram": "their runs are older than its count",
    "predict": "C is not timed",
    "decision": "C is not timed",
    "cycles": "only bench chip counts them",
}


@dataclass(frozen=True)
class Budget:
    """What one budget does to the candidates.

    Attributes:
        cost: that it is for.
        most: of it.
        over: candidates that need more.
        unknown: candidates of which nobody knows whether they do.
        least: index of the candidate that needs least, None if it is known of none.
        without: index of the best one that fits all the other budgets, None if none does.
        gain: its accuracy minus that of the best one that fits all budgets, mean over subjects in points; NaN if none
            does.
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
    """What was chosen among candidates.

    Attributes:
        table: the candidates with ``loss`` (mean over subjects of best minus own accuracy, in points), ``error`` (its
            standard error) and ``verdict``, cheapest first; those whose cost is not known stand last.
        chosen: index in it, None if no candidate fits the budgets.
        best: index of the most accurate one that fits them.
        costlier: index of the next costlier one that fits them and is more accurate than the chosen, None if there is
            none.
        unranked: indices of those that fit the budgets and whose cost is not known, most accurate first.
        budgets: what each of them does.
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
    replays: bool = False,
    runs_of: Mapping[str, pd.DataFrame] | None = None,
    windows: bool = False,
) -> tuple[pd.DataFrame, str, pd.DataFrame]:
    """Every way in which a tracked system labels captures, or windows of them: percents of the two are not compared.

    What ``bench chip`` has exported labels as C, with bytes and instructions that were measured. Systems that ``bench
    stream`` has replayed are there, too, if they are asked for: deciding on as much of the beginning of a capture as a
    budget of time allows, or at every instant. Seeds of a system are averaged.

    Args:
        store: where the runs are.
        asked: names of ``data``, ``protocol``, ``where``, ``target``, ``model``, ``features`` to choose among, and
            ``shots`` that are known of a new person; parameters of the protocol by their dotted names; or values of
            `COMPARABLE`.
        most: milliseconds until a decision is out.
        replays: whether replayed systems are candidates; they are with ``most``.
        runs_of: `bench.outcomes.runs.tracked` by kind, where somebody has read it.
        windows: label single windows, in percent of windows, of the systems that decide on such.

    Returns:
        One row per candidate (``system``, ``unit``, ``accuracy`` in percent as a mean over subjects, ``flash`` and
        ``ram`` in kB, ``predict`` and ``decision`` in ms, ``cycles`` in thousands of instructions, ``linked``, whether
        its bytes are as linked, with code, ``windows``, whether it decides on windows, ``cpu`` and the keys of
        `ORIGIN`; NaN where a cost is not known); what they are all on, in words; and accuracies in percent
        [candidates, subjects].

    Raises:
        NothingTracked: no complete run is tracked for these values.
        InputError: runs on several corpora or protocols are, or a table of one is gone.
    """
    read = ["cell"] if windows else ["cell", "chip", *(["stream"] if most is not None or replays else [])]
    runs_of = of_kinds(store, read) if runs_of is None else runs_of
    found = [_asked(runs_of[kind], asked) for kind in read if kind in runs_of]
    if not found:
        tracked(store)  # which says so
    runs = pd.concat(found, ignore_index=True)
    if windows:
        runs = runs[_windowed(runs)]
    linked = _linked(runs)
    named = [] if "protocol_label" in asked else ["protocol"]  # parameters that change nothing are not in the label
    kinds = runs[[*COMPARABLE, *named]].drop_duplicates()
    if not len(kinds):
        raise NothingTracked("no complete run is tracked for these values; make some with bench run, then choose")
    if len(kinds) > 1:
        told = dict.fromkeys(_on(k) for k in rows_of(kinds))
        raise InputError(f"runs on different captures cannot be compared; name one of: {'; '.join([*told][:4])}")
    rows, accuracy = [], []
    options = runs.reindex(columns=["stream.hop_ms", "chip.bits"]).fillna("")
    for (system, *_), group in runs.groupby(
        [runs["system"], runs["touchbench.kind"], *(options[name] for name in options)], sort=True
    ):
        within = None if most is None else most - group["decide_ms_p50"].max()  # one instant for all seeds
        is_c = group["touchbench.kind"].iloc[0] == "chip"
        if not is_c:
            group = group.assign(**linked.get(str(system), {}))
        each = [_units(store, run, within, windows) for run in rows_of(group)]
        for unit in each[0]:
            costs = pd.DataFrame([units[unit][0] for units in each]).mean().reindex([*COSTS])
            about = {"linked": is_c or system in linked, "windows": _windowed(group).any()}
            rows.append({"system": system, "unit": unit, **costs, **about, **_origin(group)})
            accuracy.append(pd.concat([units[unit][1] for units in each], axis=1).mean(axis=1))
    subjects = pd.DataFrame(accuracy).reset_index(drop=True)
    table = pd.DataFrame(rows).assign(accuracy=subjects.mean(axis=1))
    return table, ", ".join(context_of(rows_of(runs)[0])), subjects


def _windowed(runs: pd.DataFrame) -> pd.Series:
    """Whether each run decided on windows."""
    return runs["windows"] > 0 if "windows" in runs else pd.Series(False, runs.index)


def _on(run: Row) -> str:
    """What tells captures and protocol of a run from others, as `bench choose` takes it."""
    asked = {"data": str(run["data"]), "where": str(run["subset"])} | labelled("protocol", str(run["protocol"]))
    asked |= {"target": str(run["target"])} if run["target"] != "gesture" else {}
    return " ".join(f"{key}={quoted(value)}" for key, value in asked.items())


def _origin(group: pd.DataFrame) -> dict[str, str]:
    """Where a candidate comes from: processors, kind of run, captures, command and arguments of its last run."""
    tags = group.reindex(columns=[*ORIGIN.values()]).fillna("").iloc[-1]
    return {"cpu": ", ".join(sorted(set(group["cpu"])))} | {name: str(tags[tag]) for name, tag in ORIGIN.items()}


def _linked(runs: pd.DataFrame) -> dict[str, dict[str, float]]:
    """By system, bytes as linked of its C in 32 bits, whose labels are its own: the counted ones leave code out."""
    if "chip.bits" not in runs:
        return {}
    whole = runs[(runs["touchbench.kind"] == "chip") & (runs["chip.bits"] == "32")]
    return {
        str(run["system"]): {f"{name}_bytes": run[f"chip_{name}_bytes"] for name in ("flash", "ram")}
        for run in rows_of(whole)
    }


def _asked(runs: pd.DataFrame, asked: Mapping[str, list[str]]) -> pd.DataFrame:
    """The complete runs among some that were asked for; replays only from the onset."""
    runs = runs[runs["status"] == "FINISHED"]
    keys = {key: COLUMNS.get(key, key) for key in asked}
    if lacking := [key for key, column in keys.items() if column.startswith("protocol.") and column not in runs]:
        raise InputError(f"{lacking[0]}: no run of a protocol that has it is tracked")
    if "shots" in asked:
        runs = runs[runs["protocol.unlabelled"] != "True"]
    wanted = {"target": ["gesture"], **asked} | ({"stream.start": ["onset"]} if "stream.start" in runs else {})
    return selected(runs, wanted)


def _units(
    store: Store, run: Row, within: float | None, windows: bool
) -> dict[str, tuple[dict[str, float], pd.Series]]:
    """Costs and accuracy by subject, in percent, of each way in which a run labels.

    A replayed one labels at the last instant within so many ms, or at each.
    """

    def of(labelled: pd.DataFrame) -> pd.Series:
        own = scores.per_subject(labelled).set_index("subject")["accuracy"]
        return own.rename(index=str) * 100

    size = {name: run.get(f"{name}_bytes", np.nan) / 1000 for name in ("flash", "ram")}
    path, kind = needed(store, run, "predictions.parquet"), run["touchbench.kind"]
    if kind == "cell" and not windows and (told := subject_accuracy(store, run)):
        return {"capture": (_whole(run, size), pd.Series(told))}  # reading the predictions of 1000 runs takes a minute
    table = pd.read_parquet(path)
    if kind == "chip":
        cost = {name: run[f"chip_{name}_bytes"] / 1000 for name in ("flash", "ram")}
        cost["cycles"] = run["chip_most_instructions"] / 1000
        return {f"in C, {run['chip.bits']} bits": (cost, of(scores.captures(table)))}
    if kind == "stream":
        instants = pd.read_csv(needed(store, run, "instants.csv"))["ms"]
        seen = np.sort(table["instant"].unique())  # frames
        soon = instants.index if within is None else instants.index[instants <= within][-1:]
        chosen = soon if len(soon) else instants.index[:1]  # which says how far it is from soon enough
        cost = size | {"predict": run["decide_ms_p50"]}
        return {
            f"first {instants[i]:.0f} ms": (
                cost | {"decision": instants[i] + run["decide_ms_p50"]},
                of(standing(table, seen[i])),
            )
            for i in chosen
        }
    if windows:
        costs = size | {"predict": run["decide_ms_p50"], "decision": run["decision_ms"]}
        return {"window": (costs, of(scores.windows(table)))}
    return {"capture": (_whole(run, size), of(scores.captures(table)))}


def _whole(run: Row, size: dict[str, float]) -> dict[str, float]:
    """Costs of labelling whole captures."""
    return size | {"predict": run["predict_ms_p50"], "decision": run["capture_decision_ms"]}


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
    verdicts = []
    for row in table.to_dict("records"):
        over = [k for k, most in budgets.items() if not row[k] <= most]
        said = [
            f"{k} {amount(k, row[k])} > {amount(k, budgets[k])}" if np.isfinite(row[k]) else f"{k} not known"
            for k in over
        ]
        verdicts.append("ruled out: " + ", ".join(said) if said else "")
    table = table.assign(verdict=verdicts, loss=np.nan, error=np.nan)
    fits = table.index[table["verdict"] == ""]
    unknown = table.loc[fits][table.loc[fits, by].isna()].sort_values("accuracy", ascending=False)
    unranked = [int(i) for i in unknown.index]
    best = _best(table, by, budgets)
    limits = [_limit(table, subjects, by, budgets, cost, best) for cost in budgets]
    if best is None:
        table.loc[unranked, "verdict"] = f"{by} not known"
        return Choice(table.sort_values(by), None, None, None, unranked, limits)
    near = []
    for i in fits:
        lost = (subjects.loc[best] - subjects.loc[i]).to_numpy()
        table.loc[i, ["loss", "error"]] = mean_and_error(lost)
        if i == best or _not_below(lost, margin):
            near.append(i)
    order = table.sort_values([by, "accuracy"], ascending=[True, False]).index
    chosen = next(i for i in order if i in near and i not in unranked)
    for i in fits:
        if i in unranked:
            verdict = f"{'as good' if i in near else 'below the best'}, {by} not known"
        elif i == chosen:
            verdict = "chosen"
        else:
            verdict = "as good, costlier" if i in near else "below the best"
        table.loc[i, "verdict"] = verdict
    more = [i for i in order if i in fits and table[by][i] > table[by][chosen]]
    costlier = next((i for i in more if table["accuracy"][i] > table["accuracy"][chosen]), None)
    return Choice(table.loc[order], chosen, best, costlier, unranked, limits)


def fitting(table: pd.DataFrame, budgets: Mapping[str, float]) -> pd.DataFrame:
    """The candidates that are known to fit all budgets."""
    within = [table[cost] <= most for cost, most in budgets.items()]
    return table[np.logical_and.reduce(within)] if within else table


def _best(table: pd.DataFrame, by: str, budgets: Mapping[str, float]) -> int | None:
    """The most accurate one that fits and whose cost is known; of equal ones the cheapest."""
    ranked = fitting(table, budgets).dropna(subset=[by]).sort_values(by)
    return int(ranked.index[int(ranked["accuracy"].argmax())]) if len(ranked) else None


def _limit(
    table: pd.DataFrame, subjects: pd.DataFrame, by: str, budgets: dict[str, float], cost: str, best: int | None
) -> Budget:
    """What one of the budgets does."""
    most, needed = budgets[cost], table[cost].dropna()
    without = _best(table, by, {k: v for k, v in budgets.items() if k != cost})
    gain = error = np.nan
    if best is not None and without is not None:
        gain, error = mean_and_error((subjects.loc[without] - subjects.loc[best]).to_numpy())
    return Budget(
        cost,
        most,
        int((needed > most).sum()),
        int(table[cost].isna().sum()),
        int(needed.index[int(needed.argmin())]) if len(needed) else None,
        without,
        gain,
        error,
    )


def _not_below(losses: np.ndarray, margin: float | None) -> bool:
    if margin is None:
        return within_one_standard_error(losses)
    if len(losses) < 2:
        return False
    if not losses.std():
        return bool(losses.mean() < margin)
    return bool(ttest_1samp(losses, margin, alternative="less").pvalue < 0.05)


def amount(cost: str, value: float) -> str:
    """A cost with its unit, as people read it."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.3g} {COSTS[cost]}" if value < 100 else f"{value:.0f} {COSTS[cost]}"


def sentences(choice: Choice, by: str, margin: float | None, subjects: int) -> list[str]:
    """The choice, its reason, what the next costlier system would buy, and what each budget costs."""
    rows = dict(zip(choice.table.index, rows_of(choice.table), strict=True))
    limits = [_limited(limit, rows, choice.best) for limit in choice.budgets]
    if choice.chosen is None:
        if choice.unranked:
            return [f"Nothing can be chosen: {by} is known of no candidate that fits ({UNKNOWN[by]}).", *limits]
        return ["Nothing fits: every candidate is ruled out by a budget.", *limits]
    own, best = rows[choice.chosen], rows[choice.best]
    rule = "one standard error of the paired difference" if margin is None else f"{margin:g} points (p < 0.05)"
    said = [f"Choose {_named(own)}: {own['accuracy']:.1f} % with {by} {amount(by, own[by])}."]
    if choice.chosen == choice.best:
        said.append("Of those that fit, none is more accurate, and no cheaper one comes within " + rule + ".")
    else:
        said.append(
            f"It is the cheapest that is not below the best that fits, {_named(best)} ({best['accuracy']:.1f} %), by "
            f"more than {rule}: {own['loss']:.1f} ± {own['error']:.1f} points over {subjects} subjects."
        )
    if choice.costlier is not None:
        next_one = rows[choice.costlier]
        said.append(
            f"The next costlier one that is more accurate, {_named(next_one)}, would buy "
            f"{next_one['accuracy'] - own['accuracy']:.1f} points for {by} {amount(by, next_one[by])} in place of "
            f"{amount(by, own[by])}."
        )
    if choice.unranked:
        first = rows[choice.unranked[0]]
        said.append(
            f"Candidates whose {by} is not known ({UNKNOWN[by]}), which cannot be the cheapest: "
            f"{len(choice.unranked)}; the most accurate of them is {_named(first)}, {first['accuracy']:.1f} %."
        )
    said += limits
    if subjects < FEW_SUBJECTS:
        said.append(f"Only {subjects} subjects: this says little about the next person.")
    return said


def _limited(limit: Budget, rows: dict[int, Row], best: int | None) -> str:
    """What a budget costs, or where nothing fits, how far the candidates are from it."""
    cost, count = limit.cost, limit.over + limit.unknown
    said = f"{cost} at most {amount(cost, limit.most)}"
    unknown = f"of {limit.unknown} it is not known: {UNKNOWN[cost]}" if limit.unknown else ""
    without = "nothing fits either"
    if limit.without is not None:
        row = rows[limit.without]
        without = f"the best that fits is {_named(row)}, {row['accuracy']:.1f} %"
    if best is not None:
        price = f"costs {limit.gain:.1f} ± {limit.error:.1f} points: without it {without}."
        if limit.without == best:
            price = "costs nothing: without it the best that fits is the same."
        return f"{said} {price}" + (f" It rules out {count} candidates ({unknown})." if unknown else "")
    counts = f"{said} alone rules out {count} of {len(rows)} candidates" + (f" ({unknown})" if unknown else "")
    if limit.least is not None:
        row = rows[limit.least]
        counts += f"; the least that any needs is {amount(cost, row[cost])}, {_named(row)}"
    return f"{counts}. Without it {without}."


def _named(row: Row) -> str:
    return f"{row['system']} ({SAID.get(row['unit'], row['unit'])})"
