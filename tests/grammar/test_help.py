"""Help: parts and their parameters, which their docstrings describe, and short sentences."""

import re

import pytest

from bench.cli import main
from bench.grammar.help import describe_part, takes_features
from bench.grammar.options import command_options, load_commands
from bench.ground.registry import registered_parts

LONGEST = 25  # words of a sentence


def test_sentences_are_short():
    texts = [option.help for name in load_commands() for option in command_options(name).values()]
    for command in load_commands().values():
        texts += re.split(r"[.:;] (?=[A-Za-z0-9])", command.text)
    assert not [text for text in texts if len(text.split()) > LONGEST]


@pytest.mark.parametrize("group", ["features", "models", "protocols"])
def test_every_parameter_of_every_part_has_a_meaning(group):
    for name in registered_parts(group):
        part = describe_part(group, name)
        assert part.summary and [p.name for p in part.parameters if not p.meaning] == [], name


def test_every_default_of_a_classifier_has_a_source():
    names = [name for name in registered_parts("models") if takes_features(name)]
    assert {"bayes", "svm", "xgb"} <= {*names}
    assert not {"reflex", "cnn85", "jung2014_svm"} & {*names}
    for name in names:
        parameters = describe_part("models", name).parameters
        assert {p.name for p in parameters if not p.source} <= {"seed"}, name


def test_help_prints_the_parameters_of_the_parts_that_are_named(capsys):
    assert main(["run", "features=jung28,touch", "model=svm", "data=haart", "--help"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert out.index("features=jung28:") < out.index("features=touch:") < out.index("model=svm:")
    assert "model.C= penalty; default 512 (a point of the grid" in out
    assert "features.area=" in out and "no parameters" in out
    assert main(["run", "model=smv", "--help"]) == 2
    assert capsys.readouterr().err.startswith("bench: model=smv: unknown; did you mean svm?")
