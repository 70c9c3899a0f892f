"""Modules import in one direction, and what help and results need loads nothing heavy.

An import counts wherever it stands: in a function and for types alone, too. Parts that a registry loads by name do not.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import bench

ROOT = Path(bench.__file__).parents[1]
PACKAGES = ("bench", "features", "models", "protocols", "reports")

# Rooms from the bottom to the top: packages, or modules, and the rooms that they may import.
ROOMS = {
    "ground": ("bench.errors bench.ground", ""),
    "corpora": ("bench.corpora", "ground"),
    "values": ("bench.values", "ground corpora"),
    "store": ("bench.store", "ground values"),
    "grammar": ("bench.grammar", "ground values"),  # of the command line: results do not know it
    "features": ("bench.features", "ground corpora"),
    "contract": (
        "bench.contract bench.models.space",
        "ground corpora features",
    ),  # with the types that it names
    "models": ("bench.models", "ground corpora values features contract"),
    "protocols": ("bench.protocols", "ground corpora"),
    "plan": ("bench.plan", "ground values corpora features contract models"),
    # The reading half.
    "reading": ("bench.reading", "ground values store corpora"),
    "reports": ("bench.reports", "ground values store grammar corpora reading"),
    # The producing half: none of it knows what is read.
    "running": ("bench.running", "ground values store corpora features contract models plan"),
}
FRONT = "bench bench.__main__ bench.cli bench.commands"  # may import every room
PRODUCING = (
    "bench.running.circumstances",
    "bench.corpora",
    "bench.features",
    "bench.models",
    "bench.plan",
    "bench.protocols",
    "bench.running",
)
READING = ("bench.reading", "bench.reports")
HEAVY = {"numpy", "pandas", "scipy", "sklearn", "torch", "mlflow", "matplotlib", "rich"}
LIGHT = [
    "bench",
    "bench.values.measures",
    "bench.values.columns",
    "bench.values.table",
    "bench.values.result",
    "bench.grammar.options",
    "bench.cli",
]
OURS = ("bench", "touchbench")
EVERY = "import bench.ground.registry as r; r.loaded('circumstances'), r.views()"
ROCKET = "from bench.plan.cells import cells; cells({'model': 'rocket,svm'})[0].estimator()"
LOADED = [  # code, and what it does not load
    *((f"import {name}", HEAVY) for name in LIGHT),
    (EVERY, HEAVY),
    ("from bench.cli import main; main(['run', '--help'])", HEAVY),
    ("import bench.commands.run, bench.running.loop", {"dask", "distributed"}),
    (ROCKET, {"aeon", "numba"}),
]


TABULAR = {"read_parquet", "to_parquet", "read_csv", "to_csv"}  # pandas' readers and writers
TABLES = {  # modules that call one, beside bench.store.tables, and their files, none of which is a table of a run
    "bench.commands.predict": "the user's captures with labels, printed",
    "bench.corpora.folder": "captures",
    "bench.corpora.read.table": "files to import",
    "bench.values.table": "what is shown, for the user",
    "bench.running.tracking": "a copy of some tables for people, which is not read",
    "bench.features.cache": "features",
    "bench.reports.comparison": "published numbers",
}


def modules():
    """The file of each module, by name."""
    named = {}
    for path in (path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))):
        parts = path.relative_to(ROOT).with_suffix("").parts
        parts = parts if parts[0] == "bench" else ("bench", *parts)
        named[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return named


def imported(source, named):
    """The modules that a source imports; of a package only where one of its own names is imported."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "relative imports are not followed"
            full = {alias.name: f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in named else node.module for name in full.values()}
    return found & {*named}


def test_one_module_reads_and_writes_tables_of_runs():
    """Others would lose the types of labels."""
    found = set()
    for name, path in modules().items():
        called = {
            node.attr
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Attribute)
        }
        found |= {name} if called & TABULAR else set()
    assert found - {"bench.store.tables"} == {*TABLES}


def test_the_core_names_no_addon():
    """Neither a package nor what one of them is about."""
    packages, subjects = (
        "touchbench_(chip|dask|people|streams)",
        "shots?|adapt(s|ed|ation)?|personal|transfer|skins?",
    )
    words = re.compile(rf"{packages}|_?({subjects})")
    found = set()
    for name, path in modules().items():
        for node in ast.walk(ast.parse(path.read_text())):
            said = [
                getattr(node, key, None) for key in ("id", "attr", "name", "arg", "module", "value")
            ]
            found |= {(name, one) for one in said if isinstance(one, str) and words.fullmatch(one)}
    assert found - {("bench.errors", "shots")} == set()


def room_of(name):
    """The room of a module, by the longest prefix that a room names."""
    prefixes = {prefix: room for room, (listed, _) in ROOMS.items() for prefix in listed.split()}
    prefixes |= dict.fromkeys(FRONT.split()[1:], "front")
    parts = name.split(".")
    found = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return (
        "front"
        if name == "bench"
        else next((prefixes[prefix] for prefix in found if prefix in prefixes), None)
    )


@pytest.fixture(scope="module")
def graph():
    named = modules()
    return {name: imported(path.read_bytes(), named) - {name} for name, path in named.items()}


def test_no_modules_import_each_other_in_a_circle(graph):
    assert len(graph) > 150
    TopologicalSorter(graph).prepare()  # raises CycleError with the modules


def test_rooms_import_only_those_below_them(graph):
    below = list(ROOMS)
    for i, (room, (_, allowed)) in enumerate(ROOMS.items()):
        assert {*allowed.split()} <= {*below[:i]}, room
    assert [name for name in graph if room_of(name) is None] == []  # a new module belongs to a room
    wrong = []
    for name, targets in graph.items():
        room = room_of(name)
        for target in (target for target in targets if room_of(target) != room):
            if room != "front" and room_of(target) not in ROOMS[room][1].split():
                wrong.append(f"{name} ({room}) imports {target} ({room_of(target)})")
    assert wrong == []


def test_the_producing_half_reaches_nothing_of_the_reading_half(graph):
    """Through any number of files; what both need knows neither half."""
    found, todo = set(), [name for name in graph if name.startswith(PRODUCING)]
    assert len(todo) > 100
    while todo:
        if (name := todo.pop()) not in found:
            found.add(name)
            todo += graph[name]
    assert sorted(name for name in found if name.startswith(READING)) == []


@pytest.mark.parametrize(("code", "heavy"), LOADED)
def test_nothing_heavy_is_loaded_before_it_is_needed(code, heavy):
    code += (
        f"; import sys; print(*sorted({heavy!r} & {{part.split('.')[0] for part in sys.modules}}))"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert said.stdout.splitlines()[-1] == ""


def seconds(code, compiled):
    """The least processor time of three processes that run some code, whose modules are compiled before."""
    spent = []
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(compiled)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    for _ in range(3):
        before = children()
        subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=True, env=environment
        )
        spent.append(children() - before)
    return min(spent)


def children():
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.mark.skipif(sys.platform == "win32", reason="no resource module")
def test_help_comes_at_once(tmp_path):
    code = "import sys; from bench.cli import main; sys.argv = ['bench', 'stress', '--help']; sys.exit(main())"
    # 0.1 s where a bare Python takes 0.025 s: a busy or a slow machine takes longer for both
    seconds(code, tmp_path)
    assert any(seconds(code, tmp_path) < 4.5 * seconds("pass", tmp_path) for _ in range(3))


def test_a_run_loads_what_it_uses(tmp_path, empty_store):
    """Whatever add-ons are installed: no other command, no circumstance, no step of systems that have none."""
    shutil.copy(empty_store, tmp_path / "mlflow.db")
    words = "run data.subjects=2 data.variants=normal data.repetitions=1 protocol=loso model=svm features=touch jobs=1"
    code = f"import sys; from bench.cli import main; assert main({words.split()}) == 0; print(*sys.modules)"
    said = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    ours = [
        name
        for name in said.stdout.splitlines()[-1].split()
        if name.split(".")[0].partition("_")[0] in OURS
    ]
    assert len(ours) <= 68 and not {
        "bench.running.circumstances",
        "bench.models.recipe",
        "bench.commands.choose",
    } & {*ours}
