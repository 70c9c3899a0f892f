"""The rule of a choice, for the people of a corpus or for many drawings of them at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench import few
from bench.measures import costs
from bench.paired import TOLERANCE, within_one_standard_error

AT_ONCE = 50  # drawings that are computed together


@dataclass(frozen=True)
class People:
    """What each subject contributes to the score and to the costs of each candidate.

    Attributes:
        scores: float [candidates, subjects], in percent.
        losses: points lost under each fault at each severity, float [candidates, circumstances, subjects]; NaN where
            not stored.
        alarms: false alarms and hours of background, float [2, candidates, subjects and people without touches]; NaN
            where not measured. The last have no score: they are in every drawing.
        fixed: other costs by name, float [candidates].
    """

    scores: np.ndarray
    losses: np.ndarray
    alarms: np.ndarray
    fixed: dict[str, np.ndarray]

    def cost(self, name: str, drawn: np.ndarray) -> np.ndarray:
        """A cost of each candidate for some drawings of people, float [drawings, candidates].

        Args:
            name: name of the cost.
            drawn: numbers of the subjects in each drawing, int [drawings, people].
        """
        if name in self.fixed:
            return np.broadcast_to(self.fixed[name], (len(drawn), len(self.scores)))
        among = costs()[name].among
        if among is None:
            return np.full((len(drawn), len(self.scores)), np.nan)
        return among(self, drawn)

    def lowest(self, drawn: np.ndarray, count: int) -> np.ndarray:
        """Mean of the lowest ``count`` scores in percent, float [drawings, candidates]."""
        lowest = np.sort(self.scores[:, drawn], axis=2)  # NaN comes last
        return np.where(np.isnan(lowest[:, :, -1]), np.nan, lowest[:, :, :count].mean(axis=2)).T

    def loss(self, drawn: np.ndarray) -> np.ndarray:
        """Mean points lost under each fault at each severity, float [drawings, candidates, circumstances]."""
        if not self.losses.shape[1]:
            return np.full((len(drawn), len(self.scores), 1), np.nan)
        return np.einsum("ds,cfs->dcf", counted(drawn, self.scores.shape[1]), self.losses) / drawn.shape[1]

    def alarm_rate(self, drawn: np.ndarray) -> np.ndarray:
        """False alarms per hour of background, float [drawings, candidates]."""
        others = np.ones((len(drawn), self.alarms.shape[2] - self.scores.shape[1]))
        weights = np.concatenate([counted(drawn, self.scores.shape[1]), others], axis=1)
        alarms, hours = weights @ self.alarms[0].T, weights @ self.alarms[1].T
        return np.divide(alarms, hours, out=np.full(alarms.shape, np.nan), where=hours > 0)


def counted(drawn: np.ndarray, subjects: int) -> np.ndarray:
    """How often each subject is in each drawing, float [drawings, subjects]."""
    return np.stack([np.bincount(each, minlength=subjects) for each in drawn]).astype(float)


def within(name: str, amounts: np.ndarray, budget: float) -> np.ndarray:
    """Whether amounts of a cost are within a budget: not where they are NaN, and rounding is no excess."""
    if costs()[name].better == "high":
        return amounts >= budget * (1 - TOLERANCE)
    return amounts <= budget * (1 + TOLERANCE)


def fitting(amounts: Mapping[str, np.ndarray], budgets: Mapping[str, float], candidates: int) -> np.ndarray:
    """Whether candidates fit all budgets, bool [..., candidates].

    Args:
        amounts: amounts of each cost with a budget, float [..., candidates].
        budgets: budget of each cost.
        candidates: number of them.
    """
    fits = np.ones(candidates, bool)
    for name, budget in budgets.items():
        fits = fits & within(name, amounts[name], budget)
    return fits


def pick(
    scores: np.ndarray, drawn: np.ndarray, fits: np.ndarray, by: np.ndarray, margin: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cheapest candidate whose score is not below that of the best, for each drawing of people.

    Not below means: the mean over people of the difference is at most its standard error; or, with a margin, a
    one-sided paired t-test finds it smaller than the margin (p < 0.05); fewer than
    `bench.few.TEST` people show nothing.

    Args:
        scores: in percent, float [candidates, subjects].
        drawn: numbers of the subjects in each drawing, int [drawings, people]; a subject may come several times.
        fits: True for candidates that fit the budgets, bool [drawings, candidates].
        by: burden of the cost to minimise (`bench.measures.Cost.burden`), float [drawings, candidates]; NaN if not
            known, which is never chosen.
        margin: points that do not matter, or None.

    Returns:
        Numbers of the chosen and of the best candidate [drawings], -1 where none fits, and which candidates that fit
        are not below the best, bool [drawings, candidates].
    """
    if len(drawn) > AT_ONCE:
        cuts = [slice(i, i + AT_ONCE) for i in range(0, len(drawn), AT_ONCE)]
        parts = [pick(scores, drawn[cut], fits[cut], by[cut], margin) for cut in cuts]
        chosen, best, near = (np.concatenate([part[k] for part in parts]) for k in range(3))
        return chosen, best, near
    rows = np.arange(len(drawn))
    of_people = scores[:, drawn].transpose(1, 0, 2)  # [drawings, candidates, people]
    means = np.round(_mean(of_people), 9)  # equal sums in another order are ties
    can = fits & np.isfinite(by) & np.isfinite(means)
    any_can = can.any(axis=1)
    order = np.lexsort((by, -np.where(can, means, -np.inf)), axis=1)
    best = np.where(any_can, order[:, 0], -1)
    losses = of_people[rows, best][:, None, :] - of_people
    near = fits & any_can[:, None]
    near &= _not_below(losses, margin) if margin is None or scores.shape[1] >= few.TEST else False
    near[rows[any_can], best[any_can]] = True
    cheap = np.lexsort((-means, np.where(can & near, by, np.inf)), axis=1)
    return np.where(any_can, cheap[:, 0], -1), best, near


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean over the last axis of what is known; NaN where nothing is."""
    known = np.isfinite(values)
    counts = known.sum(axis=-1)
    return np.where(known, values, 0).sum(axis=-1) / np.where(counts, counts, np.nan)


def _not_below(losses: np.ndarray, margin: float | None) -> np.ndarray:
    """Which mean losses are within one standard error or, with a margin, shown to be less; over the last axis."""
    if margin is None:
        return within_one_standard_error(losses)
    people, mean = losses.shape[-1], losses.mean(axis=-1)
    if people < 2:
        return np.zeros(mean.shape, bool)
    error = losses.std(axis=-1, ddof=1) / np.sqrt(people)
    from scipy.special import stdtr  # not scipy.stats, which takes half a second

    t = np.divide(mean - margin, error, out=np.full(mean.shape, np.inf), where=error > 0)
    return np.where(error > 0, stdtr(people - 1, t) < 0.05, mean < margin)
