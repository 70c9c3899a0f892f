"""What ``bench export``, ``form=c`` and their keys print, and the C of a system, as golden files (``--golden``)."""

import re
from pathlib import Path

import pandas as pd
import pytest

import bench
from addons.chip.tests.compiled import lacking
from bench.cli import main
from tests.conftest import never_busy, shorten_measurements
from tests.net import masks, numbers
from tests.net.build import RUNS, THREE, build, copy, inside, step
from tests.net.commands import LDA, ON

GOLDEN = Path(__file__).parent / "golden"
TOOLS = lacking("arm-none-eabi-gcc", "qemu-system-arm")
LINKED = re.compile(
    rf"{masks.MASKED.pattern}|flash( kB)?|(library |program )?RAM kB|ram|stack B|instructions a frame|in a touch"
    "|at most|cycles"
)
WRONG = [
    ["export", "nowhere", "out=c"],
    ["export", "rec"],
    ["export", "rec", "out=c", "bits=7"],
    ["run", *THREE, "model=tree", "features=jung28", "form=c", "bits=4"],
    ["choose", "clock=64"],
]


def chip_of(text, folders):
    """What commands print, without sizes and instructions of linked C, which depend on the compiler."""
    return re.sub(r"\d[\d.,]*(?= k?B\b| k?cycles| (k )?instructions)", "#", masks.lines_of(text, folders, LINKED))


@pytest.fixture(scope="module")
def few_runs(tmp_path_factory, empty_store):
    """A store with the runs that a choice compares with systems in C."""
    folder = tmp_path_factory.mktemp("few")
    with pytest.MonkeyPatch.context() as patch:
        shorten_measurements(patch)
        never_busy(patch)
        run = ["run", *THREE, "model=tree,bayes", "features=jung28"]
        build(folder, {"corpora": RUNS["corpora"], "run": [run]}, empty_store)
    return folder


@pytest.fixture
def in_few(few_runs, tmp_path):
    """A copy of it, in which the test works."""
    with inside(copy(few_runs, tmp_path / "few")):
        yield tmp_path / "few"


@pytest.fixture
def golden(request, few_runs, tmp_path):
    """Compare a text with the golden file of a name, or write it."""
    folders = (tmp_path / "few", few_runs, tmp_path)

    def compared(name, text, form=masks.lines_of):
        path, text = GOLDEN / name, form(text, folders)
        if request.config.getoption("golden"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        assert text == path.read_text()

    return compared


def test_help_and_refusals_are_what_they_were(in_few, golden):
    golden("help.txt", step(["export", "--help"]))
    golden("refusals.txt", "".join(map(step, WRONG)))


def test_an_exported_system_is_what_it_was(in_few, golden):
    assert "exit code" not in step(["fit", *LDA, "stopping=no", "out=rec"])
    golden("export.txt", step(["export", "rec", "out=rec_c"]))
    golden("touch.h", Path("rec_c/touch.h").read_text())


@pytest.mark.live
@pytest.mark.skipif(bool(TOOLS), reason=TOOLS)
def test_systems_as_c_print_what_they_printed(in_few, golden):
    ran = step(["run", *THREE, "model=bayes", "features=jung28", "form=c", "bits=32,8"])
    golden("chip.txt", ran + step(["choose", "data=three", *ON[1:], "by=cycles"]), chip_of)


@pytest.mark.parametrize("bits", ["32", "8"])
def test_the_c_of_a_system_has_the_numbers_that_it_had(bits, request):
    stored = GOLDEN / "c" / f"{bits}.csv"
    bench.fit(model="lda", **{k: v for k, v in numbers.ON.items() if k != "jobs"}, out="fitted", stopping=False)
    assert main(["export", "fitted", "out=c", f"bits={bits}"]) == 0
    files = sorted(path for path in Path("c").iterdir() if path.suffix in (".c", ".h"))
    rows = [(path.name, numbers.digest(path.read_text())) for path in files]
    pd.DataFrame(rows, columns=["file", "digest"]).to_csv("found.csv", index=False)
    if request.config.getoption("golden"):
        stored.write_text(Path("found.csv").read_text())
    if request.config.getoption("exact"):
        assert Path("found.csv").read_text() == stored.read_text()
    else:
        assert [name for name, _ in rows] == [*pd.read_csv(stored)["file"]]
