"""Fixtures of the tests of streams: few measurements of watching."""

import pytest

from addons.chip.tests.test_chip import costs  # noqa: F401
from addons.streams.tests.people import FEW
from tests.reports.conftest import quick  # noqa: F401


@pytest.fixture(scope="session", autouse=True)
def folder_of_modules(tmp_path_factory):
    """Fixtures of a module do not keep detectors in the user's data folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TOUCHBENCH_HOME", str(tmp_path_factory.mktemp("home")))
        yield


@pytest.fixture
def few_gestures(monkeypatch):
    """Generated recordings have a few gestures, so they are short."""
    monkeypatch.setattr("touchbench_streams.synth_recordings.GESTURES", FEW)


@pytest.fixture(autouse=True)
def few_decisions(monkeypatch):
    """Folds time and repeat few decisions."""
    monkeypatch.setattr("touchbench_streams.fold.TIMED_CAPTURES", 3)
