"""The recipes of docs/notes/architecture.md do what the page says: each is installed as a package and run."""

import re
from pathlib import Path

import pytest

from bench.cli import main
from tests.conftest import SMALL

PAGE = Path(__file__).parents[1] / "docs/notes/architecture.md"
RECIPES = {
    file: (source, points)
    for file, source, points in re.findall(
        r"```python\n# recipe: (\w+)\.py\n(.*?)```\n\n```ini\n(.*?)```", PAGE.read_text(), re.DOTALL
    )
}


def test_the_page_has_two_recipes():
    assert [*RECIPES] == ["louder", "guess"]


@pytest.mark.parametrize(
    ("file", "command", "words"),
    [
        ("louder", ["run", "model=bayes", "features=jung28", "louder=2,4"], ["2 times the pressure", "mean loss"]),
        (
            "guess",
            ["guess", "model=bayes", "features=jung28", "first=3"],
            ["in these classes", "most frequent"],
        ),
    ],
)
def test_a_recipe_runs(file, command, words, plug, capsys):
    source, points = RECIPES[file]
    plug(points, source, file)
    assert main([*command, *SMALL]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert [w for w in words if w not in printed] == []
