"""The demo: its commands are those that it prints, in a store of their own, and what it says next can be typed."""

import html
import os
import shlex
from importlib import import_module
from pathlib import Path

import pytest

from bench import cli
from bench.arguments import parse
from bench.commands import demo
from bench.plan.cells import cells

SMALL = ("data=synth", "data.subjects=3", "data.variants=normal", "data.repetitions=1")


def test_it_runs_what_it_prints_and_goes_on_where_it_stopped(monkeypatch, capsys, tmp_path):
    made, main = [], cli.main

    def seen(step):
        made.append(step)
        if step[0] == "stress" and len(made) < 5:
            return 130  # as Ctrl-C ends it
        return main(step)

    monkeypatch.setattr(demo, "RUNS", (("run", *SMALL, "model=tree,bayes,lda", "features=jung28"),))
    monkeypatch.setattr(cli, "main", seen)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'mine.db'}")
    assert demo.demo([f"out={tmp_path / 'd'}"]) == 130
    first = list(made)
    assert [step[0] for step in first] == ["run", "stream", "stream", "stress"]
    accuracies = {}
    for line in capsys.readouterr().out.splitlines():
        if line.startswith("│") and line.count("│") == 8:  # of the table of bench run
            accuracies[line.split()[1]] = float(line.split("│")[2].split()[0])
    best = sorted(accuracies, key=accuracies.get, reverse=True)[:2]
    assert len(accuracies) == 3
    named = [next(a for a in step if a.startswith("model="))[len("model=") :] for step in first[1:3]]
    assert min(accuracies[n] for n in named) >= max(v for k, v in accuracies.items() if k not in named)
    assert accuracies[named[0]] == accuracies[best[0]]
    assert demo.demo([f"out={tmp_path / 'd'}"]) == 0
    said = capsys.readouterr()
    assert [step for step in made[4:]][:4] == first and made[-1][0] == "choose"
    printed = [shlex.split(line[2:])[1:] for line in said.out.splitlines() if line.startswith("$ bench")]
    assert printed == made[4:]
    assert said.err.count("all 3 folds were stored before") == 5  # three runs, two replays
    page = tmp_path / "d" / "report" / "index.html"
    assert (
        page.exists()
        and page.as_uri() in said.out
        and said.out.splitlines()[-len(demo.NEXT) :] == [f"  {s}" for s in demo.NEXT]
    )
    verdict = [line for line in said.out.splitlines() if line.startswith("Choose ")][-1]
    assert verdict in html.unescape(page.read_text())  # with the same budgets
    assert "synthetic" in said.out.splitlines()[0] and not (tmp_path / "mine.db").exists()
    assert os.environ["MLFLOW_TRACKING_URI"].endswith("mine.db") and Path.cwd() == tmp_path


@pytest.mark.parametrize("step", [*demo.RUNS, *demo.VERDICTS, *(tuple(s.split()[1:]) for s in demo.NEXT[1:])])
def test_its_commands_can_be_typed(step):
    command, *arguments = step
    module = import_module(cli.COMMANDS[command][0].partition(":")[0])
    values = parse(arguments, module.KEYS)
    assert command == "choose" or cells(values)


def test_five_systems_are_compared():
    assert sum(len(cells(parse(list(step[1:]), {"data", "protocol", "model", "features"}))) for step in demo.RUNS) == 5


def test_what_it_takes(capsys):
    assert cli.main(["demo", "model=svm"]) == 2 and "out" in capsys.readouterr().err
