"""The ways in which a run labels, for a choice: Python on captures, windows or early, and systems that watch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from bench.candidate import EARLY, Candidate, Wish
from bench.errors import InputError
from bench.outcomes.reactions import by_capture, by_decision
from bench.outcomes.runs import subject_accuracy
from bench.outcomes.scores import captures
from bench.outcomes.stopping import standing
from bench.paired import TOLERANCE
from bench.result import Result
from bench.usual import DETECTOR, FALSE_ALARMS, NO_TOUCH

NAMED = 3  # systems that a line names
WINDOW = {"predict": "decide_ms_p50", "decision": "observed_ms"}  # what the costs of single windows read


def plain_candidates(result: Result, wish: Wish) -> Iterator[Candidate]:
    """The system in Python on whole captures, or on windows if these are wished."""
    reactions = wish.reactions
    if wish.windows:
        table = result.tables["predictions"]
        yield Candidate("window", reactions.scores(by_decision(table, reactions)), WINDOW)
        return
    # What the run stored is the same and quick: reading the predictions of 1000 runs takes a minute.
    stored = pd.Series(subject_accuracy(result), dtype=float) if reactions.plain else pd.Series(dtype=float)
    scores = stored if len(stored) else reactions.scores(by_capture(result.tables["predictions"], reactions))
    yield Candidate("capture", scores, whole=True)


def early_candidates(result: Result, wish: Wish) -> Iterator[Candidate]:
    """A replayed system after the last time that is soon enough, or after each; none where no time was asked for."""
    if wish.most is None:
        return
    table, instants = result.tables["replay"], result.tables["instants"]["ms"].tolist()
    decided = [*zip(instants, np.sort(table["instant"].unique()), strict=True)]  # ms, frames
    if np.isfinite(wish.most):  # the last that is soon enough, else the first
        decided = [one for one in decided if one[0] <= wish.most * (1 + TOLERANCE)][-1:] or decided[:1]
    for ms, frames in decided:
        scores = wish.reactions.scores(by_decision(standing(table, frames), wish.reactions))
        apart, stored = (str(result["stream.hop_ms"]),), {"predict": "replay_ms_p50"}
        yield Candidate(f"first {ms:.0f} ms", scores, stored, {"decision": ms}, apart, mark=EARLY)


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
    detector = str(result.get("watch.detector") or DETECTOR)  # an earlier version had one
    unit += "" if detector == DETECTOR else f", detector={detector}"
    alarms = (shares["false_alarms_per_hour"] * hours).fillna(0)
    yield Candidate(unit, scores, {"decision": "", "cycles": ""}, counts=(alarms, hours), whole=True)


def watched_gestures(result: Result) -> tuple[str, ...]:
    """All gestures of the recordings of a run, and the background."""
    touches = result.tables["touches"]
    return tuple(sorted({*touches["gesture"].astype(str), str(result["watch.background"]) or NO_TOUCH}))


def one_label(results: Sequence[Result]) -> str:
    """A warning of systems that predict one label for all test captures of a fold with several classes."""
    systems = []
    for result in results:
        predictions = result.tables.get("predictions")
        if predictions is None:
            continue
        labels = captures(predictions).groupby("fold", sort=False)[["true", "predicted"]].nunique()
        if count := int(((labels["true"] > 1) & (labels["predicted"] == 1)).sum()):
            systems.append(f"{result['system']} in {count} of {len(labels)} folds")
    named = "; ".join(systems[:NAMED]) + (f" and {len(systems) - NAMED} more systems" if len(systems) > NAMED else "")
    return f"warning: all test captures of a fold get the same label: {named}" if systems else ""
