"""The system of Balli Altuglu and Altun 2015 (ICMI challenge): selected statistics and a forest."""

from sklearn.pipeline import Pipeline

from bench.features.balli import Balli
from bench.models.classic.rf import rf


def balli2015_rf(selected: int = 42, seed: int = 0) -> Pipeline:
    """Random forest of 500 trees, a number that is our reading, on the selected features.

    Args:
        selected: number of features that floating selection keeps.
        seed: random seed of the forest.
    """
    return rf(Balli(selected), trees=500, seed=seed)
