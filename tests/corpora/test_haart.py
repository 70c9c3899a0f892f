import zipfile

import numpy as np
import pytest

from bench.corpora.read import haart
from bench.corpora.read.haart import CELLS, read
from bench.errors import InputError


def training(captures, frames=432):
    rows = [f'ParticipantNo, "Substrate", "Cover", "Gesture",{",".join(CELLS)}']
    for i, (who, gesture) in enumerate(captures):
        rows += [f"{who},curve,fur,{gesture}," + ",".join([str(i), str(t), *["5"] * 62]) for t in range(frames)]
    return "\n".join(rows) + "\n"


def test_part(captures, frames=432):
    rows = [f"ParticipantID,Substrate,Cover,Gesture,Sequence,{','.join(CELLS)}"]
    for i, (who, gesture) in enumerate(captures):
        rows += [f"{who},foam,none,{gesture},{t}," + ",".join([str(i), *["7"] * 62, "9"]) for t in range(1, frames + 1)]
    return "\n".join(rows) + "\n"


test_part.__test__ = False


@pytest.fixture
def release(tmp_path):
    folder = tmp_path / "HAART DataSet"
    folder.mkdir()
    (folder / "training.csv").write_text(training([("P4", "constant"), ("P4", "pat"), ("P10", "pat")]))
    (folder / "testWITHLABELS.csv").write_text(test_part([("T9", "rub"), ("T1", "pat")]))
    return folder


def test_folder_parent_and_zip_give_the_same(release, tmp_path):
    corpus = read(release)
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
    warnings = corpus.info["warnings"]
    assert len(warnings) == 2 + 14 + 1
    assert "train captures: 3 here, 578 published" in warnings
    assert "train captures of gesture pat: 2 here, 83 published" in warnings
    assert "test captures of gesture constant: 0 here, 35 published" in warnings
    assert "subjects: 4 here, 10 published" in warnings
    with zipfile.ZipFile(tmp_path / "release.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in release.iterdir():
            archive.write(file, f"HAART DataSet/{file.name}")
    for source in (tmp_path, tmp_path / "release.zip"):
        assert np.array_equal(read(source).frames, corpus.frames)


def test_published_counts_add_up():
    assert {split: sum(counts.values()) for split, counts in haart.PUBLISHED_GESTURES.items()} == haart.PUBLISHED


def test_unknown_labels_are_named(release):
    good = (release / "training.csv").read_text()
    for old, new, message in [
        ("constant", "wave", "training.csv, line 2: Gesture is 'wave', not one of constant, notouch"),
        ("P10", "X10", "training.csv, line 866: ParticipantNo is 'X10', not a participant such as P4"),
    ]:
        (release / "training.csv").write_text(good.replace(old, new))
        with pytest.raises(InputError, match=message):
            read(release)


@pytest.mark.parametrize("packing", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("damage", ["content", "encrypted", "cut"])
def test_damaged_zip_files(release, tmp_path, packing, damage):
    path = tmp_path / "release.zip"
    with zipfile.ZipFile(path, "w", packing) as archive:
        for file in sorted(release.iterdir()):
            archive.write(file, f"HAART DataSet/{file.name}")
    content = bytearray(path.read_bytes())
    if damage == "content":
        content[200:400] = bytes(200)
    elif damage == "cut":
        del content[len(content) // 2 :]
    else:
        for signature, flag in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
            at = -1
            while (at := content.find(signature, at + 1)) >= 0:
                content[at + flag] |= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"release.zip: not a readable zip file \(") as error:
        read(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_packings_without_bounds_are_refused(release, tmp_path, packing):
    with zipfile.ZipFile(tmp_path / "release.zip", "w", packing) as archive:
        for file in release.iterdir():
            archive.write(file, file.name)
    with pytest.raises(InputError, match="release.zip: packed with bzip2 or LZMA; pack it with deflate"):
        read(tmp_path / "release.zip")


def test_broken_releases(release, tmp_path, monkeypatch):
    def refused(message, source=release):
        with pytest.raises(InputError, match=message) as error:
            read(source)
        assert "\n" not in str(error.value)

    whole = (release / "training.csv").read_text().splitlines()
    (release / "training.csv").write_text("\n".join(whole[:-1]))
    refused(r"training.csv, line 866: the capture that starts here has 431 frames instead of 432")
    (release / "training.csv").write_text("\n".join(whole[:400] + whole[401:]))
    refused(r"training.csv, line 433: the capture that starts in line 2 has 431 frames")
    (release / "training.csv").write_text("\n".join(whole))
    tested = (release / "testWITHLABELS.csv").read_text().splitlines()
    (release / "testWITHLABELS.csv").write_text("\n".join(tested[:10] + tested[11:]))
    refused(r"testWITHLABELS.csv, line 11: frame 11 follows frame 9")
    (release / "testWITHLABELS.csv").write_text("\n".join([*tested[:5], tested[5].replace(",7,", ",2000,", 1)]))
    refused(r"testWITHLABELS.csv, line 6: cell2 is 2000, not within 0 and the full scale 1023")
    (release / "testWITHLABELS.csv").unlink()
    refused("testWITHLABELS.csv is missing")
    (tmp_path / "bad.zip").write_bytes(b"PK\x03\x04 not really")
    refused("not a readable zip file", tmp_path / "bad.zip")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("readme.txt", "hello")
    refused("training.csv is missing", tmp_path / "other.zip")
    refused("no such file or folder", tmp_path / "nowhere.zip")
    with zipfile.ZipFile(tmp_path / "large.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("training.csv", "0" * 5000)
        archive.writestr("testWITHLABELS.csv", "0")
    monkeypatch.setattr(haart, "LARGEST_MEMBER", 4096)
    refused("large.zip: a file in it is larger than", tmp_path / "large.zip")
