"""Systems under faults and over time, on the page: all methods of each context in one figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bench.outcomes.comparable import Row, comparable, context_of, method_of, seed_number
from bench.outcomes.runs import rows_of
from bench.outcomes.stopping import SHOWN_MS
from bench.outcomes.store import Store
from reports import streaming
from reports.figures import Picture, save
from reports.layout import Table
from reports.numbers import number, percent
from reports.stability_figures import heat_map

CONTEXTS = 3  # captures-and-protocol groups that are drawn
METHODS = 10  # of a context
Section = tuple[str, Picture | None, Table]  # a context in words, what is drawn of it, and its table


def stress_sections(contexts: dict[str, list[Row]], folder: Path) -> list[Section]:
    """The loss under each fault, and where each method fails first."""
    sections = []
    for i, (context, runs) in enumerate(contexts.items(), 1):
        losses, picture = pd.DataFrame({method_of(r): under(r, "loss.") for r in runs}).T, None
        if losses.size:  # else learning curves alone
            figure = heat_map(losses, [r["accuracy"] for r in runs], context)
            caption = "Points of accuracy lost under each fault, mean over five severities, worst fault first."
            picture = save(figure, folder, f"0-stress-{i}", context, f"{context}: {caption}")
        sections.append((context, picture, Table(pd.DataFrame([_failing(r) for r in runs]))))
    return sections


def stream_sections(store: Store, contexts: dict[str, list[Row]], folder: Path) -> list[Section]:
    """Accuracy against touch seen, and the result of stopping at the learned threshold."""
    sections = []
    for i, (context, runs) in enumerate(contexts.items(), 1):
        figure = streaming.draw([streaming.stream_of(store, r) for r in runs])
        caption = "Left: accuracy against milliseconds of touch. Right: fixed windows and adaptive stopping."
        picture = save(figure, folder, f"0-stream-{i}", context, f"{context}: {caption}")
        sections.append((context, picture, Table(pd.DataFrame([_over_time(r) for r in runs]))))
    return sections


def contexts(runs: pd.DataFrame | None) -> dict[str, list[Row]]:
    """Complete runs by comparability: for each system, the newest of its lowest seed.

    A run that met more faults stands before a newer one that met fewer.

    Args:
        runs: `bench.outcomes.runs.tracked` of a kind; None if there is none.

    Returns:
        At most `CONTEXTS` groups, people first and the largest first, each with its `METHODS` most accurate methods.
    """
    complete = [] if runs is None else rows_of(runs[runs["status"] == "FINISHED"])[::-1]  # the newest first
    groups: dict[tuple, dict[str, Row]] = {}
    several: set[tuple] = set()  # groups that have runs of a system with other seeds
    for run in sorted(complete, key=lambda r: (seed_number(r["seed"]), -len(under(r, "loss.")))):
        same = comparable(run)
        if groups.setdefault(same, {}).setdefault(run["system"], run)["seed"] != run["seed"]:
            several.add(same)
    ordered = sorted(groups.items(), key=lambda g: (next(iter(g[1].values()))["synthetic"], -len(g[1])))
    named = {}
    for same, members in ordered[:CONTEXTS]:
        best = sorted(members.values(), key=lambda r: -r["accuracy"])[:METHODS]
        left = len(members) - len(best)
        words = context_words(best[0]) + (f", {left} less accurate systems left out" if left else "")
        named[words + (", only the lowest seed of each system" if same in several else "")] = best
    return named


def context_words(run: Row) -> str:
    """Corpus and protocol of a run, and the way of replay, in words."""
    parts = [*context_of(run)]
    parts += ["from the middle of the capture"] if run.get("stream.start") == "middle" else []
    parts += [f"a decision every {hop} ms"] if (hop := run.get("stream.hop_ms", "None")) != "None" else []
    parts += [f"background: {background}"] if (background := run.get("watch.background")) else []
    return ", ".join(parts)


def under(run: Row, prefix: str) -> dict[str, float]:
    """Metrics of a run whose names begin alike, by the rest of their names."""
    return {k.removeprefix(prefix): v for k, v in run.items() if k.startswith(prefix) and pd.notna(v)}


def _failing(run: Row) -> dict[str, str]:
    halves = sorted(under(run, "half_margin.").items(), key=lambda item: item[1])
    return {
        "system": method_of(run),
        "clean %": percent(run["accuracy"]),
        "half of the margin is lost at": ", ".join(f"{k.replace('_', ' ')} {v:.1f}" for k, v in halves) or "nowhere",
        "failing of tested groups": f"{run['failing_slices']:.0f} of {run['tested_slices']:.0f}",
        **{f"worst {k}": percent(v) for k, v in under(run, "worst.").items()},
    }


def _over_time(run: Row) -> dict[str, str]:
    shares: Sequence[tuple[str, str]] = [(f"{ms} ms", f"accuracy_at_{ms}_ms") for ms in SHOWN_MS]
    shares = [*shares, ("whole", "accuracy"), ("adaptive", "adaptive_accuracy")]
    return {
        "system": method_of(run),
        **{heading: percent(run.get(metric, float("nan"))) for heading, metric in shares},
        "after ms": number(run["adaptive_ms"], 0),
        "decision ms p50 / p95": f"{run['decide_ms_p50']:.1f} / {run['decide_ms_p95']:.1f}",
    }
