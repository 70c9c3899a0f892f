"""Entries of docstrings start with a noun, not with "what", "whether" or "of"."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("bench", "features", "models", "protocols", "reports")
VAGUE = {"what", "whether", "how", "which", "of", "as", "where", "that", "from"}
SECTION = re.compile(r"^(Args|Attributes):\n((?: +.*\n?|\n)+)", re.MULTILINE)
ENTRY = re.compile(r"^ {4}([^\s:][^:\n]*): *([A-Za-z]+)", re.MULTILINE)


def documented(node: ast.AST, name: str = "") -> list[tuple[str, str]]:
    """Dotted name and docstring of each public class and function of a module, and of the module."""
    found = [(name, ast.get_docstring(node) or "")]
    for part in getattr(node, "body", []):
        if isinstance(part, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and not re.match("_[^_]", part.name):
            found += documented(part, f"{name}.{part.name}".lstrip("."))
    return found


def vague(text: str) -> list[str]:
    """Names of the arguments and attributes whose description starts with a word of `VAGUE`."""
    entries = [entry for section in SECTION.finditer(text) for entry in ENTRY.findall(section[2])]
    return [argument for argument, word in entries if word.lower() in VAGUE]


def test_the_check_finds_vague_entries_only():
    text = "Fit.\n\nArgs:\n    a: of X.\n    b, c: How,\n        d: of it.\n    e: seed.\n\nRaises:\n    f: of Z.\n"
    assert vague(text) == ["a", "b, c"]


@pytest.mark.parametrize("room", ROOMS)
def test_entries_start_with_a_noun(room):
    paths = sorted((ROOT / room).rglob("*.py"))
    assert paths
    texts = {(str(path.relative_to(ROOT)), *one) for path in paths for one in documented(ast.parse(path.read_text()))}
    assert [f"{path} {name}: {entry}" for path, name, text in sorted(texts) for entry in vague(text)] == []
