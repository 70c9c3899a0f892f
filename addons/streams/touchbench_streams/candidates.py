"""How a system that watched recordings is chosen by."""

from __future__ import annotations

from collections.abc import Iterator

from bench.candidate import Candidate, Wish
from bench.errors import InputError
from bench.result import Result
from bench.words import labelled
from touchbench_streams import DETECTOR, FALSE_ALARMS, NO_TOUCH


def watched_candidates(result: Result, wish: Wish, unit: str) -> Iterator[Candidate]:
    """A system as it watched recordings, with false alarms and hours of background by subject."""
    shares = result.tables["per_subject"].set_index("subject")
    if "background_s" not in shares:
        raise InputError(f"{result['system']}: an older version stored this run of bench watch; run it again")
    scores, hours = 100 * shares["end_correct"].dropna(), shares["background_s"] / 3600
    if not wish.reactions.plain:
        wish.reactions.of(watched_gestures(result))  # refuses other names
        scores = wish.reactions.scores(
            result.tables["touches"].rename(columns={"gesture": "true", "label": "predicted"})
        )
    aim = float(result["watch.false_alarms"])
    unit += "" if aim == FALSE_ALARMS else f", false_alarms={aim:g}"
    detector = str(result.get("watch.detector") or DETECTOR)
    unit += "" if detector == DETECTOR else f", detector={detector}"
    alarms = (shares["false_alarms_per_hour"] * hours).fillna(0)
    shipped = {"background": str(result.get("watch.background") or "")} | labelled("detector", detector)
    shipped["false_alarms"] = f"{aim:g}"
    usual = {"background": "", "detector": DETECTOR, "false_alarms": f"{FALSE_ALARMS:g}"}  # of bench fit
    shipped = {key: value for key, value in shipped.items() if usual.get(key) != value}
    yield Candidate(unit, scores, counts=(alarms, hours), whole=True, shipped=shipped)


def watched_gestures(result: Result) -> tuple[str, ...]:
    """All gestures of the recordings of a run, and the background."""
    touches = result.tables["touches"]
    return tuple(sorted({*touches["gesture"].astype(str), str(result["watch.background"]) or NO_TOUCH}))
