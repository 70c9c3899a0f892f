"""The values behind everything that is shown and chosen, against values by hand: measures, costs, tables, results."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from bench.columns import run_columns
from bench.errors import InputError
from bench.intervals import drawn, ratio_interval, weights
from bench.measures import CODE, Cost, Interval, Measure, costs, in_thousands, percent, text, three
from bench.result import SMALL, Failure, Result, Tables
from bench.scores import over_people
from bench.table import Table, of_text, write_sheet
from bench.tables import file_of, read_table, uniform, write_table

ROW = {"share": 0.8125, "share_low": 0.75, "share_high": 0.9, "bytes": 90064, "p50": 1.5, "p95": None, "name": "a"}


@pytest.mark.parametrize(
    ("measure", "cell", "words"),
    [
        (percent("share"), 81.25, "81.2"),
        (percent("accuracy", read="share", ends="share"), Interval(81.25, 75.0, 90.0), "81.2 [75.0, 90.0]"),
        (percent("share", ends="bytes"), 81.25, "81.2"),  # no interval of this name
        (Measure("kB", read="bytes", form=three, scale=in_thousands), 90.064, "90.1"),
        (Measure("B", read="bytes", form=three), 90064, "90 064"),
        (Measure("ms", read=("p50", "p95"), form=".2f"), (1.5, None), "1.50"),
        (Measure("ms", read=("p95", "p50")), (None, 1.5), "- / 1.5"),
        (text("name"), "a", "a"),
        (Measure("nothing", read=lambda row: pd.NA), None, "-"),
        (Measure("zero", read=lambda row: 0.0), 0.0, "0.0"),
    ],
)
def test_a_measure_reads_and_writes_a_value(measure, cell, words):
    assert measure.cell(ROW) == cell and measure.of(ROW) == words


def test_costs_have_their_budgets_units_and_lines():
    every = costs()
    of_captures = ["flash", "ram", "predict", "decision", "fault_loss", "worst_fault"]
    assert list(every) == [*of_captures, "worst_person", "worst_tenth"]
    assert every["flash"].typed("1MiB") == pytest.approx(1048.576) and every["flash"].cell({"flash_bytes": 2500}) == 2.5
    run = {"flash_bytes": 2500, "ram_bytes": 512, "predict_ms_p50": 1.5, "predict_ms_p95": 9, "capture_ms": 300}
    run |= {"observed_ms": 100, "peak_rss_bytes": 7}
    amounts = {"flash": 2.5, "ram": 0.512, "predict": 1.5, "decision": 300}
    assert {name: cost.cell(run) for name, cost in every.items() if cost.among is None} == amounts
    least = {"worst_person", "worst_tenth"}
    assert {c.budget for c in every.values()} == {f"{'min' if name in least else 'max'}_{name}" for name in every}
    with pytest.raises(InputError, match="min_worst_person=101: give a number from 0 to 100"):
        every["worst_person"].typed("101")
    assert every["worst_person"].line == ("people", "worst_person") and every["ram"].line == ("budget", "ram")
    with pytest.raises(InputError, match="max_flash="):
        every["flash"].typed("3ms")
    assert [every["flash"].amount(number) for number in (64, 1234.5, np.nan)] == ["64 kB", "1234 kB", "-"]
    assert every["flash"].apart(64.001, 64.002) == ("64.001 kB", "64.002 kB")
    last = Cost("battery_life", unit="h", better="high")
    assert (last.budget, last.extreme, last.burden(3.0)) == ("min_battery_life", "highest", -3.0)
    assert (last.noun, last.words, last.axis) == ("battery life", "of battery life", "battery life (h)")
    assert (
        every["flash"].argument(64) == "max_flash=64kB" and every["worst_fault"].argument(2.5) == "max_worst_fault=2.5"
    )


def test_columns_of_runs_by_hand():
    run = {"accuracy": 0.75, "pooled_accuracy": 0.8, "subject_sd": 0.125, "fit_seconds": 1.234, "subjects": 4}
    columns = {measure.key: measure for measure in run_columns()}
    found = {name: columns[name].of(run) for name in ("accuracy", "pooled_accuracy", "subject_sd", "fit_seconds")}
    assert found == {"accuracy": "75.0", "pooled_accuracy": "80.0", "subject_sd": "12.5", "fit_seconds": "1.23"}
    hits = pd.DataFrame({"subject": range(10), "true": "a", "predicted": "a"}).loc[lambda t: t.index.repeat(20)]
    hits.loc[hits.groupby("subject").cumcount() >= hits["subject"].map(lambda n: 15 + 3 * (-1) ** n), "predicted"] = "b"
    people = over_people(hits)  # of half of the subjects 0.9, of the others 0.6
    half = 15 * (10 / 9) ** 0.5 * 2.262157 / 10**0.5  # SD, and t of 9 degrees of freedom
    run |= {"accuracy": people["accuracy"], "accuracy_low": people["low"], "accuracy_high": people["high"]}
    assert columns["accuracy"].of(run) == f"75.0 [{75 - half:.1f}, {75 + half:.1f}]"
    assert columns["accuracy"].of({}) == "-"


def test_people_are_drawn_with_the_usual_seed():
    people = np.random.default_rng(0).integers(0, 5, (2000, 5))
    assert drawn(5).tolist() == people.tolist()
    assert weights([4], 9)[0].tolist() == np.random.default_rng(0).multinomial(4, [0.25] * 4, 9).tolist()
    hits, captures = np.array([5, 0, 3, 1, 2]), np.array([5, 1, 4, 2, 2])
    shares = [sum(hits[each]) / sum(captures[each]) for each in people]
    assert ratio_interval(np.stack([hits, captures], axis=1)) == pytest.approx(np.quantile(shares, [0.025, 0.975]))


def test_a_table_shows_what_fits_and_keeps_all_numbers(tmp_path):
    columns = [
        text("name", "system"),
        percent("share", "accuracy %", ends="share"),
        Measure("bytes", form=",.0f", spare=1),
    ]
    columns += [Measure("p95", "p95 ms", spare=3), Measure("code", form=CODE, spare=2)]
    rows = [ROW | {"code": "bench run"}, {"name": "=b", "share": 0.5, "code": ""}]
    table = Table(columns, rows, "Title", [1], remarks=[["x", "y"], ["y"]], groups=["g", "g"])
    assert table.headings == ["system", "accuracy %", "bytes", "code"]  # nothing is known of p95
    assert table.texts[1] == {"system": "=b", "accuracy %": "50.0", "bytes": "-", "code": ""}
    assert table.notes == ["x", "y"] and [line["marks"] for line in table.lines] == [[1, 2], [2]]
    frame = table.frame()
    assert [*frame] == ["name", "share", "share_low", "share_high", "bytes", "p95", "code"]
    assert frame["share"].tolist() == [81.25, 50]
    assert frame["share_low"].tolist()[0] == 75 and frame["share_low"].isna()[1]
    write_sheet(table.frame(), tmp_path / "t.csv")
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert lines[2].startswith("'=b,50.0")  # no formula in a spreadsheet
    out = Console(width=38, record=True)  # system, accuracy % and bytes take 39 columns, code another 12
    table.print(out)
    printed = out.export_text()
    assert "columns left out: code, bytes; a terminal of 51 columns" in " ".join(printed.split())
    assert "81.2 [75.0, 90.0]" in printed
    assert of_text(pd.DataFrame({"a": ["1"]}), code=["a"]).code == {"a"}


def test_what_does_not_fit_follows_in_lines_under_its_row():
    """At every width: nothing is wider, names and numbers are whole, and only long text takes further lines."""
    columns = [text("system"), *(Measure(f"n{i}", f"number {i}", form=".4f") for i in range(9)), text("verdict")]
    rows = [
        {"system": f"system {j}", "verdict": "ruled out"} | {f"n{i}": 10 * j + i / 7 for i in range(9)} for j in (1, 2)
    ]
    table = Table(columns, rows, "Title")
    for width in (24, 40, 72, 100, 160):
        out = Console(width=width, record=True)
        table.print(out)
        lines = out.export_text().splitlines()
        assert max(map(len, lines)) <= width and len({len(line) for line in lines[1:]}) == 1
        assert [line.split()[1:3] for line in lines if "│ system" in line] == [["system", "1"], ["system", "2"]]
        shown = " ".join("".join(lines).replace("│", " ").split())
        assert all(f"{row[f'n{i}']:.4f}" in shown for row in rows for i in range(9)) and shown.count("ruled out") == 2
        under = 0 if width == 160 else -(-(9 * len("number 1 20.0000, ")) // (width - 6)) + 3
        assert len(lines) <= 5 + len(rows) * (1 + under)


def test_a_result_is_a_mapping_and_reads_its_tables_when_asked():
    about = {"system": "s", "seed": "1", "data": "d", "synthetic": "true", "subset": "all", "target": "gesture"}
    about |= {"protocol_label": "LOSO", "touchbench.kind": "cell", "status": "FAILED", "accuracy": "text"}
    asked = []

    def read(name, columns=()):
        asked.append(name)
        return pd.DataFrame({"n": range({"small": 3, "large": SMALL + 1}.get(name, 0))}) if name != "none" else None

    tables = Tables({"kept": pd.DataFrame({"n": [1]})}, read, "s (run 7) is missing", lambda: ["small", "large"])
    result = Result(
        about, {"accuracy": 0.5, "folds": 2, "folds_failed": 1}, tables, {"f": Failure("ValueError: no", "traceback")}
    )
    assert result["accuracy"] == 0.5 and dict(result)["accuracy"] == 0.5  # a number before a text of the same name
    assert len(result) == len(dict(result)) == len(about) + 2
    assert (result.method, result.context[0], result.folds) == ("s, seed 1", "d (synthetic)", "2/3")
    assert not result.complete and result.alone and result.scored
    for name in ("kept", "small", "small", "large", "large"):
        assert len(result.tables[name])
    assert asked == ["small", "large", "large"]
    assert [*result.tables] == ["small", "large", "kept"] and len(result.tables) == 3  # without reading
    assert asked == ["small", "large", "large"]
    with pytest.raises(InputError, match=r"none of s \(run 7\) is missing"):
        result.tables["none"]
    assert "none" not in result.tables and result.tables.get("none", 0) == 0
    assert result.tables.columns("small", ["n"])[0].tolist() == [0, 1, 2] and result.tables.columns("none", []) is None


words = st.sampled_from(["NA", "null", "nan", "03", "1.0", "1", "", "True", "a,b", 'a"b', "ü ", "inf"]) | st.text(
    "aé,\" '"
)


@given(labels=st.lists(words, min_size=1, max_size=5))
def test_stored_text_stays_text(tmp_path_factory, labels):
    folder = tmp_path_factory.mktemp("tables")
    table = pd.DataFrame({"true": labels, "label": labels[::-1], "share": 0.1 + 0.2})
    write_table(table, folder / file_of("touches"))
    assert file_of("touches") == "touches.parquet"
    pd.testing.assert_frame_equal(read_table(folder / file_of("touches"), "touches"), table, check_dtype=False)
    columns = read_table(folder / file_of("touches"), "touches", columns=["share", "label"])
    assert columns["share"].to_pylist() == [0.1 + 0.2] * len(labels)
    assert columns["label"].to_pylist() == labels[::-1]


def test_a_column_is_stored_as_numbers_or_as_text(tmp_path):
    values = {
        "class": [int, None, str],
        "tuple": [(1, "a"), (2, 3), None],
        "list": [[1], [], ["a"]],
        "whole": [8, None, 9],
        "truth": [True, None, False],
        "text": ["03", None, ""],
        "none": [None] * 3,
        "number": [0.5, None, 2.0],
        "all whole": [8, 2, 3],
        "whole and not": [8, 0.5, 3],
    }
    table = pd.DataFrame({name: pd.Series(column, dtype=object) for name, column in values.items()})
    write_table(table, tmp_path / "odd.parquet")
    read = read_table(tmp_path / "odd.parquet", "odd")
    pd.testing.assert_frame_equal(read, uniform(table), check_dtype=False)
    pd.testing.assert_frame_equal(uniform(read), read)
    lists = {name: column.astype(object).where(column.notna(), None).tolist() for name, column in read.items()}
    assert lists["class"] == ["<class 'int'>", None, "<class 'str'>"] and lists["tuple"] == ["(1, 'a')", "(2, 3)", None]
    assert lists["list"] == ["[1]", "[]", "['a']"] and lists["whole"] == ["8", None, "9"]
    assert lists["truth"] == ["True", None, "False"] and lists["text"] == ["03", None, ""]
    for name in ("none", "number", "all whole", "whole and not"):
        assert lists[name] == values[name]
    assert [read[name].dtype.kind for name in ("number", "all whole", "whole and not")] == ["f", "i", "f"]
    twice = uniform(pd.DataFrame([[1, "a", 2, 3]], columns=["a", "a.1", "a", 4]))
    assert [*twice] == ["a", "a.1", "a.2", "4"] and twice.iloc[0].tolist() == [1, "a", 2, 3]
