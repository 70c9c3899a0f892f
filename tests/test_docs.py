"""Snippets of docs/your_system.md as they are written there."""

import re
from pathlib import Path

import pytest

from bench.cli import main
from tests.conftest import predictions, runs

PAGE = (Path(__file__).parent.parent / "docs" / "your_system.md").read_text()
SNIPPETS = dict(re.findall(r"```python\n# (\w+\.py)\n(.*?)```", PAGE, flags=re.DOTALL))
SMALL = ["data.subjects=3", "data.variants=normal", "data.repetitions=2"]


@pytest.mark.parametrize(
    "name", ["plain.py:discriminants", "with_aeon.py:minirocket", "with_sktime.py:neighbours", "with_torch.py:tiny"]
)
def test_an_adapter_is_less_than_five_lines_and_runs(name, capsys):
    file, _, factory = name.partition(":")
    body = SNIPPETS[file].split("def ")[1].strip().splitlines()
    assert len(body) < 5
    for package in re.findall(r"^from (aeon|sktime)", SNIPPETS[file], flags=re.MULTILINE):
        pytest.importorskip(package)
    Path(file).write_text(SNIPPETS[file])
    assert main(["run", f"model={name}", *SMALL]) == 0
    store, (run,) = runs("cell")
    table = predictions(store, run)
    assert run.data.tags["system"].startswith(factory) and len(table.groupby("capture")) == 3 * 14 * 2
    assert run.data.metrics["flash_bytes"] > 0 and run.data.metrics["ram_bytes"] > 0


def test_objects_are_run_as_written():
    names = {}
    exec(SNIPPETS["objects.py"], names)
    table = names["table"]
    assert table["system"].tolist() == ["bayes · jung54", "GaussianNB() · jung54"] and (table["folds"] == "2/2").all()
