"""A bundle makes the page again without store and corpus; damaged ones are refused."""

import json
import zipfile
from pathlib import Path

import pandas as pd
import pytest

from bench.cli import main
from bench.errors import InputError
from bench.reading.runs import load_results
from bench.reports.bundle import FORMAT, HEAD, TIME, Bundle
from bench.store.client import connect
from tests.reading.results import make_predictions, predictions_with_hits
from tests.reports.store import stressed, tracked_run


def files_of(folder):
    paths = (path for path in Path(folder).rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def change(path, name, content, only=False):
    """A copy of a bundle in which one file has another content, or is the only one."""
    with zipfile.ZipFile("good.zip") as good, zipfile.ZipFile(path, "w") as archive:
        for each in () if only else good.namelist():
            if each != name:
                archive.writestr(each, good.read(each))
        archive.writestr(name, content)


def test_the_page_is_made_again_in_another_folder_without_store_and_corpus(
    store, quick, monkeypatch, tmp_path
):
    """Equal to the last byte, with the options of the report; equal runs give equal bytes."""
    own = str(tmp_path / "my code" / "mine.py")
    arguments = {"data": "synth", "model": f"{own}:Mine"}
    tags = {"touchbench.command": "run", "touchbench.arguments": json.dumps(arguments)}
    tracked_run(store, "Mine", make_predictions(6, skill=0.9), model=f"{own}:Mine", **tags)
    run = tracked_run(
        store, "svm · jung54", make_predictions(6, windows=2, seed=1), **{"model.C": "8.0"}
    )
    stressed(store, "lda", 0.6, {"noise": 0.1, "shift": 0.2})
    words = ["report", "data=synth,haart", "max_flash=5kB", "against=svm · jung54"]
    words += ["paper=accuracy,flash"]
    assert main([*words, "bundle=paper.zip"]) == 0
    assert main([*words, "bundle=again.zip", "out=again"]) == 0
    assert Path("paper.zip").read_bytes() == Path("again.zip").read_bytes()
    written = files_of("report")
    with zipfile.ZipFile("paper.zip") as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
        assert {entry.date_time for entry in archive.infolist()} == {TIME}
    report = {name: content for name, content in files.items() if name.startswith("report/")}
    assert {name.removeprefix("report/"): content for name, content in report.items()} == written
    assert not [name for name, content in files.items() if str(tmp_path).encode() in content]
    assert "bench run data=synth model=mine.py:Mine\n" in files["commands.sh"].decode()
    assert f"synth {'d' * 64}" in files["README.txt"].decode()
    (expected,) = (r for r in load_results(connect()) if r["run_id"] == run)
    (read,) = (r for r in load_results(Bundle(Path("paper.zip"))) if r["run_id"] == run)
    assert read.metrics == expected.metrics and {*read.tables} == {*expected.tables}
    for name in expected.tables:
        pd.testing.assert_frame_equal(read.tables[name], expected.tables[name])
    (tmp_path / "new").mkdir()
    monkeypatch.chdir(tmp_path / "new")
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "new" / "home"))
    assert main(["report", "from=../paper.zip"]) == 0
    assert files_of("report") == written and not Path("mlflow.db").exists()
    assert main(["report", "from=../paper.zip", "model=svm", "out=one"]) == 0
    assert "Mine" not in Path("one/comparison.csv").read_text()


def test_damaged_and_foreign_files_are_refused_and_nothing_leaves_the_folder(
    store, quick, capsys, tmp_path
):
    tracked_run(store, "svm", predictions_with_hits([15] * 6))
    assert main(["report", "bundle=good.zip"]) == 0
    good, before = Path("good.zip").read_bytes(), files_of("report")
    middle = good.index(b"predictions.parquet") + 200
    flipped = good[:middle] + bytes([good[middle] ^ 255]) + good[middle + 1 :]
    for name, content in (("cut", good[: len(good) // 2]), ("flipped", flipped), ("text", b"no")):
        Path(f"{name}.zip").write_bytes(content)
    change("foreign.zip", "word/document.xml", "<a/>", only=True)
    newer = {"format": FORMAT + 1, "touchbench": "9.9", "options": {}}
    change("newer.zip", HEAD, json.dumps(newer))
    change("list.zip", "runs.json", "[3]")
    refused = dict.fromkeys(("cut", "flipped", "text", "list"), "damaged") | {
        "foreign": "no bundle",
        "newer": "touchbench 9.9",
        "nowhere": "there is no such file",
    }
    for name, words in refused.items():
        with pytest.raises(InputError, match=words):
            Bundle(Path(f"{name}.zip"))
    capsys.readouterr()
    assert main(["report", "bundle=report"]) == 2
    assert "bundle=report cannot be written" in capsys.readouterr().err
    change("evil.zip", "../../evil.txt", "evil")
    there = {*tmp_path.parent.rglob("evil*")}
    assert main(["report", "from=evil.zip", "out=safe"]) == 0
    assert {*tmp_path.parent.rglob("evil*")} == there and files_of("safe") == before
    with zipfile.ZipFile("good.zip") as archive:
        (run,) = json.loads(archive.read("runs.json"))
    unknown = run | {"about": run["about"] | {"touchbench.kind": "strange", "run_id": "x"}}
    change("more.zip", "runs.json", json.dumps([run, unknown]))
    Bundle(Path("more.zip"))
    assert "1 run of more.zip left out: install the add-ons" in "".join(capsys.readouterr())
