"""The values behind everything that is shown and chosen, against values by hand: measures, costs, tables, results."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from bench.errors import InputError
from bench.store.tables import as_stored, read_table, table_file, write_table
from bench.values.columns import run_columns
from bench.values.intervals import ratio_interval
from bench.values.measures import (
    CODE,
    Cost,
    Interval,
    Measure,
    all_costs,
    format_three_digits,
    percent_measure,
    text_measure,
    to_thousands,
)
from bench.values.result import KEPT_ROWS, Failure, Result, RunTables
from bench.values.table import Table, text_table, write_sheet

ROW = {
    "share": 0.8125,
    "share_low": 0.75,
    "share_high": 0.9,
    "bytes": 90064,
    "p50": 1.5,
    "p95": None,
    "name": "a",
}


@pytest.mark.parametrize(
    ("measure", "cell", "words"),
    [
        (
            percent_measure("accuracy", source="share", ends="share"),
            Interval(81.25, 75.0, 90.0),
            "81.2 [75.0, 90.0]",
        ),
        (percent_measure("share", ends="bytes"), 81.25, "81.2"),  # no interval of this name
        (
            Measure("kB", source="bytes", form=format_three_digits, scale=to_thousands),
            90.064,
            "90.1",
        ),
        (Measure("B", source="bytes", form=format_three_digits), 90064, "90 064"),
        (Measure("ms", source=("p50", "p95"), form=".2f"), (1.5, None), "1.50"),
        (Measure("ms", source=("p95", "p50")), (None, 1.5), "- / 1.5"),
        (text_measure("name"), "a", "a"),
        (Measure("nothing", source=lambda row: pd.NA), None, "-"),
        (Measure("zero", source=lambda row: 0.0), 0.0, "0.0"),
    ],
)
def test_a_measure_reads_and_writes_a_value(measure, cell, words):
    assert measure.value_of_row(ROW) == cell and measure.as_text(ROW) == words


def test_costs_have_their_budgets_units_and_lines():
    every = all_costs()
    least = ["worst_person", "worst_tenth"]
    assert [*every] == ["flash", "ram", "predict", "decision", "fault_loss", "worst_fault", *least]
    assert {c.budget_key for c in every.values()} == {
        f"{'min' if name in least else 'max'}_{name}" for name in every
    }
    run = {
        "flash_bytes": 2500,
        "ram_bytes": 512,
        "predict_ms_p50": 1.5,
        "predict_ms_p95": 9,
        "capture_ms": 300,
    }
    amounts = {"flash": 2.5, "ram": 0.512, "predict": 1.5, "decision": 300}
    assert {
        name: cost.value_of_row(run) for name, cost in every.items() if cost.of_people is None
    } == amounts
    flash = every["flash"]
    assert (
        flash.parse_budget("1MiB") == pytest.approx(1048.576)
        and flash.format_budget(64) == "max_flash=64kB"
    )
    for name, typed, fact in (
        ("worst_person", "101", "min_worst_person=101: give a number from 0 to 100"),
        ("flash", "3ms", "max_flash="),
    ):
        with pytest.raises(InputError, match=fact):
            every[name].parse_budget(typed)
    assert [flash.format_amount(number) for number in (64, 1234.5, np.nan)] == [
        "64 kB",
        "1234 kB",
        "-",
    ]
    assert flash.format_two_amounts(64.001, 64.002) == ("64.001 kB", "64.002 kB")
    last = Cost("battery_life", unit="h", better="high")
    assert (last.budget_key, last.best_word, last.as_burden(3.0)) == (
        "min_battery_life",
        "highest",
        -3.0,
    )
    assert (last.noun, last.phrase, last.axis) == (
        "battery life",
        "of battery life",
        "battery life (h)",
    )


def test_columns_of_runs_by_hand():
    run = {
        "accuracy": 0.75,
        "pooled_accuracy": 0.8,
        "subject_sd": 0.125,
        "fit_seconds": 1.234,
        "subjects": 4,
    }
    columns = {measure.key: measure for measure in run_columns()}
    found = {
        name: columns[name].as_text(run)
        for name in ("accuracy", "pooled_accuracy", "subject_sd", "fit_seconds")
    }
    assert found == {
        "accuracy": "75.0",
        "pooled_accuracy": "80.0",
        "subject_sd": "12.5",
        "fit_seconds": "1.23",
    }
    assert (
        columns["accuracy"].as_text(run | {"accuracy_low": 0.7, "accuracy_high": 0.8})
        == "75.0 [70.0, 80.0]"
    )
    assert columns["accuracy"].as_text({}) == "-"


def test_the_interval_of_a_ratio_is_that_of_people_drawn_with_the_usual_seed():
    hits, captures = np.array([5, 0, 3, 1, 2]), np.array([5, 1, 4, 2, 2])
    shares = [
        sum(hits[each]) / sum(captures[each])
        for each in np.random.default_rng(0).integers(0, 5, (2000, 5))
    ]
    assert ratio_interval(np.stack([hits, captures], axis=1)) == pytest.approx(
        np.quantile(shares, [0.025, 0.975])
    )


def test_a_table_shows_what_fits_and_keeps_all_numbers(tmp_path):
    columns = [
        text_measure("name", "system"),
        percent_measure("share", "accuracy %", ends="share"),
        Measure("bytes", form=",.0f", spare=1),
        Measure("p95", "p95 ms", spare=3),
        Measure("code", form=CODE, spare=2),
    ]
    rows = [ROW | {"code": "bench run"}, {"name": "=b", "share": 0.5, "code": ""}]
    table = Table(columns, rows, "Title", [1], remarks=[["x", "y"], ["y"]], groups=["g", "g"])
    assert table.headings == ["system", "accuracy %", "bytes", "code"]  # nothing is known of p95
    assert table.texts[1] == {"system": "=b", "accuracy %": "50.0", "bytes": "-", "code": ""}
    assert table.footnotes == ["x", "y"] and [line["marks"] for line in table.template_rows] == [
        [1, 2],
        [2],
    ]
    frame = table.to_frame()
    assert [*frame] == ["name", "share", "share_low", "share_high", "bytes", "p95", "code"]
    assert frame["share"].tolist() == [81.25, 50] and frame["share_low"].isna().tolist() == [
        False,
        True,
    ]
    write_sheet(frame, tmp_path / "t.csv")
    assert (
        (tmp_path / "t.csv").read_text().splitlines()[2].startswith("'=b,50.0")
    )  # no formula in a spreadsheet
    out = Console(
        width=38, record=True
    )  # system, accuracy % and bytes take 39 columns, code another 12
    table.print(out)
    printed = out.export_text()
    assert "columns left out: code, bytes; a terminal of 51 columns" in " ".join(printed.split())
    assert "81.2 [75.0, 90.0]" in printed
    assert text_table(pd.DataFrame({"a": ["1"]}), code=["a"]).code_headings == {"a"}


def test_what_does_not_fit_follows_in_lines_under_its_row():
    """At every width: nothing is wider, names and numbers are whole, and only long text takes further lines."""
    columns = [
        text_measure("system"),
        *(Measure(f"n{i}", f"number {i}", form=".4f") for i in range(9)),
        text_measure("verdict"),
    ]
    rows = [
        {"system": f"system {j}", "verdict": "ruled out"}
        | {f"n{i}": 10 * j + i / 7 for i in range(9)}
        for j in (1, 2)
    ]
    table = Table(columns, rows, "Title")
    for width in (24, 40, 72, 100, 160):
        out = Console(width=width, record=True)
        table.print(out)
        lines = out.export_text().splitlines()
        assert max(map(len, lines)) <= width and len({len(line) for line in lines[1:]}) == 1
        assert [line.split()[1:3] for line in lines if "│ system" in line] == [
            ["system", "1"],
            ["system", "2"],
        ]
        shown = " ".join("".join(lines).replace("│", " ").split())
        assert (
            all(f"{row[f'n{i}']:.4f}" in shown for row in rows for i in range(9))
            and shown.count("ruled out") == 2
        )
        under = 0 if width == 160 else -(-(9 * len("number 1 20.0000, ")) // (width - 6)) + 3
        assert len(lines) <= 5 + len(rows) * (1 + under)


def test_a_result_is_a_mapping_and_reads_its_tables_when_asked():
    about = {
        "system": "s",
        "seed": "1",
        "data": "d",
        "synthetic": "true",
        "subset": "all",
        "target": "gesture",
    }
    about |= {
        "protocol_label": "LOSO",
        "touchbench.kind": "cell",
        "status": "FAILED",
        "accuracy": "text",
    }
    asked = []

    def read(name, columns=()):
        asked.append(name)
        return (
            pd.DataFrame({"n": range({"small": 3, "large": KEPT_ROWS + 1}.get(name, 0))})
            if name != "none"
            else None
        )

    tables = RunTables(
        {"kept": pd.DataFrame({"n": [1]})}, read, "s (run 7) is missing", lambda: ["small", "large"]
    )
    failed = {"f": Failure("ValueError: no", "traceback")}
    result = Result(about, {"accuracy": 0.5, "folds": 2, "folds_failed": 1}, tables, failed)
    assert (
        result["accuracy"] == dict(result)["accuracy"] == 0.5
    )  # a number before a text of the same name
    assert (result.system_with_seed, result.context[0], result.folds) == (
        "s, seed 1",
        "d (synthetic)",
        "2/3",
    )
    assert not result.is_complete and result.predicts_alone and result.has_scores
    assert [*result.tables] == ["small", "large", "kept"] and not asked
    assert all(len(result.tables[name]) for name in ("kept", "small", "small", "large", "large"))
    assert asked == ["small", "large", "large"]  # large ones are not kept in memory
    with pytest.raises(InputError, match=r"none of s \(run 7\) is missing"):
        result.tables["none"]
    assert "none" not in result.tables and result.tables.get("none", 0) == 0
    assert (
        result.tables.read_columns("small", ["n"])[0].tolist() == [0, 1, 2]
        and result.tables.read_columns("none", []) is None
    )


words = st.sampled_from(
    ["NA", "null", "nan", "03", "1.0", "1", "", "True", "a,b", 'a"b', "ü ", "inf"]
) | st.text("aé,\" '")


@given(labels=st.lists(words, min_size=1, max_size=5))
def test_stored_text_stays_text(tmp_path_factory, labels):
    folder = tmp_path_factory.mktemp("tables")
    table = pd.DataFrame({"true": labels, "label": labels[::-1], "share": 0.1 + 0.2})
    write_table(table, folder / table_file("touches"))
    assert table_file("touches") == "touches.parquet"
    pd.testing.assert_frame_equal(
        read_table(folder / table_file("touches"), "touches"), table, check_dtype=False
    )
    columns = read_table(folder / table_file("touches"), "touches", columns=["share", "label"])
    assert columns["share"].to_pylist() == [0.1 + 0.2] * len(labels)
    assert columns["label"].to_pylist() == labels[::-1]


@pytest.mark.parametrize(
    ("values", "read", "kind"),
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
def test_a_column_is_stored_as_numbers_or_as_text(values, read, kind):
    table = pd.DataFrame({"a": pd.Series(values, dtype=object)})
    write_table(table, Path("odd.parquet"))
    found = read_table(Path("odd.parquet"), "odd")
    pd.testing.assert_frame_equal(found, as_stored(table), check_dtype=False)
    pd.testing.assert_frame_equal(as_stored(found), found)
    assert found["a"].astype(object).where(found["a"].notna(), None).tolist() == read
    assert kind == "O" or found["a"].dtype.kind == kind


def test_columns_of_one_name_are_told_apart():
    twice = as_stored(pd.DataFrame([[1, "a", 2, 3]], columns=["a", "a.1", "a", 4]))
    assert [*twice] == ["a", "a.1", "a.2", "4"] and twice.iloc[0].tolist() == [1, "a", 2, 3]
