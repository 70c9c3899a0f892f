"""Sentences from templates: paragraphs as lines, no value forgotten, no block unused."""

import ast
import re

import pytest
from jinja2 import UndefinedError

from bench.sentences import sentences, shortened
from tests.test_structure import modules


def test_an_empty_line_ends_a_paragraph_and_a_forgotten_value_is_an_error():
    words = {"chosen": {}, "few": "3 subjects: too few for an interval", "mixed": "Mixed."}
    lines = ["3 subjects: too few for an interval. The order may differ for other people.", "Mixed."]
    assert sentences("bench.outcomes", "choice", "scope", **words) == lines
    assert sentences("bench.outcomes", "choice", "scope", chosen={}, few="", mixed="") == []
    with pytest.raises(UndefinedError, match="mixed"):
        sentences("bench.outcomes", "choice", "scope", chosen={}, few="")
    command = "bench stress 'where=gesture  !=  ''\n'"
    lacking = {"lacking": {"The loss": [command]}, "shown": 1}
    assert sentences("bench.outcomes", "choice", "lacking", **lacking) == [
        f"The loss is not stored. To measure it: {command}."
    ]
    assert shortened(["a", "b", "c"], 2) == "a; b; and 1 more" and shortened(["a"], 2) == "a"


def test_every_block_of_a_template_is_used_and_every_used_one_exists():
    """Blocks by package and template, as the source calls them."""
    used, there = set(), set()
    for path in modules().values():
        source = path.read_text()
        used |= {*re.findall(r'"(bench\.\w+)",\s*"(\w+)",\s*"(\w+)"', source)}
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "said":
                used |= {("bench.outcomes", "choice", block) for block in node.args[0].value.split()}
        for template in (path.parent / "templates").glob("*.jinja"):
            package = f"bench.{path.parent.name}"
            there |= {(package, template.stem, name) for name in re.findall(r"{% block (\w+) %}", template.read_text())}
    assert used == there != set()
