"""CoST, HAART and CuddleBot: small files by hand; `test_wrong_files` has wrong ones."""

import tarfile
import zipfile

import numpy as np
import pandas as pd
import pytest

from bench.corpora import library
from bench.corpora.read import cost, cuddlebot, haart
from tests.corpora.made import archive, cost_csv, held_out_csv, line, training_csv


def test_cost_by_hand(tmp_path):
    lines = (
        line(frame=1),
        line(frame=2, values=[9] * 64),
        line(frame=1),
        line(7, 3, 12, 1, [1023] * 64),
    )
    corpus = cost.read(cost_csv(tmp_path, *lines))
    assert list(corpus.lengths) == [2, 1, 1] and list(corpus.starts) == [0, 2, 3]
    assert corpus.captures.to_dict("list") == {
        "subject": ["1", "1", "7"],
        "variant": ["gentle", "gentle", "rough"],
        "gesture": ["grab", "grab", "stroke"],
        "repetition": [1, 2, 1],
    }
    assert (corpus.rate_hz, corpus.full_scale, corpus.grid) == (135, 1023, (8, 8))
    # ch1 to ch8 are the lowest row, ch57 to ch64 the top.
    assert list(corpus[0][0][7]) == list(range(8)) and list(corpus[0][0][0]) == list(range(56, 64))
    assert (corpus[0][1] == 9).all() and (corpus[2] == 1023).all()
    warnings = corpus.info["warnings"]
    assert (
        "captures: 3 here, 7805 published" in warnings
        and "subjects: 2 here, 31 published" in warnings
    )
    assert any("challenge split cannot be recovered" in w for w in warnings)


def test_the_training_subjects_of_the_challenge_are_recovered():
    """31 subjects with one gentle and one normal capture of four gestures; 21 have known sums."""
    rows, lengths = [], []
    for subject in range(31):
        for gesture, sums in cost.CHALLENGE_FRAMES.items():
            total = sums[(subject * 5) % 21] if subject < 21 else 50 + subject
            for variant, n in (
                ("gentle", total // 3),
                ("normal", total - total // 3),
                ("rough", 17),
            ):
                rows.append((str(subject + 1), variant, gesture))
                lengths.append(n)
    captures, lengths = (
        pd.DataFrame(rows, columns=["subject", "variant", "gesture"]),
        np.array(lengths),
    )
    assert cost.training_subjects(captures, lengths) == {str(i) for i in range(1, 22)}
    shared = (
        (captures["subject"] == "31")
        & (captures["gesture"] == "rub")
        & (captures["variant"] != "rough")
    )
    lengths[shared] = (
        cost.CHALLENGE_FRAMES["rub"][0] - 900,
        900,
    )  # a test subject has one known sum by chance
    assert cost.training_subjects(captures, lengths) == {str(i) for i in range(1, 22)}
    lengths[0] += 1  # one subject no longer matches in one gesture
    assert cost.training_subjects(captures, lengths) == set()


def test_split_marks_gentle_and_normal_captures_only(tmp_path, monkeypatch):
    monkeypatch.setattr(cost, "CHALLENGE_FRAMES", {"pat": (5,), "rub": (7,)})
    monkeypatch.setattr(cost, "PUBLISHED_SUBJECTS", 2)
    captures = [(1, 1, 4, 2), (1, 2, 4, 3), (1, 1, 8, 7), (1, 3, 8, 1), (2, 1, 4, 5), (2, 2, 8, 6)]
    lines = [line(*labels, f) for *labels, frames in captures for f in range(1, frames + 1)]
    corpus = cost.read(cost_csv(tmp_path, *lines))
    assert corpus.captures["split"].tolist() == ["train", "train", "train", "", "test", "test"]
    assert not any("split" in w for w in corpus.info["warnings"])


def test_haart_by_hand_from_folder_parent_and_zip(tmp_path):
    training = training_csv(("P4", "constant"), ("P4", "pat"), ("P10", "pat"))
    parts = {
        "training.csv": training,
        "testWITHLABELS.csv": held_out_csv(("T9", "rub"), ("T1", "pat")),
    }
    path = archive(tmp_path, parts={f"HAART DataSet/{name}": text for name, text in parts.items()})
    corpus = haart.read(path)
    assert corpus.captures.to_dict("list") == {
        "subject": ["4", "4", "10", "9", "1"],
        "gesture": ["constant", "pat", "pat", "rub", "pat"],
        "substrate": ["curve"] * 3 + ["foam"] * 2,
        "cover": ["fur"] * 3 + ["none"] * 2,
        "split": ["train"] * 3 + ["test"] * 2,
    }
    assert corpus.rate_hz == 54 and list(corpus.lengths) == [432] * 5
    assert corpus[1][5].ravel()[:3].tolist() == [1, 5, 5]
    # Sequence is no cell, and the last cell is not lost.
    assert corpus[4][10].ravel()[[0, 1, 63]].tolist() == [1, 7, 9]
    assert "train captures of gesture pat: 2 here, 83 published" in corpus.info["warnings"]
    with zipfile.ZipFile(path) as packed:
        packed.extractall(tmp_path / "folder")
    for source in (tmp_path / "folder", tmp_path / "folder" / "HAART DataSet"):
        assert np.array_equal(haart.read(source).frames, corpus.frames)


FILES = {
    "02/150505-2coverdynamicpat.csv": 1,
    "02/150505-2nonestaticrub.csv": 2,
    "10/150505-10nonestaticnotouch.csv": 1,
}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """A folder of CuddleBot in which every file has other values."""
    root = tmp_path_factory.mktemp("cb") / "Touch Data"
    for k, (name, repetitions) in enumerate(FILES.items()):
        values = (np.arange(repetitions * 5400 * 10).reshape(-1, 10) * 7 + k) % 1024
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(root / name, values, fmt="%d", delimiter=",", footer="\n", comments="")
    (root / "notes.csv").write_text("a,b\n")
    return root


def test_every_repetition_of_cuddlebot_is_a_capture_in_pressure(recordings, tmp_path):
    corpus = cuddlebot.read(recordings)
    assert corpus.captures.to_dict("list") == {
        "subject": ["2", "2", "2", "10"],
        "gesture": ["pat", "rub", "rub", "notouch"],
        "cover": ["cover", "none", "none", "none"],
        "motion": ["dynamic", "static", "static", "static"],
        "repetition": ["1", "1", "2", "1"],
    }
    lines = (recordings / "02/150505-2nonestaticrub.csv").read_text().splitlines()
    row = 5400 + 17 * 10 + 3  # second repetition, frame 17, row 3
    assert corpus[2][17, 3].tolist() == [1023 - int(word) for word in lines[row].split(",")]
    assert corpus[2].shape == (540, 10, 10) and any(
        "4 here, 902 published" in w for w in corpus.info["warnings"]
    )
    with tarfile.open(tmp_path / "a.tar.xz", "w:xz") as packed:
        packed.add(recordings, "Touch Data")
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as packed:
        for name in FILES:
            packed.write(recordings / name, name)
    for name in ("a.tar.xz", "a.zip"):
        assert np.array_equal(cuddlebot.read(tmp_path / name).frames, corpus.frames)


def test_an_import_with_changes_has_a_name_of_its_own(recordings):
    corpus = library.import_corpus(
        "cuddlebot", recordings, {"crop": "8x8", "frames": "54:486", "align": "6:0"}
    )
    assert (
        corpus.name == "cuddlebot-aligned"
        and corpus.grid == (8, 8)
        and set(corpus.lengths) == {432}
    )
    assert (
        corpus.info["changes"] == "align=6:0, frames=54:486, crop=8x8"
        and "not known" in corpus.info["source"]
    )
