"""How systems behave under faults and over time, on the page: all methods of each context in one figure."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from mlflow.entities import Run

from bench.outcomes.comparable import comparable, context_of, method_of, seed_number
from bench.outcomes.stopping import SHOWN_MS
from bench.outcomes.store import Store
from reports import streaming
from reports.figures import Picture, save
from reports.layout import Block, Table
from reports.stability_figures import heat_map

CONTEXTS = 3  # captures-and-protocol groups that are drawn
METHODS = 10  # of a context


def stress_blocks(store: Store, folder: Path) -> list[Block]:
    """The loss under each fault, and where each method fails first, of the newest complete stress runs."""
    blocks: list[Block] = []
    for number, (context, runs) in enumerate(contexts(store, "stress").items(), 1):
        losses = pd.DataFrame({method_of(r.data.tags): under(r, "loss.") for r in runs}).T
        clean = [r.data.metrics["accuracy"] for r in runs]
        caption = "Points of accuracy lost under each fault, mean over five severities: the costliest fault first."
        if losses.size:  # else learning curves alone
            blocks.append(_picture(heat_map(losses, clean, context), folder, f"0-stress-{number}", context, caption))
        blocks.append(
            Table(
                pd.DataFrame([_failing(r) for r in runs]),
                f"{context}: where each method fails. Half of the margin over chance is lost at the severity of 1 to "
                "5 that stands behind each fault. Failing slices are subjects, gestures, conditions, faults and "
                "pairs of these that are significantly below the method's own accuracy (Benjamini-Hochberg); each "
                "is in stability/stability_slices.csv of the run, beside the curves over severities, training "
                "subjects and lengths of captures.",
            )
        )
    return blocks


def stream_blocks(store: Store, folder: Path) -> list[Block]:
    """Accuracy against touch seen, and what stopping at the learned threshold gives."""
    blocks: list[Block] = []
    for number, (context, runs) in enumerate(contexts(store, "stream").items(), 1):
        rows = [streaming.stream_of(store, r.info.run_id) for r in runs]
        caption = "Left, accuracy against milliseconds of touch seen; right, fixed windows beside adaptive stopping."
        blocks.append(_picture(streaming.draw(rows), folder, f"0-stream-{number}", context, caption))
        blocks.append(
            Table(
                pd.DataFrame([_over_time(r) for r in runs]),
                f"{context}: accuracy of captures in percent after some milliseconds of touch, and of adaptive "
                "stopping with the mean of what it saw; computing time of a decision.",
            )
        )
    return blocks


def contexts(store: Store, kind: str) -> dict[str, list[Run]]:
    """Complete runs by what must agree for them to be compared: of each system and its lowest seed the newest.

    A run that met more faults stands before a newer one that met fewer.

    Returns:
        At most `CONTEXTS` groups, people first and the largest first, each with its `METHODS` most accurate methods.
    """
    runs = store.of_kind(kind, finished=True)
    groups: dict[tuple, dict[str, Run]] = {}
    several: set[tuple] = set()  # groups that have runs of a system with other seeds
    for run in sorted(runs, key=lambda r: (seed_number(r.data.tags["seed"]), -len(under(r, "loss.")))):
        same = comparable(run.data.params | run.data.tags)
        lowest = groups.setdefault(same, {}).setdefault(run.data.tags["system"], run)
        if lowest.data.tags["seed"] != run.data.tags["seed"]:
            several.add(same)
    ordered = sorted(groups.items(), key=lambda g: (next(iter(g[1].values())).data.tags["synthetic"], -len(g[1])))
    found = {}
    for same, members in ordered[:CONTEXTS]:
        best = sorted(members.values(), key=lambda r: -r.data.metrics["accuracy"])[:METHODS]
        left_out = len(members) - len(best)
        words = context_words(best[0]) + (f", {left_out} less accurate methods left out" if left_out else "")
        found[words + (", only the lowest seed of each system" if same in several else "")] = best
    return found


def context_words(run: Run) -> str:
    """What a run is on, and how captures were replayed."""
    params = run.data.params
    parts = [*context_of(run.data.tags)]
    parts += ["from the middle of the capture"] if params.get("stream.start") == "middle" else []
    parts += [f"a decision every {hop} ms"] if (hop := params.get("stream.hop_ms", "None")) != "None" else []
    return ", ".join(parts)


def under(run: Run, prefix: str) -> dict[str, float]:
    """Metrics of a run whose names begin alike, by the rest of their names."""
    return {k.removeprefix(prefix): v for k, v in run.data.metrics.items() if k.startswith(prefix)}


def _failing(run: Run) -> dict[str, str]:
    measured, halves = run.data.metrics, sorted(under(run, "half_margin.").items(), key=lambda item: item[1])
    return {
        "method": method_of(run.data.tags),
        "clean %": f"{100 * measured['accuracy']:.1f}",
        "half of the margin is lost at": ", ".join(f"{k.replace('_', ' ')} {v:.1f}" for k, v in halves) or "nowhere",
        "failing of tested slices": f"{measured['failing_slices']:.0f} of {measured['tested_slices']:.0f}",
        **{f"worst {k}": f"{100 * v:.1f}" for k, v in under(run, "worst.").items()},
    }


def _over_time(run: Run) -> dict[str, str]:
    measured = run.data.metrics

    def percent(name: str) -> str:
        return f"{100 * measured[name]:.1f}" if name in measured else "-"

    return {
        "method": method_of(run.data.tags),
        **{f"{ms} ms": percent(f"accuracy_at_{ms}_ms") for ms in SHOWN_MS},
        "whole": percent("accuracy"),
        "adaptive": percent("adaptive_accuracy"),
        "after ms": f"{measured['adaptive_ms']:.0f}",
        "decision ms p50 / p95": f"{measured['decide_ms_p50']:.1f} / {measured['decide_ms_p95']:.1f}",
    }


def _picture(figure: object, folder: Path, name: str, context: str, caption: str) -> Picture:
    return save(figure, folder, name, name.split("-")[1], context, f"{context}: {caption}")
