"""Every feature set: names, slices, constant captures, wrong parameters, no leaks."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from bench.errors import InputError
from bench.features import hughes36, signals, touch
from bench.features.balli import Balli
from bench.features.gaus import Gaus
from bench.features.hughes36 import Hughes36
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.features.selection import Subset
from bench.features.ta273 import Ta273
from bench.features.touch import TouchFeatures
from bench.features.touch_profiles import TouchProfiles
from bench.features.wingerden45 import Wingerden45
from tests.conftest import random_corpus, with_other_values
from tests.features.captures import corpus_of, row_of

QUICK_HUGHES36 = Hughes36(states=2, iterations=2, epochs=1)
WIDTH = {  # columns for 8 x 8 taxels and three gestures
    Jung28(): 28,
    Jung28("capture", "maxima"): 28,
    Jung54("capture"): 54,
    Wingerden45(): 45,
    Balli(0): 208,
    Balli(12): 12,
    Gaus(): 1382,
    Gaus(("bmh", "lbptop")): 241,
    Ta273(): 273,
    TouchFeatures(): 427,
    TouchProfiles(): 469,
    Subset(Jung28(), 6): 6,
    QUICK_HUGHES36: 14,
}


@pytest.mark.parametrize("features", WIDTH, ids=str)
def test_columns_and_slices(features, monkeypatch):
    corpus = random_corpus(subjects=2, per_class=2, longest=20)

    width, features = WIDTH[features], clone(features)
    tolerance = {"check_exact": True}
    if isinstance(features, Hughes36 | Ta273):  # matrix products round
        tolerance = {"rtol": 1e-9, "atol": 1e-9}

    def check_rows(part, rows):
        expected = table.iloc[rows].reset_index(drop=True)
        pd.testing.assert_frame_equal(features.transform(part), expected, **tolerance)

    with pytest.raises(NotFittedError):
        features.get_feature_names_out()
    table = features.fit_transform(corpus, corpus.gestures)
    assert table.shape == (12, width) and table.columns.is_unique
    assert np.isfinite(table).all(axis=None)
    assert list(features.get_feature_names_out()) == list(table.columns)
    assert repr(clone(features).get_params()) == repr(features.get_params())
    check_rows(corpus[np.array([7, 3, 10, 3])], [7, 3, 10, 3])
    assert features.set_output(transform="pandas").transform(corpus[:0]).shape == (0, width)
    small_blocks = partial(signals.capture_blocks, values=15 * 64)
    monkeypatch.setattr(signals, "capture_blocks", small_blocks)
    monkeypatch.setattr(hughes36, "FRAMES_TO_SCORE", 15)
    monkeypatch.setattr(touch, "RUN_VALUES", 7 * 64)
    monkeypatch.setattr(touch, "BATCH_VALUES", 1)
    assert len(signals.capture_blocks(corpus)) > 5
    check_rows(corpus, range(12))


CONSTANT = {  # columns that are 0 for constant captures
    Jung28(): "displacement|crossings|variability",
    Jung54(): "travel|crossings|derivative|_step_|frequency|f44",
    Wingerden45(): "displacement|crossings|derivative|change",
    Balli(0): "_(ar.|mobility|complexity)$",
    Gaus(): "smmhh|variance|skewness|kurtosis|iqr|_sd$|sd_touch",
    Ta273(): "_sd$|_crossings|derivative|fft|frequency|temporal",
    TouchFeatures(): "_(step|step_sd|crossings|turns|skewness|centroid|.*_ms|range|correlation)$",
}


@pytest.mark.parametrize("grid", [(8, 8), (1, 4), (1, 1)])
@pytest.mark.parametrize("features", CONSTANT, ids=str)
def test_constant_captures(features, grid):
    values = [(0, np.uint16), (65535, np.uint16), (1023, np.float32), (0.1, np.float32)]
    for frames in (1, 2, 3, 50):
        for value, kind in values:
            capture = np.full((frames, *grid), value, kind)
            row = row_of(clone(features), capture, full_scale=max(value, 1023.0))
            still = row.filter(regex=CONSTANT[features])
            assert np.isfinite(row).all() and len(still) > 3 and (still.abs() < 1e-12).all()


@pytest.mark.parametrize(
    "features", [Balli(5), Ta273(), Subset(Jung28(), 4), QUICK_HUGHES36], ids=str
)
def test_only_training_captures_are_learnt_from(features):
    corpus = random_corpus(5, 4, grid=(3, 4))
    test = corpus.subjects == "2"
    changed = with_other_values(corpus, np.flatnonzero(test))
    gestures = np.where(test, "pat", corpus.gestures)
    changed = changed.with_fields(captures=changed.captures.assign(gesture=gestures))
    fitted = clone(features).fit(corpus[~test], corpus.gestures[~test])
    blind = clone(features).fit(changed[~test], gestures[~test])
    leaky = clone(features).fit(changed, gestures)
    table = fitted.transform(corpus)
    assert table.equals(blind.transform(corpus)) and not table.equals(leaky.transform(corpus))
    if not isinstance(features, Hughes36):  # without labels, classes are the gestures
        assert table.equals(clone(features).fit(corpus[~test]).transform(corpus))


def test_balli_keeps_all_columns_if_nothing_can_be_learned(corpus):
    still = corpus_of([np.full((9, 4, 4), 5, np.uint16)] * 12, ["a", "b"] * 6)
    one_class, one_each = corpus[corpus.gestures == "pat"], corpus[corpus.subjects == "1"][::3]
    for part in (corpus[:1], one_class, one_each, still):
        assert Balli().fit_transform(part).shape == (len(part), 208)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (Jung28("frames"), "features.area=frames: give frame or capture"),
        (Balli(-1), "features.selected=-1"),
        (Hughes36(states=0), "features.states=0"),
        (Subset(Jung28(), 0), "count=0"),
        (Gaus(()), "features.families="),
        (Gaus(("sd", "lbp")), "features.families="),
        (Gaus(("sd", "bmh", "sd")), "features.families="),
    ],
    ids=str,
)
def test_wrong_parameters_are_one_line(wrong, message, corpus):
    uses = [lambda: wrong.fit(corpus, corpus.gestures)]
    uses += [wrong.check] if hasattr(wrong, "check") else []
    uses += [] if wrong.learns else [lambda: wrong.transform(corpus)]
    for use in uses:
        with pytest.raises(InputError, match=f"^[^\n]*{message}[^\n]*$"):
            use()
