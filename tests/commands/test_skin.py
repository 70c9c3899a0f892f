"""The search of a skin: pairs of people, the choice for a person, its runs and figures."""

import itertools
import re
from contextlib import ExitStack

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.commands.run import run_complete, run_from_python
from bench.commands.skin import (
    command,
    describe_choice,
    search_designs,
    search_taxels,
    usual_designs,
)
from bench.corpora.corpus import Corpus
from bench.corpora.folder import content_digest, write_folder
from bench.corpora.skin import Design
from bench.corpora.synth import generate
from bench.errors import InputError
from bench.grammar.options import key_options, parse_arguments
from bench.ground.scratch import data_folder
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.protocols.subjects import LOSO
from bench.reading.designs import Designs, best_half, changed_property, cheapest_design
from bench.reports.designs import draw_designs
from bench.store.database import lock_run
from bench.values.measures import all_costs
from bench.values.scores import label_captures
from tests.conftest import predictions, random_corpus, runs

SMALL = "data.subjects=4 data.variants=normal data.repetitions=2 model=lda features=jung28 jobs=1"
LINE = "data=shuffled model=lda features=jung28 jobs=1 skin.grid=4x4,1x1 skin.curve=log"


def store_corpus(name, corpus):
    corpus = corpus.with_fields(name=name, info={"format": "table"})
    digest, folder = content_digest(corpus), data_folder() / "corpora" / name
    write_folder(corpus, folder / digest[:16], digest)
    (folder / "current").write_text(digest[:16])


def parse_skin(line):
    return parse_arguments(line.split(), key_options("skin"))


@given(st.integers(3, 9), st.data())
def test_pairs_test_each_person_with_one_on_either_side_and_train_on_neither(people, data):
    from bench.protocols.subjects import Pairs

    apart = data.draw(st.integers(1, people // 2))
    corpus = random_corpus(subjects=people, per_class=1, longest=3)
    names = [str(i + 1) for i in range(people)]
    met = {name: set() for name in names}
    for train, test in Pairs(apart).split(corpus):
        tested = {*corpus.subjects[test]}
        assert len(tested) == 2 and tested | {*corpus.subjects[train]} == {*names}
        assert not tested & {*corpus.subjects[train]}
        for name in tested:
            met[name] |= tested - {name}
    for i, name in enumerate(names):
        assert met[name] == {names[(i + apart) % people], names[(i - apart) % people]}


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9)), min_size=1, max_size=20))
def test_a_design_that_is_dropped_beats_none_that_stays(points):
    accuracy, burden = np.array(points, float).T
    kept = best_half(accuracy, burden)
    assert kept[0] and 2 * kept.sum() >= len(points)
    for i in np.flatnonzero(~kept):
        worse = (accuracy[i] > accuracy) & (burden[i] <= burden)
        worse |= (accuracy[i] >= accuracy) & (burden[i] < burden)
        worse[0] = False  # the recorded one stays in any case
        assert not (worse & kept).any()


def test_the_cheapest_design_within_one_standard_error_is_chosen():
    recorded = np.array([80.0, 82.0, 84.0, 86.0])
    loses = recorded - [1.0, 1.0, 1.0, 1.2]  # by more than its standard error
    varies = recorded - [4.0, -4.0, 1.0, 0.0]
    accuracy = np.stack([recorded, loses, varies, varies + 1])
    assert cheapest_design(accuracy, np.array([9.0, 1.0, 2.0, 2.0])) == 3
    assert cheapest_design(accuracy[:2], np.array([9.0, 1.0])) == 0


def test_a_design_that_changes_one_property_is_named_after_it():
    assert changed_property({"grid": "4x4", "curve": "log"}) == "grid"
    assert changed_property({"curve": "log"}) == "curve"
    assert changed_property({"grid": "4x4", "bits": 6}) == changed_property({}) == ""


def made_designs(options, accuracy, bits):
    """Designs with accuracies [designs, people] and bits per second, by taxels."""
    results = []
    for shares, amount in zip(accuracy, bits, strict=True):
        scores = {str(i): share for i, share in enumerate(shares)}
        names = {"accuracy_by_subject": scores, "context": ("d", "all", "LOSO"), "system": "s"}
        result = type("Run", (dict,), names)(taxels=1.0, bits_per_s=amount, data="d", where="all")
        results.append(result)
    amounts, choices = np.ones(len(options)), np.zeros(accuracy.shape[1], int)
    return Designs(options, results, all_costs()["taxels"], amounts, choices)


def test_a_property_is_judged_by_its_finest_value_and_the_same_curve(tmp_path):
    log = {"curve": "log"}
    options = [{}, {"rate_hz": 18.0} | log, {"rate_hz": 27.0} | log, log]
    accuracy = 90.0 + np.array(
        [[0, 2, 1, 1, 1], [1, 0, 3, 2, 2], [5, 6, 5, 4, 5], [9, 7, 9, 11, 9]]
    )
    designs = made_designs(options, accuracy, [9.0, 1.0, 2.0, 9.0])
    assert designs.single_changes() == {"curve": [3], "rate_hz": [2, 1]}
    lines = describe_choice(designs)
    assert "1 taxels instead of 1, " in lines[0]
    words = "rate_hz: the recorded skin with curve=log gains 4.0 ± 0.9 points over rate_hz=27.0, "
    assert lines[-1] == f"{words}curve=log, so a finer skin may gain more."
    assert designs.row(3)["mean_high"] == 100
    shown = draw_designs(designs, tmp_path)[1].read_text()
    assert "27, log" in shown and "18, log" in shown


def test_without_a_property_alone_there_is_no_figure_of_it(tmp_path):
    options = [{}, {"grid": "2x2", "bits": 4}]
    designs = made_designs(options, np.array([[80.0, 85, 90], [70, 80, 75]]), [9.0, 1.0])
    assert [path.stem for path in draw_designs(designs, tmp_path)] == ["front"]


def test_designs_for_a_person_are_chosen_on_stored_runs_that_never_saw_the_person(capsys, tmp_path):
    corpus = generate(subjects=5, variants=("normal",), repetitions=2, seed=1)
    order = np.argsort([int(name) * 3 % 5 for name in corpus.subjects], kind="stable")
    store_corpus("shuffled", corpus[order])  # people come as 5, 2, 4, 1, 3
    values = parse_skin(f"{LINE} out={tmp_path / 'figures'}") | {"where": "subject != '5'"}
    assert command(values) == 0
    printed = capsys.readouterr().out
    client, stored = runs("cell")
    assert len(stored) == 3 * 3  # pairs at two distances, and LOSO, of three designs
    assert "Chosen on others for each person" in printed and "grid=4x4" in printed
    assert "nan" not in printed  # four people have no interval
    for name in ("front", "properties"):
        assert (tmp_path / "figures" / f"{name}.svg").read_text().startswith("<?xml")
    designs = search_designs(values)
    assert len(runs("cell")[1]) == len(stored)
    people = [str(i + 1) for i in range(4)]
    grids = [each.get("grid", "") for each in designs.options]
    shares = {}  # of design, person left out and person tested
    for run in stored:
        if not run.data.params["protocol"].startswith("pairs"):
            continue
        table = label_captures(predictions(client, run, "predictions"))
        right = table["true"].astype(str) == table["predicted"].astype(str)
        for _, fold in table.assign(right=right).groupby("fold"):
            one, other = fold["subject"].unique()
            for left_out, tested in ((one, other), (other, one)):
                share = 100 * fold["right"][fold["subject"] == tested].mean()
                shares[run.data.params.get("skin.grid", ""), str(left_out), str(tested)] = share
    assert len(shares) == 3 * 4 * 3
    assert len({*designs.choices.tolist()}) > 1
    for person, choice in zip(people, designs.choices, strict=True):
        others = [name for name in people if name != person]
        accuracy = [[shares[grid, person, other] for other in others] for grid in grids]
        assert cheapest_design(np.array(accuracy), designs.amounts) == choice
    loso = pd.Series(designs.results[0].accuracy_by_subject)
    assert [*loso.index] == people and len([*LOSO().split(random_corpus())]) == 4
    told, recorded = designs.new_person()
    np.testing.assert_allclose(recorded, loso)
    np.testing.assert_allclose(told, designs.accuracy[designs.choices, range(4)])


@pytest.mark.parametrize("wired", [1, 3])
def test_taxels_are_added_or_removed_by_the_accuracy_on_a_half_of_the_people(
    wired, capsys, tmp_path
):
    line = f"{SMALL} skin.grid=2x2 wired={wired} out={tmp_path}"
    assert command(parse_skin(line)) == 0
    verb = "added" if wired == 1 else "removed"
    assert capsys.readouterr().out.count(f"they are {verb}, chosen on people") == 2
    assert (tmp_path / "taxels.svg").exists()
    halves, count = (["1", "3"], ["2", "4"]), len(runs("cell")[1])
    orders = search_taxels(parse_skin(line))
    assert len(runs("cell")[1]) == count
    channels = {(0, 0): "1-4+9-12+17-20+25-28", (0, 1): "5-8+13-16+21-24+29-32"}
    channels |= {(1, 0): "33-36+41-44+49-52+57-60", (1, 1): "37-40+45-48+53-56+61-64"}
    for order, half in zip(orders, halves, strict=True):
        assert order.people == half and order.wired == [wired]
        if half != halves[wired // 2]:
            continue  # each direction once
        means = {}
        for place in channels:
            kept = [place] if wired == 1 else [other for other in channels if other != place]
            skin = "+".join(channels[each] for each in kept)
            (row,) = run_from_python(
                "run",
                parse_skin(f"{SMALL} skin.grid=2x2 skin.taxels={skin}")
                | {"protocol": "loso", "where": f"subject in {half}"},
            ).to_dict("records")
            means[place] = row["accuracy"]
        (place,) = zip(*np.nonzero(order.order), strict=True)
        assert means[place] == max(means.values())


@pytest.mark.parametrize(
    ("frames", "full_scale", "grids", "bits"),
    [
        (np.zeros((2, 19, 24), np.uint16), 1023.0, ["", "8x8", "4x4", "2x2"], [0, 6, 4]),
        (np.zeros((2, 6, 6), np.uint16), 31.0, ["", "4x4", "2x2"], [0, 4]),
        (np.zeros((2, 2, 2), np.float32), 4.5, [""], [10, 6, 4]),
    ],
)
def test_usual_designs_are_those_that_a_recorded_skin_can_stand_for(
    frames, full_scale, grids, bits
):
    table = pd.DataFrame({"subject": [*"123"], "gesture": "tap"})
    corpus = Corpus.from_captures([frames] * 3, table, 60.0, full_scale=full_scale, name="d")
    designs = usual_designs(corpus)
    assert (designs["skin.grid"], designs["skin.bits"]) == (grids, bits)
    for values in itertools.product(grids, designs["skin.rate_hz"], bits):
        Design(*values, curve="log").convert(corpus)


def test_a_taxel_of_a_grid_that_does_not_divide_is_wired_alone(tmp_path):
    store_corpus("tiny", random_corpus(subjects=4, per_class=2, grid=(5, 3)))
    line = f"data=tiny model=lda features=jung28 jobs=1 skin.grid=2x1 out={tmp_path} wired=1"
    orders = search_taxels(parse_skin(line))
    assert [order.order.sum() for order in orders] == [1, 1]
    _, stored = runs("cell")
    wired = "".join(run.data.params["skin.taxels"] for run in stored)
    assert {*re.findall(r"\d+-\d+", wired)} == {"1-6", "10-15"}
    assert {run.data.metrics["taxels"] for run in stored} == {1.0}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"{SMALL} skin.grid=7x8 wired=4", "skin.grid=7x8: give a grid of whole taxels"),
        ("data.subjects=3 model=lda features=jung28 skin.grid=2x2 wired=2", "halves of people"),
        (f"{SMALL} skin.grid=2x2 wired=4", "wired=4: give 1 to 3"),
        (f"{SMALL} skin.taxels=1-8 wired=4", "skin.taxels=1-8: wired= chooses the taxels"),
        (f"{SMALL} by=wires wired=4", "by= and wired= exclude each other"),
        (f"{SMALL} by=worst_person", "by=worst_person: known: "),
        ("protocol=kfold", "protocol=kfold: bench skin sets it"),
        ("model=lda,svm features=jung28", "one system"),
        ("data.subjects=2 model=lda features=jung28", "three are needed"),
        (f"{SMALL} skin.grid=99x99", "skin.grid=99x99"),
    ],
)
def test_what_cannot_be_searched_is_refused_in_a_line(line, words):
    with pytest.raises(InputError, match=words):
        command(parse_skin(line))


def test_a_search_waits_for_what_another_process_runs(monkeypatch, capsys):
    values = parse_skin(f"{SMALL} skin.grid=2x2")
    cells = make_cells(values)
    (plan,) = make_plans(cells, 1)
    with ExitStack() as other:
        other.enter_context(lock_run(plan.key))
        monkeypatch.setattr("bench.commands.run.time.sleep", lambda _: other.close())
        (result,) = run_complete(cells, values)
    assert result.is_complete and "waiting for it" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_refused_before_the_search(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.commands.skin.search_designs", lambda _: pytest.fail("searched"))
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="out=.*cannot be written"):
        command(parse_skin(f"{SMALL} out={tmp_path / 'file'}"))


def test_a_command_whose_skin_is_no_design_takes_no_parameter_of_one():
    with pytest.raises(InputError, match="no key is called 'skin.grid'"):
        parse_arguments(["skin.grid=4x4"], key_options("predict"))
