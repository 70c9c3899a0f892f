"""A temperature for the scores of a classifier (Guo et al. 2017)."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp


def fit_temperature(scores: np.ndarray, codes: np.ndarray, coldest: float, hottest: float) -> float:
    """The temperature T for which softmax(scores / T) has the lowest mean log loss.

    Found by Brent's bounded search over log T, to about 1e-5 of it.

    Args:
        scores: log probabilities, or other scores, of captures that training did not see, float64 [captures, classes].
        codes: true class of each, a column of the scores [captures].
        coldest: lowest temperature.
        hottest: highest one.
    """

    def loss(log: float) -> float:
        cooled = scores / np.exp(log)
        return float(np.mean(logsumexp(cooled, axis=1) - cooled[np.arange(len(codes)), codes]))

    best = minimize_scalar(loss, bounds=(np.log(coldest), np.log(hottest)), method="bounded")
    return float(np.exp(best.x))
