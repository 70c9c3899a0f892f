"""What tests of add-ons share: the fixtures of the core's tests, with all add-ons that are installed."""

from tests.conftest import *  # noqa: F403
from tests.conftest import without_numba


def pytest_configure(config):
    """As of the core's tests, but nothing is hidden."""
    without_numba(config)
