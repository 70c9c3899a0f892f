"""Fixtures for the tests of add-ons; those of the core, by path."""

import pytest

from tests.conftest import *  # noqa: F403
from tests.conftest import without_numba
from tests.net import masks


def pytest_configure(config):
    """As of the core's tests, but nothing is hidden."""
    without_numba(config)


@pytest.fixture
def golden(request, tmp_path):
    """Compare a text with a golden file beside the test, or write it (``--golden``)."""

    def compared(name, text, form=masks.lines_of):
        path, text = request.path.parent / "golden" / name, form(text, (tmp_path / "net", tmp_path))
        if request.config.getoption("golden"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        assert text == path.read_text()

    return compared
