"""Modules import in one direction, and help loads nothing heavy.

An import counts wherever it stands: also in a function, and for types alone. Parts that the
registry loads by name do not count.
"""

import ast
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
# Each room is a folder, ``bench.<room>``; the rooms that it may import stand above it.
ROOMS = {
    "ground": "",
    "corpora": "ground",
    "values": "ground corpora",
    "store": "ground values",
    "grammar": "ground values",
    "features": "ground corpora",
    "contract": "ground corpora features",
    "models": "ground corpora values features contract",
    "protocols": "ground corpora",
    "plan": "ground values corpora features contract models",
    "reading": "ground values store corpora",
    "reports": "ground values store grammar corpora reading",
    "running": "ground values store corpora features contract models plan",
}
ELSEWHERE = {"bench.errors": "ground", "bench.models.space": "contract"}  # modules of other rooms
FRONT = {"bench", "bench.__main__", "bench.cli", "bench.commands"}  # may import every room
PRODUCING = "corpora features models plan protocols running".split()
READING = ("bench.reading", "bench.reports")
HEAVY = {"numpy", "pandas", "scipy", "sklearn", "torch", "mlflow", "matplotlib", "rich"}
VALUES = "bench.values.columns, bench.values.table, bench.grammar.options, bench.cli"
VIEWS = "import bench.ground.registry as r; r.load_parts('circumstances'), r.load_views()"
ROCKET = (
    "from bench.plan.grid import make_cells; make_cells({'model': 'rocket,svm'})[0].estimator()"
)
LOADED = [  # code, and what it does not load
    (f"import bench, {VALUES}", HEAVY),
    (VIEWS, HEAVY),
    ("from bench.cli import main; main(['run', '--help'])", HEAVY),
    ("import bench.commands.run, bench.running.loop", {"dask", "distributed"}),
    (ROCKET, {"aeon", "numba"}),
]
TABULAR = {"read_parquet", "to_parquet", "read_csv", "to_csv"}  # pandas' readers and writers
TABLES = {  # modules that call one, and their files, none of which is a table of a run
    "bench.commands.predict": "the user's captures with labels, printed",
    "bench.corpora.folder": "captures",
    "bench.corpora.read.table": "files to import",
    "bench.values.table": "what is shown, for the user",
    "bench.running.tracking": "a copy of some tables for people, which is not read",
    "bench.features.cache": "features",
    "bench.reports.comparison": "published numbers",
    "bench.reports.own_numbers": "published numbers of the user",
}


def module_files():
    """The file of each module, by name."""
    return {
        name if name.startswith("bench") else f"bench.{name}": path
        for package in PACKAGES
        for name, path in files_of(ROOT / package)
    }


def files_of(package):
    """Name and file of each module of a package."""
    for path in sorted(package.rglob("*.py")):
        name = ".".join(path.relative_to(package.parent).with_suffix("").parts)
        yield name.removesuffix(".__init__"), path


def nodes(path, *kinds):
    return [node for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, kinds)]


def import_graph(files):
    """The modules among these that each module imports; a package only for a name of its own."""
    graph = {}
    for module, path in files.items():
        found = {alias.name for node in nodes(path, ast.Import) for alias in node.names}
        for node in nodes(path, ast.ImportFrom):
            assert not node.level, "relative imports are not followed"
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in files else node.module for name in full}
        graph[module] = (found & {*files}) - {module}
    return graph


@pytest.fixture(scope="module")
def graph():
    return import_graph(module_files())


def room_of(module):
    if module in ELSEWHERE:
        return ELSEWHERE[module]
    is_front = module == "bench" or any(module.startswith(name) for name in FRONT - {"bench"})
    return "front" if is_front else module.split(".")[1]


def test_one_module_reads_and_writes_tables_of_runs():
    """Others would lose the types of labels."""
    found = set()
    for name, path in module_files().items():
        if TABULAR & {node.attr for node in nodes(path, ast.Attribute)}:
            found.add(name)
    assert found - {"bench.store.tables"} == {*TABLES}


def test_the_core_names_no_addon():
    for path in module_files().values():
        texts = [node.value for node in nodes(path, ast.Constant) if isinstance(node.value, str)]
        modules = [node.module or "" for node in nodes(path, ast.ImportFrom)]
        assert not [x for x in texts + modules if re.match(r"touchbench_(?!file_)[a-z]", x)], path


def test_no_modules_import_each_other_in_a_circle(graph):
    assert len(graph) > 150
    TopologicalSorter(graph).prepare()  # raises CycleError with the modules


def test_no_modules_of_an_addon_import_each_other_in_a_circle():
    packages = [path.parent for path in ROOT.glob("addons/*/touchbench_*/__init__.py")]
    graph = import_graph(dict(pair for package in packages for pair in files_of(package)))
    assert len(graph) > 40
    TopologicalSorter(graph).prepare()


def test_rooms_import_only_those_below_them(graph):
    below = [*ROOMS]
    for i, (room, allowed) in enumerate(ROOMS.items()):
        assert {*allowed.split()} <= {*below[:i]}, room
    assert {room_of(module) for module in graph} == {*ROOMS, "front"}
    wrong = []
    for module, targets in graph.items():
        if (room := room_of(module)) != "front":
            allowed = {room, *ROOMS[room].split()}
            wrong += [f"{module} imports {t}" for t in targets if room_of(t) not in allowed]
    assert wrong == []


def test_the_producing_half_reaches_nothing_of_the_reading_half(graph):
    """Through any number of files; what both need knows neither half."""
    found, todo = set(), [name for name in graph if room_of(name) in PRODUCING]
    assert len(todo) > 100
    while todo:
        if (name := todo.pop()) not in found:
            found.add(name)
            todo += graph[name]
    assert sorted(name for name in found if name.startswith(READING)) == []


def output_of(code, **how):
    """The last line that Python prints for some code."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, **how)
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize(("code", "heavy"), LOADED)
def test_nothing_heavy_is_loaded_before_it_is_needed(code, heavy):
    loaded = "{part.split('.')[0] for part in sys.modules}"
    assert output_of(f"{code}; import sys; print(*sorted({heavy!r} & {loaded}))", cwd=ROOT) == ""


def test_a_run_loads_what_it_uses(tmp_path, empty_store):
    """Whatever add-ons are installed: no other command, circumstance or steps of a system."""
    shutil.copy(empty_store, tmp_path / "mlflow.db")
    words = "run data.subjects=2 data.variants=normal data.repetitions=1 model=svm features=touch"
    run = f"main({[*words.split(), 'jobs=1']})"
    code = f"import sys; from bench.cli import main; {run}; print(*sys.modules)"
    names = output_of(code, cwd=tmp_path).split()
    ours = {n for n in names if n.split(".")[0].partition("_")[0] in ("bench", "touchbench")}
    unused = {"bench.running.circumstances.faults", "bench.models.recipe", "bench.commands.choose"}
    assert 40 < len(ours) <= 77 and not unused & ours
