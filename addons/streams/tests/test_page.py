"""Continuous touch on the page."""

import html
from pathlib import Path

import pandas as pd

from addons.streams.tests.made import WATCHED, watched
from bench.reports import page
from tests.reports.store import keep, tracked_run
from tests.reports.test_report import HOSTILE
from tests.results import made_up, result
from touchbench_streams import page as watching


def test_continuous_touch_on_the_page(quick, store):
    tracked_run(store, "a", made_up(3))
    keep(store, watched(HOSTILE, [0.5] * 3, alarms=40.0, latency=1.0))
    page.write_report(store, Path("report"))
    words = " ".join(html.unescape(Path("report/index.html").read_text()).split())
    assert '<details id="continuous-touch">' in words and Path("report/figures/0-watch-1.svg").exists()
    assert (
        f"LOSO (10 subjects), 2 touches in 2 minutes of background: {HOSTILE}, detector=frames finds 90.0 percent"
        in words
    )
    assert "raises 40.0 false alarms per hour" in words and "latency is 1.00 s" in words


def test_without_runs_on_captures_the_report_has_those_on_recordings(quick, store):
    keep(store, watched("svm", [0.5] * 6, alarms=40.0, latency=1.0))
    written = page.write_report(store, Path("report"))
    words = " ".join(html.unescape(Path("report/index.html").read_text()).split())
    assert '<details id="continuous-touch" open>' in words and "1 run of 1 system" in words
    assert 'id="verdict"' not in words and 'id="runs"' not in words
    assert Path("report/index.html") in written and not Path("report/comparison.csv").exists()


def test_the_timeline_shows_touches_reports_and_what_was_missed():
    assert watching.frame_rate(WATCHED, 1.5) == 50  # 90 s of background
    numbers = {"background_minutes": 1.5, "touches_found": 0.5, "false_alarms_per_hour": 40.0}
    curve = pd.DataFrame({"offset": [0.0], "missed": [0.5], "false_alarms_per_hour": [40.0]})
    one = result("$a$", "watch", numbers, {"predictions": WATCHED, "curve": curve}, synthetic="false")
    figure = watching.watching_figure([one], {})
    timeline, curves = figure.axes
    words = {text.get_text() for text in timeline.texts}
    assert words == {"pat", "rub (missed)", "tap → pat", "rub (false alarm)"}
    assert [bar.get_x() for bar in timeline.patches] == [10, 20, 11, 38] and timeline.get_xlim() == (0, 60)
    assert [line.get_xydata().tolist() for line in curves.lines] == [[[40, 50]]] * 2
    figure.canvas.draw()
