"""CuddleBot recordings: files that the test writes, as a folder, a tar and a zip archive."""

import tarfile
import zipfile

import numpy as np
import pytest

from bench.corpora import library
from bench.corpora.read.cuddlebot import read
from bench.errors import InputError

FILES = {"02/150505-2coverdynamicpat.csv": 1, "02/150505-2nonestaticrub.csv": 2, "10/150505-10nonestaticnotouch.csv": 1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder in which every file has other values."""
    root = tmp_path_factory.mktemp("cb") / "Touch Data"
    for k, (name, repetitions) in enumerate(FILES.items()):
        values = (np.arange(repetitions * 5400 * 10).reshape(-1, 10) * 7 + k) % 1024
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(root / name, values, fmt="%d", delimiter=",", footer="\n", comments="")
    (root / "notes.csv").write_text("a,b\n")
    return root


def test_every_repetition_is_a_capture_in_pressure(folder, tmp_path):
    corpus = read(folder)
    assert corpus.captures.to_dict("list") == {
        "subject": ["2", "2", "2", "10"],
        "gesture": ["pat", "rub", "rub", "notouch"],
        "cover": ["cover", "none", "none", "none"],
        "motion": ["dynamic", "static", "static", "static"],
        "repetition": ["1", "1", "2", "1"],
    }
    lines = (folder / "02/150505-2nonestaticrub.csv").read_text().splitlines()
    line = 5400 + 17 * 10 + 3  # second repetition, frame 17, row 3
    assert corpus[2][17, 3].tolist() == [1023 - int(word) for word in lines[line].split(",")]
    assert corpus[2].shape == (540, 10, 10) and any("4 here, 902 published" in w for w in corpus.info["warnings"])
    with tarfile.open(tmp_path / "a.tar.xz", "w:xz") as archive:
        archive.add(folder, "Touch Data")
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in FILES:
            archive.write(folder / name, name)
    for packed in ("a.tar.xz", "a.zip"):
        assert np.array_equal(read(tmp_path / packed).frames, corpus.frames)


def test_an_import_with_changes_has_a_name_of_its_own(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path))
    corpus = library.import_corpus("cuddlebot", folder, {"crop": "8x8", "frames": "54:486", "align": "6:0"})
    assert corpus.name == "cuddlebot-aligned" and corpus.grid == (8, 8) and set(corpus.lengths) == {432}
    assert corpus.info["changes"] == "align=6:0, frames=54:486, crop=8x8" and "not known" in corpus.info["source"]


@pytest.mark.parametrize(
    ("name", "change", "fact"),
    [
        ("02/150505-2coverdynamicpat.csv", lambda text: text.replace("\n", "\n1024", 1), "not a whole number"),
        ("02/150505-2coverdynamicpat.csv", lambda text: "1,2\n3,4\n", "2 fields instead of 10"),
        ("03/150505-2coverdynamicpat.csv", lambda text: text, "in it twice"),
    ],
)
def test_a_broken_file_is_named(name, change, fact, folder, tmp_path):
    for one in FILES:
        target = tmp_path / one
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text((folder / one).read_text())
    target = tmp_path / name
    target.parent.mkdir(exist_ok=True)
    target.write_text(change((folder / "02/150505-2coverdynamicpat.csv").read_text()))
    with pytest.raises(InputError, match=fact) as error:
        read(tmp_path)
    assert "150505-2coverdynamicpat.csv" in str(error.value) and str(error.value).count("\n") == 0
