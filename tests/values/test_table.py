"""Tables: what fits into a terminal, and that all numbers are kept."""

import pandas as pd
from rich.console import Console

from bench.values.measures import CODE, Measure, percent_measure, text_measure
from bench.values.table import Table, text_table, write_sheet

COLUMNS = [
    text_measure("name", "system"),
    percent_measure("share", "accuracy %", ends="share"),
    Measure("bytes", form=",.0f", spare=1),
    Measure("p95", "p95 ms", spare=3),
    Measure("code", form=CODE, spare=2),
]
ROWS = [
    {"name": "a", "share": 0.8125, "share_low": 0.75, "share_high": 0.9, "bytes": 90064},
    {"name": "=b", "share": 0.5, "code": ""},
]
ROWS[0]["code"] = "bench run"
TABLE = Table(COLUMNS, ROWS, "Title", [1], remarks=[["x", "y"], ["y"]], groups=["g", "g"])


def test_cells_and_footnotes():
    assert TABLE.headings == ["system", "accuracy %", "bytes", "code"]  # p95 has no value
    assert TABLE.texts[1] == {"system": "=b", "accuracy %": "50.0", "bytes": "-", "code": ""}
    assert TABLE.footnotes == ["x", "y"]
    assert [row["marks"] for row in TABLE.template_rows] == [[1, 2], [2]]
    assert text_table(pd.DataFrame({"a": ["1"]}), code=["a"]).code_headings == {"a"}


def test_a_frame_has_all_numbers_and_a_sheet_no_formula(tmp_path):
    frame = TABLE.to_frame()
    assert [*frame] == ["name", "share", "share_low", "share_high", "bytes", "p95", "code"]
    assert frame["share"].tolist() == [81.25, 50]
    assert frame["share_low"].isna().tolist() == [False, True]
    write_sheet(frame, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text().splitlines()[2].startswith("'=b,50.0")


def test_columns_that_do_not_fit_are_named():
    out = Console(width=38, record=True)  # the first three columns take 39, the last 12
    TABLE.print(out)
    printed = out.export_text()
    assert "columns left out: code, bytes; a terminal of 51 columns" in " ".join(printed.split())
    assert "81.2 [75.0, 90.0]" in printed


def test_numbers_that_do_not_fit_follow_under_their_row():
    """At every width: nothing is wider, names and numbers are whole, only long text is wrapped."""
    numbers = [Measure(f"n{i}", f"number {i}", form=".4f") for i in range(9)]
    rows = [{f"n{i}": 10 * j + i / 7 for i in range(9)} for j in (1, 2)]
    rows = [row | {"system": f"system {j}", "verdict": "ruled out"} for j, row in enumerate(rows)]
    table = Table([text_measure("system"), *numbers, text_measure("verdict")], rows, "Title")
    for width in (24, 40, 72, 100, 160):
        out = Console(width=width, record=True)
        table.print(out)
        lines = out.export_text().splitlines()
        assert max(map(len, lines)) <= width and len({len(line) for line in lines[1:]}) == 1
        names = [line.split()[1:3] for line in lines if "│ system" in line]
        assert names == [["system", "0"], ["system", "1"]]
        shown = " ".join("".join(lines).replace("│", " ").split())
        assert all(f"{row[f'n{i}']:.4f}" in shown for row in rows for i in range(9))
        assert shown.count("ruled out") == 2
        under = 0 if width == 160 else -(-(9 * len("number 1 20.0000, ")) // (width - 6)) + 3
        assert len(lines) <= 5 + len(rows) * (1 + under)
