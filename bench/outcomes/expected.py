"""What to expect from a choice: for new people, with other people, with more people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bench import few, resampling
from bench.measures import costs
from bench.outcomes.candidates import Candidates
from bench.outcomes.choice import named, said
from bench.outcomes.pick import People, fitting, pick
from bench.outcomes.reactions import Reactions
from bench.paired import interval
from bench.table import rows_of
from bench.work import stability

DRAWS = 1000  # of people with replacement
POWER, LEVEL = 0.8, 0.05  # of the paired t-test, two-sided
MORE = (5, 10, 20)  # training people
SHOWN = 3  # systems that a sentence names


@dataclass(frozen=True)
class Expected:
    """What to expect from a choice.

    Attributes:
        scores: score of each person, with the system that is chosen without this person, in percent; NaN where none is.
        without: number of the candidate chosen without each person, -1 for none [people].
        shares: share of the drawings of people in which each candidate is chosen [candidates].
        rival: number of the candidate that is chosen most often beside the chosen one, or the most accurate other one
            that fits; None without one.
        difference: its score less that of the chosen one, in points; NaN without one.
        smallest: difference of these two that so many people can show; NaN if they are too few for a p value.
    """

    scores: np.ndarray
    without: np.ndarray
    shares: np.ndarray
    rival: int | None = None
    difference: float = np.nan
    smallest: float = np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % t-interval of the mean of `scores`, up to 100."""
        low, high = interval(self.scores)
        return low, min(high, 100.0)


def expected(
    people: People, chosen: int, by: str, budgets: Mapping[str, float], margin: float | None
) -> Expected | None:
    """Repeat a choice without each person, and with people drawn with replacement.

    Scores, losses under faults, worst people and false alarms are computed again from the people that are left. Latency
    and decision time are medians of all people and do not change.

    Args:
        people: contribution of each person to scores and costs, from `bench.outcomes.candidates`.
        chosen: number of the candidate that all people choose.
        by: the cost to minimise.
        budgets: budget of each cost.
        margin: points that do not matter, or None.

    Returns:
        None for fewer than `bench.few.INTERVAL` people, or one candidate.
    """
    candidates, count = people.scores.shape
    if count < few.INTERVAL or candidates < 2:
        return None

    def choices(drawn: np.ndarray) -> np.ndarray:
        amounts = {name: people.cost(name, drawn) for name in budgets}
        fits = np.broadcast_to(fitting(amounts, budgets, candidates), (len(drawn), candidates))
        return pick(people.scores, drawn, fits, costs()[by].burden(people.cost(by, drawn)), margin)[0]

    others = np.array([[k for k in range(count) if k != person] for person in range(count)])
    without = choices(others)
    scores = np.where(without < 0, np.nan, people.scores[without, np.arange(count)])
    drawn = choices(resampling.drawn(count, DRAWS))
    shares = np.bincount(drawn[drawn >= 0], minlength=candidates) / DRAWS
    everyone = np.arange(count)[None]
    fits = fitting({name: people.cost(name, everyone)[0] for name in budgets}, budgets, candidates)
    means = people.scores.mean(axis=1)
    rank = np.where(fits & np.isfinite(means), means, -np.inf) + 1e6 * shares
    rank[chosen] = -np.inf
    rival = int(rank.argmax())
    if not np.isfinite(rank[rival]):
        return Expected(scores, without, shares)
    differences = people.scores[rival] - people.scores[chosen]
    difference, spread = float(differences.mean()), float(differences.std(ddof=1))
    smallest = detectable(spread, count) if count >= few.TEST else np.nan
    return Expected(scores, without, shares, rival, difference, smallest)


def expectation(one: Expected | None, among: Candidates, chosen: int | None) -> list[str]:
    """What to expect for new people, how stable the choice is, and what would change it, in sentences.

    Args:
        one: result of `expected`; None gives no sentence.
        among: candidates.
        chosen: number of the chosen one.
    """
    if one is None or chosen is None:
        return []
    rows = rows_of(among.table)
    order = [int(i) for i in np.argsort(-one.shares, kind="stable") if one.shares[i] > 0]
    nothing = float(1 - one.shares.sum())
    changes: dict[str, list[str]] = {}
    for person, i in zip(among.subjects, one.without, strict=True):
        if i != chosen:
            changes.setdefault("nothing" if i < 0 else named(rows[i]), []).append(str(person))
    return said(
        "expectation",
        chosen=rows[chosen],
        people=among.subjects.shape[1],
        mixed=among.mixed,
        failed=int(np.isnan(one.scores).sum()),
        mean=one.scores.mean(),
        interval=one.interval,
        draws=DRAWS,
        shares=[(rows[i], one.shares[i]) for i in order],
        shown=SHOWN,
        nothing=nothing if nothing > 0.5 / DRAWS else 0,
        changes=changes,
        rival=None if one.rival is None else rows[one.rival],
        difference=one.difference,
        smallest=None if np.isnan(one.smallest) else one.smallest,
    )


def power(difference: float, spread: float, people: int) -> float:
    """Power of a two-sided paired t-test at `LEVEL`.

    Args:
        difference: true mean difference.
        spread: its SD over people, above 0.
        people: number of people, 2 or more.
    """
    from scipy.special import nctdtr, stdtrit

    limit, shift = stdtrit(people - 1, 1 - LEVEL / 2), abs(difference) / spread * np.sqrt(people)
    share = 1 - nctdtr(people - 1, shift, limit) + nctdtr(people - 1, shift, -limit)
    return 1.0 if np.isnan(share) else float(share)  # SciPy gives NaN for very large shifts


def detectable(spread: float, people: int) -> float:
    """The smallest difference that so many people show with `POWER`; arguments as of `power`."""
    if not spread:
        return 0.0
    low, high = 0.0, spread / 100
    while power(high, spread, people) < POWER:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if power(middle, spread, people) >= POWER else (middle, high)
    return high


def more_people(table: pd.DataFrame, reactions: Reactions) -> tuple[int, pd.DataFrame] | None:
    """The gain of more training people, from a learning curve.

    The score is taken as a - b / n for n training people, fitted by least squares to the means over subjects.

    Args:
        table: labels of a run with ``train_subjects=`` (`bench.work.curves`). Whole training sets of
            different size count as their mean.
        reactions: reactions that are scored.

    Returns:
        The largest number of training people, and a row per number of `MORE`: ``more``, ``gain`` in points, ``low`` and
        ``high`` (95 % bootstrap interval over subjects). None for fewer than three numbers of training people, or
        fewer than `bench.few.INTERVAL` subjects.
    """
    clean = stability.as_they_are(table)
    numbered = stability.trained_on(clean)
    parts = {n: reactions.scores(clean[numbered == n]) for n in sorted({*numbered})}
    curve = pd.DataFrame(parts).dropna()  # [subjects, numbers]
    if curve.shape[1] < 3 or len(curve) < few.INTERVAL:
        return None
    numbers = curve.columns.to_numpy()
    solve = np.linalg.pinv(np.column_stack([np.ones(len(numbers)), -1 / numbers]))
    drawn = resampling.drawn(len(curve), DRAWS)
    scores = curve.to_numpy()
    slope, slopes = solve[1] @ scores.mean(axis=0), scores[drawn].mean(axis=1) @ solve[1]
    most = round(float(numbers.max()))
    rows = []
    for more in MORE:
        share = 1 / most - 1 / (most + more)
        low, high = resampling.interval(slopes * share)
        rows.append((more, slope * share, low, high))
    return most, pd.DataFrame(rows, columns=["more", "gain", "low", "high"])
