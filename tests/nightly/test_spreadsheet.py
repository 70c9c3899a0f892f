"""No file that a command writes for people holds a formula, whatever the names of a corpus."""

import csv
import re

import pandas as pd
import pytest

from bench.cli import main

pytestmark = pytest.mark.nightly
EVIL = "=HYPERLINK(1)"


def test_names_of_a_corpus_are_no_formulas_in_what_people_open(tmp_path, capsys):
    rows = [
        (s, g, r, f, r * 3 + f + 40 * (g != "tap"))
        for s in (EVIL, "@b", "-c")
        for g in ("tap", EVIL)
        for r in (0, 1)
        for f in range(3)
    ]
    pd.DataFrame(rows, columns=["subject", "gesture", "repetition", "frame", "ch1"]).to_csv("evil.csv", index=False)
    assert main("data import table evil.csv name=evil grid=1x1 rate_hz=10 full_scale=255".split()) == 0
    system = ["data=evil", "model=bayes", "features=jung28"]
    for line in (
        "run",
        "report",
        "stress faults=noise",
        "run after=each stopping=yes",
        "fit out=saved",
        "predict saved evil.csv out=labels.csv",
    ):
        name, *more = line.split()
        assert main([name, *([] if name in ("report", "predict") else system), *more]) == 0
    seen = [*tmp_path.glob("report/*.csv"), *tmp_path.glob("stress/*.csv"), tmp_path / "labels.csv"]
    texts = {}
    for path in seen:
        with path.open(newline="", encoding="utf-8") as f:
            texts[path] = [cell for each in csv.reader(f) for cell in each]
        assert not [c for c in texts[path] if re.match(r"[=@\t\r]|[+-][a-zA-Z]", c)], path
    assert len(seen) > 10 and any(f"'{EVIL}" in cells for cells in texts.values())
