"""Words that only the code uses reach no user; no sentence lacks a value."""

import ast
import re
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from bench.grammar.help import command_help, help_overview
from bench.grammar.options import load_commands
from bench.values.sentences import render_sentences, shorten_list
from tests.project.test_structure import module_files, nodes

ROOT = Path(__file__).parents[2]
FORBIDDEN = re.compile(
    r"\b(cells?|plans?|experiments?|outcomes?|findings|candidates?|facts|contexts?|slices?"
    r"|strangers?|instants?|told|said|methods?|the bench|place of its plan)\b",
    re.IGNORECASE,
)
# MLflow's tags and addresses, cells of CSV files, names of files, methods of classes
ALLOWED = re.compile(
    r"touchbench\.cell|#/experiments/|(correct|fill) the cell|within a cell|(instants|slices)\.csv"
    r"|bench\.plans|the experiment {} of|mlflow experiments|deleted experiment"
    r"|bench\.reading\.(choice|compare)|told apart|optional[ -]methods|attributes and methods"
    r"|the method and the precision|slices="
)
REPLACED = {"single slices", "single slices under faults"}  # stored names, printed as others


def literals(path):
    """Line and text of each literal of several words but docstrings; ``{}`` is a value."""
    tree = ast.parse(path.read_text())
    within = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr | ast.Expr):
            within |= {id(child) for child in ast.iter_child_nodes(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [getattr(part, "value", "{}") for part in node.values]
            text = "".join(part if isinstance(part, str) else "{}" for part in parts)
        elif isinstance(node, ast.Constant) and id(node) not in within:
            text = node.value if isinstance(node.value, str) else ""
        else:
            continue
        if " " in text.strip() and text not in REPLACED:
            yield node.lineno, text


def texts():
    """Place and text of everything that users read."""
    yield "bench --help", help_overview()
    yield from ((f"bench {name} --help", command_help(name)) for name in load_commands())
    pages = {*ROOT.glob("docs/*.md")} - {ROOT / "docs/architecture.md"}  # which is for contributors
    for path in [ROOT / "README.md", *pages, *ROOT.glob("tests/net/golden/[rs][tu]*/*.txt")]:
        yield path.name, path.read_text()
    for path in [*ROOT.glob("reports/templates/*.jinja"), *ROOT.glob("bench/*/templates/*.jinja")]:
        yield path.name, re.sub(r"\{[{%#].*?[}%#]\}|<.*?>", "", path.read_text(), flags=re.DOTALL)
    for module, path in module_files().items():
        yield from ((f"{module}:{line}", text) for line, text in literals(path))


def test_no_word_of_the_code_reaches_users():
    found = {}
    for place, text in texts():
        if words := FORBIDDEN.findall(ALLOWED.sub("", text)):
            found[place] = words
    assert found == {}


def test_a_missing_value_is_an_error():
    with pytest.raises(UndefinedError, match="mixed"):
        render_sentences("bench.reading", "choice", "scope", chosen={}, few="")
    assert shorten_list(["a", "b", "c"], 2) == "a; b; and 1 more" and shorten_list(["a"], 2) == "a"


def test_every_block_of_a_template_is_used_and_every_used_one_exists():
    """Blocks by package and template, as the source calls them."""
    used, present = set(), set()
    for path in module_files().values():
        used |= {*re.findall(r'"(bench\.\w+)",\s*"(\w+)",\s*"(\w+)"', path.read_text())}
        for template in (path.parent / "templates").glob("*.jinja"):
            blocks = re.findall(r"{% block (\w+) %}", template.read_text())
            present |= {(f"bench.{path.parent.name}", template.stem, name) for name in blocks}
    choice = nodes(ROOT / "bench/reading/choice.py", ast.Constant)  # names several blocks in a text
    words = {word for node in choice for word in str(node.value).split()}
    used |= {block for block in present if block[1] == "choice" and block[2] in words}
    assert used == present != set()
