"""The certificate of a build: data, accuracy to expect, costs, faults, and what is unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.duplicates import capture_digests
from bench.errors import InputError
from bench.reading.frame import runs_table
from bench.reading.scene import Board, Scene
from bench.values import few
from bench.values.measures import costs_by_budget
from bench.values.result import format_count
from bench.values.sentences import template_environment
from touchbench_builder import systems
from touchbench_builder.bounds import GESTURE_SPREAD, SPREAD, new_person_bounds
from touchbench_builder.systems import (
    BITS,
    STREAM_BUDGETS,
    ChosenSystem,
    make_plan,
    run_plan,
    train_chosen,
)
from touchbench_chip.tables import check_exportable
from touchbench_chip.write import hash_fixed_code, poisson_upper_rate

if TYPE_CHECKING:
    from bench.running.saved import Recogniser
    from touchbench_builder.progress import Progress

MAX_LOSS = 10.0  # points of accuracy: a system survives a fault that costs less
SESSION_COLUMNS = ("session", "day", "sitting", "date", "visit")  # columns that tell days apart


def make_certificate(
    corpus: Corpus,
    on: Mapping[str, str],
    warnings: list[str],
    scene: Scene,
    choice: ChosenSystem,
    command: str,
    progress: Progress,
) -> tuple[Recogniser, dict[str, Any]]:
    """Test the chosen system under faults, and train it on all captures.

    Returns:
        The model, and the content of ``certificate.json``.
    """
    progress.start_step(f"{choice.name} under faults of the sensor")
    faults = _fault_losses(on, scene, choice)
    watched = _watch_recordings(on, scene, choice)
    progress.start_step(f"{choice.name} on all captures")
    run_id, recogniser, numbers, without = train_chosen(on, choice, scene)
    facts = {
        "certificate": 1,
        "touchbench": version("touchbench"),
        "command": command,
        "data": {
            "corpus": corpus.name,
            "digest": corpus.digest,
            "where": on.get("where", ""),
            "synthetic": corpus.synthetic,
            "people": len(set(corpus.subjects)),
            "captures": len(corpus),
            "gestures": recogniser.classes,
            "grid": list(recogniser.grid),
            "rate_hz": recogniser.rate_hz,
            "full_scale": recogniser.full_scale,
            "subjects": sorted(set(corpus.subjects.astype(str))),
            "captures_seen": " ".join(sorted({*filter(None, capture_digests(corpus))})),
            "warnings": warnings,
        },
        "system": {
            "name": choice.name,
            "model": f"runs:/{run_id}/model",
            "bits": BITS,
            "code": hash_fixed_code(),
        },
        "expected": expected_accuracy(choice.nested),
        "compared": choice.table.round(4).replace({np.nan: None}).to_dict("records"),
        "left_out": choice.left_out,
        "runs": choice.runs,
        "budgets": choice.limits,
        "chip": None if numbers is None else _chip_costs(numbers, recogniser.rate_hz, scene.board),
        "without": without,
        "faults": faults,
        "stream": operating_points(recogniser),
        "no_stream": _why_no_stream(recogniser, without),
        "watched": watched,
        "unknown": unknown_sentences(corpus),
    }
    return recogniser, facts


def expected_accuracy(nested: pd.DataFrame) -> dict[str, Any]:
    """Accuracy to expect for a new person, of all gestures and of each.

    Args:
        nested: labels of people left out, as `ChosenSystem.nested`.
    """
    right = nested["true"].astype(str) == nested["predicted"].astype(str)
    people = nested["subject"].astype(str)
    counts = _count_by_person(right, people)
    chosen = nested.groupby(people)["system"].first()
    gestures = {}
    for gesture, part in right.groupby(nested["true"].astype(str)):
        gestures[str(gesture)] = _rounded_bounds(_count_by_person(part, people), GESTURE_SPREAD)
    return {
        **_rounded_bounds(counts, SPREAD),
        "people": {str(p): [int(row["right"]), int(row["total"])] for p, row in counts.iterrows()},
        "systems": {str(name) or "none": int(n) for name, n in chosen.value_counts().items()},
        "gestures": gestures,
    }


def _count_by_person(right: pd.Series, people: pd.Series) -> pd.DataFrame:
    return right.groupby(people[right.index]).agg(right="sum", total="size")


def _rounded_bounds(counts: pd.DataFrame, spread: float) -> dict[str, Any]:
    right, total = counts["right"].to_numpy(), counts["total"].to_numpy()
    bounds = asdict(new_person_bounds(right, total, spread))
    return {name: value if value is None else round(value, 4) for name, value in bounds.items()}


def _fault_losses(
    on: Mapping[str, str], scene: Scene, choice: ChosenSystem
) -> list[dict[str, Any]]:
    """Losses under each fault: the last severity that costs at most `MAX_LOSS`, and the next."""
    faults = [*(scene.faults or systems.DEFAULT_FAULTS)]
    values = {**on, "protocol": "loso", **choice.values, "under": faults}
    cases = runs_table([run_plan(*make_plan(values))], cases=True)
    losses = []
    for name, part in cases.groupby("case", sort=False):
        row = {"fault": str(name), "survives": None, "lost": None}
        row |= {"fails": None, "lost_there": None}
        for level in part.sort_values("level").itertuples():
            if level.loss > MAX_LOSS:
                row |= {"fails": str(level.amount), "lost_there": round(float(level.loss), 1)}
                break
            row |= {"survives": str(level.amount), "lost": round(float(level.loss), 1)}
        losses.append(row)
    return losses


def _watch_recordings(
    on: Mapping[str, str], scene: Scene, choice: ChosenSystem
) -> dict[str, Any] | None:
    """Results in recordings of people left out; None if the scene has no budgets of streams."""
    costs = {key: costs_by_budget()[key] for key in STREAM_BUDGETS if key in scene.values}
    limits = {key: cost.parse_budget(scene.values[key]) for key, cost in costs.items()}
    if not limits:
        return None
    numbers = run_plan(*make_plan({**on, "protocol": "loso", **choice.values}, "watch")).metrics
    rate, minutes = numbers.get("false_alarms_per_hour"), numbers["background_minutes"]
    for key, cost in costs.items():
        limit = limits[key]
        amount = cost.value_of_row(numbers) if cost.of_people is None else rate
        if amount is None:
            raise InputError(
                f"{choice.name}: {cost.noun} is unknown: {cost.why_unknown}; leave {key}= out of "
                "the scene"
            )
        if amount > limit:
            amounts = f"{cost.format_amount(amount)}, its budget is {cost.format_amount(limit)}"
            raise InputError(
                f"{choice.name} fits all other budgets, but has {cost.noun} {amounts}; relax it, "
                "or record more people"
            )
    latency = numbers.get("latency_s_p50")
    found = {"background_minutes": round(minutes, 1), "alarms": None}
    found |= {"per_hour": None, "at_most_per_hour": None}
    if rate is not None:
        alarms, hours = round(rate * minutes / 60), minutes / 60
        upper_rate = round(poisson_upper_rate(alarms, hours), 2)
        found |= {"alarms": alarms, "per_hour": round(rate, 2), "at_most_per_hour": upper_rate}
    found["found"] = round(numbers["touches_found"], 4)
    return found | {"latency_ms": None if latency is None else round(1000 * latency)}


def _chip_costs(
    numbers: Mapping[str, float], rate_hz: float, board: Board | None
) -> dict[str, Any]:
    """Bytes, instructions, and the share of a board's processor."""
    costs: dict[str, Any] = {name: int(value) for name, value in numbers.items()}
    costs |= {"board": None, "processor_share": None}
    if board is not None:
        names = ("title", "flash_kb", "ram_kb", "clock_mhz", "fpu", "share")
        costs["board"] = {name: getattr(board, name) for name in names}
        if board.fpu:
            share = numbers["frame_instructions"] * rate_hz / (1e6 * board.clock_mhz)
            costs["processor_share"] = round(share, 4)
    return costs


def operating_points(recogniser: Recogniser) -> dict[str, Any] | None:
    """Operating points of a model that watches a stream, from training people left out."""
    if (watcher := recogniser.watcher) is None:
        return None
    points = [
        {
            "found": round(found, 4),
            "alarms": int(alarms),
            "at_most_per_hour": round(poisson_upper_rate(int(alarms), hours), 2) if hours else None,
            "initial": bool(np.isclose(level, watcher.level)),
        }
        for level, alarms, hours, found in watcher.points
    ]
    minutes = 60 * max((point[2] for point in watcher.points), default=0)
    soonest = 1000 * watcher.soonest / recogniser.rate_hz
    return {"background_minutes": round(minutes, 1), "soonest_ms": round(soonest), "points": points}


def _why_no_stream(recogniser: Recogniser, without: str) -> str:
    """Reason why a model does not watch a stream, or ""."""
    if recogniser.watcher is not None:
        return ""
    if without:
        return "the budgets have no room for the detector"
    if check_exportable(recogniser.estimator):
        return "the captures cannot teach a detector of touches"
    return "the C of this system cannot watch a stream"


def unknown_sentences(corpus: Corpus) -> list[str]:
    """What the captures can't tell, in sentences."""
    people, captures = len(set(corpus.subjects)), corpus.captures
    sentences = []
    if people < few.FEWEST_FOR_INTERVAL:
        sentences.append(
            f"{format_count(people, 'subject')} were recorded: too few for a bound. Record "
            f"{few.FEWEST_FOR_INTERVAL} or more."
        )
    others = captures.drop(columns=["subject", "gesture", "split"], errors="ignore")
    columns = [str(name) for name in others if captures[name].nunique() < 50]
    for column in columns:
        if captures[column].nunique(dropna=False) == 1:
            value = captures[column].iloc[0]
            sentences.append(
                f"All captures have {column} {value}; nothing is known of another one."
            )
    if not {*map(str.lower, columns)} & {*SESSION_COLUMNS}:
        sentences.append(
            "No column names sessions: nothing is known of the same people and sensor on another "
            "day."
        )
    if corpus.synthetic:
        sentences.append("The captures are generated. They say nothing about people.")
    sentences.append(
        "Nothing is known of another sensor of this make, or of people unlike the recorded ones."
    )
    return sentences


def render_page(facts: Mapping[str, Any]) -> str:
    """Render the certificate as Markdown."""
    env = template_environment(files("touchbench_builder") / "templates")
    env.filters["pc"] = format_share
    return env.get_template("certificate.md.jinja").render(**facts)


def format_share(share: float | None) -> str:
    """Format a share in percent, or "unknown"."""
    return "unknown" if share is None else f"{100 * share:.1f} %"


def summary_lines(facts: Mapping[str, Any]) -> list[str]:
    """Summarise the certificate in a line or two."""
    bounds, data = facts["expected"], facts["data"]
    shares = {name: format_share(bounds[name]) for name in ("mean", "mean_low", "person_low")}
    expect = f"a new person may expect {shares['mean']} correctly classified captures"
    line = f"{facts['system']['name']}: {expect}"
    if bounds["mean_low"] is None:
        return [f"{line}; {format_count(data['people'], 'subject')} are too few for a bound"]
    mean_bound = f"mean of the next {bounds['next_people']} people or more at least"
    person_bound = f"nine of ten people above {shares['person_low']}"
    return [line, f"{mean_bound} {shares['mean_low']} (95 %); {person_bound}"]
