"""What changes the key of a run, and what does not (docs/notes/decisions.md, identity)."""

import importlib
import os
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from bench.errors import InputError
from bench.ground import source
from bench.ground.registry import load_part
from bench.plan.grid import make_cells
from bench.plan.plan import Plan, captures_of_cell, make_folds
from bench.running.circumstances.faults import Faults
from bench.running.circumstances.instants import Instants
from bench.running.circumstances.subjects import Subjects
from tests.conftest import forget_parts

RUNS = {
    "run": (),
    "stress": (Faults(("noise",)),),
    "stream": (Instants(),),
    "curve": (Subjects((1,)),),
    "tune": (),
}
EVERY = {*RUNS}


@cache
def usual(**values):
    """A cell with its captures and folds."""
    (cell,) = make_cells({"data.subjects": "2", "data.variants": "normal", **values})
    return cell, (corpus := captures_of_cell(cell)), tuple(make_folds(cell, corpus))


def key(*circumstances, threads=1, tuning=None, **values):
    cell, corpus, folds = usual(**values)
    return Plan(
        replace(cell, tuning=tuning, circumstances=circumstances), corpus, folds, 1, threads
    ).key


def of(name):
    """The key of a kind of run."""
    return key(*RUNS[name], tuning={"space": {"C": [1.0, 2.0]}} if name == "tune" else None)


unchanged = cache(of)


@pytest.fixture
def changed(monkeypatch):
    """Changes the text of a module as `bench.ground.source` reads it."""

    def change(module, edit):
        read, text, path = source._parse_file, Path.read_bytes, source.module_file(module)
        before = path.read_bytes()
        assert edit(before) != before, f"{module} has nothing to change"
        monkeypatch.setattr(
            Path, "read_bytes", lambda self: edit(before) if self == path else text(self)
        )
        monkeypatch.setattr(
            source,
            "_parse_file",
            lambda file, at: (read.__wrapped__ if file == str(path) else read)(file, at),
        )

    return change


def code(text):
    return text + b"\nANOTHER = 1\n"


def line(text):
    """An edit that adds a line to a fold."""
    start = b"started = time.process_time()\n"
    return text.replace(start, b"another = 1; " + start)


@pytest.mark.parametrize(
    ("module", "edit", "stale"),
    [
        ("bench.models.classic.svm", lambda text: text + b"\n# a remark\n", set()),
        ("bench.models.classic.svm", code, EVERY),
        ("bench.protocols.subjects", code, EVERY),
        ("bench.values.scores", code, EVERY),
        ("bench.running.fold", code, EVERY),
        ("bench.running.circumstances.faults", line, {"stress"}),
        ("bench.corpora.faults", code, {"stress", "tune"}),
        ("bench.running.replay", code, {"stream"}),
        ("bench.running.circumstances.subjects", code, {"curve"}),
        ("bench.models.rocket", code, set()),
        ("bench.models.search.tuning", code, {"tune"}),
        ("bench.running.loop", code, set()),
        # what is shown, and chosen by
        *(
            (f"bench.{name}", code, set())
            for name in ("reports.views.faults", "values.measures", "reading.candidates")
        ),
    ],
)
def test_a_change_of_code_makes_those_runs_stale_that_depend_on_it(module, edit, stale, changed):
    before = {name: unchanged(name) for name in RUNS}
    changed(module, edit)
    assert {name for name in RUNS if of(name) != before[name]} == stale


def test_everything_else_that_numbers_depend_on_is_in_the_key(monkeypatch):
    keys = [
        key(),
        key(**{"data.subjects": "3"}),
        *(
            key(where=f"gesture != '{gesture}'") for gesture in ("pat", "tap")
        ),  # as many captures, in the same places
        key(target="variant+gesture"),
        key(protocol="kfold", **{"protocol.folds": "2", "data.repetitions": "2"}),
        key(**{"model.C": "2"}),
        key(threads=2),
        key(tuning={"space": {"C": [1.0]}}),
        *(key(*RUNS[name]) for name in ("stress", "stream", "curve")),
        key(Instants((), 250.0)),
        key(Faults(("noise",)), Subjects((1,))),
    ]
    assert len(set(keys)) == len(keys) and keys[0] == key()
    monkeypatch.setattr("bench.plan.cells.package_versions", lambda also: {"numpy": "0"})
    assert key() not in keys


@pytest.mark.parametrize(("late", "on_path"), [(False, True), (True, False)])
def test_what_a_file_imports_from_beside_it_or_from_the_path_counts(
    tmp_path, monkeypatch, late, on_path
):
    """In packages with and without __init__, through their modules, imported or not."""
    monkeypatch.setattr(sys, "path", [*sys.path, *([str(tmp_path / "lib")] if on_path else [])])
    monkeypatch.setattr(sys, "modules", dict(sys.modules))  # what is imported here is forgotten
    mine, package = tmp_path / "mine", tmp_path / ("lib" if on_path else "mine") / "nets_of_mine"
    package.mkdir(parents=True)
    mine.mkdir(exist_ok=True)
    (package / "net.py").write_text("from .layers import SIZE\ndef Net():\n    return SIZE\n")
    (package / "layers.py").write_text("import numpy\nSIZE = 1\n")
    if not late:
        (package / "__init__.py").touch()
    early, inside = ("", "    {}\n") if late else ("{}\n", "")
    text = f"{early}def mine():\n{inside}    return Net()\n".replace(
        "{}", "from nets_of_mine.net import Net"
    )
    (mine / "wrap.py").write_text(text)
    part = load_part("models", f"{mine / 'wrap.py'}:mine")
    before = source.source_digest(part)
    assert before == source.source_digest(part)
    (package / "layers.py").write_text("import numpy\nSIZE = 2\n")
    os.utime(package / "layers.py", (1, 1))
    assert source.source_digest(part) != before


def test_a_key_does_not_depend_on_what_was_imported_before():
    """In a new process it is that of this one, which has imported much."""
    code = "import sys; sys.path.insert(0, sys.argv[1]); "
    code += "from tests.plan.test_identity import key; print(key())"
    command = [sys.executable, "-c", code, str(Path(source.__file__).parents[2])]
    importlib.import_module("bench.reports.page")
    assert (
        subprocess.run(command, capture_output=True, text=True, check=True).stdout == f"{key()}\n"
    )


def test_files_that_a_system_names_are_part_of_its_key():
    Path("my.py").write_text("depends = ['table.txt']\ndef tree(): pass\n")
    keys = []
    for text in ("1", "2", "1"):
        Path("table.txt").write_text(text)
        forget_parts()
        keys.append(source.source_digest(load_part("models", "my.py:tree")))
    assert keys[0] == keys[2] != keys[1]
    Path("table.txt").unlink()
    with pytest.raises(InputError, match="depends names 'table.txt'"):
        source.source_digest(load_part("models", "my.py:tree"))
