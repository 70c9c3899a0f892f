"""The choice among runs on recordings."""

import pandas as pd
import pytest

import bench
from addons.streams.tests.made import stored as watched
from bench.cli import main
from bench.errors import InputError
from bench.words import SMALL
from tests.reports.store import made_up, tracked_run


def test_budgets_of_false_alarms_and_latency_choose_among_runs_of_watch_alone(store, capsys):
    tracked_run(store, "cut", made_up(), data="haart", synthetic="false", subset="all", flash_bytes="1")
    watched(store, "large", [0.8, 0.9, 0.7], alarms=2.3, latency=0.9, flash=9000.0)
    watched(store, "small", [0.78, 0.9, 0.7], alarms=4.0, latency=1.0)  # 0.67 points less, standard error 0.67
    watched(store, "loud", [0.9, 0.9, 0.9], alarms=6.2, latency=0.5, flash=100.0)
    watched(store, "other", [1.0, 1.0, 1.0], alarms=1.0, latency=0.5, **{"watch.background": "quiet"})
    watched(store, "small", [0.8, 0.9, 0.7], alarms=1.0, latency=1.2, **{"watch.false_alarms": "2.0"})
    watched(store, "strange", [1.0, 1.0, 1.0], alarms=1.0, latency=0.5, **{"watch.unknown": "pat"})
    choice = bench.choose(max_false_alarms=5, max_latency="1s", why=True)
    table = choice.choice.table.set_index(["system", "unit"])
    assert len(table) == 4 and choice.system == "small"  # other recordings and whole captures are left out
    cheap = table.loc[("small", "touches in recordings")]
    assert cheap[["accuracy", "false_alarms", "latency", "flash"]].tolist() == pytest.approx([238 / 3, 4, 1000, 4])
    assert table.loc[("small", "touches in recordings, false_alarms=2"), "verdict"].endswith(
        "latency 1200 ms > 1000 ms"
    )
    for fact in (
        "Choose small (touches in recordings): 79.3 % with 4 kB of flash.",
        "It raises 4 false alarms per hour of background; its median latency is 1000 ms.",
        "or with another background",
    ):
        assert fact in str(choice)
    assert bench.choose(by="latency").system == "loud" and "500 ms of latency" in str(bench.choose(by="latency"))
    assert main(["choose", "max_false_alarms=0.5"]) == 1
    out = capsys.readouterr().out
    assert "lowest false-alarm rate is 1 per hour (small" in out and f"bench watch data=haart {SMALL}" in out
    assert main(["choose"]) == 0 and "touches" not in capsys.readouterr().out
    for wrong in ("by=decision", "max_decision=1s", "unit=window", "clock=64MHz"):
        assert main(["choose", "max_latency=1s", wrong]) == 2
        assert wrong.partition("=")[0] in capsys.readouterr().err


def test_a_scene_of_an_endless_stream_scores_the_last_label(store, tmp_path):
    (tmp_path / "robot.toml").write_text('[reactions]\ncalm = ["pat", "rub"]\n[stream]\nfalse_alarms = 5')
    rows = [
        (s, g, said) for s in (1, 2, 3) for g, said in (("pat", "rub"), ("rub", ""), ("tap", "tap"), ("tap", "pat"))
    ]
    touches = pd.DataFrame(rows, columns=["subject", "gesture", "label"])
    watched(store, "small", [0.5, 0.5, 0.5], alarms=2.0, latency=1.0, tables={"touches": touches})
    (tmp_path / "wrong.toml").write_text('[reactions]\ncalm = ["pet"]\n[stream]\nlatency = "2s"')
    with pytest.raises(InputError, match="did you mean pat"):
        bench.choose(scene=str(tmp_path / "wrong.toml"))
    result = bench.choose(scene=str(tmp_path / "robot.toml"))
    assert result.choice.table["accuracy"].tolist() == [50] and result.system == "small"  # a missed touch is a mistake


def test_a_scene_of_a_stream_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "wrong.toml").write_text("[budget]\ndecision = '1s'\n[stream]\nlatency = '1s'")
    with pytest.raises(InputError, match="decision: runs of .stream. do not measure it"):
        bench.choose(scene=str(tmp_path / "wrong.toml"))
