"""Gates of the design: a new cost, and a new column, are one entry and the line that measures them."""

import contextlib
import io
import re
import sys
from collections import Counter
from pathlib import Path

import pandas as pd
import pytest

from bench import measures
from bench.cli import main
from bench.commands.choose import Chosen
from bench.options import help_of
from bench.outcomes.candidates import candidates
from bench.outcomes.choice import decide
from tests.conftest import SMALL
from tests.results import evaluated, with_hits

PLUGGED = """
from bench.measures import Cost, Measure

ENERGY = Cost(
    "energy",
    unit="mJ",
    noun="energy",
    words="of energy",
    axis="mJ to compute a label",
    help="most energy of a label, such as 2",
    latex="mJ",
)
AMONG = Cost(
    "worst_half",
    unit="%",
    noun="error of the worse half of people",
    words="wrong for the worse half",
    axis="% wrong for the worse half of people",
    help="largest error of the worse half of people",
    column=False,
    zero=True,
    among=lambda people, drawn: people.error(drawn, drawn.shape[1] // 2),
)
HEAT = Cost("heat", ends="heat", unit="K", column=False)
BATTERY = Cost("battery", unit="h", noun="battery life", better="high", help="least battery life")
HUMS = Measure("hums", "hum dB", form=".3f", shows=("terminal", "page", "latex", "csv"))
WRONG = 3.0
FLASH = Cost("flash")
LINE = Cost("my_flash", line=("budget", "flash"))
HEADING = Measure("my_n", "n", shows=("page",))
"""
POINTS = """
[touchbench.costs]
energy = plugged_in:ENERGY
half = plugged_in:AMONG
battery = plugged_in:BATTERY
heat = plugged_in:HEAT
[touchbench.columns]
hums = plugged_in:HUMS
"""
MEASURED = {"energy": 1.25, "heat": 2.0, "heat_low": 1.0, "heat_high": 3.0, "hums": 3.14159}


@pytest.fixture
def plug(tmp_path, monkeypatch):
    """Install a package with these entry points, in a folder of its own."""
    site = tmp_path / "site"
    info = site / "watts-1.0.dist-info"

    def forget():
        measures.plugged.cache_clear()
        measures.costs.cache_clear()
        sys.modules.pop("plugged_in", None)

    def install(points, source=PLUGGED):
        info.mkdir(parents=True, exist_ok=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: watts\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(points)
        (site / "plugged_in.py").write_text(source)
        monkeypatch.syspath_prepend(site)
        forget()

    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield install
    forget()


@pytest.fixture
def entered(plug, monkeypatch):
    """An installed package with the entries, and the line that measures them in each fold."""
    plug(POINTS)
    from bench.work import evaluation

    footprint, folds = evaluation.footprint, Counter()

    def measured(estimator, corpus):
        scale = 2.0 if "Tree" in repr(estimator) else 1.0
        folds[scale] += 1
        battery = scale * (40.0 if folds[scale] == 2 else 80.0)  # the second fold is the worst
        return (
            footprint(estimator, corpus)
            | {name: value * scale for name, value in MEASURED.items()}
            | {"battery": battery}
        )

    monkeypatch.setattr(evaluation, "footprint", measured)
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)


def done(arguments):
    """Exit code and output of a command."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        return main(arguments), out.getvalue()


def test_of_some_costs_more_is_better(entered):
    """Equally accurate systems that last 40 and 80 hours."""
    lasting = [evaluated(name, with_hits([10, 12]), metrics={"battery": h}) for name, h in (("a", 40.0), ("b", 80.0))]
    among = candidates({"cell": lasting}, {})
    loose, tight = (decide(among.table, among.subjects, "battery", {"battery": h}, None) for h in (40.0, 80.0))
    assert loose.chosen == tight.chosen == 1 and tight.budgets[0].over == 1 and loose.budgets[0].over == 0
    assert tight.table["verdict"].to_dict() == {1: "chosen", 0: "ruled out: battery 40 h < 80 h"}
    said = str(Chosen(loose, among, "battery", {"battery": 40.0}, None))
    assert "Choose b: 55.0 % with 80 h" in said and "score and battery life: a (by b)." in said


def test_a_new_cost_and_a_new_column_appear_everywhere(entered):
    code, printed = done(["run", *SMALL, "model=tree,lda", "features=jung28"])
    assert code == 0
    cells = [[cell.strip() for cell in re.split("[│┃]", line)] for line in printed.splitlines() if line[:1] in "│┃"]
    table = pd.DataFrame(cells[1:], columns=cells[0])
    assert [*table["energy"]] == ["2.5", "1.2"] and [*table["battery"]] == ["80.0", "40.0"]
    assert [*table["hum dB"]] == ["6.283", "3.142"]  # 1.25 is rounded to even

    code, printed = done(["choose", "by=energy"])
    assert code == 0 and "with 1.25 mJ of energy." in printed and "lowest energy first" in printed
    assert done(["choose", "max_energy=2"])[1].count("ruled out: energy 2.5 mJ > 2 mJ") == 1
    assert done(["choose", "max_energy=1"])[0] == 1
    assert "with 2 K of heat." in done(["choose", "by=heat"])[1]  # the value of an interval
    printed = done(["choose", "min_battery=50"])[1]
    assert "ruled out: battery 40 h < 50 h" in printed and "battery at least 50 h" in printed
    printed = done(["choose", "by=battery", "min_battery=90"])[1]
    assert "highest battery first" in printed and "The highest battery life is 80 h" in printed
    code, printed = done(["choose", "max_worst_half=0"])
    assert code == 1 and "for error of the worse half of people rules out 2 of 2 systems" in printed

    Path("robot.toml").write_text("by = 'energy'\n[budget]\nenergy = 2\nbattery = 30\n")
    code, printed = done(["choose", "scene=robot.toml"])
    assert code == 0 and "energy at most 2 mJ, battery at least 30 h" in printed
    Path("robot.toml").write_text("[budget]\nenergy = 'much'\n")
    assert done(["choose", "scene=robot.toml"])[0] == 2

    for command in ("choose", "report"):
        assert re.search("max_energy= +most energy of a label, such as 2", help_of(command))
        assert "min_battery=" in help_of(command)
    assert "worst_half" in help_of("choose")

    assert done(["report", "max_energy=2"])[0] == 0
    csv = pd.read_csv("report/comparison.csv").set_index("system")
    assert csv["energy"].to_dict() == {"tree · jung28": 2.5, "lda · jung28": 1.25}
    assert csv["hums"]["lda · jung28"] == MEASURED["hums"]
    latex = Path("report/comparison.tex").read_text()
    assert re.search(r"system & .*\bmJ\b.* & hum dB", latex) and "3.142" in latex
    page = Path("report/index.html").read_text()
    for words in ('<th scope="col">energy</th>', "<td>6.283</td>", "mJ to compute a label", "max_energy=2"):
        assert words in page
    steps = pd.read_csv("report/budgets.csv")
    assert {"energy", "battery", "worst_half"} <= {*steps["cost"]}
    assert [*steps.query("cost == 'battery'")["least"]] == sorted(
        steps.query("cost == 'battery'")["least"], reverse=True
    )
    assert re.search(">up to (80|40) h<", page) and not re.search(">from [0-9.]+ h on<", page)


@pytest.mark.parametrize(
    ("point", "facts"),
    [
        ("costs:gone = no_such_module:ENERGY", ["gone", "no_such_module"]),
        ("costs:lost = plugged_in:LOST", ["lost", "LOST"]),
        ("costs:wrong = plugged_in:WRONG", ["no bench.measures.Cost but float"]),
        ("costs:column = plugged_in:HUMS", ["no bench.measures.Cost but Measure"]),
        ("columns:wrong = plugged_in:WRONG", ["no bench.measures.Measure but float"]),
        ("costs:flash = plugged_in:FLASH", ["the key flash is taken"]),
        ("costs:line = plugged_in:LINE", ["the line [budget] flash is taken"]),
        ("columns:heading = plugged_in:HEADING", ["the heading n is taken"]),
    ],
)
def test_a_wrong_entry_is_refused_in_one_line_before_any_work(plug, capsys, point, facts):
    group, _, line = point.partition(":")
    plug(f"[touchbench.{group}]\n{line}\n")
    assert main(["run", *SMALL, "model=tree", "features=jung28"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "package watts" in error and f"touchbench.{group}" in error
    assert all(fact in error for fact in facts)
    assert main(["run", "--help"]) == 0  # which needs no costs
    assert group == "columns" or main(["choose", "--help"]) == 2


def test_a_cost_that_should_be_higher_is_refused(plug, capsys):
    plug("[touchbench.costs]\nhigher = plugged_in:BATTERY\n", PLUGGED.replace('"high"', '"higher"'))
    assert main(["choose"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "higher" in error and "give low or high" in error
