"""CSV files for spreadsheets hold no formulas; those for programs hold what was there."""

import csv
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from reports.spreadsheet import write_sheet

EVIL = "=HYPERLINK(1)"


def cells_of(path):
    with Path(path).open(newline="", encoding="utf-8") as f:
        return [cell for row in csv.reader(f) for cell in row]


def formulas(path):
    return [c for c in cells_of(path) if c[:1] in ("=", "@", "\t", "\r") or (c[:1] in ("+", "-") and c[1:2].isalpha())]


@pytest.mark.parametrize("text", ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3", "\t=1", "-a"])
def test_a_text_that_would_be_a_formula_is_led_by_an_apostrophe(text, tmp_path):
    write_sheet(pd.DataFrame({text: [text]}), tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as f:
        assert list(csv.reader(f)) == [[f"'{text}"], [f"'{text}"]]


def test_numbers_dashes_and_other_texts_stay(tmp_path):
    table = pd.DataFrame({"n": [-1.5, np.nan], "t": ["-1.5", "-"], "u": ["a=b", ""]})
    table["i"] = pd.array([-3, None], "Int64")
    write_sheet(table, tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == table.to_csv(index=False)


def test_names_of_a_corpus_are_no_formulas_in_what_people_open(tmp_path, capsys):
    table = pd.DataFrame(
        [
            (s, g, r, f, r * 3 + f + 40 * (g != "tap"))
            for s in (EVIL, "@b", "-c")
            for g in ("tap", EVIL)
            for r in (0, 1)
            for f in range(3)
        ],
        columns=["subject", "gesture", "repetition", "frame", "ch1"],
    )
    table.to_csv("evil.csv", index=False)
    arguments = ["name=evil", "grid=1x1", "rate_hz=10", "full_scale=255"]
    assert main(["data", "import", "table", "evil.csv", *arguments]) == 0
    assert main(["run", "data=evil", "model=bayes", "features=jung28"]) == 0
    assert main(["report"]) == 0
    assert main(["stress", "data=evil", "model=bayes", "features=jung28", "faults=noise"]) == 0
    assert main(["stream", "data=evil", "model=bayes", "features=jung28", "out=streamed"]) == 0
    assert main(["fit", "data=evil", "model=bayes", "features=jung28", "out=saved"]) == 0
    assert main(["predict", "saved", "evil.csv", "out=labels.csv"]) == 0
    seen = [*Path("report").glob("*.csv"), *Path("stress").glob("*.csv"), *Path("streamed").glob("*.csv"), "labels.csv"]
    assert len(seen) > 10
    for path in seen:
        assert not formulas(path), path
    assert any(f"'{EVIL}" in cells_of(path) for path in seen)
    assert main(["extract", "data=evil", "features=jung28", "out=features.csv"]) == 0  # for programs: as it is
    assert set(pd.read_csv("features.csv")["gesture"]) == {"tap", EVIL}


def test_a_path_that_looks_like_an_option_can_be_labelled(tmp_path, capsys):
    table = pd.DataFrame({"subject": [1, 1, 2, 2] * 3, "gesture": ["a", "b"] * 6, "frame": 0, "ch1": range(12)})
    table["repetition"] = np.arange(12) // 4
    table.to_csv("t.csv", index=False)
    assert main(["data", "import", "table", "t.csv", "name=t", "grid=1x1", "rate_hz=10", "full_scale=255"]) == 0
    assert main(["fit", "data=t", "model=bayes", "features=jung28", "out=saved"]) == 0
    capsys.readouterr()
    for name in ("subject=3.csv", "out=3.csv"):
        table.to_csv(name, index=False)
        assert main(["predict", "saved", name]) == 0
        assert len(capsys.readouterr().out.splitlines()) == 13
    assert main(["predict", "saved", "out=4.csv"]) == 2
    assert "give a model and a file" in capsys.readouterr().err
