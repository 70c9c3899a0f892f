"""The command ``bench choose``: the cheapest system that is not measurably worse than the best one.

Without ``over=`` it reads tracked runs; with it, it makes a run whose every fold chooses the smallest value of one
parameter on training subjects.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from rich.markup import escape
from rich.table import Table
from scipy.stats import ttest_1samp

from bench import scores
from bench.cells import PARTS, Cell, cells, convert, items, parse
from bench.errors import InputError
from bench.registry import load, nearest, parameters
from bench.replay import standing
from bench.run import KEYS as RUN_KEYS
from bench.run import console, execute, jobs_of, output
from models.tuning import Search

COSTS = {"flash": "kB", "ram": "kB", "predict": "ms", "decision": "ms"}  # what a system may cost, and its unit
BUDGETS = {f"max_{name}": name for name in COSTS}
UNITS = {"": 1, "B": 1e-3, "kB": 1, "KiB": 1.024, "MB": 1e3, "MiB": 1048.576, "ms": 1, "s": 1e3}
KEYS = RUN_KEYS | {"over", "inner", "by", "margin", *BUDGETS}
SAID = {"capture": "whole captures", "window": "one window"}
FEW_SUBJECTS = 6  # with five, no sign test can reach p < 0.05
SHARES = (0.125, 0.25, 0.5, 1.0)  # of a parameter's default, where no values are given


@dataclass(frozen=True)
class Choice:
    """What was chosen among candidates.

    Attributes:
        table: the candidates with ``loss`` (mean over subjects of best minus own accuracy, in points), ``error`` (its
            standard error) and ``verdict``, cheapest first.
        chosen: index in it, None if no candidate fits the budgets.
        best: index of the most accurate one that fits them.
        costlier: index of the next costlier one that fits them and is more accurate than the chosen, None if there is
            none.
    """

    table: pd.DataFrame
    chosen: int | None
    best: int | None
    costlier: int | None


def choose(arguments: list[str]) -> int:
    """Print the choice and its reason; exit code 1 if nothing fits the budgets.

    Raises:
        InputError: something in the arguments cannot be used, or no run is tracked for them.
    """
    values = parse(arguments, KEYS)
    if "over" in values:
        return _over(values)
    if given := [k for k in values if k in ("jobs", "inner", "seed") or "." in k]:
        raise InputError(f"{given[0]}= is for over=; without it, nothing is run")
    by = values.get("by", "flash")
    if by not in COSTS:
        raise InputError(f"by={by}: {nearest(by, COSTS)}")
    budgets = {BUDGETS[k]: quantity(k, values[k]) for k in BUDGETS if k in values}
    margin = quantity("margin", values["margin"]) if "margin" in values else None
    found, about, subjects = candidates(values)
    choice = decide(found, subjects, by, budgets, margin)
    if (by == "predict" or "predict" in budgets) and found["cpu"].nunique() > 1:
        console.print(f"warning: times are of several processors: {'; '.join(sorted(set(found['cpu'])))}",
                      style="yellow", markup=False, highlight=False, soft_wrap=True)  # fmt: skip
    _print(choice, about, by, budgets, margin, len(subjects.columns))
    return 0 if choice.chosen is not None else 1


def quantity(key: str, text: str) -> float:
    """A number with a unit, in milliseconds or kilobytes (1000 bytes; KiB are 1024), or a margin in points.

    Raises:
        InputError: it is none, or not above 0.
    """
    number = text.rstrip("BkKiMms ")
    unit = text[len(number) :].strip()
    known = {"kB": ["B", "kB", "KiB", "MB", "MiB"], "ms": ["ms", "s"]}
    allowed = known[COSTS[BUDGETS[key]]] if key in BUDGETS else []
    try:
        value = float(number)
        if not value > 0 or (unit not in allowed and allowed) or (unit and not allowed):
            raise ValueError(text)
    except ValueError as e:
        raise InputError(f"{key}={text}: give a number above 0" + (f" and {' or '.join(allowed)}" if allowed else "")) \
            from e  # fmt: skip
    return value * UNITS[unit]


def candidates(values: dict[str, str]) -> tuple[pd.DataFrame, str, pd.DataFrame]:
    """Every way in which a tracked system labels what it is given.

    A system that decides on windows is there twice: labelling whole captures, and by one window alone, which is sooner.
    Systems that ``bench stream`` has replayed are there, too: where there is a budget of ``max_decision``, deciding on
    as much of the beginning of a capture as it allows, and with ``by=decision`` at every instant. Seeds of a system are
    averaged.

    Args:
        values: as typed; ``data``, ``protocol``, ``where``, ``target``, ``model``, ``features`` choose among the runs.

    Returns:
        One row per candidate (``system``, ``unit``, ``accuracy`` in percent as a mean over subjects, ``flash`` and
        ``ram`` in kB, ``predict`` and ``decision`` in ms, ``cpu``); what they are all on, in words; and accuracies in
        percent [candidates, subjects].

    Raises:
        InputError: no run is tracked for these values, or runs on several corpora or protocols are.
    """
    from bench.tracking import connect, context_of
    from reports.comparison import tracked

    client = connect()
    runs = _asked(tracked(client), values)
    most = quantity("max_decision", values["max_decision"]) if "max_decision" in values else None
    if most is not None or values.get("by") == "decision":
        with suppress(InputError):  # nothing was replayed
            runs = pd.concat([runs, _asked(tracked(client, "stream"), values)], ignore_index=True)
    same = ["data", "subset", "protocol", "protocol_label", "corpus_digest"]
    kinds = runs[same].drop_duplicates()
    if not len(kinds):
        raise InputError("no complete run is tracked for these values; make some with bench run, then choose")
    if len(kinds) > 1:
        told = "; ".join(f"data={k.data} protocol={k.protocol} ({k.subset})" for k in kinds.head(4).itertuples())
        raise InputError(f"runs on different captures cannot be compared; name one of: {told}")
    rows, accuracy = [], []
    hops = runs["stream.hop_ms"].fillna("") if "stream.hop_ms" in runs else pd.Series("", runs.index)
    for (system, _, _), group in runs.groupby([runs["system"], runs["touchbench.kind"], hops], sort=True):
        within = None if most is None else most - group["decide_ms_p50"].max()  # one instant for all seeds
        each = [_units(client, run, within) for run in group.to_dict("records")]
        for unit in each[0]:
            costs = pd.DataFrame([units[unit][0] for units in each]).mean()
            rows.append({"system": system, "unit": unit, **costs, "cpu": ", ".join(sorted(set(group["cpu"])))})
            accuracy.append(pd.concat([units[unit][1] for units in each], axis=1).mean(axis=1))
    subjects = pd.DataFrame(accuracy).reset_index(drop=True)
    table = pd.DataFrame(rows).assign(accuracy=subjects.mean(axis=1))
    return table, ", ".join(context_of(runs.iloc[0])), subjects


def _asked(runs: pd.DataFrame, values: dict[str, str]) -> pd.DataFrame:
    """The complete runs among some that were asked for."""
    runs = runs[runs["status"] == "FINISHED"]
    asked = {"subset": values.get("where"), "target": values.get("target", "gesture"), "data": values.get("data")}
    asked |= {"stream.start": "onset"} if "stream.start" in runs else {}
    for key, value in asked.items():
        if value is not None:
            runs = runs[runs[key] == value]
    for key in PARTS:
        if key in values:  # tags also name parameters: svm[C=8.0]
            runs = runs[runs[key].str.split("[", regex=False).str[0].isin(items(key, values[key]))]
    return runs


def _units(client: object, run: dict, within: float | None) -> dict[str, tuple[dict[str, float], pd.Series]]:
    """Costs and accuracy by subject, in percent, of each way in which a run labels.

    A replayed one labels at the last instant within so many ms, or at each.
    """
    predictions = pd.read_parquet(client.download_artifacts(run["run_id"], "predictions.parquet"))

    def of(labelled: pd.DataFrame) -> pd.Series:
        table = scores.per_subject(labelled).set_index("subject")["accuracy"]
        return table.rename(index=str) * 100

    size = {name: run.get(f"{name}_bytes", np.nan) / 1000 for name in ("flash", "ram")}
    if run["touchbench.kind"] == "stream":
        instants = pd.read_csv(client.download_artifacts(run["run_id"], "instants.csv"))["ms"]
        seen = np.sort(predictions["instant"].unique())  # frames
        chosen = instants.index if within is None else instants.index[instants <= within][-1:]
        cost = size | {"predict": run["decide_ms_p50"]}
        return {
            f"first {instants[i]:.0f} ms": (cost | {"decision": instants[i] + run["decide_ms_p50"]},
                                            of(standing(predictions, seen[i])))
            for i in chosen
        }  # fmt: skip
    found = {"capture": (size | {"predict": run["predict_ms_p50"], "decision": run["capture_decision_ms"]},
                         of(scores.captures(predictions)))}  # fmt: skip
    if run.get("windows", 0) > 0:
        window = size | {"predict": run["decide_ms_p50"], "decision": run["decision_ms"]}
        found["window"] = window, of(scores.windows(predictions))
    return found


def decide(
    table: pd.DataFrame, subjects: pd.DataFrame, by: str, budgets: dict[str, float], margin: float | None
) -> Choice:
    """Take the cheapest candidate whose accuracy is not below that of the best.

    Not below means: the mean over subjects of the difference is at most its standard error; or, with a margin, a
    one-sided paired t-test finds it smaller than the margin (p < 0.05). The best one is sought among those that fit the
    budgets; a candidate whose cost is not known fits none.

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
        said = [f"{k} {_amount(k, row[k])} > {_amount(k, budgets[k])}" if np.isfinite(row[k]) else f"{k} not known"
                for k in over]  # fmt: skip
        if not over and not np.isfinite(row[by]):
            said = [f"{by} not known"]
        verdicts.append("ruled out: " + ", ".join(said) if said else "")
    table = table.assign(verdict=verdicts, loss=np.nan, error=np.nan)
    fits = table.index[table["verdict"] == ""]
    if not len(fits):
        return Choice(table.sort_values(by), None, None, None)
    best = int(table.loc[fits].sort_values([by])["accuracy"].idxmax())
    near = []
    for i in fits:
        lost = (subjects.loc[best] - subjects.loc[i]).to_numpy()
        error = lost.std(ddof=1) / np.sqrt(len(lost)) if len(lost) > 1 else np.nan
        table.loc[i, ["loss", "error"]] = lost.mean(), error
        if i == best or _not_below(lost, error, margin):
            near.append(i)
    order = table.sort_values([by, "accuracy"], ascending=[True, False]).index
    chosen = next(i for i in order if i in near)
    for i in fits:
        good = "as good, costlier" if i in near else "worse than the best"
        table.loc[i, "verdict"] = "chosen" if i == chosen else good
    more = [i for i in order if i in fits and table[by][i] > table[by][chosen]]
    costlier = next((i for i in more if table["accuracy"][i] > table["accuracy"][chosen]), None)
    return Choice(table.loc[order], chosen, best, costlier)


def _not_below(lost: np.ndarray, error: float, margin: float | None) -> bool:
    if margin is None:
        return bool(lost.mean() <= error)
    if len(lost) < 2:
        return False
    if not lost.std():
        return bool(lost.mean() < margin)
    return bool(ttest_1samp(lost, margin, alternative="less").pvalue < 0.05)


def _amount(cost: str, value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.3g} {COSTS[cost]}" if value < 100 else f"{value:.0f} {COSTS[cost]}"


def sentences(choice: Choice, by: str, margin: float | None, subjects: int) -> list[str]:
    """The choice, its reason, and what the next costlier system would buy."""
    if choice.chosen is None:
        return ["Nothing fits: every candidate is ruled out by a budget."]
    table = choice.table
    own, best = table.loc[choice.chosen], table.loc[choice.best]
    rule = "one standard error of the paired difference" if margin is None else f"{margin:g} points (p < 0.05)"
    said = [f"Choose {_named(own)}: {own['accuracy']:.1f} % with {by} {_amount(by, own[by])}."]
    if choice.chosen == choice.best:
        said.append("Of those that fit, none is more accurate, and no cheaper one comes within " + rule + ".")
    else:
        said.append(
            f"It is the cheapest that is not below the best that fits, {_named(best)} ({best['accuracy']:.1f} %), by "
            f"more than {rule}: {own['loss']:.1f} ± {own['error']:.1f} points over {subjects} subjects."
        )
    if choice.costlier is not None:
        next_one = table.loc[choice.costlier]
        said.append(
            f"The next costlier one that is more accurate, {_named(next_one)}, would buy "
            f"{next_one['accuracy'] - own['accuracy']:.1f} points for {next_one[by] / own[by]:.2g} times the {by}."
        )
    if subjects < FEW_SUBJECTS:
        said.append(f"Only {subjects} subjects: this says little about the next person.")
    return said


def _named(row: pd.Series) -> str:
    return f"{row['system']} ({SAID.get(row['unit'], row['unit'])})"


def _print(choice: Choice, about: str, by: str, budgets: dict[str, float], margin: float | None, subjects: int) -> None:
    out = output()
    within = ", ".join(f"{k} at most {_amount(k, v)}" for k, v in budgets.items()) or "no budget"
    table = Table(title=f"{about}; {within}; cheapest by {by} first")
    for name in ("system", "labels", "accuracy %", "below the best", *COSTS, "verdict"):
        table.add_column(name, justify="left" if name in ("system", "labels", "verdict") else "right")
    for row in choice.table.to_dict("records"):
        loss = "-" if np.isnan(row["loss"]) else f"{row['loss']:.1f} ± {row['error']:.1f}"
        amounts = [_amount(k, row[k]) for k in COSTS]
        table.add_row(escape(row["system"]), row["unit"], f"{row['accuracy']:.1f}", loss, *amounts, row["verdict"])
    out.print(table)
    for line in sentences(choice, by, margin, subjects):
        out.print(line, markup=False, highlight=False, soft_wrap=True)


def _over(values: dict[str, str]) -> int:
    """Run each system with the smallest value that suffices, chosen in every fold, beside the system as it is."""
    if given := {"by", "margin", *BUDGETS} & set(values):
        raise InputError(f"{given.pop()}= chooses among tracked runs; leave it out, or leave out over=")
    over = values["over"]
    listed = values.get(f"model.{over}")
    rest = {k: v for k, v in values.items() if k not in ("over", "inner", f"model.{over}")}
    whole = cells(rest)
    smallest = [replace(cell, tuning=_tuning(cell, over, listed, values.get("inner", "3"))) for cell in whole]
    return execute([c for pair in zip(smallest, whole, strict=True) for c in pair], jobs_of(values))


def _tuning(cell: Cell, over: str, listed: str | None, inner: str) -> dict[str, object]:
    """How a search picks the smallest value; all parameters but that one stay as they are.

    Raises:
        InputError: the model has no such parameter, or it has no sizes.
    """
    how = {"inner": inner, "objective": "smallest", "over": over, "seed": cell.model.parameters.get("seed", 0)}
    usual = parameters(load("models", cell.model.name))
    fixed = {k: [v] for k, v in cell.model.parameters.items() if v != usual[k] and k != "seed"}
    if isinstance(cell.estimator(), Search):
        raise InputError(f"model={cell.model.name} searches by itself; choose over= of a model that does not")
    if over == "features":
        if not cell.features:
            raise InputError(f"over=features: model={cell.model.name} takes none; choose over= one of its parameters")
        return {"space": fixed} | how
    if over not in usual or over == "seed":
        raise InputError(f"over={over}: {nearest(over, [*(set(usual) - {'seed'}), 'features'])}")
    if isinstance(usual[over], bool) or not isinstance(usual[over], int | float):
        raise InputError(f"over={over}: it has no sizes to choose from; choose over= a parameter that is a number")
    kind = type(usual[over])
    if listed is None:
        chosen = {kind(usual[over] * share) for share in SHARES} - {0}
    else:
        chosen = {convert(f"model.{over}", text, usual[over]) for text in items(f"model.{over}", listed)}
    if not chosen:
        raise InputError(f"over={over}: its default is {usual[over]}; give values, such as model.{over}=1,2")
    return {"space": fixed | {over: sorted(chosen)}} | how
