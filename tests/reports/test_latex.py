"""LaTeX tables: every number where it belongs, every caption whole, every text as it was."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import bench
from bench.leaderboard.submissions import score
from bench.leaderboard.tasks import HAART
from bench.outcomes.comparable import BATCH, CONDITIONS
from bench.outcomes.runs import tracked
from bench.outcomes.store import connect
from reports.comparison import comparison, published
from reports.latex import escaped, latex
from reports.leaderboard import reference
from tests.reports.store import made_up, tracked_run, with_hits


@pytest.fixture
def table():
    store = connect()
    tracked_run(store, "svm[C=8] · jung54", made_up(4), cost=2.0)
    tracked_run(store, "rf & co_1 · jung54", made_up(4, skill=0.9), seed=3)
    tracked_run(
        store, "net", made_up(5, windows=3), subset="variant == 'rough' & a < 50 % #1", synthetic="false", data="my_arm"
    )
    tracked_run(
        store,
        "broken",
        made_up(5),
        failed=1,
        subset="variant == 'rough' & a < 50 % #1",
        synthetic="false",
        data="my_arm",
    )
    return comparison(store, tracked(store), published())


def tables_of(text):
    """Caption and rows of every table, cells in text."""
    found = []
    for block in re.findall(r"\\begin\{table\}.*?\\end\{table\}", text, flags=re.DOTALL):
        caption = re.search(r"\\caption\{(.*)\}\n", block)[1]
        body = re.search(r"\\midrule\n(.*?)\\bottomrule", block, flags=re.DOTALL)[1]
        head = re.search(r"\\toprule\n(.*?) \\\\\n", block)[1].split(" & ")
        rows = [re.split(r"(?<!\\) & ", line.removesuffix(r" \\")) for line in body.strip().splitlines()]
        found.append((caption, [dict(zip(head, row, strict=True)) for row in rows]))
    return found


def test_each_comparison_is_a_table_with_its_numbers(table):
    found = tables_of(latex(table))
    assert len(found) == 1 + 2  # of synth; of my_arm the captures of both systems, and windows
    caption, rows = next((c, r) for c, r in found if "synth (synthetic)" in c)
    for said in ("48 captures of 4 subjects", "scored by capture", "LOSO (4 subjects)"):
        assert said in caption, caption
    assert "generated and say nothing about people" in caption and r"95\,\% bootstrap interval over subjects" in caption
    assert [row["system"] for row in rows] == [r"rf \& co\_1 $\cdot$ jung54, seed 3", r"svm[C=8] $\cdot$ jung54"]
    hits = made_up(4, skill=0.9)
    right = (
        hits[["p_pat", "p_rub", "p_tap"]].to_numpy().argmax(axis=1) == hits["true"].map({"pat": 0, "rub": 1, "tap": 2})
    ).mean()
    assert rows[0]["accuracy"] == rf"\textbf{{{100 * right:.1f}}}" and "textbf" not in rows[1]["accuracy"]
    assert [row["kB"] for row in rows] == ["4.0", "8.0"] and rows[0]["ms"] == "1.5"
    low, high = map(float, rows[0][r"95\,\% interval"].split("--"))
    assert low <= 100 * right <= high


def test_windows_stand_apart_and_a_failed_fold_is_told(table):
    captions = [caption for caption, _ in tables_of(latex(table)) if r"my\_arm" in caption]
    assert ["scored by window." in c for c in captions] == [False, True]
    assert all("people" not in c and r"variant == \textquotesingle{}rough" in c for c in captions)
    assert "broken, 5/6 folds" in latex(table)


def test_systems_on_windows_and_others_share_a_table_with_one_winner_and_p():
    # b loses one capture of 20 on each of ten subjects: p = 2 / 2 ** 10; c two, so that Holm's correction doubles it.
    store = connect()
    tracked_run(store, "a", with_hits([18] * 10, windows=3))
    tracked_run(store, "b", with_hits([17] * 10))
    tracked_run(store, "c", with_hits([16] * 10))
    captures, windows = tables_of(latex(bench.results()))
    caption, rows = captures
    shown = {row["system"]: (row["accuracy"], row["$p$ (Holm)"]) for row in rows}
    assert shown == {
        "a, mean probability": (r"\textbf{90.0}", "--"),
        "a, majority vote": (r"\textbf{90.0}", "--"),
        "b": ("85.0", "0.004"),
        "c": ("80.0", "0.004"),
    }
    assert "against a, corrected by Holm" in caption and "200 captures of 10 subjects, scored by capture" in caption
    assert "scored by window" in windows[0] and [row["system"] for row in windows[1]] == ["a"]


def test_reference_results_stand_in_the_same_table_and_are_marked():
    store = connect()
    about = {"data": "haart", "synthetic": "false", "corpus_digest": HAART, "protocol_label": "LOSO (10 subjects)"}
    tracked_run(store, "mine", with_hits([18] * 10), **about)
    tracked_run(store, "svm · jung54", with_hits([4] * 10), **about)
    ((caption, rows),) = tables_of(latex(bench.results()))
    own = score(next(one for one in reference() if one.task.name == "haart-loso-v1" and one.name == "reflex"))
    names = [row["system"] for row in rows]
    assert names[:2] == ["mine", "reflex (reference)"] and rows[1]["accuracy"] == f"{100 * own['accuracy']:.1f}"
    assert r"svm $\cdot$ jung54" in names and r"svm $\cdot$ jung54 (reference)" not in names  # the same system twice
    assert "come with touchbench" in caption and "seven of HAART" in caption
    assert [row["system"] for _, rows in tables_of(latex(bench.results(model="mine"))) for row in rows] == ["mine"]


def test_a_system_that_depends_on_the_batch_is_marked_and_not_compared():
    store = connect()
    tracked_run(store, "a", with_hits([19] * 10), **{BATCH: "true"})
    tracked_run(store, "b", with_hits([18] * 10), **{CONDITIONS: "substrate,cover"})
    tracked_run(store, "c", with_hits([17] * 10))
    found = bench.results()
    assert found["system"].tolist() == ["a †", "b (uses substrate, cover)", "c"]
    assert set(found["against"]) == {"", "b (uses substrate, cover)"}
    ((caption, rows),) = tables_of(latex(found))
    assert [row["$p$ (Holm)"] for row in rows] == ["--", "--", "0.002"] and rows[0]["system"] == r"a $^\dagger$"
    assert [r"\textbf" in row["accuracy"] for row in rows] == [False, True, False]
    assert r"$^\dagger$ predictions depend on the captures that are predicted together" in caption


def test_a_choice_of_rows_from_python(table):
    text = bench.latex(table[table["system"] == "net"])
    assert {row["system"] for _, rows in tables_of(text) for row in rows} == {
        "net, mean probability",
        "net, majority vote",
        "net",
    }
    assert len(tables_of(bench.latex(bench.results(data="synth")))) == 1


def test_text_is_escaped_and_control_characters_are_gone():
    assert escaped("a_b & 50 % {x} #1 $2 ~ ^ \\") == (
        r"a\_b \& 50 \% \{x\} \#1 \$2 \textasciitilde{} \textasciicircum{} \textbackslash{}"
    )
    assert escaped("a\nb\x1bc\u202e") == "a bc"


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="pdflatex is not installed")
def test_it_compiles_and_fits_the_page(table):
    awkward = table.assign(system=table["system"] + " \\ { } \" ' ` ~ ^ < > | $ % # _ &")
    Path("tables.tex").write_text(latex(table) + latex(awkward))
    Path("paper.tex").write_text(
        "\\documentclass{article}\\usepackage{booktabs}\\begin{document}\\input{tables}\\end{document}"
    )
    done = subprocess.run(["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper"], capture_output=True)
    log = Path("paper.log").read_text(errors="replace")
    assert done.returncode == 0 and Path("paper.pdf").stat().st_size > 5000, log[-2000:]
    assert "Missing character" not in log and "undefined" not in log.lower().replace("labels may", "")
