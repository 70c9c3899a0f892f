"""Completion in the shell: keys that commands take, names that are known, in real shells, nothing heavy loaded."""

from dataclasses import replace

import pytest

from bench.amounts import UNITS
from bench.arguments import parse, value_of
from bench.commands.completion import answer, values
from bench.corpora.faults import all_faults
from bench.endless.stress import whole_faults
from bench.options import OPTIONS, commands, keys, makers, options
from bench.plan.cells import cells
from bench.registry import names


@pytest.mark.parametrize("option", OPTIONS, ids=lambda option: f"{option.commands.split()[0]}-{option.key}")
def test_a_key_of_the_table_is_taken_completed_and_has_a_default_of_its_type(option):
    every = [*option.commands.split(), *(makers() if "makers" in option.commands else ())]
    for command in (command for command in every if command != "makers"):
        name = command.partition("-")[0]
        listed = options(command)[option.key]  # with the values that only the code knows
        assert name in commands() and replace(listed, values=option.values) == option
        assert option.key in keys(name) or "." in option.key
        assert f"{option.key}=" in answer([*command.split("-"), *(["synth"] if "-" in command else []), option.key])
        if option.default not in (None, "") and option.type not in ("amount", *UNITS):
            assert value_of(option, str(option.default)) == option.default
        for value in listed.values:
            assert str(value_of(option, value)) == value


def test_values_are_those_that_are_known(tmp_path, monkeypatch):
    assert [*all_faults(), "none"] == list(values("faults", options("stress")))
    assert [*whole_faults()] == list(values("under", options("watch")))
    assert answer(["run", "protocol=lo"]) == ["protocol=loso"]
    assert set(answer(["run", "model="])) == {f"model={name}" for name in names("models")}
    assert answer(["run", "model=svm,rf,r"]) == [
        f"model=svm,rf,{n}" for n in sorted(names("models")) if n[0] == "r" and n != "rf"
    ]
    assert "model.faults=noise+shift" in answer(["run", "model.faults=noise+"])
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path))
    (tmp_path / "corpora" / "arm").mkdir(parents=True)
    assert answer(["run", "data="]) == ["data=synth"]
    (tmp_path / "corpora" / "arm" / "current").touch()
    assert answer(["data", "show", ""]) == ["synth", "arm"]
    assert answer(["run", "data=a"]) == ["data=arm"] and answer(["nonsense", ""]) == []
    assert "model=" not in answer(["run", "model=svm", "m"])


def test_names_of_values_that_the_registry_lacks_are_taken_by_the_code():
    for key in ("model.repair", "model.person", "model.scale"):
        listed = values(key, options("run"))
        word = f"{key}={'peak' if key == 'model.scale' else '+'.join(listed)}"
        (cell,) = cells(parse(["model=lda", "features=touch", word], {"model", "features"}))
        cell.estimator()
