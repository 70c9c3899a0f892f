"""What the README and the pages of docs/ promise, as it is written there."""

import inspect
import itertools
import json
import os
import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import bench
from bench import contract
from bench.cli import main
from bench.grammar.options import key_options, load_commands, parse_arguments
from bench.ground.registry import views_of_circumstances
from bench.reading.runs import load_results
from bench.store.client import connect
from bench.values.columns import run_columns
from bench.values.measures import to_percent
from bench.values.result import FOLD_COUNTS
from tests.conftest import predictions, runs

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
DOCS = {path.name: path.read_text() for path in (ROOT / "docs").glob("*.md")}
PAGES = sorted((ROOT / "docs").rglob("*.md"))
ADDED = set(
    "bits clock cluster form max_cycles max_false_alarms max_latency watch".split()
)  # keys of add-ons
SMALL = ["data.subjects=3", "data.variants=normal", "data.repetitions=1"]
OWN = dict(re.findall(r"```python\n# (\w+\.py)\n(.*?)```", DOCS["your_system.md"], flags=re.DOTALL))
LEVEL = OWN["my.py"]


def test_every_command_is_introduced_and_every_command_line_is_taken():
    """The parser reads the commands of README and docs, with `NAME=` and `...` as they are."""
    texts = [README, *(path.read_text() for path in PAGES)]
    for command in load_commands():
        assert any(f"bench {command}" in text for text in texts), command
    lines = [
        line
        for text in texts
        for line in re.findall(r"^ *bench (.+)|`bench ([^`\n]+)`", text, re.MULTILINE)
    ]
    checked = 0
    for line in filter(None, itertools.chain(*lines)):
        try:
            command, *words = shlex.split(re.split(r" [|<>] | \|\|", line)[0], comments=True)
        except ValueError:  # a quotation that goes on in prose
            continue
        if command in load_commands() and command != "data" and "--help" not in words:
            values = [
                f"{word}1" if word.endswith("=") else word
                for word in words
                if "=" in word and "<" not in word
            ]
            if not ADDED & {value.partition("=")[0] for value in values}:
                checked += len(parse_arguments(values, key_options(command)))
    assert checked > 150


def test_a_recogniser_of_ones_own_runs_from_its_file_with_its_sizes():
    Path("my.py").write_text(LEVEL)
    assert main(["run", "model=my.py:Level", "model.power=0.5", *SMALL]) == 0
    _, (level,) = runs("cell")
    assert level.data.tags["system"] == "Level[power=0.5]"
    corpus = bench.corpus("synth", subjects=3, variants=("normal",), repetitions=1)
    assert level.data.metrics["flash_bytes"] == 4 * 14  # a mean per class
    assert level.data.metrics["ram_bytes"] == 4 * (64 * corpus.lengths.max() + 14)
    # it has no probabilities, and can be searched all the same
    assert main(["tune", "model=my.py:Level", "model.power=0.5,2", "inner=2", *SMALL]) == 0
    assert main(["fit", "model=my.py:Level", "out=saved", "stopping=no", *SMALL]) == 0
    Path("my.py").unlink()  # the model has it inside
    saved = "mlflow.pyfunc.load_model('saved').unwrap_python_model()"
    command = [sys.executable, "-c", f"import mlflow; print({saved}.estimator)"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "Level()"


def test_every_name_of_the_contract_is_on_the_page_of_ones_own_system():
    methods = [value for value in vars(contract).values() if isinstance(value, contract.Method)]
    attributes = re.findall(r'getattr\(\w+, "(\w+)"', inspect.getsource(contract))
    names = {*attributes, *(method.name for method in methods)} - {"__name__", "features"}
    assert len(names) > 20
    assert not [name for name in names if f"`{name}" not in DOCS["your_system.md"]]


@pytest.mark.parametrize(
    "name",
    [
        "plain.py:discriminants",
        "with_aeon.py:minirocket",
        "with_sktime.py:neighbours",
        "with_torch.py:tiny",
    ],
)
def test_an_adapter_is_less_than_five_lines_and_runs(name, capsys):
    file, _, factory = name.partition(":")
    body = OWN[file].split("def ")[1].strip().splitlines()
    assert len(body) < 5
    for package in re.findall(r"^from (aeon|sktime)", OWN[file], flags=re.MULTILINE):
        pytest.importorskip(package)
    Path(file).write_text(OWN[file])
    assert main(["run", f"model={name}", *SMALL]) == 0
    store, (run,) = runs("cell")
    table = predictions(store, run)
    assert run.data.tags["system"].startswith(factory) and len(table.groupby("capture")) == 3 * 14
    assert run.data.metrics["flash_bytes"] > 0 and run.data.metrics["ram_bytes"] > 0


def tracked():
    """Each number of a run in MLflow: its name, unit and meaning."""
    named = {
        "seconds": "s",
        "ms": "ms",
        "bytes": "bytes",
        "slowdown": "factor",
        "relative": "factor",
    }
    for one in (measure for measure in run_columns() if measure.meaning):
        units = [named[word] for word in one.source_name.split("_") if word in named]
        yield (
            one.source_name,
            "share" if one.scale is to_percent else units[0] if units else "number",
            one.meaning,
        )


def test_the_page_of_the_store_has_every_number_of_a_run_with_unit_and_meaning(in_net):
    rows = re.findall(r"^\| `(\w+)` \| (.+?) \| (.+) \|$", DOCS["store.md"], flags=re.MULTILINE)
    assert rows == [*tracked()]
    plain = [
        r
        for r in load_results(connect())
        if not any(view.applies_to(r) for view in views_of_circumstances())
    ]
    assert any("windows" in r for r in plain)
    variant = re.compile("^(vote|window)_|(?<=accuracy)_(low|high)$|_p(50|95|99)$")
    names = {variant.sub("", name) for r in plain for name in r.metrics}
    assert {"abstained"} | names - {*FOLD_COUNTS} == {variant.sub("", name) for name, *_ in rows}


@pytest.mark.live
@pytest.mark.skipif(find_spec("mkdocs") is None, reason="needs the extra docs")
@pytest.mark.parametrize(
    "variables", [{"PAGES": "index.md,your_data.md"}, pytest.param({}, marks=pytest.mark.nightly)]
)
def test_the_site_is_built_with_examples_run(tmp_path, variables):
    """MkDocs runs examples of some pages or all; warnings, such as dead links, are errors."""
    out, variables = tmp_path / "site", os.environ | {"PYTHONPATH": str(ROOT)} | variables
    variables.pop("TOUCHBENCH_HOME")
    site = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(out)]
    done = subprocess.run(site, cwd=ROOT, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {page.relative_to(out).as_posix(): page.read_text() for page in out.rglob("*.html")}
    assert {p.relative_to(ROOT / "docs").with_suffix(".html").as_posix() for p in PAGES} < set(
        pages
    )
    loaded = [
        page
        for page, text in pages.items()
        if 'src="http' in text or 'rel="stylesheet" href="http' in text
    ]
    assert not loaded, "pages that load something from elsewhere"
    for path in (ROOT / "docs").glob("*.ipynb"):
        book = json.loads(path.read_text())
        assert not any(cell.get("outputs") for cell in book["cells"]), f"{path.name} has output"
        assert path.with_suffix(".html").name in pages
