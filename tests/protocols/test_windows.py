"""The protocol of windows: its folds, scores of captures, and checks."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import StratifiedKFold

from bench.corpora.windows import Windows
from bench.errors import InputError
from bench.plan.grid import make_cells
from bench.plan.plan import Fold, make_plans
from bench.protocols.windows import WindowKFold
from bench.running.circumstances.faults import Faults
from bench.running.evaluation import fit_and_predict
from bench.values import scores
from tests.conftest import SMALL, random_corpus
from tests.running.fakes import Level, fake_cell


@given(seed=st.integers(0, 500), frames=st.integers(2, 12), hop=st.integers(1, 6))
def test_windows_of_all_captures_are_dealt_as_scikit_learn_does(seed, frames, hop):
    """Windows are those of `bench.corpora.windows.Windows`, whose test has a loop."""
    corpus = random_corpus(seed=seed, grid=(1, 2))
    protocol = WindowKFold(frames / corpus.rate_hz, hop / corpus.rate_hz, folds=3, seed=seed)
    windows = protocol.joined(corpus)
    assert windows.steps == (Windows(frames / corpus.rate_hz, hop / corpus.rate_hz),)
    y = corpus.gestures[windows.index]
    theirs = StratifiedKFold(3, shuffle=True, random_state=seed).split(y, y)
    for (train, test, parts), (learnt, tested) in zip(protocol.split(windows), theirs, strict=True):
        assert np.array_equal(train, learnt) and np.array_equal(test, tested)
        assert sorted(i for _, part in parts for i in part) == list(test)
        assert all(
            not len(more) and len(set(windows.index[part])) == len(part) for more, part in parts
        )


class Batch(Level):
    """Measures pressure from the mean of the windows that it is given together."""

    def measure_levels(self, X):
        return super().measure_levels(X) - super().measure_levels(X).mean()


def folds_of(system, protocol):
    """All windows of 24 captures, and all folds of a system."""
    windows = protocol.joined(random_corpus(per_class=2, longest=60))
    folds = [Fold(f"fold{i:02d}", *split) for i, split in enumerate(protocol.split(windows))]
    return windows, [fit_and_predict(fake_cell(system), windows, fold, 1)[1] for fold in folds]


def test_a_capture_is_scored_once_by_all_its_windows():
    windows, folds = folds_of(Level, WindowKFold(0.1, 0.05, folds=3))
    assert not [effect for fold in folds for effect in fold.batch_effects]
    table = pd.concat([fold.table for fold in folds])
    rows = sorted(zip(table["capture"], table["start"], table["frames"], strict=True))
    assert rows == sorted(zip(windows.index, windows.piece, windows.lengths, strict=True))
    labelled = scores.label_captures(table).set_index("capture")["predicted"]
    assert sorted(labelled.index) == list(range(24))
    for capture, label in labelled.items():
        proba = table.loc[table["capture"] == capture, ["p_pat", "p_rub", "p_tap"]].to_numpy()
        assert ["pat", "rub", "tap"][np.mean(proba, axis=0).argmax()] == label


def test_a_window_whose_label_depends_on_others_is_found():
    assert all(fold.batch_effects for fold in folds_of(Batch, WindowKFold(0.1, folds=3))[1])


def test_rows_say_that_the_protocol_is_optimistic_and_faults_are_refused():
    typed = dict(word.split("=") for word in SMALL[:-1])
    typed |= {"protocol": "windows", "protocol.folds": "3", "model": "lda", "features": "jung28"}
    (plan,) = make_plans(make_cells(typed), 1)
    assert plan.label == "3-fold of 1 s windows, optimistic: subjects mixed, captures mixed"
    assert plan.mixes_subjects and plan.facts["test_over_train"]
    with pytest.raises(
        InputError, match="protocol=windows.* tests windows, not captures; leave under= out"
    ):
        make_plans([replace(plan.cell, circumstances=(Faults(("noise",)),))], 1)
    with pytest.raises(InputError, match=r"protocol\.seconds=0: .* above 0"):
        make_plans(make_cells(typed | {"protocol.seconds": "0"}), 1)
