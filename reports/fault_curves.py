"""Systems under faults, on the page: all systems of each context in one figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.comparable import Row
from bench.measures import Measure, percent, text
from bench.reports.contexts import context_words, contexts
from bench.reports.figures import save
from bench.reports.part import Part, Section
from bench.reports.stability_figures import heat_map
from bench.result import Result
from bench.sentences import sentences
from bench.table import Table
from bench.work.curves import clean_accuracy

FAULTS = "Faults"  # heading
FAILING = (  # columns of the table of systems under faults
    text("system", read=lambda r: r.method),
    Measure("accuracy", "clean %", lambda r: 100 * clean_accuracy(r)),
    text("halves", "half of the margin is lost at", read=lambda r: _halves(r)),
)
CAPTION = (
    "{}: faults and groups of captures on which each system fails. The number after each fault is the severity "
    "from 1 to 5 at which half of the margin over chance is lost. Groups are subjects, gestures, conditions, "
    "faults and pairs of these; failing groups have an accuracy significantly below that of the system "
    "(Benjamini-Hochberg). faults.csv has every severity; bench stress writes all groups, and curves over "
    "severities, training subjects and lengths."
)


def fault_section(results: Sequence[Result], folder: Path, failing: Callable[[Row], Any]) -> Section | None:
    """The loss under each fault, and where each system fails first.

    Args:
        results: results of runs under faults.
        folder: destination folder of figures.
        failing: number of failing groups of a result, in words.
    """
    parts = []
    for i, (context, members) in enumerate(contexts(results, more="loss."), 1):
        losses, picture = pd.DataFrame({r.method: losses_of(r) for r in members}).T, None
        if losses.size:  # else learning curves alone
            figure = heat_map(losses, [clean_accuracy(r) for r in members], context)
            caption = "Points of accuracy lost under each fault, mean over five severities, worst fault first."
            picture = save(figure, folder, f"0-stress-{i}", context, f"{context}: {caption}")
        worst = dict.fromkeys(f"worst.{name}" for r in members for name in under(r, "worst."))
        groups = Measure("failing", "failing of tested groups", failing)
        columns = [*FAILING, groups, *(percent(name, name.replace(".", " ")) for name in worst)]
        parts.append(Part(picture, Table(columns, members), CAPTION.format(context)))
    return Section(FAULTS, parts) if parts else None


def robust(results: Sequence[Result]) -> tuple[str, str] | None:
    """A sentence on the most robust system under faults, on the first of all comparable captures."""
    for _, runs in contexts(results, more="loss."):
        losses = {r.method: losses_of(r) for r in runs if r.alone}
        sets = Counter(frozenset(loss) for loss in losses.values() if loss)
        if not sets:
            continue
        tested = max(sets, key=lambda each: (sets[each], len(each)))  # by most systems
        means = {m: 100 * np.mean([*loss.values()]) for m, loss in losses.items() if set(loss) == tested}
        least, most = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        worst = max(losses[least], key=losses[least].__getitem__)
        named = {"least": least, "most": most, "worst": worst, "loss": 100 * losses[least][worst]}
        words = sentences(
            *("bench.reports", "sentences", "robust"),
            context=context_words(runs[0]),
            means=means,
            faults=len(tested),
            **named,
        )
        return FAULTS, words[0]
    return None


def losses_of(run: Row) -> dict[str, float]:
    """Mean loss of accuracy under each fault of a run."""
    names = str(run.get("faults", "")).split(", ")
    return {name: value for name, value in under(run, "loss.").items() if name in names}


def under(run: Row, prefix: str) -> dict[str, float]:
    """Metrics of a run whose names begin alike, by the rest of their names."""
    return {k.removeprefix(prefix): v for k, v in run.items() if k.startswith(prefix) and pd.notna(v)}


def _halves(run: Row) -> str:
    """Each fault with the severity at which half of the margin is lost, the lowest first."""
    halves = sorted(under(run, "half_margin.").items(), key=lambda item: item[1])
    return ", ".join(f"{fault.replace('_', ' ')} {severity:.1f}" for fault, severity in halves) or "nowhere"
