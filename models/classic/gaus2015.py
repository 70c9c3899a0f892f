"""The systems of Gaus et al. 2015 (ICMI challenge): five feature families, a forest or boosting."""

from sklearn.pipeline import Pipeline

from bench.features.gaus import Gaus
from bench.models.classic.boost import boost
from bench.models.classic.rf import rf


def gaus2015_rf(seed: int = 0) -> Pipeline:
    """Random forest of 500 trees, a number that is our reading."""
    return rf(Gaus(), trees=500, seed=seed)


def gaus2015_boost(seed: int = 0) -> Pipeline:
    """300 rounds of boosting, a number that is our reading."""
    return boost(Gaus(), seed=seed)
