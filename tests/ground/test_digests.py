"""Files with a digest: whatever bit changes and wherever they are cut off, nothing else is read."""

import json
from io import BytesIO
from pathlib import Path
from shutil import copytree

import numpy as np
import pandas as pd
import pytest

from bench.errors import InputError
from bench.features.cache import _read_table
from bench.ground.digests import (
    DamagedFile,
    append_digest,
    check_folder,
    json_with_digest,
    read_json_with_digest,
    split_digest,
    write_folder_digest,
)
from bench.running import tracking
from bench.running.results import FoldResult
from bench.store.tables import read_table, write_table

TABLE = pd.DataFrame({"subject": ["1", "2", None], "accuracy": [0.25, 0.5, 1.0], "n": [3, 4, 5]})
VALUES = {"people": {"1": [8, 10], "ü": [9, 10]}, "mean": 0.85, "chip": None, "ok": True}


def damages(content, count=400):
    """Copies with one flipped bit, at each byte or a sample of them, and copies cut off."""
    rng = np.random.default_rng(0)
    places = range(len(content))
    for place in places if len(content) <= count else rng.choice(len(content), count, False):
        bit = 1 << int(rng.integers(8))
        yield content[:place] + bytes([content[place] ^ bit]) + content[place + 1 :]
    for end in {0, 1, 7, 63, 64, 65, len(content) // 2, len(content) - 1} & {*range(len(content))}:
        yield content[:end]


def write_fold(path):
    metrics = {"fit_seconds": 1.5}
    tracking._write_fold(FoldResult("3", TABLE, metrics, tables={"labels": TABLE}), path)


def read_fold(path):
    result = tracking._read_fold(path)
    if result is None:
        raise DamagedFile
    return result.name, result.metrics, result.table.to_csv(), result.tables["labels"].to_csv()


def write_features(path):
    buffer = BytesIO()
    write_table(TABLE, buffer)
    path.write_bytes(buffer.getvalue())


KINDS = {  # how a file is written, and how it is read
    "bytes": (
        lambda path: path.write_bytes(append_digest(b"1234")),
        lambda path: split_digest(path.read_bytes()),
    ),
    "JSON": (
        lambda path: path.write_text(json_with_digest(json.dumps(VALUES, indent=1))),
        read_json_with_digest,
    ),
    "table": (
        lambda path: write_table(TABLE, path),
        lambda path: read_table(path, "per_subject").to_csv(),
    ),
    "columns": (
        lambda path: write_table(TABLE, path),
        lambda path: read_table(path, "per_subject", columns=["n"]).to_pydict(),
    ),
    "features": (write_features, lambda path: _read_table.__wrapped__(path).to_csv()),
    "fold": (write_fold, read_fold),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_refused_or_reads_the_same(kind, tmp_path):
    write, read = KINDS[kind]
    write(path := tmp_path / "file")
    content, expected = path.read_bytes(), read(path)
    refused = 0
    for damaged in damages(content):
        path.write_bytes(damaged)
        try:
            found = read(path)
        except (DamagedFile, InputError):
            refused += 1
        else:
            assert found == expected
    assert refused >= 68  # of few bytes, all


def test_tables_are_plain_parquet_files(tmp_path):
    write_table(TABLE, path := tmp_path / "table.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(path), TABLE)


def test_a_folder_without_one_of_its_files_or_with_another_byte_is_refused(tmp_path):
    folder = tmp_path / "model"
    (folder / "code").mkdir(parents=True)
    (folder / "model.pkl").write_bytes(bytes(range(99)))
    (folder / "code" / "a.py").write_text("a = 1\n")
    write_folder_digest(folder)
    (folder / "later").write_text("")
    check_folder(folder)
    for name in ("model.pkl", "code/a.py", "sha256.json"):
        other = Path(copytree(folder, tmp_path / "other", dirs_exist_ok=True))
        for damaged in damages((folder / name).read_bytes(), 40 * (name != "sha256.json")):
            (other / name).write_bytes(damaged)
            with pytest.raises(DamagedFile, match=name):
                check_folder(other)
        (other / name).unlink()
        with pytest.raises(DamagedFile, match=name):
            check_folder(other)
