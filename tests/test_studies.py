"""The studies: each runs on generated captures; laws and curves by hand; no test subject is seen."""

import sys

import numpy as np
import pandas as pd
import pytest
from sklearn.model_selection import GroupKFold

import bench
from bench import contract
from bench.arguments import parse
from bench.options import keys
from bench.plan.cells import cells
from bench.reports.pair import Compared
from studies import ablation, epochs, learning, reference
from tests.conftest import with_other_values
from tests.results import result

SMALL = ["data=synth", "data.variants=normal"]
LITTLE = ["data.subjects=4", "data.repetitions=1"]
NETWORK = {"data": "synth", "data.subjects": 4, "data.variants": "normal", "data.repetitions": 1}
NETWORK |= {"protocol": "groupkfold", "protocol.folds": 2, "model": "hughes2017_cnn", "model.rate": 1e-3}


def test_learning_curves_are_extrapolated_and_compared(tmp_path, monkeypatch):
    monkeypatch.setattr(learning, "DRAWS", 20)
    out = tmp_path / "curves"
    words = [*SMALL, *LITTLE, "model=bayes", "features=jung28", "train_subjects=1,2", "until=60", f"out={out}"]
    table = learning.main([*words, "+", "model=lda", "features=touch"])
    assert [*table["method"].unique()] == ["bayes · jung28", "lda · touch"]
    measured = table[table["kind"] == "measured"]
    assert measured["train_subjects"].tolist() == [1, 2, 3, 1, 2, 3]
    keys = {"data__subjects": 4, "data__variants": "normal", "data__repetitions": 1}
    alone = bench.run(data="synth", model="lda", features="touch", **keys)
    assert 100 * measured["accuracy"].iloc[-1] == pytest.approx(alone["accuracy"][0])
    assert table["kind"].str.startswith("above").sum() == 1 and (out / "learning.svg").stat().st_size > 10_000
    assert "not people" in (out / "learning.svg").read_text()
    for more in (["+"], ["+", "features=touch"], ["until=x"]):
        with pytest.raises(bench.InputError):
            learning.main([*words[:-2], *more])


@pytest.mark.parametrize(("a", "b", "c"), [(0.1, 0.5, 0.5), (0.0, 0.6, 0.2), (0.3, 0.2, 1.5)])
def test_a_law_is_found_again_and_more_subjects_never_hurt(a, b, c):
    counts = np.array([2, 4, 8, 16, 64.0])
    fitted = learning.law(counts, a + b * counts**-c)
    np.testing.assert_allclose(fitted[0] + fitted[1] * counts ** -fitted[2], a + b * counts**-c, atol=3e-3)
    rising = learning.law(np.array([2, 4, 8.0]), np.array([0.2, 0.25, 0.3]))
    assert rising[:2] == pytest.approx((0.25, 0), abs=1e-6)


def test_extrapolation_is_of_pooled_captures_and_overtaking_is_by_hand():
    hits = {2: [5, 6, 4], 4: [6, 6, 6], 8: [7, 8, 6], 9: [7, 8, 7]}  # of three subjects with ten captures each
    tested = [(n, subject, right, k) for n, of in hits.items() for subject, right in enumerate(of) for k in range(10)]
    rows = [(n, subject, "a", "a" if k < right else "b") for n, subject, right, k in tested]
    labels = pd.DataFrame(rows, columns=["train_subjects", "subject", "true", "predicted"])
    counts = np.array([2, 10, 50, 300.0])
    expected = learning.extrapolated(labels, counts, 20)
    a, b, c = learning.law(np.array([2, 4, 8, 9.0]), 1 - np.array([15, 18, 21, 22]) / 30)
    np.testing.assert_allclose(expected[0], 1 - a - b * counts**-c)
    assert expected.shape == (21, 4) and (np.diff(expected, axis=1) >= -1e-12).all()
    other = np.array([[0.6, 0.7, 0.75, 0.76]] * 3)
    deep = np.array([[0.7, 0.65, 0.76, 0.80], [0.5, 0.6, 0.7, 0.77], [0.5, 0.6, 0.7, 0.75]])
    assert learning.overtakes(deep, other, counts) == (50.0, 0.5)  # early luck does not count
    assert learning.overtakes(other, deep, counts)[0] == np.inf


def test_accuracy_by_epoch_is_that_of_so_long_a_training_and_uses_no_test_subject():
    (plan,) = bench.plans(**NETWORK, **{"model.epochs": 2})
    table = epochs.trained(plan, 0, 2, 0)
    train = plan.folds[0].train
    names = plan.corpus.subjects[train].astype(str)
    learnt, judged = next(GroupKFold(2, shuffle=True, random_state=0).split(names, groups=names))
    part, held = plan.corpus[train[learnt]], plan.corpus[train[judged]]
    for row in table.to_dict("records"):
        plain = plan.cell.estimator().set_params(epochs=int(row["epoch"])).fit(part, part.gestures)
        assert row["accuracy"] == pytest.approx((plain.predict(held) == held.gestures).mean())
        assert row["loss"] == pytest.approx(contract.history(plain)[-1]["loss"])
    object.__setattr__(plan, "corpus", with_other_values(plan.corpus, plan.folds[0].test))
    pd.testing.assert_frame_equal(epochs.trained(plan, 0, 2, 0), table)


def test_curves_of_epochs_are_pooled_and_what_has_ended_stays():
    def training(accuracies, captures):
        numbers = np.arange(1, len(accuracies) + 1)
        return pd.DataFrame({"epoch": numbers, "loss": 1.0 / numbers, "accuracy": accuracies, "captures": captures})

    curve = epochs.pooled([training([0.1, 0.2, 0.4], 10), training([0.4, 0.7], 30)])
    assert curve["accuracy"].tolist() == pytest.approx([0.325, 0.575, 0.625])
    assert curve["loss"].tolist() == pytest.approx([1, 1 / 2, (1 / 3 + 1 / 2) / 2])
    flat = epochs.pooled([training([0.0, 0.9, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.4, 0.4], 10)])
    assert epochs.best_epoch(flat) == (8, pytest.approx(0.5))  # one lucky epoch is none
    assert epochs.best_epoch(epochs.pooled([training([0.3, 0.6], 10)])) == (2, pytest.approx(0.45))


@pytest.mark.parametrize("label", ablation.ROWS | ablation.CHANCES)
def test_every_row_of_the_ablation_is_a_system_that_can_be_made(label):
    keys = (ablation.ROWS | ablation.CHANCES)[label]
    (cell,) = cells(keys)
    contract.check(cell.estimator())
    faults = ("faults" in label or label.startswith("reflex")) and "without faults" not in label
    assert (len(contract.trained_faults(cell.estimator())) == 17) == faults


def test_every_reference_command_names_systems_that_are_there():
    commands = [command.split() for part in reference.PARTS.values() for command in part]
    assert len({" ".join(words) for words in commands}) == len(commands)
    for command, *words in commands:
        assert command in ("run", "stress", "stream", "watch") and cells(parse(words, keys(command)))


def test_a_failing_reference_command_is_reported_and_the_others_run(tmp_path, monkeypatch):
    echo = "import sys; print(*sys.argv[1:]); sys.exit('data=nothing' in sys.argv)"
    monkeypatch.setattr(reference, "BENCH", [sys.executable, "-c", echo])
    monkeypatch.setitem(reference.PARTS, "loso", ["run data=nothing", "stress data=synth where='a == 1'"])
    assert reference.run_parts(["loso"], 3, tmp_path / "out") == ["run data=nothing"]
    times = pd.read_csv(tmp_path / "out" / "times.csv")
    assert times["status"].tolist() == [1, 0] and times["part"].tolist() == ["loso"] * 2
    text = (tmp_path / "out" / "loso-002.txt").read_text()
    assert text.split() == ["stress", "data=synth", "where=a", "==", "1", "jobs=3", f"out={tmp_path}/out/loso"]


def test_systems_stand_side_by_side_with_their_differences(tmp_path, monkeypatch):
    people = pd.Series([80.0, 60.0, 70.0, 90.0, 50.0]), pd.Series([70.0, 60.0, 50.0, 80.0, 40.0])

    def compared(system, other, **_):
        return Compared(system, other, "", pd.DataFrame({system: people[1], other: people[0]}))

    monkeypatch.setattr(bench, "results", lambda **_: pd.DataFrame({"system": ["reflex", "lda"]}))
    monkeypatch.setattr(bench, "compare", compared)
    table = reference.side_by_side(("one",))
    # means 70 and 60; t(0.975, 4) = 2.7764; SD 15.81 of both, 7.07 of the differences: halves 19.63 and 8.78
    assert table.loc["reflex"].tolist() == ["70.0 [50.4, 89.6]", "1", ""]
    assert table.loc["lda"].tolist() == ["60.0 [40.4, 79.6]", "2", "-10.0 [-18.8, -1.2]"]


def test_the_newest_complete_run_of_each_system_is_shown(monkeypatch):
    rows = [  # started, data, status, losses under two faults
        (2, "haart", "FINISHED", 0.2, 0.4),
        (1, "haart", "FINISHED", 0.9, 0.9),
        (3, "haart", "FAILED", 0.5, 0.5),
        (4, "haart+cuddlebot", "FINISHED", 0.5, 0.5),  # a learning curve
    ]
    runs = [
        result(
            "lda",
            metrics={"loss.noise": noise, "loss.shift": shift},
            faults="noise, shift",
            failed=int(status == "FAILED"),
            data=data,
            started=started,
        )
        for started, data, status, noise, shift in rows
    ]
    monkeypatch.setattr(reference, "connect", lambda: None)
    monkeypatch.setattr(reference, "every_result", lambda _: runs)
    table = reference.other_tests()
    assert len(table) == 1 and table.loc[("haart", "loso", "lda"), "lost under faults"] == 30.0
