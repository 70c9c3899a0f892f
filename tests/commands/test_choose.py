"""The command ``bench choose``: what it prints, what it loads, and the choice over a parameter inside the folds."""

import json
import subprocess
import sys

import pytest

import bench
from bench.arguments import parse
from bench.cli import main
from bench.commands.choose import chosen
from bench.commands.smallest import smallest
from bench.errors import InputError
from bench.options import SMALL
from bench.outcomes.comparable import MARKED
from bench.plan.cells import cells
from tests.reports.store import made_up, tracked_run, watched

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
    cells(parse(SMALL.split(), {"model", "features"}))  # can be typed
    assert main(["choose", "by=cycles"]) == 1
    assert main(["choose", "max_predict=9s", "model=lda,svm,rf", "batch=yes"]) == 0
    said = capsys.readouterr()
    assert main(["choose", "batch=yes"]) == 0
    said = capsys.readouterr()
    assert "Choose centred †" in said.out and MARKED in said.out and not said.err
    assert chosen({"data": "synth", "batch": True, "max_flash": "6kB"}).system == "centred †"  # from Python


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


def test_budgets_of_false_alarms_and_latency_choose_among_runs_of_watch_alone(store, capsys):
    tracked_run(store, "cut", made_up(), data="haart", synthetic="false", subset="all", flash_bytes="1")
    watched(store, "large", [0.8, 0.9, 0.7], alarms=2.3, latency=0.9, flash=9000.0)
    watched(store, "small", [0.78, 0.9, 0.7], alarms=4.0, latency=1.0)  # 0.67 points less, standard error 0.67
    watched(store, "loud", [0.9, 0.9, 0.9], alarms=6.2, latency=0.5, flash=100.0)
    watched(store, "other", [1.0, 1.0, 1.0], alarms=1.0, latency=0.5, **{"watch.background": "quiet"})
    watched(store, "small", [0.8, 0.9, 0.7], alarms=1.0, latency=1.2, **{"watch.false_alarms": "2.0"})
    watched(store, "strange", [1.0, 1.0, 1.0], alarms=1.0, latency=0.5, **{"watch.unknown": "pat"})
    choice = bench.choose(max_false_alarms=5, max_latency="1s")
    table = choice.choice.table.set_index(["system", "unit"])
    assert len(table) == 4 and choice.system == "small"  # other recordings and whole captures are left out
    cheap = table.loc[("small", "touches in recordings")]
    assert cheap[["accuracy", "false_alarms", "latency", "flash"]].tolist() == pytest.approx([238 / 3, 4, 1000, 4])
    assert table.loc[("small", "touches in recordings, false_alarms=2"), "verdict"].endswith(
        "latency 1200 ms > 1000 ms"
    )
    for fact in (
        "Choose small (touches in recordings): 79.3 % with 4 kB of flash.",
        "It raises 4 false alarms per hour of background; its median latency is 1000 ms.",
        "or with another background",
    ):
        assert fact in str(choice)
    assert main(["choose", "max_false_alarms=0.5"]) == 1
    out = capsys.readouterr().out
    assert "lowest false-alarm rate is 1 per hour (small" in out and f"bench watch {SMALL}" in out
    assert main(["choose"]) == 0 and "touches" not in capsys.readouterr().out
    for wrong in ("by=decision", "max_decision=1s", "unit=window", "clock=64MHz"):
        assert main(["choose", "max_latency=1s", wrong]) == 2
        assert wrong.partition("=")[0] in capsys.readouterr().err


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
