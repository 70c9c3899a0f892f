"""Arguments as cells: grids, parameters, and mistakes."""

import resource

import pytest

from bench.errors import InputError
from bench.grammar.options import RUN_KEYS, make_executor, parse_arguments
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans


def cells_of(line):
    return make_cells(parse_arguments(line.split(), RUN_KEYS))


def titles(line):
    return [cell.title() for cell in cells_of(line)]


def test_a_comma_makes_a_grid_of_what_each_part_takes():
    """A network ignores feature sets, a model without a seed ignores seeds."""
    assert titles("") == ["svm · jung54 | synth | loso"]
    svm = ["svm · jung28", "svm · jung54"]
    line = "data=haart protocol=challenge,loso model=cnn85,svm features=jung28,jung54 seed=3,5"
    assert titles(line) == [
        f"{s} | haart | {p}" for p in ("challenge", "loso") for s in ("cnn85", "cnn85", *svm)
    ]
    assert [c.model.parameters["seed"] for c in cells_of("model=cnn85 seed=3,5")] == [3, 5]


@pytest.mark.parametrize(
    ("line", "part", "name", "values"),
    [
        ("model=cnn85 model.hop=None,10", "model", "hop", [None, 10]),
        ("protocol=kfold protocol.folds=5,3", "protocol", "folds", [5, 3]),
        ("model.C=1,2.5", "model", "C", [1.0, 2.5]),
        ("model.window=2.0", "model", "window", [2.0]),  # of any model
    ],
)
def test_dotted_keys_set_parameters_by_the_type_of_their_default(line, part, name, values):
    found = [getattr(cell, part).parameters[name] for cell in cells_of(line)]
    assert found == values and list(map(type, found)) == list(map(type, values))


def test_a_dotted_key_is_for_the_parts_that_take_it():
    svm, rf = cells_of("model=svm,rf model.trees=7 data.subjects=3 data.variants=rough+gentle")
    assert "trees" not in svm.model.parameters and rf.model.parameters["trees"] == 7
    assert (
        svm.data_parameters["variants"] == ("rough", "gentle")
        and svm.data_parameters["subjects"] == 3
    )
    (usual,) = cells_of("model.window=0.0")  # a step as it is without
    assert "window" not in usual.model.parameters and usual == cells_of("")[0]
    (cell,) = cells_of("model=cnn85 model.frames=20 model.hop=10 protocol=kfold protocol.folds=5")
    assert (str(cell.model), str(cell.protocol)) == ("cnn85[frames=20, hop=10]", "kfold[folds=5]")


MISTAKES = [  # what is typed, and facts that the message names; others are golden
    ("model=cnn85 model.frames=8.5", "model.frames=8.5", "whole number"),
    ("model=cnn85 features=jung54", "features=jung54", "cnn85"),
    ("data=haart data.subjects=3", "data.subjects", "synth"),
    ("data.subject=3", "data=synth", "'subject'", "subjects"),
    ("where=loudness>3", "synth", "subject, variant"),
    ("where=gesture=='pat'", "gesture=='pat'", "only one"),
    ("protocol=groupkfold protocol.folds=11", "protocol.folds=11", "10"),
    ("where=(subject=='1')|(gesture!='pat')", "fold 1", "pat", "protocol=loso"),
    ("model=cnn85 model.hop=0", "model.hop=0", "1"),
    ("model=rf model.trees=0", "model.trees=0"),
    ("data.subjects=2 model=zhou2016_gm_lstm", "training subject"),
    ("features=gaus features.families=sd+sad", "features.families=sd+sad:"),
    ("model=jung2014_svm where=(subject=='1')|(subject=='2')", "only one"),
    ("target=subject protocol=loso", "subject 1"),
    # sizes that cannot be
    ("data.rows=1000000 data.cols=1000000", "TB of memory"),
    ("data.rate_hz=1e308", "of memory"),
    ("data.subjects=1000000000000", "1000000"),
    ("model=cnn85 model.frames=1000000 model.batch=1000000", "256 TB"),
    ("model=rf model.trees=99999999999999999999", "1000000"),
    ("model=rf seed=4294967296", "4294967295"),
    ("model=" + 3000 * "a", "zhou2016_lrcn"),
    (3000 * "a" + "=1", "no key"),
]


@pytest.mark.parametrize(("line", "facts"), [(line, facts) for line, *facts in MISTAKES])
def test_a_mistake_is_refused_with_its_key_its_value_and_what_is_right(line, facts):
    """Before any memory is asked for."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError) as refusal:
        values = parse_arguments(line.split(), RUN_KEYS)
        make_plans(make_cells(values), make_executor(values).jobs)
    message = str(refusal.value)
    assert all(fact in message for fact in facts) and "\n" not in message, message
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB
