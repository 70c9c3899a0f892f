"""Words: those that only the code uses reach no user; parameters have meanings; no sentence lacks a value."""

import ast
import re
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from bench.cli import main
from bench.grammar.help import classifier_names, command_help, describe_part, help_overview
from bench.grammar.options import command_options, load_commands
from bench.ground.registry import registered_parts
from bench.values.sentences import render_sentences, shorten_list
from tests.test_structure import modules

ROOT = Path(__file__).parent.parent
FORBIDDEN = re.compile(
    r"\b(cells?|plans?|experiments?|outcomes?|findings|candidates?|facts|contexts?|slices?|strangers?|instants?|told"
    r"|said|methods?|the bench|place of its plan)\b",
    re.IGNORECASE,
)
ALLOWED = re.compile(  # MLflow's tags and addresses, cells of CSV files, names of files, methods of classes
    r"touchbench\.cell|#/experiments/|(correct|fill) the cell|within a cell|instants\.csv|bench\.plans"
    r"|the experiment {} of|mlflow experiments|deleted experiment"
    r"|bench\.reading\.(choice|compare)|told apart|optional[ -]methods|attributes and methods"
    r"|the method and the precision"
)
REPLACED = {
    "single slices",
    "single slices under faults",
}  # stored names that are printed as others
LONGEST = 25  # words of a sentence


def forbidden(text):
    return FORBIDDEN.findall(ALLOWED.sub("", text))


def literals(path):
    """Line and text of each literal of two words or more that is no docstring; ``{}`` stands for a value."""
    tree = ast.parse(path.read_text())
    inner = {
        id(n)
        for f in ast.walk(tree)
        if isinstance(f, ast.JoinedStr | ast.Expr)
        for n in ast.iter_child_nodes(f)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = "".join(
                str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values
            )
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner
        ):
            text = node.value
        else:
            continue
        if " " in text.strip() and text not in REPLACED:
            yield node.lineno, text


def texts():
    """Place and text of everything that users read."""
    yield "bench --help", help_overview()
    yield from ((f"bench {name} --help", command_help(name)) for name in load_commands())
    pages = [
        path for path in ROOT.glob("docs/*.md") if path.name != "architecture.md"
    ]  # which is for contributors
    for path in [ROOT / "README.md", *pages, *ROOT.glob("tests/net/golden/[rs][tu]*/*.txt")]:
        yield path.name, path.read_text()
    for path in [*ROOT.glob("reports/templates/*.jinja"), *ROOT.glob("bench/*/templates/*.jinja")]:
        yield path.name, re.sub(r"\{[{%#].*?[}%#]\}|<.*?>", "", path.read_text(), flags=re.DOTALL)
    for room in ("bench", "features", "models", "protocols", "reports"):
        for path in ROOT.glob(f"{room}/**/*.py"):
            yield from ((f"{path.relative_to(ROOT)}:{line}", text) for line, text in literals(path))


def test_no_word_of_the_code_reaches_users():
    found = {where: words for where, text in texts() if (words := forbidden(text))}
    assert not found, "\n".join(f"{where}: {', '.join(words)}" for where, words in found.items())


def test_sentences_of_help_are_short():
    sentences = [
        s
        for command in load_commands().values()
        for s in re.split(r"[.:;] (?=[A-Za-z0-9])", command.text)
    ]
    sentences += [
        option.help for name in load_commands() for option in command_options(name).values()
    ]
    assert not [s for s in sentences if len(s.split()) > LONGEST]


@pytest.mark.parametrize("room", ["features", "models", "protocols"])
def test_every_parameter_of_every_part_has_a_meaning(room):
    for name in registered_parts(room):
        one = describe_part(room, name)
        assert one.summary and [f"{name}.{p.name}" for p in one.parameters if not p.meaning] == []


def test_every_default_of_a_classifier_has_an_origin():
    assert {"bayes", "svm", "xgb"} <= {*classifier_names()} and not {
        "reflex",
        "cnn85",
        "jung2014_svm",
    } & {*classifier_names()}
    for name in classifier_names():
        assert [
            f"{name}.{p.name}" for p in describe_part("models", name).parameters if not p.source
        ] in (
            [],
            [f"{name}.seed"],
        )


def test_help_prints_the_parameters_of_the_parts_that_are_named(capsys):
    assert main(["run", "features=jung28,touch", "model=svm", "data=haart", "--help"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert out.index("features=jung28:") < out.index("features=touch:") < out.index("model=svm:")
    for fact in (
        "model.C= penalty; default 512 (a point of the grid",
        "features.area=",
        "no parameters",
    ):
        assert fact in out
    assert main(["run", "model=smv", "--help"]) == 2
    assert capsys.readouterr().err.startswith("bench: model=smv: unknown; did you mean svm?")


def test_a_forgotten_value_is_an_error():
    with pytest.raises(UndefinedError, match="mixed"):
        render_sentences("bench.reading", "choice", "scope", chosen={}, few="")
    assert shorten_list(["a", "b", "c"], 2) == "a; b; and 1 more" and shorten_list(["a"], 2) == "a"


def test_every_block_of_a_template_is_used_and_every_used_one_exists():
    """Blocks by package and template, as the source calls them."""
    used, there = set(), set()
    for path in modules().values():
        source = path.read_text()
        used |= {*re.findall(r'"(bench\.\w+)",\s*"(\w+)",\s*"(\w+)"', source)}
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "said":
                used |= {("bench.reading", "choice", block) for block in node.args[0].value.split()}
        for template in (path.parent / "templates").glob("*.jinja"):
            package = f"bench.{path.parent.name}"
            there |= {
                (package, template.stem, name)
                for name in re.findall(r"{% block (\w+) %}", template.read_text())
            }
    assert used == there != set()
