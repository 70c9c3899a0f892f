"""What makes runs comparable, and the facts of protocols, tracked or from before they were."""

import pytest

from bench.outcomes.comparable import Facts, comparable, facts_of


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
