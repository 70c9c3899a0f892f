"""Rates and times to expect for a new person: bounds from a few people, and a test of rates.

Arguments of the functions on rates: ``events`` and ``amounts`` of each person [people], such as
false alarms and hours of background. People have different rates, which are gamma distributed. The
mean and the shape of this distribution are known from the people and a prior, on a grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, stdtrit

from bench.values import few
from touchbench_builder.bounds import (
    MEAN_LEVEL,
    PERSON_LEVEL,
    PRIOR_PEOPLE,
    count_next_people,
)

SHAPES = np.geomspace(0.1, 30, 30)  # of people's rates: the inverse squared relative spread
LIKELY_SHAPE, SHAPE_SPREAD = 1.0, 1.0  # median, and SD of the logarithm
MEANS = np.geomspace(1 / 30, 30, 120)  # multiples of the pooled rate
DRAWS = 40_000
TIME_SPREAD = 0.2  # SD between people of the logarithm of a time: HAART's is 0.1 to 0.2


@dataclass(frozen=True)
class UpperBounds:
    """What to expect of a number in which more is worse; the mean only, if people are too few.

    Attributes:
        mean: of the people.
        mean_high: the mean of the next people stays below it with 95 % probability.
        person_high: the next person stays below it with 90 % probability.
    """

    mean: float
    mean_high: float | None
    person_high: float | None


def new_person_rate_bounds(events: np.ndarray, amounts: np.ndarray) -> UpperBounds:
    """Bounds of the rate of a new person; the mean is that of all events and amounts."""
    events, amounts = np.asarray(events, float), np.asarray(amounts, float)
    mean = float(events.sum() / amounts.sum())
    if len(events) < few.FEWEST_FOR_INTERVAL:
        return UpperBounds(mean, None, None)
    rates = _draw_rates(events, amounts, count_next_people(len(events)))
    high = float(np.quantile(rates.mean(axis=1), MEAN_LEVEL))
    return UpperBounds(mean, high, float(np.quantile(rates[:, 0], PERSON_LEVEL)))


def compare_rates(
    certificate_events: np.ndarray,
    certificate_amounts: np.ndarray,
    events: np.ndarray,
    amounts: np.ndarray,
) -> float:
    """Probability of as many events of later people, or more, if the certificate is true."""
    known = np.asarray(certificate_events, float), np.asarray(certificate_amounts, float)
    rates = _draw_rates(*known, len(amounts))
    counts = np.random.default_rng(1).poisson(rates * np.asarray(amounts, float)).sum(axis=1)
    return float((1 + (counts >= np.sum(events)).sum()) / (1 + DRAWS))


def new_person_time_bounds(times: np.ndarray) -> UpperBounds:
    """Bounds of a time of a new person, by Student's t of logarithms: times of people [people]."""
    times = np.asarray(times, float)
    logs, people = np.log(times), len(times)
    if people < few.FEWEST_FOR_INTERVAL:
        return UpperBounds(float(times.mean()), None, None)
    own = logs.var(ddof=1)
    pooled = ((people - 1) * own + PRIOR_PEOPLE * TIME_SPREAD**2) / (people - 1 + PRIOR_PEOPLE)
    variance, highs = max(own, pooled), []
    for level, count in ((MEAN_LEVEL, count_next_people(people)), (PERSON_LEVEL, 1)):
        error = np.sqrt(variance * (1 / people + 1 / count))
        highs.append(float(np.exp(logs.mean() + stdtrit(people - 1, level) * error)))
    return UpperBounds(float(times.mean()), *highs)


def _draw_rates(events: np.ndarray, amounts: np.ndarray, people: int) -> np.ndarray:
    """Rates of new people, drawn from what the known ones tell [draws, people]."""
    shape = SHAPES[:, None, None]
    means = MEANS[None, :, None] * (events.sum() + 0.5) / amounts.sum()
    expected = means * amounts
    logs = gammaln(events + shape) - gammaln(shape) - shape * np.log1p(expected / shape)
    logs = (logs + events * np.log(expected / (shape + expected))).sum(axis=-1)
    logs -= (np.log(SHAPES[:, None] / LIKELY_SHAPE) / SHAPE_SPREAD) ** 2 / 2
    logs += np.log(MEANS) / 2  # the prior of Jeffreys, for a Poisson rate
    weights = np.exp(logs - logs.max())
    rng = np.random.default_rng(0)
    drawn = rng.choice(weights.size, DRAWS, p=weights.ravel() / weights.sum())
    shapes = np.broadcast_to(shape[..., 0], weights.shape).ravel()[drawn, None]
    means = np.broadcast_to(means[..., 0], weights.shape).ravel()[drawn, None]
    return rng.gamma(shapes, means / shapes, (DRAWS, people))
