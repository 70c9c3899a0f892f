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
from bench.reading.frame import group_results
from bench.reports.comparison import average_seeds, score_rows
from bench.reports.latex import (
    COSTS,
    SCORES,
    comparison_latex,
    escape_latex,
    make_papers,
    papers_latex,
    papers_table,
)
from bench.values.result import BATCH_MARK
from tests.reading.results import make_run, predictions_with_hits
from tests.reports.store import tracked_run


def averaged(runs):
    return average_seeds(score_rows(group_results(runs)), runs)


def row(system, accuracy, **more):
    about = {
        "data": "my_arm",
        "subset": "a < 50 % #1",
        "protocol": "LOSO",
        "group": "g",
        "unit": "capture",
    }
    numbers = {
        "accuracy_low": 0.4004,
        "accuracy_high": 0.6006,
        "subject_sd": 0.02,
        "macro_f1": 0.499,
    }
    numbers |= {"flash_bytes": 4000, "predict_ms_p50": 1.5}
    counts = {"captures": 48, "subjects": 4, "folds": "4/4", "seed": "0", "seeds": 1}
    named = {"name": system, "system": system, "accuracy": accuracy / 100}
    return named | about | numbers | counts | more


def test_a_paper_has_protocols_side_by_side_with_means_and_sds_over_people():
    hits = {
        "LOSO": {"a": [10, 14, 18, 12], "b": [16, 16, 12, 16]},
        "10-fold": {"a": [20, 18, 20, 20]},
    }
    runs = [
        make_run("a", predictions_with_hits([12, 16, 16, 14]), protocol_label="LOSO", seed=1),
        make_run("c", failed=1),
    ]
    for name, rows in hits.items():
        about = {"protocol_label": name, "mixes_subjects": str(name != "LOSO").lower()}
        runs += [
            make_run(system, predictions_with_hits(row), cost=2.0, **about)
            for system, row in rows.items()
        ]
    (one,) = make_papers(averaged(runs), ["accuracy", "macro_f1", "fit", "flash"])
    seeds = 5 * (np.array(hits["LOSO"]["a"]) + [12, 16, 16, 14]) / 2  # percent of 20 captures
    rows = {row["system"]: row for row in one.table.texts}
    scores = [f"{on}: {each}" for on in ("LOSO", "10-fold ‡") for each in ("accuracy", "F1")]
    expected = ["system", *scores, "seeds", "fit s", "flash kB"]
    assert [*rows] == ["b", "a"] and one.table.headings == expected
    assert [rows[name]["seeds"] for name in "ba"] == ["1", "1 to 2"]
    assert (
        rows["a"]["LOSO: accuracy"] == f"{seeds.mean():.1f} ± {seeds.std(ddof=1):.1f}"
        and rows["b"]["LOSO: accuracy"] == "75.0 ± 10.0"
    )
    assert (
        rows["b"]["10-fold ‡: accuracy"] == "-"
        and rows["b"]["flash kB"] == "8"
        and rows["b"]["fit s"] == "6.00"
    )
    assert rows["a"]["LOSO: F1"] == f"{50 * (runs[0]['macro_f1'] + runs[2]['macro_f1']):.1f}"
    text = papers_latex([one])
    assert (
        r"b & \textbf{75.0 $\pm$ 10.0} &" in text
        and r"$^\ddagger$ Training and test captures come from" in text
    )
    table = papers_table([one]).set_index("system")
    assert {"LOSO: accuracy %", "LOSO: macro_f1 %", "fit_seconds", "flash kB"} < {*table}
    assert (
        table.loc["a", "LOSO: SD %"] == pytest.approx(seeds.std(ddof=1))
        and "‡" in table.loc["a", "note"]
    )


def test_a_system_has_one_row_over_its_seeds_with_interval_test_and_people():
    hits = {0: [10, 14, 18, 12, 9, 11], 1: [12, 16, 16, 14, 13, 9], 2: [11, 15, 17, 13, 8, 16]}
    runs = [make_run("a", predictions_with_hits(row), seed=seed) for seed, row in hits.items()]
    runs += [make_run("b", predictions_with_hits([19] * 6), seed="none")]
    few = {"protocol_label": "challenge", "official_split": "true"}
    runs += [make_run("c", predictions_with_hits([9, 12]), cost=4.0, **few)]
    rows = averaged(runs)
    (text,) = re.findall(r"^a .*", comparison_latex(rows), re.MULTILINE)
    people = 5 * np.mean([*hits.values()], axis=0)  # percent of 20 captures
    half = 2.5706 * people.std(ddof=1) / np.sqrt(6)  # t of 5 degrees of freedom
    assert f"{people.mean():.1f} [{people.mean() - half:.1f}, {people.mean() + half:.1f}]" in text
    assert "macro-F1 & fit s & ms & kB & seeds" in comparison_latex(rows)
    assert text.endswith(r"& 3 \\")
    assert "All numbers are means over the seeds of each system." in comparison_latex(rows)
    assert "40 captures of 2 of 6 subjects" in comparison_latex(rows)
    columns = ["accuracy", "interval", "p", "seed_sd", "flash"]
    (one,) = make_papers(rows, columns)
    cells = {row["system"]: row for row in one.table.texts}
    seeds = [5 * np.mean(row) for row in hits.values()]
    assert cells["a"]["LOSO: SD of seeds"] == f"{np.std(seeds, ddof=1):.1f}"
    assert cells["a"]["LOSO: 95 % interval"] == (
        f"{people.mean() - half:.1f} to {people.mean() + half:.1f}"
    )
    assert cells["a"]["LOSO: p"] == "0.031" and cells["b"]["LOSO: p"] == "-"
    assert "challenge: p" not in cells["a"] and cells["c"]["flash kB"] == "16"
    notes = " ".join(one.notes)
    assert "against b" in notes and "challenge, tests 2 of 6 people" in notes
    assert "Those of c are those under challenge." in notes


def test_a_comparison_has_intervals_its_best_without_a_mark_and_its_p():
    rows = [
        row(f"a {BATCH_MARK}", 90.0),
        row("b & co_1", 85.04),
        row("c", 80.0, p_holm=0.0004, against="b & co_1"),
    ]
    text = comparison_latex([*rows, row("d", 70.0, unit="window", data="x (synthetic)")])
    shown = (
        r"\textbf{85.0 [40.0, 60.1]}",
        "80.0 [40.0, 60.1]",
        "$<$ 0.001",
        r"against b \& co\_1",
        r"a $<$ 50 \% \#1",
    )
    assert [words for words in shown if words not in text] == [] and text.count("textbf") == 1
    marked = [row(f"{system} {BATCH_MARK}", 80) for system in "ab"]
    assert "textbf" not in comparison_latex(marked)  # none of them is compared
    assert "generated" in text and "by window" in text


def test_text_is_escaped_and_control_characters_are_gone():
    assert escape_latex("a_b & 50 % {x} #1 $2 ~ ^ \\") == (
        r"a\_b \& 50 \% \{x\} \#1 \$2 \textasciitilde{} \textasciicircum{} \textbackslash{}"
    )
    assert escape_latex("a\nb\x1bc\u202e") == "a bc"
    for letter, first in (("é", "% One table"), ("λ", "% Letters beyond Latin: needs lualatex")):
        assert comparison_latex([row(letter, 50.0)] * 2).startswith(first)


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="pdflatex is not installed")
def test_tables_compile_and_fit_a_page():
    names = [
        "reflex",
        "rf[leaf=5, tried=3, trees=2000] · touch",
        "Tree_1 · ta273",
        "tuned tree[level=1|9] · jung28",
    ]
    protocols = ["LOSO (10 subjects)", "challenge (official split)", "10-fold, subjects mixed"]
    runs = [
        make_run(name, predictions_with_hits([9, 14, 18, 11]), protocol_label=on)
        for name in names
        for on in protocols
    ]
    side = papers_latex(make_papers(averaged(runs), [*SCORES, *COSTS]))
    (caption,) = re.findall(r"\\caption\{(.*)\}\n", side)
    assert "tried=" not in caption and "tried=0" in side and r"\begin{table*}" in side
    assert r"\begin{table}" in papers_latex(
        make_papers(averaged(runs[:1]), ["accuracy"])
    )  # takes one of two columns
    one = comparison_latex([row("a \\ { } \" ' ` ~ ^ < > | $ % # _ &", 50.0)] * 2)
    for columns in ("onecolumn", "twocolumn"):
        head = rf"\documentclass[a4paper,{columns}]{{article}}\usepackage{{booktabs,graphicx}}"
        head += r"\usepackage[textwidth=16cm]{geometry}"
        Path("paper.tex").write_text(
            rf"{head}\begin{{document}}{side}{one}\end{{document}}", encoding="utf-8"
        )
        done = subprocess.run(
            ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper"], capture_output=True
        )
        log = Path("paper.log").read_text(errors="replace")
        assert done.returncode == 0 and "Missing character" not in log
        assert "Overfull" not in log, re.findall("Overfull.*", log)


def test_the_call_makes_what_the_report_writes(store, quick):
    for seed in (0, 1):
        tracked_run(store, "svm", predictions_with_hits([9, 14, 18, 11]), seed=seed)
    assert main(["report", "paper=accuracy,flash"]) == 0
    table = bench.runs()
    text = bench.latex(table, paper=["accuracy", "flash"])
    assert (
        text == Path("report/paper.tex").read_text() == bench.latex(table, paper="accuracy,flash")
    )
    assert bench.latex(table) == Path("report/comparison.tex").read_text()
    with pytest.raises(bench.InputError, match="give the table of bench.runs"):
        bench.latex(pd.DataFrame({"system": []}), paper="accuracy")
