"""What tests of the report share."""

from pathlib import Path

import pytest


@pytest.fixture
def quick(monkeypatch):
    """Figures are made, but nothing is drawn: most of the time would go there."""
    monkeypatch.setattr(
        "matplotlib.figure.Figure.savefig", lambda self, path, **_: Path(path).write_text("<svg/>")
    )
