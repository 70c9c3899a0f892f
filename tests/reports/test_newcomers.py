"""What shots are worth: numbers by hand, who gets worse, and the blocks of the report."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bench.api import run
from bench.cli import main
from bench.outcomes.runs import tracked
from bench.outcomes.store import connect
from reports import new_person as newcomers
from reports.layout import Table
from reports.new_person import WITHOUT, comparable, curve_of, curves_of, enough, newcomer_blocks

SMALL = {"data": "synth", "data.subjects": "4", "data.repetitions": "2", "where": "gesture in ['pat', 'rub', 'grab']"}


def test_gains_are_paired_and_who_loses_is_named(monkeypatch):
    people = {"0": [80.0, 60.0, 70.0], "2": [90.0, 70.0, 65.0], WITHOUT: [82.0, 58.0, 70.0]}
    runs = pd.DataFrame(
        [
            {
                "protocol.shots": "0" if k == WITHOUT else k,
                "protocol.unlabelled": str(k == WITHOUT),
                "of": k,
                "seed": "0",
            }
            for k in people
        ]
    )
    found = lambda store, row: dict(zip("abc", people[row["of"]], strict=True))  # noqa: E731
    monkeypatch.setattr(newcomers, "subject_accuracy", found)
    curve = curve_of(None, runs).set_index("known")
    assert curve.index.tolist() == ["0", WITHOUT, "2"]
    assert curve["accuracy"].tolist() == pytest.approx([70, 70, 75])
    gain = np.array([10.0, 10, -5])
    assert curve.loc["2", "gain"] == pytest.approx(5)
    low, high = stats.t.interval(0.95, 2, gain.mean(), stats.sem(gain))
    assert (curve.loc["2", "gain_low"], curve.loc["2", "gain_high"]) == pytest.approx((low, high))
    assert curve.loc["2", "worse"] == "c (-5.0)" and curve.loc[WITHOUT, "worse"] == "b (-2.0)"


def test_the_fewest_shots_that_are_enough():
    people = pd.DataFrame({"0": [50.0, 60, 55], "1": [78.0, 82, 81], "3": [80.0, 82, 82], "5": [81.0, 82, 81]})
    # to the best, 3 or 5 at 81.33: 1 loses 1 +- 0.58, so 3 it is
    assert enough(people) == "3"
    people["1"] = [81.0, 82, 81]
    assert enough(people) == "1"


def test_what_has_no_shots_stands_beside_every_way_to_draw_some():
    told = [("0", "False", "5"), ("0", "True", "5"), ("1", "False", "2"), ("3", "False", "2"), ("1", "False", "5")]
    names = ["protocol.shots", "protocol.unlabelled", "protocol.draws"]
    runs = pd.DataFrame(told, columns=names).assign(
        data="haart", corpus_digest="d", subset="all", target="gesture", protocol_name="personal"
    )
    runs = runs.assign(**{"protocol.weight": "10", "protocol.seed": "0"})
    parts = [part[names].agg(" ".join, axis=1).tolist() for part in comparable(runs)]
    alone = ["0 False 5", "0 True 5"]
    assert parts == [[*alone, "1 False 2", "3 False 2"], [*alone, "1 False 5"]]
    assert [len(part) for part in comparable(runs[:2])] == [2]


def test_captures_without_labels_alone_are_no_curve(tmp_path):
    run(**SMALL, protocol="personal", model="lda", features="touch", **{"protocol.unlabelled": True})
    assert newcomer_blocks(curves_of(connect(), tracked(connect())), tmp_path) == []
    assert main(["report", f"out={tmp_path / 'report'}"]) == 0


def test_runs_become_a_figure_and_a_table(tmp_path):
    for shots in (0, 1):
        run(
            **SMALL,
            protocol="personal",
            model="lda",
            features="touch",
            **{"protocol.shots": shots, "protocol.draws": 2},
        )
    run(
        **SMALL,
        protocol="personal",
        model="lda",
        features="touch",
        **{"protocol.unlabelled": True, "protocol.draws": 2},
    )
    run(**SMALL, protocol="personal", model="lda", features="jung54", **{"protocol.draws": 2})  # one point is no line
    blocks = newcomer_blocks(curves_of(connect(), tracked(connect())), tmp_path)
    assert len(blocks) == 2 and "Synthetic" in blocks[0].caption and all(p.exists() for p in blocks[0].paths)
    assert isinstance(blocks[1], Table) and blocks[1].frame["known"].tolist() == ["0", WITHOUT, "1"]
    assert set(blocks[1].frame["system"]) == {"lda · touch"}
    assert blocks[1].frame["gain"][0] == "-" and blocks[1].frame["enough"][0] in ("0", "1")
    assert main(["report", f"out={tmp_path / 'report'}"]) == 0
    text = (tmp_path / "report" / "comparison.md").read_text()
    gain = blocks[1].frame["gain"].iloc[-1].split(" ")[0]
    assert f"1 known captures of each class change the accuracy of lda · touch by {gain} points" in text


@pytest.mark.parametrize("command", ["stress", "stream"])
def test_other_commands_say_that_they_do_not_adapt(command, tmp_path, capsys):
    arguments = [f"{k}={v}" for k, v in SMALL.items()]
    assert main([command, *arguments, "model=lda", "protocol=personal", "protocol.shots=1", f"out={tmp_path}"]) == 2
    assert "as they are for anybody" in "".join(capsys.readouterr())
