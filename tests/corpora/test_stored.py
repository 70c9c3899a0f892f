"""A stored corpus that was changed, damaged or swapped is refused in one line, or made again if it was generated."""

import json
import multiprocessing
import os
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.corpora import library, synth
from bench.corpora.folder import content_digest, find_damage, open_folder, write_folder
from bench.corpora.library import import_corpus, imported_names, open_corpus
from bench.errors import InputError
from bench.ground.scratch import data_folder, use_scratch_folder
from bench.plan.cells import make_cells
from bench.plan.plan import make_plans
from tests.conftest import random_corpus
from tests.corpora.made import GOOD, csv


@pytest.fixture
def stored(corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    return tmp_path / "c"


def refused(opened, *arguments):
    """The one line."""
    with pytest.raises(InputError) as error:
        opened(*arguments)
    message = str(error.value)
    assert "import it again" in message and "\n" not in message and len(message) <= 300
    return message


def flip(path, as_before=False):
    """Turn one byte over, and set the times back."""
    times, content = path.stat(), bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)
    if as_before:
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def rewrite(change):
    return lambda path: path.write_text(change(path.read_text()))


HARMS = [
    flip,
    lambda path: flip(path, as_before=True),
    lambda path: os.truncate(path, 1 << 40),  # a hole of a terabyte
    Path.unlink,
    lambda path: (path.unlink(), os.mkfifo(path)),
    lambda path: (path.unlink(), path.symlink_to("/dev/zero")),
]
TEXTS = [
    rewrite(lambda text: text.replace('"rate_hz": 100.0', '"rate_hz": 50.0')),
    rewrite(lambda text: text.replace('"files"', '"others"')),
    *(
        rewrite(lambda _, text=text: text)
        for text in ("null", "[" * 100_000, '{"a": ' + "9" * 5000 + "}")
    ),
]
HARMED = [*product(["frames.npy"], HARMS), *product(["corpus.json"], HARMS + TEXTS)]


@pytest.mark.parametrize(
    ("name", "harm"), [*HARMED, ("lengths.npy", flip), ("captures.parquet", Path.unlink)]
)
def test_a_harmed_file_is_refused_found_and_mended(stored, corpus, name, harm):
    harm(stored / name)
    assert name in refused(open_folder, stored)
    wrong = find_damage(stored)
    assert wrong[name] and (name == "corpus.json" or sum(map(bool, wrong.values())) == 1)
    write_folder(corpus, stored)
    assert not any(find_damage(stored, "c").values())
    assert np.array_equal(open_folder(stored).frames, corpus.frames)
    assert [p.name for p in stored.parent.iterdir() if p.name != "home"] == ["c"]


def test_frames_are_hashed_when_they_look_different_and_only_then(stored, corpus):
    frames, seal = stored / "frames.npy", stored / "seal.json"
    written = {seal.stat().st_mtime_ns}
    assert (
        open_folder(stored).digest == content_digest(corpus)
        and {seal.stat().st_mtime_ns} == written
    )
    os.utime(frames)
    for _ in range(3):
        assert np.array_equal(open_folder(stored).frames, corpus.frames)
        written.add(seal.stat().st_mtime_ns)
    assert len(written) == 2  # the new look is remembered
    flip(frames)
    assert "frames.npy differs" in refused(open_folder, stored)
    flip(frames)  # undone
    assert np.array_equal(open_folder(stored).frames, corpus.frames)


def test_a_byte_with_all_clocks_set_back_is_found_by_verifying(stored):
    frames, seal = stored / "frames.npy", stored / "seal.json"
    flip(frames, as_before=True)
    look = json.loads(seal.read_text())
    seal.write_text(json.dumps([*look[:3], frames.stat().st_ctime_ns, *look[4:]]))
    open_folder(stored)  # all that is cheap to see is as it was
    assert [name for name, wrong in find_damage(stored).items() if wrong] == ["frames.npy"]
    refused(open_folder, stored)  # from now on


OPTIONS = {"name": "arm", "rate_hz": "50", "grid": "1x2"}


def hidden():
    return [p.name for p in data_folder().rglob(".*") if not p.name.endswith(".lock")]


@pytest.mark.parametrize("at", ["numpy.save", "pathlib.Path.rename", "os.replace"])
def test_an_import_that_dies_leaves_the_earlier_corpus(tmp_path, monkeypatch, at):
    path = csv(tmp_path)
    import_corpus("table", path, OPTIONS)
    csv(tmp_path, *(row.replace("ann", "bob") for row in GOOD))
    with monkeypatch.context() as patch:
        patch.setattr(at, lambda *_, **__: os._exit(9))  # without any clean-up
        process = multiprocessing.get_context("fork").Process(
            target=import_corpus, args=("table", path, OPTIONS)
        )
        process.start()
        process.join(60)
    assert process.exitcode == 9
    assert hidden() and open_corpus("arm", {}).subjects.tolist() == ["ann"]
    with use_scratch_folder():  # as the next command does
        assert not hidden()
    assert import_corpus("table", path, OPTIONS).subjects.tolist() == ["bob"]
    folder = data_folder() / "corpora" / "arm"
    assert {p.name for p in folder.iterdir()} == {"current", (folder / "current").read_text()}


@pytest.fixture
def bring(monkeypatch):
    """A function that imports a corpus; ``arm`` is imported."""
    monkeypatch.setattr(
        library,
        "load",
        lambda *_: lambda path, seed: random_corpus(seed=int(seed), info={"source": "x"}),
    )

    def bring(name="arm", seed="0"):
        return import_corpus("any", data_folder(), {"name": name, "seed": seed})

    bring()
    return bring


POINTERS = {
    "folder": lambda path: path.mkdir(),
    "pipe": os.mkfifo,
    "loop": lambda path: path.symlink_to("current"),
    "nowhere": lambda path: path.symlink_to("nothing"),
    "no text": lambda path: path.write_bytes(b"\xff\xfe\x00" * 5000),
    "outside": lambda path: path.write_text("../other/0123456789abcdef"),
    "none": lambda path: path.write_text("0123456789abcdef"),
}


@pytest.mark.parametrize("how", POINTERS)
def test_what_points_nowhere_or_outside_is_refused_and_mended_by_an_import(bring, how, capsys):
    pointer = data_folder() / "corpora" / "arm" / "current"
    good = pointer.read_text()
    pointer.unlink()
    POINTERS[how](pointer)
    refused(open_corpus, "arm", {})
    assert main(["data", "verify", "arm"]) == 1
    assert "arm: damaged" in capsys.readouterr().out
    if how in ("loop", "nowhere"):
        assert imported_names() == []
    bring()
    assert (
        pointer.read_text() == good
        and not pointer.is_symlink()
        and len(open_corpus("arm", {})) == 36
    )


def test_a_damaged_corpus_does_not_hide_the_others(bring, capsys):
    flip(bring("leg", "1").path / "frames.npy")
    assert main(["data"]) == 0
    out = capsys.readouterr().out
    assert "import it again" in out and "arm\n  36 captures" in out
    assert main(["run", "data=leg"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "frames.npy differs" in error and "import it again" in error


SYNTH = {"subjects": 1, "variants": ("normal",), "repetitions": 1}


def test_a_damaged_generated_corpus_is_generated_again(monkeypatch):
    expected = synth.generate(**SYNTH)
    generated, real = [], synth.generate
    monkeypatch.setattr(synth, "generate", lambda **how: (generated.append(1), real(**how))[1])

    def right():
        corpus = open_corpus("synth", SYNTH)
        return np.array_equal(corpus.frames, expected.frames) and corpus.captures.equals(
            expected.captures
        )

    assert right() and right() and len(generated) == 1
    place, other = (open_corpus("synth", SYNTH | more).path for more in ({}, {"seed": 1}))
    harms = [lambda: place.write_text("a file"), lambda: shutil.copytree(other, place)]
    for count, harm in enumerate(harms, 3):
        shutil.rmtree(place)
        harm()
        assert right() and right() and len(generated) == count
    flip(place / "frames.npy")
    assert main(["data", "verify", "synth"]) == 1
    assert right() and len(generated) == 5 and main(["data", "verify", "synth"]) == 0


def test_several_corpora_are_opened_as_one_for_any_protocol(bring):
    for name, seed in (("leg", "1"), ("hip", "2")):
        bring(name, seed)
    (plan,) = make_plans(
        make_cells({"data": "arm+leg+hip", "where": "corpus != 'hip'", "model": "lda"}), 1
    )
    assert (
        plan.corpus.name == "arm+leg+hip" and len(set(plan.corpus.subjects)) == len(plan.folds) == 8
    )
    before = open_corpus("arm+leg", {}).digest
    bring("leg", "3")
    assert open_corpus("arm+leg", {}).digest != before
    for name in ("arm+arm", "arm+synth", "arm+", "arm+toe"):
        with pytest.raises(InputError, match=r"join the names|not imported"):
            open_corpus(name, {})
