"""A stored corpus that was changed, harmed or swapped is refused in one line; one that is the same is used."""

import json
import os
import shutil

import numpy as np
import pandas as pd
import pytest

from bench.corpora import files
from bench.corpora import folder as module
from bench.corpora.folder import content_digest, open_folder, verified, write_folder
from bench.errors import InputError
from tests.conftest import random_corpus


@pytest.fixture
def stored(corpus, tmp_path):
    write_folder(corpus, tmp_path / "c")
    return tmp_path / "c"


def refused(folder, key=""):
    """The one line."""
    with pytest.raises(InputError) as found:
        open_folder(folder, key)
    message = str(found.value)
    assert "import it again" in message and "\n" not in message and len(message) <= 300
    return message


def flip(path, at=-5, as_before=False):
    """Turn one byte over, and set the times back."""
    times = path.stat()
    content = bytearray(path.read_bytes())
    content[at] ^= 16
    path.write_bytes(content)
    if as_before:
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def edit(path, change):
    value = json.loads(path.read_text())
    other = change(value)
    path.write_text(json.dumps(value if other is None else other))


def hashed(monkeypatch):
    """How often frames were hashed from here on."""
    asked, real = [], files.sha256_of
    for place in (files, module):
        monkeypatch.setattr(place, "sha256_of", lambda path: (asked.append(path.name), real(path))[1])
    return asked


@pytest.mark.parametrize("name", ["frames.npy", "lengths.npy", "captures.parquet", "corpus.json"])
@pytest.mark.parametrize("how", ["flip", "cut", "empty", "gone", "folder", "longer", "pipe", "loop"])
def test_a_harmed_file_is_refused_and_found(stored, name, how):
    path = stored / name
    content = path.read_bytes()
    if how == "flip":
        flip(path, len(content) // 2)
    elif how == "cut":
        path.write_bytes(content[:-1])
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "longer":
        path.write_bytes(content + content)
    else:
        path.unlink()
        if how == "folder":
            path.mkdir()
        elif how == "pipe":
            os.mkfifo(path)
        elif how == "loop":
            path.symlink_to(name)
    assert name in refused(stored)
    assert verified(stored)[name]


def test_frames_are_hashed_when_they_look_different_and_only_then(stored, corpus, monkeypatch):
    asked = hashed(monkeypatch)
    frames = stored / "frames.npy"
    for _ in range(3):
        assert open_folder(stored).digest == content_digest(corpus)
    assert asked == []
    os.utime(frames)
    for _ in range(3):
        assert np.array_equal(open_folder(stored).frames, corpus.frames)
    assert asked == ["frames.npy"]  # once, and the new look is remembered
    shutil.copy(frames, stored / "copy")
    os.replace(stored / "copy", frames)
    assert np.array_equal(open_folder(stored).frames, corpus.frames) and len(asked) == 2
    flip(frames)
    assert "frames.npy differs" in refused(stored)
    flip(frames)  # undone
    assert np.array_equal(open_folder(stored).frames, corpus.frames)
    assert sorted(p.name for p in stored.iterdir()) == sorted(["seal.json", "corpus.json", *module.FILES])


def test_a_byte_with_its_time_set_back_is_found_by_verifying(stored, monkeypatch):
    frames = stored / "frames.npy"
    flip(frames, as_before=True)
    seal = json.loads((stored / "seal.json").read_text())
    seal[3] = frames.stat().st_ctime_ns  # a clock set back, too
    (stored / "seal.json").write_text(json.dumps(seal))
    open_folder(stored)  # all that is cheap to see is as it was
    found = verified(stored)
    assert found["frames.npy"] and not any(wrong for name, wrong in found.items() if name != "frames.npy")
    refused(stored)  # from now on


def test_labels_that_were_shuffled_are_refused_though_their_file_looks_the_same(stored):
    path = stored / "captures.parquet"
    times = path.stat()
    table = pd.read_parquet(path)
    table["gesture"] = np.roll(table["gesture"], 1)
    table.to_parquet(path, index=False)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert "captures.parquet" in refused(stored)


@pytest.mark.parametrize(
    "change",
    [
        lambda about: about.update(rate_hz=50.0),
        lambda about: about.update(rate_hz="100"),
        lambda about: about.update(rate_hz=None),
        lambda about: about.update(rate_hz=float("nan")),
        lambda about: about.update(full_scale=1024.0),
        lambda about: about.update(full_scale=-1),
        lambda about: about.update(digest="0" * 64),
        lambda about: about.update(digest=7),
        lambda about: about.update(name="other"),
        lambda about: about["info"].update(synthetic=True),
        lambda about: about["info"].pop("stored") and None,
        lambda about: about["info"]["stored"].pop("files") and None,
        lambda about: about["info"]["stored"]["files"]["frames.npy"].reverse(),
        lambda about: about["info"].update(stored=[]),
        lambda about: about.update(info=None),
        lambda about: about.update(extra=1),
        lambda about: about.pop("name") and None,
        lambda about: [about],
        lambda about: {"name": "arm"},
    ],
)
def test_another_corpus_json_is_refused(stored, change):
    edit(stored / "corpus.json", change)
    refused(stored)
    assert any(verified(stored).values())


@pytest.mark.parametrize("text", ["", "null", "[" * 100_000, '{"name": ' + "9" * 5000 + "}", "\0", '"\\ud800"'])
def test_a_corpus_json_that_says_nothing_is_refused(stored, text):
    (stored / "corpus.json").write_text(text)
    refused(stored)


@pytest.mark.parametrize("name", ["frames.npy", "lengths.npy", "captures.parquet", "corpus.json", "seal.json"])
def test_a_file_with_a_hole_of_a_terabyte_is_not_read(stored, corpus, name):
    os.truncate(stored / name, 1 << 40) if (stored / name).exists() else None
    if name == "seal.json":
        assert np.array_equal(open_folder(stored).frames, corpus.frames)
    else:
        refused(stored)
        assert any(verified(stored).values())
        write_folder(corpus, stored)
    assert not any(verified(stored).values())


@pytest.mark.parametrize("text", [None, "", "[]", "[" * 100_000, "\x00", '{"a": 1}', "folder"])
def test_without_its_seal_a_corpus_is_hashed_and_sealed_again(stored, corpus, text, monkeypatch):
    seal = stored / "seal.json"
    before = seal.read_text()
    seal.unlink()
    if text == "folder":
        seal.mkdir()
    elif text is not None:
        seal.write_text(text)
    asked = hashed(monkeypatch)
    for _ in range(2):
        assert np.array_equal(open_folder(stored).frames, corpus.frames)
    assert asked == ["frames.npy"] and (text == "folder" or seal.read_text() == before)
    flip(stored / "frames.npy")
    refused(stored)


def test_files_of_another_corpus_are_refused(stored, tmp_path):
    write_folder(random_corpus(seed=1, gestures=("hit", "rub", "tap")), tmp_path / "d")
    for name in (*module.FILES, "corpus.json"):
        shutil.copytree(stored, tmp_path / "e")
        shutil.copy(tmp_path / "d" / name, tmp_path / "e" / name)
        refused(tmp_path / "e")
        shutil.rmtree(tmp_path / "e")
    for name in ("corpus.json", "lengths.npy", "captures.parquet"):  # all but the frames and their seal
        shutil.copy(tmp_path / "d" / name, stored / name)
    refused(stored)


def test_a_folder_that_was_written_for_another_name_is_refused_where_names_matter(stored, tmp_path):
    stored.rename(tmp_path / "d")
    assert len(open_folder(tmp_path / "d")) == 36
    assert "written for c" in refused(tmp_path / "d", key="d")


def test_a_link_to_the_same_content_is_right_and_to_another_is_refused(stored, corpus, tmp_path):
    (stored / "frames.npy").rename(tmp_path / "elsewhere.npy")
    (stored / "frames.npy").symlink_to(tmp_path / "elsewhere.npy")
    assert np.array_equal(open_folder(stored).frames, corpus.frames)
    (stored / "lengths.npy").unlink()
    (stored / "lengths.npy").symlink_to("/dev/zero")
    assert "lengths.npy is no file" in refused(stored)


def test_a_folder_without_what_was_stored_is_refused(stored, corpus):
    edit(stored / "corpus.json", lambda about: about["info"].pop("stored") and None)
    (stored / "seal.json").unlink()
    assert "does not say what was stored" in refused(stored) and any(verified(stored).values())
    write_folder(corpus, stored)
    assert np.array_equal(open_folder(stored).frames, corpus.frames)


def test_in_a_folder_that_cannot_be_written_a_process_remembers(stored, corpus, monkeypatch):
    def denied(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(module, "write_text", denied)
    asked = hashed(monkeypatch)
    (stored / "seal.json").unlink()
    for _ in range(3):
        assert np.array_equal(open_folder(stored).frames, corpus.frames)
    assert asked == ["frames.npy"]
    flip(stored / "frames.npy")
    refused(stored)


def test_writing_again_keeps_what_is_good_and_replaces_what_is_not(stored, corpus, tmp_path):
    inode = (stored / "frames.npy").stat().st_ino
    write_folder(corpus, stored)
    assert (stored / "frames.npy").stat().st_ino == inode
    opened = open_folder(stored)
    flip(stored / "lengths.npy", as_before=True)
    write_folder(corpus, stored)
    assert np.array_equal(open_folder(stored).lengths, corpus.lengths)
    assert np.array_equal(opened.frames, corpus.frames)  # who has it open keeps it
    for harm in (lambda: stored.write_text("a file"), lambda: stored.symlink_to(tmp_path / "nowhere"), lambda: None):
        shutil.rmtree(stored)
        harm()
        write_folder(corpus, stored)
        assert not any(verified(stored, "c").values())
    other = random_corpus(seed=1)
    write_folder(other, stored)  # another content under the same name
    assert open_folder(stored).digest == content_digest(other)
    assert [p.name for p in tmp_path.iterdir()] == ["c"]


def test_numbers_of_numpy_and_columns_of_any_kind_are_read_back_as_they_were_stored(corpus, tmp_path):
    rows = len(corpus)
    captures = corpus.captures.assign(
        small=np.arange(rows, dtype=np.uint8),
        single=np.linspace(0, 1, rows, dtype=np.float32),
        gaps=np.where(np.arange(rows) % 2, np.nan, 0.1),
        truth=np.arange(rows) % 2 == 0,
        late=pd.Timestamp("2020-01-01"),
        unknown=pd.Series([None, "x"] * (rows // 2)),
        either=pd.Series([None, True] * (rows // 2)),
    )
    fields = {"captures": captures, "rate_hz": np.float64(100.1), "full_scale": np.float32(3.5)}
    fields["info"] = {"pair": (1, 2), 3: "three"}
    made = corpus.changed(**fields)
    write_folder(made, tmp_path / "c")
    again = open_folder(tmp_path / "c")
    assert again.digest == content_digest(made) == content_digest(again)
    assert again.info == {"pair": [1, 2], "3": "three"}
