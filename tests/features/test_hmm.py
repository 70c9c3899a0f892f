"""Hidden Markov models against sums over all state paths."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import norm

from bench.features.hmm import GaussianHMMs
from tests.features.captures import near


def random_models(rng, classes=2, states=3, values=2):
    models = GaussianHMMs(states, 1)
    models.start_ = rng.dirichlet(np.ones(states), classes)
    models.transition_ = rng.dirichlet(np.ones(states), (classes, states))
    models.mean_ = rng.normal(size=(classes, states, values))
    models.variance_ = rng.uniform(0.1, 2, (classes, states, values))
    return models


def paths(models, c, frames):
    """Every path of states through one sequence with its log-probability and that of the frames together."""
    states = len(models.start_[c])
    density = norm.logpdf(frames[:, None], models.mean_[c], np.sqrt(models.variance_[c])).sum(axis=2)
    for path in itertools.product(range(states), repeat=len(frames)):
        log = np.log(models.start_[c, path[0]]) + sum(density[t, s] for t, s in enumerate(path))
        yield path, log + sum(np.log(models.transition_[c, a, b]) for a, b in itertools.pairwise(path))


LENGTHS = st.lists(st.integers(1, 5), min_size=1, max_size=4)


@given(st.integers(0, 10_000), LENGTHS, st.integers(1, 3), st.sampled_from([0.1, 1, 30]))
def test_likelihood_is_the_sum_over_all_paths(seed, lengths, states, far):
    rng = np.random.default_rng(seed)
    models = random_models(rng, states=states)
    sequences = [far * rng.normal(size=(n, 2)) for n in lengths]
    logs = models.log_likelihood(np.concatenate(sequences), np.array(lengths))
    near(logs, [[logsumexp([log for _, log in paths(models, c, s)]) for c in range(2)] for s in sequences], rtol=1e-9)


@given(st.integers(0, 10_000))
def test_an_iteration_equals_expectations_over_all_paths(seed):
    rng = np.random.default_rng(seed)
    begin = random_models(rng, states=2)
    lengths = np.array([3, 1, 5, 2, 4, 5, 2])
    classes = np.array([1, 0, 1, 0, 0, 1, 1])
    frames = rng.normal(size=(lengths.sum(), 2))
    models = GaussianHMMs(2, 1)
    models._begin = lambda parts: vars(models).update({k: v.copy() for k, v in vars(begin).items() if k[-1] == "_"})
    models.fit(frames, lengths, classes)
    sequences = np.split(frames, np.cumsum(lengths)[:-1])
    for c in range(2):
        start, moves, weight, first, second = np.zeros(2), np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2)), 0
        total = 0
        for sequence in (sequences[i] for i in np.flatnonzero(classes == c)):
            every = list(paths(begin, c, sequence))
            likelihood = logsumexp([log for _, log in every])
            total += likelihood
            for path, log in every:
                share = np.exp(log - likelihood)
                start[path[0]] += share
                for a, b in itertools.pairwise(path):
                    moves[a, b] += share
                for t, s in enumerate(path):
                    weight[s] += share
                    first[s] += share * sequence[t]
                    second = second + share * np.outer(np.arange(2) == s, sequence[t] ** 2)
        assume(weight.min() > 0.01 and moves.sum(axis=1).min() > 0.01)
        mean = first / weight[:, None]
        assert models.history_[0, c] == pytest.approx(total)
        near(models.start_[c], start / start.sum(), atol=2e-6)
        near(models.transition_[c], moves / moves.sum(axis=1, keepdims=True), atol=2e-6)
        near(models.mean_[c], mean)
        near(models.variance_[c], np.maximum(second / weight[:, None] - mean**2, 1e-3), rtol=1e-7)
