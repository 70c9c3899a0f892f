"""The certificate of a build: what the recogniser was chosen on, what to expect of it, and what the data can't tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.reading.frame import frame
from bench.reading.scene import Board, Scene
from bench.values import few
from bench.values.measures import budgets
from bench.values.result import several
from bench.values.sentences import environment
from touchbench_builder import choice as choices
from touchbench_builder.bounds import GESTURE_SPREAD, SPREAD, new_person
from touchbench_builder.choice import BITS, OF_STREAMS, Choice, planned, run, trained
from touchbench_chip.tables import check
from touchbench_chip.write import digest, most

if TYPE_CHECKING:
    from bench.running.saved import Recogniser
    from touchbench_builder.progress import Progress

LOST = 10.0  # points of accuracy: a system survives a fault that costs less
SESSIONS = ("session", "day", "sitting", "date", "visit")  # columns that tell days apart


def certificate(
    corpus: Corpus,
    on: Mapping[str, str],
    warnings: list[str],
    scene: Scene,
    choice: Choice,
    command: str,
    progress: Progress,
) -> tuple[Recogniser, dict[str, Any]]:
    """Test the chosen system under faults, train it on all captures: the model, and content of ``certificate.json``."""
    progress.begin(f"{choice.name} under faults of the sensor")
    faults = _faults(on, scene, choice)
    watched = _watched(on, scene, choice)
    progress.begin(f"{choice.name} on all captures")
    run_id, recogniser, numbers, without = trained(on, choice, scene)
    facts = {
        "certificate": 1,
        "touchbench": version("touchbench"),
        "command": command,
        "data": {
            **{"corpus": corpus.name, "digest": corpus.digest, "where": on.get("where", "")},
            **{
                "synthetic": corpus.synthetic,
                "people": len(set(corpus.subjects)),
                "captures": len(corpus),
            },
            **{
                "gestures": recogniser.classes,
                "grid": list(recogniser.grid),
                "rate_hz": recogniser.rate_hz,
            },
            **{
                "full_scale": recogniser.full_scale,
                "subjects": sorted(set(corpus.subjects.astype(str))),
            },
            **{"warnings": warnings},
        },
        "system": {
            "name": choice.name,
            "model": f"runs:/{run_id}/model",
            "bits": BITS,
            "code": digest(),
        },
        "expected": expected(choice.nested),
        "compared": choice.table.round(4).replace({np.nan: None}).to_dict("records"),
        "left_out": choice.left_out,
        "runs": choice.runs,
        "budgets": choice.limits,
        "chip": None if numbers is None else _chip(numbers, recogniser.rate_hz, scene.board),
        "without": without,
        "faults": faults,
        "stream": stream(recogniser),
        "no_stream": _no_stream(recogniser, without),
        "watched": watched,
        "unknown": unknown(corpus),
    }
    return recogniser, facts


def expected(nested: pd.DataFrame) -> dict[str, Any]:
    """Accuracy to expect for a new person, of all gestures and of each, from labels of people left out."""
    right = nested["true"].astype(str) == nested["predicted"].astype(str)
    people = nested["subject"].astype(str)
    counts = right.groupby(people).agg(right="sum", total="size")
    chosen = nested.groupby(people)["system"].first()
    return {
        **_bounds(counts, SPREAD),
        "people": {str(p): [int(row["right"]), int(row["total"])] for p, row in counts.iterrows()},
        "systems": {str(name) or "none": int(n) for name, n in chosen.value_counts().items()},
        "gestures": {
            str(gesture): _bounds(
                part.groupby(people[part.index]).agg(right="sum", total="size"), GESTURE_SPREAD
            )
            for gesture, part in right.groupby(nested["true"].astype(str))
        },
    }


def _bounds(counts: pd.DataFrame, spread: float) -> dict[str, Any]:
    found = asdict(new_person(counts["right"].to_numpy(), counts["total"].to_numpy(), spread))
    return {name: value if value is None else round(value, 4) for name, value in found.items()}


def _faults(on: Mapping[str, str], scene: Scene, choice: Choice) -> list[dict[str, Any]]:
    """What each fault costs the chosen system: the worst severity that costs less than `LOST` points, and the next."""
    under = [*(scene.faults.names if scene.faults else choices.FAULTS)]
    cases = frame(
        [run(*planned({**on, "protocol": "loso", **choice.values, "under": under}))], cases=True
    )
    found = []
    for name, part in cases.groupby("case", sort=False):
        part = part.sort_values("level")
        bad = part[part["loss"] > LOST]
        good = part[part["level"] < bad["level"].min()] if len(bad) else part
        found.append(
            {
                "fault": str(name),
                "survives": None if good.empty else str(good["amount"].iloc[-1]),
                "lost": None if good.empty else round(float(good["loss"].iloc[-1]), 1),
                "fails": None if bad.empty else str(bad["amount"].iloc[0]),
                "lost_there": None if bad.empty else round(float(bad["loss"].iloc[0]), 1),
            }
        )
    return found


def _watched(on: Mapping[str, str], scene: Scene, choice: Choice) -> dict[str, Any] | None:
    """Recordings of people left out, watched by the chosen system, if the scene has budgets of streams."""
    limits = {
        key: budgets()[key].typed(scene.values[key]) for key in OF_STREAMS if key in scene.values
    }
    if not limits:
        return None
    numbers = run(*planned({**on, "protocol": "loso", **choice.values}, "watch")).metrics
    for key, limit in limits.items():
        cost = budgets()[key]
        if (
            amount := cost.cell(numbers)
            if cost.among is None
            else numbers.get("false_alarms_per_hour")
        ) is None:
            raise InputError(
                f"{choice.name}: {cost.noun} is unknown: {cost.unknown}; leave {key}= out of the scene"
            )
        if amount > limit:
            words = f"{cost.noun} {cost.amount(amount)}, its budget is {cost.amount(limit)}"
            raise InputError(
                f"{choice.name} fits all other budgets, but has {words}; relax it, or record more people"
            )
    minutes, rate, latency = map(
        numbers.get, ("background_minutes", "false_alarms_per_hour", "latency_s_p50")
    )
    alarms = None if rate is None else round(rate * minutes / 60)
    return {
        "background_minutes": round(minutes, 1),
        "alarms": alarms,
        "per_hour": None if rate is None else round(rate, 2),
        "at_most_per_hour": None if alarms is None else round(most(alarms, minutes / 60), 2),
        "found": round(numbers["touches_found"], 4),
        "latency_ms": None if latency is None else round(1000 * latency),
    }


def _chip(numbers: Mapping[str, float], rate_hz: float, board: Board | None) -> dict[str, Any]:
    """Bytes and instructions, and shares of a board."""
    found: dict[str, Any] = {name: int(value) for name, value in numbers.items()}
    found |= {"board": None, "processor_share": None}
    if board is not None:
        names = ("title", "flash_kb", "ram_kb", "clock_mhz", "fpu", "share")
        found["board"] = {name: getattr(board, name) for name in names}
    if board is not None and board.fpu:
        found["processor_share"] = round(
            numbers["frame_instructions"] * rate_hz / (1e6 * board.clock_mhz), 4
        )
    return found


def stream(recogniser: Recogniser) -> dict[str, Any] | None:
    """Operating points of a model that watches a stream: alarms and minutes of training people left out."""
    if (watcher := recogniser.watcher) is None:
        return None
    points = [
        {
            "found": round(found, 4),
            "alarms": int(alarms),
            "at_most_per_hour": round(most(int(alarms), hours), 2) if hours else None,
            "initial": bool(np.isclose(level, watcher.level)),
        }
        for level, alarms, hours, found in watcher.points
    ]
    minutes = 60 * max((point[2] for point in watcher.points), default=0)
    soonest = 1000 * watcher.soonest / recogniser.rate_hz
    return {"background_minutes": round(minutes, 1), "soonest_ms": round(soonest), "points": points}


def _no_stream(recogniser: Recogniser, without: str) -> str:
    """Why a model does not watch a stream; empty if it does."""
    if recogniser.watcher is not None:
        return ""
    if without:
        return "the budgets have no room for the detector"
    can = check(recogniser.estimator)
    return (
        "the captures cannot teach a detector of touches"
        if can
        else "the C of this system cannot watch a stream"
    )


def unknown(corpus: Corpus) -> list[str]:
    """What the captures can't tell, in sentences."""
    people, captures = len(set(corpus.subjects)), corpus.captures
    lines = []
    if people < few.INTERVAL:
        lines.append(
            f"{several(people, 'subject')} were recorded: too few for a bound. Record {few.INTERVAL} or more."
        )
    columns = [
        str(c)
        for c in captures
        if c not in ("subject", "gesture", "split") and captures[c].nunique() < 50
    ]
    for column in columns:
        if captures[column].nunique(dropna=False) == 1:
            lines.append(
                f"All captures have {column} {captures[column].iloc[0]}; nothing is known of another one."
            )
    if not {*map(str.lower, columns)} & {*SESSIONS}:
        lines.append(
            "No column names sessions: nothing is known of the same people and sensor on another day."
        )
    if corpus.synthetic:
        lines.append("The captures are generated. They say nothing about people.")
    lines.append(
        "Nothing is known of another sensor of this make, or of people unlike the recorded ones."
    )
    return lines


def page(facts: Mapping[str, Any]) -> str:
    """The certificate as Markdown."""
    env = environment(files("touchbench_builder") / "templates")
    env.filters["pc"] = percent
    return env.get_template("certificate.md.jinja").render(**facts)


def percent(share: float | None) -> str:
    """A share in words."""
    return "unknown" if share is None else f"{100 * share:.1f} %"


def line(facts: Mapping[str, Any]) -> list[str]:
    """The certificate in a sentence or two."""
    expect, data = facts["expected"], facts["data"]
    text = f"{facts['system']['name']}: a new person may expect {percent(expect['mean'])} correctly classified captures"
    if expect["mean_low"] is None:
        return [f"{text}; {several(data['people'], 'subject')} are too few for a bound"]
    bounds = f"mean of the next {expect['next_people']} people or more at least {percent(expect['mean_low'])} (95 %)"
    return [text, f"{bounds}; nine of ten people above {percent(expect['person_low'])}"]
