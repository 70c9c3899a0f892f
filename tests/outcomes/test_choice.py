"""Which runs of a store are candidates, which are left out and why, on made-up runs."""

import re

import pytest

from bench.cli import main
from bench.errors import InputError
from bench.outcomes.choice import candidates
from bench.outcomes.comparable import MARKED
from bench.outcomes.store import connect
from tests.reports.store import made_up, tracked_run


def systems(store, asked=None, **how):
    return sorted(candidates(store, asked or {}, **how).table["system"])


def test_runs_of_c_do_not_hide_parameters_of_a_protocol(store, capsys):
    for shots in ("0", "3"):
        label = {"protocol": f"personal[shots={shots}]", "protocol_label": f"a new person, {shots} shots"}
        tracked_run(
            store, f"lda {shots}", made_up(), **label, **{"protocol.shots": shots, "protocol.unlabelled": False}
        )
    on_chip = {"touchbench.kind": "chip", "chip.bits": "32"}
    tracked_run(store, "lda 0", made_up(), **on_chip)
    asked = {"shots": ["3"], "protocol": ["personal"]}
    assert systems(store, asked) == ["lda 3"]
    assert systems(store, {"protocol.shots": ["0"]}) == ["lda 0"]
    with pytest.raises(InputError, match=r"protocol\.draws: no run of a protocol that has it is tracked"):
        candidates(store, {"protocol.draws": ["2"]})


def test_a_budget_of_a_second_takes_windows_of_a_second(store, capsys):
    predictions = made_up(windows=3).assign(start=[0, 10, 20] * 48, frames=50)  # at 50 Hz
    tracked_run(store, "lda", predictions)
    tracked_run(store, "rf", predictions.assign(frames=51))
    assert main(["choose", "unit=window", "max_decision=1s"]) == 0
    out = re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    assert "Choose lda (one window): " in out and "ruled out: decision 1020 ms > 1000 ms" in out
    assert (
        "The time until a decision is the touch that it needs; computing time on this machine is not part of it." in out
    )


def test_runs_on_the_newest_corpus_of_a_name_win(store):
    tracked_run(store, "svm", made_up(), corpus_digest="a" * 64)
    tracked_run(store, "rf", made_up(), corpus_digest="a" * 64)
    tracked_run(store, "lda", made_up(5), corpus_digest="b" * 64)
    found = candidates(store, {"data": ["synth"]})
    assert list(found.table["system"]) == ["lda"]
    assert found.notes == ["Left out: 2 older runs on another version of synth (corpus aaaaaaaa)."]
    assert systems(store, {"corpus_digest": ["a" * 64]}) == ["rf", "svm"]  # as the page asks


def test_runs_of_another_version_are_left_out_in_one_line(store, capsys):
    tracked_run(store, "svm", made_up())
    old = tracked_run(store, "rf", made_up())
    store.client.delete_tag(old, "touchbench.format")
    assert systems(connect()) == ["svm"]
    store.client.set_tag(old, "touchbench.format", "0")
    assert main(["choose"]) == 0
    (line,) = capsys.readouterr().err.splitlines()[-1:]
    assert line == "runs that another version of touchbench has stored are left out; run their commands again"
    store.client.delete_tag(store.of_kind("cell")[0].info.run_id, "touchbench.format")
    assert main(["choose"]) == 2 and "no scored run is tracked here; make one first" in capsys.readouterr().err


def test_a_message_names_arguments_that_tell_protocols_apart(store):
    for seed in ("0", "1"):
        name = "personal" + f"[seed={seed}]" * (seed != "0")
        label = {"protocol": name, "protocol_label": f"a new person, seed {seed}"}
        tracked_run(store, f"lda {seed}", made_up(), **label, **{"protocol.seed": seed, "protocol.shots": "3"})
    tracked_run(store, "svm", made_up())
    with pytest.raises(InputError) as wrong:
        candidates(store, {"data": ["synth"]})
    assert "runs on different captures or protocols cannot be compared" in str(wrong.value)
    options = str(wrong.value).partition("name one of: ")[2].split("; ")
    assert options == [
        "data=synth where=all protocol=personal protocol.seed=0",
        "data=synth where=all protocol=personal protocol.seed=1",
        "data=synth where=all protocol=loso",
    ]
    for option, system in zip(options, ("lda 0", "lda 1", "svm"), strict=True):
        asked = {key: [value] for key, _, value in (word.partition("=") for word in option.split())}
        assert systems(store, asked) == [system]


def test_a_run_with_a_failed_fold_is_named(store, capsys):
    label = {"protocol_label": "LOSO (4 subjects)"}
    for system in ("svm", "lda"):
        tracked_run(store, system, made_up())
    tracked_run(store, "svm", made_up(3), failed=1, **label)  # complete elsewhere
    tracked_run(store, "rf", made_up(3), failed=1, **label)
    found = candidates(store, {})
    assert sorted(found.table["system"]) == ["lda", "svm"]
    assert found.notes == ["Left out, because folds failed: rf. Repeat the command to run them again."]
    with pytest.raises(InputError, match="no complete run is tracked.*folds failed: rf"):
        candidates(store, {"system": ["rf"]})
    assert main(["choose"]) == 0
    assert "Left out, because folds failed: rf." in capsys.readouterr().out


def test_a_system_whose_labels_depend_on_the_batch_is_chosen_only_if_asked_for(store, capsys):
    tracked_run(store, "svm", made_up(skill=0.6))
    tracked_run(store, "centred", made_up(skill=0.99), cost=0.1, **{"touchbench.depends_on_batch": "true"})
    tracked_run(store, "lda", made_up(skill=0.5), **{"touchbench.depends_on_batch": "false"})
    assert systems(store) == ["lda", "svm"]
    assert systems(store, batch=True) == ["centred †", "lda", "svm"]
    assert main(["choose"]) == 0
    out = capsys.readouterr().out
    assert "Choose centred" not in out
    assert (
        "Left out, because predictions depend on the captures that are predicted together: centred. "
        "Give batch=yes to choose among them, too." in out
    )
    assert main(["choose", "batch=yes"]) == 0
    out = capsys.readouterr().out
    assert "Choose centred †" in out and "Left out" not in out and MARKED in out
    assert main(["choose", "batch=maybe"]) == 2
    assert "batch=maybe: give yes or no" in capsys.readouterr().err


def test_a_protocol_that_mixes_subjects_is_said_so(store, capsys):
    tracked_run(store, "svm", made_up(), mixes_subjects="true", protocol="kfold", protocol_label="5-fold")
    assert main(["choose"]) == 0
    assert "Training and test captures come from the same subjects: this does not hold" in capsys.readouterr().out


def test_a_candidate_names_the_conditions_that_it_uses(store):
    tracked_run(store, "lda", made_up(skill=0.5), **{"touchbench.conditions": "cover"})
    assert candidates(store, {}).table[["system", "conditions"]].to_numpy().tolist() == [["lda (uses cover)", "cover"]]
