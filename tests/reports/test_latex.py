"""LaTeX tables: every number where it belongs, every caption whole, every text as it was."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bench
from bench.cli import main
from bench.reports.latex import COSTS, SCORES, escaped, latex, papers, sheet, side_by_side
from bench.result import MARK
from tests.results import evaluated, with_hits


def row(system, accuracy, **more):
    about = {"data": "my_arm", "subset": "a < 50 % #1", "protocol": "LOSO", "group": "g", "unit": "capture"}
    numbers = {"accuracy_low": 0.4004, "accuracy_high": 0.6006, "subject_sd": 0.02, "macro_f1": 0.499}
    numbers |= {"flash_bytes": 4000, "predict_ms_p50": 1.5}
    counts = {"captures": 48, "subjects": 4, "folds": "4/4", "seed": "0"}
    named = {"name": system, "system": system, "accuracy": accuracy / 100}
    return named | about | numbers | counts | more


def tables_of(text):
    """Caption and rows of every table, cells in text."""
    found, text = [], text.replace(r"\raggedright ", "").replace(r"\allowbreak{}", "")
    for block in re.findall(r"\\begin\{table\*?\}.*?\\end\{table\*?\}", text, flags=re.DOTALL):
        caption = re.search(r"\\caption\{(.*)\}\n", block)[1]
        body = re.search(r"\\midrule\n(.*?)\\bottomrule", block, flags=re.DOTALL)[1]
        head = re.search(r"(.*) \\\\\n\\midrule", block)[1].split(" & ")
        rows = [re.split(r"(?<!\\) & ", line.removesuffix(r" \\")) for line in body.strip().splitlines()]
        found.append((caption, [dict(zip(head, each, strict=True)) for each in rows]))
    return found


def test_each_comparison_is_a_table_with_its_numbers_its_best_and_its_p():
    rows = [
        row(f"a {MARK}", 90.0),
        row("b & co_1 · x", 85.04, name="b & co_1 · x, seed 3", combined="majority vote"),
        row("c", 80.0, p_holm=0.0004, against="b & co_1 · x", folds="3/4"),
        row("d", 70.0, unit="window", accuracy_low=np.nan, accuracy_high=np.nan, data="x (synthetic)"),
    ]
    (caption, captures), (other, windows) = tables_of(latex(rows))
    names = [r"a $^\dagger$", r"b \& co\_1 $\cdot$ x, seed 3, majority vote", "c, 3/4 folds"]
    assert [r["system"] for r in captures] == names and [r["system"] for r in windows] == ["d"]
    shown = ["90.0 [40.0, 60.1]", r"\textbf{85.0 [40.0, 60.1]}", "80.0 [40.0, 60.1]"]
    assert [r["accuracy"] for r in captures] == shown and windows[0]["accuracy"] == "70.0"
    assert [r["p Holm"] for r in captures] == ["--", "--", "$<$ 0.001"] and "p Holm" not in windows[0]
    assert (captures[0]["kB"], captures[0]["ms"], captures[0]["SD"]) == ("4", "1.50", "2.0")
    facts = r"my\_arm", r"a $<$ 50 \% \#1", "48 captures of 4 subjects", r"against b \& co", r"$^\dagger$"
    assert all(fact in caption for fact in facts)
    assert "generated" in other and "generated" not in caption and "by window" in other


def test_a_paper_has_protocols_side_by_side_with_means_and_sds_over_people():
    hits = {"LOSO": {"a": [10, 14, 18, 12], "b": [16, 16, 12, 16]}, "10-fold": {"a": [20, 18, 20, 20]}}
    mixed = {"mixes_subjects": "true"}
    runs = [
        evaluated(system, with_hits(row), protocol_label=name, cost=2.0, **(mixed if name == "10-fold" else {}))
        for name, rows in hits.items()
        for system, row in rows.items()
    ]
    runs += [evaluated("a", with_hits([12, 16, 16, 14]), protocol_label="LOSO", seed=1), evaluated("c", failed=1)]
    (one,) = papers(runs, ["accuracy", "macro_f1", "fit", "flash"])
    seeds = 5 * (np.array(hits["LOSO"]["a"]) + [12, 16, 16, 14]) / 2  # percent of 20 captures
    rows = {row["system"]: row for row in one.table.texts}
    assert [*rows] == ["b", "a"] and one.table.headings == [
        *("system", "LOSO", "LOSO, macro-F1", "10-fold ‡", "10-fold ‡, macro-F1", "fit s", "flash kB")
    ]
    assert rows["a"]["LOSO"] == f"{seeds.mean():.1f} ± {seeds.std(ddof=1):.1f}" and rows["b"]["LOSO"] == "75.0 ± 10.0"
    assert rows["b"]["10-fold ‡"] == "-" and rows["b"]["flash kB"] == "8" and rows["b"]["fit s"] == "6.00"
    assert rows["a"]["LOSO, macro-F1"] == f"{50 * (runs[0]['macro_f1'] + runs[3]['macro_f1']):.1f}"
    made = side_by_side([one])
    spans, heads = re.search(r"\\toprule\n(.*?)\n\\midrule", made, re.DOTALL)[1].splitlines()
    protocols = r" & \multicolumn{2}{c}{LOSO} & \multicolumn{2}{c}{10-fold $^\ddagger$}"
    assert spans == protocols + r" & \multicolumn{2}{c}{costs} \\"
    assert heads == r"system & accuracy & F1 & accuracy & F1 & fit s & kB \\"
    assert made.index(r"b & \textbf{75.0 $\pm$ 10.0} &") < made.index(r"\\" + "\na & ")
    text = side_by_side(papers(runs, ["accuracy", "flash"]))
    assert r"b & \textbf{75.0 $\pm$ 10.0} & -- & 8 \\" in text and "generated" in text
    ((caption, _),) = tables_of(text)
    assert r"$^\ddagger$ Training and test captures come from the same subjects" in caption and "generated" in caption
    table = sheet([one]).set_index("system")
    assert {"LOSO: accuracy %", "LOSO: macro_f1 %", "fit_seconds", "flash kB"} < {*table}
    assert table.loc["a", "LOSO: SD %"] == pytest.approx(seeds.std(ddof=1)) and "‡" in table.loc["a", "note"]


def test_text_is_escaped_and_control_characters_are_gone():
    assert escaped("a_b & 50 % {x} #1 $2 ~ ^ \\") == (
        r"a\_b \& 50 \% \{x\} \#1 \$2 \textasciitilde{} \textasciicircum{} \textbackslash{}"
    )
    assert escaped("a\nb\x1bc\u202e") == "a bc"
    for letter, first in (("é", "% One table"), ("λ", "% Letters beyond Latin: needs lualatex")):
        assert latex([row(letter, 50.0)] * 2).startswith(first)


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="pdflatex is not installed")
def test_tables_compile_and_fit_a_page():
    names = [
        "reflex",
        "rf[leaf=5, tried=3, trees=2000] · touch",
        "Tree_1 · ta273",
        "tuned tree[level=1|9, inner=2] · jung28",
    ]
    protocols = ["LOSO (10 subjects)", "challenge (official split)", "10-fold, subjects mixed"]
    runs = [evaluated(name, with_hits([9, 14, 18, 11]), protocol_label=on) for name in names for on in protocols]
    side = side_by_side(papers(runs, [*SCORES, *COSTS]))
    (caption,) = re.findall(r"\\caption\{(.*)\}\n", side)
    assert "tried=" not in caption and "tried=0" in side and r"\begin{table*}" in side
    assert r"\begin{table}" in side_by_side(papers(runs[:1], ["accuracy"]))  # takes one of two columns
    one = latex([row("a \\ { } \" ' ` ~ ^ < > | $ % # _ &", 50.0)] * 2)
    for columns in ("onecolumn", "twocolumn"):
        head = rf"\documentclass[a4paper,{columns}]{{article}}\usepackage{{booktabs,graphicx}}"
        head += r"\usepackage[textwidth=16cm]{geometry}"
        Path("paper.tex").write_text(rf"{head}\begin{{document}}{side}{one}\end{{document}}", encoding="utf-8")
        done = subprocess.run(["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper"], capture_output=True)
        log = Path("paper.log").read_text(errors="replace")
        assert done.returncode == 0 and "Missing character" not in log
        assert "Overfull" not in log, re.findall("Overfull.*", log)


def test_the_call_makes_what_the_report_writes(in_net):
    assert main(["report", "data=people", "paper=accuracy,flash"]) == 0
    table = bench.runs(data="people")
    text = bench.latex(table, paper=["accuracy", "flash"])
    assert text == Path("report/paper.tex").read_text() == bench.latex(table, paper="accuracy,flash")
    assert bench.latex(table) == Path("report/comparison.tex").read_text()
    with pytest.raises(bench.InputError, match="give the table of bench.runs"):
        bench.latex(pd.DataFrame({"system": []}), paper="accuracy")
