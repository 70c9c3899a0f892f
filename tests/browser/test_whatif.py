"""The what-if panel of the page in headless Chromium, against ``bench choose`` with the command that it tells."""

import json
import os
import shlex
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.arguments import parse
from bench.commands.choose import KEYS, chosen
from bench.outcomes.stability import CLEAN
from bench.outcomes.store import connect
from bench.scene_file import EVERY
from reports.page import write_report
from tests.browser.test_page import CHROMIUM, LACKING, PACKAGES
from tests.reports.store import made_up, other_run, stressed, tracked_run, with_hits

pytestmark = [pytest.mark.live, pytest.mark.real_store, pytest.mark.skipif(bool(LACKING), reason=LACKING or "-")]
GESTURES = ("hit", "notouch", "pat", "rub", "tap")
FACTS = {"mixes_subjects": "false", "test_over_train": "", "official_split": ""}


def kept(store, run, **tables):
    with tempfile.TemporaryDirectory() as folder:
        for name, table in tables.items():
            if name in ("instants", "stopping"):
                table.to_csv(Path(folder) / f"{name}.csv", index=False)
            else:
                table.to_parquet(Path(folder) / f"{name}.parquet", index=False)
        store.keep(run, Path(folder))


def predicted(seed, skill, quarters=False, dtype="float32", **how):
    """Predictions of one precision; in quarters, sums of groups are often equal."""
    table = made_up(8, skill=skill, seed=seed, gestures=GESTURES, **how)
    names = [name for name in table if name.startswith("p_")]
    if quarters:
        table[names] = np.floor(table[names] * 4) / 4
    return table.astype({name: dtype for name in names})


def fill(store):
    """Windows, seeds, ties, one-hot labels, C alone, a replay, two systems under faults, and one without a size."""

    def typed(system):
        line = json.dumps({"data": "haart", "protocol": "loso", "model": system})
        made = {"touchbench.command": "run", "touchbench.arguments": line}
        return made | {"data": "haart", "synthetic": "false", "corpus_digest": "d"}  # as other_run stores it

    tracked_run(store, "svm", predicted(1, 0.75, dtype="float64"), cost=8.0, **typed("svm"))
    tracked_run(store, "rf", predicted(2, 0.8, windows=3), cost=16.0, **typed("rf"))
    tracked_run(store, "tree", predicted(3, 0.35, hard=True), cost=1.0, **typed("tree"))
    tracked_run(store, "et", predicted(4, 0.6, quarters=True), cost=2.0, **typed("et"))
    tracked_run(store, "knn", predicted(9, 0.9), cost=np.nan, **typed("knn"))
    for system, cost, hits in (("cnn", 100.0, [20] * 8), ("mlp", 90.0, [18] + [20] * 7)):  # one standard error apart
        tracked_run(store, system, with_hits(hits, gestures=GESTURES), cost=cost, **typed(system))
    for seed in (0, 1):
        tracked_run(store, "lda", predicted(5 + seed, 0.7, True, per_class=3), cost=4.0, seed=seed, **typed("lda"))
    about = {"cpu": "one", "protocol": "loso", "model": "svm"}
    label = FACTS | {"protocol_label": "LOSO (8 subjects)"}
    sizes = {
        "accuracy": 0.7,
        "chip_flash_bytes": 3000.0,
        "chip_ram_bytes": 400.0,
        "chip_most_instructions": 7e4,
        "capture_ms": 200.0,
    }
    run = other_run(store, "chip", "bayes", sizes, about | {"chip.bits": "8"}, **label)
    kept(store, run, predictions=predicted(7, 0.5, True))
    replayed = pd.concat([predicted(10 + n, 0.3 + 0.06 * n).assign(instant=n) for n in (2, 5, 8)])
    costs = {"accuracy": 0.7, "adaptive_accuracy": 0.65, "adaptive_ms": 812.0, "mean_ms": 900.0, "decide_ms_p50": 1.0}
    costs |= {"decide_ms_p95": 2.0, "flash_bytes": 3500.0, "ram_bytes": 900.0}
    run = other_run(store, "stream", "rf", costs, about | {"stream.start": "onset", "stream.hop_ms": "None"}, **label)
    table = pd.DataFrame({"ms": [40.0, 100.0, 160.0], "mean_ms": 90.0, "accuracy": 0.5, "low": 0.3, "high": 0.8})
    kept(store, run, predictions=replayed, instants=table, stopping=table)
    for system, skill in (("svm", 0.7), ("tree", 0.3)):
        run = stressed(store, system, 0.7, dict.fromkeys(EVERY, 0.05), **label)
        rows = [(CLEAN, 0), *((fault, severity) for fault in EVERY for severity in range(1, 6))]
        parts = []
        for n, (fault, severity) in enumerate(rows):
            part = made_up(8, skill=skill - 0.02 * severity, seed=n, gestures=GESTURES)
            part["predicted"] = part.filter(like="p_").idxmax(axis=1).str.removeprefix("p_")
            parts.append(part.assign(fault=fault, severity=severity, train_subjects=7))
        kept(store, run, stress=pd.concat(parts))


def settings(count=18):
    """Random budgets near most costs above, half of them with reactions, for which it has no losses or replays."""
    rng = np.random.default_rng(0)
    near = {"flash": (2, 70), "ram": (0.3, 9), "predict": (1, 40), "decision": (30, 220), "worst_person": (20, 90)}
    near |= {"cycles": (60, 80), "fault_loss": (1, 40), "worst_fault": (20, 60)}
    made = [{"budgets": {}, "reactions": {}}, {"budgets": {"decision": 120}, "reactions": {}}]
    while len(made) < count:
        grouped = len(made) % 2
        of = ("flash", "ram", "predict", "worst_person") if grouped else (*near,)
        names = ["flash", *rng.choice(of, size=int(rng.integers(0, 2)))]
        budgets = {str(name): round(float(rng.uniform(*near[name])), 2) for name in names}
        options = ("own", "1", "2", "nothing")
        reactions = dict(zip(GESTURES, map(str, rng.choice(options, 5)), strict=True)) if grouped else {}
        made.append({"budgets": budgets, "reactions": reactions})
    return [*made, {"budgets": {"fault_loss": 5}, "reactions": {"hit": "1", "pat": "1", "tap": "nothing"}}]


def test_the_panel_chooses_as_bench_choose_does(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'mlflow.db'}")
    store = connect()
    fill(store)
    write_report(store, Path("report"))
    given = settings()
    command = ["node", str(Path(__file__).with_name("whatif.cjs")), CHROMIUM, "report/index.html", json.dumps(given)]
    env = os.environ | {"NODE_PATH": str(PACKAGES / "node_modules")}
    done = subprocess.run(command, capture_output=True, text=True, env=env, timeout=300)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert seen["console"] == seen["violations"] == [] and max(seen["sideways"]) <= 0
    *told, without_losses = seen["told"]
    firsts = set()
    for setting, page in zip(given, told, strict=False):
        Path("scene.toml").write_text(page["scene"], encoding="utf-8")
        result = chosen(parse(shlex.split(page["command"])[2:], KEYS))
        assert page["lines"][: 1 + bool(result.system)] == result.lines()[: 1 + bool(result.system)], setting
        assert any(setting["reactions"].get(g, "own") != "own" for g in GESTURES) == bool(page["scene"]), setting
        firsts.add(page["lines"][0].partition(":")[0])
    assert told[0]["lines"][0].startswith("Choose mlp: 98.8 %")  # 98.75, halves to even
    assert len(firsts) >= 5 and "Nothing fits the budgets." in firsts
    assert "single gestures alone" in without_losses["lines"][0]
    assert without_losses["scene"] == (
        '[reactions]\nreaction_1 = ["hit", "pat"]\nnothing = ["tap"]\n\n[faults]\nloss = 5'
    )
