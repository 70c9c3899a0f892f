"""Systems under faults and over time, on the page: all methods of each context in one figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bench.comparable import Row, context_of, seed_number
from bench.measures import Measure, percent, text
from bench.outcomes.stopping import SHOWN_MS
from bench.result import Result
from bench.table import Table
from reports import streaming
from reports.figures import Picture, save
from reports.stability_figures import heat_map

CONTEXTS = 3  # captures-and-protocol groups that are drawn
METHODS = 10  # of a context
Section = tuple[str, Picture | None, Table]  # a context in words, what is drawn of it, and its table


FAILING = (  # columns of the table of systems under faults
    text("system", read=lambda r: r.method),
    percent("accuracy", "clean %"),
    text("halves", "half of the margin is lost at", read=lambda r: _halves(r)),
    Measure("failing", "failing of tested groups", lambda r: f"{r['failing_slices']:.0f} of {r['tested_slices']:.0f}"),
)
OVER_TIME = (  # columns of the table of replayed systems
    text("system", read=lambda r: r.method),
    *(percent(f"accuracy_at_{ms}_ms", f"{ms} ms") for ms in SHOWN_MS),
    percent("accuracy", "whole"),
    percent("adaptive_accuracy", "adaptive"),
    Measure("adaptive_ms", "after ms", form=".0f"),
    Measure("decide_ms", "decision ms p50 / p95", ("decide_ms_p50", "decide_ms_p95")),
)


def stress_sections(contexts: dict[str, list[Result]], folder: Path) -> list[Section]:
    """The loss under each fault, and where each method fails first."""
    sections = []
    for i, (context, results) in enumerate(contexts.items(), 1):
        losses, picture = pd.DataFrame({r.method: under(r, "loss.") for r in results}).T, None
        if losses.size:  # else learning curves alone
            figure = heat_map(losses, [r["accuracy"] for r in results], context)
            caption = "Points of accuracy lost under each fault, mean over five severities, worst fault first."
            picture = save(figure, folder, f"0-stress-{i}", context, f"{context}: {caption}")
        worst = dict.fromkeys(f"worst.{name}" for r in results for name in under(r, "worst."))
        columns = [*FAILING, *(percent(name, name.replace(".", " ")) for name in worst)]
        sections.append((context, picture, Table(columns, results)))
    return sections


def stream_sections(contexts: dict[str, list[Result]], folder: Path) -> list[Section]:
    """Accuracy against touch seen, and the result of stopping at the learned threshold."""
    sections = []
    for i, (context, results) in enumerate(contexts.items(), 1):
        figure = streaming.draw(results)
        caption = "Left: accuracy against milliseconds of touch. Right: fixed windows and adaptive stopping."
        picture = save(figure, folder, f"0-stream-{i}", context, f"{context}: {caption}")
        sections.append((context, picture, Table(OVER_TIME, results)))
    return sections


def contexts(results: Sequence[Result], score: str = "accuracy") -> dict[str, list[Result]]:
    """Complete results by comparability: for each system, the newest of its lowest seed.

    A result of more faults stands before a newer one of fewer.

    Args:
        results: results of a kind of run.
        score: number by which methods are ordered.

    Returns:
        At most `CONTEXTS` groups, people first and the largest first, each with its `METHODS` most accurate methods.
    """
    complete = [r for r in results if r.complete][::-1]  # the newest first
    groups: dict[tuple, dict[str, Result]] = {}
    several: set[tuple] = set()  # groups that have runs of a system with other seeds
    for r in sorted(complete, key=lambda r: (seed_number(r["seed"]), -len(under(r, "loss.")))):
        if groups.setdefault(r.comparable, {}).setdefault(r["system"], r)["seed"] != r["seed"]:
            several.add(r.comparable)
    ordered = sorted(groups.items(), key=lambda g: (next(iter(g[1].values()))["synthetic"], -len(g[1])))
    named = {}
    for same, members in ordered[:CONTEXTS]:
        best = sorted(members.values(), key=lambda r: -r[score])[:METHODS]
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


def _halves(run: Row) -> str:
    """Each fault with the severity at which half of the margin is lost, the lowest first."""
    halves = sorted(under(run, "half_margin.").items(), key=lambda item: item[1])
    return ", ".join(f"{fault.replace('_', ' ')} {severity:.1f}" for fault, severity in halves) or "nowhere"
