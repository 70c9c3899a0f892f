"""The choice among candidates against hand-made ones, and over a parameter inside the folds."""

import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_rel

import bench
from bench.arguments import parse
from bench.cli import main
from bench.commands.choose import Chosen, _print
from bench.costs import quantity
from bench.errors import InputError
from bench.options import SMALL
from bench.outcomes.choice import apart, candidates, decide, sentences
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.work import machine
from bench.work.machine import Machine
from tests.reports.store import made_up, tracked_run

FEW = ["data.subjects=4", "data.repetitions=2", "data.variants=normal"]


def table(accuracies, **costs):
    subjects = pd.DataFrame(accuracies).rename(columns=lambda place: "abcd"[place]).astype(float)
    rows = pd.DataFrame({"system": [f"s{i}" for i in range(len(subjects))], "unit": "capture"})
    usual = {name: [1.0] * len(rows) for name in ("flash", "ram", "predict", "decision")}
    return rows.assign(accuracy=subjects.mean(axis=1), **usual | costs), subjects


def test_the_cheapest_within_one_standard_error_is_chosen():
    # s1 loses 1, 3, 0, 0 points: mean 1, SD sqrt(2), SE 0.707: worse.
    # s2 loses 3, -1, 2, -2: mean 0.5, SE 1.19: as good.
    found, subjects = table([[80, 70, 60, 90], [79, 67, 60, 90], [77, 71, 58, 92]], flash=[50.0, 1.0, 9.0])
    choice = decide(found, subjects, "flash", {}, None)
    assert (choice.chosen, choice.best, choice.costlier) == (2, 0, 0)
    assert list(choice.table.index) == [1, 2, 0]  # cheapest first
    assert list(choice.table["verdict"]) == ["below the best", "chosen", "as good, costlier"]
    assert choice.table.loc[1, ["loss", "error"]].tolist() == pytest.approx([1, np.sqrt(2) / 2])
    assert choice.table.loc[2, ["loss", "error"]].tolist() == pytest.approx([0.5, np.sqrt(17 / 3) / 2])
    said = " ".join(sentences(choice, "flash", None, 4))
    assert "Choose s2: 74.5 % with 9 kB of flash." in said
    assert "It is the cheapest system within one standard error of the best one that fits (s0, 75.0 %)." in said
    assert "It loses 0.5 ± 1.2 points (mean ± standard error over 4 subjects)." in said
    assert "The next better system, s0, gains 0.5 points but needs 50 kB of flash instead of 9 kB." in said
    assert "Only 4 subjects" in said


def test_budgets_rule_out_what_is_over_them_or_not_known():
    found, subjects = table(
        [[90] * 4, [80] * 4, [70] * 4, [60] * 4], ram=[40.0, np.nan, 32.0, 1.0], predict=[1.0, 1.0, 1.0, 1.0]
    )
    choice = decide(found, subjects, "flash", {"ram": 32.0}, None)
    assert (choice.chosen, choice.best) == (2, 2)
    assert choice.table["verdict"][0] == "ruled out: ram 40 kB > 32 kB"
    assert choice.table["verdict"][1] == "ruled out: ram not known"
    nothing = decide(found, subjects, "flash", {"ram": 0.5}, None)
    assert nothing.chosen is None and sentences(nothing, "flash", None, 4)[0].startswith("Nothing fits")


def test_a_margin_asks_for_proof_of_equivalence():
    rng = np.random.default_rng(0)
    best = rng.uniform(60, 90, 4)
    noise = np.array([0.5, -0.4, 0.1, -0.1])
    found, subjects = table([best, best - 1 + noise, best - 1 + 8 * noise], flash=[9.0, 2.0, 1.0])
    for i, expected in ((1, True), (2, False)):
        p = ttest_rel(subjects.loc[0] - 3, subjects.loc[i], alternative="less").pvalue
        assert (p < 0.05) == expected
    assert decide(found, subjects, "flash", {}, 3.0).chosen == 1
    assert decide(found, subjects, "flash", {}, 0.5).chosen == 0


def test_each_budget_has_its_price_and_what_binds():
    # Without ram: s0, whose subjects are 10, 14, 10 and 6 points better than those of s2: mean 10, SD sqrt(32 / 3).
    accuracies = [[90, 84, 70, 76], [80] * 4, [80, 70, 60, 70]]
    found, subjects = table(accuracies, ram=[40.0, 32.0, 8.0], flash=[9.0, 20.0, 3.0], predict=[1.0, np.nan, 2.0])
    choice = decide(found, subjects, "flash", {"ram": 32.0, "flash": 10.0}, None)
    assert choice.chosen == 2
    ram, flash = choice.budgets
    assert (ram.over, ram.unknown, ram.least, ram.without) == (1, 0, 2, 0)
    assert (ram.gain, ram.error) == pytest.approx((10, np.sqrt(32 / 3) / 2))
    assert (flash.without, flash.gain) == (1, 10)
    said = sentences(choice, "flash", None, 4)
    assert any(
        s.startswith("ram at most 32 kB costs 10.0 ± 1.6 points: without it the best that fits is s0") for s in said
    )
    loose = decide(found, subjects, "flash", {"ram": 50.0}, None)
    assert (loose.budgets[0].without, loose.budgets[0].gain) == (loose.best, 0)
    assert "ram at most 50 kB costs nothing" in " ".join(sentences(loose, "flash", None, 4))
    nothing = decide(found, subjects, "flash", {"ram": 4.0, "predict": 1.5}, None)
    ram, predict = nothing.budgets
    assert (ram.over, ram.least, ram.without) == (3, 2, 0) and np.isnan(ram.gain)
    assert (predict.over, predict.unknown, predict.least, predict.without) == (1, 1, 0, None)
    said = " ".join(sentences(nothing, "flash", None, 4))
    assert "ram at most 4 kB alone rules out 3 of 3 candidates; the least that any needs is 8 kB, s2" in said
    assert "predict at most 1.5 ms alone rules out 2 of 3 candidates (1 with unknown predict: " in said
    assert "Without it nothing fits either" in said


def test_what_has_no_known_cost_is_compared_and_never_chosen():
    found, subjects = table([[90] * 4, [80] * 4, [70] * 4], flash=[np.nan, 5.0, 1.0])
    choice = decide(found, subjects, "flash", {}, None)
    assert (choice.chosen, choice.best, choice.unranked) == (1, 1, [0])
    assert list(choice.table.index) == [2, 1, 0] and choice.table["loss"][0] == -10
    assert choice.table["verdict"][0] == "as good, flash not known"
    said = " ".join(sentences(choice, "flash", None, 4))
    assert "No system that fits and has a known flash is more accurate, and no cheaper one" in said
    assert "1 candidate cannot be chosen, because the flash is unknown" in said
    assert "The most accurate of these is s0, 90.0 %." in said
    none, subjects = table([[90] * 4], flash=[np.nan])
    nothing = decide(none, subjects, "flash", {}, None)
    assert nothing.chosen is None and "Nothing can be chosen" in sentences(nothing, "flash", None, 4)[0]


def test_what_is_said_of_one_subject_holds():
    found, subjects = table([[90.0], [90.0], [80.0]], flash=[9.0, 5.0, 1.0])
    choice = decide(found, subjects, "flash", {"ram": 2.0}, None)
    said = " ".join(sentences(choice, "flash", None, 1))
    assert choice.chosen == 1 and "No system that fits is more accurate." in said
    assert "one standard error" not in said and "nan" not in said and "Only 1 subject, so there is no" in said
    assert sentences(decide(found, subjects, "flash", {"flash": 2.0}, None), "flash", None, 1)[-2].startswith(
        "flash at most 2 kB costs 10.0 points: without it the best that fits is s1"
    )


def test_amounts_that_differ_are_printed_with_digits_that_do():
    assert apart("flash", 64.02, 64.0) == ("64.02 kB", "64 kB")
    assert apart("decision", 352.4, 352.0) == ("352.4 ms", "352 ms")
    assert apart("flash", 64.0, 64.0) == ("64 kB", "64 kB") and apart("flash", 65.6, 64.0) == ("65.6 kB", "64 kB")
    found, subjects = table([[90] * 4, [80] * 4], flash=[64.02, 64.0])
    choice = decide(found, subjects, "flash", {"flash": 64.0}, None)
    assert choice.table["verdict"][0] == "ruled out: flash 64.02 kB > 64 kB"
    said = sentences(decide(found, subjects, "flash", {"flash": 70.0}, 20.0), "flash", 20.0, 4)
    assert "The next better system, s0, gains 10.0 points but needs 64.02 kB of flash instead of 64 kB." in said


def test_equal_costs_and_equal_accuracies_are_called_so():
    found, subjects = table([[80, 70, 60, 90], [79, 71, 60, 89.9], [60] * 4], flash=[5.0, 5.0, 5.0])
    choice = decide(found, subjects, "flash", {}, None)
    assert choice.table["verdict"].to_dict() == {0: "chosen", 1: "as good, equally cheap", 2: "below the best"}
    tied, subjects = table([[0.1, 0.2, 0.3, 0.0], [0.3, 0.2, 0.1, 0.0]], flash=[9.0, 1.0])  # sums differ by 1e-17
    choice = decide(tied, subjects, "flash", {}, None)
    assert (choice.chosen, choice.best, choice.costlier) == (1, 1, None)


def test_mixed_subjects_are_said():
    found, subjects = table([[90] * 4, [80] * 4])
    choice = decide(found, subjects, "flash", {}, None)
    said = "Training and test captures come from the same subjects: this does not hold for a new person."
    assert sentences(choice, "flash", None, 4, mixed=True)[-1] == said and said not in sentences(
        choice, "flash", None, 4
    )


def test_where_nothing_fits_it_says_what_binds_and_the_least_that_any_needs(store, capsys):
    for system, cost in (("lda", 1.0), ("svm", 2.0)):
        tracked_run(store, system, made_up(), cost=cost)
    assert main(["choose", "max_flash=1kB", "max_decision=9s"]) == 1
    out = capsys.readouterr().out
    assert "flash at most 1 kB alone rules out 2 of 2 candidates; the least that any needs is 4 kB, lda" in out
    assert "bench stream replays systems" in out and "bench chip" not in out and f"bench run {SMALL}" in out
    assert main(["choose", "by=cycles"]) == 1
    assert "bench chip exports systems to C" in capsys.readouterr().out
    cells(parse(SMALL.split(), {"model", "features"}))  # can be typed


def test_nothing_heavy_is_loaded_to_choose_among_three_runs(store):
    for system in ("lda", "svm", "rf"):
        arguments = json.dumps({"data": "synth", "model": system, "features": "jung28"})
        tracked_run(store, system, made_up(), **{"touchbench.command": "run", "touchbench.arguments": arguments})
    code = "import sys; from bench.cli import main; main(['choose']); print({'torch', 'sklearn'} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()
    assert said[-1] == "set()" and said[-2].startswith("next: bench fit data=synth model=")


def test_amounts():
    assert quantity("max_flash", "256kB") == 256 and quantity("max_flash", "1MB") == 1000
    assert quantity("max_ram", "32KiB") == pytest.approx(32.768) and quantity("max_ram", "500B") == 0.5
    assert quantity("max_decision", "0.7s") == 700 and quantity("max_predict", "2ms") == 2
    assert quantity("margin", "1.5") == 1.5
    for key, text in (
        ("max_flash", "3ms"),
        ("max_predict", "2kB"),
        ("margin", "2ms"),
        ("max_ram", "0kB"),
        ("max_ram", "32"),
        ("max_ram", "much"),
        ("max_ram", "-1kB"),
        ("max_ram", "nankB"),
    ):
        with pytest.raises(InputError, match=f"{key}={text}: give a number above 0"):
            quantity(key, text)


def test_choosing_among_tracked_runs(capsys):
    assert main(["run", "model=bayes,cnn85", "features=jung28", "model.epochs=2", "model.frames=40", *FEW]) == 0
    assert main(["run", "model=svm", "protocol=kfold", "protocol.folds=2", *FEW]) == 0
    capsys.readouterr()
    assert main(["choose"]) == 2
    told = capsys.readouterr().err.strip().partition("name one of: ")[2].split("; ")
    assert told[1] == "data=synth where=all protocol=kfold"
    for words in told:  # which can be pasted
        assert main(["choose", *words.split()]) == 0
    choosable = candidates(connect(), {"protocol": ["loso"]})
    found, about, subjects = choosable.table, choosable.about, choosable.subjects
    assert "synthetic" in about and len(subjects.columns) == 4
    named = [("bayes · jung28", "capture", False), ("cnn85[frames=40, epochs=2]", "capture", True)]
    assert list(zip(found["system"], found["unit"], found["windows"], strict=True)) == named
    assert found["decision"][0] > 40 / 135 * 1000
    assert main(["choose", "protocol=loso", "max_decision=1ms"]) == 1
    out = " ".join(capsys.readouterr().out.split())
    assert "is scored in percent of windows: see unit=window" in out and "40 / 135" not in out
    assert main(["choose", "protocol=loso"]) == 0
    out = capsys.readouterr().out
    assert "cnn85[frames=40, epochs=2]" in out and "Choose bayes · jung28: " in out
    assert main(["choose", "protocol=loso", "max_flash=1B", "model=bayes,cnn85"]) == 1
    assert main(["choose", "protocol=loso", "by=price"]) == 2
    assert main(["choose", "protocol=loso", "model.frames=3"]) == 2
    assert main(["choose", "protocol=loso", "model=rf"]) == 2
    assert "no complete run is tracked" in capsys.readouterr().err


def test_percents_of_windows_are_compared_with_one_another_alone(capsys):
    assert main(["run", "model=bayes,lda", "features=jung28", *FEW]) == 0
    assert main(["choose", "unit=window"]) == 2
    assert "no complete run" in capsys.readouterr().err
    assert main(["run", "model=lda", "features=touch", "model.window=0.2,0.4", *FEW]) == 0
    windows = candidates(connect(), {}, windows=True)
    found, subjects = windows.table, windows.subjects
    assert list(found["unit"]) == ["window", "window"] and set(found["system"].str.split("[").str[0]) == {"lda"}
    for place, (run, row) in enumerate(zip(connect().of_kind("cell")[:2][::-1], found.itertuples(), strict=True)):
        table = pd.read_parquet(connect().path(run.info.run_id, run.info.artifact_uri, "predictions.parquet"))
        columns = [c for c in table if c.startswith("p_")]
        right = np.array([c[2:] for c in columns])[table[columns].to_numpy().argmax(axis=1)] == table["true"]
        assert subjects.loc[place].to_dict() == pytest.approx((100 * right.groupby(table["subject"]).mean()).to_dict())
        assert row.decision == pytest.approx(1000 * (0.2, 0.4)[place], abs=1000 / 135)
    assert main(["choose", "unit=window", "max_decision=9s"]) == 0
    assert "(one window)" in capsys.readouterr().out
    assert main(["choose", "unit=frame"]) == 2
    assert main(["choose", "unit=window", "over=window", "model=lda"]) == 2


OWN = """
from sklearn.naive_bayes import GaussianNB
def near(): return GaussianNB()
"""


def test_a_model_of_a_file_is_found_by_its_file_and_by_its_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    assert main(["run", "model=mine.py:near,bayes", "features=jung28", *FEW]) == 0
    for name in ("mine.py:near", "near", str(tmp_path / "mine.py:near")):
        capsys.readouterr()
        found = candidates(connect(), {"model": [name]}).table
        assert list(found["system"]) == ["near · jung28"], name
        assert main(["choose", f"model={name}"]) == 0 and "warning" not in capsys.readouterr().err
        assert list(bench.results(model=name)["system"]) == ["near · jung28"]
    assert main(["choose", "model=other.py:near,mine.py:near,svm"]) == 0
    err = capsys.readouterr().err
    assert "model=svm: no run of it is tracked" in err and "model=other.py:near: no run" in err
    assert "mine.py" not in err


def test_sizes_as_linked_are_marked_beside_those_without_code(monkeypatch, capsys):
    found, subjects = table([[80] * 4, [70] * 4], flash=[20.0, 5.0])
    found = found.assign(kind="cell", command="run", arguments="", cycles=1.0)
    choice = decide(found.assign(linked=[True, False]), subjects, "flash", {}, None)
    _print(Chosen(choice, "synth", "flash", {}, None, 4))
    out = capsys.readouterr().out
    assert "20 kB*" in out and "5 kB*" not in out and "* as linked in C" in out
    choice = decide(found.assign(linked=True), subjects, "flash", {}, None)
    _print(Chosen(choice, "synth", "flash", {}, None, 4))
    assert "* as linked" not in capsys.readouterr().out


def test_times_of_several_processors_are_warned_of(monkeypatch, capsys):
    assert main(["run", "model=bayes", "features=jung28", *FEW]) == 0
    monkeypatch.setattr(machine, "this_machine", lambda: Machine("another", ""))
    assert main(["run", "model=tree", "features=jung28", *FEW]) == 0
    capsys.readouterr()
    assert main(["choose", "max_predict=9s"]) == 0 and "several processors: " in capsys.readouterr().err
    assert main(["choose"]) == 0 and "several processors" not in capsys.readouterr().err


def test_a_replayed_system_decides_within_the_budget(capsys, tmp_path):
    assert main(["stream", "model=bayes", "features=jung28", f"out={tmp_path}", *FEW]) == 0
    assert main(["run", "model=bayes", "features=jung28", *FEW]) == 0
    found = candidates(connect(), {}, 30_000.0).table
    assert list(found["unit"]) == ["capture", found["unit"][1]] and found["accuracy"][1] == found["accuracy"][0]
    soon = candidates(connect(), {}, 345.0)
    found, subjects = soon.table, soon.subjects
    (run,) = connect().of_kind("stream")
    assert found["unit"][1] == "first 244 ms"  # 33 frames at 135 Hz; the next instant is at 348 ms
    assert subjects.loc[1].mean() == pytest.approx(100 * run.data.metrics["accuracy_at_250_ms"])
    assert found["decision"][1] == pytest.approx(33 / 0.135)  # of touch
    exactly = f"{33 / 0.135:.9f}"  # rounding is no excess
    assert candidates(connect(), {}, float(exactly)).table["unit"][1] == "first 244 ms"
    assert main(["choose", "max_decision=345ms"]) == 0
    assert "Choose bayes · jung28 (first 244 ms)" in capsys.readouterr().out
    at_each = candidates(connect(), {}, replays=True).table
    assert len(at_each) > 5 and at_each["unit"][0] == "capture" and "first 244 ms" in set(at_each["unit"])
    assert at_each["decision"][1:].is_monotonic_increasing
    found = candidates(connect(), {}, 1.0).table  # the first instant says how far it is from that
    assert list(found["unit"]) == ["capture", "first 59 ms"]
    assert main(["stream", "model=bayes", "features=jung28", "hop_ms=150", f"out={tmp_path}", *FEW]) == 0
    found = candidates(connect(), {}, 345.0).table  # replayed in two ways: both are there
    assert set(found["unit"]) == {"capture", "first 244 ms", "first 296 ms"}


def test_among_runs_with_so_many_shots_of_a_new_person(capsys):
    small = ["data=synth", "data.subjects=3", "where=gesture in ['pat', 'rub', 'grab']", "features=touch"]
    personal = ["run", *small, "model=lda,bayes", "protocol=personal", "protocol.draws=1"]
    assert main(["run", *small, "model=lda"]) == 0
    assert main(["choose", "shots=1"]) == 2  # nothing knows of shots
    assert main([*personal, "protocol.shots=0,1"]) == 0
    assert main([*personal, "protocol.unlabelled=true"]) == 0
    capsys.readouterr()
    found = {}
    for shots in ("0", "1"):
        assert main(["choose", f"shots={shots}", "by=predict"]) == 0
        found[shots] = capsys.readouterr().out
    assert "1 shots" in found["1"] and "0 shots" in found["0"] and "1 shots" not in found["0"]
    assert "lda" in found["1"] and "bayes" in found["1"]
    assert main([*personal[:-1], "protocol.draws=2", "protocol.shots=1"]) == 0
    assert main(["choose", "shots=1"]) == 2 and main(["choose", "shots=1", "protocol.draws=2"]) == 0
    capsys.readouterr()
    for wrong, told in (
        (["shots=2"], "no complete run"),
        (["shots=x"], "whole number"),
        (["shots=1", "over=C"], "leave it out"),
    ):
        assert main(["choose", *wrong]) == 2 and told in capsys.readouterr().err


def test_over_a_parameter_and_over_features(capsys):
    small = ["data.subjects=4", "data.repetitions=2", "protocol=groupkfold", "protocol.folds=2", "inner=2"]
    assert main(["choose", "model=bayes", "over=ridge", "model.ridge=1,0.01", "features=jung28", *small]) == 0
    out = capsys.readouterr().out
    assert "ridge=0.01|1.0" in out and "objective=smallest" in out and "bayes · jung28" in out
    assert main(["choose", "model=bayes", "features=jung28", "over=features", *small]) == 0
    assert "best of jung28" in capsys.readouterr().out
    for wrong, told in (
        (["model=rf", "over=tree"], "over=tree: did you mean trees"),
        (["model=svm", "over=kernel"], "no sizes"),
        (["model=rf", "over=seed"], "over=seed"),
        (["model=cnn85", "over=width", "model.width=20,40"], "model.width=20: give a share"),
        (["model=cnn85", "over=features"], "takes none"),
        (["model=jung2017_tree", "over=features"], "searches by itself"),
        (["model=rf", "over=trees", "by=flash"], "leave out over="),
    ):
        assert main(["choose", *wrong, *FEW]) == 2
        assert told in capsys.readouterr().err
