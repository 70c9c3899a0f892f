"""Completion in the shell: keys that commands take, names that are known, in real shells, nothing heavy loaded."""

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bench.cli import COMMANDS, main
from bench.commands.completion import SHELLS, answer, faults, keys, values
from bench.corpora.faults import known
from bench.registry import names

OWN = {"adapt": {"out", "rate_hz", "labels"}, "predict": {"out", "rate_hz"}}  # of what has words without a key, too


@pytest.mark.parametrize("command", COMMANDS)
def test_keys_are_those_that_the_command_takes(command):
    module = importlib.import_module(COMMANDS[command][0].partition(":")[0])
    taken = OWN.get(command) or getattr(module, "KEYS", None)
    if taken is not None:
        assert {key for key in keys([command]) if "." not in key} == set(taken)


def test_values_are_those_that_are_known(tmp_path, monkeypatch):
    assert faults() == list(known()) == list(values("faults"))
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
    from bench.arguments import parse
    from bench.plan.cells import cells

    for word in ("model.repair=stuck+dead+offset", "model.scale=peak", "model.person=centre+scale+pool"):
        key, _, value = word.partition("=")
        assert set(value.split("+")) == set(values(key))
        (cell,) = cells(parse(["model=lda", "features=touch", word], {"model", "features"}))
        cell.estimator()
    for key, command in {"start": "stream", "bits": "chip"}.items():
        for value in values(key):
            assert main([command, f"{key}={value}", "data=nowhere"]) == 2  # of the data, not of the value


def test_a_tab_imports_nothing_heavy(tmp_path):
    code = (
        "import sys; from bench.cli import main; code = main(['completion', 'answer', 'run', 'model=sv'])\n"
        "print(code, [m for m in ('numpy', 'pandas', 'rich', 'mlflow', 'torch', 'sklearn') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "model=svm\n0 []\n"


def test_a_shell_that_is_not_known_is_told_in_one_line(capsys):
    for arguments in ([], ["tcsh"], ["bash", "zsh"]):
        code = main(["completion", *arguments])
        said = capsys.readouterr().err
        assert (code, said.count("\n")) == (2, 1) and "bash" in said


@pytest.fixture
def path(tmp_path):
    """A PATH on which ``bench`` is this copy."""
    (tmp_path / "bin").mkdir()
    bench = tmp_path / "bin" / "bench"
    root = Path(__file__).parents[2]
    bench.write_text(
        f"#!/bin/sh\nPYTHONPATH={root} exec {sys.executable} -c "
        "'import sys; from bench.cli import main; sys.exit(main())' \"$@\"\n"
    )
    bench.chmod(0o755)
    return os.environ | {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "HOME": str(tmp_path)}


def shell(name, script, path):
    if not shutil.which(name):
        pytest.skip(f"{name} is not installed")
    done = subprocess.run([name, "-c", script], capture_output=True, text=True, env=path, timeout=60)
    return done.stdout.splitlines()


TYPED = {
    "bench ru": ["run"],
    "bench run protocol=los": ["protocol=loso"],
    "bench run model=svm,xg": ["model=svm,xgb"],
    "bench run data=synth proto": ["protocol="],
    "bench stress faults=noise,rota": ["faults=noise,rotation"],
    "bench data exp": ["export"],
}


@pytest.mark.parametrize(("typed", "expected"), TYPED.items())
def test_bash_completes(typed, expected, path):
    script = (
        'eval "$(bench completion bash)"; complete -p bench\n'
        f'COMP_LINE="{typed}"; COMP_POINT=${{#COMP_LINE}}; _bench 2>/dev/null; printf "%s\\n" "${{COMPREPLY[@]}}"'
    )
    first, *found = shell("bash", script, path)
    assert first == "complete -F _bench bench"
    whole = typed.split()[-1]
    behind = whole.rpartition("=")[0] + "=" if "=" in whole else ""  # bash puts what it gets behind the =
    assert [behind + word for word in found] == expected


@pytest.mark.parametrize(("typed", "expected"), TYPED.items())
def test_fish_completes(typed, expected, path):
    assert shell("fish", f'bench completion fish | source; complete -C "{typed}"', path) == expected


def test_zsh_takes_the_script(path):
    script = 'compdef() { print -r -- "$@" }; eval "$(bench completion zsh)"; print -r -- $+functions[_bench]'
    assert shell("zsh", script, path) == ["_bench bench", "1"]


def test_scripts_do_not_hold_names_that_change():
    for script in SHELLS.values():
        assert "svm" not in script and "loso" not in script
