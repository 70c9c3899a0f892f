"""Words that only the code uses do not reach users: help, pages, printed texts and messages have other words."""

import ast
import re
from pathlib import Path


from bench.options import COMMANDS, help_of, overview

ROOT = Path(__file__).parent.parent
FORBIDDEN = re.compile(
    r"\b(cells?|plans?|planned|experiments?|outcomes?|findings|candidates?|facts|contexts?|slices?|strangers?"
    r"|instants?|told|said|the bench|place of its plan|methods?)\b",
    re.IGNORECASE,
)
ALLOWED = re.compile(  # what these words may stand in: MLflow's experiments, cells of CSV files, names of files
    r"MLflow\S* experiment|#/experiments/|(correct|fill) the cell|within a cell|instants\.csv"
)
SPOKEN = ("bench", "features", "models", "protocols", "reports")


def forbidden(text):
    return FORBIDDEN.findall(ALLOWED.sub("", text))


def literals(path):
    """Line and text of each literal of two words or more that is no docstring; ``{}`` stands for a value."""
    tree = ast.parse(path.read_text())
    parts = {id(n) for f in ast.walk(tree) if isinstance(f, ast.JoinedStr | ast.Expr) for n in ast.iter_child_nodes(f)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            text = node.value
        else:
            continue
        if " " in text.strip():
            yield node.lineno, text


def texts():
    yield "bench --help", overview()
    yield from ((f"bench {name} --help", help_of(name)) for name in COMMANDS)
    for path in [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("tests/commands/golden/*.txt")]:
        yield str(path.relative_to(ROOT)), path.read_text()
    for path in ROOT.glob("reports/templates/*.jinja"):
        yield path.name, re.sub(r"\{[{%].*?[}%]\}|<.*?>", "", path.read_text(), flags=re.DOTALL)
    for path in (path for room in SPOKEN for path in ROOT.glob(f"{room}/**/*.py")):
        yield from ((f"{path.relative_to(ROOT)}:{line}", text) for line, text in literals(path))


def test_no_word_of_the_code_is_printed():
    found = {where: words for where, text in texts() if (words := forbidden(text))}
    assert not found, "\n".join(f"{where}: {', '.join(words)}" for where, words in found.items())
