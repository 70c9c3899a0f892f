"""The system of Hughes et al. 2015 (ICMI challenge): likelihoods of HMMs and softmax regression."""

from sklearn.pipeline import Pipeline

from bench.features.hughes36 import Hughes36
from bench.models.classic.softmax import softmax


def hughes2015_softmax(seed: int = 0) -> Pipeline:
    """Softmax regression on standardised features; ``seed`` is that of the autoencoder and HMMs."""
    return softmax(Hughes36(seed=seed))
