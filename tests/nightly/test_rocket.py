"""Rocket against plain loops, on skins of any size and in processes: what numba compiles for minutes."""

import numpy as np
import pytest
import torch

from bench.corpora.corpus import Corpus
from models.rocket import Rocket
from tests.models.test_systems import check_contract

pytestmark = pytest.mark.nightly
BOTH = pytest.mark.parametrize("transform", ["minirocket", "multirocket_hydra"])


def small(transform="minirocket", **kwargs):
    return Rocket(transform, **{"kernels": 200, **kwargs})


@BOTH
@pytest.mark.parametrize("channels", ["taxels", "both"])
def test_contract(transform, channels):
    check_contract(lambda: small(transform, channels=channels))


@BOTH
def test_captures_of_one_frame_and_captures_that_never_change(transform, corpus):
    varied = small(transform).fit(corpus, corpus.gestures)
    for arrays in (
        [f[:1] for f in corpus],
        [np.zeros((25, 8, 8), np.uint16) for _ in corpus],
        [np.repeat(f[:1], 30, axis=0) for f in corpus],
    ):
        still = Corpus.from_captures(arrays, corpus.captures, 100.0)
        for model in (varied, small(transform).fit(still, still.gestures)):
            proba = model.predict_proba(still)
            assert np.isfinite(proba).all()
            np.testing.assert_allclose(proba.sum(axis=1), 1, rtol=1e-5)


@BOTH
def test_nothing_of_the_process_is_changed(transform, corpus):
    threads = torch.get_num_threads()
    np.random.seed(5)
    torch.manual_seed(5)
    expected = np.random.random(), torch.rand(1).item()
    np.random.seed(5)
    torch.manual_seed(5)
    small(transform).fit(corpus, corpus.gestures).predict(corpus)
    assert (np.random.random(), torch.rand(1).item()) == expected
    assert torch.get_num_threads() == threads
