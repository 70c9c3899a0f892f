"""Stored feature tables: computed once for each key, and again if they are damaged."""

import os

import numpy as np
import pytest

from bench.features import cache
from bench.features.cache import cache_key
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.ground import source
from bench.ground.scratch import data_folder


@pytest.fixture
def extracted(monkeypatch):
    """Number of captures in each call of ``extract``."""
    counts, extract = [], Jung28.extract

    def counted(self, corpus):
        counts.append(len(corpus))
        return extract(self, corpus)

    monkeypatch.setattr(Jung28, "extract", counted)
    return counts


DAMAGES = {
    "other values": lambda data: (
        data[:200] + bytes(byte ^ 1 for byte in data[200:300]) + data[300:]
    ),
    "end missing": lambda data: data[:-100],
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_table_is_computed_again(stored, corpus, extracted, name):
    expected = Jung28().transform(corpus)
    Jung28().transform(stored)
    path = data_folder() / "features" / f"{cache_key(Jung28(), stored.digest)}.parquet"
    path.write_bytes(DAMAGES[name](path.read_bytes()))
    del extracted[:]
    for _ in range(2):  # the second time it is repaired
        cache._read_table.cache_clear()
        assert Jung28().transform(stored).equals(expected) and extracted == [36]


def test_a_pipe_in_place_of_a_table_is_replaced(stored, corpus):
    path = data_folder() / "features" / f"{cache_key(Jung28(), stored.digest)}.parquet"
    path.parent.mkdir(parents=True)
    os.mkfifo(path)
    assert Jung28().transform(stored).equals(Jung28().transform(corpus)) and path.is_file()


def test_features_are_computed_once_per_corpus(corpus, stored, monkeypatch):
    expected = Jung54().transform(corpus)
    part = Jung54().transform(stored[np.array([4, 2])])
    assert part.equals(expected.iloc[[4, 2]].reset_index(drop=True))
    monkeypatch.setattr(Jung54, "extract", lambda *_: pytest.fail("computed again"))
    assert Jung54().transform(stored).equals(expected)
    monkeypatch.setattr(cache.pd, "read_parquet", lambda *_: pytest.fail("read again"))
    assert Jung54().transform(stored[5:2:-1]).equals(expected.iloc[5:2:-1].reset_index(drop=True))
    assert len(list((data_folder() / "features").iterdir())) == 1  # no temporary file is left


def test_the_key_depends_on_corpus_parameters_class_and_code(monkeypatch):
    features = [Jung54(), Jung54("capture"), Jung28(), Jung28(peaks="maxima")]
    key = cache_key(Jung54(), "a")
    assert len({*(cache_key(f, "a") for f in features), cache_key(Jung54(), "b"), key}) == 5
    parse_file = source._parse_file
    monkeypatch.setattr(cache, "loaded_code_digest", source.source_digest)  # as in a new process
    for name in ("signals.py", "jung28.py", "jung54.py", "gaus.py"):

        def parse_changed_file(path, stamp, name=name):
            code, tree = parse_file(path, stamp)
            return code + path.endswith(name) * b"changed", tree

        with monkeypatch.context() as patch:
            patch.setattr(source, "_parse_file", parse_changed_file)
            assert (cache_key(Jung54(), "a") != key) == (name != "gaus.py")


def test_a_folder_that_cannot_be_written_only_costs_time(
    corpus, stored, extracted, tmp_path, monkeypatch
):
    expected = Jung28().transform(corpus[3:5])
    (tmp_path / "file").write_text("")
    with monkeypatch.context() as patch:
        patch.setenv("TOUCHBENCH_HOME", str(tmp_path / "file"))
        assert Jung28().transform(stored[3:5]).equals(expected)
        assert extracted == [2, 2]  # no other capture

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache, "write_parquet_with_digest", full)
    assert Jung28().transform(stored[3:5]).equals(expected)
    assert not list((data_folder() / "features").iterdir())
