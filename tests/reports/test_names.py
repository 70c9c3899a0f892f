"""A short name of a system stands everywhere, with its full name beside it."""

import json
from pathlib import Path

import pandas as pd

import bench
from bench.cli import main
from tests.conftest import runs
from tests.reading.results import predictions_with_hits
from tests.reports.store import tracked_run

OURS = {"data": "haart", "synthetic": "false"}


def test_a_short_name_stands_in_every_table_and_in_mlflow(store, quick, capsys):
    """Also for seeds that are run later; parts with a note on their design stay in it."""
    args = {"touchbench.arguments": json.dumps({"data": "haart"}), "touchbench.command": "run"}
    hits = predictions_with_hits([15, 16, 14, 17, 15, 16])
    for name, table in (
        ("rf[trees=60] · touch", hits),
        ("lda · jung54", predictions_with_hits([12] * 6)),
    ):
        tracked_run(store, name, table, features=name.split(" · ")[1], **OURS, **args)
    assert main(["runs", "model=rf", "name=Ours"]) == 0
    assert "Ours · touch" in capsys.readouterr().out
    assert {run.info.run_name for run in runs("cell")[1]} == {"Ours", "lda · jung54"}
    tracked_run(store, "rf[trees=60] · touch", hits, seed=1, features="touch", **OURS, **args)
    assert {*bench.runs()["system"]} == {"Ours · touch", "lda · jung54"}
    assert main(["report", "paper=accuracy", "against=Ours · touch"]) == 0
    for file in ("paper.tex", "comparison.tex"):
        text = Path("report", file).read_text()
        assert r"Ours $\cdot$ touch: rf[trees=60] $\cdot$ touch" in text, file
        assert r"rf: Random forest" in text and "were designed on seven" in text, file
    assert "Ours · touch: rf[trees=60] · touch" in Path("report/index.html").read_text()
    assert "Ours · touch" in {*pd.read_csv("report/statistics.csv")["system"]}
    assert bench.compare("Ours · touch", "lda · jung54").difference > 0
    for words, fact in (
        (["model=rf", "name=lda · jung54"], "another system"),
        (["model=rf", "name=touch"], "another system"),
        (["data=haart", "name=Both"], "these are 2 systems"),
    ):
        assert main(["runs", *words]) == 2 and fact in capsys.readouterr().err


def test_files_with_a_class_of_one_name_are_two_systems(store, capsys):
    """Also in the means over seeds of LaTeX; the older one keeps its name."""
    for file, correct, seed in (("a/my", 15, 0), ("b/my", 9, 0), ("c", 3, 0), ("a/my", 17, 1)):
        about = {"model_name": f"/x/{file}.py:Level", "seed": seed, **OURS}
        tracked_run(store, "Level", predictions_with_hits([correct] * 6), **about)
    systems = {"Level", "Level (b/my.py)", "Level (c.py)"}
    assert {*bench.runs()["system"]} == systems
    assert main(["report", "paper=accuracy"]) == 0
    table = pd.read_csv("report/paper.csv").set_index("system")
    assert {*table.index} == systems
    assert main(["runs", "model=/x/c.py:Level", "name=Ours"]) == 0
    assert {*bench.runs()["system"]} == {"Level", "Level (b/my.py)", "Ours"}
