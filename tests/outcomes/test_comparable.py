"""What makes runs comparable, and the facts of protocols."""

from bench.comparable import comparable
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


def test_runs_on_other_splits_are_never_in_one_group():
    store = connect()
    label = "10-fold, subjects mixed"
    named = {"protocol": "kfold[seed=1]", "protocol_label": f"{label}, seed 1"}
    for about in ({"protocol": "kfold", "protocol_label": label, "protocol.seed": "0"}, named | {"protocol.seed": "1"}):
        tracked_run(store, "svm · jung54", made_up(), **about)
    runs = with_groups(tracked(store))
    assert runs["protocol"].tolist() == ["kfold", "kfold[seed=1]"]
    assert runs["protocol_label"].tolist() == [label, f"{label}, seed 1"]
    assert runs["group"].nunique() == 2
