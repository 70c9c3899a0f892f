"""Which system to take: the cheapest that is within one standard error of the best one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import pandas as pd

from bench.arguments import quoted
from bench.costs import COSTS
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
from bench.paired import TOLERANCE, mean_and_error, within_one_standard_error

Amount = TypeVar("Amount", float, pd.Series)
SAID = {"window": "one window"}  # units in words; a capture is not named
WORDS = {  # an amount of a cost
    "flash": "of flash",
    "ram": "of RAM",
    "predict": "of computing time",
    "decision": "until the decision",
    "cycles": "instructions",
}
FEW_SUBJECTS = 6  # with five, no sign test can reach p < 0.05
ORIGIN = {
    "kind": "touchbench.kind",
    "command": "touchbench.command",
    "arguments": "touchbench.arguments",
}
UNKNOWN = {  # why a cost is not known
    "flash": "their size cannot be counted",
    "ram": "their memory cannot be counted",
    "predict": "no timing is available for exported C",
    "decision": "it was not measured",
    "cycles": "only bench chip counts them",
}


@dataclass(frozen=True)
class Candidates:
    """The candidates of a store, on the same captures under the same protocol.

    Attributes:
        table: one row per candidate (``system``, ``unit``, ``accuracy`` in percent as a mean over subjects, ``flash``
            and ``ram`` in kB, ``predict`` and ``decision`` in ms, ``cycles`` in thousands of instructions, ``linked``,
            whether its bytes are as linked, with code, ``windows``, whether it decides on windows, ``cpu`` and the keys
            of `ORIGIN`; NaN where a cost is not known).
        about: captures and protocol, in words.
        subjects: accuracies in percent [candidates, subjects].
        mixed: whether training and test captures come from the same subjects.
        notes: which runs are left out and why, in sentences.
    """

    table: pd.DataFrame
    about: str
    subjects: pd.DataFrame
    mixed: bool
    notes: list[str]


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
    clock: float | None = None,
    batch: bool = False,
) -> Candidates:
    """Every way in which a tracked system labels captures, or windows of them: percents of the two are not compared.

    What ``bench chip`` has exported labels as C, with bytes and instructions that were measured. Systems that ``bench
    stream`` has replayed are there, too, if they are asked for: deciding on as much of the beginning of a capture as a
    budget of time allows, or at every instant. Seeds of a system are averaged.

    Args:
        store: where the runs are.
        asked: names of ``data``, ``protocol``, ``where``, ``target``, ``model``, ``features`` to choose among, and
            ``shots`` that are known of a new person; parameters of the protocol by their dotted names; or values of
            `COMPARABLE`.
        most: milliseconds of touch until a decision is out.
        replays: whether replayed systems are candidates; they are with ``most``.
        runs_of: `bench.outcomes.runs.tracked` by kind, where somebody has read it.
        windows: label single windows, in percent of windows, of the systems that decide on such.
        clock: of the target in MHz: the measured cycles at this clock are part of a decision's time.
        batch: whether systems whose predictions depend on the captures that are predicted together are candidates.

    Raises:
        NothingTracked: no complete run is tracked for these values.
        InputError: runs on several corpora or protocols are, or a table of one is gone.
    """
    read = ["cell"] if windows else ["cell", "chip", *(["stream"] if most is not None or replays else [])]
    runs_of = of_kinds(store, read) if runs_of is None else runs_of
    tables = [runs_of[kind] for kind in read if kind in runs_of]
    if not tables:
        tracked(store)  # which says so
    runs = _asked(tables, asked)
    if windows:
        runs = runs[_windowed(runs)]
    runs, notes = _usable(runs, batch, "protocol_label" in asked)
    if not len(runs):
        why = "".join(f". {note.removesuffix('.')}" for note in notes)
        raise NothingTracked(f"no complete run is tracked for these values; make some with bench run, then choose{why}")
    linked = _linked(runs)
    rows, accuracy = [], []
    options = runs.reindex(columns=["stream.hop_ms", "chip.bits"]).fillna("")
    for (system, *_), group in runs.groupby(
        [runs["system"], runs["touchbench.kind"], *(options[name] for name in options)], sort=True
    ):
        is_c = group["touchbench.kind"].iloc[0] == "chip"
        if not is_c:
            group = group.assign(**linked.get(str(system), {}))
        each = [_units(store, run, most, windows) for run in rows_of(group)]
        for unit in each[0]:
            costs = pd.DataFrame([units[unit][0] for units in each]).mean().reindex([*COSTS])
            if clock is not None and np.isfinite(costs["cycles"]):
                costs["decision"] += costs["cycles"] / clock  # thousands by MHz: ms
            about = {
                "conditions": value if isinstance(value := rows_of(group)[-1].get(CONDITIONS), str) else "",
                "linked": is_c or system in linked,
                "windows": _windowed(group).any(),
            }
            rows.append({"system": system_of(rows_of(group)[-1]), "unit": unit, **costs, **about, **_origin(group)})
            accuracy.append(pd.concat([units[unit][1] for units in each], axis=1).mean(axis=1))
    subjects = pd.DataFrame(accuracy).reset_index(drop=True)
    table = pd.DataFrame(rows).assign(accuracy=subjects.mean(axis=1))
    first, *_ = known = rows_of(runs)
    mixed = any(facts_of(run).mixes_subjects for run in known)
    return Candidates(table, ", ".join(context_of(first)), subjects, mixed, notes)


def _usable(runs: pd.DataFrame, batch: bool, same: bool) -> tuple[pd.DataFrame, list[str]]:
    """The complete runs that can be compared, and which others are left out, in sentences.

    Args:
        runs: that were asked for.
        batch: whether systems whose predictions depend on the captures that are predicted together stay.
        same: whether one set of captures and one protocol were asked for.

    Raises:
        InputError: runs on several corpora or protocols are among them.
    """
    complete = runs[runs["status"] == "FINISHED"]
    complete, notes = (complete, []) if same or not len(complete) else _alike(complete)
    failed = runs[(runs["status"] != "FINISHED") & ~runs["system"].isin(complete["system"])]
    if len(complete):
        failed = failed.merge(complete[[*COMPARABLE]].drop_duplicates())
    if names := sorted(set(failed["system"])):
        notes.append(f"Left out, because folds failed: {'; '.join(names)}. Repeat the command to run them again.")
    if BATCH in runs and not batch:
        names = sorted(set(complete["system"][complete[BATCH] == "true"]))
        if names:
            complete = complete[~complete["system"].isin(names)]
            notes.append(
                "Left out, because predictions depend on the captures that are predicted together: "
                f"{'; '.join(names)}. Give batch=yes to choose among them, too."
            )
    return complete, notes


def _alike(runs: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The runs on the captures and under the protocol of the newest run, and which others are left out, in sentences.

    Raises:
        InputError: arguments of `bench choose` can tell them apart.
    """
    named = pd.Series(_on(runs), runs.index)
    if named.nunique() > 1:
        raise InputError(
            f"runs on different captures or protocols cannot be compared; name one of: {'; '.join(named.unique()[:4])}"
        )
    same = [*COMPARABLE, "protocol"]
    newest = runs.sort_values("started").iloc[-1]
    kept = (runs[same] == newest[same]).all(axis=1)
    older, data = runs[~kept], str(newest["data"])
    notes = []
    if count := int((digests := older["corpus_digest"]).ne(newest["corpus_digest"]).sum()):
        versions = ", ".join(digest[:8] for digest in digests.unique() if digest != newest["corpus_digest"])
        notes.append(f"Left out: {_several(count, 'older run')} on another version of {data} (corpus {versions}).")
    if count := len(older) - count:
        notes.append(f"Left out: {_several(count, 'older run')} whose protocol was stored under another name.")
    return runs[kept], notes


def _windowed(runs: pd.DataFrame) -> pd.Series:
    """Whether each run decided on windows."""
    return runs["windows"] > 0 if "windows" in runs else pd.Series(False, runs.index)


def _on(runs: pd.DataFrame) -> list[str]:
    """Arguments of `bench choose` that select the captures and the protocol of each run."""
    parameters = [str(name) for name in runs if str(name).startswith("protocol.")]
    differing = {
        name: [p for p in parameters if group[p].notna().all() and group[p].nunique() > 1]
        for name, group in runs.groupby("protocol_name")
    }
    found = []
    for run in rows_of(runs):
        protocol = str(run["protocol"]).partition("[")[0]
        asked = {"data": str(run["data"]), "where": str(run["subset"]), "protocol": protocol}
        asked |= {"target": str(run["target"])} if run["target"] != "gesture" else {}
        asked |= {name: str(run[name]) for name in differing[run["protocol_name"]]}
        found.append(" ".join(f"{key}={quoted(value)}" for key, value in asked.items()))
    return found


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


def _asked(tables: list[pd.DataFrame], asked: Mapping[str, list[str]]) -> pd.DataFrame:
    """The runs of all kinds that were asked for; replays only from the onset.

    Args:
        tables: the runs of each kind; one whose protocols lack an asked parameter has no such run.
        asked: as `candidates` takes it.

    Raises:
        InputError: no run of any kind has a parameter that was asked for.
    """
    columns = {key: COLUMNS.get(key, key) for key in asked}
    for key, column in columns.items():
        if column.startswith("protocol.") and not any(column in runs for runs in tables):
            raise InputError(f"{key}: no run of a protocol that has it is tracked")
    found = []
    for runs in tables:
        if not {*columns.values()} <= {*runs.columns}:
            continue
        if "shots" in asked and "protocol.unlabelled" in runs:
            runs = runs[runs["protocol.unlabelled"] != "True"]
        wanted = {"target": ["gesture"], **asked} | ({"stream.start": ["onset"]} if "stream.start" in runs else {})
        found.append(selected(runs, wanted))
    return pd.concat(found, ignore_index=True) if found else tables[0].iloc[:0]


def _units(store: Store, run: Row, most: float | None, windows: bool) -> dict[str, tuple[dict[str, float], pd.Series]]:
    """Costs and accuracy by subject, in percent, of each way in which a run labels.

    A replayed one labels at the last instant within so many ms of touch, or at each. The time of a decision is the
    touch that it needs: what this machine takes to compute it is another cost.
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
        cost |= {"cycles": run["chip_most_instructions"] / 1000, "decision": run["capture_ms"]}
        return {f"in C, {run['chip.bits']} bits": (cost, of(scores.captures(table)))}
    if kind == "stream":
        instants = pd.read_csv(needed(store, run, "instants.csv"))["ms"]
        seen = np.sort(table["instant"].unique())  # frames
        soon = instants.index if most is None else instants.index[_within(instants, most)][-1:]
        chosen = soon if len(soon) else instants.index[:1]  # which says how far it is from soon enough
        cost = size | {"predict": run["decide_ms_p50"]}
        return {
            f"first {instants[i]:.0f} ms": (
                cost | {"decision": instants[i]},
                of(standing(table, seen[i])),
            )
            for i in chosen
        }
    if windows:
        costs = size | {"predict": run["decide_ms_p50"], "decision": run["observed_ms"]}
        return {"window": (costs, of(scores.windows(table)))}
    return {"capture": (_whole(run, size), of(scores.captures(table)))}


def _whole(run: Row, size: dict[str, float]) -> dict[str, float]:
    """Costs of labelling whole captures."""
    return size | {"predict": run["predict_ms_p50"], "decision": run["capture_ms"]}


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
        over = [k for k, most in budgets.items() if not _within(row[k], most)]
        said = [
            f"{k} {' > '.join(apart(k, row[k], budgets[k]))}" if np.isfinite(row[k]) else f"{k} not known" for k in over
        ]
        verdicts.append("ruled out: " + ", ".join(said) if said else "")
    accuracy = table["accuracy"].round(9)  # equal sums in another order are ties
    table = table.assign(verdict=verdicts, loss=np.nan, error=np.nan, accuracy=accuracy)
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
            dearer = "costlier" if table[by][i] > table[by][chosen] else "equally cheap"
            verdict = f"as good, {dearer}" if i in near else "below the best"
        table.loc[i, "verdict"] = verdict
    more = [i for i in order if i in fits and table[by][i] > table[by][chosen]]
    costlier = next((i for i in more if table["accuracy"][i] > table["accuracy"][chosen]), None)
    return Choice(table.loc[order], chosen, best, costlier, unranked, limits)


def fitting(table: pd.DataFrame, budgets: Mapping[str, float]) -> pd.DataFrame:
    """The candidates that are known to fit all budgets."""
    within = [_within(table[cost], most) for cost, most in budgets.items()]
    return table[np.logical_and.reduce(within)] if within else table


def _within(cost: Amount, most: float) -> Amount:
    """Whether a cost is within its budget: not where it is NaN, and rounding is no excess."""
    return cost <= most * (1 + TOLERANCE)


def _best(table: pd.DataFrame, by: str, budgets: Mapping[str, float]) -> int | None:
    """The most accurate one that fits and whose cost is known; of equal ones the cheapest."""
    ranked = fitting(table, budgets).dropna(subset=[by]).sort_values(by)
    return int(ranked.index[int(ranked["accuracy"].round(9).argmax())]) if len(ranked) else None


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
        int((~_within(needed, most)).sum()),
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
    from scipy.stats import ttest_1samp  # heavy

    if not losses.std():
        return bool(losses.mean() < margin)
    return bool(ttest_1samp(losses, margin, alternative="less").pvalue < 0.05)


def amount(cost: str, value: float) -> str:
    """A cost with its unit, as people read it."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.3g} {COSTS[cost]}" if value < 100 else f"{value:.0f} {COSTS[cost]}"


def apart(cost: str, one: float, other: float) -> tuple[str, str]:
    """Two amounts of a cost with as many digits as tell them apart."""
    texts = amount(cost, one), amount(cost, other)
    digits = 4
    while texts[0] == texts[1] and one != other and digits < 17:
        texts = f"{one:.{digits}g} {COSTS[cost]}", f"{other:.{digits}g} {COSTS[cost]}"
        digits += 1
    return texts


def points(mean: float, error: float) -> str:
    """A difference in points with its standard error, which a single subject does not have."""
    text = f"{mean:.1f}" if round(mean, 1) or not mean else f"{mean:.1g}"
    return text if np.isnan(error) else f"{text} ± {error:.1f}"


def sentences(choice: Choice, by: str, margin: float | None, subjects: int, mixed: bool = False) -> list[str]:
    """The choice, its reason, what the next better system needs, what each budget costs, and for whom it holds.

    Args:
        choice: that was made.
        by: the cost that is to be low.
        margin: points of accuracy that do not matter, or None.
        subjects: number of them.
        mixed: whether training and test captures come from the same subjects.
    """
    rows = dict(zip(choice.table.index, rows_of(choice.table), strict=True))
    limits = [_limited(limit, rows, choice.best) for limit in choice.budgets]
    if choice.chosen is None:
        if choice.unranked:
            return [f"Nothing can be chosen: no candidate that fits has a known {by} ({UNKNOWN[by]}).", *limits]
        return ["Nothing fits: every candidate is ruled out by a budget.", *limits]
    own, best = rows[choice.chosen], rows[choice.best]
    said = [f"Choose {_named(own)}: {own['accuracy']:.1f} % with {amount(by, own[by])} {WORDS[by]}."]
    that = "that fits" + (f" and has a known {by}" if choice.unranked else "")
    if choice.chosen == choice.best or subjects < 2:
        said.append(f"No system {that} is more accurate{_nor_cheaper(margin, subjects)}.")
    else:
        rule = "within one standard error of" if margin is None else f"that loses less than {margin:g} points to"
        proof = "" if margin is None else ", p < 0.05"
        said += [
            f"It is the cheapest system {rule} the best one {that} ({_brief(best)}, {best['accuracy']:.1f} %{proof}).",
            f"It loses {points(own['loss'], own['error'])} points (mean ± standard error over {subjects} subjects).",
        ]
    if choice.costlier is not None:
        better = rows[choice.costlier]
        more, less = apart(by, better[by], own[by])
        gain = points(better["accuracy"] - own["accuracy"], np.nan)
        said.append(
            f"The next better system, {_named(better)}, gains {gain} points but needs {more} {WORDS[by]} instead of "
            f"{less}."
        )
    if choice.unranked:
        first = rows[choice.unranked[0]]
        said.append(
            f"{_several(len(choice.unranked), 'candidate')} cannot be chosen, because the {by} is unknown "
            f"({UNKNOWN[by]}). The most accurate of these is {_named(first)}, {first['accuracy']:.1f} %."
        )
    said += limits
    if subjects == 1:
        said.append("Only 1 subject, so there is no standard error: this says little about the next person.")
    elif subjects < FEW_SUBJECTS:
        said.append(f"Only {subjects} subjects: this says little about the next person.")
    if mixed:
        said.append("Training and test captures come from the same subjects: this does not hold for a new person.")
    return said


def _nor_cheaper(margin: float | None, subjects: int) -> str:
    """That no cheaper system comes near the best one, where subjects can show it."""
    if subjects < 2:
        return ""
    if margin is None:
        return ", and no cheaper one is within one standard error"
    return f", and no cheaper one is shown to lose less than {margin:g} points (p < 0.05)"


def _limited(limit: Budget, rows: dict[int, Row], best: int | None) -> str:
    """What a budget costs, or where nothing fits, how far the candidates are from it."""
    cost, count = limit.cost, limit.over + limit.unknown
    said = f"{cost} at most {amount(cost, limit.most)}"
    unknown = f"{limit.unknown} with unknown {cost}: {UNKNOWN[cost]}" if limit.unknown else ""
    without = "nothing fits either"
    if limit.without is not None:
        row = rows[limit.without]
        without = f"the best that fits is {_named(row)}, {row['accuracy']:.1f} %"
    if best is not None:
        price = f"costs {points(limit.gain, limit.error)} points: without it {without}."
        if limit.without == best:
            price = "costs nothing: without it the best that fits is the same."
        return f"{said} {price}" + (f" It rules out {_several(count, 'candidate')} ({unknown})." if unknown else "")
    if not count:
        return f"{said} rules out no candidate."
    counts = f"{said} alone rules out {count} of {_several(len(rows), 'candidate')}"
    counts += f" ({unknown})" if unknown else ""
    if limit.least is not None:
        row = rows[limit.least]
        counts += f"; the least that any needs is {apart(cost, row[cost], limit.most)[0]}, {_named(row)}"
    return f"{counts}. Without it {without}."


def _several(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' if number != 1 else ''}"


def _named(row: Row) -> str:
    """A candidate: the system, and in brackets what it labels unless that is whole captures."""
    return str(row["system"]) + ("" if row["unit"] == "capture" else f" ({SAID.get(row['unit'], row['unit'])})")


def _brief(row: Row) -> str:
    """The same for a place that is in brackets."""
    return _named(row).replace(" (", ", ").removesuffix(")")
