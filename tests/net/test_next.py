"""Every command that a golden output names as the next one works in a store like the one of which it was printed."""

import io
import re
import shlex
import shutil
from pathlib import Path

import pandas as pd

from bench.cli import main
from bench.options import commands
from tests.net.build import step
from tests.net.commands import STEPS

GOLDEN = Path(__file__).parent / "golden"
NEXT = re.compile(r"^next: (.*)\n((?:      .*\n)*)", re.M)


def lines():
    found = [m for path in sorted(GOLDEN.rglob("*.txt")) for m in NEXT.finditer(path.read_text())]
    return sorted({line.strip() for m in found for line in (m[1], *m[2].splitlines())})


def done(line, monkeypatch):
    """Type a line; its exit code."""
    name, *words = shlex.split(line)
    if name == "sensor":  # what a sensor prints stands before the bar
        rows = Path("new.csv").read_text().splitlines()[1:31]
        frames = "\n".join(",".join(row.split(",")[-64:]) for row in rows) + "\n"
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(frames.encode())))
        return main(words[words.index("bench") + 1 :])
    assert name == "bench"
    if words == ["ui"]:  # a server, see tests/commands/test_server.py
        return 0 if "ui" in commands() else 2
    shutil.rmtree("chosen", ignore_errors=True)
    return main(words)


def test_next_lines_work(in_net, monkeypatch, capsys):
    table = pd.read_csv("three.csv")
    for name in ("one.csv", "new.csv"):
        table[table["subject"] == 1].to_csv(name, index=False)
    made = [command for command in STEPS["data"] if command[:2] in (["data", "export"], ["data", "import"])]
    for command in (*made, *STEPS["fit"]):
        assert "exit code" not in step(command)
    said = {}
    for line in lines():
        if code := done(line, monkeypatch):
            if code == 1 and " max_" in line and "Nothing fits" in capsys.readouterr().out:
                continue  # an answer
            said[line] = code, capsys.readouterr().err
    assert len(lines()) > 20
    assert said == {}
