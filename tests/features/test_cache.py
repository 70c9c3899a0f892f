"""Tables of features that are kept: computed once, never stale, and replaceable."""

import numpy as np
import pandas as pd
import pytest

from bench import source
from bench.corpora.folder import open_folder, write_folder
from features import cache
from features.cache import cache_key
from features.jung28 import Jung28
from features.jung54 import Jung54
from tests.conftest import random_corpus


@pytest.fixture
def stored(corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    return open_folder(tmp_path / "c")


def test_features_are_computed_once_per_corpus(corpus, stored, tmp_path, monkeypatch):
    expected = Jung54().transform(corpus)
    assert Jung54().transform(stored[np.array([4, 2])]).equals(expected.iloc[[4, 2]].reset_index(drop=True))
    monkeypatch.setattr(Jung54, "extract", lambda *_: pytest.fail("computed again"))
    assert Jung54().transform(stored).equals(expected)
    monkeypatch.setattr(cache.pd, "read_parquet", lambda *_: pytest.fail("read again"))
    assert Jung54().transform(stored[5:2:-1]).equals(expected.iloc[5:2:-1].reset_index(drop=True))
    assert len(list((tmp_path / "home" / "features").iterdir())) == 1  # nothing is left beside the table


def test_the_key_depends_on_corpus_parameters_class_and_code(monkeypatch):
    features = [Jung54(), Jung54("capture"), Jung28(), Jung28(peaks="maxima")]
    key = cache_key(Jung54(), "a")
    assert len({*(cache_key(f, "a") for f in features), cache_key(Jung54(), "b"), key}) == 5
    original = source.meaning
    for name, other in (("signals.py", True), ("jung28.py", True), ("jung54.py", True), ("kept.py", False)):
        changed = lambda p, at, n=name: (original(p, at)[0] + p.endswith(n) * b"changed", original(p, at)[1])  # noqa: E731
        with monkeypatch.context() as patch:
            patch.setattr(source, "meaning", changed)
            assert (cache_key(Jung54(), "a") != key) == other


def test_a_folder_that_cannot_be_written_only_costs_time(corpus, stored, tmp_path, monkeypatch):
    expected = Jung28().transform(corpus[3:5])
    (tmp_path / "file").write_text("")
    lengths, extract = [], Jung28.extract
    monkeypatch.setattr(Jung28, "extract", lambda self, c: (lengths.append(len(c)), extract(self, c))[1])
    with monkeypatch.context() as patch:
        patch.setenv("TOUCHBENCH_HOME", str(tmp_path / "file"))
        assert Jung28().transform(stored[3:5]).equals(expected) and lengths == [2]  # no capture more than needed

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pd.DataFrame, "to_parquet", full)
    assert Jung28().transform(stored[3:5]).equals(expected)
    assert not list((tmp_path / "home" / "features").iterdir())


def test_a_corpus_that_was_replaced_does_not_fill_the_cache(corpus, stored, tmp_path):
    write_folder(random_corpus(seed=1), tmp_path / "d")
    (tmp_path / "c").rename(tmp_path / "old")
    (tmp_path / "d").rename(tmp_path / "c")
    assert Jung28().transform(stored).equals(Jung28().transform(corpus))
    assert not list((tmp_path / "home" / "features").iterdir())
