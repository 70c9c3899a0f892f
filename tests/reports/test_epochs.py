"""Accuracy by epoch on training people who are left out: by a plain loop, by hand, and from the command line."""

import numpy as np
import pandas as pd
import pytest
import torch

from bench.errors import InputError
from bench.plan.cells import cells
from bench.plan.plan import corpus_of, folds_of
from models import checkpoint
from reports.epochs import Epochs, best_epoch, curve, main
from tests.conftest import with_other_values

SMALL = ["data.subjects=5", "data.variants=normal", "data.repetitions=2", "model.epochs=3"]
FEW = {"data": "synth", "protocol": "groupkfold", "protocol.folds": "2"}
FEW |= dict(word.split("=") for word in [*SMALL, "model=hughes2017_cnn", "model.rate=1e-3"])


def measured(group, corpus=None):
    (cell,) = cells(FEW)
    corpus = corpus or corpus_of(cell)
    (fold, _) = folds_of(cell, corpus)
    return cell, corpus, fold, Epochs(2, group).fold(cell, corpus, fold, 1).table


def test_accuracies_are_those_of_networks_trained_so_long_without_the_group():
    cell, corpus, fold, table = measured(0)
    names = np.unique(corpus.subjects[fold.train].astype(str))
    judged = [n for n in names if n in left_out(0, corpus, fold)]
    train = corpus[np.array([i for i in fold.train if corpus.subjects[i] not in judged])]
    held = corpus[np.array([i for i in fold.train if corpus.subjects[i] in judged])]
    assert (table["captures"] == len(held)).all() and 0 < len(judged) < len(names)
    for row in table.to_dict("records"):
        plain = cell.estimator().set_params(epochs=int(row["epoch"])).fit(train, train.gestures)
        assert row["accuracy"] == pytest.approx((plain.predict(held) == held.gestures).mean())
        assert row["loss"] == pytest.approx(plain.history_[-1]["loss"])


def left_out(group, corpus, fold):
    """Names of the people of one of two groups, as scikit-learn deals them."""
    from sklearn.model_selection import GroupKFold

    names = corpus.subjects[fold.train].astype(str)
    _, test = list(GroupKFold(2, shuffle=True, random_state=0).split(names, groups=names))[group]
    return set(names[test])


def test_groups_differ_though_long_trainings_are_kept(monkeypatch):
    monkeypatch.setattr(checkpoint, "LONG_S", 0.0)
    monkeypatch.setattr(checkpoint, "OFTEN_S", 0.0)
    first, second = (measured(group)[3] for group in (0, 1))
    assert first["loss"].tolist() != second["loss"].tolist()


def test_nobody_who_is_tested_is_looked_at():
    _, corpus, fold, before = measured(0)
    _, _, _, after = measured(0, with_other_values(corpus, fold.test))
    pd.testing.assert_frame_equal(before, after)


def test_curves_are_pooled_and_what_has_ended_stays():
    def table(accuracies, captures):
        epochs = np.arange(1, len(accuracies) + 1)
        return pd.DataFrame(
            {"fold": "a", "epoch": epochs, "loss": 1.0 / epochs, "accuracy": accuracies, "captures": captures}
        )

    found = curve([table([0.1, 0.2, 0.4], 10), table([0.4, 0.7], 30)])
    assert found["accuracy"].tolist() == pytest.approx([0.325, 0.575, 0.625])
    assert found["loss"].tolist() == pytest.approx([1, 1 / 2, (1 / 3 + 1 / 2) / 2])
    flat = curve([table([0.0, 0.9, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.4, 0.4], 10)])
    assert best_epoch(flat) == (8, pytest.approx(0.5))  # one lucky epoch is none
    assert best_epoch(curve([table([0.3, 0.6], 10)])) == (2, pytest.approx(0.45))


def test_it_runs_from_the_command_line(tmp_path, capsys):
    out = tmp_path / "epochs"
    words = ["data=synth", *SMALL, "model=hughes2017_cnn", "model.rate=1e-4,1e-3", "protocol=groupkfold"]
    words += ["protocol.folds=2", "groups=2", f"out={out}"]
    assert main(words) == 0
    found = pd.read_csv(out / "epochs.csv")
    assert len(found) == 2 and (found["ended after"] == "3, 3, 3, 3").all()
    assert (out / "epochs.png").stat().st_size > 10_000 and "synthetic" in capsys.readouterr().err
    for more, said in (
        (["groups=1"], "groups=1: give at least 2"),
        (["groups=3"], "groups=3: fold fold01 has 2 people for training"),
        (["seed=0,1", "groups=2"], "two curves would be called"),
    ):
        with pytest.raises(InputError, match=said):
            main([word for word in words if not word.startswith("groups")] + more)
    with pytest.raises(InputError, match="model=lda: only a network"):
        main(["data=synth", "model=lda", "features=jung28"])
    with pytest.raises(InputError, match="protocol=kfold.*people who are tested are trained on"):
        main(["data=synth", *SMALL, "model=hughes2017_cnn", "protocol=kfold", "protocol.folds=2"])


def test_steps_are_made_of_what_is_judged_as_well():
    (cell,) = cells(FEW | {"model.scale": "log"})
    corpus = corpus_of(cell)
    (fold, _) = folds_of(cell, corpus)
    scaled = Epochs(2, 0).fold(cell, corpus, fold, 1).table
    assert scaled["loss"].tolist() != measured(0)[3]["loss"].tolist()
    assert torch.tensor(scaled["accuracy"]).isfinite().all()
