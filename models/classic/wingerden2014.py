"""The system of van Wingerden et al. 2014: 45 features and a network of 46 units."""

from sklearn.pipeline import Pipeline

from bench.features.wingerden45 import Wingerden45
from bench.models.classic.mlp import mlp


def wingerden2014_mlp(seed: int = 0) -> Pipeline:
    """One hidden layer on standardised features, stopped on 15 % of the captures; ours."""
    return mlp(Wingerden45(), "46", held=0.15, runs=1, scaling="z", seed=seed)
