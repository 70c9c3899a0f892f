"""A process is killed (-9) while it writes into the data folder: the next one that writes there clears that away."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.corpora import library
from bench.corpora.files import clear
from bench.corpora.folder import open_folder, write_folder
from bench.corpora.library import import_corpus, open_corpus
from bench.scratch import home
from features.jung28 import Jung28
from tests.conftest import random_corpus

ROOT = Path(bench.__file__).parents[1]
SYNTH = {"subjects": 1, "variants": ("normal",)}
# Stops for good in the middle of writing.
START = """
import os, sys, time
from pathlib import Path
import numpy as np
import pandas as pd
from bench.corpora import library
from bench.corpora.corpus import Corpus
from bench.corpora.folder import open_folder, write_folder

def stop(*_, **__):
    print("writing", flush=True)
    time.sleep(600)

def corpus(*_):
    captures = pd.DataFrame({"subject": ["1", "2"], "gesture": ["pat", "rub"]})
    return Corpus.from_captures([np.ones((3, 2, 2), np.uint16)] * 2, captures, 100.0)

"""
STOP_ARRAYS = START + "np.save = stop\n"
STOP_TABLES = START + "pd.DataFrame.to_parquet = stop\n"
STOP_RENAMES = START + "os.replace = stop\n"


def hidden(place):
    return [p.name for p in place.rglob(".*") if not p.name.endswith(".lock")]


@pytest.fixture
def writing():
    """Starts a process and returns when it is in the middle of writing."""
    started = []

    def start(code, *arguments):
        process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments)], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout.readline() == "writing\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


def kill(process):
    process.kill()  # signal 9
    process.wait()


def test_a_corpus(writing, corpus, tmp_path):
    code = STOP_ARRAYS + "write_folder(corpus(), Path(sys.argv[1]))"
    dead, alive = (writing(code, tmp_path / "c" / name) for name in "ab")
    assert len(hidden(tmp_path / "c")) == 4
    kill(dead)
    write_folder(corpus, tmp_path / "c" / "d")
    left = hidden(tmp_path / "c")
    assert len(left) == 2 and sum(f"-{alive.pid}-" in name for name in left) == 2
    assert np.array_equal(open_folder(tmp_path / "c" / "d").frames, corpus.frames)
    kill(alive)
    write_folder(corpus, tmp_path / "c" / "a")
    assert not hidden(tmp_path / "c")


def test_what_belongs_to_others_stays(tmp_path):
    host = socket.gethostname()
    stay = [
        f".other-{2**22 + 1}-abcdefgh",
        f".{host}-2-{2**22 + 1}-abcdefgh",  # a machine whose name begins as ours
        f".{host}-{os.getpid()}-abcdefgh",
        f".{host}-1-abcdefgh",
        f".{host}-x-abcdefgh",
        f".{host}-{10**20}-abcdefgh",
        f"{host}-{2**22 + 1}-abcdefgh",
        ".arm.lock",
        ".hidden",
    ]
    for name in stay:
        (tmp_path / name).mkdir()
    (tmp_path / f".{host}-{2**22 + 1}-abcdefgh").mkdir()  # beyond the largest number of a process
    (tmp_path / f".{host}-{2**22 + 1}-abcdefgi").write_text("")
    (tmp_path / f".{host}-{2**22 + 1}-abcdefgj").symlink_to("/")
    clear(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(stay)


def test_an_import(writing, tmp_path, monkeypatch):
    def reader(source: Path, seed: float = 0):
        return random_corpus(seed=int(seed))

    monkeypatch.setattr(library, "load", lambda room, kind: reader)
    import_corpus("any", Path("x"), {"name": "arm"})
    before = (home() / "corpora" / "arm" / "current").read_text()
    code = "library.load = lambda room, kind: corpus\n"
    code += "library.import_corpus('any', Path('x'), {'name': 'arm'})"
    for stop in (STOP_ARRAYS, STOP_RENAMES):
        kill(writing(stop + code))
        assert hidden(home()) and len(open_corpus("arm", {})) == 36
        assert (home() / "corpora" / "arm" / "current").read_text() == before
    import_corpus("any", Path("x"), {"name": "arm", "seed": "1"})
    assert not hidden(home()) and open_corpus("arm", {}).digest.startswith(
        (home() / "corpora" / "arm" / "current").read_text()
    )
    assert (home() / "corpora" / ".arm.lock").exists()  # an empty file, one for each name, held by nobody


def test_a_generated_corpus(writing):
    code = f"library.open_corpus('synth', {SYNTH})"
    kill(writing(STOP_ARRAYS + code))
    kill(writing(STOP_TABLES + code))
    assert len(hidden(home())) == 2  # the second one cleared away what the first had left
    assert len(open_corpus("synth", SYNTH)) == 14
    assert not hidden(home())


def test_a_seal_that_is_made_anew(writing, corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    (tmp_path / "c" / "seal.json").unlink()
    kill(writing(STOP_RENAMES + "open_folder(Path(sys.argv[1]))", tmp_path / "c"))
    assert len(hidden(tmp_path)) == 1
    assert len(open_folder(tmp_path / "c")) == 36
    assert not hidden(tmp_path) and (tmp_path / "c" / "seal.json").exists()


def test_a_table_of_features(writing, corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    code = "from features.jung28 import Jung28; Jung28().transform(open_folder(Path(sys.argv[1])))"
    kill(writing(STOP_TABLES + code, tmp_path / "c"))
    kill(writing(STOP_RENAMES + code, tmp_path / "c"))
    assert len(hidden(home())) == 1
    assert Jung28().transform(open_folder(tmp_path / "c")).equals(Jung28().transform(corpus))
    assert not hidden(home()) and len(list((home() / "features").iterdir())) == 1
