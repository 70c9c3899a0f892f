"""What the README and the pages of docs/ promise, as it is written there."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sklearn.model_selection import LeaveOneGroupOut, cross_val_score

import bench
from bench.cli import main
from bench.options import COMMANDS
from bench.work.fold import decisions
from models.search.tuning import Search
from tests.chip.compiled import lacking
from tests.conftest import runs

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
DOCS = {path.name: path.read_text() for path in (ROOT / "docs").glob("*.md")}
SNIPPETS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_the_example_recogniser_runs_as_written(corpus):
    names = {}
    exec(SNIPPETS[0], names)
    found = cross_val_score(
        names["Level"](power=0.5), corpus, corpus.gestures, groups=corpus.subjects, cv=LeaveOneGroupOut()
    )
    assert found.mean() > 0.9


def test_its_parameter_can_be_searched_though_it_has_no_probabilities(corpus):
    """As `bench tune model=level model.power=0.5,1,2` does in each fold."""
    names = {}
    exec(SNIPPETS[0], names)
    train, test = np.flatnonzero(corpus.subjects != "1"), np.flatnonzero(corpus.subjects == "1")
    search = Search({"level": names["Level"]}, {"level": {"power": [0.5, 1.0, 2.0]}}).fit(
        corpus[train], corpus.gestures[train]
    )
    assert not hasattr(search, "predict_proba")
    table = decisions(search, corpus, "1", test)
    labels = table[["p_pat", "p_rub", "p_tap"]].to_numpy()
    assert (labels.max(axis=1) == 1).all() and (labels.sum(axis=1) == 1).all()
    expected = names["Level"](search.chosen_["level.power"]).fit(corpus[train], corpus.gestures[train])
    assert (np.array(["pat", "rub", "tap"])[labels.argmax(axis=1)] == expected.predict(corpus[test])).all()


def test_every_command_is_introduced():
    said = README + "".join(DOCS.values())
    for command in COMMANDS:
        assert f"bench {command}" in said, command


def test_it_is_short_and_what_it_links_to_is_there():
    assert README.count("\n") <= 120
    links = re.findall(r"\]\(([^)#]+)", README)
    assert len(links) > 15 and all((ROOT / link).exists() for link in links), links


def test_its_run_of_seconds_gives_the_verdict_that_it_prints(capsys):
    """Words as they stand there; numbers may differ by a point, as another processor rounds otherwise."""
    pattern = r"```sh\n(bench run [^`]*bench choose [^`]*)```\n\n```text\n(.*?)```"
    block, shown = re.search(pattern, README, re.DOTALL).groups()
    for line in block.splitlines():
        assert main(line.split()[1:]) == 0
    lines = capsys.readouterr().out.splitlines()
    begin = next(place for place, line in enumerate(lines) if line.startswith("Choose"))
    found = lines[begin : begin + len(shown.splitlines())]
    number = r"\d+(?:\.\d+)?"
    for said, line in zip(shown.splitlines(), found, strict=True):
        assert re.sub(number, "#", said) == re.sub(number, "#", line)
        for a, b in zip(re.findall(number, said), re.findall(number, line), strict=True):
            assert abs(float(a) - float(b)) <= 1, (said, line)


def test_the_page_of_systems_of_ones_own_has_the_same_example():
    assert f"```python\n# my.py\n{SNIPPETS[0]}```" in DOCS["your_system.md"]


def test_commands_are_single_lines_and_ci_runs_the_readmes():
    blocks = re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)[:2]
    assert all(block.strip().count("\n") == 0 for block in blocks)
    assert blocks[0].endswith("bench run protocol=loso model=cnn85\n") and "-m pytest" in blocks[1]
    assert README.count("-m pytest") == 1 and "-m pytest" in (ROOT / ".ci" / "run").read_text()


@pytest.mark.skipif(bool(lacking("make", "gcc")), reason=lacking("make", "gcc"))
def test_from_captures_to_running_c_as_written(capsys, monkeypatch):
    block = next(b for b in re.findall(r"```sh\n(.*?)```", DOCS["chip.md"], flags=re.DOTALL) if "bench export" in b)
    lines = [line.partition("#")[0].strip() for line in block.splitlines()]
    assert len(lines) == 5
    small = ["data=synth", "data.subjects=3", "data.variants=normal", "model.units=2", "model.copies=1", "stopping=no"]
    for line in lines:
        command = line.rpartition("&&")[0].strip() or line
        if command.startswith("bench fit"):
            assert main(["fit", *small, *(w for w in command.split()[2:] if not w.startswith("data="))]) == 0
        elif command.startswith("bench"):
            assert main(command.split()[1:]) == 0
        elif "flash" not in command or not lacking("arm-none-eabi-gcc", "qemu-system-arm"):
            subprocess.run(command, shell=True, check=True, capture_output=True)
    frames = ("1 " * 63 + "9\n") * 200
    printed = subprocess.run(["rec_c/touch"], input=frames, capture_output=True, text=True, check=True).stdout
    assert printed.startswith("capture,ms,label") and len(printed.splitlines()) > 3


def test_every_name_of_the_table_exists():
    from bench.registry import names

    for room in ("corpora", "features", "models", "protocols"):
        for name in names(room):
            assert f"`{name}`" in DOCS["parts.md"], name


def test_the_python_example_runs_as_written(capsys):
    names = {}
    exec(re.findall(r"```python\n(.*?)```", DOCS["api.md"], flags=re.DOTALL)[0], names)
    assert names["table"]["system"].tolist() == ["svm · jung54", "rf[trees=50] · jung54"]
    assert "Choose " in capsys.readouterr().out


def test_a_recogniser_of_ones_own_runs_from_its_file_with_its_sizes():
    Path("my.py").write_text(SNIPPETS[0])
    small = ["data.subjects=3", "data.variants=normal", "data.repetitions=1"]
    assert main(["run", "model=my.py:Level,svm", "model.power=0.5", *small]) == 0
    _, (level, _) = runs("cell")
    assert level.data.tags["system"] == "Level[power=0.5]"
    corpus = bench.corpus("synth", subjects=3, variants=("normal",), repetitions=1)
    assert level.data.metrics["flash_bytes"] == 4 * 14  # a mean per class
    assert level.data.metrics["ram_bytes"] == 4 * (64 * corpus.lengths.max() + 14)
    assert main(["fit", "model=my.py:Level", "out=saved", *small]) == 0
    Path("my.py").unlink()  # the model has it inside
    code = "import mlflow, sys; print(mlflow.pyfunc.load_model('saved').unwrap_python_model().estimator)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "Level()"
