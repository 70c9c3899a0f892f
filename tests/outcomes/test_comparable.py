"""What makes runs comparable, and the facts of protocols, tracked or from before they were."""

import json

import pytest

from bench.outcomes.comparable import Facts, comparable, facts_of, seeds_named
from bench.outcomes.runs import tracked, with_groups
from bench.outcomes.store import connect
from tests.reports.store import made_up, tracked_run


def test_runs_are_comparable_on_the_same_captures_under_the_same_protocol():
    run = {"data": "arm", "corpus_digest": "d", "subset": "all", "target": "gesture", "protocol_label": "LOSO"}
    assert comparable(run) == comparable(run | {"system": "svm", "seed": "3", "status": "FAILED"})
    for key in run:
        assert comparable(run) != comparable(run | {key: "other"})
    replayed = run | {"stream.start": "onset", "stream.hop_ms": "None"}
    assert comparable(replayed) != comparable(replayed | {"stream.start": "middle"})
    assert comparable({k: v for k, v in run.items() if k != "target"}) == comparable(run)  # of old runs


def test_facts_are_tags():
    run = {"mixes_subjects": "true", "test_over_train": "0.25", "official_split": "false"}
    assert facts_of(run) == Facts(True, 0.25, False)
    assert facts_of({"mixes_subjects": "false", "test_over_train": "", "official_split": ""}) == Facts(
        False, None, None
    )


@pytest.mark.parametrize(
    ("protocol", "folds", "facts"),
    [
        ("loso", 10, Facts(False, pytest.approx(1 / 9), None)),
        ("kfold", 5, Facts(True, pytest.approx(1 / 4), None)),
        ("holdout", 1, Facts(True, None, None)),
        ("challenge", 1, Facts(False, None, True)),
        ("challenge", 5, Facts(False, None, False)),
        ("mine", 3, Facts(False, None, None)),
    ],
)
def test_facts_of_runs_from_before_they_were_tracked(protocol, folds, facts):
    assert facts_of({"protocol_name": protocol, "folds": float(folds)}) == facts


def test_runs_on_other_splits_are_never_in_one_group():
    """Two as they are tracked now, and one from before labels named the seed of a protocol."""
    store = connect()
    label = "10-fold, subjects mixed"
    named = {"protocol": "kfold[seed=1]", "protocol_label": f"{label}, seed 1"}
    for about in (
        {"protocol": "kfold", "protocol_label": label, "protocol.seed": "0"},
        named | {"protocol.seed": "1"},
        {"protocol": "kfold", "protocol_label": label, "protocol.seed": "2"},
    ):
        tracked_run(store, "svm · jung54", made_up(), **about)
    runs = with_groups(tracked(store))
    assert runs["protocol"].tolist() == ["kfold", "kfold[seed=1]", "kfold[seed=2]"]
    assert runs["protocol_label"].tolist() == [label, f"{label}, seed 1", f"{label}, seed 2"]
    assert runs["group"].nunique() == 3


def test_the_seeds_of_older_runs_are_named_from_their_parameters():
    arguments = {"data": "arm", "protocol": "kfold", "protocol.folds": "5", "model": "bayes", "features": "hughes36"}
    old = {
        "protocol": "kfold[folds=5]",
        "protocol_label": "5-fold, subjects mixed",
        "system": "bayes · hughes36",
        "features": "hughes36",
        "seed": "none",
        "touchbench.arguments": json.dumps(arguments),
    }
    now = seeds_named(old, {"protocol.seed": "1", "features.seed": "2"})
    assert json.loads(now.pop("touchbench.arguments")) == arguments | {"protocol.seed": "1", "seed": "2"}
    assert now == {
        "protocol": "kfold[folds=5, seed=1]",
        "protocol_label": "5-fold, subjects mixed, seed 1",
        "seed": "2",
    }
    forest = old | {"system": "rf · hughes36", "seed": "1"}
    now = seeds_named(forest, {"protocol.seed": "0", "features.seed": "0"})
    assert now["system"] == "rf · hughes36[seed=0]" and now["features"] == "hughes36[seed=0]"
    assert json.loads(now["touchbench.arguments"]) == arguments | {"features.seed": "0"}
    assert seeds_named(old | now, {"protocol.seed": "0", "features.seed": "0"}) == {"seed": "0"}
    assert seeds_named(forest, {"protocol.seed": "0", "features.seed": "1"}) == {}
    assert seeds_named(forest, {"tuning.seed": "1", "features.seed": "0"}) == {}
    assert seeds_named({"touchbench.kind": "fold"}, {}) == {}
