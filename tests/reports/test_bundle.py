"""A bundle makes the page again without store and corpus, has no trace of the machine, and damaged ones are refused."""

import json
import zipfile
from pathlib import Path

import pandas as pd

from bench.cli import main
from bench.reading.runs import every_result
from bench.reports.bundle import FORMAT, HEAD, TIME, Bundle
from bench.store.client import connect
from tests.reports.store import stressed, tracked_run
from tests.results import made_up, with_hits


def files_of(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file()
    }


def changed(path, name, content, only=False):
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
    tracked_run(store, "Mine", made_up(6, skill=0.9), model=f"{own}:Mine", **tags)
    run = tracked_run(store, "svm · jung54", made_up(6, windows=2, seed=1), **{"model.C": "8.0"})
    stressed(store, "lda", 0.6, {"noise": 0.1, "shift": 0.2})
    words = [
        "report",
        "data=synth,haart",
        "max_flash=5kB",
        "against=svm · jung54",
        "paper=accuracy,flash",
    ]
    assert (
        main([*words, "bundle=paper.zip"]) == 0
        and main([*words, "bundle=again.zip", "out=again"]) == 0
    )
    assert Path("paper.zip").read_bytes() == Path("again.zip").read_bytes()
    written = files_of("report")
    with zipfile.ZipFile("paper.zip") as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
        assert {entry.date_time for entry in archive.infolist()} == {TIME}
    assert {
        name.removeprefix("report/"): held[name] for name in held if name.startswith("report/")
    } == written
    assert not [name for name, content in held.items() if str(tmp_path).encode() in content]
    assert "bench run data=synth model=mine.py:Mine\n" in held["commands.sh"].decode()
    assert f"synth {'d' * 64}" in held["README.txt"].decode()
    expected = connect().result(next(r for r in connect().of_kind("cell") if r.info.run_id == run))
    read = next(r for r in every_result(Bundle(Path("paper.zip"))) if r["run_id"] == run)
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


def test_damaged_and_foreign_files_are_refused_in_a_line_and_nothing_leaves_the_folder(
    store, quick, capsys, tmp_path
):
    tracked_run(store, "svm", with_hits([15] * 6))
    assert main(["report", "bundle=good.zip"]) == 0
    whole = Path("good.zip").read_bytes()
    Path("cut.zip").write_bytes(whole[: len(whole) // 2])
    middle = whole.index(b"predictions.parquet") + 200
    Path("flipped.zip").write_bytes(
        whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
    )
    Path("text.zip").write_text("no zip")
    changed("foreign.zip", "word/document.xml", "<a/>", only=True)
    changed(
        "newer.zip", HEAD, json.dumps({"format": FORMAT + 1, "touchbench": "9.9", "options": {}})
    )
    changed("list.zip", "runs.json", "[3]")
    changed("bare.zip", "runs.json", json.dumps([{"about": {"run_id": "a"}, "metrics": {}}]))
    wrong = dict.fromkeys(("cut", "flipped", "text", "list"), "damaged") | {"foreign": "no bundle"}
    wrong |= {
        "newer": "touchbench 9.9",
        "bare": "a run lacks data",
        "nowhere": "there is no such file",
    }
    before = files_of("report")
    capsys.readouterr()
    for name, words in wrong.items():
        assert main(["report", f"from={name}.zip"]) == 2, name
        assert words in (line := capsys.readouterr().err) and line.count("\n") == 1, (name, line)
    assert files_of("report") == before
    assert (
        main(["report", "bundle=report"]) == 2
        and "bundle=report cannot be written" in capsys.readouterr().err
    )
    changed("evil.zip", "../../evil.txt", "evil")
    there = {path for path in tmp_path.parent.rglob("evil*")}
    assert main(["report", "from=evil.zip", "out=safe"]) == 0
    assert {path for path in tmp_path.parent.rglob("evil*")} == there and files_of("safe") == before
    with zipfile.ZipFile("good.zip") as archive:
        (run,) = json.loads(archive.read("runs.json"))
    strange = run | {"about": run["about"] | {"touchbench.kind": "strange", "run_id": "x"}}
    changed("more.zip", "runs.json", json.dumps([run, strange]))
    capsys.readouterr()
    assert main(["report", "from=more.zip"]) == 0
    assert "1 run of more.zip left out: install the add-ons" in "".join(capsys.readouterr())
