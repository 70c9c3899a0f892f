"""Runs that an earlier version stored are read, and the same is printed of them."""

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

from bench.outcomes.runs import stored
from bench.outcomes.store import connect
from bench.outcomes.tables import TEXT
from tests.net import masks
from tests.net.build import EARLIER, inside, step, unpack

PRINTED = {  # by what was typed behind "$ bench"
    re.match("[$] bench (.*)", text)[1]: text
    for text in re.split("(?m)^(?=[$] bench )", Path(str(EARLIER).replace(".tar.xz", ".txt")).read_text())[1:]
}
TABLES = {  # of runs, by their kind
    "cell": "confusion per_class per_subject predictions",
    "stress": "stress",
    "stream": "chosen instants predictions stopping trials",
    "watch": "chosen curve per_subject predictions reports touches trials",
    "chip": "per_subject predictions",
}
NOTHING = re.compile("(?!)")  # times, sizes and processors are those of the stored runs, so no column is masked
SCENE = """by = "fault_loss"
[reactions]
calm = ["stroke", "rub"]
[costs]
calm = { pat = 3 }
[budget]
flash = "64kB"
[faults]
names = ["noise", "dead_taxels"]
severity = 3
worst = 80
"""


@pytest.fixture(scope="module")
def earlier(tmp_path_factory):
    """The store of an earlier version; choosing among its runs changes nothing."""
    folder = unpack(tmp_path_factory.mktemp("earlier"))
    (folder / "robot.toml").write_text(SCENE)
    return folder


@pytest.mark.parametrize("command", PRINTED)
def test_stored_runs_of_an_earlier_version_print_the_same(command, earlier):
    with inside(earlier):
        now = step(shlex.split(command))
    now, before = (masks.lines_of(text.rstrip(), masked=NOTHING) for text in (now, PRINTED[command]))
    assert now == before


@pytest.mark.parametrize("kind", TABLES)
def test_stored_tables_of_an_earlier_version_are_read(kind, earlier):
    """As their files have them, CSV or Parquet; text stays text."""
    with inside(earlier):
        runs = stored(connect(), kind)
        assert runs and all({*run.tables} == {*TABLES[kind].split()} for run in runs)
        for run in runs:
            for name, table in run.tables.items():
                (path,) = Path(run["artifacts"]).glob(f"{name}.*")
                csv = path.suffix == ".csv"
                kept = pd.read_csv(path, float_precision="round_trip") if csv else pd.read_parquet(path)
                assert [*table] == [*kept] and len(table) == len(kept) > 0
                numbers = kept.select_dtypes("number").columns.difference(TEXT)
                pd.testing.assert_frame_equal(table[numbers], kept[numbers], check_dtype=False, check_exact=True)
                cells = table[table.columns.intersection(TEXT)].stack().dropna()
                assert cells.map(type).eq(str).all()
