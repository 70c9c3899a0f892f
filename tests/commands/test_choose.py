"""The command ``bench choose``: what it prints, what it loads, and the choice over a parameter inside the folds."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd
import pytest

import bench
from bench.cli import main
from tests.reports.store import made_up, stressed, tracked_run


def typed_run(model):
    """The tags of a run that was typed."""
    return {"touchbench.command": "run", "touchbench.arguments": json.dumps({"data": "synth", "model": model})}


FEW = ["data.subjects=4", "data.repetitions=2", "data.variants=normal"]


def test_the_verdict_and_what_is_loaded_for_it(store):
    for system in ("lda", "svm", "rf"):
        arguments = json.dumps({"data": "synth", "model": system, "features": "jung28"})
        tracked_run(store, system, made_up(), **{"touchbench.command": "run", "touchbench.arguments": arguments})
    code = "import sys; from bench.cli import main; main(['choose']); print({'torch', 'sklearn'} & set(sys.modules))"
    lines = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()
    assert lines[-1] == "set()" and lines[-2].startswith("next: bench fit data=synth model=")
    assert any(line.startswith("Choose ") for line in lines)


@pytest.mark.parametrize(
    "limits", [["by=flash"], ["max_flash=20kB", "max_ram=1MB", "max_decision=9s", "max_predict=9s"]]
)
@pytest.mark.parametrize("flash", [6.0, 30.0])
def test_eight_lines_follow_the_table_and_why_prints_the_rest(limits, flash, store, capsys):
    """Of a protocol that mixes people, with a failed run; nothing fits the budgets, or a system does."""
    for i, cost in enumerate((flash, 2 * flash, 3 * flash)):
        about = typed_run(f"m{i}") | {"mixes_subjects": "true"}
        tracked_run(store, f"m{i}", made_up(8, seed=i), cost=cost, **about)
    tracked_run(store, "failed", made_up(8), failed=1)

    def below(*more):
        main(["choose", "data=synth", *limits, *more])
        return capsys.readouterr().out.rpartition("┘")[2].strip().splitlines()

    brief, every = below(), below("why=yes")
    assert (
        len(brief) <= 8 and len(brief) <= len(every) and brief[-1].startswith(("next: bench fit", "Try a small system"))
    )
    (more,) = [line for line in brief if "with why=yes." in line]
    assert int(more.split()[0]) == len([line for line in every if line not in brief])
    assert (
        {*brief} - {more} <= {*every}
        and any(line.startswith(("Expect ", "The lowest")) for line in brief[1:])
        or ("rules out 3 of 3 systems" in brief[1])
    )


def kept(store, run, **tables):
    """Store tables with a run: parquet for labels, CSV else."""
    with tempfile.TemporaryDirectory() as folder:
        for name, table in tables.items():
            if name == "labels":
                table.to_parquet(Path(folder) / "labels.parquet")
            else:
                table.to_csv(Path(folder) / f"{name}.csv", index=False)
        store.keep(run, Path(folder))


SCENE = """
[reactions]
calm = ["pat", "rub"]
[costs]
tap = { calm = 3 }
[faults]
names = ["noise"]
severity = 2
loss = 40
[people]
worst_person = 10
"""


def test_a_scene_scores_reactions_and_asks_for_losses_and_the_worst_person(store, tmp_path, capsys):
    """Captures of three people; those of svm are scored by a loop, its losses are worked out by hand."""
    (tmp_path / "robot.toml").write_text(SCENE)
    tables = {"svm": made_up(subjects=3, seed=1, skill=0.9), "lda": made_up(subjects=3, seed=2, skill=0.2)}
    for system, table in tables.items():
        arguments = json.dumps({"data": "haart", "protocol": "loso", "model": system})
        about = {"data": "haart", "synthetic": "false", "subset": "all", "corpus_digest": "d"}
        tags = {"touchbench.command": "run", "touchbench.arguments": arguments, "protocol_label": "LOSO (10 subjects)"}
        tracked_run(store, system, table, **about, **tags)
    # Clean: all right. Under noise 1 nothing changes; under noise 2 subject 1 takes a tap for a pat once in two.
    rows = [(s, k, "tap", "tap", "none", 0) for s in "123" for k in (0, 1)]
    rows += [
        (s, k, "tap", "rub" if (v, s, k) == (2, "1", 0) else "tap", "noise", v)
        for v in (1, 2)
        for s in "123"
        for k in (0, 1)
    ]
    table = pd.DataFrame(rows, columns=["subject", "capture", "true", "predicted", "case", "level"])
    table = pd.concat([table, table.assign(case="noise", level=3, predicted="pat")])
    table["circumstance"] = table["case"].map({"none": "", "noise": "under"})
    stressed_run = stressed(store, "svm", 1.0, {"noise": 0.0})
    kept(store, stressed_run, labels=table.assign(fold=table["subject"], train_subjects=2))
    result = bench.choose(data="haart", scene=str(tmp_path / "robot.toml"), why=True)
    rows = result.choice.table.set_index("system")
    costs = {}
    for row in tables["svm"].to_dict("records"):
        calm = row["p_pat"] + row["p_rub"]
        said = min((3 * row["p_tap"], "calm"), (calm, "tap"))[1]
        meant = "tap" if row["true"] == "tap" else "calm"
        costs.setdefault(row["subject"], []).append(0 if said == meant else 3 if meant == "tap" else 1)
    scores = {subject: 100 * (1 - sum(each) / len(each)) for subject, each in costs.items()}
    assert rows.loc["svm", "accuracy"] == pytest.approx(sum(scores.values()) / 3)
    assert rows.loc["svm", "worst_person"] == pytest.approx(min(scores.values()))
    assert rows.loc["svm", "fault_loss"] == pytest.approx(
        100 * 3 / 2 / 3 / 2
    )  # of one subject in three, severity in two
    assert rows.loc["svm", "worst_fault"] == pytest.approx(100 * 3 / 2 / 3)
    assert result.system == "svm" and "fault loss" in rows.loc["lda", "verdict"]
    for fact in (
        "To measure it: bench stress data=haart protocol=loso model=lda faults=noise.",
        "3 subjects: too few for an interval. The order may differ for other people.",
        "Reactions: calm (pat, rub); unlisted gestures are their own reaction.",
        "tap taken for calm 3, doing nothing 1, any other mistake 1",
    ):
        assert fact in str(result)
    overridden = bench.choose(data="haart", scene=str(tmp_path / "robot.toml"), max_fault_loss=20)
    assert overridden.system is None and overridden.budgets["fault_loss"] == 20
    assert main(["choose", "data=haart", f"scene={tmp_path / 'other.toml'}"]) == 2
    (tmp_path / "wrong.toml").write_text('[reactions]\ncalm = ["path"]')
    assert main(["choose", "data=haart", f"scene={tmp_path / 'wrong.toml'}"]) == 2
    assert "did you mean pat" in capsys.readouterr().err
