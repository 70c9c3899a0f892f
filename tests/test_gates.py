"""Gates of the design: a new cost, and a new column, are one entry and the line that measures them."""

import ast
import contextlib
import io
import re
import sys
from collections import Counter
from pathlib import Path

import pandas as pd
import pytest

import bench
from bench import registry
from bench.cli import main
from bench.commands.choose import Chosen
from bench.options import help_of, overview
from bench.outcomes.candidates import candidates
from bench.outcomes.choice import decide
from bench.outcomes.runs import every_result
from tests.conftest import SMALL, runs
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
    noun="accuracy of the worse half of people",
    words="correct for the worse half",
    axis="% correct for the worse half of people",
    help="least accuracy of the worse half of people",
    better="high",
    column=False,
    zero=True,
    among=lambda people, drawn: people.lowest(drawn, drawn.shape[1] // 2),
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
def entered(plug, monkeypatch):
    """An installed package with the entries, and the line that measures them in each fold."""
    plug(POINTS, PLUGGED, "plugged_in")
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
    among = candidates(lasting, {})
    loose, tight = (decide(among.table, among.subjects, "battery", {"battery": h}, None) for h in (40.0, 80.0))
    assert loose.chosen == tight.chosen == 1 and tight.budgets[0].over == 1 and loose.budgets[0].over == 0
    assert tight.table["verdict"].to_dict() == {1: "chosen", 0: "ruled out: battery 40 h < 80 h"}
    said = str(Chosen(loose, among, "battery", {"battery": 40.0}, None, why=True))
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
    code, printed = done(["choose", "min_worst_half=100"])
    assert code == 1 and "for accuracy of the worse half of people rules out 2 of 2 systems" in printed

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
    plug(f"[touchbench.{group}]\n{line}\n", PLUGGED, "plugged_in")
    assert main(["run", *SMALL, "model=tree", "features=jung28"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "package watts" in error and f"touchbench.{group}" in error
    assert all(fact in error for fact in facts)
    assert main(["run", "--help"]) == 0  # which needs no costs
    assert group == "columns" or main(["choose", "--help"]) == 2


def test_a_cost_that_should_be_higher_is_refused(plug, capsys):
    plug("[touchbench.costs]\nhigher = plugged_in:BATTERY\n", PLUGGED.replace('"high"', '"higher"'), "plugged_in")
    assert main(["choose"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "higher" in error and "give low or high" in error


PLUGINS = Path(__file__).parent / "plugged"


def code_of(name):
    """A file that an installed package would have, which may be no longer than the gate allows."""
    return (PLUGINS / f"{name}.py").read_text()


def page_has(*words):
    page = Path("report/index.html").read_text()
    assert [w for w in words if w not in page] == []


def test_a_new_circumstance_is_one_file_and_appears_everywhere(plug, monkeypatch):
    """Fewer captures of each class: printed, in a CSV file, on the page with a figure, a candidate, with a budget."""
    source = code_of("fewer")
    assert len(source.splitlines()) <= 45
    plug("[touchbench.circumstances]\neach = fewer:Fewer\n", source, "fewer")
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)
    assert "each=" in help_of("run") and "max_each_loss=" in help_of("choose") and "max_each_loss=" in help_of("report")
    code, printed = done(["run", *SMALL, "model=tree,lda", "features=jung28", "each=2,1"])
    assert code == 0 and "Accuracy in percent by training captures of each class" in printed
    (store, stored_runs) = runs("cell")
    for run in stored_runs:
        labels = every_result(store)[0].tables["labels"]
        assert {*labels["circumstance"]} == {"", "each"} and {*labels["level"]} == {0, 1, 2}
        number = f"{100 * run.data.metrics['accuracy.each.1']:.1f}"
        row = [line for line in printed.splitlines() if run.data.tags["system"] in line][-1]
        loss = (
            run.data.metrics["accuracy"]
            - (run.data.metrics["accuracy.each.1"] + run.data.metrics["accuracy.each.2"]) / 2
        )
        assert run.data.metrics["loss.each"] == pytest.approx(loss) and f"{100 * loss:.1f}" in row and number in row
    assert done(["run", *SMALL, "model=tree", "features=jung28", "each=0"])[0] == 2
    table = bench.choose(data="synth").choice.table
    assert {"1 captures of each class", "2 captures of each class", "capture"} == {*table["unit"]}
    printed = done(["choose", "max_each_loss=0", "why=yes"])[1]
    assert "loss to few captures" in printed and done(["choose", "max_each_loss=100"])[0] == 0
    Path("robot.toml").write_text("[budget]\neach_loss = 100\n")
    assert done(["choose", "scene=robot.toml"])[0] == 0
    assert done(["report", "max_each_loss=100"])[0] == 0
    page_has("Accuracy in percent by training captures of each class", "max_each_loss=100")
    sheet = pd.read_csv("report/each.csv")
    assert {*sheet["system"]} == {"tree · jung28", "lda · jung28"} and {*sheet["level"]} == {1, 2}
    assert [*Path("report/figures").glob("*each*.svg")]


def test_a_new_kind_of_run_is_one_file_and_appears_everywhere(plug, monkeypatch):
    """Late captures: a command with help, an API function, a row, a CSV file, a section, a candidate, a budget."""
    source = code_of("halves")
    assert len(source.splitlines()) <= 80
    plug("[touchbench.kinds]\nhalves = halves:Halves\n", source, "halves")
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)
    assert "share= " in help_of("halves") and "halves" in overview() and "max_tested=" in help_of("choose")
    code, printed = done(["halves", *SMALL, "model=tree", "features=jung28", "share=0.25"])
    assert code == 0 and "Accuracy in percent on late captures" in printed
    _, (run,) = runs("halves")
    assert run.data.params["halves.share"] == "0.25" and run.data.metrics["tested"] > 0
    assert done(["halves", *SMALL, "model=tree", "features=jung28", "share=-1"])[0] == 2
    table = bench.halves(**dict(key.split("=") for key in SMALL), model="tree", features="jung28", share=0.25)
    assert len(runs("halves")[1]) == 1 and len(table) == 1  # found again
    assert done(["run", *SMALL, "model=tree", "features=jung28"])[0] == 0
    assert {*bench.choose(data="synth").choice.table["unit"]} == {"late captures", "capture"}
    assert done(["choose", "max_tested=1"])[0] == 1
    assert done(["report"])[0] == 0
    page_has("Late captures", "Accuracy on late captures.")
    assert len(pd.read_csv("report/halves.csv")) == 1


@pytest.mark.parametrize("group", ["circumstances", "kinds"])
def test_a_wrong_kind_or_circumstance_is_refused_in_one_line(plug, capsys, group):
    plug(f"[touchbench.{group}]\ngone = no_such_module:Gone\n", "", "empty")
    assert main(["run", *SMALL, "model=tree", "features=jung28"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"touchbench.{group}" in error and "gone" in error
    assert (
        main(["gone"]) == 2 and f"touchbench.{group}" in capsys.readouterr().err
    )  # it may be a command of that package
    assert [main(words) for words in (["--help"], ["run", "--help"], ["papers"])] == [0, 0, 0]  # which make no runs
    assert capsys.readouterr().err.count(f"warning: the entry point gone in touchbench.{group}") == 1  # not in help


def own_names(package=""):
    """Tags, commands and keys of kinds and circumstances (of a package), keys of their costs, and their modules."""
    names = set()
    for room in ("kinds", "circumstances"):
        for one in (one for one in registry.classes(room).values() if one.__module__.startswith(package)):
            names |= {*one.commands, getattr(one, "tag", ""), getattr(one, "key", ""), one.__module__}
            names |= {cost.key for cost in one.costs}
    # the command that all others are compared with; a parameter of protocols; a column of every table of labels
    return names - {"", "run", "shots", "train_subjects"}


NAMED = {  # file: names that it may have, with the reason
    "bench/commands/demo.py": {"stream", "stress"},  # lines as a user types them
    "bench/in_c/write.py": {"watch"},  # a file of C
    "bench/endless/kind.py": {"stream", "under"},  # a section of scene files; faults of recordings, by the same key
    "bench/endless/candidates.py": {"decision", "cycles"},  # costs that a system that watches does not have
    "bench/scene_file.py": {"stream", "decision"},  # a section of scene files; what clock= adds to
    "bench/outcomes/candidates.py": {"decision", "cycles"},  # what clock= adds to, and what it adds
    "bench/outcomes/chosen.py": {"decision", "cycles"},  # the same; times at which a decision may fall
    "reports/candidates.py": {"decision"},  # the same
    "reports/budgets.py": {"decision"},
    "bench/outcomes/scored.py": {"decision", "stream"},  # candidates, called from their files
    "reports/streaming.py": {"stream"},  # its page, called from its file
    "bench/measures.py": {"stream"},  # the same
    "bench/commands/fit.py": {"watch"},
    "bench/corpora/read/haart.py": {"cell"},  # columns of its files
    "reports/layout.py": {"form"},  # of the output
}


def test_no_other_file_names_a_kind_or_a_circumstance():
    root = Path(registry.__file__).parents[1]
    names, found = own_names(), {}
    files = [
        path
        for folder in ("bench", "reports", "models", "features", "protocols")
        for path in (root / folder).rglob("*.py")
    ]
    away = {room.parent for room in (root / "bench").glob("*/room.py")}
    for path in (p for p in files if p.parent.name not in ("kinds", "circumstances")):
        tree = ast.parse(path.read_text())
        words = {
            node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        words |= {name for name in names for word in words if re.match(rf"{re.escape(name)}\.\w", word)}
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        added = own_names(f"bench.{path.parent.name}.") if path.parent in away else set()  # a room names what it adds
        if here := (names - added) & (words | imported):
            found[str(path.relative_to(root))] = here
    assert {file: here - NAMED.get(file, set()) for file, here in found.items() if here - NAMED.get(file, set())} == {}
    assert {file: here - found.get(file, set()) for file, here in NAMED.items() if here - found.get(file, set())} == {}


COUNTS = """
from bench.arguments import parse
from bench.options import Command, Option, keys

COUNT = Command(
    "more",
    "count letters",
    "Counts the letters of a name.",
    module="counting",
    shares="data",
    options=(Option("least", "count", "count", 1, "least letters"),),
)
LOUD = Option("loud", "fit predict", "yes", False, "yes: say so")

def count(arguments):
    print(len(parse(arguments, keys("count"))["data"]), "letters")
    return 0
"""


def test_a_package_adds_a_command_and_a_key_of_others(plug):
    points = "[touchbench.commands]\ncount = counting:COUNT\nlost = counting:LOST\n"
    points += "[touchbench.options]\nloud = counting:LOUD\n"
    plug(points, COUNTS, "counting")
    assert done(["count", "data=anna"]) == (0, "4 letters\n") and done(["count", "seed=1"])[0] == 2
    assert "data=" in help_of("count") and "least letters; default 1" in help_of("count") and "count" in overview()
    assert "loud= " in help_of("fit") and "loud= " not in help_of("run")
    assert [line.split(" in ")[0] for line in registry.broken()] == ["the entry point lost"]


def test_a_run_enters_no_other_kind_no_choice_and_no_report(tmp_path):
    """Every Python function that a run calls, with folds in this process."""
    assert done(["run", *SMALL, "model=tree", "features=jung28", "under=noise"])[0] == 0  # all is imported
    root, entered = Path(registry.__file__).parents[1], set()

    def trace(frame, event, _):
        if event == "call" and frame.f_code.co_filename.startswith(str(root)) and frame.f_code.co_name[0] != "<":
            entered.add(str(Path(frame.f_code.co_filename).relative_to(root)))

    sys.setprofile(trace)
    try:
        assert done(["run", *SMALL, "model=bayes", "features=jung28", "under=noise"])[0] == 0
    finally:
        sys.setprofile(None)
    of = {folder: {file for file in entered if file.startswith(folder)} for folder in ("bench/", "reports/")}
    kinds = {file for file in of["bench/"] if file.startswith(("bench/kinds/", "bench/circumstances/"))}
    assert kinds == {"bench/kinds/base.py", "bench/kinds/captures.py", "bench/circumstances/base.py"} | {
        "bench/circumstances/faults.py"
    }
    assert not of["reports/"]
    choice = {"candidates", "choice", "pick", "expected", "steps", "reactions", "losses", "scored"} - {"scored"}
    assert not {f"bench/outcomes/{name}.py" for name in choice} & of["bench/"]
    assert not {f"bench/commands/{name}.py" for name in ("choose", "report")} & of["bench/"]
