"""Each of touchbench's rooms that can be taken away, taken away: a copy without its folders does all that is left."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bench

ROOT = Path(bench.__file__).parents[1]
TOP = ("features", "models", "protocols", "reports")  # imported below bench, as pyproject.toml says
ROOMS = {  # with words that are typed, and the line that refuses them
    "endless": ("watch model=lda", "no command is called 'watch'"),
    "in_c": ("chip model=lda", "no command is called 'chip'"),
    "on_cluster": ("run cluster=tcp://x:1", "no key is called 'cluster'"),
}
SMALL = "data.subjects=3 data.variants=normal data.repetitions=2"
TYPED = """
import sys
import bench, bench.models
from bench.cli import main
print(bench.__path__[0], bench.models.__path__[0])
sys.exit(next(filter(None, (main(line.split()) for line in sys.argv[1:])), 0))
"""
COMMANDS = (
    "--help",
    f"run {SMALL} model=lda,svm features=jung28 under=noise after=500ms",
    "choose",
    "report",
    f"fit {SMALL} model=lda features=touch out=rec",
    "tune --help",
)
CORE = "corpora/test_where.py corpora/test_steps.py outcomes/test_gate.py work/test_loop.py"

pytestmark = pytest.mark.live


EACH = [pytest.param([room], id=room, marks=pytest.mark.nightly) for room in ROOMS]


@pytest.fixture(params=[pytest.param([*ROOMS], id="all"), *EACH])
def without(request, tmp_path):
    """Some rooms, and a copy of the project without their folders and tests."""
    rooms, copy = request.param, tmp_path / "copy"
    for name in ("bench", *TOP, "tests"):
        links = TOP if name == "bench" else ()
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", *links))
    for name in TOP:
        (copy / "bench" / name).symlink_to(copy / name)
    shutil.copy(ROOT / "pyproject.toml", copy)
    for room in rooms:
        shutil.rmtree(copy / "bench" / room)
        shutil.rmtree(copy / "tests" / room)
    return rooms, copy


def said(copy, *arguments, **how):
    """Exit code and output of Python on the copy."""
    env = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=900, env=env, **how)
    return done.returncode, done.stdout + done.stderr


def test_rooms_can_be_taken_away(without, tmp_path):
    """All at once in CI; each alone, which also shows that no room needs another one, every night."""
    rooms, copy = without
    work = tmp_path / "work"
    work.mkdir()
    for words, refusal in map(ROOMS.get, rooms):
        code, text = said(copy, "-c", TYPED, words, cwd=work)
        assert code == 2 and refusal in text.partition("\n")[2] and len(text.splitlines()) == 2, text
    code, text = said(copy, "-c", TYPED, *COMMANDS, cwd=work)  # in one process, as each loads everything
    assert code == 0 and text.startswith(f"{copy}/bench {copy}/bench/models\n"), text[-5000:]
    code, text = said(copy, "-m", "pytest", "-q", *(f"tests/{name}" for name in CORE.split()), cwd=copy)
    assert code == 0 and int(re.search(r"(\d+) passed", text)[1]) > 100, text[-5000:]
