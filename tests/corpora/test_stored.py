"""Stored corpora: damage is refused in one line and mended; generated corpora are made again."""

import json
import multiprocessing
import os
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from bench.cli import main
from bench.corpora import library, synth
from bench.corpora.folder import content_digest, find_damage, open_folder, write_folder
from bench.corpora.library import import_corpus, open_corpus
from bench.errors import InputError
from bench.ground.scratch import data_folder, use_scratch_folder
from tests.conftest import random_corpus
from tests.corpora.made import GOOD, csv


@pytest.fixture
def stored(corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    return tmp_path / "c"


def refusal(function, *arguments):
    """The one line with which a damaged corpus is refused."""
    with pytest.raises(InputError) as error:
        function(*arguments)
    message = str(error.value)
    assert "import it again" in message and "\n" not in message and len(message) <= 300
    return message


def flip_bit(path, keep_time=False):
    times, content = path.stat(), bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)
    if keep_time:
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def halve(path):
    os.truncate(path, path.stat().st_size // 2)


def halve_rate(path):
    path.write_text(path.read_text().replace('"rate_hz": 100.0', '"rate_hz": 50.0'))


def replace_by_pipe(path):
    path.unlink()
    os.mkfifo(path)


def enlarge(path):
    os.truncate(path, (1 << 24) + 1)


OTHER_SHAPES = ("null", "{}", '{"info": 5}', '{"info": "a"}', "[" * 200_000)
HARMS = [
    *product(["frames.npy", "lengths.npy", "captures.parquet"], [flip_bit, halve, Path.unlink]),
    ("frames.npy", lambda path: flip_bit(path, keep_time=True)),
    *product(["corpus.json"], [Path.unlink, halve, halve_rate]),
    *product(["corpus.json"], [replace_by_pipe, enlarge]),
    *(("corpus.json", lambda path, text=text: path.write_text(text)) for text in OTHER_SHAPES),
]


@pytest.mark.parametrize(("name", "harm"), HARMS)
def test_a_damaged_file_is_refused_found_and_replaced(stored, corpus, name, harm):
    harm(stored / name)
    assert name in refusal(open_folder, stored)
    defects = find_damage(stored)
    assert defects[name] and (name == "corpus.json" or sum(map(bool, defects.values())) == 1)
    write_folder(corpus, stored)
    assert not any(find_damage(stored).values())
    assert np.array_equal(open_folder(stored).frames, corpus.frames)
    assert [path.name for path in stored.parent.iterdir() if path.name != "home"] == ["c"]


def test_frames_are_hashed_only_when_they_look_different(stored, corpus):
    frames, seal = stored / "frames.npy", stored / "seal.json"
    first = seal.stat().st_mtime_ns
    assert open_folder(stored).digest == content_digest(corpus)
    assert seal.stat().st_mtime_ns == first
    os.utime(frames)
    open_folder(stored)
    second = seal.stat().st_mtime_ns
    open_folder(stored)
    assert first != second == seal.stat().st_mtime_ns
    flip_bit(frames)
    assert "frames.npy differs" in refusal(open_folder, stored)
    flip_bit(frames)  # undone
    assert np.array_equal(open_folder(stored).frames, corpus.frames)


@pytest.mark.parametrize("harm", [replace_by_pipe, enlarge, lambda p: p.write_text("[" * 200_000)])
def test_what_is_no_seal_is_replaced(stored, corpus, harm):
    harm(stored / "seal.json")
    assert open_folder(stored).digest == content_digest(corpus)
    assert len(json.loads((stored / "seal.json").read_text())) == 5


def test_a_generated_corpus_under_another_name_is_refused(stored):
    stored.rename(stored.with_name("d"))
    assert "corpus.json was written for c" in refusal(open_folder, stored.with_name("d"))


def test_damage_that_cannot_be_seen_from_outside_is_found_by_verifying(stored):
    frames, seal = stored / "frames.npy", stored / "seal.json"
    flip_bit(frames, keep_time=True)
    contents = json.loads(seal.read_text())
    seal.write_text(json.dumps([*contents[:3], frames.stat().st_ctime_ns, *contents[4:]]))
    open_folder(stored)
    assert [name for name, defect in find_damage(stored).items() if defect] == ["frames.npy"]
    refusal(open_folder, stored)  # from now on


OPTIONS = {"name": "arm", "rate_hz": "50", "grid": "1x2"}


def leftovers():
    return [path.name for path in data_folder().rglob(".*") if not path.name.endswith(".lock")]


@pytest.mark.parametrize("step", ["numpy.save", "pathlib.Path.rename", "os.replace"])
def test_an_import_that_dies_leaves_the_earlier_corpus(tmp_path, monkeypatch, step):
    path = csv(tmp_path)
    import_corpus("table", path, OPTIONS)
    csv(tmp_path, *(row.replace("ann", "bob") for row in GOOD))
    with monkeypatch.context() as patch:
        patch.setattr(step, lambda *_, **__: os._exit(9))  # without any clean-up
        process = multiprocessing.get_context("fork").Process(
            target=import_corpus, args=("table", path, OPTIONS)
        )
        process.start()
        process.join(60)
    assert process.exitcode == 9
    assert leftovers() and open_corpus("arm", {}).subjects.tolist() == ["ann"]
    with use_scratch_folder():  # as the next command does
        assert not leftovers()
    assert import_corpus("table", path, OPTIONS).subjects.tolist() == ["bob"]
    folder = data_folder() / "corpora" / "arm"
    assert {path.name for path in folder.iterdir()} == {"current", (folder / "current").read_text()}


@pytest.fixture
def import_random(monkeypatch):
    """A function that imports a random corpus; ``arm`` is imported."""

    def reader(path, seed):
        return random_corpus(seed=int(seed), info={"source": "x"})

    def import_random(name="arm", seed="0"):
        return import_corpus("any", data_folder(), {"name": name, "seed": seed})

    monkeypatch.setattr(library, "load_part", lambda *_: reader)
    import_random()
    return import_random


@pytest.mark.parametrize("text", ["", "../other/0123456789abcdef", "0123456789abcdef"])
def test_a_name_without_its_corpus_is_refused_until_the_next_import(import_random, text):
    pointer = data_folder() / "corpora" / "arm" / "current"
    good = pointer.read_text()
    pointer.write_text(text)
    refusal(open_corpus, "arm", {})
    import_random()
    assert pointer.read_text() == good and len(open_corpus("arm", {})) == 36


def test_verifying_finds_a_copied_folder_and_a_damaged_name(import_random, capsys):
    corpora = data_folder() / "corpora"
    shutil.copytree(corpora / "arm", corpora / "leg")
    assert main(["data", "verify", "leg"]) == 1
    assert "it is a copy of arm" in capsys.readouterr().out
    import_random("leg")
    assert main(["data", "verify", "leg"]) == 0
    (corpora / "arm" / "current").write_text("x")
    assert main(["data", "verify", "arm"]) == 1
    assert "current  damaged: names no corpus" in capsys.readouterr().out
    assert main(["data", "verify", "arm+leg"]) == 2
    assert "give one corpus at a time" in capsys.readouterr().err


def test_an_import_replaces_a_link_and_not_its_file(import_random, tmp_path):
    pointer, other = data_folder() / "corpora" / "arm" / "current", tmp_path / "other"
    other.write_text("mine")
    pointer.unlink()
    pointer.symlink_to(other)
    import_random()
    assert other.read_text() == "mine" and len(open_corpus("arm", {})) == 36


def test_a_second_import_under_one_name_is_refused_at_once(import_random):
    with FileLock(data_folder() / "corpora" / ".arm.lock"):
        with pytest.raises(InputError, match="another import of name=arm is under way"):
            import_random()
    with pytest.raises(InputError, match="no such file"):
        import_corpus("table", Path("nosuch.csv"), {})


def test_a_damaged_corpus_does_not_hide_the_others(import_random, capsys):
    flip_bit(import_random("leg", "1").path / "frames.npy")
    assert main(["data"]) == 0
    out = capsys.readouterr().out
    assert "import it again" in out and "arm\n  36 captures" in out
    assert main(["run", "data=leg"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "frames.npy differs" in error and "import it again" in error


def test_a_damaged_generated_corpus_is_generated_again():
    parameters = {"subjects": 1, "variants": ("normal",), "repetitions": 1}
    expected = synth.generate(**parameters)
    folder = open_corpus("synth", parameters).path
    flip_bit(folder / "frames.npy")
    assert main(["data", "verify", "synth"]) == 1
    again = open_corpus("synth", parameters)
    assert np.array_equal(again.frames, expected.frames) and again.path == folder
    assert again.captures.equals(expected.captures)
    assert main(["data", "verify", "synth"]) == 0


def test_joined_corpora_follow_their_parts(import_random):
    import_random("leg", "1")
    before = open_corpus("arm+leg", {})
    assert len({*before.subjects}) == 8
    import_random("leg", "3")
    assert open_corpus("arm+leg", {}).digest != before.digest
    for name in ("arm+arm", "arm+synth", "arm+", "arm+toe"):
        with pytest.raises(InputError, match=r"join the names|not imported"):
            open_corpus(name, {})
