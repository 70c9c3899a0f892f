"""What a stranger installs: wheel and sdist, without the clone, in an environment of their own."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("bench", "features", "models", "protocols", "reports")
FILES = ("pyproject.toml", "README.md", "LICENSE")
SMALL = ["data.subjects=3", "data.variants=normal", "data.repetitions=2"]

pytestmark = pytest.mark.live


def said(*command, **how):
    """Output of a command that must succeed, within ten minutes, without this environment."""
    env = {
        k: v
        for k, v in os.environ.items()
        if k not in ("PYTHONPATH", "VIRTUAL_ENV", "MLFLOW_TRACKING_URI")
    }
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, timeout=600, env=env, **how
    )
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def new_environment(place):
    """Python and pip, nothing else."""
    said(sys.executable, "-m", "venv", place)
    return place / "bin" / "python"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The wheel, which ``build`` makes from the sdist, and the sdist, made from tracked files."""
    folder = tmp_path_factory.mktemp("built")
    source = folder / "source"
    source.mkdir()
    for room in ROOMS:
        shutil.copytree(ROOT / room, source / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy(ROOT / name, source)
    python = new_environment(folder / "maker")
    said(python, "-m", "pip", "install", "-q", "build")
    said(python, "-m", "build", "--outdir", folder / "dist", source)
    (wheel,) = (folder / "dist").glob("*.whl")
    (sdist,) = (folder / "dist").glob("*.tar.gz")
    return wheel, sdist


def test_all_files_of_the_rooms_are_in_both(built):
    wheel, sdist = built
    there = {
        p.relative_to(ROOT).as_posix()
        for room in ROOMS
        for p in (ROOT / room).rglob("*")
        if p.is_file()
    }
    wanted = {p for p in there if "__pycache__" not in p} - {
        "reports/baseline.json"
    }  # the gate of this project
    packed = set(zipfile.ZipFile(wheel).namelist())
    top = {name.split("/")[0] for name in packed if ".dist-info/" not in name}
    assert top == {"bench"}  # a user's own folders may have the names of the others
    packed = {
        re.sub(r"^bench/(?=(features|models|protocols|reports)/)", "", name) for name in packed
    }
    assert not wanted - packed
    strangers = {name for name in packed - wanted if not name.split("/")[0].endswith(".dist-info")}
    assert not strangers
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert not wanted - names and set(FILES) <= names
    assert wheel.stat().st_size < 3_000_000


def test_it_runs_where_the_clone_is_not(built, tmp_path):
    place = tmp_path / "installed"
    python = new_environment(place)
    said(python, "-m", "pip", "install", "-q", "--no-deps", built[0])
    # Its dependencies are those of this environment, without add-ons, by a path in a .pth file.
    own = Path(
        said(python, "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])").strip()
    )
    (packages := tmp_path / "site-packages").mkdir()
    for folder in {sysconfig.get_paths()["purelib"], sysconfig.get_paths()["platlib"]}:
        for file in Path(folder).iterdir():
            if "touchbench" not in file.name:
                (packages / file.name).symlink_to(file)
    (own / "dependencies.pth").write_text(str(packages))
    work = tmp_path / "work"
    work.mkdir()

    def bench(*commands):
        """Output of a command as people type it, or of several in one process."""
        if len(commands) == 1:
            return said(place / "bin" / "bench", *commands[0], cwd=work)
        return said(
            python,
            "-c",
            f"from bench.cli import main\nfor c in {commands}: assert main(c) == 0, c",
            cwd=work,
        )

    assert "choose" in bench(["--help"]) and bench(["--version"]).startswith("touchbench ")
    said(
        python,
        "-c",
        f"import bench; assert bench.__file__.startswith({str(place)!r})",
        cwd=work,
    )
    assert "svm" in bench(["run", "model=svm,lda", "features=jung28", *SMALL])
    fit = ["fit", "model=lda", "features=jung28", "stopping=no", "out=rec", *SMALL]
    printed = bench(["choose"], ["report"], fit, ["data", "show", "synth", *SMALL])
    assert "accuracy" in printed
    page = (work / "report" / "index.html").read_text()
    assert "prefers-color-scheme" in page and "<title>svm · jung28: " in page
    assert (
        sum(p.stat().st_size for p in (work / "rec").rglob("*")) < 20_000_000
    )  # not all that is installed
    assert (work / "look" / "index.html").exists()
