"""Runs that an earlier version stored are read, and the same is printed of them."""

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

from bench.outcomes.runs import every_result
from bench.outcomes.store import connect
from bench.outcomes.tables import TEXT
from bench.result import PLAIN
from tests.net import masks
from tests.net.build import EARLIER, inside, step, unpack

PRINTED = {  # by what was typed behind "$ bench"
    re.match("[$] bench (.*)", text)[1]: text
    for text in re.split("(?m)^(?=[$] bench )", Path(str(EARLIER).replace(".tar.xz", ".txt")).read_text())[1:]
}
BESIDE = "stability/stability"  # files that the runs of a command shared
TABLES = {  # of runs, by their kind: names of today, and of the stored files where they are others
    "cell": {"confusion", "per_class", "per_subject", "predictions"},
    "stress": {"labels": "stress"} | {n: f"{BESIDE}_{n}" for n in ("faults", "conditions", "learning", "slices")},
    "stream": {"rules": "chosen", "instants": "instants", "replay": "predictions", "stopping": "stopping"},
    "watch": {"chosen", "curve", "per_subject", "predictions", "reports", "touches", "trials"},
    "chip": {"c": "predictions"},
}
TABLES["stress"] |= {"margins": f"{BESIDE}_half_margins"}
TABLES["stream"] |= {"thresholds": "trials"}
TABLES |= {kind: {n: n for n in names} for kind, names in TABLES.items() if isinstance(names, set)}
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
        runs = [r for r in every_result(connect()) if r.about.get(PLAIN, r.kind) == kind]
        assert runs and all({*run.tables} == {*TABLES[kind]} for run in runs)
        for run in runs:
            for name, table in run.tables.items():
                (path,) = [
                    p
                    for p in Path(run["artifacts"]).glob(f"{TABLES[kind][name]}.*")
                    if p.suffix in (".csv", ".parquet")
                ]
                csv = path.suffix == ".csv"
                kept = pd.read_csv(path, float_precision="round_trip") if csv else pd.read_parquet(path)
                if "stability" in TABLES[kind][name]:  # of all systems of the command
                    kept = kept[kept["system"] == run["system"]].reset_index(drop=True)
                    kept = kept.drop(columns=["data", "subset", "protocol", "system", "seed"])
                assert {*table} - {"circumstance"} == {*kept.columns} if name != "labels" else len(table.columns) == 13
                assert len(table) == len(kept) > 0
                if (
                    name == "labels"
                ):  # the key of the circumstance is another column, and numbers of subjects are levels
                    harmed = table["circumstance"] == "under"
                    assert (harmed == (kept["fault"] != "none")).all() and {*table["circumstance"]} > {""}
                    assert (table["case"][harmed] == kept["fault"][harmed]).all()
                    assert (table["level"][harmed] == kept["severity"][harmed]).all()
                    fewer = table[table["circumstance"] == "train_subjects"]
                    assert (fewer["level"] == fewer["train_subjects"]).all() and {*fewer["level"]} == {1, 2}
                    kept = kept.drop(columns=["fault", "severity"])
                numbers = kept.select_dtypes("number").columns.difference(TEXT)
                pd.testing.assert_frame_equal(table[numbers], kept[numbers], check_dtype=False, check_exact=True)
                cells = table[table.columns.intersection(TEXT)].stack().dropna()
                assert cells.map(type).eq(str).all()


def test_times_of_an_earlier_version_are_of_the_wall_clock(earlier):
    with inside(earlier):
        for run in every_result(connect()):
            names = {name for name in run.metrics if re.match("(fit|adapt|predict|decide|replay)_.*(ms|seconds)", name)}
            assert names and all("wall" in name or "cpu" in name for name in names)
            assert "decision_ms" not in run.metrics
            replayed = run.about.get(PLAIN) == "stream"
            assert replayed == ("replay_wall_ms_p50" in names) and not (replayed and "decide_wall_ms_p50" in names)
