"""A function from captures to rows as a feature set."""

from pathlib import Path

import pytest

from bench.cli import main
from tests.conftest import SMALL


@pytest.mark.parametrize(("captures", "code"), [("X", 0), ("X[:1]", 1)])
def test_it_needs_a_row_for_each_capture(captures, code, capsys):
    function = (
        f"def peaks(X, power=1):\n    return [[c.max() ** power, c.mean()] for c in {captures}]\n"
    )
    Path("feat.py").write_text(function)
    words = ["model=bayes", "features=feat.py:peaks", "features.power=2"]
    assert main(["run", *SMALL, *words]) == code
    output = "".join(capsys.readouterr())
    assert "peaks[power=2]" in output and ("1 rows for" in output) == bool(code)
