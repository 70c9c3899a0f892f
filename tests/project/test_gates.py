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
from tests.project.test_structure import module_files, nodes


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
    """Fewer captures of each class: printed, in a file, on the page, as candidate and budget."""
    plug(POINTS.replace("lost = example:LOST\n", ""), EXAMPLE, "example")
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)
    assert "each=" in command_help("run")
    assert all("max_each_loss=" in command_help(name) for name in ("choose", "report"))
    code, printed = done(["run", *SMALL, "model=tree,usual", "features=jung28", "each=2,1"])
    assert code == 0 and "Accuracy in percent by training captures of each class" in printed
    (store, stored_runs) = runs("cell")
    for run in stored_runs:
        labels = load_results(store)[0].tables["labels"]
        assert {*labels["circumstance"]} == {"", "each"} and {*labels["level"]} == {0, 1, 2}
        metrics, start = run.data.metrics, f"│ {run.data.tags['system']}"
        row = [line for line in printed.splitlines() if line.startswith(start)][-1]
        fewer = metrics["accuracy.each.1"], metrics["accuracy.each.2"]
        loss = metrics["accuracy"] - sum(fewer) / 2
        assert metrics["loss.each"] == pytest.approx(loss)
        assert f"{100 * loss:.1f}" in row and f"{100 * fewer[0]:.1f}" in row
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
    "bench/commands/declarations.py": {"under"},  # an option of bench stress
    "bench/commands/run.py": {"under"},  # bench stress is bench run with it
    "reports/layout.py": {"form"},  # of the output
}


def test_no_other_file_names_a_circumstance():
    root = Path(registry.__file__).parents[2]
    parts = registry.load_parts("circumstances").values()
    keys = {part.key for part in parts} - {"train_subjects"}  # a column of every table of labels
    modules = {part.__module__ for part in parts} | {p.view.partition(":")[0] for p in parts}
    found = {}
    for path in module_files().values():
        if {path.parent.name, path.stem} & {"circumstances", "views"}:
            continue  # which may name what they add
        constants = {
            node.value for node in nodes(path, ast.Constant) if isinstance(node.value, str)
        }
        imported = {node.module for node in nodes(path, ast.ImportFrom)}
        name = str(path.relative_to(root))
        here = (keys & constants) | (modules & imported) - {"bench.reports.views.base"}
        if here := here - NAMED.get(name, set()):
            found[name] = here
    assert found == {}


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
