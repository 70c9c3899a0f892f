"""A function from captures to rows as a feature set."""

from pathlib import Path

import pytest

from bench.cli import main
from bench.ground.scratch import data_folder
from tests.conftest import SMALL


def run_features(body, *words, model="bayes"):
    """Exit code of a run of a feature function with this body."""
    Path("feat.py").write_text(
        f"import numpy as np, pandas as pd\ndef peaks(X, power=1):\n    {body}\n"
    )
    return main(["run", *SMALL, f"model={model}", "features=feat.py:peaks", *words])


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("return [[c.max(), c.mean()] for c in X[:1]]", "returns 1 rows for "),
        ("return [c.mean(axis=(1, 2)).tolist() for c in X]", "returns rows of "),
        ("return [['a', c.mean()] for c in X]", "returns 'a' as feature 0; give numbers"),
        ("return np.zeros((len(X), 2, 2))", "returns an array of shape ("),
        ("return pd.DataFrame(np.ones((len(X), 2)), columns=['a', 'a'])", "named 'a'; rename one"),
        ("return [[c.mean(), np.nan] for c in X]", "feature 1 is NaN for a capture of every class"),
        ("return [[1 / 0] for c in X]", "it raises ZeroDivisionError: division by zero"),
        ("return [[len(X.gestures)] for c in X]", "X.gestures is hidden"),
    ],
)
def test_it_gives_a_row_of_numbers_for_each_capture_or_is_refused_before_the_first_fold(
    body, words, capsys
):
    assert run_features(body) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("bench: features=peaks") and words in line


def test_its_table_is_stored_by_its_source_and_parameters(monkeypatch, capsys):
    """Folds and models share it, so the time of a fit has no extraction; an edit makes another."""
    count = "with open('calls', 'a') as calls: calls.write('x' * len(X))"
    body = f"{count}\n    return [[c.max() ** power, c.mean()] for c in X]"
    assert run_features(body, "features.power=2") == 0
    assert "peaks[power=2]" in capsys.readouterr().out
    tables = {*data_folder().glob("features/*.parquet")}
    first = len(Path("calls").read_text())
    assert run_features(body, "features.power=2", model="lda") == 0
    # The captures of one class each that are tried, and those that are predicted alone
    assert len(Path("calls").read_text()) - first < first
    assert {*data_folder().glob("features/*.parquet")} == tables and len(tables) == 1
    run_features(body, "features.power=3")
    run_features(body.replace("mean", "min"), "features.power=3")
    assert len([*data_folder().glob("features/*.parquet")]) == 3
