"""Tables of runs as parquet: what comes back, and of which type."""

from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.store.tables import as_stored, read_table, table_file, write_table

HARD = ["NA", "null", "nan", "03", "1.0", "1", "", "True", "a,b", 'a"b', "ü ", "inf"]


@given(labels=st.lists(st.sampled_from(HARD) | st.text("aé,\" '"), min_size=1, max_size=5))
def test_text_stays_text(tmp_path_factory, labels):
    path = tmp_path_factory.mktemp("tables") / table_file("touches")
    table = pd.DataFrame({"true": labels, "label": labels[::-1], "share": 0.1 + 0.2})
    write_table(table, path)
    assert path.name == "touches.parquet"
    pd.testing.assert_frame_equal(read_table(path, "touches"), table, check_dtype=False)
    columns = read_table(path, "touches", columns=["share", "label"])
    assert columns["share"].to_pylist() == [0.1 + 0.2] * len(labels)
    assert columns["label"].to_pylist() == labels[::-1]


@pytest.mark.parametrize(
    ("values", "stored", "kind"),
    [
        ([int, None, str], ["<class 'int'>", None, "<class 'str'>"], "O"),
        ([(1, "a"), [], None], ["(1, 'a')", "[]", None], "O"),
        ([8, None, 9], ["8", None, "9"], "O"),
        ([True, None, False], ["True", None, "False"], "O"),
        (["03", None, ""], ["03", None, ""], "O"),
        ([None] * 3, [None] * 3, "O"),
        ([0.5, None, 2.0], [0.5, None, 2.0], "f"),
        ([8, 2, 3], [8, 2, 3], "i"),
        ([8, 0.5, 3], [8, 0.5, 3], "f"),
    ],
)
def test_a_column_is_stored_as_numbers_or_as_text(values, stored, kind):
    table = pd.DataFrame({"a": pd.Series(values, dtype=object)})
    write_table(table, Path("odd.parquet"))
    found = read_table(Path("odd.parquet"), "odd")
    pd.testing.assert_frame_equal(found, as_stored(table), check_dtype=False)
    pd.testing.assert_frame_equal(as_stored(found), found)
    assert found["a"].astype(object).where(found["a"].notna(), None).tolist() == stored
    assert kind == "O" or found["a"].dtype.kind == kind


def test_columns_of_one_name_get_numbers():
    twice = as_stored(pd.DataFrame([[1, "a", 2, 3]], columns=["a", "a.1", "a", 4]))
    assert [*twice] == ["a", "a.1", "a.2", "4"] and twice.iloc[0].tolist() == [1, "a", 2, 3]
