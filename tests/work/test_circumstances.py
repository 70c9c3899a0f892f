"""Circumstances: what is fitted on what, what is predicted in which case, and what is measured of it."""

import pickle
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

import bench
from bench import scores
from bench.candidate import Wish
from bench.circumstances.base import Case, Circumstance, option
from bench.circumstances.faults import Faults
from bench.circumstances.instants import Instants
from bench.circumstances.subjects import Subjects
from bench.cli import main
from bench.corpora.faults import FAULTS, as_shares, damaged, usual_faults
from bench.errors import InputError
from bench.outcomes.reactions import Reactions, by_capture
from bench.outcomes.runs import every_result, plain
from bench.plan.cells import cells
from bench.plan.plan import Fold, Plan, folds_of
from bench.registry import views
from bench.reports.views.base import View
from bench.result import Result
from bench.store import connect
from bench.work.curves import COLUMNS, unharmed
from bench.work.evaluation import folded, run_of
from bench.work.fitted import labelled
from bench.work.fold import decisions
from bench.work.loop import prepared
from bench.work.subset import subset
from bench.work.tracking import key_of
from tests.conftest import SMALL, random_corpus, with_other_values
from tests.work.fakes import Level, cell_of

FEW = ("noise", "early_end")
CORPUS = random_corpus(per_class=2, grid=(4, 4))
TEST, TRAIN = np.flatnonzero(CORPUS.subjects == "2"), np.flatnonzero(CORPUS.subjects != "2")
FOLD = Fold("x", TRAIN, TEST)
ABOUT = {"system": "Level", "seed": "0", "data": "random", "synthetic": "false"}
ABOUT |= {"subset": "all", "target": "gesture", "protocol_label": "LOSO"}


class Recorder(Level):
    """Remembers what it was fitted on."""

    seen = []

    def fit(self, X, y):
        super().fit(X, y)
        self.seen.append((self, [frames.copy() for frames in X], X.index.copy(), pickle.dumps(vars(self))))
        return self


def stress(faults=FEW, fewer=()):
    """What ``bench stress`` runs."""
    return Faults(faults), *([Subjects(fewer)] if fewer else [])


def once(*circumstances, system=Level):
    """A fold of a system of tests, and the run of it."""
    cell = cell_of(system, *circumstances)
    result = folded(cell, CORPUS, FOLD, 1)
    return result, run_of(SimpleNamespace(corpus=CORPUS, cell=cell), ABOUT, [result])


def recorded(corpus, fewer=()):
    Recorder.seen = []
    return folded(cell_of(Recorder, *stress(FEW, fewer)), corpus, FOLD, 1), Recorder.seen


@pytest.fixture(scope="module")
def stressed():
    """A fold with two faults and one or two training subjects besides, and every fit in it."""
    return recorded(CORPUS, (1, 2))


def test_only_clean_training_captures_are_seen_and_faults_leave_what_was_learned(stressed):
    result, ((model, frames, index, learned), *_) = stressed
    assert np.array_equal(index, TRAIN)
    assert all(np.array_equal(a, CORPUS[int(i)]) for a, i in zip(frames, TRAIN, strict=True))
    assert pickle.dumps(vars(model)) == learned
    _, others = recorded(with_other_values(CORPUS, TEST))
    assert len(others) == 1 and others[0][3] == learned  # fitted once, whatever the faults
    table = result.tables["labels"]
    columns = {"fold", "capture", "true", *(COLUMNS - {"hit"}), "subject", "repetition"}
    assert len(table) == len(TEST) * (1 + 2 * 5 + 2) and set(table) == columns
    noisy = table[table["case"] == "noise"].groupby("level")["amount"].first()
    assert noisy.to_dict() == {s: FAULTS["noise"].describe(s) for s in range(1, 6)}
    clean, faulty = unharmed(table), table[table["circumstance"] == "under"]
    assert {*faulty["case"]} == {*FEW} and clean["case"].eq("none").all() and len(clean) == len(TEST)
    assert clean["amount"].eq("").all() and (clean["length"].to_numpy() == CORPUS.lengths[TEST]).all()
    assert clean["train_subjects"].eq(3).all() and faulty["train_subjects"].eq(3).all()


def test_fewer_training_subjects_are_among_more_and_never_tested(stressed):
    result, seen = stressed
    chosen = [set(CORPUS.subjects[index]) for _, _, index, _ in seen]
    assert [len(c) for c in chosen] == [3, 1, 2] and chosen[1] < chosen[2] < chosen[0] and "2" not in chosen[0]
    table = result.tables["labels"]
    fewer = table[table["train_subjects"] < 3]
    assert fewer["circumstance"].eq("train_subjects").all() and len(fewer) == 2 * len(TEST)
    assert (fewer["level"] == fewer["train_subjects"]).all() and fewer["amount"].eq("").all()
    assert np.array_equal(subset(CORPUS, TRAIN, TEST, 2, 0), subset(CORPUS, TRAIN, TEST, 2, 0))
    drawn = {tuple(sorted(set(CORPUS.subjects[subset(CORPUS, TRAIN, TEST, 1, seed)]))) for seed in range(20)}
    assert len(drawn) == 3  # other seeds, other subjects


def test_labels_under_a_fault_are_those_of_the_damaged_captures_and_clean_ones_those_of_bench_run(stressed):
    result = stressed[0]
    table, whole = result.tables["labels"], once()[0].table
    pd.testing.assert_frame_equal(result.table, whole)
    expected, clean = scores.captures(whole), unharmed(table)
    for column in ("fold", "capture", "true", "predicted", "subject"):
        assert clean[column].tolist() == expected[column].tolist()
    system, shares = Level().fit(CORPUS[TRAIN], CORPUS.gestures[TRAIN]), as_shares(CORPUS, TEST)
    for fault in map(FAULTS.__getitem__, FEW):
        for severity in range(6):
            worse = damaged(CORPUS, TEST, shares, fault, severity)
            part = table[(table["case"] == fault.name) & (table["level"] == severity)] if severity else clean
            proba = system.predict_proba(worse[TEST])
            assert part["predicted"].tolist() == system.classes_[proba.argmax(axis=1)].tolist()
            p_true = proba[np.arange(len(TEST)), np.searchsorted(system.classes_, CORPUS.gestures[TEST])]
            np.testing.assert_allclose(part["p_true"], p_true, rtol=1e-6)


def test_labels_are_right_where_a_class_is_not_tested_and_a_window_net_decides_often(corpus):
    class Windows(Level):
        def decide(self, X):
            position = np.repeat(np.arange(len(X)), 2)
            proba = np.tile([[0.0, 0.2, 0.8], [0.0, 0.7, 0.3]], (len(X), 1))
            return pd.DataFrame({"capture": position, "start": 0, "frames": 1}), proba

    model = Windows().fit(corpus, corpus.gestures)
    test = np.flatnonzero((corpus.gestures != "pat") & (corpus.subjects == "3"))
    rows = labelled(decisions(model, corpus, "3", test))
    assert rows["predicted"].eq("tap").all() and rows["capture"].tolist() == test.tolist()
    assert rows["p_true"].tolist() == pytest.approx(np.where(rows["true"] == "tap", 0.55, 0.45))


class Shy(Level):
    """Abstains where no class is likely enough."""

    abstains = "unknown"

    def predict_proba(self, X):
        proba = super().predict_proba(X)
        return np.where(proba.max(axis=1, keepdims=True) > 0.9945, proba, np.nan)

    def predict(self, X):
        proba = self.predict_proba(X)
        return np.where(np.isnan(proba[:, 0]), "unknown", self.classes_[np.nan_to_num(proba).argmax(axis=1)])


def test_abstentions_are_wrong_in_every_circumstance_and_their_share_is_told():
    _, run = once(Faults(("noise",)), Instants((250.0, 1000.0)), system=Shy)
    system, shares = Shy().fit(CORPUS[TRAIN], CORPUS.gestures[TRAIN]), as_shares(CORPUS, TEST)
    for severity, row in run.tables["faults"].set_index("severity").iterrows():
        proba = system.predict_proba(damaged(CORPUS, TEST, shares, FAULTS["noise"], severity)[TEST])
        gone = np.isnan(proba[:, 0])
        hit = system.classes_[np.nan_to_num(proba).argmax(axis=1)] == CORPUS.gestures[TEST]
        assert (row["accuracy"], row["abstained"]) == ((hit & ~gone).mean(), gone.mean())
    gone = np.isnan(system.predict_proba(CORPUS[TEST])[:, 0]).mean()
    assert 0 < run.metrics["abstained"] == gone < 1
    labelled = scores.captures(run.tables["predictions"])
    rows = by_capture(run.tables["predictions"], Reactions(silence=0.25)).assign(predicted=labelled["predicted"])
    assert (rows["taken"] == "nothing").tolist() == labelled["predicted"].eq("").tolist()
    wrong = (labelled["predicted"] != labelled["true"]).mean()
    assert Reactions(silence=0.25).scores(rows)["2"] == pytest.approx(100 * (1 - wrong + 0.75 * gone))


def test_metrics_are_those_of_the_table(stressed):
    result, _ = stressed
    metrics = result.scored
    table = result.tables["labels"].assign(hit=lambda rows: rows["true"] == rows["predicted"])
    noisy = table[(table["case"] == "noise") & (table["level"] == 3)]["hit"].mean()
    clean = unharmed(table)["hit"].mean()
    assert metrics["accuracy.noise.3"] == noisy and metrics["accuracy"] == clean
    assert metrics["accuracy.train_subjects.1"] == table[table["train_subjects"] == 1]["hit"].mean()
    _, run = once(*stress(FEW, (1, 2)))
    measured = run.metrics
    assert measured["accuracy.noise.3"] == noisy and measured["accuracy"] == clean
    assert measured["faults_tested"] == 2 and measured["faults_trained"] == 0
    assert {"loss.noise", "loss.early_end", "chance", "failing_slices", "accuracy.train_subjects.2"} <= set(measured)
    assert {"fault_seconds", "fault_cpu_seconds", "refit_seconds"} <= set(measured)
    worst = max((measured["loss.noise"], "noise"), (measured["loss.early_end"], "early end"))
    said = {
        m.name: m.of(Result(run.about | {"faults": "noise, early_end"}, measured, {}))
        for m in views()["under"].shows([run])
    }
    assert said["failing groups"] == f"{measured['failing_slices.under']} of {measured['tested_slices.under']}"
    assert said["worst fault"] == f"{worst[1]} {100 * worst[0]:.1f}"
    alone = once(*stress((), (1,)))[0].tables["labels"]  # the learning curve alone
    assert not alone["circumstance"].eq("under").any() and set(alone["train_subjects"]) == {1, 3}
    typed = [Faults(names).arguments() for names in ((), usual_faults(), FEW)]
    assert typed == [{"under": "none"}, {"under": "all"}, {"under": "noise,early_end"}]


def test_other_faults_or_training_subjects_are_another_run(corpus):
    (cell,) = cells({"model": "bayes"})
    plan = Plan(cell, corpus, tuple(folds_of(cell, corpus)), 1, 1)
    every = (stress(FEW), stress(FEW[:1]), stress(FEW, (2,)), ())
    keys = [key_of(plan.of(replace(cell, circumstances=some))) for some in every]
    assert len(set(keys)) == 4 and keys[0] == key_of(plan.of(replace(cell, circumstances=stress(FEW))))


def test_one_run_in_several_circumstances_has_what_a_run_in_each_has():
    every = (Faults(FEW), Instants((250.0, 1000.0)), Subjects((1,)))
    together, measured = once(*every)
    for one in every:
        alone, run = once(one)
        pd.testing.assert_frame_equal(alone.table, together.table)
        for name, table in alone.tables.items():
            if name == "labels":
                wanted = together.tables[name]["circumstance"].isin(["", one.key])
                pd.testing.assert_frame_equal(together.tables[name][wanted].reset_index(drop=True), table)
            else:
                pd.testing.assert_frame_equal(together.tables[name], table)
        numbers = run.metrics
        same = [
            n
            for n in numbers
            if n.startswith(("accuracy", "loss", "replay_accuracy", "failing_slices.")) or n == "chance"
        ]
        assert len(same) > 3 and {n: measured.metrics[n] for n in same} == {n: numbers[n] for n in same}
    names = [m.name for m in views()["after"].shows([measured])]
    assert names[1:3] == ["250 ms", "whole"] and "early stop %" not in names  # no capture lasts 1000 ms
    assert "stopping" not in views()["after"].title([measured])
    learned = Result(measured.about, measured.metrics | {"adaptive_accuracy": 0.5, "adaptive_ms": 300.0}, {})
    spare = {m.name: m.spare for m in views()["after"].shows([learned])}
    assert spare["early stop %"] == spare["at mean ms"] == 0 and "stopping" in views()["after"].title([learned])
    assert "stopping" not in measured.tables and {"labels", "replay", "learning", "slices"} < {*measured.tables}
    assert {"fault", "time"} <= {*measured.tables["slices"]["circumstance"]}


def test_a_circumstance_that_fails_in_a_fold_leaves_the_others_and_is_tried_again(monkeypatch, capsys):
    words = ["run", *SMALL, "model=bayes", "features=jung28", "under=noise", "after=250ms"]
    replayed, done = Instants.fold, []

    def fold(self, at):
        done.append(at.fold.name)
        if at.fold.name == "2":
            raise ValueError("no replay")
        return replayed(self, at)

    monkeypatch.setattr(Instants, "fold", fold)
    assert main(words) == 1
    said = capsys.readouterr()
    assert said.err.count("fold 2, after= failed: ValueError: no replay") == 1 and "traceback of the first" in said.err
    (run,) = every_result(connect())
    assert run.complete and run["folds"] == 3 and views()["under"].holds(run) and not views()["after"].holds(run)
    assert {"accuracy", "loss.noise"} <= {*run.metrics} and "replay_accuracy" not in run
    assert bench.choose(data="synth").choice.table["unit"].tolist() == ["capture"]
    assert main([*words[:-2], "after=250ms"]) == 1  # alone: another run, whose captures are labelled
    assert capsys.readouterr().out.count("3/3") == 1
    monkeypatch.setattr(Instants, "fold", replayed)
    done.clear()
    assert main(words) == 0 and "fold 2 done" in (said := capsys.readouterr().err) and "fold 1 done" not in said
    run = next(r for r in every_result(connect()) if views()["under"].holds(r))
    assert views()["after"].holds(run) and run["replay_accuracy"] > 0 and not run.failed


@dataclass(frozen=True)
class Pressed(Circumstance):
    """Readings times a factor, in cases with names."""

    key: ClassVar[str] = "pressed"

    def cases(self, at):
        for case in ("up", "down"):
            for factor in (0.5, 2):
                frames = at.corpus.frames * (factor if case == "up" else 1 / factor)
                yield Case(case, factor, corpus=at.corpus.changed(frames=frames.astype(np.float32)))


class Pressing(View):
    noun = "times"
    alike = {"pressed.hand": ("{} hand", "right")}


def test_each_named_case_and_fractional_level_is_a_column_and_a_candidate():
    result, run = once(Faults(("noise",)), Pressed())
    view = Pressing("pressed", ("pressed",))
    names = {f"accuracy.{case}.{level}" for case in ("up", "down") for level in ("0.5", "2")}
    names |= {f"accuracy.noise.{severity}" for severity in range(1, 6)}
    of = [{n for n in numbers if n.startswith("accuracy.")} for numbers in (run.metrics, result.scored)]
    assert of == [names, names]
    table = run.tables["labels"].assign(hit=lambda rows: rows["true"] == rows["predicted"])
    right = table.groupby(["case", "level"])["hit"].mean()
    shown = {m.name: m.cell(run) for m in view.shows([run])}
    cases = [(case, level) for case in ("up", "down") for level in (0.5, 2)]
    assert [*shown][:-1] == [f"{case}, {level:g} times" for case, level in cases]
    assert shown == pytest.approx(
        {f"{case}, {level:g} times": 100 * right[case, level] for case, level in cases}
        | {"mean loss": 100 * (right["none", 0] - np.mean([right[one] for one in cases]))}
    )
    ways = [way.unit for way in view.candidates(run, Wish(Reactions()))]
    assert ways == [f"{case}, {level:g} times" for case, level in cases]
    left = Result(run.about | {"pressed.hand": "left"}, run.metrics, run.tables)
    apart = [way.unit for way in view.candidates(left, Wish(Reactions()))]
    assert apart == [f"{way}, left hand" for way in ways]


def test_numbers_of_training_subjects_that_differ_between_folds_are_a_column():
    """Of three folds of five subjects, one trains on four and two on three: 3.3 subjects on average."""
    run = Result(ABOUT, {"accuracy.train_subjects.2": 0.5, "accuracy.train_subjects.3.3": 0.75}, {})
    assert {m.name: m.of(run) for m in views()["train_subjects"].shows([run])} == {
        "2 subjects": "50.0",
        "3.3 subjects": "75.0",
    }


def test_times_in_another_order_are_the_same_run_and_the_same_candidates():
    (one,), (other,) = (Instants.of({"after": text}) for text in ("200ms,1234.5678ms,100ms", "100ms,200ms,1234.5678ms"))
    assert one == other and one.params() == other.params()
    assert Instants.of(one.arguments()) == [one]
    (hop,) = Instants.of({"after": "each", "hop_ms": "33.3333333"})
    assert Instants.of(hop.arguments()) == [hop] and hop.arguments()["hop_ms"] == "33.3333333"
    ways = []
    for times in ((100.0, 200.0), (200.0, 300.0)):
        _, run = once(Instants(times))
        run.about.update({name: str(value) for name, value in Instants(times).params().items()})
        ways.append({(c.apart, c.unit): c.scores for c in views()["after"].candidates(run, Wish(Reactions(), np.inf))})
    both = {*ways[0]} & {*ways[1]}
    assert {unit for _, unit in both} >= {"first 200 ms"} and len(both) == 2  # and the whole capture
    assert all(ways[0][key].equals(ways[1][key]) for key in both)


def test_times_beyond_the_longest_capture_and_equal_lengths_are_told_once(capsys):
    words = [*SMALL, "model=bayes,tree", "features=jung28", "after=250ms,1000s"]
    assert main(["run", *words]) == 0
    said = capsys.readouterr().err
    assert said.count("warning: synth: after=1000000ms: no capture lasts so long; the longest") == 1


@dataclass(frozen=True)
class Typed(Circumstance):
    """Options with several values of a type."""

    key: ClassVar[str] = "shares"

    shares: tuple[float, ...] = option((), "shares", type="number")
    sides: tuple[str, ...] = option(("left",), "sides", ("left", "right"))
    ends: tuple[bool, ...] = option((), "ends", type="yes")


def test_each_of_several_values_of_an_option_is_of_its_type():
    (made,) = Typed.of({"shares": "0.5,0.25", "sides": "right,left", "ends": "no,yes"})
    assert made == Typed((0.5, 0.25), ("right", "left"), (False, True)) and Typed.of(made.arguments()) == [made]
    for key, value in (("shares", "zebra"), ("shares", "0.5,-1"), ("sides", "left,up"), ("ends", "maybe")):
        with pytest.raises(InputError, match=f"{key}={value.split(',')[-1]}: give"):
            Typed.of({key: value})


@pytest.mark.parametrize(
    ("words", "fact"),
    [
        (["hop_ms=200"], "hop_ms= needs after="),
        (["after=0ms"], "after=0ms"),
        (["after=250ms", "hop_ms=200"], "leave one of them out"),
        (["after=each,250ms"], "after=each,250ms: each stands alone"),
        (["under=nois"], "did you mean noise"),
        (["train_subjects=0"], "at least 1"),
    ],
)
def test_what_no_circumstance_takes_is_one_line(words, fact, capsys):
    assert main(["run", *SMALL, "model=bayes", "features=jung28", *words]) == 2
    error = capsys.readouterr().err
    assert fact in error and error.count("\n") == 1


def test_a_plain_run_and_one_in_a_circumstance_are_one_system(capsys):
    words = [*SMALL, "model=bayes", "features=jung28"]
    assert main(["run", *words, "under=noise"]) == 0 and main(["run", *words]) == 0
    every = every_result(connect())
    (one,) = plain(every)
    assert len(every) == 2 and not views()["under"].holds(one)
    assert one["accuracy"] == next(r for r in every if views()["under"].holds(r))["accuracy"]
    assert bench.choose(data="synth").choice.table["unit"].tolist() == ["capture"]
    assert bench.runs()["name"].tolist() == ["bayes · jung28, faults noise", "bayes · jung28"]


def test_a_column_that_tables_of_labels_need_is_refused_before_anything_runs(monkeypatch):
    (cell,) = cells({"model": "bayes", "features": "jung28"})
    named = CORPUS.changed(captures=CORPUS.captures.assign(level=1))
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: named)
    with pytest.raises(InputError, match="'level'"):
        prepared([replace(cell, circumstances=stress())], 1)
    assert prepared([cell], 1)
