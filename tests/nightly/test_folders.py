"""The data folder with random damage: what is opened is what was stored, or it is refused and an import mends it."""

import json
import os
import shutil

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora import library, synth
from bench.corpora.corpus import Corpus
from bench.corpora.library import import_corpus, open_corpus, verify
from bench.errors import InputError
from features import cache
from features.jung28 import Jung28
from tests.nightly.bounded import bounded

pytestmark = pytest.mark.nightly
NAMES = ("arm", "leg")
GENERATED = {"subjects": 1, "variants": ("normal",), "rows": 3, "cols": 3}
ODD = [None, True, -1, 10**400, float("nan"), "", "\ud800", "0" * 64, [], [1], {}, {"a": {}}]
TEXTS = [b"", b"null", b"[" * 50_000, b'{"name": 1, "name": 2}', b"9" * 5000, b"../arm", b"0" * 16, b"\xff\xfe"]


def made(name):
    """The corpus that an import of this name reads."""
    rng = np.random.default_rng(NAMES.index(name))
    arrays = [rng.integers(0, 1000, (int(rng.integers(2, 9)), 3, 4)).astype(np.uint16) for _ in range(12)]
    captures = pd.DataFrame({"subject": np.repeat(["1", "2", "3"], 4), "gesture": ["pat", "rub", "tap"] * 4})
    captures["force"] = np.where(rng.random(12) < 0.3, np.nan, rng.random(12))
    return Corpus.from_captures(arrays, captures, 100.0 + NAMES.index(name), info={"source": name, "warnings": []})


def same(one, other):
    return (
        np.array_equal(one.frames, other.frames)
        and np.array_equal(one.lengths, other.lengths)
        and one.captures.astype(str).equals(other.captures.astype(str))
        and (one.rate_hz, one.full_scale, one.info["source"]) == (other.rate_hz, other.full_scale, other.info["source"])
    )


def bring(name):
    return import_corpus("any", name, {"name": name})


def used(home, harmless):
    """Open, verify and use all that is in a data folder."""
    os.environ["TOUCHBENCH_HOME"] = str(home)
    cache._read.cache_clear()
    for name in NAMES:
        expected = made(name)
        try:
            corpus = open_corpus(name, {})
            assert not any(verify(name).values()), "opened, and verified as damaged"
        except InputError as e:
            message = str(e)
            assert len(message) <= 300 and message.isprintable() and "mport it" in message, message
            assert not harmless, message
            bring(name)
            corpus = open_corpus(name, {})
        assert corpus.name == name and same(corpus, expected) and not any(verify(name).values())
        assert Jung28().transform(corpus).equals(Jung28().extract(expected))
    corpus, expected = open_corpus("synth", GENERATED), synth.generate(**GENERATED)
    assert same(corpus, expected) and corpus.synthetic
    assert Jung28().transform(corpus).equals(Jung28().extract(expected))
    assert not [p for p in home.rglob(".*") if not p.name.endswith(".lock")]


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A data folder with two imported corpora, a generated one and their features."""
    home = tmp_path_factory.mktemp("template")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TOUCHBENCH_HOME", str(home))
        patch.setattr(library, "load", lambda room, kind: lambda source: made(source))
        for name in NAMES:
            bring(name)
        used(home, True)
        yield home


def changed_json(data, path):
    value = inside = json.loads(path.read_text())
    while isinstance(inside, dict | list) and inside:
        key = data.draw(st.sampled_from(sorted(inside) if isinstance(inside, dict) else range(len(inside))))
        if not isinstance(inside[key], dict | list) or data.draw(st.booleans()):
            inside[key] = data.draw(st.sampled_from(ODD))
            break
        inside = inside[key]
    return json.dumps(value).encode()


def changed_content(data, path, others):
    content = path.read_bytes()
    at = data.draw(st.integers(0, max(0, len(content) - 1)))
    how = data.draw(st.sampled_from(["flip", "cut", "longer", "blank", "text", "other", "json", "same"]))
    if how == "json" and path.suffix == ".json":
        return changed_json(data, path)
    return {
        "flip": content[:at] + bytes([content[at] ^ 1 << at % 8]) + content[at + 1 :] if content else b"x",
        "cut": content[:at],
        "longer": content + content[:at],
        "blank": content[:at] + bytes(64) + content[at + 64 :],
        "text": data.draw(st.sampled_from(TEXTS)),
        "other": data.draw(st.sampled_from(others)).read_bytes(),
    }.get(how, content)


@given(st.data())
def test_damage_is_refused_or_does_not_count(template, tmp_path, data):
    home = tmp_path / "copy"
    shutil.rmtree(home, ignore_errors=True)
    shutil.copytree(template, home)
    for seal in home.rglob("seal.json"):  # else the copy itself looks changed
        status = (seal.parent / "frames.npy").stat()
        look = [status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]
        seal.write_text(json.dumps([json.loads(seal.read_text())[0], *look]))
    harmless = True
    for _ in range(data.draw(st.integers(1, 3))):
        paths = sorted(p for p in home.rglob("[!.]*") if p.is_file() and not p.is_symlink())
        path, how = data.draw(st.sampled_from(paths)), data.draw(st.sampled_from(["content"] * 6 + ["kind", "swap"]))
        before, times = path.read_bytes(), path.stat()
        if how == "content":
            content = changed_content(data, path, paths)
            path.unlink() if data.draw(st.booleans()) else None
            path.write_bytes(content)
            if data.draw(st.booleans()):
                os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            same_bytes = content == before
        elif how == "kind":
            path.unlink()
            match data.draw(st.sampled_from(["gone", "folder", "pipe", "loop", "device", "hole"])):
                case "folder":
                    path.mkdir()
                case "pipe":
                    os.mkfifo(path)
                case "loop":
                    path.symlink_to(path.name)
                case "device":
                    path.symlink_to("/dev/zero")
                case "hole":
                    path.touch()
                    os.truncate(path, 1 << 40)
            same_bytes = False
        else:
            one, other = data.draw(st.permutations([p.parent for p in paths if p.name == "corpus.json"]))[:2]
            one.rename(home / "aside")
            other.rename(one) if other != one and other.exists() else None
            (home / "aside").rename(other)
            same_bytes = False
        harmless &= same_bytes or path.name == "seal.json" or "features" in path.parts
    bounded(used, home, harmless, seconds=60)
