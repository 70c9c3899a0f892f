"""Trials of `models.search.auto`: what was found of each, as a study keeps it and as tables tell it."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.pareto import front
from models.search import portfolio
from models.search.portfolio import Trial
from models.search.space import Range
from models.search.trial_scores import Inner

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial

COSTS = {"flash": "flash_bytes", "ram": "ram_bytes", "predict": "predict_ms"}
STATES = {"complete": "COMPLETE", "pruned": "PRUNED"}  # of Optuna; others are no trials to it


@dataclass
class Tried:
    """One trial.

    Attributes:
        trial: what was tried.
        state: ``complete``; ``pruned``, as it was worse; ``large``, as it exceeds a limit; ``late``, as it took too
            long; ``skipped``, as it would have; ``failed``; ``unjudged`` where there was no time for any.
        seconds: that it took.
        subjects: accuracy of each left-out training subject.
        fit_seconds: what a fit to the whole training part should take.
        costs: bytes in flash and memory with 32 bits a number, milliseconds of a decision.
        proba: of left-out captures, float16 [captures, classes]; None for what is not complete.
        heat: temperature of the probabilities.
        error: of one that failed.
    """

    trial: Trial
    state: str
    seconds: float = 0.0
    subjects: dict[str, float] = field(default_factory=dict)
    fit_seconds: float = 0.0
    costs: dict[str, float] = field(default_factory=dict)
    proba: np.ndarray | None = None
    heat: float = 1.0
    error: str = ""

    @property
    def accuracy(self) -> float:
        """Mean over subjects; not a number where none was judged."""
        return float(np.mean([*self.subjects.values()])) if self.subjects else float("nan")


def together(costs: list[dict[str, float]]) -> dict[str, float]:
    """What several systems cost that decide one after the other."""
    found = {name: sum(each[name] for each in costs) for name in COSTS.values()}
    return found | {"ram_bytes": max(each["ram_bytes"] for each in costs)}


def within(costs: dict[str, float], limits: dict[str, float]) -> bool:
    """Whether no cost that is known exceeds its limit."""
    return all(costs[name] <= limit for name, limit in limits.items() if name in costs)


def frozen(tried: Tried, limits: dict[str, float]) -> FrozenTrial:
    """A trial as a study holds it: one that exceeds a limit is worse than any that does not."""
    import optuna

    state = optuna.trial.TrialState[STATES.get(tried.state, "FAIL")]
    told = {
        name: getattr(tried, name) for name in ("state", "seconds", "subjects", "fit_seconds", "costs", "heat", "error")
    }
    if tried.proba is not None:
        told["proba"] = base64.b64encode(zlib.compress(tried.proba.tobytes())).decode()
    spaces = portfolio.BEFORE | {
        f"{m}.{k}": values for m, space in portfolio.SPACES.items() for k, values in space.items()
    }
    spaces |= {"model": list(portfolio.MODELS), "features": list(portfolio.FEATURES)}
    return optuna.trial.create_trial(
        state=state,
        value=tried.accuracy - (not within(tried.costs, limits)) if tried.state == "complete" else None,
        params=tried.trial,
        distributions={key: _distribution(spaces[key]) for key in tried.trial},
        user_attrs=told,
        intermediate_values=dict(enumerate(tried.subjects.values())),
    )


def _distribution(values: Range | Sequence) -> BaseDistribution:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if not isinstance(values, Range):
        return CategoricalDistribution(list(values))
    whole = isinstance(values.low, int) and isinstance(values.high, int)
    return (IntDistribution if whole else FloatDistribution)(values.low, values.high, log=values.log)


def thawed(kept: FrozenTrial, inner: Inner) -> Tried:
    """A trial as a study holds it, once more what it was."""
    told = dict(kept.user_attrs)
    if "proba" in told:
        values = zlib.decompress(base64.b64decode(told["proba"]))
        told["proba"] = np.frombuffer(values, dtype=np.float16).reshape(len(inner.y), len(inner.classes))
    return Tried(dict(kept.params), **told)


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


def told(tried: list[Tried], chosen: list[tuple[Tried, float]], part: slice | np.ndarray) -> dict[str, object]:
    """What was chosen, in words, and how far the search got."""
    found: dict[str, object] = {str(i): f"{w:.2f} {named(t.trial)}" for i, (t, w) in enumerate(chosen, 1)}
    states = [t.state for t in tried]
    found |= {name: states.count(name) for name in ("complete", "pruned", "large", "late", "skipped", "failed")}
    found |= {"error": next(t.error for t in tried if t.error)} if "failed" in states else {}
    return found | ({} if isinstance(part, slice) else {"captures": len(part)})


def named(trial: Trial) -> str:
    """A trial in words: ``lda · touch, window 1, shrinkage 0.2``; what captures and columns are left at is left out."""
    first = {k: list(values)[0] for k, values in portfolio.BEFORE.items()}
    parts = [f"{k} {_short(trial[k])}" for k in first if trial[k] != first[k]]
    parts += [f"{k.partition('.')[2]} {_short(v)}" for k, v in trial.items() if "." in k]
    return f"{trial['model']} · {', '.join([str(trial['features']), *parts])}"


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
