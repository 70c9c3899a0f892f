"""Gates of the design: what is added is one file and an entry."""

import ast
import contextlib
import io
from pathlib import Path

import pandas as pd
import pytest

import bench
from bench.cli import main
from bench.grammar.help import command_help, help_overview
from bench.ground import registry
from bench.reading.runs import load_results
from tests.conftest import SMALL, runs


def done(arguments):
    """Exit code and output of a command."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        return main(arguments), out.getvalue()


EXAMPLE = (Path(__file__).parents[1] / "plugged" / "example.py").read_text()
POINTS = """
[touchbench.models]
usual = example:usual
[touchbench.circumstances]
each = example:Fewer
[touchbench.commands]
count = example:COUNT
lost = example:LOST
fit loud = example:LOUD
predict loud = example:LOUD
"""


def page_has(*words):
    page = Path("report/index.html").read_text()
    assert [w for w in words if w not in page] == []


def test_a_new_circumstance_is_one_file_and_appears_everywhere(plug, monkeypatch):
    """Fewer captures of each class: printed, in a CSV file, on the page with a figure, a candidate, with a budget."""
    plug(POINTS.replace("lost = example:LOST\n", ""), EXAMPLE, "example")
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)
    assert (
        "each=" in command_help("run")
        and "max_each_loss=" in command_help("choose")
        and "max_each_loss=" in command_help("report")
    )
    code, printed = done(["run", *SMALL, "model=tree,usual", "features=jung28", "each=2,1"])
    assert code == 0 and "Accuracy in percent by training captures of each class" in printed
    (store, stored_runs) = runs("cell")
    for run in stored_runs:
        labels = load_results(store)[0].tables["labels"]
        assert {*labels["circumstance"]} == {"", "each"} and {*labels["level"]} == {0, 1, 2}
        number = f"{100 * run.data.metrics['accuracy.each.1']:.1f}"
        row = [
            line for line in printed.splitlines() if line.startswith(f"│ {run.data.tags['system']}")
        ][-1]
        loss = (
            run.data.metrics["accuracy"]
            - (run.data.metrics["accuracy.each.1"] + run.data.metrics["accuracy.each.2"]) / 2
        )
        assert (
            run.data.metrics["loss.each"] == pytest.approx(loss)
            and f"{100 * loss:.1f}" in row
            and number in row
        )
    assert done(["run", *SMALL, "model=tree", "features=jung28", "each=0"])[0] == 2
    table = bench.choose(data="synth").table
    assert {"1 captures of each class", "2 captures of each class", "capture"} == {*table["unit"]}
    printed = done(["choose", "max_each_loss=0", "why=yes"])[1]
    assert "loss to few captures" in printed and done(["choose", "max_each_loss=100"])[0] == 0
    assert done(["report", "max_each_loss=100"])[0] == 0
    page_has("Accuracy in percent by training captures of each class", "max_each_loss=100")
    sheet = pd.read_csv("report/each.csv")
    assert {*sheet["system"]} == {"tree · jung28", "usual · jung28"} and {*sheet["level"]} == {1, 2}
    assert [*Path("report/figures").glob("*each*.svg")]


def test_a_wrong_circumstance_is_refused_where_it_is_used(plug, capsys):
    plug("[touchbench.circumstances]\ngone = no_such_module:Gone\n", "", "empty")
    assert main(["run", *SMALL, "model=tree", "features=jung28", "gone=1"]) == 2
    warning, error = capsys.readouterr().err.splitlines()
    assert warning.startswith(
        "warning: circumstance=gone cannot be loaded from no_such_module:Gone"
    )
    assert error.startswith("bench: no key is called 'gone'")


NAMED = {  # file: keys that it may have, with the reason
    "bench/grammar/options.py": {"under", "after"},  # commands and examples as a user types them
    "bench/commands/run.py": {"under"},  # bench stress is bench run with it
    "reports/layout.py": {"form"},  # of the output
}


def test_no_other_file_names_a_circumstance_or_a_study():
    root = Path(registry.__file__).parents[2]
    every = [*registry.load_parts("circumstances").values()]
    keys = {one.key for one in every} - {"train_subjects"}  # a column of every table of labels
    modules = {
        place.partition(":")[0] for one in every for place in (f"{one.__module__}:", one.view)
    }
    files = [
        p
        for name in ("bench", "reports", "models", "features", "protocols")
        for p in (root / name).rglob("*.py")
    ]
    found = {}
    for path in files:
        name = str(path.relative_to(root))
        if {path.parent.name, path.stem} & {"circumstances", "views"}:
            continue  # what they add they name
        tree = [*ast.walk(ast.parse(path.read_text()))]
        words = {
            node.value
            for node in tree
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        imported = {node.module for node in tree if isinstance(node, ast.ImportFrom)}
        if here := (keys & words) | (modules & imported) - {"bench.reports.views.base"}:
            found[name] = here - NAMED.get(name, set())
    assert {file: here for file, here in found.items() if here} == {}


def test_a_package_adds_a_command_and_a_key_of_others(plug):
    plug(POINTS, EXAMPLE, "example")
    assert done(["count", "data=anna"]) == (0, "4 letters\n") and done(["count", "seed=1"])[0] == 2
    assert (
        "data=" in command_help("count")
        and "least letters; default 1" in command_help("count")
        and "count" in help_overview()
    )
    assert "loud= " in command_help("fit") and "loud= " not in command_help("run")
    assert "lost" not in help_overview() and done(["lost"])[0] == 2
