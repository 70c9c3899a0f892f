"""A bundle makes the page again without store and corpus; damaged ones are refused."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pandas as pd
import pytest

import bench
from bench.cli import main
from bench.errors import InputError
from bench.ground.source import git_revisions
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


def test_the_commands_of_a_bundle_run_in_an_empty_home_with_the_users_own_code(
    quick, tmp_path, monkeypatch, capsys
):
    """Code, what it imports and reads, and the file of grids; a file that changed is named."""
    lab, folder = tmp_path / "lab", tmp_path / "unpacked"
    (lab / "parts").mkdir(parents=True)
    (lab / "parts/__init__.py").write_text("")
    (lab / "parts/level.py").write_text("def level(frames):\n    return frames.mean()\n")
    (lab / "weights.csv").write_text("2")
    (lab / "my.py").write_text(
        "from pathlib import Path\n"
        "import numpy as np\n"
        "from sklearn.naive_bayes import GaussianNB\n"
        "from parts.level import level\n"
        "depends = ['weights.csv']\n"
        "WEIGHT = float((Path(__file__).parent / 'weights.csv').read_text())\n"
        "def means(X):\n"
        "    return np.array([[level(frames) * WEIGHT] for frames in X])\n"
        "def plain():\n"
        "    return GaussianNB()\n"
    )
    (lab / "grid.toml").write_text(
        'model = "my.py:plain"\nfeatures = "my.py:means"\n"data.subjects" = 2\n'
        '"data.variants" = "normal"\n"data.repetitions" = 1\n[one]\nprotocol = "loso"\n'
    )
    subprocess.run(["git", "init", "-q"], cwd=lab, check=True)
    monkeypatch.chdir(lab)
    assert main(["run", "grid.toml", "jobs=1"]) == 0
    assert main(["report", "bundle=paper.zip", "out=../report"]) == 0
    with zipfile.ZipFile("paper.zip") as archive:
        archive.extractall(folder)
        assert not [n for n in archive.namelist() if str(tmp_path).encode() in archive.read(n)]
    for name in ("my.py", "parts/level.py", "parts/__init__.py", "weights.csv", "grid.toml"):
        assert (folder / name).read_bytes() == (lab / name).read_bytes()
    assert "captures, trained models" in (folder / "README.txt").read_text()
    (first,) = load_results(connect())
    home = {"TOUCHBENCH_HOME": str(tmp_path / "home"), "MLFLOW_TRACKING_URI": ""}
    script = (folder / "commands.sh").read_text().replace("bench ", f"{sys.executable} -m bench ")
    variables = os.environ | home | {"PYTHONPATH": str(Path(bench.__file__).parents[1])}
    subprocess.run(["bash", "-ec", script], cwd=folder, env=variables, check=True, timeout=200)
    monkeypatch.chdir(folder)
    (again,) = load_results(connect())
    assert again["accuracy"] == first["accuracy"] and again["run_id"] != first["run_id"]
    monkeypatch.chdir(lab)
    capsys.readouterr()
    (lab / "my.py").write_text((lab / "my.py").read_text() + "# later\n")
    (lab / "grid.toml").unlink()
    assert main(["report", "bundle=later.zip", "out=../report"]) == 0
    out = capsys.readouterr().out
    assert "not in the bundle: my.py as it was when some runs were made" in out
    assert "not in the bundle: the TOML file with SHA-256" in out
    with zipfile.ZipFile("later.zip") as archive:
        assert "my.py" not in archive.namelist()
        assert "my.py as it was" in archive.read("README.txt").decode()


def test_a_run_names_the_revision_of_the_users_repository_beside_ours(tmp_path):
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "my.py").write_text("")
    assert "lab" not in git_revisions(str(lab / "my.py"))  # no repository
    author = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init", "-q"], ["add", "."], [*author, "commit", "-q", "-m", "first"]):
        subprocess.run(["git", *words], cwd=lab, check=True)
    head = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=lab, capture_output=True, text=True
    ).stdout
    (lab / "my.py").write_text("1")
    *_, revision = git_revisions(*[str(lab / "my.py")] * 2).split(", ")  # behind ours
    assert revision == f"lab {head[:12]}+changes"
