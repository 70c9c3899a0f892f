"""CSV files for people hold no formulas."""

import csv

import numpy as np
import pandas as pd

from bench.values.table import write_sheet


def test_a_text_that_would_be_a_formula_is_led_by_an_apostrophe_and_numbers_stay(tmp_path):
    texts = ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3", "\t=1", "-a"]
    write_sheet(pd.DataFrame([texts], columns=texts), tmp_path / "formulas.csv")
    with (tmp_path / "formulas.csv").open(newline="") as f:
        assert list(csv.reader(f)) == [[f"'{text}" for text in texts]] * 2
    harmless = pd.DataFrame({"n": [-1.5, np.nan], "t": ["-1.5", "-"], "u": ["a=b", ""]})
    write_sheet(harmless, tmp_path / "harmless.csv")
    assert (tmp_path / "harmless.csv").read_text() == harmless.to_csv(index=False)
