"""HAART in the layout of its release; damaged ones are in `test_untrusted`."""

import zipfile

import numpy as np

from bench.corpora.read.haart import read
from tests.corpora.made import archive, held_out_csv, training_csv


def test_folder_parent_and_zip_give_the_same(tmp_path):
    parts = {
        "training.csv": training_csv(("P4", "constant"), ("P4", "pat"), ("P10", "pat")),
        "testWITHLABELS.csv": held_out_csv(("T9", "rub"), ("T1", "pat")),
    }
    path = archive(tmp_path, at="HAART DataSet/{}", parts=parts)
    corpus = read(path)
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
        assert np.array_equal(read(source).frames, corpus.frames)
