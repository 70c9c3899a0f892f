"""A stored corpus that was changed, harmed or swapped is refused in one line; one that is the same is used."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.corpora import folder as module
from bench.corpora.folder import content_digest, open_folder, verified, write_folder
from bench.corpora.library import import_corpus, open_corpus
from bench.errors import InputError
from bench.scratch import home, scratch
from tests.conftest import random_corpus
from tests.corpora.made import GOOD, csv

PARTS = [*module.FILES, "corpus.json"]


@pytest.fixture
def stored(corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    return tmp_path / "c"


def refused(folder, key=""):
    """The one line."""
    with pytest.raises(InputError) as error:
        open_folder(folder, key)
    message = str(error.value)
    assert "import it again" in message and "\n" not in message and len(message) <= 300
    return message


def flip(path, at=-5, as_before=False):
    """Turn one byte over, and set the times back."""
    times, content = path.stat(), bytearray(path.read_bytes())
    content[at] ^= 16
    path.write_bytes(content)
    if as_before:
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


HARM = {
    "flipped": lambda path: flip(path, path.stat().st_size // 2),
    "flipped, times set back": lambda path: flip(path, path.stat().st_size // 2, as_before=True),
    "a hole of a terabyte": lambda path: os.truncate(path, 1 << 40),
    "gone": lambda path: path.unlink(),
    "a pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "a device": lambda path: (path.unlink(), path.symlink_to("/dev/zero")),
}


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("how", HARM)
def test_a_harmed_file_is_refused_found_and_mended(stored, corpus, name, how):
    HARM[how](stored / name)
    assert name in refused(stored)
    wrong = verified(stored)
    assert wrong[name] and (name == "corpus.json" or sum(map(bool, wrong.values())) == 1)
    write_folder(corpus, stored)
    assert not any(verified(stored, "c").values())
    assert np.array_equal(open_folder(stored).frames, corpus.frames)
    assert [p.name for p in stored.parent.iterdir() if p.name != "home"] == ["c"]


@pytest.mark.parametrize(
    "change",
    [
        lambda about: about.update(rate_hz=50.0),
        lambda about: about["info"].update(synthetic=True),
        lambda about: about["info"]["stored"].pop("files") and None,
        *(lambda _, text=text: text for text in ("null", "[" * 100_000, '{"a": ' + "9" * 5000 + "}")),
    ],
)
def test_another_corpus_json_is_refused(stored, change):
    about = json.loads((stored / "corpus.json").read_text())
    changed = change(about)
    text = changed if isinstance(changed, str) else json.dumps(about if changed is None else changed)
    (stored / "corpus.json").write_text(text)
    refused(stored)
    assert any(verified(stored).values())


def test_frames_are_hashed_when_they_look_different_and_only_then(stored, corpus):
    frames, seal = stored / "frames.npy", stored / "seal.json"
    written = {seal.stat().st_mtime_ns}
    assert open_folder(stored).digest == content_digest(corpus) and {seal.stat().st_mtime_ns} == written
    os.utime(frames)
    for _ in range(3):
        assert np.array_equal(open_folder(stored).frames, corpus.frames)
        written.add(seal.stat().st_mtime_ns)
    assert len(written) == 2  # the new look is remembered
    flip(frames)
    assert "frames.npy differs" in refused(stored)
    flip(frames)  # undone
    assert np.array_equal(open_folder(stored).frames, corpus.frames)


def test_a_byte_with_all_clocks_set_back_is_found_by_verifying(stored):
    frames = stored / "frames.npy"
    flip(frames, as_before=True)
    seal = json.loads((stored / "seal.json").read_text())
    seal[3] = frames.stat().st_ctime_ns
    (stored / "seal.json").write_text(json.dumps(seal))
    open_folder(stored)  # all that is cheap to see is as it was
    assert [name for name, wrong in verified(stored).items() if wrong] == ["frames.npy"]
    refused(stored)  # from now on


def test_files_of_another_corpus_are_refused(stored, tmp_path):
    write_folder(random_corpus(seed=1, gestures=("hit", "rub", "tap")), tmp_path / "d")
    for names in (["frames.npy"], ["corpus.json", "lengths.npy", "captures.parquet"]):
        shutil.copytree(stored, tmp_path / "e", dirs_exist_ok=True)
        for name in names:
            shutil.copy(tmp_path / "d" / name, tmp_path / "e" / name)
        refused(tmp_path / "e")
    (tmp_path / "d").rename(tmp_path / "f")
    assert len(open_folder(tmp_path / "f")) == 36
    assert "written for d" in refused(tmp_path / "f", key="f")  # where names matter


# A process that dies


ROOT = Path(bench.__file__).parents[1]
OPTIONS = {"name": "arm", "rate_hz": "50", "grid": "1x2"}


# Ends at once, without any clean-up, when it calls the function that is named first.
DYING = """
import os, sys, numpy as np, pandas as pd
from pathlib import Path
from bench.corpora.library import import_corpus
die = lambda *_, **__: os._exit(9)
exec(sys.argv[1] + " = die")
exec(sys.argv[2])
"""


def hidden():
    return [p.name for p in home().rglob(".*") if not p.name.endswith(".lock")]


@pytest.mark.parametrize("at", ["np.save", "Path.rename", "os.replace"])
def test_an_import_that_dies_leaves_the_earlier_corpus(tmp_path, at):
    import_corpus("table", csv(tmp_path), OPTIONS)
    csv(tmp_path, *(row.replace("ann", "bob") for row in GOOD))
    code = f"import_corpus('table', Path({str(tmp_path / 'my.csv')!r}), {OPTIONS})"
    assert subprocess.run([sys.executable, "-c", DYING, at, code], cwd=ROOT).returncode == 9
    assert hidden() and open_corpus("arm", {}).subjects.tolist() == ["ann"]
    with scratch():  # as the next command does
        assert not hidden()
    assert import_corpus("table", tmp_path / "my.csv", OPTIONS).subjects.tolist() == ["bob"]
    folder = home() / "corpora" / "arm"
    assert {p.name for p in folder.iterdir()} == {"current", (folder / "current").read_text()}
