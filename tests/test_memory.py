"""Sizes that cannot be are refused before any memory is asked for."""

import re
import resource

import pytest

from bench.cli import main
from bench.errors import InputError
from bench.memory import available, ensure


def test_what_is_free_is_less_than_the_machine_has():
    with open("/proc/meminfo") as f:
        total = next(1024 * int(line.split()[1]) for line in f if line.startswith("MemTotal"))
    assert 0 < available() < total


def test_more_than_is_free_is_refused_with_both_numbers(monkeypatch):
    monkeypatch.setattr("bench.memory.available", lambda: 2e9)
    ensure("x=1", 2e9)
    with pytest.raises(InputError, match=r"^x=1: needs at least 3\.5 GB of memory, 2 GB are free; ask for less$"):
        ensure("x=1", 3.5e9)


@pytest.mark.parametrize(
    ("typed", "told"),
    [
        ("data.rows=1000000 data.cols=1000000", r"needs at least .* TB of memory, .* are free"),
        ("data.rate_hz=1e12", "needs at least"),
        ("data.rate_hz=1e308", "needs at least"),
        ("data.subjects=1000000 data.rows=20", "needs at least"),
        ("data.subjects=1000000000000", "give 1000000 at most"),
        ("model=cnn85 model.frames=1000000000000", "give 1000000 at most"),
        ("model=cnn85 model.frames=1000000 model.batch=1000000", "needs at least 256 TB"),
        ("model=cnn85 model.seconds=1e300", "up to 3600"),
        ("model=rf model.trees=99999999999999999999", "give 1000000 at most"),
        ("model=rf seed=99999999999999999999", "give 4294967295 at most"),
        ("model=rf seed=4294967296", "give 4294967295 at most"),
        ("model=rf seed=" + 5000 * "9", "seed=999"),
        ("protocol=kfold protocol.seed=4294967296", "give 4294967295 at most"),
        ("data=" + 300 * "a", "data=aaa"),
        ("model=" + 3000 * "a", "zhou2016_lrcn$"),
        (3000 * "a" + "=1", "no key is called"),
        ("data.seed=1\0", "NUL"),
    ],
)
def test_sizes_that_cannot_be_are_one_line(typed, told, capsys):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert main(["run", *typed.split(" ")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(told, line) and len(line) <= 310
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB


def test_the_largest_seed_works(capsys):
    assert main(["run", "model=rf", "model.trees=2", "seed=4294967295", "data.subjects=2", "data.variants=normal"]) == 0


@pytest.mark.parametrize(
    "command",
    [
        ["fit", "data.subjects=2", f"out={'a' * 300}"],
        ["predict", "a" * 300, "x.csv"],
        ["data", "import", "cost", "a" * 300],
        ["check", f"baseline={'a' * 300}"],
        ["report", f"out={'a' * 300}"],
        ["demo", f"out={'a' * 300}"],
        ["extract", "data=synth", "data.subjects=2", "features=jung28", f"out={'a' * 300}.csv"],
        ["fit", "data.subjects=2", "out=a\0b"],
        ["report", "out=a\0b"],
    ],
)
def test_names_that_the_file_system_cannot_take_are_one_line(command, capsys):
    assert main(command) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("bench: ") and len(line) <= 310
