"""Words that only the code uses do not reach users: not in help, pages, printed texts and messages."""

import ast
import re
from pathlib import Path

from bench.described import help_of, overview
from bench.options import commands, options

ROOT = Path(__file__).parent.parent
FORBIDDEN = re.compile(
    r"\b(cells?|plans?|experiments?|outcomes?|findings|candidates?|facts|contexts?|slices?|strangers?|instants?|told"
    r"|said|methods?|the bench|place of its plan)\b",
    re.IGNORECASE,
)
ALLOWED = re.compile(  # MLflow's tags and addresses, cells of CSV files, names of files, methods of classes
    r"touchbench\.cell|#/experiments/|(correct|fill) the cell|within a cell|instants\.csv|bench\.plans"
    r"|the experiment {} of|mlflow experiments|deleted experiment"
    r"|bench\.outcomes\.(choice|compare)|told apart|optional[ -]methods|attributes and methods"
    r"|the method and the precision"
)
REPLACED = {"single slices", "single slices under faults"}  # stored names that are printed as others
LONGEST = 25  # words of a sentence


def forbidden(text):
    return FORBIDDEN.findall(ALLOWED.sub("", text))


def literals(path):
    """Line and text of each literal of two words or more that is no docstring; ``{}`` stands for a value."""
    tree = ast.parse(path.read_text())
    inner = {id(n) for f in ast.walk(tree) if isinstance(f, ast.JoinedStr | ast.Expr) for n in ast.iter_child_nodes(f)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            text = node.value
        else:
            continue
        if " " in text.strip() and text not in REPLACED:
            yield node.lineno, text


def texts():
    """Place and text of everything that users read."""
    yield "bench --help", overview()
    yield from ((f"bench {name} --help", help_of(name)) for name in commands())
    pages = [path for path in ROOT.glob("docs/*.md") if path.name != "architecture.md"]  # which is for contributors
    for path in [ROOT / "README.md", *pages, *ROOT.glob("tests/net/golden/[rs][tu]*/*.txt")]:
        yield path.name, path.read_text()
    for path in [*ROOT.glob("reports/templates/*.jinja"), *ROOT.glob("bench/*/templates/*.jinja")]:
        yield path.name, re.sub(r"\{[{%].*?[}%]\}|<.*?>", "", path.read_text(), flags=re.DOTALL)
    for room in ("bench", "features", "models", "protocols", "reports"):
        for path in ROOT.glob(f"{room}/**/*.py"):
            yield from ((f"{path.relative_to(ROOT)}:{line}", text) for line, text in literals(path))


def test_no_word_of_the_code_reaches_users():
    found = {where: words for where, text in texts() if (words := forbidden(text))}
    assert not found, "\n".join(f"{where}: {', '.join(words)}" for where, words in found.items())


def test_sentences_of_help_are_short():
    sentences = [s for command in commands().values() for s in re.split(r"[.:;] (?=[A-Za-z0-9])", command.text)]
    sentences += [option.help for name in commands() for option in options(name).values()]
    assert not [s for s in sentences if len(s.split()) > LONGEST]
