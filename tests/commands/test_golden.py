"""What commands print, as whole texts on one store of six runs; ``pytest --golden`` writes them anew."""

import re
import shutil
from pathlib import Path

import pytest

from bench.options import COMMANDS
from tests.conftest import SIX, SMALL, done

GOLDEN = Path(__file__).parent / "golden"
LDA = [*SMALL[:-1], "model=lda", "features=touch", "model.window=0.5"]
TIMED = r"(predict|decision|mean|system hop) ms|decisions per s|predict|decision"  # headings
SAME = {  # what depends on time, place, memory and identity
    r"[^\s'/]*/six\d*": "~",
    r"file://\S*?/(?=\w+/index)": "file://~/",
    r"m-[0-9a-f]{32}|[0-9a-f]{32}": "#",
    r"; \d+\.\d s$": "; # s",
    r"in \d+\.\d\d s": "in # s",
    r"saved \(\d+ kB\)": "saved (# kB)",
    r"[━─]+[┳╇┷┴┓┩┘━─]*": "─",
    r" {2,}(?=[│┃])|(?<=[│┃]) {2,}": " ",
}
STEPS = {  # commands that go on from the six runs, each list in a folder of its own
    "help": [["--help"], *([name, "--help"] for name in COMMANDS)],
    "choose": [["choose"], ["choose", "max_flash=1B", "by=ram"], ["choose", "protocol=loso", "model=tree", "margin=5"]],
    "report": [["report", "max_flash=64kB"]],
    "scene": [["scene", "data=synth"]],
    "systems": [["systems"]],
    "audit": [["audit", "model=tree", "features=jung28"]],
    "check": [["check", "update=true", *SMALL, "model=tree", "features=jung28", "baseline=b.json"]]
    + [["check", "run=false", "baseline=b.json"]],
    "submit": [["submit", "task=haart-loso-v1", "who=me", "out=mine", "model=tree", "features=jung28"]],
    "leaderboard": [["leaderboard", "out=board.html"]],
    "data": [["data"], ["data", "export", "synth", "o.csv", "subjects=2", "variants=normal"]]
    + [["data", "import", "table", "o.csv", "name=mine", "grid=8x8", "rate_hz=135", "full_scale=1023"]]
    + [["data", "show", "mine", "where=subject == '1'", "target=variant"], ["data", "verify", "mine"], ["data"]]
    + [["extract", "data=mine", "features=jung28", "out=f.csv"]],
    "fit": [["fit", *LDA, "stopping=no", "out=rec"], ["export", "rec", "out=rec_c"]]
    + [["data", "export", "synth", "o.csv", "subjects=1", "variants=normal", "repetitions=1"]]
    + [["predict", "rec", "o.csv", "out=p.csv"], ["adapt", "rec", "o.csv", "out=rec_1"]],
}


def masked(text, folder):
    """Output without what depends on time, place and memory; tables without their padding."""
    timed, lines = [], []
    for line in text.replace(str(folder), "~").splitlines():
        if line.startswith(("┃", "│")):
            cells = line.split(line[0])
            if line[0] == "┃":
                timed = [i for i, cell in enumerate(cells) if re.fullmatch(TIMED, cell.strip())]
            line = line[0].join(" # " if i in timed and line[0] == "│" else cell for i, cell in enumerate(cells))
        for pattern, word in SAME.items():
            line = re.sub(pattern, word, line)
        lines.append(line.rstrip())
    return "\n".join(lines) + "\n"


def compared(name, text, golden):
    path = GOLDEN / f"{name}.txt"
    if golden:
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    assert text == path.read_text()


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)  # room for all columns, however long times are


@pytest.mark.parametrize("name", SIX)
def test_runs_print_what_they_printed(name, six_runs, request):
    folder, printed = six_runs
    compared(name, masked(printed[name], folder), request.config.getoption("golden"))


@pytest.mark.parametrize("name", STEPS)
def test_commands_print_what_they_printed(name, six_runs, request, tmp_path, monkeypatch):
    shutil.copytree(six_runs[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "home"))
    text = ""
    for step in STEPS[name]:
        code, printed = done(step)
        text += f"$ bench {' '.join(step)}\n{printed}{f'exit code {code}' * bool(code)}\n\n"
    compared(name, masked(text, tmp_path), request.config.getoption("golden"))
