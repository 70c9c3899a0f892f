"""The code that a result depends on: its hash, so that no change is mistaken for the code before it, and versions."""

from __future__ import annotations

import ast
import copy
import hashlib
import importlib
import importlib.util
import inspect
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from bench.registry import FILE_MODULE, lies_beside

Code = ModuleType | Callable  # a module, class or function
ROOMS = {"bench"}
# Modules that find, move and keep things and change no number; a change in them is no other result.
INDIFFERENT = {
    "bench.arguments",
    "bench.words",
    "bench.work.backend",
    "bench.candidate",
    "bench.corpora.duplicates",
    "bench.corpora.folder",
    "bench.corpora.library",
    "bench.described",
    "bench.errors",
    "bench.memory",
    "bench.comparable",
    "bench.measures",
    "bench.options",
    "bench.table",
    "bench.result",
    "bench.progress",
    "bench.registry",
    "bench.scratch",
    "bench.source",
    "bench.work.experiment",
    "bench.features.cache",
}


class Imports(NamedTuple):
    """What a file imports, as pairs of a module and a name of it; ``*`` where the module itself is imported.

    Attributes:
        loading: ``from`` imports at module level, and those of a module within a package.
        late: imports inside of functions, classes and blocks.
        left_out: names at module level that only consumers use.
    """

    loading: frozenset[tuple[str, str]]
    late: frozenset[tuple[str, str]]
    left_out: frozenset[str]


def source_digest(*parts: Code) -> str:
    """Hash of modules, or those that define classes or functions, and of every module these take names from.

    Comments, docstrings and layout are left out, and so are modules that change no number (`INDIFFERENT`). Modules of
    other packages are left out too; their versions identify them.

    A class names in ``consumers`` (a frozenset) those of its members that only show numbers: they are left out, with
    all that only they use of the file, unless the rest of the file uses an attribute of that name; and so are the help
    texts of options. What such a file, or a module that it imports late, imports late counts too.
    """
    todo = [(name, "" if inspect.ismodule(part) else of, False) for part in parts for name, of in [_origin(part)]]
    packages = ROOMS | {name.split(".")[0] for name, _, _ in todo}
    beside = {Path(str(sys.modules[name].__file__)).parent for name, _, _ in todo if name.startswith(FILE_MODULE)}
    code: dict[str, bytes] = {}
    consumers: dict[str, tuple[tuple[str, frozenset[str]], ...]] = {}
    taken: dict[str, frozenset[str]] = {}  # what others take from a file that has consumers is not the consumers' alone
    done: set[tuple[str, bool, frozenset[str]]] = set()

    def considered(name: object) -> bool:
        return isinstance(name, str) and (name.split(".")[0] in packages or _lies_in(name, beside))

    while todo:
        name, of, late = todo.pop()
        if name in INDIFFERENT:
            continue
        module = sys.modules[name]
        if name not in consumers:
            consumers[name] = _consumers(module)
        if consumers[name]:
            taken[name] = taken.get(name, frozenset()) | {of}
        this = (name, late, taken.get(name, frozenset()))
        if this in done:
            continue
        done.add(this)
        path = getattr(module, "__file__", None)
        if path and path.endswith(".py"):
            parted = (consumers[name], taken[name]) if consumers[name] else ()
            code[name], imports = meaning(path, Path(path).stat().st_mtime_ns, *parted)
        else:  # typed into a notebook
            code[name], imports = _typed_in(parts, name), Imports(frozenset(), frozenset(), frozenset())
        package = hasattr(module, "__path__")  # it holds whatever was imported of it
        used = set() if package else _names(module, imports.left_out)
        # A constant does not tell where it comes from; a package says nothing that its module does not.
        used |= {(f"{m}.{n}", "*") if f"{m}.{n}" in sys.modules else (m, n) for m, n in imports.loading}
        todo += [(m, n, False) for m, n in used if m in sys.modules and considered(m)]
        # Not of all files: the Corpus imports pictures and the messages of where= late, a search the steps of captures
        # and the selection of columns, so that what does without them does not depend on them.
        if late or consumers[name] or lies_beside(path, beside):  # a user's code counts as a whole
            found = {o for m, n in imports.late for o in _imported(m, n, module.__package__, considered)}
            todo += [(m, n, True) for m, n in found if m in sys.modules and considered(m)]
    h = hashlib.sha256()
    for name in sorted(code):
        stem = FILE_MODULE if name.startswith(FILE_MODULE) else name  # whose rest tells the path and every letter
        h.update(stem.encode() + code[name])
    return h.hexdigest()


def _lies_in(name: str, folders: set[Path]) -> bool:
    """Whether a module, or a late import, is what a user's file imports from beside it."""
    path = getattr(sys.modules.get(name), "__file__", None)
    if folders and name not in sys.modules and (spec := importlib.util.find_spec(name.partition(".")[0])):
        path = spec.origin or next(iter(spec.submodule_search_locations or []), None)  # a package may have no file
    return lies_beside(path, folders)


def _origin(value: object) -> tuple[str, str]:
    """The module that a value is (all of it, ``*``), or comes from, and its name there."""
    if inspect.ismodule(value):
        return value.__name__, "*"
    return getattr(value, "__module__", ""), getattr(value, "__qualname__", "")


def _names(module: ModuleType, left_out: frozenset[str]) -> set[tuple[str, str]]:
    """Modules that a module's values are, or come from, and the names there, but for some values."""
    return {_origin(value) for name, value in vars(module).items() if name not in left_out}


def _consumers(module: ModuleType) -> tuple[tuple[str, frozenset[str]], ...]:
    """Members that only show numbers, by name of the class of the module; those of a base class count."""
    classes = [(n, v) for n, v in vars(module).items() if isinstance(v, type) and v.__module__ == module.__name__]
    named = [(name, getattr(value, "consumers", None)) for name, value in classes]
    return tuple((name, members) for name, members in named if members and isinstance(members, frozenset))


def _imported(
    name: str, part: str, package: str | None, considered: Callable[[str], bool]
) -> Iterator[tuple[str, str]]:
    """Where a late import of a package's module takes from, as `_origin` says it; made if nobody has made it before.

    What cannot be imported here is not run here either.
    """
    try:
        name = importlib.util.resolve_name(name, package)
        if not considered(name):
            return
        value: object = importlib.import_module(name)
        if part != "*":
            value = getattr(value, part) if hasattr(value, part) else importlib.import_module(f"{name}.{part}")
    except Exception:  # what others wrote may raise anything
        return
    yield _origin(value)
    if not inspect.ismodule(value):
        yield name, part


@lru_cache(maxsize=512)
def meaning(
    path: str,
    changed: int,
    consumers: tuple[tuple[str, frozenset[str]], ...] = (),
    taken: frozenset[str] = frozenset(),
) -> tuple[bytes, Imports]:
    """The syntax tree of a file without docstrings and consumers, and its imports.

    Read again when its time of change is another.

    Args:
        path: the file.
        changed: its time of change.
        consumers: by name of a class, names of its members that are left out, with all that only they use.
        taken: names that other modules take, which stay; ``*`` for all.
    """
    tree = ast.parse(Path(path).read_bytes())
    left_out = _leave_out(tree, dict(consumers), {name.partition(".")[0] for name in taken}) if consumers else ()
    froms = [(node.module, node.names) for node in tree.body if isinstance(node, ast.ImportFrom) and node.module]
    imported = {(module, part.name) for module, parts in froms for part in parts}
    plain = [part.name for node in tree.body if isinstance(node, ast.Import) for part in node.names]
    imported |= {(name, "*") for name in plain if "." in name}  # no value of the file is that module
    late: set[tuple[str, str]] = set()
    passed = {*map(id, tree.body)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and _documented(node):
            node.body = node.body[1:]
        elif isinstance(node, ast.If) and _for_types(node):
            passed |= {id(inner) for part in node.body for inner in ast.walk(part)}
        elif isinstance(node, ast.Import | ast.ImportFrom) and id(node) not in passed:
            late |= {*_parts(node)}
    return ast.dump(tree).encode(), Imports(frozenset(imported), frozenset(late), frozenset(left_out))


def _parts(node: ast.Import | ast.ImportFrom) -> Iterator[tuple[str, str]]:
    """Module and name of each part of an import."""
    for part in node.names:
        yield (part.name, "*") if isinstance(node, ast.Import) else ("." * node.level + (node.module or ""), part.name)


def _for_types(node: ast.stmt) -> bool:
    """Whether a statement is a block that exists for type checkers only."""
    if not isinstance(node, ast.If) or node.orelse:
        return False
    test = node.test
    return (isinstance(test, ast.Name) and test.id or isinstance(test, ast.Attribute) and test.attr) == "TYPE_CHECKING"


def _leave_out(tree: ast.Module, consumers: dict[str, frozenset[str]], taken: set[str]) -> set[str]:
    """Take the consumers out of a tree, and what only they use of the file; returns the names of the latter."""
    whole, wanted = tree.body, set[str]()
    while True:
        gone, names = _parted(tree, whole, consumers, taken, wanted)
        attributes = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        if not (more := gone & attributes):
            return names
        wanted |= more


def _parted(
    tree: ast.Module,
    whole: list[ast.stmt],
    consumers: dict[str, frozenset[str]],
    taken: set[str],
    wanted: set[str],
) -> tuple[set[str], set[str]]:
    """Make a tree of all statements but consumers, and what only they use; returns names of members and of the rest.

    Args:
        tree: tree that is made.
        whole: statements of the file.
        consumers: names of members by name of the class.
        taken: names that other modules take.
        wanted: members that stay.
    """
    parts: list[ast.stmt] = []
    gone: list[ast.stmt] = []
    members_gone: set[str] = set()
    for node in whole:
        if isinstance(node, ast.ClassDef) and node.name in consumers:
            members, node = {"consumers", *consumers[node.name]} - wanted, copy.copy(node)
            left = [member for member in node.body if _bound(member) and _bound(member) <= members]
            node.body = [_without_help(member) for member in node.body if member not in left]
            members_gone |= set().union(*map(_bound, left))
            gone += left
        if isinstance(node, ast.Import):  # each name for itself, as only some may be the consumers'
            parts += [ast.Import([part]) for part in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts += [ast.ImportFrom(node.module, [part], node.level) for part in node.names]
        elif _of_consumers(node, consumers):
            gone.append(node)
        elif not _for_types(node):
            parts.append(node)
    named = [(_bound(part), _used(part)) for part in parts]

    def reached(names: set[str]) -> set[str]:
        """Names, and all that the statements use that bind them."""
        while more := set().union(*(used for bound, used in named if bound & names)) - names:
            names = names | more
        return names

    theirs = reached(set().union(*map(_used, gone)))
    stays = taken | consumers.keys()
    # What nobody uses stays: other modules may.
    rest = [bound | used for bound, used in named if "*" in taken or bound & stays or not bound & theirs]
    kept = reached(set().union(*rest))
    tree.body = [part for part, (bound, _) in zip(parts, named, strict=True) if not bound or bound & kept]
    return members_gone, set().union(*(bound for bound, _ in named)) - kept


def _without_help(member: ast.stmt) -> ast.stmt:
    """A member of a class; an option (`bench.kinds.base.option`) without the text of its help."""
    call = getattr(member, "value", None)
    if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "option"):
        return member
    member = copy.deepcopy(member)
    call = member.value  # type: ignore[attr-defined]
    call.args[1:2] = []
    call.keywords = [one for one in call.keywords if one.arg != "help"]
    return member


def _bound(node: ast.stmt) -> set[str]:
    """Names that a statement binds, and does nothing else."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {node.name}
    if isinstance(node, ast.Import | ast.ImportFrom):
        return {(part.asname or part.name).split(".")[0] for part in node.names} - {"*"}
    names: set[str] = set()
    for target in _targets(node):
        inner = target.elts if isinstance(target, ast.Tuple | ast.List) else [target]
        if not all(isinstance(one, ast.Name) for one in inner):
            return set()
        names |= {one.id for one in inner if isinstance(one, ast.Name)}
    return names


def _targets(node: ast.stmt) -> list[ast.expr]:
    """What a statement assigns to."""
    if isinstance(node, ast.Assign):
        return node.targets
    return [node.target] if isinstance(node, ast.AnnAssign | ast.AugAssign) else []


def _used(node: ast.AST) -> set[str]:
    return {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name)}


def _of_consumers(node: ast.stmt, consumers: dict[str, frozenset[str]]) -> bool:
    """Whether a statement sets consumers of a class from outside of it, as in ``Mine.shown = ()``."""
    targets = _targets(node)
    return bool(targets) and all(
        isinstance(target, ast.Attribute)
        and isinstance(target.value, ast.Name)
        and target.attr in consumers.get(target.value.id, ())
        for target in targets
    )


def _documented(node: ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    first = node.body[0] if node.body else None
    return isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str)


def _typed_in(parts: tuple[Code, ...], module: str) -> bytes:
    """Source of the classes and functions themselves, where their module is no file."""
    text = []
    for part in parts:
        if not inspect.ismodule(part) and part.__module__ == module:
            try:
                text.append(inspect.getsource(part))
            except (OSError, TypeError):  # nobody remembers it, so that no two are the same
                text.append(f"{part!r} {id(part)}")
    return "\n".join(text).encode()


def versions(also: Iterable[str] = ()) -> dict[str, str]:
    """Versions of the packages that results depend on, and of those that one system needs besides."""
    installed = {"python": ".".join(map(str, sys.version_info[:3]))}
    names = ("touchbench", "numpy", "pandas", "scipy", "scikit-learn", "optuna", "xgboost", "xgboost-cpu", "torch")
    for name in (*names, *also):
        try:
            installed[name] = version(name)
        except PackageNotFoundError:  # xgboost has two distributions, one of them is installed
            continue
    return installed


def git_revision() -> str:
    """Revision of the checkout that touchbench runs from, with ``+changes`` if it has any; empty without git."""
    if not shutil.which("git"):
        return ""
    here = Path(__file__).parent

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", "-C", here, *arguments], capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else ""

    revision = git("rev-parse", "--short=12", "HEAD")
    return revision + "+changes" if revision and git("status", "--porcelain", "--untracked-files=no") else revision
