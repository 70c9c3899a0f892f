"""Systems as C beside themselves in Python: labels, costs, and what reads them."""

import json
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.export import measure as compiled
from bench.export import network
from bench.outcomes import scores
from bench.outcomes.choice import candidates
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.work import chip as onchip
from bench.work import saved
from bench.work.chip import OnChip
from bench.work.tracking import key_of
from tests.conftest import predictions, runs
from tests.export.compiled import lacking

SMALL = ["features=jung28", "data.subjects=4", "data.repetitions=2", "data.variants=normal"]
COSTS = {
    "chip_flash_bytes": 9000.0,
    "chip_code_bytes": 2000.0,
    "chip_table_bytes": 5000.0,
    "chip_ram_bytes": 3000.0,
    "chip_program_ram_bytes": 11_000.0,
    "chip_stack_bytes": 400.0,
    "chip_frame_instructions": 5000.0,
    "chip_most_instructions": 60_000.0,
}


@pytest.fixture
def costs(monkeypatch):
    """No chip, whose compiler and emulator the marked test needs."""
    monkeypatch.setattr(onchip, "measured", lambda folder: COSTS)
    monkeypatch.setattr(onchip, "lacking", lambda: [])


@pytest.mark.skipif(bool(lacking("cc")), reason=lacking("cc"))
def test_what_c_says_is_tracked_chosen_and_drawn(costs, capsys):
    assert main(["chip", "model=bayes", "bits=32,8", *SMALL]) == 0
    assert main(["choose"]) == 0  # where nothing but C is tracked
    assert main(["run", "model=bayes", *SMALL]) == 0
    out = capsys.readouterr().out
    assert "in Python" in out and "60,000" in out and "9.0" in out
    row = OnChip(8).row(COSTS)
    assert [row[name] for name in ("library RAM kB", "program RAM kB", "stack B")] == ["3.0", "11.0", "400"]
    store, found = runs("chip")
    whole = scores.captures(predictions(store, runs("cell")[1][0]))
    for run in found:
        table = predictions(store, run)
        assert table["python"].tolist() == whole["predicted"].tolist() and table["capture"].is_unique
        own = scores.captures(table)["predicted"]
        assert run.data.metrics["other_labels"] == (own != table["python"]).sum() <= 0.1 * len(table)
        assert run.data.metrics["accuracy"] == pytest.approx((own == table["true"]).mean())
        assert run.data.metrics["python_accuracy"] == pytest.approx((whole["predicted"] == whole["true"]).mean())
        np.testing.assert_allclose(table.filter(like="p_").sum(axis=1), 1, rtol=1e-4)
    assert sorted(run.data.params["chip.bits"] for run in found) == ["32", "8"]
    named = candidates(connect(), {}).table
    assert named["unit"].tolist() == ["capture", "in C, 32 bits", "in C, 8 bits"]
    assert named["cycles"].tolist()[1:] == [60, 60] and np.isnan(named["cycles"][0]) and named["flash"][1] == 9
    assert named["flash"][0] == 9  # of Python what is linked, which the count leaves code out of
    touch = named["decision"][0]
    assert named["decision"].tolist() == [touch] * 3
    timed = candidates(connect(), {}, clock=0.5).table["decision"]
    assert timed.tolist() == pytest.approx([touch, touch + 120, touch + 120])  # 60,000 cycles at 0.5 MHz
    assert main(["choose", f"max_decision={touch + 1}ms", "clock=500kHz"]) == 0
    out = re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    assert "for 2 of 3 candidates, plus the measured cycles at 0.5 MHz" in out and "ruled out: decision" in out
    for wrong in ("64", "MHz", "-1MHz", "nanMHz"):
        assert main(["choose", f"clock={wrong}"]) == 2 and f"clock={wrong}: give a number" in capsys.readouterr().err
    assert main(["choose", "max_cycles=0.1M"]) == 0
    assert "cycles not known" in re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    assert main(["choose", "max_cycles=59999"]) == 2 and "max_cycles=59999" in capsys.readouterr().err
    assert main(["choose", "max_cycles=59k"]) == 1
    assert main(["report"]) == 0
    page = open("report/index.html", encoding="utf-8").read()
    data = json.loads(page.split('id="chart-data">')[1].split("</script>")[0])
    (group,) = data["groups"]
    drawn = {p["name"]: p["x"] for p in group["points"]}
    place = next(i for i, words in enumerate(data["costs"]) if words.startswith("thousand instructions"))
    assert drawn["bayes · jung28 (in C, 8 bits)"][place] == 60 and drawn["bayes · jung28"][place] is None


def test_what_cannot_be_is_refused_before_anything_runs(monkeypatch, capsys):
    monkeypatch.setattr(compiled.shutil, "which", lambda name: None if "arm" in name else "/bin/true")
    for arguments, said in {
        ("model=bayes", "features=jung28"): "needs arm-none-eabi-gcc, qemu-system-arm, not installed here",
        ("model=cnn85",): "has no C",
        ("model=lda", "features=touch"): "fit with model.window=1",
        ("model=bayes", "features=jung54"): "Jung54 has no C",
        ("model=bayes", "features=jung28", "bits=16"): "bits=16: give 32 or 8",
        ("model=lda", "features=touch", "model.window=1", "model.hop=0.1"): "leave model.hop= out",
        ("model=reflex", "model.scale=peak"): "reflex behind steps of its own has no C",
    }.items():
        assert main(["chip", *arguments, *SMALL[1:]]) == 2
        assert said in capsys.readouterr().err


def test_c_that_does_not_fit_is_a_failed_fold(tmp_path):
    (tmp_path / "Makefile").write_text(
        "flash count chip:\n\t@echo x does not fit: FLASH=1K is 9 bytes too small >&2; echo make failed >&2; exit 1\n"
    )
    if shutil.which("make") is None:
        pytest.skip("make not installed")
    with pytest.raises(ValueError, match="flash count chip: x does not fit: FLASH=1K is 9 bytes too small$"):
        compiled.measured(tmp_path)
    (tmp_path / "Makefile").write_text("flash count chip:\n\t@echo nothing\n")
    with pytest.raises(ValueError, match="said nothing of flash"):
        compiled.measured(tmp_path)


def test_what_it_starts_ends_with_it(tmp_path, monkeypatch):
    """QEMU in an endless loop would stay, as only make is ended."""
    monkeypatch.setattr(compiled, "LIMIT_S", 1)
    (tmp_path / "Makefile").write_text("flash count chip:\n\t@sleep 4321 & echo $$! > pid; wait\n")
    with pytest.raises(ValueError, match="did not end within 1 s"):
        compiled.measured(tmp_path)
    pid = int((tmp_path / "pid").read_text())
    time.sleep(0.2)
    state = Path(f"/proc/{pid}/stat")
    assert not state.exists() or state.read_text().split()[2] == "Z"


def test_other_code_or_compilers_are_another_run(monkeypatch):
    (plan,) = planned(cells({"model": "bayes", "features": "jung28", "data.subjects": "4"}), 1)
    key = key_of(plan, OnChip(8))
    assert key == key_of(plan, OnChip(8)) != key_of(plan, OnChip(32))
    monkeypatch.setattr(onchip, "toolchain", lambda: ["cc 99"])
    assert key_of(plan, OnChip(8)) != key
    assert {network.__name__, saved.__name__} <= {
        part.__name__ for part in OnChip(8).depends() if hasattr(part, "__file__")
    }


@pytest.mark.live
@pytest.mark.skipif(bool(compiled.lacking()), reason=f"{', '.join(compiled.lacking())} not installed")
def test_a_chip_is_measured():
    assert main(["chip", "model=bayes", *SMALL]) == 0
    (run,) = runs("chip")[1]
    found = run.data.metrics
    assert found["chip_table_bytes"] == pytest.approx(found["flash_bytes"], rel=0.1)
    assert found["chip_ram_bytes"] == pytest.approx(found["ram_bytes"], rel=0.1)
    assert found["chip_ram_bytes"] + 4096 < found["chip_program_ram_bytes"] < found["chip_ram_bytes"] + 4096 + 8192
    assert 50 < found["chip_stack_bytes"] < 2000
    assert found["chip_code_bytes"] + found["chip_table_bytes"] < found["chip_flash_bytes"] < 64e3
    assert 1000 < found["chip_frame_instructions"] < found["chip_most_instructions"] < 1e6
