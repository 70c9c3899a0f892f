"""LaTeX tables: every number where it belongs, every caption whole, every text as it was."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.comparable import MARK
from bench.measures import Cost, Measure, run_columns
from reports.latex import escaped, latex


def row(system, accuracy, **more):
    about = {"data": "my_arm", "subset": "a < 50 % #1", "protocol": "LOSO", "group": "g", "unit": "capture"}
    numbers = {"low": 40.04, "high": 60.06, "subject_sd": 2.0, "macro_f1": 49.9, "flash_bytes": 4000, "p_holm": np.nan}
    counts = {
        "captures": 48,
        "subjects": 4,
        "folds": "4/4",
        "seed": "0",
        "against": "",
        "source": "store",
        "combined": "",
    }
    return {"system": system, "accuracy": accuracy, "predict_ms_p50": 1.5} | about | numbers | counts | more


def tables_of(text):
    """Caption and rows of every table, cells in text."""
    found = []
    for block in re.findall(r"\\begin\{table\}.*?\\end\{table\}", text, flags=re.DOTALL):
        caption = re.search(r"\\caption\{(.*)\}\n", block)[1]
        body = re.search(r"\\midrule\n(.*?)\\bottomrule", block, flags=re.DOTALL)[1]
        head = re.search(r"\\toprule\n(.*?) \\\\\n", block)[1].split(" & ")
        rows = [re.split(r"(?<!\\) & ", line.removesuffix(r" \\")) for line in body.strip().splitlines()]
        found.append((caption, [dict(zip(head, each, strict=True)) for each in rows]))
    return found


def test_each_comparison_is_a_table_with_its_numbers_its_best_and_its_p():
    rows = [
        row(f"a {MARK}", 90.0),
        row("b & co_1 · x", 85.04, seed="3", combined="majority vote"),
        row("c", 80.0, p_holm=0.0004, against="b & co_1 · x", low=np.nan, folds="3/4"),
        row("d", 70.0, unit="window", low=np.nan, data="x (synthetic)"),
    ]
    (caption, captures), (other, windows) = tables_of(latex(pd.DataFrame(rows)))
    names = [r"a $^\dagger$", r"b \& co\_1 $\cdot$ x, seed 3, majority vote", "c, 3/4 folds"]
    assert [r["system"] for r in captures] == names and [r["system"] for r in windows] == ["d"]
    assert [r["accuracy"] for r in captures] == ["90.0", r"\textbf{85.0}", "80.0"] and windows[0]["accuracy"] == "70.0"
    assert [r[r"95\,\% interval"] for r in captures] == ["40.0--60.1", "40.0--60.1", "--"]
    assert [r["$p$ (Holm)"] for r in captures] == ["--", "--", "$<$ 0.001"] and "$p$ (Holm)" not in windows[0]
    assert (captures[0]["kB"], captures[0]["ms"], captures[0]["SD"]) == ("4", "1.50", "2.0")
    for fact in (
        r"my\_arm",
        r"a $<$ 50 \% \#1",
        "48 captures of 4 subjects",
        r"against b \& co",
        r"$^\dagger$",
    ):
        assert fact in caption
    assert "generated" in other and "generated" not in caption and "by window" in other


def test_the_caption_defines_each_classifier_once_with_its_parameters():
    rows = [row("svm · jung54", 60.0), row("svm[C=8] · touch", 70.0), row("reflex", 80.0)]
    ((caption, _),) = tables_of(latex(pd.DataFrame(rows)))
    assert caption.count("svm:") == 1 and "C=512, gamma=0.125, kernel=rbf, scaling=range" in caption
    assert "bayes:" not in caption and "reflex:" not in caption


def test_text_is_escaped_and_control_characters_are_gone():
    assert escaped("a_b & 50 % {x} #1 $2 ~ ^ \\") == (
        r"a\_b \& 50 \% \{x\} \#1 \$2 \textasciitilde{} \textasciicircum{} \textbackslash{}"
    )
    assert escaped("a\nb\x1bc\u202e") == "a bc"


def test_headings_without_latex_are_escaped(monkeypatch):
    every = [*run_columns(), Cost("battery_life"), Measure("hum", "hum %", shows=("latex",))]
    monkeypatch.setattr("reports.latex.run_columns", lambda: every)
    ((_, (shown,)),) = tables_of(latex(pd.DataFrame([row("a", 50.0, battery_life=2.0, hum=1.0)])))
    assert (shown[r"battery\_life"], shown[r"hum \%"]) == ("2.0", "1.0")


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="pdflatex is not installed")
def test_it_compiles():
    Path("tables.tex").write_text(latex(pd.DataFrame([row("a \\ { } \" ' ` ~ ^ < > | $ % # _ &", 50.0)] * 2)))
    head = "\\documentclass{article}\\usepackage{booktabs}\\begin{document}\\input{tables}\\end{document}"
    Path("paper.tex").write_text(head)
    done = subprocess.run(["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper"], capture_output=True)
    assert done.returncode == 0 and "Missing character" not in Path("paper.log").read_text(errors="replace")
