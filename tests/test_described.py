"""Parts in words: every parameter has a meaning, defaults an origin, and help has both."""

import pytest

from bench.cli import main
from bench.described import classifiers, described
from bench.registry import names


@pytest.mark.parametrize("room", ["features", "models", "protocols"])
def test_every_parameter_of_every_part_has_a_meaning(room):
    for name in names(room):
        one = described(room, name)
        assert one.summary and [f"{name}.{p.name}" for p in one.parameters if not p.meaning] == []


def test_every_default_of_a_classifier_has_an_origin():
    assert {"bayes", "svm", "xgb"} <= {*classifiers()} and not {"reflex", "cnn85", "jung2014_svm"} & {*classifiers()}
    for name in classifiers():
        assert [f"{name}.{p.name}" for p in described("models", name).parameters if not p.source] in (
            [],
            [f"{name}.seed"],
        )


def test_help_prints_the_parameters_of_the_parts_that_are_named(capsys):
    assert main(["run", "features=jung28,touch", "model=svm", "data=haart", "--help"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert out.index("features=jung28:") < out.index("features=touch:") < out.index("model=svm:")
    for fact in ("model.C= penalty; default 512 (a point of the grid", "features.area=", "no parameters"):
        assert fact in out
    assert main(["ui", "model=svm", "--help"]) == 0 and capsys.readouterr().out.startswith("bench ui")
    assert main(["run", "model=smv", "--help"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("bench: model=smv: unknown; did you mean svm?")
