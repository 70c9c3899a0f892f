"""The net under changes of structure: all that users see of one store, as golden files.

The store has runs of every kind. ``pytest --golden`` writes the files anew; read the difference.
`tests.net.masks` says what is masked.
"""

from pathlib import Path

import pandas as pd
import pytest

import bench
from bench.grammar.options import load_commands
from tests.net import masks
from tests.net.build import RUNS, step
from tests.net.commands import FILES, LINES, ON, SCENES, STEPS, WRONG

GOLDEN = Path(__file__).parent / "golden"
FORMS = {".csv": masks.csv_of, ".html": masks.page_of}


@pytest.fixture
def work(in_net):
    """A copy of the store, with scenes and captures of one person."""
    for name, text in SCENES.items() | {(f"{name}.toml", text) for name, text in LINES.items()}:
        (in_net / name).write_text(text)
    table = pd.read_csv("three.csv")
    table[table["subject"] == 1].to_csv("one.csv", index=False)
    return in_net


@pytest.fixture
def golden(request, net_store, tmp_path):
    """Compare a text with the golden file of a name, or write it."""

    def compared(name, text):
        path = GOLDEN / name
        if request.config.getoption("golden"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        assert text == path.read_text()

    compared.folders = (tmp_path / "net", net_store, tmp_path)
    return compared


def compare_files(golden, folder, names):
    for name in names:
        form = FORMS.get(Path(name).suffix, masks.lines_of)
        kept = name.replace(".html", ".txt")
        golden(f"files/{kept}", form((folder / name).read_text(), golden.folders))


@pytest.mark.parametrize("name", RUNS)
def test_runs_print_what_they_printed(name, net_store, golden):
    golden(
        f"runs/{name}.txt",
        masks.lines_of((net_store / f"printed/{name}.txt").read_text(), golden.folders),
    )


@pytest.mark.parametrize("name", STEPS)
def test_commands_print_and_write_what_they_did(name, work, golden):
    text = "".join(map(step, STEPS[name]))
    golden(f"steps/{name}.txt", masks.lines_of(text, golden.folders))
    compare_files(golden, work, FILES.get(name, ()))
    if name == "report":
        names = sorted(str(path.relative_to(work / name)) for path in (work / name).rglob("*.*"))
        golden("files/report.txt", "\n".join(names) + "\n")


@pytest.mark.parametrize("name", ["bench", *load_commands()])
def test_help_is_what_it_was(name, golden):
    text = step(["--help"] if name == "bench" else [name, "--help"])
    golden(f"help/{name}.txt", masks.lines_of(text, golden.folders))


def test_mistakes_are_refused_in_the_same_words(work, golden):
    """A file for each command, and one for what is none."""
    known = load_commands()
    file_of = {command[0]: command[0] if command[0] in known else "none" for command in WRONG}
    for name in sorted({*file_of.values()}):
        text = "".join(step(command) for command in WRONG if file_of[command[0]] == name)
        golden(f"refusals/{name}.txt", masks.lines_of(text, golden.folders))


def test_the_api_returns_what_it_returned(work, golden):
    """Objects as they are printed, their tables as columns, types and rows."""
    on = dict(key.split("=", 1) for key in ON)
    people, jung = {"data": "people", "jobs": 1}, {"features": "jung28"}  # runs that are stored
    faults = {"faults": ["noise", "dead_taxels"], "train_subjects": [1, 2]}
    objects = {
        "run": bench.run(model=["tree", "bayes"], **jung, **people),
        "stress": bench.stress(model=["tree", "bayes"], **faults, **jung, **people),
        "replay": bench.run(
            model="tree", after="each", stopping=True, start="middle", data="three", jobs=1, **jung
        ),
        "runs": bench.runs(data="people"),
        "choose": bench.choose(**on, max_flash="64kB"),
        "groups": bench.groups(data="synth"),
        "compare": bench.compare("tree · jung28", {"model": "bayes", "features": "jung28"}, **on),
        "corpus": bench.corpus("people"),
    }
    for name, value in objects.items():
        golden(f"api/{name}.txt", shown(value, golden.folders))


def shown(value, folders):
    """An object of the API as a text."""
    if isinstance(value, pd.DataFrame):
        return masks.table_of(value, folders)
    text = f"{value!s}\n{value!r}" if hasattr(value, "candidates") else repr(value)
    parts = [type(value).__name__, masks.lines_of(text, folders)]
    if hasattr(value, "candidates"):
        parts.append(f"choice.table\n{masks.table_of(value.table, folders)}")
    return "\n".join(parts)
