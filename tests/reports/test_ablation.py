"""The ablation: rows that can be run, numbers that are those of its runs, and what it says of bad input."""

import numpy as np
import pandas as pd
import pytest

from bench import corpus
from bench.errors import InputError
from bench.outcomes import scores
from bench.plan.cells import cells
from models import contract
from reports.ablation import CHANCES, NETWORKS, ROWS, main
from tests.conftest import runs


@pytest.mark.parametrize("label", ROWS | CHANCES)
def test_every_row_is_a_system_that_can_be_made(label):
    (cell,) = cells((ROWS | CHANCES)[label])
    contract.check(cell.estimator())
    assert (len(contract.trained_faults(cell.estimator())) == 17) == (
        ("faults" in label and "without" not in label) or (label.startswith("reflex") and "without faults" not in label)
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rows=nope"], "rows=nope: not known"),
        (["data=a,b"], "data=a,b: give one"),
        (["protocol=loso,challenge"], "protocol=loso,challenge: give one"),
        (["out=taken"], "out=taken: taken cannot be written"),
        (["row=x"], "row"),
        (["rows=networks", "device=nonsense"], "model.device=nonsense"),
        (["rows=networks", "device=cpu,cuda"], "device=cpu,cuda: give one"),
        (["rows=reflex", "device=cpu"], "none of these rows is a network"),
        (["rows=reflex", "protocol=loso", "protocol.typo=3"], "no parameter 'typo'"),
    ],
)
def test_bad_input_gets_one_line(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").touch()
    with pytest.raises(InputError, match=said):
        main(arguments)


def test_its_numbers_are_those_of_its_runs(tmp_path, monkeypatch):
    monkeypatch.setitem(ROWS, "quick", {"model": "bayes", "features": "jung28", "data.subjects": "3"})
    monkeypatch.setattr("bench.commands.stress.known", few_faults)
    assert main(["data=synth", "rows=quick", f"out={tmp_path / 'a'}"]) == 0
    found = pd.read_csv(tmp_path / "a" / "ablation.csv").iloc[0]
    store, (stress,) = runs("stress")
    table = pd.read_parquet(store.fetched(stress.info.run_id, "stress.parquet"))
    right = (table["true"] == table["predicted"]).groupby([table["fault"], table["severity"]]).mean()
    clean = right[right.index.get_level_values("severity") == 0].iloc[0]
    worse = right[right.index.get_level_values("severity") > 0]
    assert len(worse) == 10 and found["loss"] == pytest.approx((clean - worse).mean())
    assert found["accuracy"] == pytest.approx(clean)
    rate = corpus("synth", subjects=3).rate_hz
    store, (stream,) = runs("stream")
    replayed = pd.read_parquet(store.fetched(stream.info.run_id, "predictions.parquet"))
    seen = replayed[replayed["frames"] <= rate].groupby("capture").tail(1)
    columns = [c for c in seen if c.startswith(scores.PREFIX)]
    named = np.array([c.removeprefix(scores.PREFIX) for c in columns])[seen[columns].to_numpy().argmax(axis=1)]
    assert found["accuracy_1000_ms"] == pytest.approx((named == seen["true"].to_numpy(dtype=str)).mean())
    assert (tmp_path / "a" / "ablation.png").stat().st_size > 10_000
    words = (tmp_path / "a" / "ablation.md").read_text()
    assert "| quick |" in words and words.startswith("synth (synthetic), LOSO")
    assert "not people" in (tmp_path / "a" / "ablation.svg").read_text()


def test_a_label_means_one_row_and_networks_differ_by_the_recipe_alone():
    assert all(ROWS[label] == CHANCES[label] for label in ROWS.keys() & CHANCES.keys())
    assert len(CHANCES) == 2 + 2 * len(NETWORKS)
    for name in NETWORKS:
        published, recipe = (cells(keys)[0].estimator() for label, keys in CHANCES.items() if label.split()[0] == name)
        assert recipe.system.get_params() | {"epochs": 0} == published.get_params() | {"epochs": 0}
        assert (recipe.scale, recipe.repair, recipe.copies) == ("log", ("stuck", "dead"), 1)


def few_faults():
    from bench.corpora.faults import FAULTS

    return {name: FAULTS[name] for name in ("noise", "shift")}
