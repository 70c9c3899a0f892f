"""What changes the key of a run, and what does not (docs/notes/decisions.md, identity)."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from bench import source
from bench.corpora.faults import FAULTS
from bench.plan.cells import cells
from bench.plan.plan import Plan, corpus_of, folds_of
from bench.work.evaluation import Evaluation
from bench.work.stream import Stream
from bench.work.stress import Stress
from bench.work.tracking import key_of
from protocols import transfer

ROOT = Path(source.__file__).parent.parent
KINDS = {"run": Evaluation(), "stress": Stress((FAULTS["noise"],)), "stream": Stream()}


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
        again = lambda file, when: whole(file, when) if Path(file) == path else meaning(file, when)  # noqa: E731
        again.__wrapped__ = whole
        monkeypatch.setattr(source, "meaning", again)

    return change


def comment(text):
    return text + b"\n# a remark\n"


def code(text):
    return text + b"\nANOTHER = 1\n"


@pytest.mark.parametrize(
    ("file", "edit", "stale"),
    [
        ("models/search/tuning.py", comment, set()),
        ("models/search/tuning.py", code, set()),  # svm is not searched
        ("models/classic/svm.py", comment, set()),
        ("models/classic/svm.py", lambda text: text.replace(b"Scaled features", b"Features, scaled"), set()),
        ("models/classic/svm.py", code, {*KINDS}),
        ("features/jung54.py", code, {*KINDS}),
        ("features/signals.py", code, {*KINDS}),
        ("features/cache.py", code, set()),
        ("protocols/subjects.py", code, {*KINDS}),
        ("bench/corpora/corpus.py", code, {*KINDS}),
        ("bench/corpora/folder.py", code, set()),
        ("bench/corpora/where.py", code, set()),
        ("bench/outcomes/scores.py", code, {*KINDS}),
        ("bench/outcomes/stopping.py", code, {"stream"}),
        ("bench/outcomes/stability.py", code, {"stress"}),
        ("bench/outcomes/store.py", code, set()),
        ("bench/outcomes/tables.py", code, set()),
        ("bench/outcomes/resampling.py", code, {*KINDS}),
        ("bench/measures.py", lambda text: text.replace(b'"flash kB"', b'"kB of flash"'), set()),  # a caption
        ("bench/measures.py", code, set()),
        ("bench/table.py", code, set()),
        ("bench/result.py", code, set()),
        ("bench/comparable.py", code, set()),
        ("bench/usual.py", code, {"stress"}),
        ("bench/work/evaluation.py", code, {"run"}),
        ("bench/work/stress.py", code, {"stress"}),
        ("bench/corpora/faults.py", code, {"stress"}),
        ("bench/work/loop.py", code, set()),
        ("bench/work/replay.py", code, {"stream"}),
        ("models/sizes.py", code, {*KINDS}),
        ("models/rocket.py", code, set()),
        ("models/__init__.py", code, set()),  # another name in the registry
        ("bench/contract.py", code, {*KINDS}),
    ],
)
def test_a_change_of_code_makes_those_runs_stale_that_depend_on_it(file, edit, stale, changed):
    before = {name: key(kind) for name, kind in KINDS.items()}
    changed(file, edit)
    assert {name for name, kind in KINDS.items() if key(kind) != before[name]} == stale


def test_no_protocol_depends_on_help_or_on_costs(changed):
    before = source.source_digest(transfer)
    for file in ("bench/options.py", "bench/arguments.py", "bench/measures.py"):
        changed(file, code)
        assert source.source_digest(transfer) == before
    changed("bench/amounts.py", code)
    assert source.source_digest(transfer) != before


def test_a_searched_run_depends_on_the_search_and_its_selection(changed):
    tuned = {"space": {"C": [1.0, 2.0]}}
    over = {"space": {}, "over": "features"}
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
        *(key(kind) for kind in (KINDS["stress"], KINDS["stream"], Stream(250.0), Stress((FAULTS["shift"],)))),
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
        for first in ("pass", "import models.rocket, reports.illustrations, bench.work.fit, features.gaus")
    ]
    assert said[0] == said[1] == f"{key()}\n"
