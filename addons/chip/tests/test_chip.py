"""Systems as C beside themselves in Python: labels, costs, and what reads them."""

import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from addons.chip.tests.compiled import describe_missing
from bench.cli import main
from bench.commands.printing import printed_runs_table
from bench.ground.registry import load_views
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.reading.candidates import find_candidates
from bench.values import scores
from tests.conftest import predictions, runs
from tests.reading.results import make_predictions, make_result
from tests.reading.test_choice import run as costly
from tests.reports.conftest import quick  # noqa: F401
from touchbench_chip import fold as onchip
from touchbench_chip import measure as compiled
from touchbench_chip import network
from touchbench_chip.circumstance import InC

SMALL = ["features=jung28", "data.subjects=3", "data.repetitions=1", "data.variants=normal"]
COSTS = {
    "flash_bytes": 9e3,
    "code_bytes": 2e3,
    "table_bytes": 5e3,
    "ram_bytes": 3e3,
    "program_ram_bytes": 11e3,
}
COSTS |= {"stack_bytes": 400.0, "frame_instructions": 5e3, "most_instructions": 6e4}
COSTS = {f"chip_{name}": value for name, value in COSTS.items()}
WATCHED = {
    "chip_watch_flash_bytes": 31e3,
    "chip_watch_ram_bytes": 15e3,
    "chip_watch_most_instructions": 1.2e6,
}
WATCHED |= {"chip_watch_stack_bytes": 420.0}
WATCHED |= {"chip_watch_idle_instructions": 1.1e5, "chip_watch_frame_instructions": 2.6e5}


def count_named(folder):
    """Gestures that the exported watcher names, 0 without."""
    text = (folder / "tables.h").read_text()
    return int(text.split("#define NAMED ")[1].split()[0]) if "#define NAMED " in text else 0


@pytest.fixture
def costs(monkeypatch):
    """No chip, whose compiler and emulator the marked test needs."""
    monkeypatch.setattr(onchip, "measure_footprint", lambda folder: COSTS)
    monkeypatch.setattr(
        onchip,
        "measure_watching",
        lambda folder, _: WATCHED | {"chip_watch_defined": count_named(folder)},
    )
    monkeypatch.setattr(onchip, "missing_programs", lambda: [])


@pytest.mark.skipif(bool(describe_missing("cc")), reason=describe_missing("cc"))
def test_labels_of_c_are_tracked_beside_those_of_python_and_drawn(costs, quick, capsys):  # noqa: F811
    few = "where=gesture in ('grab', 'pat', 'rub', 'tap')"
    assert main(["run", "form=c", "model=bayes", "bits=8", few, *SMALL]) == 0
    out = capsys.readouterr().out
    assert "in Python" in out and "60,000" in out and "9.0" in out
    one = make_result(metrics=COSTS | {"c_accuracy": 0.5, "accuracy": 0.5}, **{"chip.bits": 8})
    (row,) = printed_runs_table([one], load_views()["form"]).texts
    assert [row[name] for name in ("library RAM kB", "program RAM kB", "stack B")] == [
        "3.0",
        "11.0",
        "400",
    ]
    store, (run,) = runs("cell")
    python, table = scores.label_captures(predictions(store, run)), predictions(store, run, "c")
    assert table["python"].tolist() == python["predicted"].tolist() and table["capture"].is_unique
    in_c = scores.label_captures(table)["predicted"]
    assert run.data.metrics["other_labels"] == (in_c != table["python"]).sum() <= 0.1 * len(table)
    assert run.data.metrics["c_accuracy"] == pytest.approx((in_c == table["true"]).mean())
    assert run.data.metrics["accuracy"] == pytest.approx(
        (python["predicted"] == python["true"]).mean()
    )
    np.testing.assert_allclose(table.filter(like="p_").sum(axis=1), 1, rtol=1e-4)
    assert run.data.params["chip.bits"] == "8"
    assert main(["report"]) == 0
    assert "in C, 8 bits" in Path("report/index.html").read_text(encoding="utf-8")


def test_a_machine_without_the_programs_is_refused_before_anything_runs(monkeypatch, capsys):
    monkeypatch.setattr(
        compiled.shutil, "which", lambda name: None if "arm" in name else "/bin/true"
    )
    assert main(["run", "form=c", "model=bayes", *SMALL]) == 2
    assert (
        "needs arm-none-eabi-gcc, qemu-system-arm, which are not installed"
        in capsys.readouterr().err
    )


def test_c_that_does_not_fit_is_a_failed_fold(tmp_path):
    (tmp_path / "Makefile").write_text(
        "flash count chip:\n\t@echo x does not fit: FLASH=1K is 9 bytes too small >&2; "
        "echo make failed >&2; exit 1\n"
    )
    if shutil.which("make") is None:
        pytest.skip("make not installed")
    with pytest.raises(
        ValueError, match="flash count chip: x does not fit: FLASH=1K is 9 bytes too small$"
    ):
        compiled.measure_footprint(tmp_path)


def test_what_it_starts_ends_with_it(tmp_path, monkeypatch):
    """QEMU in an endless loop would stay, as only make is ended."""
    monkeypatch.setattr(compiled, "LIMIT_S", 1)
    (tmp_path / "Makefile").write_text("flash count chip:\n\t@sleep 4321 & echo $$! > pid; wait\n")
    with pytest.raises(ValueError, match="did not end within 1 s"):
        compiled.measure_footprint(tmp_path)
    pid = int((tmp_path / "pid").read_text())
    time.sleep(0.2)
    state = Path(f"/proc/{pid}/stat")
    assert not state.exists() or state.read_text().split()[2] == "Z"


def test_other_code_or_compilers_are_another_run(monkeypatch):
    (plan,) = make_plans(
        make_cells({"model": "bayes", "features": "jung28", "data.subjects": "4"}), 1
    )
    of = lambda bits: plan.with_cell(replace(plan.cell, circumstances=(InC("c", bits),))).key  # noqa: E731
    key = of("8")
    assert key == of("8") != of("32")
    monkeypatch.setattr(compiled, "toolchain_versions", lambda: ["cc 99"])
    assert of("8") != key
    assert network.__name__ in InC("c", "8").code()


@pytest.mark.live
@pytest.mark.skipif(
    bool(compiled.missing_programs()),
    reason=f"{', '.join(compiled.missing_programs())} not installed",
)
def test_a_chip_is_measured():
    assert main(["run", "form=c", "model=bayes", *SMALL]) == 0
    (run,) = runs("cell")[1]
    metrics = run.data.metrics
    assert metrics["chip_table_bytes"] == pytest.approx(metrics["flash_bytes"], rel=0.1)
    assert metrics["chip_ram_bytes"] == pytest.approx(metrics["ram_bytes"], rel=0.15)
    room = (
        metrics["chip_program_ram_bytes"] - metrics["chip_ram_bytes"]
    )  # a stack of 4 kB and the library of C
    assert 4096 < room < 4096 + 8192
    assert 50 < metrics["chip_stack_bytes"] < 2000
    assert (
        metrics["chip_code_bytes"] + metrics["chip_table_bytes"]
        < metrics["chip_flash_bytes"]
        < 64e3
    )
    assert 1000 < metrics["chip_frame_instructions"] < metrics["chip_most_instructions"] < 1e6


def test_c_is_a_candidate_with_its_own_size_and_cycles():
    chip = {"chip_ram_bytes": 1000.0, "chip_most_instructions": 6e4}
    c = {"c": make_predictions(per_class=1)}
    sizes = {"32": 9000.0, "8": 5000.0}
    in_c = [
        costly("lda", None, c, **chip, **{"chip_flash_bytes": n, "chip.bits": b})
        for b, n in sizes.items()
    ]
    table = find_candidates([costly("lda"), costly("svm"), *in_c], {}, clock=0.5).table
    assert table[["unit", "flash", "linked", "decision"]].to_numpy().tolist() == [
        ["capture", 9, True, 300],  # of Python what is linked, which the count leaves code out of
        ["in C, 32 bits", 9, True, 420],  # 60,000 cycles at 0.5 MHz
        ["in C, 8 bits", 5, True, 420],
        ["capture", 4, False, 300],
    ]
    assert table["cycles"].tolist()[1:3] == [60, 60] and table["cycles"].isna().tolist() == [
        True,
        False,
        False,
        True,
    ]
