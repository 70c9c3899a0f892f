"""Ensembles of recognisers, and the selection of their members."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp, softmax

from bench import contract
from bench.corpora.corpus import Corpus
from bench.models.most_probable import MostProbable

MIN_PROBABILITY = 1e-9  # inside a logarithm
MIN_GAIN = 1e-9  # of the log likelihood, by a pick
MAX_PICKS = 15  # of a selection: weights are multiples of about 1/15


@dataclass(eq=False, repr=False)
class Ensemble(MostProbable):
    """Fitted recognisers of the same classes, and the weighted mean of tempered probabilities."""

    members: list[contract.System]
    weights: list[float]
    temperatures: list[float]

    def __post_init__(self) -> None:
        self.classes_ = self.members[0].classes_

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes]."""
        parts = zip(self.members, self.weights, self.temperatures, strict=True)
        return sum(
            w * apply_temperature(contract.predict_probabilities(member, X), t)
            for member, w, t in parts
        )


def apply_temperature(proba: np.ndarray, temperature: float) -> np.ndarray:
    """Divide the logarithms of probabilities [captures, classes] by a temperature; normalise."""
    return softmax(log_probabilities(proba) / temperature, axis=1)


def fit_temperature(scores: np.ndarray, codes: np.ndarray, coldest: float, hottest: float) -> float:
    """Temperature T for which softmax(scores / T) has the lowest mean log loss (Guo et al. 2017).

    It is found by Brent's bounded search over log T, to about 1e-5 of it.

    Args:
        scores: log probabilities or other scores of held-out captures [captures, classes].
        codes: class of each capture.
        coldest: lowest T.
        hottest: highest T.
    """

    def log_loss(log_temperature: float) -> float:
        scaled = scores / np.exp(log_temperature)
        return float(np.mean(logsumexp(scaled, axis=1) - scaled[np.arange(len(codes)), codes]))

    bounds = np.log(coldest), np.log(hottest)
    return float(np.exp(minimize_scalar(log_loss, bounds=bounds, method="bounded").x))


def log_probabilities(proba: np.ndarray) -> np.ndarray:
    """Logarithms of probabilities, which are at least `MIN_PROBABILITY`, float64."""
    return np.log(np.maximum(proba.astype(np.float64), MIN_PROBABILITY))


def select_ensemble(
    proba: np.ndarray, codes: np.ndarray, subjects: np.ndarray, allowed: Callable[[set[int]], bool]
) -> dict[int, float]:
    """Pick an ensemble one by one for the lowest log loss (Caruana et al. 2004).

    A recogniser may be picked again, which increases its weight. Picking ends when nothing improves
    the ensemble, or after 15 picks. All subjects count alike.

    Args:
        proba: tempered probabilities [recognisers, captures, classes], of the most accurate one
            first.
        codes: class of each capture.
        subjects: subject of each capture.
        allowed: whether a set of recognisers may form an ensemble. The first one that may is picked
            first.

    Returns:
        Weights by position; empty if no recogniser is allowed alone.
    """
    _, subject_codes = np.unique(subjects, return_inverse=True)
    weight = 1 / np.bincount(subject_codes)[subject_codes]
    correct = proba[:, np.arange(len(codes)), codes] + MIN_PROBABILITY
    picks = [i for i in range(len(correct)) if allowed({i})][:1]
    total, best = sum(correct[i] for i in picks), -np.inf
    while picks and len(picks) < MAX_PICKS:
        scores = np.log((total + correct) / (len(picks) + 1)) @ weight
        best = max(best, np.log(total / len(picks)) @ weight)
        better = [int(i) for i in np.argsort(-scores, kind="stable") if scores[i] > best + MIN_GAIN]
        pick = next((i for i in better if allowed({*picks, i})), None)
        if pick is None:
            break
        picks.append(pick)
        total = total + correct[pick]
    return {i: picks.count(i) / len(picks) for i in dict.fromkeys(picks)}
