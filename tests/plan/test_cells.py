"""Arguments as cells: grids, parameters, and mistakes."""

import resource
from pathlib import Path

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


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("gamma", "0.03", 0.03),
        ("gamma", "auto", "auto"),
        ("gamma", "None", None),
        ("depth", "4", 4),
        ("depth", "0.5", 0.5),
        ("depth", "sqrt", "sqrt"),
        ("subject", "3", "3"),  # as its default is a number, it is a name
        ("C", "2", 2.0),
    ],
)
def test_a_number_may_be_typed_where_a_default_of_an_own_part_is_text_or_none(name, text, value):
    Path("own.py").write_text(
        "from sklearn.svm import SVC\n"
        "def own(gamma='scale', depth=None, subject='1', C=1.0):\n    return SVC()\n"
    )
    (cell,) = cells_of(f"model=own.py:own model.{name}={text}")
    read = cell.model.parameters[name]
    assert (read, type(read)) == (value, type(value))
    typed = cell.arguments()
    (again,) = make_cells({**typed, "model": "own.py:own"})
    assert again.model.parameters == cell.model.parameters


def test_a_value_that_scikit_learn_refuses_is_refused_before_the_first_fold():
    Path("own.py").write_text(
        "from sklearn.pipeline import make_pipeline\nfrom sklearn.svm import SVC\n"
        "def own(gamma='scale'):\n    return make_pipeline(SVC(gamma=gamma))\n"
    )
    with pytest.raises(InputError, match="model=own: The 'gamma' parameter of SVC must be"):
        make_plans(cells_of("model=own.py:own model.gamma=wide data.subjects=3"), 1)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("def predict(self, X): pass", "it has no fit(X, y); write one"),
        ("def fit(self, X, y): pass", "it has no predict(X); write one"),
        ("def __init__(self): raise KeyError('colour')", "it cannot be made: KeyError: 'colour'"),
        ("def fit(self, X): pass\n    predict = fit", "fit cannot be called as fit(X, y): "),
    ],
)
def test_a_class_without_its_methods_is_refused_before_the_first_fold(body, words):
    Path("own.py").write_text(f"class Own:\n    {body}\n")
    with pytest.raises(InputError) as refused:
        make_plans(cells_of("model=own.py:Own data.subjects=3"), 1)
    assert str(refused.value).startswith(f"model=Own: {words}")


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
