"""Choice, training and accuracy to expect of the systems of a build."""

import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from addons.streams.tests.people import PEOPLE, import_day
from bench.cli import main
from bench.corpora.read.table import write_table
from bench.errors import InputError
from bench.plan.grid import make_cells
from bench.reading.candidates import Candidates
from bench.reading.choice import choose_candidate
from bench.reading.scene import Scene, load_boards
from tests.conftest import random_corpus
from tests.reading.results import make_run
from touchbench_builder import fitting, systems
from touchbench_builder.candidates import SMALLEST_SYSTEM, candidate_systems, system_title
from touchbench_builder.captures import load_corpus
from touchbench_builder.certificate import expected_accuracy
from touchbench_builder.fitting import EARLY, fit_or_load
from touchbench_builder.sessions import measure_session_cost
from touchbench_builder.slices import most_instructions, needed_ram, spread_work
from touchbench_builder.systems import (
    nested_labels,
    nothing_fits_message,
    parse_trained_faults,
    systems_without_each,
)
from touchbench_chip.tables import check_exportable
from touchbench_streams.detectors.ticks import TickWatcher
from touchbench_streams.stress import parse_faults


def make_choice(flash, ram, accuracies, budgets):
    """The choice between two systems, small and large."""
    scores = pd.DataFrame(accuracies, columns=["1", "2", "3"])
    table = pd.DataFrame({"system": ["small", "large"], "flash": flash, "ram": ram})
    table = table.assign(unit="capture", accuracy=scores.mean(axis=1))
    losses, counts = np.empty((2, 0, 3)), np.empty((0, 2, 3))
    candidates = Candidates(table, scores, losses, counts, make_run("small"), notes=[])
    return choose_candidate(candidates, "flash", budgets)


def test_each_person_gets_the_system_that_the_others_choose():
    """Without 1, large has 90 and small 10 %. Without 2 or 3, both have a mean of 50 %: small."""
    scores = np.array([[90.0, 10, 10], [10, 90, 90]])
    choice = make_choice([1.0, 2.0], [1.0, 1.0], scores, {})
    people, captures = np.divmod(np.arange(30), 10)
    table = pd.DataFrame({"subject": (people + 1).astype(str), "true": "pat", "fold": people})
    results = []
    for system, accuracies in zip(("small", "large"), scores, strict=True):
        right = 1.0 * (captures < accuracies[people] / 10)
        labels = table.assign(capture=np.arange(30), p_pat=right, p_rub=1 - right)
        results.append(SimpleNamespace(system=system, tables={"predictions": labels}))
    chosen = systems_without_each(choice)
    assert chosen == {"1": "large", "2": "small", "3": "small"}
    expected = expected_accuracy(nested_labels(results, chosen))
    # small alone would have 37 %, large 63 %
    assert expected["people"] == {"1": [1, 10], "2": [1, 10], "3": [1, 10]}
    assert expected["mean"] == 0.1 and expected["mean_low"] is None


def test_each_candidate_has_c_and_one_that_can_watch_learns_faults():
    candidates = candidate_systems(random_corpus(3, 3, grid=(4, 4)))
    can_watch = [
        check_exportable(make_cells({"data": "synth", **values})[0].untrained_system)
        for values, _ in candidates
    ]
    seconds = {system_title(values): fit_seconds for values, fit_seconds in candidates}
    assert len(seconds) == len(candidates)
    (steady,) = (i for i, (values, _) in enumerate(candidates) if "model.faults" in values)
    title = system_title(candidates[steady][0])
    trained = "offset_drift+lower_rate+doubled_frames+own_noise"
    assert can_watch[steady]
    assert title == f"lda on touch_profiles, windows of 1 s, trained against {trained}"
    assert seconds[title] > seconds["lda on touch, windows of 1 s"]  # copies, and more features


def test_a_stream_can_have_each_fault_of_a_certificate_and_captures_those_to_train_against():
    assert {*parse_faults(systems.DEFAULT_FAULTS)} == {*systems.DEFAULT_FAULTS}
    assert parse_trained_faults("+".join(systems.TRAINED_FAULTS)) == systems.TRAINED_FAULTS
    assert parse_trained_faults("noise,cover") == ("noise", "cover")
    assert parse_trained_faults("none") == () and parse_trained_faults("auto") is None
    with pytest.raises(InputError, match="faults=nois: unknown; did you mean noise"):
        parse_trained_faults("nois+cover")


TIME_LEFT = [  # seconds, of which 168 come after a comparison and 20 are its first folds
    (189, False, 1, False, ""),
    (187, False, 1, False, "it would take about"),
    (189, True, 1, False, "it would take about"),  # its folds were too slow before
    (319, True, 1, False, ""),
    (189, False, 2, False, "it would take about"),  # the other session is tested, too
    (389, False, 2, False, ""),
    (237, False, 1, True, "it would take about"),  # the choice is trained against faults, too
    (239, False, 1, True, ""),
]


@pytest.mark.parametrize(("left", "was_stopped", "sessions", "hardens", "reason"), TIME_LEFT)
def test_another_system_is_run_if_all_that_follows_is_in_time(
    left, was_stopped, sessions, hardens, reason
):
    corpus = random_corpus(2, 2)
    days = np.where(np.arange(len(corpus)) % sessions, "mon", "tue")
    corpus = corpus.with_fields(captures=corpus.captures.assign(day=days))
    clock = SimpleNamespace(seconds_left=left)
    comparison = systems.Comparison(corpus, {}, Scene(), clock, True, math.inf)
    comparison.slowest, comparison.linking, comparison.longest = 100.0, 10.0, 150.0
    comparison.was_stopped, comparison.hardens = was_stopped, hardens
    late = comparison._why_late(SimpleNamespace(folds=range(10), workers=2), 5.0)
    assert reason in late and bool(late) is bool(reason)


def result_of_people(system, right):
    """A run with ten touches of each person."""
    rows = [(person, i < count) for person, count in right.items() for i in range(10)]
    touches = pd.DataFrame(rows, columns=["subject", "end_correct"])
    return SimpleNamespace(system=system, tables={"touches": touches})


@pytest.mark.parametrize(("flash", "is_kept"), [(30, True), (50, False)])
def test_training_against_faults_is_kept_for_whom_the_others_lose_little(flash, is_kept):
    """Person 1 loses 20 points, the others none, or 2.5 on average: without 1, nothing is lost."""
    plain = result_of_people("lda", dict.fromkeys("12345678", 8))
    hard = result_of_people("hard", {**dict.fromkeys("12345678", 8), "1": 6})
    trained = []

    def run_system(values, seconds, place):
        assert not comparison.was_stopped  # of another system that was too slow
        trained.append(values)
        return hard

    comparison = SimpleNamespace(plans={"lda": ({"model": "lda"}, None)}, results=[plain])
    comparison.was_stopped = True
    comparison.costs = {"hard": {"flash_bytes": 1e3 * flash, "needed_ram_bytes": 1e3}}
    comparison.costs["hard"]["most_instructions"] = 1e5
    comparison.run_system, lines = run_system, []
    comparison.progress = SimpleNamespace(print_line=lines.append)
    deciding = dict.fromkeys("12345678", "lda") | {"2": "tree"}
    rows, name, after = systems._harden(comparison, "lda", dict(deciding), {"flash": 40}, 1.0)
    faults = "+".join(systems.TRAINED_FAULTS)
    assert trained == [{"model": "lda", "model.faults": faults, "model.copies": 1}]
    assert name == "lda" and "2.5 points lost" in lines[0]
    assert after == deciding | ({"1": "hard"} if is_kept else {})
    assert rows[0]["accuracy"] == pytest.approx(77.5) and rows[0]["flash"] == flash
    hard.tables = result_of_people("hard", dict.fromkeys("12345678", 8)).tables
    _, name, after = systems._harden(comparison, "lda", dict(deciding), {"flash": 40}, 1.0)
    assert name == ("hard" if is_kept else "lda")
    assert after == dict.fromkeys("12345678", name) | {"2": "tree"}


@pytest.mark.parametrize(("people", "lacks", "count"), [(4, "", 1), (3, "", 0), (5, "rub", 0)])
def test_a_system_that_tunes_itself_is_tried_where_people_can_be_left_out(people, lacks, count):
    """In the third case, one person has not shown a gesture."""
    corpus = random_corpus(people, 1, gestures=("pat", "rub"), grid=(4, 4))
    is_kept = (corpus.subjects != "5") | (corpus.gestures != lacks)
    candidates = candidate_systems(corpus[np.flatnonzero(is_kept)])
    tuned = [values for values, _ in candidates if "model.tune" in values]
    assert [*map(system_title, tuned)] == ["lda on touch, windows of 1 s, tuned"] * count
    for values in tuned:
        (cell,) = make_cells({"data": "synth", **values})
        assert cell.model.parameters["tune"] is True
        check_exportable(cell.untrained_system)


@pytest.mark.parametrize(
    ("faults", "trained"), [((), set()), (("noise", "cover"), {"noise+cover"})]
)
def test_all_candidates_are_trained_against_named_faults(faults, trained):
    candidates = candidate_systems(random_corpus(3, 1, grid=(4, 4)), faults)
    assert {v.get("model.faults") for v, _ in candidates} - {None} == trained
    assert not faults or all("model.faults" in values for values, _ in candidates)


NOTHING_FITS = [  # flash, RAM, words; microbit2 has 512 KiB
    ([300, 400], [3, 1], "lowest flash is 300 kB.* board that holds one of them is microbit2$"),
    ([30, 100], [3, 1], "flash rules out 1 .* is large, .* RAM .* is small, .* nucleo-l432kc$"),
    ([30, 30], [np.nan] * 2, "RAM rules out 2 of 2 systems .2 with unknown .* is large, 60.0 %$"),
]


@pytest.mark.parametrize(("flash", "ram", "words"), NOTHING_FITS)
def test_a_board_that_holds_a_system_is_named_if_nothing_fits(flash, ram, words, monkeypatch):
    monkeypatch.setattr(systems, "missing_programs", list)
    choice = make_choice(flash, ram, [[50.0] * 3, [60.0] * 3], {"flash": 64.0, "ram": 1.9})
    assert re.search(words, nothing_fits_message(choice))


def test_from_recordings_it_learns_the_compared_gestures_and_to_watch():
    """``bench fit`` also has the background as a class, which the comparison lacks."""
    import_day()
    values = {"model": "lda", "features": "touch", "model.window": 0.5}
    run_id, recogniser = fit_or_load({"data": "day", "jobs": "1"}, values, "key", stopping=False)
    assert recogniser.classes == sorted(set(PEOPLE.events["gesture"]))
    assert recogniser.watcher is not None
    assert fit_or_load({"data": "day"}, values, "key")[0] == run_id


@pytest.mark.parametrize(("flash", "without"), [(40, ""), (30, EARLY), (20, None)])
def test_the_model_has_what_the_budgets_allow(flash, without, monkeypatch):
    """The system with its detector takes 30 kB of flash, early decisions 10 more."""

    def fit(on, values, key, stopping=True, watch=True):
        return key, SimpleNamespace(stopping=stopping or None, watcher=watch or None)

    def costs(model):
        amount = 10e3 * (1 + bool(model.stopping) + 2 * bool(model.watcher))
        return {name: amount if name == "flash_bytes" else 1.0 for name in fitting.CHIP_COSTS}

    fakes = {"fit_or_load": fit, "measure_on_chip": costs, "missing_programs": list}
    for name, fake in fakes.items():
        monkeypatch.setattr(fitting, name, fake)
    limits = {"flash": flash}
    choice = SimpleNamespace(name="lda", values={}, run_id="r", limits=limits, watched=True)
    choice.frame_limit, choice.board = math.inf, None
    if without is None:
        with pytest.raises(InputError, match=r"trained on all captures it takes 30.0 kB of flash"):
            fitting.train_chosen({}, choice)
        return
    _, model, amounts, left_out = fitting.train_chosen({}, choice)
    assert left_out == without and amounts["flash_bytes"] <= 1000 * flash
    assert model.watcher and bool(model.stopping) is not bool(without)


SPREAD_WORK = [  # instructions that a board executes in half a period, slices and what is measured
    (math.inf, 1, [1]),
    (2.4e6, 1, [1]),
    (1.5e6, 3, [1, 3]),
    (0.7e6, 5, [1, 5]),
    (0.5e6, 7, [1, 6, 7]),
    (0.1e6, 7, [1, 7]),
    (0.0, 7, [1, 7]),
]


@pytest.mark.parametrize(("limit", "slices", "measured"), SPREAD_WORK)
def test_the_fewest_slices_are_taken_with_which_each_frame_is_short_enough(limit, slices, measured):
    watcher = TickWatcher(None, None, None, 0.0, 7)
    model, seen = SimpleNamespace(watcher=watcher), []

    def measure(model):
        seen.append(model.watcher.slices)
        return {"most_instructions": 1e5 + 2.3e6 / max(1, model.watcher.slices - 1)}

    costs = spread_work(model, limit, measure)
    assert model.watcher.slices == slices and seen == measured
    assert costs == measure(model) and watcher.slices == 1


def test_ram_holds_stack_and_frame_and_tables_where_constants_take_ram():
    costs, boards = dict.fromkeys(fitting.CHIP_COSTS, 100.0), load_boards()
    assert [needed_ram(costs, board) for board in (None, boards["zero"])] == [300.0, 300.0]
    assert needed_ram(costs, boards["uno-r3"]) == 400.0


def test_a_frame_may_take_half_a_period_of_a_board_with_an_fpu():
    boards = load_boards()
    assert most_instructions(boards["nucleo-l432kc"], 54.0, math.inf) == pytest.approx(
        740_741, 1e-5
    )
    assert most_instructions(boards["nucleo-l432kc"], 54.0, 6e5) == 6e5
    assert most_instructions(boards["zero"], 54.0, 6e5) == 0
    assert most_instructions(None, 54.0, 6e5) == 6e5


def test_another_session_costs_what_left_out_people_lose_in_it():
    """In the second session, pat and tap are swapped; so all of their labels are wrong there."""
    corpus = random_corpus(5, 4, grid=(4, 4))
    table = corpus.captures
    session = np.where(np.arange(len(table)) % 4 < 2, "mon", "tue")
    swapped = table["gesture"].replace({"pat": "tap", "tap": "pat"})
    gesture = table["gesture"].where(session == "mon", swapped)
    table = table.assign(session=session, gesture=gesture)
    write_table(corpus.with_fields(captures=table), Path("skin.csv"))
    sensor = ["grid=4x4", "rate_hz=100", "full_scale=1023"]
    assert main(["data", "import", "table", "skin.csv", "name=skin", *sensor]) == 0
    choice = SimpleNamespace(values=SMALLEST_SYSTEM, watched=None)
    on = {"data": "skin", "jobs": "1"}
    imported = load_corpus({"data": "skin"})
    found = measure_session_cost(imported, on, choice)
    assert found["values"] == ["mon", "tue"] and found["people"] == 5
    shares = {}
    for name, trains in (
        ("same", {"mon": "mon", "tue": "tue"}),
        ("other", {"mon": "tue", "tue": "mon"}),
    ):
        rows = []
        for tested, trained in trains.items():
            for person in sorted(set(table["subject"])):
                train = ((table["subject"] != person) & (session == trained)).to_numpy()
                test = ((table["subject"] == person) & (session == tested)).to_numpy()
                system = make_cells({"data": "skin", **SMALLEST_SYSTEM})[0].estimator()
                system.fit(imported[train], imported.gestures[train])
                right = system.predict(imported[test]) == imported.gestures[test]
                rows += [(person, each) for each in right]
        shares[name] = 100 * pd.DataFrame(rows).groupby(0)[1].mean()
    assert found["same"] == pytest.approx(shares["same"].mean(), abs=0.06)
    assert found["other"] == pytest.approx(shares["other"].mean(), abs=0.06)
    assert found["cost"] == pytest.approx(found["same"] - found["other"], abs=0.11)
    assert found["low"] < found["cost"] < found["high"] and found["cost"] > 20
    assert measure_session_cost(imported[session == "mon"], on, choice) is None
