"""The certificate of a build: data, what to expect, costs, faults, and what is unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.contract import chosen_values
from bench.corpora.corpus import Corpus
from bench.corpora.duplicates import capture_digests
from bench.corpora.sensor import find_session_column, sensor_table
from bench.reading.frame import runs_table
from bench.reading.scene import Board, Scene
from bench.values import few
from bench.values.measures import value_or_none
from bench.values.result import format_count
from bench.values.sentences import template_environment
from touchbench_builder import systems
from touchbench_builder.bounds import SPREAD
from touchbench_builder.candidates import BITS
from touchbench_builder.fitting import ChosenSystem, train_chosen
from touchbench_builder.sessions import measure_session_cost
from touchbench_builder.stream import (
    bounds_of_counts,
    bounds_of_gestures,
    describe_stream,
    open_stream_captures,
    people_of_rows,
)
from touchbench_builder.systems import WATCH, make_plan, run_plan
from touchbench_chip.write import hash_fixed_code, poisson_upper_rate
from touchbench_streams.recordings import comes_from_recordings
from touchbench_streams.stress import FAULT_SCORES

if TYPE_CHECKING:
    from bench.running.saved import Recogniser
    from touchbench_builder.progress import Progress

CERTIFICATE_VERSION = 2
MAX_LOSS = 10.0  # points of accuracy: a system survives a fault that costs less
FAULT_GROUPS = 4  # of people, left out in turn: losses are differences, so fewer fits will do
FAULT_COLUMNS = ("touches_found", "false_alarms_per_hour")  # told of a stream under a fault


def make_certificate(
    corpus: Corpus,
    on: Mapping[str, str],
    warnings: list[str],
    scene: Scene,
    choice: ChosenSystem,
    command: str,
    progress: Progress,
    no_stream: str,
) -> tuple[Recogniser, dict[str, Any]]:
    """Test the chosen system under faults, and train it on all captures.

    ``no_stream`` is the reason why nothing watches a stream, "" if the choice does.

    Returns:
        The model, and the content of ``certificate.json``.
    """
    progress.start_step(f"{choice.name} under faults of the sensor")
    faults = _fault_losses(on, scene, choice)
    sessions = measure_session_cost(corpus, on, choice)
    progress.start_step(f"{choice.name} on all captures")
    run_id, recogniser, numbers, without = train_chosen(on, choice)
    stream = None
    if choice.watched is not None:
        composed = not comes_from_recordings(open_stream_captures(on, corpus))
        delay = recogniser.watcher.delay
        people = people_of_rows(choice.watched, recogniser.rate_hz, delay)
        stream = describe_stream(people, composed)
    facts = {
        "certificate": CERTIFICATE_VERSION,
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
            "skin": recogniser.design.typed_arguments() if recogniser.design else {},
            "recorded": recogniser.skin.get("recorded"),
            "subjects": sorted(set(corpus.subjects.astype(str))),
            "captures_seen": " ".join(sorted({*filter(None, capture_digests(corpus))})),
            "noise": float(f"{sensor_table(corpus)['noise'].mean():.3g}"),
            "warnings": warnings,
        },
        "system": {
            "name": choice.name,
            "model": f"runs:/{run_id}/model",
            "bits": BITS,
            "code": hash_fixed_code(),
            "chosen": chosen_values(recogniser.estimator),
        },
        "stream": stream,
        "captures": expected_accuracy(choice.captures),
        "systems": _count_systems(choice.systems),
        "compared": choice.table.round(4).replace({np.nan: None}).to_dict("records"),
        "left_out": choice.left_out,
        "runs": choice.runs,
        "budgets": choice.limits,
        "chip": None if numbers is None else _chip_costs(numbers, recogniser, scene.board),
        "board": scene.board and asdict(scene.board),
        "without": without,
        "sessions": sessions,
        "faults": faults,
        "operating_points": operating_points(recogniser),
        "no_stream": no_stream,
        "unknown": unknown_sentences(corpus, sessions is not None),
    }
    return recogniser, facts


def expected_accuracy(labels: pd.DataFrame) -> dict[str, Any]:
    """Correctly classified captures to expect of a new person, of all gestures and of each.

    Args:
        labels: labels of people left out, as `ChosenSystem.captures`.
    """
    right = labels["true"].astype(str) == labels["predicted"].astype(str)
    table = labels.assign(right=right, subject=labels["subject"].astype(str))

    def count(part: pd.DataFrame) -> pd.DataFrame:
        return part.groupby("subject")["right"].agg(right="sum", total="size")

    groups = table.groupby(labels["true"].astype(str))
    gestures = bounds_of_gestures({str(gesture): count(part) for gesture, part in groups})
    return {**bounds_of_counts(count(table), SPREAD), "gestures": gestures}


def _count_systems(systems: Mapping[str, str]) -> dict[str, int]:
    """How often each system was chosen without a person."""
    counts = pd.Series(systems, dtype=str).value_counts()
    return {str(name) or "none": int(number) for name, number in counts.items()}


def _fault_losses(
    on: Mapping[str, str], scene: Scene, choice: ChosenSystem
) -> list[dict[str, Any]]:
    """Losses under each fault: the last severity that costs at most `MAX_LOSS`, and the next."""
    faults = [*(scene.faults or systems.DEFAULT_FAULTS)]
    values = {**on, "protocol": "loso", **choice.values, "under": faults}
    if choice.watched is None:
        cases = runs_table([run_plan(*make_plan(values))], cases=True)
        cases = cases.rename(columns={"case": "fault", "level": "severity"})
    else:
        folds = min(FAULT_GROUPS, len(choice.systems))
        groups = {"protocol": "groupkfold", "protocol.folds": folds}
        cases = run_plan(*make_plan(values | groups, WATCH)).tables[FAULT_SCORES]
        is_clean = cases["severity"] == 0
        cases["loss"] = 100 * (float(cases["end_correct"][is_clean].iloc[0]) - cases["end_correct"])
        cases = cases[~is_clean]
    losses = []
    for name, part in cases.groupby("fault", sort=False):
        row: dict[str, Any] = {"fault": str(name), "survives": None, "fails": None}
        for level in part.sort_values("severity").to_dict("records"):
            is_survived = level["loss"] <= MAX_LOSS
            row["survives" if is_survived else "fails"] = {
                "amount": str(level["amount"]),
                "lost": round(float(level["loss"]), 1),
                **{key: value_or_none(level.get(key)) for key in FAULT_COLUMNS},
            }
            if not is_survived:
                break
        losses.append(row)
    return losses


def _chip_costs(
    numbers: Mapping[str, float], recogniser: Recogniser, board: Board | None
) -> dict[str, Any]:
    """Bytes, instructions, slices, and the share of a board's processor."""
    costs: dict[str, Any] = {n: int(value) for n, value in numbers.items() if n != "delay_s"}
    watcher = recogniser.watcher
    costs |= {"slices": watcher.slices if watcher else 1, "costliest": "observed"}
    costs |= {"delay_ms": round(1000 * numbers["delay_s"]), "processor_share": None}
    if board is not None and board.fpu:
        share = numbers["frame_instructions"] * recogniser.rate_hz / (1e6 * board.clock_mhz)
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


def unknown_sentences(corpus: Corpus, tells_sessions: bool) -> list[str]:
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
    if not tells_sessions:
        reason = "No column names two sessions with enough people"
        if column := find_session_column(corpus):
            reason = f"The column {column} does not have two values with enough people in each"
        sentences.append(f"{reason}: nothing is known of the same sensor on another day.")
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
    env.filters["num"] = format_number
    return env.get_template("certificate.md.jinja").render(**facts) + "\n"


def format_share(share: float | None) -> str:
    """Format a share in percent, or "unknown"."""
    return "unknown" if share is None else f"{100 * share:.1f} %"


def format_number(value: float | None) -> str:
    """Format a number with three digits, or "unknown"."""
    if value is None:
        return "unknown"
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def summary_lines(facts: Mapping[str, Any]) -> list[str]:
    """Summarise the certificate in a line or two."""
    stream, people = facts["stream"], facts["data"]["people"]
    bounds = facts["captures"] if stream is None else stream["last"]
    noun = "correctly classified captures" if stream is None else "of touches named right"
    shares = {name: format_share(bounds[name]) for name in ("mean", "mean_low", "person_low")}
    line = f"{facts['system']['name']}: a new person may expect {shares['mean']} {noun}"
    if bounds["mean_low"] is None:
        return [f"{line}; {format_count(people, 'subject')} are too few for a bound"]
    mean_bound = f"mean of the next {bounds['next_people']} people or more at least"
    person_bound = f"nine of ten people above {shares['person_low']}"
    return [line, f"{mean_bound} {shares['mean_low']} (95 %); {person_bound}"]
