"""Captures of several studies: each at its own scale, added ones in training alone."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.joined import add_corpora, join_corpora
from bench.errors import InputError
from bench.features.base import added_rows, source_of_rows
from bench.features.touch import TouchFeatures
from bench.models.by_source import ADDED_SHARE, SourceScales, draw_batches, weigh_added
from bench.models.classic.lda import lda
from bench.models.classic.perceptron import perceptron
from bench.models.nets.cnn85 import CNN85
from bench.models.nets.touchnet import TouchNet
from bench.models.recipe import build_recipe
from bench.models.search.inner_folds import split_tested_subjects
from bench.plan.plan import split_captures
from bench.protocols.subjects import LOSO
from tests.corpora.made import study

PEOPLE = ("1", "2", "3")
SYSTEMS = {
    "touchnet": lambda: TouchNet(updates=4, batch=8),
    "frames": lambda: CNN85(frames=4, epochs=1, batch=8),
    "perceptron": lambda: perceptron(TouchFeatures(), updates=4),
    "by key": lambda: build_recipe(lda, TouchFeatures(), by_source=True),
}


def joined(factor=1.0, shift=0.0, name="two"):
    """Two studies as one; the second one's readings are changed."""
    other = study(name, PEOPLE, shape=(6, 5))
    frames = np.clip(other.frames * np.float32(factor) + np.float32(shift), 0, 1)
    return join_corpora([study("one", PEOPLE), other.with_fields(frames=frames)])


def learned_scales(system):
    """What a fitted system knows of each source."""
    for part in (system, getattr(system, "system_", None), *_steps(system)):
        if scales := getattr(part, "scales_", None):
            return scales.maps
    raise AssertionError("no scales")


def _steps(system):
    system = getattr(system, "system_", system)
    return [part for _, part in getattr(system, "steps", [])]


@given(st.integers(0, 99), st.floats(0.1, 9), st.floats(-5, 5))
def test_each_source_has_the_mean_and_sd_of_the_tested_ones_whatever_its_units(seed, factor, shift):
    rng = np.random.default_rng(seed)
    own, other = rng.normal(3, 2, (40, 3)), rng.normal(0, 1, (30, 3))
    own[:, 2] = 7.0  # constant
    scales = SourceScales({"own": own, "other": factor * other + shift}, ["other"])
    assert [*scales.maps] == ["other"]
    scaled = scales.apply(factor * other + shift, np.full(30, "other"))
    np.testing.assert_allclose(scaled.mean(axis=0), own.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(scaled.std(axis=0), own.std(axis=0), atol=1e-4)
    same = SourceScales({"own": own, "other": other}, ["other"]).apply(other, np.full(30, "other"))
    np.testing.assert_allclose(scaled, same, atol=1e-3)
    assert scales.apply(own, np.full(40, "own")) is own
    assert scales.apply(own, np.full(40, "unknown")) is own
    both = SourceScales({"own": own, "other": other})
    assert [*both.maps] == ["own", "other"]


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_scale_is_learned_from_training_people_of_its_source_alone(name):
    corpus = joined()
    train = np.flatnonzero(~np.isin(corpus.subjects, ["one 1", "two 1"]))
    test = np.flatnonzero(np.isin(corpus.subjects, ["one 1", "two 1"]))
    maps = learned_scales(SYSTEMS[name]().fit(corpus[train], corpus.gestures[train]))
    assert [*maps] == ["one", "two"]
    # A test person's values are learned by nothing.
    frames = np.array(corpus.frames)
    for i in test:
        frames[corpus.starts[i] : corpus.starts[i] + corpus.lengths[i]] *= 0.1
    leaky = corpus.with_fields(frames=frames)
    again = learned_scales(SYSTEMS[name]().fit(leaky[train], leaky.gestures[train]))
    for source, which in product(maps, (0, 1)):
        np.testing.assert_array_equal(maps[source][which], again[source][which])
    # A test that sees them fails: the same comparison with a test person in training.
    leaked = learned_scales(SYSTEMS[name]().fit(leaky, leaky.gestures))
    honest = learned_scales(SYSTEMS[name]().fit(corpus, corpus.gestures))
    assert not np.array_equal(leaked["one"][1], honest["one"][1])


@pytest.mark.parametrize("name", SYSTEMS)
def test_values_of_an_added_study_change_no_scale_of_the_tested_one(name):
    own = study("one", PEOPLE)
    for factor in (1.0, 0.5):
        other = study("two", PEOPLE, shape=(6, 5))
        added = add_corpora(own, [other.with_fields(frames=other.frames * np.float32(factor))])
        system = SYSTEMS[name]().fit(added, added.gestures)
        assert [*learned_scales(system)] == ["two"]
        # its own captures are read as they are, from a robot, too
        alone = system.predict_proba(own.blind())
        np.testing.assert_allclose(alone, system.predict_proba(added[~added.is_added]), atol=1e-6)


def test_added_captures_follow_at_the_sensor_of_the_tested_ones():
    own = study("one", PEOPLE, classes=("pat", "rub", "tap"), cover="fur")
    other = study("two", PEOPLE, ("Rub", "pat", "hug"), (6, 3), 20.0).with_fields(full_scale=4.0)
    added = add_corpora(own, [other])
    mine = added[~added.is_added]
    assert [*mine.index] == [*range(len(own))] and np.array_equal(mine.frames, own.frames)
    assert mine.captures[[*own.captures]].equals(own.captures)
    theirs = added[added.is_added]
    assert (theirs.rate_hz, theirs.full_scale, theirs.grid) == (40.0, 1.0, (4, 5))
    assert set(theirs.subjects) == {"two 1", "two 2", "two 3"}
    assert set(theirs.gestures) == {"pat", "rub"} and set(theirs.captures["cover"]) == {""}
    assert "two has no capture of tap and its captures of hug are left out" in str(added.info)
    with pytest.raises(InputError, match="two has no capture of pat, rub"):
        add_corpora(study("one"), [study("two", classes=("hug", "tap"))])


def test_added_people_are_in_each_training_side_and_judge_nothing():
    added = add_corpora(study("one", PEOPLE), [study("two", PEOPLE)])
    everyone = {f"two {name}" for name in PEOPLE}
    for folds in (split_captures(LOSO(), added), split_tested_subjects(added, "loso")):
        assert len(folds) == 3
        for train, test in folds:
            assert len({*added.subjects[test]}) == 1 and not added.is_added[test].any()
            assert everyone <= {*added.subjects[train]}
            assert not {*added.subjects[train]} & {*added.subjects[test]}


@given(st.integers(2, 60), st.integers(1, 200), st.integers(2, 40), st.integers(0, 9))
def test_batches_are_a_pass_over_own_samples_with_a_share_of_added_ones(own, added, batch, seed):
    is_added = np.random.default_rng(seed).permutation(np.arange(own + added) >= own)
    batches = draw_batches(np.random.default_rng(seed), is_added, min(batch, own + added))
    count = round(ADDED_SHARE * batches.shape[1])
    assert (is_added[batches].sum(axis=1) == count).all()
    rows = batches[~is_added[batches]]
    most = np.bincount(rows, minlength=len(is_added))[~is_added]
    assert most.max() - most.min() <= 1
    weights = weigh_added(np.ones(own + added), is_added)
    np.testing.assert_allclose(weights[is_added].sum() / weights.sum(), ADDED_SHARE)


def test_tables_know_the_source_of_each_row():
    corpus = add_corpora(study("one", PEOPLE), [study("two", PEOPLE)])
    table = TouchFeatures().fit_transform(corpus)
    assert np.array_equal(source_of_rows(table), corpus.sources.astype(str))
    assert np.array_equal(added_rows(table), corpus.is_added)
