"""Every command that a golden output names as the next one works in such a store."""

import re
import shlex
import shutil
from pathlib import Path

import pandas as pd

from bench.cli import main
from bench.grammar.options import load_commands
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
