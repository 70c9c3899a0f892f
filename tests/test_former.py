"""Names of the version before: each is refused in one line that gives the name of today."""

import re
from pathlib import Path

import pytest

import bench
from bench.cli import main
from bench.options import commands, overview

ROOT = Path(__file__).parent.parent
SCENE = ["choose", "scene=robot.toml"]


@pytest.mark.parametrize(
    ("arguments", "now"),
    [
        (["scene", "data=synth"], "groups"),
        (["systems"], "papers"),
        (["tune", "budget=5"], "seconds"),
        (["run", "model=auto", "model.budget=5"], "seconds"),
        (["choose", "over=trees"], "bench tune smallest="),
        (["stream", "source=-", "model=m"], "bench live"),
        (["check", "run=no"], "stored=yes"),
        (["choose", "max_worst_person=40"], "min_worst_person"),
        (["report", "max_worst_tenth=40"], "min_worst_tenth"),
        (SCENE, "[people] worst: there is no such line; it is now called worst_person"),
    ],
)
def test_a_former_name_is_one_line_with_the_new_one(arguments, now, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.toml").write_text("[people]\nworst = 60\n")
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert now in line and len(line) <= 300


def test_the_overview_is_one_screen():
    assert len(overview().splitlines()) <= 24 and overview().count("\n  bench ") == 7
    assert all(f" {name}" in overview() for name in commands())


def test_no_page_and_no_output_uses_a_former_name():
    pages = [ROOT / "README.md", ROOT / "SECURITY.md", *ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/*.ipynb")]
    printed = [path for path in ROOT.glob("tests/net/golden/**/*.*") if path.name != "refusals.txt"]
    former = r"bench[ .](?:scene|systems)\b|stream source=|choose [^`\n]*over=|model\.budget=|max_worst_[pt]\w+=|run=no"
    found = {path.name: words for path in [*pages, *printed] if (words := re.findall(former, path.read_text()))}
    assert len(printed) > 30 and not found


def test_the_api_gives_new_names_too():
    with pytest.raises(AttributeError, match="it is now called groups"):
        bench.scene  # noqa: B018
    with pytest.raises(bench.InputError, match="it is now called seconds"):
        bench.tune(budget=5)
