"""Trials of `bench.models.search.auto` as tables and words."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.models.search import portfolio
from bench.models.search.space import Trial
from bench.models.search.study import Tried
from bench.pareto import front

COSTS = {"flash": "flash_bytes", "ram": "ram_bytes", "predict": "predict_ms"}


def together(costs: list[dict[str, float]]) -> dict[str, float]:
    """Costs of several systems that decide one after the other."""
    sums = {name: sum(each[name] for each in costs) for name in COSTS.values()}
    return sums | {"ram_bytes": max(each["ram_bytes"] for each in costs)}


def table_of(tried: list[Tried], chosen: list[tuple[Tried, float]]) -> pd.DataFrame:
    """A row per trial, in their order; ``ended`` in seconds of the search."""
    weights = {id(t): w for t, w in chosen}
    rows = [
        t.trial
        | {"state": t.state, "accuracy": t.accuracy, "subjects": len(t.subjects), "seconds": t.seconds}
        | {"ended": end, "fit_seconds": t.fit_seconds, "weight": weights.get(id(t), 0.0)}
        | {name: t.costs.get(name, np.nan) for name in COSTS.values()}
        for t, end in zip(tried, np.cumsum([t.seconds for t in tried]), strict=True)
    ]
    table = pd.DataFrame(rows)
    judged = table["accuracy"].where(table["state"] == "complete").to_numpy()
    for cost, name in COSTS.items():
        table[f"front_{cost}"] = front(judged, table[name].where(table["state"] == "complete").to_numpy())
    return table


def summary(tried: list[Tried], chosen: list[tuple[Tried, float]], part: slice | np.ndarray) -> dict[str, object]:
    """The chosen systems, in words, and the progress of the search."""
    words: dict[str, object] = {str(i): f"{w:.2f} {named(t.trial)}" for i, (t, w) in enumerate(chosen, 1)}
    states = [t.state for t in tried]
    words |= {name: states.count(name) for name in ("complete", "pruned", "large", "late", "skipped", "failed")}
    words |= {"error": next(t.error for t in tried if t.error)} if "failed" in states else {}
    return words | ({} if isinstance(part, slice) else {"captures": len(part)})


def named(trial: Trial) -> str:
    """A trial in words: ``lda · touch, window 1, shrinkage 0.2``; default steps and columns are left out."""
    first = {k: list(values)[0] for k, values in portfolio.BEFORE.items()}
    parts = [f"{k} {_short(trial[k])}" for k in first if trial[k] != first[k]]
    parts += [f"{k.partition('.')[2]} {_short(v)}" for k, v in trial.items() if "." in k]
    return f"{trial['model']} · {', '.join([str(trial['features']), *parts])}"


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
