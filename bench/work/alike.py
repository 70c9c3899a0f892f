"""Whether another machine gives the results of this one: versions, code and corpora, asked before its first fold."""

from __future__ import annotations

import inspect
import socket
from typing import TYPE_CHECKING, NamedTuple

from bench.scratch import home

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from types import ModuleType

    from bench.corpora.folder import Address
    from bench.plan.cells import Cell, Part
    from bench.source import Code
    from bench.work.experiment import Experiment


TYPED = "__main__"  # module of what is typed into a script or a notebook


class Facts(NamedTuple):
    """What tells a machine that gives the same results from one that does not.

    Attributes:
        versions: of Python and the packages that results depend on.
        code: what each system computes, as a digest.
        wrong: why a system cannot be had there, empty for one that can.
        lacks: digests of the corpora that are not there.
        host: name of the machine.
        home: its data folder.
    """

    versions: dict[str, str]
    code: list[str]
    wrong: list[str]
    lacks: list[str]
    host: str
    home: str


def representatives(asked: Iterable[tuple[Cell, Experiment]]) -> tuple[list[Cell], list[Experiment]]:
    """Cells and kinds of run, one of each that share all their code."""
    from models import contract
    from models.tuning import machinery

    found: dict[tuple, tuple[Cell, Experiment]] = {}
    for cell, experiment in asked:
        parts = [part for part in (cell.protocol, cell.features, cell.model) if part is not None]
        names = [(p.room, p.name, p.module, id(p.given) if p.given else 0, *sorted(p.parameters)) for p in parts]
        code = [*experiment.depends(), *(machinery(cell.tuning) if cell.tuning else [])]
        faults = contract.trained_faults(cell.estimator())
        found.setdefault((type(experiment), *map(id, code), *names, *faults), (cell, experiment))
    return [cell for cell, _ in found.values()], [experiment for _, experiment in found.values()]


def facts(cells: Sequence[Cell], experiments: Sequence[Experiment], corpora: Sequence[Address]) -> Facts:
    """What this machine has for a command.

    Args:
        cells: one of each kind that it runs.
        experiments: their kinds of run.
        corpora: that it needs.
    """
    from bench.errors import InputError
    from bench.source import versions

    found, code, wrong, lacks = versions(), [], [], []
    for cell, experiment in zip(cells, experiments, strict=True):
        digest = why = ""
        try:
            found |= versions(cell.packages())
            digest = digest_of(cell, experiment)
        except (InputError, ImportError, OSError) as e:
            why = str(e)
        code.append(digest)
        wrong.append(why)
    for address in corpora:
        try:
            address.open()
        except InputError:
            lacks.append(address.digest)
    return Facts(found, code, wrong, lacks, socket.gethostname(), str(home().absolute()))


def digest_of(cell: Cell, experiment: Experiment) -> str:
    """Hash of what a run of a cell computes.

    Classes that were typed in travel with the cell; of those counts only what they use of files.
    """
    import hashlib
    import json

    from bench.source import source_digest

    same = cell.identity()
    del same["versions"]  # which are told apart by name
    same["parts"] = [_code_of(part) for part in (cell.protocol, cell.features, cell.model) if part is not None]
    code = [same, source_digest(*experiment.depends())]
    return hashlib.sha256(json.dumps(code, sort_keys=True, default=str).encode()).hexdigest()


def _code_of(part: Part) -> tuple:
    from bench.source import source_digest
    from models import contract

    own = contract.classes(part.given) if part.given is not None else []
    if not any(kind.__module__ == TYPED for kind in own):
        return part.identity()
    files: dict[int, Code] = {}
    for kind in own:
        _follow(kind, files, set())
    return *part.identity()[:-1], source_digest(*files.values()) if files else ""


def _follow(code: Code, files: dict[int, Code], seen: set[int]) -> None:
    """Find what typed-in code uses of files that are no installed library: base classes, and names in its functions."""
    from models import contract

    if id(code) in seen or (inspect.ismodule(code) and not any(map(contract.classes, _defined(code)))):
        return
    seen.add(id(code))
    if inspect.ismodule(code) or code.__module__ != TYPED:
        if inspect.ismodule(code) or contract.classes(code):
            files[id(code)] = code
        return
    functions = [code]
    if inspect.isclass(code):
        for base in code.__mro__[1:]:
            _follow(base, files, seen)
        functions = [getattr(v, "__func__", getattr(v, "fget", v)) for v in vars(code).values()]
    for function in filter(inspect.isfunction, functions):
        for name in function.__code__.co_names:
            used = function.__globals__.get(name)
            if inspect.ismodule(used) or inspect.isclass(used) or inspect.isfunction(used):
                _follow(used, files, seen)


def _defined(module: ModuleType) -> list[Code]:
    """Classes and functions of a module itself."""
    code = [v for v in vars(module).values() if inspect.isclass(v) or inspect.isfunction(v)]
    return [v for v in code if v.__module__ == module.__name__]


def difference(systems: Sequence[str], here: Facts, there: Facts) -> str:
    """The first thing that makes a worker's results others than this machine's; empty if there is none.

    Args:
        systems: what is called by these names here was asked about, in this order.
        here: what this machine has.
        there: what the worker has.
    """
    for name in (*here.versions, *there.versions):
        if here.versions.get(name) != (other := there.versions.get(name)):
            return f"it has {name} {other or 'not at all'}, this machine {here.versions.get(name) or 'not at all'}"
    for name, digest, other, why in zip(systems, here.code, there.code, there.wrong, strict=False):
        if why:
            return f"{name}: {why}"
        if digest != other:
            return f"its code of {name} differs from this machine's"
    return ""
