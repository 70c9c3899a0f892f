"""What makes runs comparable, and the facts of protocols."""

from bench.comparable import alike, comparable
from bench.outcomes.runs import grouped
from bench.registry import views
from tests.results import evaluated


def test_runs_are_comparable_on_the_same_captures_under_the_same_protocol():
    run = {"data": "arm", "corpus_digest": "d", "subset": "all", "target": "gesture", "protocol_label": "LOSO"}
    assert comparable(run) == comparable(run | {"system": "svm", "seed": "3", "status": "FAILED"})
    for key in run:
        assert comparable(run) != comparable(run | {key: "other"})
    replayed = run | {"stream.start": "onset", "stream.hop_ms": "None"}
    middle = replayed | {"stream.start": "middle"}
    assert comparable(replayed) == comparable(middle) == comparable(run)  # the captures as they are
    assert alike(replayed, views()["after"].alike) != alike(middle, views()["after"].alike)


def test_runs_on_other_splits_are_never_in_one_group():
    label = "10-fold, subjects mixed"
    seeds = [
        evaluated("svm", protocol="kfold", protocol_label=label, **{"protocol.seed": "0"}),
        evaluated("svm", protocol="kfold[seed=1]", protocol_label=f"{label}, seed 1", **{"protocol.seed": "1"}),
    ]
    assert grouped(seeds) == {
        f"synth (synthetic), all, {words}": [r] for words, r in zip((label, f"{label}, seed 1"), seeds, strict=True)
    }
