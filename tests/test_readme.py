"""What the README and the pages of docs/ promise, as it is written there."""

import itertools
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from sklearn.model_selection import LeaveOneGroupOut, cross_val_score

import bench
from bench.arguments import parse
from bench.cli import main
from bench.options import COMMANDS, keys
from tests.conftest import runs
from tests.export.compiled import lacking

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
DOCS = {path.name: path.read_text() for path in (ROOT / "docs").glob("*.md")}
SNIPPETS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_the_example_recogniser_runs_as_written(corpus):
    names = {}
    exec(SNIPPETS[0], names)
    level, loso = names["Level"](power=0.5), LeaveOneGroupOut()
    assert cross_val_score(level, corpus, corpus.gestures, groups=corpus.subjects, cv=loso).mean() > 0.9


def test_every_command_is_introduced_and_every_command_line_is_taken():
    """Commands of README and docs, with `NAME=` and `...` as they write them, go through the parser."""
    texts = [README, *DOCS.values(), *(path.read_text() for path in (ROOT / "docs" / "notes").glob("*.md"))]
    for command in COMMANDS:
        assert any(f"bench {command}" in text for text in texts), command
    lines = [line for text in texts for line in re.findall(r"^ *bench (.+)|`bench ([^`\n]+)`", text, re.MULTILINE)]
    checked = 0
    for line in filter(None, itertools.chain(*lines)):
        try:
            command, *words = shlex.split(re.split(r" [|<>] | \|\|", line)[0], comments=True)
        except ValueError:  # a quotation that goes on in prose
            continue
        if command in COMMANDS and command != "data" and "--help" not in words:
            values = [f"{word}1" if word.endswith("=") else word for word in words if "=" in word and "<" not in word]
            checked += len(parse(values, keys(command)))
    assert checked > 300


def test_it_is_short_and_its_links_lead_somewhere():
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
    begin = next(i for i, line in enumerate(lines) if line.startswith("Choose"))
    number = r"\d+(?:\.\d+)?"
    for written, line in zip(shown.splitlines(), lines[begin:], strict=False):
        assert re.sub(number, "#", written) == re.sub(number, "#", line)
        for a, b in zip(re.findall(number, written), re.findall(number, line), strict=True):
            assert abs(float(a) - float(b)) <= 1, (written, line)


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
    # it has no probabilities, and can be searched all the same
    assert main(["tune", "model=my.py:Level", "model.power=0.5,2", "inner=2", *small]) == 0
    assert main(["fit", "model=my.py:Level", "out=saved", *small]) == 0
    Path("my.py").unlink()  # the model has it inside
    code = "import mlflow, sys; print(mlflow.pyfunc.load_model('saved').unwrap_python_model().estimator)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "Level()"
