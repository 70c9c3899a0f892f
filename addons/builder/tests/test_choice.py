"""Accuracies to expect pay for the choice; bounds of rates; what nothing fits."""

import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from addons.streams.tests.made import PEOPLE, day
from bench.errors import InputError
from bench.reading.candidates import Candidates
from bench.reading.choice import decide
from bench.reading.scene import Scene
from touchbench_builder import certificate
from touchbench_builder import choice as choices
from touchbench_builder.certificate import expected
from touchbench_builder.choice import fitted, nested, nothing_fits
from touchbench_chip.write import most


def test_each_person_gets_the_system_that_the_others_choose():
    """Without 1, small is right in 10 and 10 %, large in 90 and 90 %: large. Without 2 or 3, both have 50: small."""
    scores = np.array([[90.0, 10, 10], [10, 90, 90]])
    table = pd.DataFrame({"system": ["small", "large"], "flash": [1.0, 2.0]})
    subjects = pd.DataFrame(scores, columns=["1", "2", "3"])
    among = Candidates(
        table, subjects, np.empty((2, 0, 3)), np.empty((0, 2, 3)), first=None, notes=[]
    )
    results = []
    for system, row in zip(table["system"], scores, strict=True):
        rows = [
            (str(p + 1), "pat", p, 10 * p + i, 1.0 * (i < row[p] / 10))
            for p in range(3)
            for i in range(10)
        ]
        labels = pd.DataFrame(rows, columns=["subject", "true", "fold", "capture", "p_pat"])
        results.append(
            SimpleNamespace(
                system=system, tables={"predictions": labels.assign(p_rub=1 - labels["p_pat"])}
            )
        )
    found = SimpleNamespace(among=among, by="flash", budgets={}, margin=None, system="large")
    labelled = nested(found, results)
    chosen = labelled.groupby("subject")["system"].unique().explode()
    assert chosen.to_dict() == {"1": "large", "2": "small", "3": "small"}
    expect = expected(labelled)
    assert expect["people"] == {
        "1": [1, 10],
        "2": [1, 10],
        "3": [1, 10],
    }  # small alone would have 37 %, large 63 %
    assert (
        expect["mean"] == 0.1
        and expect["mean_low"] is None
        and expect["systems"] == {"small": 2, "large": 1}
    )


@pytest.mark.parametrize("events", [0, 1, 7])
def test_the_bound_of_a_rate_is_that_of_poisson(events):
    assert most(events, 1.5) == pytest.approx(chi2.ppf(0.95, 2 * (events + 1)) / 2 / 1.5)
    assert most(0, 1.5) == pytest.approx(3 / 1.5, rel=0.002)  # the rule of three


@pytest.mark.parametrize(
    ("flash", "ram", "words"),
    [
        (
            [300.0, 400.0],
            [3.0, 1.0],
            "lowest flash is 300 kB.* board that holds one of them is microbit2$",
        ),  # 512 KiB
        (
            [30.0, 100.0],
            [3.0, 1.0],
            "flash rules out 1 .* is large, .* RAM rules out 1 .* is small, .* nucleo-l432kc$",
        ),
        (
            [30.0, 30.0],
            [np.nan, np.nan],
            "RAM rules out 2 of 2 systems .2 with unknown RAM.* is large, 60.0 %$",
        ),
    ],
)
def test_what_rules_all_systems_out_is_named_with_a_board_that_holds_one(
    flash, ram, words, monkeypatch
):
    """Of systems of these sizes, with budgets of 64 and 1.9 kB."""
    monkeypatch.setattr(choices, "lacking", list)
    table = pd.DataFrame(
        {"system": ["small", "large"], "unit": "capture", "accuracy": [50.0, 60.0]}
    )
    table = table.assign(flash=flash, ram=ram)
    scores = pd.DataFrame(np.repeat(table[["accuracy"]].to_numpy(), 3, axis=1))
    assert re.search(
        words,
        nothing_fits(decide(table, scores, "flash", {"flash": 64.0, "ram": 1.9}, None), "flash"),
    )


@pytest.mark.parametrize(
    ("alarms", "latency", "words"),
    [
        (30.0, 0.4, ""),
        (80.0, 0.4, "80 per hour, its budget is 60"),
        (30.0, None, "latency is unknown: no touch"),
    ],
)
def test_budgets_of_streams_are_those_of_recordings_of_people_left_out(
    alarms, latency, words, monkeypatch
):
    numbers = {"background_minutes": 20.0, "false_alarms_per_hour": alarms, "touches_found": 0.9}
    numbers |= {"latency_s_p50": latency} if latency else {}
    monkeypatch.setattr(
        certificate, "planned", lambda values, command: (values["protocol"], command)
    )
    monkeypatch.setattr(
        certificate, "run", lambda *asked: SimpleNamespace(metrics=numbers, asked=asked)
    )
    scene = Scene(values={"max_false_alarms": "60", "max_latency": "1s"})
    choice = SimpleNamespace(name="lda", values={})
    if words:
        with pytest.raises(InputError, match=words):
            certificate._watched({}, scene, choice)
        return
    found = certificate._watched({}, scene, choice)
    assert (found["alarms"], found["per_hour"], found["latency_ms"]) == (10, 30.0, 400)
    assert found["at_most_per_hour"] == pytest.approx(chi2.ppf(0.95, 22) / 2 * 3, abs=0.01)
    assert certificate._watched({}, Scene(), choice) is None


def test_of_recordings_it_learns_the_gestures_that_were_compared_and_to_watch():
    """``bench fit`` has the background as a class, too, which the comparison lacks."""
    day()
    values = {"model": "lda", "features": "touch", "model.window": 0.5}
    run_id, recogniser = fitted({"data": "day", "jobs": "1"}, values, "key", stopping=False)
    assert (
        recogniser.classes == sorted(set(PEOPLE.events["gesture"]))
        and recogniser.watcher is not None
    )
    assert fitted({"data": "day"}, values, "key")[0] == run_id


@pytest.mark.parametrize(
    ("flash", "without"),
    [(40, ""), (25, choices.STREAM), (15, f"{choices.STREAM}, {choices.EARLY}")],
)
def test_what_the_budgets_exclude_is_not_in_the_model_unless_the_scene_needs_it(
    flash, without, monkeypatch
):
    """The system takes 10 kB of flash, early decisions 10 and the detector 20 more."""

    def fit(on, values, key, stopping=True, watch=True):
        return key, SimpleNamespace(stopping=stopping or None, watcher=watch or None)

    def sizes(model):
        amount = 10e3 * (1 + bool(model.stopping) + 2 * bool(model.watcher))
        return {name: amount if name == "flash_bytes" else 1.0 for name in choices.COSTS}

    for name, fake in {"fitted": fit, "on_chip": sizes, "lacking": list}.items():
        monkeypatch.setattr(choices, name, fake)
    choice = SimpleNamespace(name="lda", values={}, run_id="r", limits={"flash": flash})
    _, model, amounts, left_out = choices.trained({}, choice, Scene())
    assert left_out == without and amounts["flash_bytes"] <= 1000 * flash
    assert bool(model.watcher) is not bool(without)
    needy = Scene(values={"max_latency": "1s"})
    if without:
        with pytest.raises(
            InputError, match="detector that the scene needs it takes 40.0 kB of flash"
        ):
            choices.trained({}, choice, needy)
    else:
        assert choices.trained({}, choice, needy)[3] == ""
