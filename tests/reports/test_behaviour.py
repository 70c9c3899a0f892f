"""Stress and stream runs on the page: which runs are shown, and what of them."""

from pathlib import Path

import pandas as pd

from bench.outcomes.store import FORMAT
from reports import page
from reports.fault_curves import contexts, stream_blocks, stress_blocks
from tests.reports.store import made_up, tracked_run

ABOUT = {
    "touchbench.depends_on_batch": "false",
    "data": "haart",
    "synthetic": "false",
    "subset": "all",
    "target": "gesture",
    "protocol": "loso",
    "protocol_label": "LOSO (10 subjects)",
    "seed": "0",
    "touchbench.format": FORMAT,
}


def other_run(store, kind, system, metrics, at, status="FINISHED", params=None, **tags):
    tags = {"touchbench.kind": kind, "system": system} | ABOUT | tags
    run = store.client.create_run(store.experiment_id, run_name=system, tags=tags, start_time=at).info.run_id
    for name, value in metrics.items():
        store.client.log_metric(run, name, value)
    for name, value in ({"corpus_digest": "d"} | (params or {})).items():
        store.client.log_param(run, name, value)
    store.end(run, status)
    return run


def stressed(accuracy, losses, **more):
    found = {"accuracy": accuracy, "failing_slices": 3, "tested_slices": 40, "worst.subject": accuracy / 2}
    return found | {f"loss.{k}": v for k, v in losses.items()} | more


def test_of_each_method_the_run_that_met_most_faults_then_the_newest_with_its_lowest_seed(store, tmp_path):
    both = {"noise": 0.1, "shift": 0.234}
    other_run(store, "stress", "svm", stressed(0.5, both), at=1)
    whole = other_run(store, "stress", "svm", stressed(0.6, both, **{"half_margin.shift": 2.25}), at=2)
    other_run(store, "stress", "svm", stressed(0.6, {"noise": 0.3}), at=3)
    other_run(store, "stress", "svm", stressed(0.9, both), at=4, status="FAILED")
    other_run(store, "stress", "svm", stressed(0.9, both), at=5, seed="1")
    forest = other_run(store, "stress", "rf", stressed(0.7, {"noise": 0.05}), at=1)
    other_run(store, "stress", "rf", stressed(0.7, both), at=9, subset="cover == 'none'")
    other_run(store, "stress", "rf", stressed(0.7, both), at=9, data="synth", synthetic="true")
    (first, runs), *rest = contexts(store, "stress").items()
    assert first == "haart, all, LOSO (10 subjects), only the lowest seed of each system" and [
        r.info.run_id for r in runs
    ] == [forest, whole]
    assert [name for name, _ in rest] == [
        "haart, cover == 'none', LOSO (10 subjects)",
        "synth (synthetic), all, LOSO (10 subjects)",
    ]
    picture, table, *_ = stress_blocks(store, tmp_path)
    drawn = picture.paths[1].read_text()
    assert all(f">{text}</text>" in drawn for text in ("23", "10", "5", "-", "svm (60 % clean)", "rf (70 % clean)"))
    row = table.frame.set_index("method").loc["svm"]
    assert row["half of the margin is lost at"] == "shift 2.2" and row["failing of tested slices"] == "3 of 40"
    assert row["worst subject"] == "30.0" and table.frame["method"].tolist() == ["rf", "svm"]


def test_streams_are_drawn_by_start_and_hop_with_their_learned_stop(store, tmp_path):
    for start, hop, system in (("onset", "None", "svm"), ("onset", "None", "rf"), ("middle", "125.0", "svm")):
        metrics = {
            "accuracy": 0.7,
            "adaptive_accuracy": 0.65,
            "adaptive_ms": 812.0,
            "decide_ms_p50": 1.04,
            "decide_ms_p95": 2.0,
            "accuracy_at_500_ms": 0.5,
        }
        params = {"stream.start": start, "stream.hop_ms": hop}
        run = other_run(store, "stream", system, metrics, at=1, params=params)
        for name in ("instants", "stopping"):
            table = pd.DataFrame({"ms": [100.0, 900], "mean_ms": [100.0, 900], "accuracy": [0.4, 0.7]})
            table.assign(low=0.3, high=0.8).to_csv(tmp_path / f"{name}.csv", index=False)
            store.keep(run, tmp_path / f"{name}.csv")
    first, table, second, _ = stream_blocks(store, tmp_path)
    assert first.caption.startswith("haart, all, LOSO (10 subjects): ") and sorted(table.frame["method"]) == [
        "rf",
        "svm",
    ]
    assert "from the middle of the capture, a decision every 125.0 ms" in second.caption
    row = table.frame.iloc[0]
    assert (row["250 ms"], row["500 ms"], row["adaptive"], row["after ms"]) == ("-", "50.0", "65.0", "812")
    assert row["decision ms p50 / p95"] == "1.0 / 2.0"


def test_the_page_has_them_where_there_are_any(store):
    tracked_run(store, "a", made_up(3))
    page.write_report(store, Path("report"))
    assert ">Faults</h2>" not in Path("report/index.html").read_text()
    other_run(store, "stress", "svm", stressed(0.6, {"noise": 0.1}), at=1)
    paths = page.write_report(store, Path("report"))
    text = Path("report/index.html").read_text()
    assert ">Faults</h2>" in text and ">Early decisions</h2>" not in text
    assert Path("report/figures/0-stress-1.png") in paths
