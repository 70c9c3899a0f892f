"""The certificate of a build: what the recogniser was chosen on, what to expect of it, and what the data can't tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench import few
from bench.comparable import several
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.outcomes.scene import Board, Scene
from bench.sentences import environment
from touchbench_builder.bounds import GESTURE_SPREAD, SPREAD, new_person
from touchbench_builder.choice import BITS, OF_STREAMS, Choice, keywords, trained
from touchbench_chip.write import digest

if TYPE_CHECKING:
    from bench.work.saved import Recogniser
    from touchbench_builder.way import Progress

FAULTS = ("dead_taxels", "stuck_taxels", "noise")  # that are tested if the scene names none
LOST = 10.0  # points of accuracy: a system survives a fault that costs less
SESSIONS = ("session", "day", "sitting", "date", "visit")  # columns that tell days apart
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Built:
    """A recogniser and its certificate.

    Attributes:
        recogniser: trained on all captures.
        facts: content of ``certificate.json``.
    """

    recogniser: Recogniser
    facts: dict[str, Any]


def certificate(
    corpus: Corpus,
    on: Mapping[str, Any],
    warnings: list[str],
    scene: Scene,
    choice: Choice,
    command: str,
    progress: Progress,
) -> Built:
    """Test the chosen system under faults, train it on all captures, and write down what is known of it."""
    progress.begin(f"{choice.name} under faults of the sensor")
    faults = _faults(on, scene, choice)
    watched = _watched(on, scene, choice)
    progress.begin(f"{choice.name} on all captures")
    run_id, recogniser, numbers, without = trained(on, choice)
    facts = {
        "certificate": 1,
        "touchbench": version("touchbench"),
        "command": command,
        "data": {
            **{"corpus": corpus.name, "digest": corpus.digest, "where": str(on.get("where", ""))},
            **{"synthetic": corpus.synthetic, "people": len(set(corpus.subjects)), "captures": len(corpus)},
            **{"gestures": recogniser.classes, "grid": list(recogniser.grid), "rate_hz": recogniser.rate_hz},
            **{"full_scale": recogniser.full_scale, "subjects": sorted(set(corpus.subjects.astype(str)))},
            **{"warnings": warnings},
        },
        "system": {"name": choice.name, "model": f"runs:/{run_id}/model", "bits": BITS, "code": digest()},
        "expected": expected(choice.nested),
        "compared": choice.table.round(4).replace({np.nan: None}).to_dict("records"),
        "left_out": choice.left_out,
        "runs": choice.runs,
        "budgets": choice.limits,
        "chip": None if numbers is None else _chip(numbers, recogniser.rate_hz, scene.board),
        "without": without,
        "faults": faults,
        "stream": stream(recogniser),
        "watched": watched,
        "unknown": unknown(corpus),
    }
    return Built(recogniser, facts)


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
            str(gesture): _bounds(part.groupby(people[part.index]).agg(right="sum", total="size"), GESTURE_SPREAD)
            for gesture, part in right.groupby(nested["true"].astype(str))
        },
    }


def _bounds(counts: pd.DataFrame, spread: float) -> dict[str, Any]:
    found = new_person(counts["right"].to_numpy(), counts["total"].to_numpy(), spread)
    return {
        "mean": _rounded(found.mean),
        "mean_low": _rounded(found.mean_low),
        "person_low": _rounded(found.person_low),
        "next_people": found.people,
    }


def _rounded(share: float | None) -> float | None:
    return None if share is None else round(float(share), 4)


def _faults(on: Mapping[str, Any], scene: Scene, choice: Choice) -> list[dict[str, Any]]:
    """What each fault costs the chosen system: the worst severity that costs less than `LOST` points, and the next."""
    import bench

    names = scene.faults.names if scene.faults else FAULTS
    run = bench.run(**keywords({**on, "protocol": "loso", **choice.values, "under": list(names)}))
    cases = bench.runs(cases=True, run=[*run["run_id"]])
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


def _watched(on: Mapping[str, Any], scene: Scene, choice: Choice) -> dict[str, Any] | None:
    """Recordings of people left out, watched by the chosen system, if the scene has budgets of streams."""
    from bench.commands.run import made
    from bench.measures import budgets

    limits = {key: budgets()[key].typed(scene.values[key]) for key in OF_STREAMS if key in scene.values}
    if not limits:
        return None
    run = made("watch", keywords({**on, "protocol": "loso", **choice.values})).iloc[0]
    hours = float(run["background_minutes"]) / 60
    alarms = round(float(run["false_alarms_per_hour"]) * hours)
    found = {
        "background_minutes": round(60 * hours, 1),
        "alarms": alarms,
        "per_hour": round(alarms / hours, 2),
        "at_most_per_hour": round(most(alarms, hours), 2),
        "found": _rounded(run["touches_found"]),
        "latency_ms": round(1000 * float(run["latency_s_p50"])),
    }
    for key, amount in (("max_false_alarms", found["per_hour"]), ("max_latency", found["latency_ms"])):
        if amount > limits.get(key, np.inf):
            cost = budgets()[key]
            words = f"{cost.noun or cost.key} {cost.amount(amount)}, its budget is {cost.amount(limits[key])}"
            raise InputError(f"{choice.name} fits all other budgets, but has {words}; relax it, or record more people")
    return found


def _chip(numbers: Mapping[str, float], rate_hz: float, board: Board | None) -> dict[str, Any]:
    """Bytes and instructions, and shares of a board."""
    found: dict[str, Any] = {name: int(value) for name, value in numbers.items()}
    found |= {"board": None, "processor_share": None}
    if board is not None:
        names = ("title", "flash_kb", "ram_kb", "clock_mhz", "fpu", "share")
        found["board"] = {name: getattr(board, name) for name in names}
    if board is not None and board.fpu:
        found["processor_share"] = round(numbers["frame_instructions"] * rate_hz / (1e6 * board.clock_mhz), 4)
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


def most(events: int, hours: float) -> float:
    """Upper 95 % bound of a rate after so many events (Poisson, exact; 3 / hours after none)."""
    from scipy.special import gammaincinv

    return float(gammaincinv(events + 1, CONFIDENCE)) / hours


def unknown(corpus: Corpus) -> list[str]:
    """What the captures can't tell, in sentences."""
    people, captures = len(set(corpus.subjects)), corpus.captures
    lines = []
    if people < few.INTERVAL:
        lines.append(f"{several(people, 'subject')} were recorded: too few for a bound. Record {few.INTERVAL} or more.")
    columns = [str(c) for c in captures if c not in ("subject", "gesture", "split") and captures[c].nunique() < 50]
    for column in columns:
        if captures[column].nunique(dropna=False) == 1:
            lines.append(f"All captures have {column} {captures[column].iloc[0]}; nothing is known of another one.")
    if not {*map(str.lower, columns)} & {*SESSIONS}:
        lines.append("No column names sessions: nothing is known of the same people and sensor on another day.")
    if corpus.synthetic:
        lines.append("The captures are generated. They say nothing about people.")
    lines.append("Nothing is known of another sensor of this make, or of people unlike the recorded ones.")
    return lines


def page(facts: Mapping[str, Any]) -> str:
    """The certificate as Markdown."""
    env = environment(files("touchbench_builder") / "templates")
    env.filters |= {"pc": lambda share: "unknown" if share is None else f"{100 * share:.1f} %"}
    return env.get_template("certificate.md.jinja").render(**facts)


def line(facts: Mapping[str, Any]) -> list[str]:
    """The certificate in a sentence or two."""
    expect, data = facts["expected"], facts["data"]
    text = (
        f"{facts['system']['name']}: a new person may expect {100 * expect['mean']:.1f} % correctly classified captures"
    )
    if expect["mean_low"] is None:
        return [f"{text}; {several(data['people'], 'subject')} are too few for a bound"]
    bounds = f"mean of the next {expect['next_people']} people or more at least {100 * expect['mean_low']:.1f} % (95 %)"
    return [text, f"{bounds}; nine of ten people above {100 * expect['person_low']:.1f} %"]


def read(text: str, where: str) -> dict[str, Any]:
    """The content of ``certificate.json``."""
    import json

    try:
        facts = json.loads(text)
        if facts["certificate"] != 1:
            raise ValueError("another version wrote it")
        return facts
    except (ValueError, KeyError, TypeError) as e:
        raise InputError(f"{where}: no certificate of bench build ({e}); build it again") from e
