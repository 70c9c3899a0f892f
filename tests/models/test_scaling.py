"""Scalers against scikit-learn's where features vary, and where they do not."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.preprocessing import MinMaxScaler, StandardScaler

from bench.corpora.corpus import Corpus
from features.jung54 import Jung54
from models.classic.scaling import RangeScaler, ZScaler
from models.classic.softmax import softmax
from models.classic.svm import svm
from tests.conftest import random_corpus


@pytest.mark.parametrize(
    ("ours", "theirs", "still"),
    [
        (RangeScaler(), MinMaxScaler(), 0),
        (RangeScaler(feature_range=(-1, 1)), MinMaxScaler((-1, 1)), -1),
        (ZScaler(), StandardScaler(), 0),
    ],
)
def test_varying_features_are_scaled_as_usual_and_constant_ones_stay(ours, theirs, still):
    rng = np.random.default_rng(0)
    train, test = rng.normal(size=(20, 4)) * [1, 1e-6, 1e6, 0], rng.normal(size=(5, 4)) * 10
    train[:, 3] = 432
    train[:10, 3] += 1e-11  # rounding
    ours = clone(ours).fit(train)
    theirs = theirs.fit(train)
    np.testing.assert_array_equal(ours.transform(test)[:, :3], theirs.transform(test)[:, :3])
    assert (ours.transform(test)[:, 3] == still).all() and (ours.transform(train)[:, 3] == still).all()
    assert np.abs(theirs.transform(test)[:, 3]).max() > 100


@pytest.mark.parametrize("model", [svm, softmax])
def test_a_duration_that_never_varied_does_not_matter(model):
    """All training captures are equally long, as HAART's; a shorter one is still told by its pressure."""
    ragged = random_corpus(per_class=4)
    corpus = Corpus.from_captures([np.repeat(one[:1], 60, 0) for one in ragged], ragged.captures, ragged.rate_hz)
    fitted = model(features=Jung54()).fit(corpus, corpus.gestures)
    short = Corpus.from_captures([one[:45] for one in corpus], corpus.captures, corpus.rate_hz)
    assert (fitted.predict(short) == corpus.gestures).mean() > 0.8
