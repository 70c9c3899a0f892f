"""Output of ``bench export`` and ``form=c``, and the C of a system, as golden files."""

import re
from pathlib import Path

import pandas as pd
import pytest

import bench
from addons.chip.tests.compiled import describe_missing
from bench.cli import main
from tests.net import masks, numbers
from tests.net.build import RUNS, SYNTH, THREE, build, step
from tests.net.commands import LDA, ON, TREE

TOOLS = describe_missing("arm-none-eabi-gcc", "qemu-system-arm")
LINKED = re.compile(
    rf"{masks.MASKED.pattern}|flash( kB)?|(library |program )?RAM kB|ram|stack B"
    "|instructions a frame|in a touch|at most|cycles"
)
IN_C = ["run", *SYNTH, "form=c"]
WRONG = [
    ["export", "nowhere", "out=c"],
    ["export", "rec"],
    ["export", "rec", "out=c", "bits=7"],
    [*IN_C, *TREE, "bits=4"],
    [*IN_C, "model=cnn85"],
    [*IN_C, "model=lda", "features=touch"],
    [*IN_C, "model=lda", "features=touch", "model.window=0.4", "model.hop=0.1"],
    [
        *IN_C,
        "model=lda",
        "features=touch",
        "model.window=0.4",
        "model.scale=log",
    ],  # else scaled by the peak in C
    [*IN_C, "model=lda", "features=jung28", "model.window=0.4"],
    [*IN_C, "model=lda", "features=jung28", "features.area=capture"],
    [*IN_C, "model=reflex", "model.scale=peak"],
    ["choose", "clock=64"],
]


def mask_sizes(text, folders):
    """Mask sizes and instructions of linked C, which depend on the compiler."""
    return re.sub(
        r"\d[\d.,]*(?= k?B\b| k?cycles| (k )?instructions)",
        "#",
        masks.lines_of(text, folders, LINKED),
    )


def test_help_and_refusals_are_what_they_were(golden):
    golden("help.txt", step(["export", "--help"]))
    golden("refusals.txt", "".join(map(step, WRONG)))


def test_an_exported_system_is_what_it_was(golden):
    assert "exit code" not in step(["fit", *LDA, "stopping=no", "out=rec"])
    assert "exit code" not in step(
        ["fit", *SYNTH[:-1], *TREE, "model.scale=log", "stopping=no", "out=log"]
    )
    places = ("rec", "out=rec_c"), ("rec", "out=rec"), ("log", "out=log_c")
    golden("export.txt", "".join(step(["export", *place]) for place in places))
    header = Path("rec_c/touch.h").read_text()
    identity = r'(?<=_init_)[0-9a-f]{8}\b|(?<=_MODEL ")[0-9a-f]{8}|(?<=_VERSION ")[^"]+'
    golden("touch.h", re.sub(identity, "#", header))  # of rounded numbers


@pytest.mark.live
@pytest.mark.skipif(bool(TOOLS), reason=TOOLS)
def test_systems_as_c_print_what_they_printed(golden, tmp_path, empty_store):
    run, choose = (
        ["run", *THREE, "model=tree,bayes", "features=jung28"],
        ["choose", "data=three", *ON[1:], "by=cycles"],
    )
    in_c = ["run", *THREE, "model=bayes", "features=jung28", "form=c", "bits=32,8"]
    commands = {"corpora": RUNS["corpora"], "run": [run], "chip": [in_c, choose]}
    build(tmp_path / "net", commands, empty_store)
    golden("chip.txt", Path(tmp_path, "net/printed/chip.txt").read_text(), mask_sizes)


def test_the_c_of_a_system_has_the_numbers_that_it_had(request):
    bench.fit(
        model="lda",
        **{k: v for k, v in numbers.ON.items() if k != "jobs"},
        out="fitted",
        stopping=False,
    )
    for bits in ("32", "8"):
        stored, found = Path(__file__).parent / f"golden/c/{bits}.csv", Path(f"{bits}.csv")
        assert main(["export", "fitted", f"out=c{bits}", f"bits={bits}"]) == 0
        files = sorted(path for path in Path(f"c{bits}").iterdir() if path.suffix in (".c", ".h"))
        rows = [(path.name, numbers.digest(path.read_text())) for path in files]
        pd.DataFrame(rows, columns=["file", "digest"]).to_csv(found, index=False)
        if request.config.getoption("golden"):
            stored.write_text(found.read_text())
        if request.config.getoption("exact"):
            assert found.read_text() == stored.read_text()
        else:
            assert [name for name, _ in rows] == [*pd.read_csv(stored)["file"]]
