"""Selection of columns, against a slow search with scikit-learn's discriminant analysis."""

from functools import cache

import numpy as np
import pytest
from sklearn.covariance import EmpiricalCovariance
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.model_selection import GroupKFold

from bench.features import selection


class Ridge(EmpiricalCovariance):
    def fit(self, X, y=None):
        covariance = np.cov(X.T, bias=True).reshape(X.shape[1], -1)
        self.covariance_ = covariance + 1e-3 * np.eye(X.shape[1])
        return self


def slow_hits(values, label, subject, columns):
    """Correctly classified captures when their group of subjects is left out."""
    hits, lda = 0, LinearDiscriminantAnalysis(solver="lsqr", covariance_estimator=Ridge())
    values = values[:, columns]
    for train, test in GroupKFold(min(5, len(set(subject)))).split(values, groups=subject):
        x = (values - values[train].mean(axis=0)) / values[train].std(axis=0)
        hits += (lda.fit(x[train], label[train]).predict(x[test]) == label[test]).sum()
    return hits


def slow_sffs(hits, columns, selected, floating=True):
    """The set that forward and backward steps find, and how many columns were removed again."""
    now, best, removed = (), {}, 0
    while len(now) < selected:
        now = max((tuple(sorted((*now, c))) for c in range(columns) if c not in now), key=hits)
        if hits(now) > hits(best.get(len(now), now)) or len(now) not in best:
            best[len(now)] = now
        while floating and len(now) > 2:
            smaller = max((tuple(c for c in now if c != out) for out in now), key=hits)
            if hits(smaller) <= hits(best[len(smaller)]):
                break
            now = best[len(smaller)] = smaller
            removed += 1
    return list(best[selected]), removed


def random_table(seed, captures=120, columns=8, classes=3, subjects=6):
    """A table whose columns are mixtures of each other, with labels and subjects."""
    rng = np.random.default_rng(seed)
    label, subject = np.arange(captures) % classes, rng.integers(0, subjects, captures).astype(str)
    values = rng.normal(size=(captures, columns)) + rng.normal(size=(classes, columns))[label] * 0.5
    mixed = values @ rng.normal(size=(columns, columns)) * 10.0 ** rng.integers(-3, 4, columns)
    return mixed, label, subject


@pytest.mark.parametrize("subjects", [2, 11])
def test_the_criterion_is_discriminant_analysis_left_out_by_subject(subjects):
    values, label, subject = random_table(1, subjects=subjects)
    label[np.flatnonzero(subject == "1")[::2]] = 3  # a class that nobody else has
    fold = selection.assign_folds(label, subject)
    assert len(np.unique(fold)) == min(subjects, 5)
    parts = [selection.Discriminant(values, label, fold != i) for i in np.unique(fold)]
    for size in (1, 2, 5):
        sets = np.array([np.random.default_rng(i).permutation(8)[:size] for i in range(10)])
        hits = sum(part.count_hits(sets) for part in parts)
        assert hits.tolist() == [slow_hits(values, label, subject, columns) for columns in sets]
        assert len(set(hits)) > 1


@pytest.mark.parametrize("seed", [0, 8])
def test_selection_equals_a_slow_search(seed, monkeypatch):
    values, label, subject = random_table(seed, captures=60, columns=7)
    hits = cache(lambda columns: slow_hits(values, label, subject, list(columns)))
    forward, _ = slow_sffs(hits, 7, 5, floating=False)
    floating, removed = slow_sffs(hits, 7, 5)
    assert selection.select_positions(values, label, subject, 5).tolist() == floating
    if seed:  # columns that later ones make useless are removed again
        assert removed and hits(tuple(floating)) > hits(tuple(forward))
    monkeypatch.setattr(selection, "MAX_STEPS_FACTOR", 0)  # no step is left for going back
    assert selection.select_positions(values, label, subject, 5).tolist() == forward
