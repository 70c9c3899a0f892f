"""The choice among runs on recordings, and continuous touch on the page."""

import html
from pathlib import Path

import pandas as pd
import pytest

import bench
from addons.streams.tests.people import WATCHED, make_watch_result
from bench.cli import main
from bench.errors import InputError
from bench.ground.typed import SMALL_SYSTEM
from bench.reading.candidates import find_candidates
from bench.reports import page
from tests.reading.results import make_predictions, make_result
from tests.reports.store import keep, tracked_run
from tests.reports.test_report import HOSTILE
from touchbench_streams import page as watching


def test_budgets_of_false_alarms_and_latency_choose_among_runs_of_watch_alone(store, capsys):
    tracked_run(
        store,
        "cut",
        make_predictions(),
        data="haart",
        synthetic="false",
        subset="all",
        flash_bytes="1",
    )
    for each in (
        make_watch_result("large", [0.8, 0.9, 0.7], alarms=2.3, latency=0.9, flash=9000.0),
        make_watch_result(
            "small", [0.78, 0.9, 0.7], alarms=4.0, latency=1.0
        ),  # 0.67 points less, standard error 0.67
        make_watch_result("loud", [0.9, 0.9, 0.9], alarms=6.2, latency=0.5, flash=100.0),
        make_watch_result(
            "other", [1.0, 1.0, 1.0], alarms=1.0, latency=0.5, **{"watch.background": "quiet"}
        ),
        make_watch_result(
            "small", [0.8, 0.9, 0.7], alarms=1.0, latency=1.2, **{"watch.false_alarms": "2.0"}
        ),
        make_watch_result(
            "strange", [1.0, 1.0, 1.0], alarms=1.0, latency=0.5, **{"watch.unknown": "pat"}
        ),
    ):
        keep(store, each)
    choice = bench.choose(max_false_alarms=5, max_latency="1s", why=True)
    table = choice.table.set_index(["system", "unit"])
    assert (
        len(table) == 4 and choice.system == "small"
    )  # other recordings and whole captures are left out
    cheap = table.loc[("small", "touches in recordings")]
    assert cheap[["accuracy", "false_alarms", "latency", "flash"]].tolist() == pytest.approx(
        [238 / 3, 4, 1000, 4]
    )
    verdict = table.loc[("small", "touches in recordings, false_alarms=2"), "verdict"]
    assert verdict.endswith("latency 1200 ms > 1000 ms")
    for fact in (
        "Choose small (touches in recordings): 79.3 % with 4 kB of flash.",
        "It raises 4 false alarms per hour of background; its median latency is 1000 ms.",
        "or with another background",
    ):
        assert fact in str(choice)
    assert bench.choose(by="latency").system == "loud" and "500 ms of latency" in str(
        bench.choose(by="latency")
    )
    assert main(["choose", "max_false_alarms=0.5"]) == 1
    out = capsys.readouterr().out
    assert (
        "lowest false-alarm rate is 1 per hour (small" in out
        and f"bench watch data=haart {SMALL_SYSTEM}" in out
    )
    assert main(["choose"]) == 0 and "touches" not in capsys.readouterr().out


def test_the_rate_of_false_alarms_counts_people_without_touches_by_their_hours():
    people = pd.DataFrame({"subject": ["4", "5"], "end_correct": [float("nan"), 0.5]})
    people = people.assign(false_alarms_per_hour=[36.0, 0.0], background_s=[500.0, 1300.0])
    table = find_candidates(
        [make_watch_result("lda", [0.5], 0.0, 1.0, tables={"per_subject": people})],
        {},
        run_kind="watch",
    ).table
    assert table["accuracy"][0] == 50 and table["false_alarms"][0] == pytest.approx(5 / 0.5)


def test_a_scene_of_an_endless_stream_scores_the_last_label(store, tmp_path):
    reactions = '[reactions]\ncalm = ["pat", "{}"]\n[stream]\n'
    (tmp_path / "robot.toml").write_text(reactions.format("rub") + "false_alarms = 5")
    (tmp_path / "wrong.toml").write_text(reactions.format("pet") + 'latency = "2s"')
    (tmp_path / "other.toml").write_text("[budget]\ndecision = '1s'\n[stream]\nlatency = '1s'")
    said = (("pat", "rub"), ("rub", ""), ("tap", "tap"), ("tap", "pat"))
    touches = pd.DataFrame(
        [(s, *each) for s in (1, 2, 3) for each in said], columns=["subject", "gesture", "label"]
    )
    keep(
        store,
        make_watch_result(
            "small", [0.5, 0.5, 0.5], alarms=2.0, latency=1.0, tables={"touches": touches}
        ),
    )
    for name, fact in {
        "wrong": "did you mean pat",
        "other": "decision: runs of .stream. do not measure it",
    }.items():
        with pytest.raises(InputError, match=fact):
            bench.choose(scene=f"{name}.toml")
    result = bench.choose(scene="robot.toml")
    assert (
        result.table["accuracy"].tolist() == [50] and result.system == "small"
    )  # a missed touch is a mistake


def test_continuous_touch_on_the_page_alone_and_beside_runs_on_captures(quick, store):
    keep(store, make_watch_result(HOSTILE, [0.5] * 3, alarms=40.0, latency=1.0))

    def written():
        page.write_report(store, Path("report"))
        return " ".join(html.unescape(Path("report/index.html").read_text()).split())

    words = written()
    assert '<details id="continuous-touch" open>' in words and "1 run of 1 system" in words
    assert (
        'id="verdict"' not in words
        and 'id="runs"' not in words
        and not Path("report/comparison.csv").exists()
    )
    assert Path("report/figures/0-watch-1.svg").exists()
    about = "LOSO (10 subjects), 2 touches in 2 minutes of background: "
    about += f"{HOSTILE}, detector=frames finds 90.0 percent"
    assert (
        about in words
        and "raises 40.0 false alarms per hour" in words
        and "latency is 1.00 s" in words
    )
    tracked_run(store, "a", make_predictions(3))
    assert '<details id="continuous-touch">' in written()


def test_the_timeline_shows_touches_reports_and_what_was_missed():
    assert watching.frame_rate(WATCHED, 1.5) == 50  # 90 s of background
    numbers = {"background_minutes": 1.5, "touches_found": 0.5, "false_alarms_per_hour": 40.0}
    curve = pd.DataFrame({"offset": [0.0], "missed": [0.5], "false_alarms_per_hour": [40.0]})
    one = make_result(
        "$a$", "watch", numbers, {"predictions": WATCHED, "curve": curve}, synthetic="false"
    )
    figure = watching.draw_watch_figure([one], {})
    timeline, curves = figure.axes
    words = {text.get_text() for text in timeline.texts}
    assert words == {"pat", "rub (missed)", "tap → pat", "rub (false alarm)"}
    assert [bar.get_x() for bar in timeline.patches] == [
        10,
        20,
        11,
        38,
    ] and timeline.get_xlim() == (0, 60)
    assert [line.get_xydata().tolist() for line in curves.lines] == [[[40, 50]]] * 2
    figure.canvas.draw()
