"""What changes the key of a run, and what does not (docs/notes/decisions.md, identity)."""

import importlib
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from bench import source
from bench.circumstances.faults import Faults
from bench.circumstances.instants import Instants
from bench.circumstances.subjects import Subjects
from bench.endless.kind import Continuous
from bench.in_c.circumstance import InC
from bench.kinds.base import Shown
from bench.kinds.captures import Captures
from bench.plan.cells import cells
from bench.plan.plan import Plan, corpus_of, folds_of
from bench.protocols import transfer
from bench.registry import classes, lies_beside, load
from bench.work.tracking import key_of

ROOT = Path(source.__file__).parent.parent
KINDS = {
    "run": Captures(),
    "stress": Captures((Faults(("noise",)),)),
    "stream": Captures((Instants(),)),
    "curve": Captures((Subjects((1,)),)),
    "chip": Captures((InC("c"),)),
    "watch": Continuous(),
}
FILES = [
    type(one).__module__.removeprefix("bench.").replace(".", "/")
    for kind in KINDS.values()
    for one in (kind, *getattr(kind, "circumstances", ()))
]
FILES = [file for file in dict.fromkeys(FILES) if "subjects" not in file]  # which has no heading


def key(experiment=KINDS["run"], threads=1, tuning=None, **values):
    (cell,) = cells({"data.subjects": "2", "data.variants": "normal", **values})
    cell = replace(cell, tuning=tuning)
    corpus = corpus_of(cell)
    return key_of(Plan(cell, corpus, tuple(folds_of(cell, corpus)), 1, threads), experiment)


@pytest.fixture
def changed(monkeypatch):
    """Changes the text of a file as `bench.source` reads it; the others are not read again."""

    def change(name, edit):
        read, meaning, path = Path.read_bytes, source.meaning, ROOT / name
        before = path.read_bytes()
        assert edit(before) != before, f"{name} has nothing to change"
        whole = source.meaning.__wrapped__
        monkeypatch.setattr(Path, "read_bytes", lambda self: edit(before) if self == path else read(self))
        again = lambda file, *of: (whole if Path(file) == path else meaning)(file, *of)  # noqa: E731
        again.__wrapped__ = whole
        monkeypatch.setattr(source, "meaning", again)

    return change


def comment(text):
    return text + b"\n# a remark\n"


def code(text):
    return text + b"\nANOTHER = 1\n"


def caption(text):
    return re.sub(rb'(heading: ClassVar\[str\] = \(?\s*")', rb"\1Another ", text)


def hint(text):
    return re.sub(rb'(option\([^"]*(?:"\w*",\s+)?")', rb"\1Another ", text)


def line(name):
    """An edit that adds a line to a method of the only class of a file."""

    def edit(text):
        start = text.index(b"    def " + name.encode())
        body = text.index(b'"""\n', text.index(b'"""', start) + 3) + 4
        return text[:body] + b"        another = 1\n" + text[body:]

    return edit


LABELLED = {"stress", "stream", "curve", "chip"}  # captures in a circumstance
CAPTURES = {"run", *LABELLED}


@pytest.mark.parametrize(
    ("file", "edit", "stale"),
    [
        ("models/search/tuning.py", comment, set()),
        ("models/search/tuning.py", code, set()),  # svm is not searched
        ("models/classic/svm.py", comment, set()),
        ("models/classic/svm.py", lambda text: text.replace(b"on scaled features", b"on features, scaled"), set()),
        ("models/classic/svm.py", code, {*KINDS}),
        ("features/jung54.py", code, {*KINDS}),
        ("features/signals.py", code, {*KINDS}),
        ("features/cache.py", code, set()),
        ("protocols/subjects.py", code, {*KINDS}),
        ("bench/corpora/corpus.py", code, {*KINDS}),
        ("bench/corpora/folder.py", code, set()),
        ("bench/scores.py", code, {*KINDS}),
        ("bench/resampling.py", code, {*KINDS}),
        ("bench/measures.py", lambda text: text.replace(b'"flash kB"', b'"kB of flash"'), set()),  # a caption
        ("bench/measures.py", code, set()),
        ("bench/table.py", code, set()),
        ("bench/result.py", code, set()),
        ("bench/comparable.py", code, set()),
        ("bench/work/loop.py", code, set()),
        ("models/sizes.py", code, {*KINDS}),
        ("models/rocket.py", code, set()),
        ("models/__init__.py", code, set()),  # another name in the registry
        ("bench/contract.py", code, {*KINDS}),
        # what shows and chooses
        *((f"bench/{file}.py", caption, set()) for file in FILES),
        *((f"bench/{file}.py", hint, set()) for file in FILES if "captures" not in file),  # which has no option
        ("bench/circumstances/base.py", line("candidates"), set()),
        ("bench/kinds/captures.py", line("candidates"), set()),
        ("bench/circumstances/faults.py", line("lost"), set()),
        ("bench/outcomes/candidates.py", code, set()),
        ("bench/outcomes/losses.py", code, set()),
        ("bench/outcomes/scored.py", code, set()),
        ("bench/outcomes/reactions.py", code, set()),
        ("bench/candidate.py", code, set()),
        ("bench/plan/plan.py", code, set()),
        ("bench/commands/kind.py", code, set()),
        ("bench/options.py", code, set()),
        ("reports/details.py", code, set()),
        ("reports/streaming.py", code, set()),
        ("reports/fault_curves.py", code, set()),
        # what is done in a fold, and what that imports late
        ("bench/kinds/captures.py", line("fold"), CAPTURES),
        ("bench/work/evaluation.py", code, CAPTURES),
        ("bench/work/fold.py", code, {*KINDS}),
        ("bench/circumstances/base.py", line("fold"), LABELLED),
        ("bench/circumstances/faults.py", line("fold"), {"stress"}),
        ("bench/circumstances/faults.py", line("cases"), {"stress"}),
        ("bench/corpora/faults.py", code, {"stress", "watch", "chip"}),  # sensors that a watcher takes for broken
        ("bench/circumstances/subjects.py", line("cases"), {"curve"}),
        ("bench/work/subset.py", code, {"curve"}),
        ("bench/circumstances/instants.py", line("fold"), {"stream"}),
        ("bench/work/replay.py", code, {"stream", "chip"}),  # C has a stopping rule
        ("bench/work/stopping.py", code, {"stream", "chip"}),
        ("bench/in_c/circumstance.py", line("fold"), {"chip"}),
        ("bench/in_c/fold.py", code, {"chip"}),
        ("bench/in_c/network.py", code, {"chip"}),
        ("bench/endless/kind.py", line("fold"), {"watch"}),
        ("bench/endless/watch.py", code, {"watch", "chip"}),  # C watches, too
    ],
)
def test_a_change_of_code_makes_those_runs_stale_that_depend_on_it(file, edit, stale, changed):
    before = {name: key(kind) for name, kind in KINDS.items()}
    changed(file, edit)
    assert {name for name, kind in KINDS.items() if key(kind) != before[name]} == stale


def test_each_name_of_the_consumers_is_a_member_of_a_kind_or_a_circumstance():
    members = {name for room in ("kinds", "circumstances") for one in classes(room).values() for name in dir(one)}
    assert {name for one in (Shown, *classes("kinds").values()) for name in one.consumers} - members == set()


def test_no_protocol_depends_on_help_or_on_costs(changed):
    before = source.source_digest(transfer)
    for file in ("bench/options.py", "bench/arguments.py", "bench/measures.py"):
        changed(file, code)
        assert source.source_digest(transfer) == before
    changed("bench/amounts.py", code)
    assert source.source_digest(transfer) != before


def test_a_searched_run_depends_on_the_search_and_its_selection(changed):
    tuned = {"space": {"C": [1.0, 2.0]}}
    over = {"space": {}, "smallest": "features"}
    before = [key(tuning=tuned), key(tuning=over)]
    changed("features/selection.py", code)
    assert [key(tuning=tuned) == before[0], key(tuning=over) == before[1]] == [True, False]
    changed("models/search/tuning.py", code)
    assert key(tuning=tuned) != before[0]


def test_everything_else_that_numbers_depend_on_is_in_the_key(monkeypatch):
    keys = [
        key(),
        key(**{"data.subjects": "3"}),
        *(key(where=f"gesture != '{gesture}'") for gesture in ("pat", "tap")),  # as many captures, in the same places
        key(target="variant+gesture"),
        key(protocol="kfold", **{"protocol.folds": "2", "data.repetitions": "2"}),
        key(features="jung28"),
        key(model="bayes"),
        key(**{"model.C": "2"}),
        key(threads=2),
        key(tuning={"space": {"C": [1.0]}}),
        *map(key, list(KINDS.values())[1:]),
        key(Captures((Instants((), 250.0),))),
        key(Captures((Faults(("shift",)),))),
        key(Captures((Faults(("noise",)), Subjects((1,))))),
    ]
    assert len(set(keys)) == len(keys) and keys[0] == key()
    monkeypatch.setattr("bench.plan.cells.versions", lambda also: {"numpy": "0"})
    assert key() not in keys


def test_a_key_does_not_depend_on_what_was_imported_before():
    code = "import sys; sys.path.insert(0, sys.argv[1]); from tests.plan.test_identity import key; "
    said = [
        subprocess.run(
            [sys.executable, "-c", f"{code}{first}; print(key())", str(ROOT)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for first in ("pass", "import bench.models.rocket, bench.reports.page, bench.work.fit, bench.features.gaus")
    ]
    assert said[0] == said[1] == f"{key()}\n"


# A kind of run whose class also shows its numbers

KIND = """
from __future__ import annotations
from produced.counting import count, counted
from produced.colours import COLOURS
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from produced.types import Corpus

UNIT = "percent"
WIDE = {"a": UNIT}
PLAIN = 1
SHARED = 2
REACHED = 3

class Base:
    consumers: ClassVar[frozenset[str]] = frozenset({"heading", "shown", "result", "drawn", "unit", "size"})
    heading: ClassVar[str]

class Kind(Base):
    \"\"\"A kind.\"\"\"
    heading: ClassVar[str] = "Accuracy"

    def fold(self, corpus: Corpus):
        from produced.fitting import fit
        return fit() + _half(1) + self.unit()

    def unit(self):
        return 4 * _sized(self)

    def size(self):
        return 5

    @property
    def result(self):
        import produced.drawing
        return _page(WIDE), SHARED, REACHED, COLOURS, counted, Kind.shown

    def drawn(self):
        return self.result

def _sized(kind):
    return kind.size()

def _half(x):
    return x / 2 + SHARED

def _page(x):
    return [_row(x) for _ in range(3)]

def _row(x):
    from produced.pages import page
    return page(x) if x else _page(x)

Kind.shown = (COLOURS, count)
"""
KIND_FILES = {
    "__init__": "",
    "kind": KIND,
    "fitting": "def fit():\n    from . import scaling\n    return scaling.SCALE\n",
    "scaling": "import produced.steps\nSCALE = 1\n",
    "steps": "from produced.kind import REACHED\ndef step():\n    return 1\n",
    "colours": "COLOURS = 1\n",
    "counting": "def count():\n    return 1\ndef counted():\n    return 2\n",
    "drawing": "LINE = 1\n",
    "pages": "def page(x):\n    return 1\n",
}


@pytest.fixture(scope="module")
def produced(tmp_path_factory):
    """The folder of a package with such a kind."""
    folder = tmp_path_factory.mktemp("kinds") / "produced"
    folder.mkdir()
    for name, text in KIND_FILES.items():
        (folder / f"{name}.py").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder.parent)
        yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "produced"]:
        del sys.modules[name]


def other(old, new):
    return lambda text: text.replace(old.encode(), new.encode())


@pytest.mark.parametrize(
    ("file", "edit", "stale"),
    [
        ("kind", other("Accuracy", "Right"), False),
        ("kind", other('"size"})', '"size", "more"})'), False),
        ("kind", other("return self.result", "return 1"), False),
        ("kind", other("Kind.shown = (COLOURS, count)", "Kind.shown = (count,)"), False),
        ("kind", other("range(3)", "range(4)"), False),  # a helper of a consumer
        ("kind", other("page(x) if x", "page(1) if x"), False),  # a helper of the helper
        ("kind", other('"percent"', '"%"'), False),
        ("kind", other("import COLOURS", "import COLOURS, MORE as COLOURS"), False),
        ("kind", other("produced.types", "produced.kinds"), False),
        ("kind", other("A kind.", "Kind."), False),
        ("kind", comment, False),
        ("pages", code, False),  # imported late by a consumer
        ("drawing", code, False),
        ("colours", code, False),
        ("counting", code, False),
        ("kind", other("_half(1)", "_half(2)"), True),
        ("kind", other("x / 2", "x / 3"), True),  # a helper of the fold
        ("kind", other("PLAIN = 1", "PLAIN = 2"), True),  # used by nobody here
        ("kind", other("SHARED = 2", "SHARED = 3"), True),  # used by both
        ("kind", other("REACHED = 3", "REACHED = 4"), True),  # used by a consumer, and by another module
        ("kind", other("return 4", "return 5"), True),  # a consumer that the fold calls
        ("kind", other("return 5", "return 6"), True),  # and one that a helper of it calls
        ("fitting", code, True),  # imported late by the fold
        ("scaling", code, True),  # and late by that
        ("steps", code, True),  # and by that when it is loaded
        ("fitting", comment, False),
    ],
)
def test_what_a_kind_shows_is_no_part_of_what_it_measures(file, edit, stale, produced, changed):
    kind = importlib.import_module("produced.kind").Kind
    before = source.source_digest(kind)
    changed(produced / f"{file}.py", edit)
    assert (source.source_digest(kind) != before) == stale


def test_late_imports_of_other_files_are_not_followed(produced, changed):
    fit = importlib.import_module("produced.fitting").fit
    before = source.source_digest(fit)
    changed(produced / "scaling.py", code)
    assert source.source_digest(fit) == before


def test_a_late_import_counts_whether_or_not_somebody_else_made_it_before(produced):
    code = (
        "import sys; sys.path[:0] = sys.argv[1:]; from bench import source; {}import produced.kind as k; "
        "print(source.source_digest(k.Kind))"
    )
    said = {
        subprocess.run(
            [sys.executable, "-c", code.format(first), str(ROOT), str(produced.parent)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for first in ("", "import produced.scaling; ", "import produced.drawing, produced.pages, produced.fitting; ")
    }
    assert said == {f"{source.source_digest(importlib.import_module('produced.kind').Kind)}\n"}


@pytest.mark.parametrize("beside", ["nets_of_mine/__init__.py", ""])
@pytest.mark.parametrize("late", [False, True])
def test_what_a_file_imports_from_beside_it_counts_also_late(tmp_path, monkeypatch, beside, late):
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "modules", dict(sys.modules))  # what is imported here is forgotten
    package = tmp_path / "nets_of_mine"
    package.mkdir()
    if beside:
        (tmp_path / beside).touch()
    (package / "net.py").write_text("def Net():\n    return 1\n")
    line = "from nets_of_mine.net import Net\n"
    text = f"def mine():\n    {line}    return Net()\n" if late else f"{line}def mine():\n    return Net()\n"
    (tmp_path / "wrap.py").write_text(text)
    part = load("models", f"{tmp_path / 'wrap.py'}:mine")
    before = source.source_digest(part)
    (package / "net.py").write_text("def Net():\n    return 22\n")
    assert source.source_digest(part) != before


def test_python_s_own_modules_lie_beside_no_file():
    """As where Python is installed below the folder of the file, such as a home."""
    import json

    import numpy

    folders = [Path(json.__file__).parents[4], Path(numpy.__file__).parents[4]]
    assert not any(lies_beside(module.__file__, folders) for module in (json, numpy, subprocess))
    assert lies_beside(str(folders[0] / "mine" / "net.py"), folders)
