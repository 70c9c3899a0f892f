"""The command ``bench choose``: what it prints, what it loads, and the choice over a parameter inside the folds."""

import json
import subprocess
import sys

import pytest

from bench.arguments import parse
from bench.cli import main
from bench.commands.choose import Chosen, _print, chosen
from bench.commands.smallest import smallest
from bench.errors import InputError
from bench.options import SMALL
from bench.outcomes.choice import Candidates, decide
from bench.outcomes.comparable import MARKED
from bench.outcomes.store import connect
from bench.plan.cells import cells
from tests.outcomes.test_choice import table
from tests.reports.store import made_up, tracked_run

FEW = ["data.subjects=4", "data.repetitions=2", "data.variants=normal"]


def test_the_verdict_and_what_is_loaded_for_it(store):
    for system in ("lda", "svm", "rf"):
        arguments = json.dumps({"data": "synth", "model": system, "features": "jung28"})
        tracked_run(store, system, made_up(), **{"touchbench.command": "run", "touchbench.arguments": arguments})
    code = "import sys; from bench.cli import main; main(['choose']); print({'torch', 'sklearn'} & set(sys.modules))"
    lines = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()
    assert lines[-1] == "set()" and lines[-2].startswith("next: bench fit data=synth model=")
    assert any(line.startswith("Choose ") for line in lines)


def test_budgets_nothing_that_fits_and_other_processors(store, capsys):
    tracked_run(store, "lda", made_up(), cost=1.0)
    tracked_run(store, "svm", made_up(), cost=2.0, cpu="two")
    tracked_run(store, "centred", made_up(), cost=0.1, **{"touchbench.depends_on_batch": "true"})
    assert main(["choose", "max_flash=1kB", "max_decision=9s"]) == 1
    out = capsys.readouterr().out
    assert "The lowest flash is 4 kB (lda)." in out and f"bench run {SMALL}" in out
    assert "without computing time on this machine" in out and "centred" in out
    cells(parse(SMALL.split(), {"model", "features"}))  # can be typed
    assert main(["choose", "by=cycles"]) == 1
    assert main(["choose", "max_predict=9s", "model=lda,svm,rf", "batch=yes"]) == 0
    said = capsys.readouterr()
    assert "several processors: one; two" in said.err and "model=rf: no run" in said.err
    assert main(["choose", "batch=yes"]) == 0
    said = capsys.readouterr()
    assert "Choose centred †" in said.out and MARKED in said.out and not said.err
    assert chosen({"data": "synth", "batch": True, "max_flash": "6kB"}).system == "centred †"  # from Python


def test_runs_of_another_version_are_left_out_in_one_line(store, capsys):
    tracked_run(store, "svm", made_up())
    old = tracked_run(store, "rf", made_up())
    store.client.set_tag(old, "touchbench.format", "0")
    assert main(["choose"]) == 0
    captured = capsys.readouterr()
    assert "another version" in captured.err and captured.err.count("\n") == 1 and "rf" not in captured.out
    store.client.delete_tag(store.of_kind("cell")[0].info.run_id, "touchbench.format")
    assert main(["choose"]) == 2 and "no scored run is stored here" in capsys.readouterr().err
    assert connect().of_kind("cell") == []


def test_sizes_as_linked_are_marked_beside_those_without_code(capsys):
    rows, subjects = table([[80] * 4, [70] * 4], flash=[20.0, 5.0])
    rows = rows.assign(kind="cell", command="run", arguments="", cycles=1.0)
    for linked, marked in (([True, False], True), ([True, True], False)):
        among = Candidates(rows.assign(linked=linked), "synth", subjects, False, [])
        _print(Chosen(decide(among.table, subjects, "flash", {}, None), among, "flash", {}, None))
        out = capsys.readouterr().out
        assert "20 kB*" in out and ("* as linked" in out) == marked and ("5 kB*" in out) != marked


@pytest.mark.parametrize(
    "wrong",
    ["by=price", "unit=frame", "batch=maybe", "clock=64", "max_ram=32", "margin=0", "shots=x", "shots=-1", "jobs=2"]
    + ["model.frames=3", "seed=1", "protocol.draws=2"],
)
def test_a_value_that_cannot_be_used_is_one_line_with_its_key(wrong, store, capsys):
    tracked_run(store, "svm", made_up())
    assert main(["choose", wrong]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and wrong.partition("=")[0] in error


def test_over_a_parameter_and_over_features(capsys):
    small = ["data.subjects=4", "data.repetitions=1", "data.variants=normal", "protocol=groupkfold", "protocol.folds=2"]
    small += ["inner=2", "model=bayes", "features=jung28"]
    assert main(["choose", "over=ridge", "model.ridge=1,0.01", *small]) == 0
    out = capsys.readouterr().out
    assert "ridge=0.01|1.0" in out and "objective" not in out and "bayes · jung28" in out
    assert main(["choose", "over=features", *small]) == 0
    assert "best of jung28" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("values", "fact"),
    [
        ({"model": "rf", "over": "tree"}, "trees"),
        ({"model": "svm", "over": "kernel"}, "over=kernel"),
        ({"model": "rf", "over": "seed"}, "over=seed"),
        ({"model": "cnn85", "over": "width", "model.width": "20,40"}, "model.width=20"),
        ({"model": "cnn85", "over": "features"}, "cnn85"),
        ({"model": "jung2017_tree", "over": "features"}, "jung2017_tree"),
        ({"model": "rf", "over": "trees", "by": "flash"}, "by="),
        ({"model": "rf", "over": "trees", "shots": "1"}, "shots="),
    ],
)
def test_what_cannot_be_chosen_over_is_refused(values, fact):
    with pytest.raises(InputError, match=fact):
        smallest({"data": "synth", **values})
