"""Recognisers that decide together, and which of many to take for that."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp, softmax

from bench import contract
from bench.corpora.corpus import Corpus
from bench.models.most_probable import MostProbable

MIN_PROBABILITY = 1e-9  # of a probability, inside a logarithm
MAX_PICKS = 15  # of a selection: weights are multiples of about 1/15


class Ensemble(MostProbable):
    """Fitted recognisers of the same classes that decide by a weighted mean of their tempered probabilities."""

    def __init__(
        self, members: list[contract.System], weights: list[float], temperatures: list[float]
    ) -> None:
        self.members = members
        self.weights = weights
        self.temperatures = temperatures
        self.classes_ = members[0].classes_

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes]."""
        parts = zip(self.members, self.weights, self.temperatures, strict=True)
        return sum(
            w * apply_temperature(contract.predict_probabilities(member, X), t)
            for member, w, t in parts
        )


def apply_temperature(proba: np.ndarray, temperature: float) -> np.ndarray:
    """Probabilities [captures, classes] whose logarithms are divided by a temperature, summing to 1 again."""
    return softmax(log_probabilities(proba) / temperature, axis=1)


def fit_temperature(scores: np.ndarray, codes: np.ndarray, coldest: float, hottest: float) -> float:
    """The temperature T for which softmax(scores / T) has the lowest mean log loss (Guo et al. 2017).

    Scores [captures, classes] are log probabilities, or others, of captures that training did not see. Found by Brent's
    bounded search over log T, to about 1e-5 of it.
    """

    def loss(log: float) -> float:
        cooled = scores / np.exp(log)
        return float(np.mean(logsumexp(cooled, axis=1) - cooled[np.arange(len(codes)), codes]))

    best = minimize_scalar(loss, bounds=(np.log(coldest), np.log(hottest)), method="bounded")
    return float(np.exp(best.x))


def log_probabilities(proba: np.ndarray) -> np.ndarray:
    """Logarithms of probabilities, none of them 0, float64."""
    return np.log(np.maximum(proba.astype(np.float64), MIN_PROBABILITY))


def select_ensemble(
    proba: np.ndarray, codes: np.ndarray, subjects: np.ndarray, allowed: Callable[[set[int]], bool]
) -> dict[int, float]:
    """Weights of recognisers that decide together, picked one by one for the lowest log loss (Caruana et al. 2004).

    Probabilities [recognisers, captures, classes] are tempered, those of the most accurate one first. The first that is
    allowed is picked first. One may be picked again, which gives it more weight. Subjects count alike, however many
    captures they have. It ends when no pick makes it better, or after 15. Empty if none is allowed even alone.
    """
    _, who = np.unique(subjects, return_inverse=True)
    weight = 1 / np.bincount(who)[who]
    right = proba[:, np.arange(len(codes)), codes] + MIN_PROBABILITY
    picks = [i for i in range(len(right)) if allowed({i})][:1]
    total, best = sum(right[i] for i in picks), -np.inf
    while picks and len(picks) < MAX_PICKS:
        gains = np.log((total + right) / (len(picks) + 1)) @ weight
        best = max(best, np.log(total / len(picks)) @ weight)
        order = np.argsort(-gains, kind="stable")
        better = next(
            (
                int(i)
                for i in order
                if gains[i] > best + MIN_PROBABILITY and allowed({*picks, int(i)})
            ),
            None,
        )
        if better is None:
            break
        picks.append(better)
        total = total + right[better]
    return {i: picks.count(i) / len(picks) for i in dict.fromkeys(picks)}
