"""The project's own gate: its systems on the embedded corpus are what reports/baseline.json says."""

from pathlib import Path

import pytest

from bench.cli import main
from bench.outcomes.baseline import read

BASELINE = Path(__file__).parents[2] / "reports" / "baseline.json"


@pytest.mark.live
@pytest.mark.pool
def test_the_systems_are_what_the_baseline_says(capsys):
    """Labels and size; of computing time only what no difference between machines explains."""
    code = main(["check", f"baseline={BASELINE}", "slower=10"])
    assert code == 0, capsys.readouterr().out
    assert all(measured.synthetic for measured in read(BASELINE))
