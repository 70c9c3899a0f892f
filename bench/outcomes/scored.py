"""The ways in which a run on captures labels, for a choice: Python on captures, on windows or early."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.candidate import EARLY, Candidate, Wish
from bench.intervals import TOLERANCE
from bench.outcomes.reactions import by_capture, by_decision
from bench.result import Result
from bench.work.stopping import standing

WINDOW = {"predict": "decide_ms_p50", "decision": "observed_ms"}  # what the costs of single windows read


def plain_candidates(result: Result, wish: Wish) -> Iterator[Candidate]:
    """The system in Python on whole captures, or on windows if these are wished."""
    reactions = wish.reactions
    if wish.windows:
        table = result.tables["predictions"]
        yield Candidate("window", reactions.scores(by_decision(table, reactions)), WINDOW)
        return
    # What the run stored is the same and quick: reading the predictions of 1000 runs takes a minute.
    stored = result.people if reactions.plain else {}
    scores = stored or reactions.scores(by_capture(result.tables["predictions"], reactions))
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
        hop, stored = str(result["stream.hop_ms"]), {"predict": "replay_ms_p50"}
        apart = (f"every {hop} ms",) if hop != "None" else ()
        yield Candidate(f"first {ms:.0f} ms", scores, stored, {"decision": ms}, apart, mark=EARLY)
