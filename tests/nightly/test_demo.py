"""The demo as a whole: it runs what it prints, goes on where it stopped, and its page has the verdict."""

import html
import os
import shlex
from pathlib import Path

import pytest

from bench import cli
from bench.commands import demo

pytestmark = pytest.mark.nightly
TINY = ("data=synth", "data.subjects=3", "data.variants=normal", "data.repetitions=1")


def test_it_runs_what_it_prints_and_goes_on_where_it_stopped(monkeypatch, capsys, tmp_path):
    made, main = [], cli.main

    def seen(step):
        made.append(step)
        if step[0] == "stress" and len(made) < 5:
            return 130  # as Ctrl-C ends it
        return main(step)

    monkeypatch.setattr(demo, "RUNS", (("run", *TINY, "model=tree,bayes,lda", "features=jung28"),))
    monkeypatch.setattr(cli, "main", seen)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'mine.db'}")
    assert demo.demo([f"out={tmp_path / 'd'}"]) == 130
    first = list(made)
    assert [step[0] for step in first] == ["run", "stream", "stream", "stress"]
    rows = [line.split("│") for line in capsys.readouterr().out.splitlines() if line.count("│") == 8]  # of bench run
    accuracies = {row[1].split()[0]: float(row[2].split()[0]) for row in rows}
    replayed = [next(a for a in step if a.startswith("model="))[len("model=") :] for step in first[1:3]]
    assert [accuracies[name] for name in replayed] == sorted(accuracies.values(), reverse=True)[:2]
    assert demo.demo([f"out={tmp_path / 'd'}"]) == 0
    output = capsys.readouterr()
    assert made[4:][:4] == first and made[-1][0] == "choose"
    assert [shlex.split(line[2:])[1:] for line in output.out.splitlines() if line.startswith("$ bench")] == made[4:]
    page = tmp_path / "d" / "report" / "index.html"
    assert page.as_uri() in output.out and output.out.endswith("".join(f"  {step}\n" for step in demo.NEXT))
    verdict = [line for line in output.out.splitlines() if line.startswith("Choose ")][-1]
    assert verdict in html.unescape(page.read_text())  # with the same budgets
    assert "synthetic" in output.out.splitlines()[0] and not (tmp_path / "mine.db").exists()
    assert os.environ["MLFLOW_TRACKING_URI"].endswith("mine.db") and Path.cwd() == tmp_path
