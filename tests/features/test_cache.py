"""Tables of features that were kept of stored corpora: damaged ones, and those of others, are computed again."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.features import cache
from bench.features.cache import cache_key
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.ground import source
from bench.ground.scratch import data_folder


@pytest.fixture
def extracted(monkeypatch):
    """A list of how many captures features were computed of, each time."""
    asked, real = [], Jung28.extract
    monkeypatch.setattr(Jung28, "extract", lambda self, c: (asked.append(len(c)), real(self, c))[1])
    return asked


CHANGES = {
    "a value doubled": lambda frame: frame.assign(f01_mean_pressure=2 * frame["f01_mean_pressure"]),
    "a row less": lambda frame: frame.iloc[:-1],
    "names swapped": lambda frame: frame.set_axis([*frame.columns[1:], frame.columns[0]], axis=1),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_table_is_computed_again(stored, corpus, extracted, name):
    expected = Jung28().transform(corpus)
    Jung28().transform(stored)
    path = data_folder() / "features" / f"{cache_key(Jung28(), stored.digest)}.parquet"
    whole = pq.read_table(path)
    frame = CHANGES[name](whole.to_pandas())
    frame.attrs = {}
    changed = pa.Table.from_pandas(frame, preserve_index=False)
    pq.write_table(
        changed.replace_schema_metadata(whole.schema.metadata), path
    )  # with all that the file says of it
    del extracted[:]
    for _ in range(2):  # the second time it is mended
        cache._read_table.cache_clear()
        assert Jung28().transform(stored).equals(expected) and extracted == [36]


def test_features_are_computed_once_per_corpus(corpus, stored, monkeypatch):
    expected = Jung54().transform(corpus)
    assert (
        Jung54()
        .transform(stored[np.array([4, 2])])
        .equals(expected.iloc[[4, 2]].reset_index(drop=True))
    )
    monkeypatch.setattr(Jung54, "extract", lambda *_: pytest.fail("computed again"))
    assert Jung54().transform(stored).equals(expected)
    monkeypatch.setattr(cache.pd, "read_parquet", lambda *_: pytest.fail("read again"))
    assert Jung54().transform(stored[5:2:-1]).equals(expected.iloc[5:2:-1].reset_index(drop=True))
    assert (
        len(list((data_folder() / "features").iterdir())) == 1
    )  # nothing is left beside the table


def test_the_key_depends_on_corpus_parameters_class_and_code(monkeypatch):
    features = [Jung54(), Jung54("capture"), Jung28(), Jung28(peaks="maxima")]
    key = cache_key(Jung54(), "a")
    assert len({*(cache_key(f, "a") for f in features), cache_key(Jung54(), "b"), key}) == 5
    original = source._parse_file
    monkeypatch.setattr(
        "bench.features.cache._code_digest", source.source_digest
    )  # which is asked once for each class
    for name, other in (
        ("signals.py", True),
        ("jung28.py", True),
        ("jung54.py", True),
        ("kept.py", False),
    ):
        changed = lambda p, at, n=name: (
            original(p, at)[0] + p.endswith(n) * b"changed",
            original(p, at)[1],
        )  # noqa: E731
        with monkeypatch.context() as patch:
            patch.setattr(source, "_parse_file", changed)
            assert (cache_key(Jung54(), "a") != key) == other


def test_a_folder_that_cannot_be_written_only_costs_time(
    corpus, stored, extracted, tmp_path, monkeypatch
):
    expected = Jung28().transform(corpus[3:5])
    (tmp_path / "file").write_text("")
    with monkeypatch.context() as patch:
        patch.setenv("TOUCHBENCH_HOME", str(tmp_path / "file"))
        assert Jung28().transform(stored[3:5]).equals(expected) and extracted == [
            2,
            2,
        ]  # no capture more than needed

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pd.DataFrame, "to_parquet", full)
    assert Jung28().transform(stored[3:5]).equals(expected)
    assert not list((data_folder() / "features").iterdir())
