"""Every command that a golden output names as the next one works in such a store."""

import re
import shlex
import shutil
from pathlib import Path

import pandas as pd
import pytest

from bench.cli import main
from bench.corpora.read.table import write_table
from bench.grammar.options import load_commands
from tests.conftest import random_corpus
from tests.net.build import step
from tests.net.commands import STEPS

GOLDEN = Path(__file__).parent / "golden"
NEXT = re.compile(r"^next: bench (.*)\n(?:      bench (.*)\n)*", re.M)


def next_commands():
    """The words of the named commands, one for each command and set of keys."""
    found = [
        m.groups()
        for path in sorted(GOLDEN.rglob("*.txt"))
        for m in NEXT.finditer(path.read_text())
    ]
    every = [shlex.split(line) for lines in found for line in lines if line]
    return [*{tuple(word.split("=")[0] for word in words): words for words in every}.values()]


@pytest.mark.parametrize("gestures", [1, 2])
@pytest.mark.parametrize(("subjects", "captures"), [(1, 1), (1, 2), (2, 1)])
def test_next_lines_of_small_corpora_work(subjects, captures, gestures, capsys):
    corpus = random_corpus(subjects, captures, gestures=("pat", "rub")[:gestures], grid=(4, 4))
    write_table(corpus, Path("small.csv"))
    sensor = ["grid=4x4", "rate_hz=100", "full_scale=1023"]
    words = ["data", "import", "table", "small.csv", "name=small", *sensor]
    for _ in range(4):  # import, show, run, choose
        assert main(words) == 0, (words, capsys.readouterr().err)
        if not (named := NEXT.search(capsys.readouterr().out)):
            break
        words = shlex.split(named[1])
    can_run = gestures == 2 and (subjects, captures) != (1, 1)
    assert words[0] == ("fit" if can_run else "data")


def test_next_lines_work(in_net, capsys):
    table = pd.read_csv("three.csv")
    table[table["subject"] == 1].to_csv("new.csv", index=False)
    made = [
        command
        for command in STEPS["data"]
        if command[:2] in (["data", "export"], ["data", "import"])
    ]
    for command in (*made, *STEPS["fit"][:1]):
        assert "exit code" not in step(command)
    named = next_commands()
    assert len(named) > 10 and {words[0] for words in named} <= {*load_commands()}
    for words in named:
        shutil.rmtree("chosen", ignore_errors=True)
        if words not in (
            ["report"],
            ["ui"],
        ):  # which is golden, and a server in tests/commands/test_server.py
            brief = ["stopping=no"] * (words[0] == "fit")  # which else takes most of the time
            assert main([*words, *brief]) == 0, (words, capsys.readouterr().err)
