"""Imported corpora by name: what points to them, what verifies them, and the generated one, which mends itself."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.corpora import library, synth
from bench.corpora.library import import_corpus, imported, open_corpus
from bench.errors import InputError
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.scratch import home
from tests.conftest import random_corpus
from tests.corpora.test_folder import flip

SYNTH = {"subjects": 1, "variants": ("normal",)}


@pytest.fixture
def arm(monkeypatch):
    """A function that imports a corpus under the name arm."""

    def reader(source: Path, seed: float = 0):
        return random_corpus(seed=int(seed), info={"source": str(source), "warnings": []})

    monkeypatch.setattr(library, "load", lambda room, kind: reader)

    def bring(name="arm", seed="0"):
        return import_corpus("any", Path("x"), {"name": name, "seed": seed})

    bring()
    return bring


def folder(name="arm"):
    (found,) = (p for p in (home() / "corpora" / name).iterdir() if p.is_dir())
    return found


WORDS = [b"", b"\xff\xfe\x00", b"../other/0123456789abcdef", b"0123456789abcdef", b"0" * 5000]


@pytest.mark.parametrize("content", [*WORDS, "folder", "pipe", "loop", "nowhere"])
def test_what_points_nowhere_or_outside_is_refused_and_mended_by_an_import(arm, content, capsys):
    pointer = home() / "corpora" / "arm" / "current"
    good = pointer.read_text()
    pointer.unlink()
    if content == "folder":
        pointer.mkdir()
    elif content == "pipe":
        os.mkfifo(pointer)
    elif content == "loop":
        pointer.symlink_to("current")
    elif content == "nowhere":
        pointer.symlink_to("nothing")
    else:
        pointer.write_bytes(content)
    with pytest.raises(InputError, match="import it again") as refused:
        open_corpus("arm", {})
    assert len(str(refused.value)) <= 300
    assert main(["data", "verify", "arm"]) == 1
    assert "arm: damaged" in capsys.readouterr().out
    if content in ("loop", "nowhere"):
        assert imported() == []
    arm()
    assert pointer.read_text() == good and not pointer.is_symlink() and len(open_corpus("arm", {})) == 36


def test_a_damaged_corpus_does_not_hide_the_others(arm, capsys):
    arm("leg", "1")
    flip(folder("arm") / "frames.npy")
    assert main(["data"]) == 0
    out = capsys.readouterr().out
    assert "import it again" in out and "leg\n  36 captures" in out
    assert main(["run", "data=arm"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "frames.npy differs" in error and "import it again" in error


def test_a_damaged_generated_corpus_is_generated_again(tmp_path, monkeypatch):
    expected = synth.generate(**SYNTH)
    made, real = [], synth.generate
    monkeypatch.setattr(synth, "generate", lambda **how: (made.append(1), real(**how))[1])

    def right():
        corpus = open_corpus("synth", SYNTH)
        return np.array_equal(corpus.frames, expected.frames) and corpus.captures.equals(expected.captures)

    assert right() and right() and len(made) == 1
    place = folder("synth")
    harms = [lambda n=name: flip(place / n) for name in ("frames.npy", "corpus.json")]
    harms += [lambda: (place / "lengths.npy").unlink(), lambda: (shutil.rmtree(place), place.write_text("a file"))]
    for count, harm in enumerate(harms, 2):
        harm()
        assert right() and right() and len(made) == count
    open_corpus("synth", SYNTH | {"seed": 1})
    one, other = sorted(p for p in place.parent.iterdir())
    one.rename(tmp_path / "one")
    other.rename(one)
    (tmp_path / "one").rename(other)  # swapped
    assert right() and main(["data", "verify", "synth"]) == 1  # the other one, until it is used
    open_corpus("synth", SYNTH | {"seed": 1})
    assert main(["data", "verify", "synth"]) == 0


def test_several_corpora_are_opened_as_one_for_any_protocol(arm):
    for name, seed in (("leg", "1"), ("hip", "2")):
        arm(name, seed)
    (plan,) = planned(cells({"data": "arm+leg+hip", "where": "corpus != 'hip'", "model": "lda"}), 1)
    assert plan.corpus.name == "arm+leg+hip" and len(set(plan.corpus.subjects)) == len(plan.folds) == 8
    for fold in plan.folds:
        assert not set(plan.corpus.subjects[fold.train]) & set(plan.corpus.subjects[fold.test])
    before = open_corpus("arm+leg", {}).digest
    arm("leg", "3")
    assert open_corpus("arm+leg", {}).digest != before
    for name in ("arm+arm", "arm+synth", "arm+", "arm+toe"):
        with pytest.raises(InputError, match=r"join the names|not imported"):
            open_corpus(name, {})
