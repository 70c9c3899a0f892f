"""Hidden Markov models against sums over all state paths."""

import itertools

import numpy as np
from hypothesis import given
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


def test_iterations_raise_the_likelihood_of_what_is_learnt():
    rng = np.random.default_rng(0)
    lengths, classes = np.resize([3, 9, 5, 12], 24), np.resize([0, 1, 1], 24)
    frames = rng.normal(size=(lengths.sum(), 2)) + 3 * rng.integers(0, 2, (lengths.sum(), 1))
    history = GaussianHMMs(2, 6).fit(frames, lengths, classes).history_
    assert history.shape == (6, 2) and (np.diff(history, axis=0) > -1e-6).all() and (history[-1] > history[0]).all()
