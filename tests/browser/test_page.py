"""The report page in headless Chromium: what it loads, whether it can be read, driven by keys, and printed."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from bench.reports.page import write_report
from bench.store import connect
from tests.reports.store import made_up, stressed, tracked_run

pytestmark = pytest.mark.live
PACKAGES = Path(__file__).parents[2] / "build" / "browser"  # npm install --prefix build/browser, as in .ci/run
HAART = {"data": "haart", "synthetic": "false"}
NAMES = ("svm · jung54", "rf[trees=50] · jung28", "lda[window=1.0, repair=stuck+dead, bits=8] · touch", "<b>&'\" · x")


def missing():
    """What the tests lack, in words."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None or shutil.which("node") is None:
        return None, "Chromium and node are needed"
    if not all((PACKAGES / "node_modules" / name).is_dir() for name in ("axe-core", "puppeteer-core")):
        return None, f"npm packages of tests/browser/package.json are not in {PACKAGES.parent.name}/{PACKAGES.name}"
    return chromium, ""


CHROMIUM, LACKING = missing()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A report on what a store may hold, with budgets of which one binds."""
    place = tmp_path_factory.mktemp("page")
    before = os.getcwd()
    os.chdir(place)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{place / 'mlflow.db'}")
            store = connect()
            for i, system in enumerate(NAMES):
                table = made_up(10, skill=0.5 + 0.1 * i, seed=i, windows=1 + 2 * (i == 2))
                tracked_run(store, system, table, cost=4.0**i, **HAART)
            tracked_run(store, "ta2015_rf", made_up(3), protocol="challenge", protocol_label="challenge", **HAART)
            tracked_run(store, "svm · jung54", made_up(6))
            for system, lost in (("svm", 0.1), ("rf", 0.2)):
                stressed(store, system, 0.7, {"noise": lost, "shift": 0.05})
            write_report(store, Path("report"), {"flash": 100.0, "predict": 2.0})
    finally:
        os.chdir(before)
    return place / "report"


@pytest.fixture(scope="module")
def seen(folder):
    """What the browser saw."""
    command = ["node", str(Path(__file__).with_name("look.cjs")), CHROMIUM, str(folder / "index.html")]
    env = os.environ | {"NODE_PATH": str(PACKAGES / "node_modules")}
    done = subprocess.run([*command, str(folder / "page.pdf")], capture_output=True, text=True, env=env, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.real_store
@pytest.mark.skipif(bool(LACKING), reason=LACKING or "-")
class TestPage:
    def test_it_is_small_and_loads_nothing(self, folder, seen):
        assert (folder / "index.html").stat().st_size < 1e6
        assert seen["console"] == [] and seen["requests"] == []

    def test_it_has_no_fault_that_axe_finds(self, seen):
        assert seen["violations"] == {f"{s} {w}": [] for s in ("light", "dark") for w in (1200, 390)}

    def test_verdicts_are_in_view_and_nothing_else_goes_sideways(self, seen):
        for name, view in seen["views"].items():
            assert view["sideways"] <= 0, name
            assert len(view["verdicts"]) > 5 and all(view["verdicts"]), name

    def test_small_text_has_one_size_and_marks_have_titles(self, seen):
        for name, view in seen["views"].items():
            assert all(12.5 < size < 13.5 for size in view["sizes"]), (name, view["sizes"])
            assert all(any(title.startswith(f"{system}: ") for title in view["titles"]) for system in NAMES), name

    def test_the_front_is_one_screen_and_all_else_is_closed(self, seen):
        assert all(view["first"] < (600 if "390" in name else 300) for name, view in seen["views"].items())
        for name, front in seen["fronts"].items():
            assert front["closed"] and front["sideways"] <= 0, name
            assert front["panes"][0] and not any(front["panes"][1:]), name
            assert front["systems"] < 960 or "390" in name, name

    def test_tabs_work_by_keyboard(self, seen):
        assert [i for i, shown in enumerate(seen["keys"]["second"]["panes"]) if shown] == [1]

    def test_it_prints(self, folder, seen):
        assert set(seen["print"]["headings"]) == set(seen["print"]["whole"]) == {"avoid"}
        assert seen["print"]["ink"] == "rgb(0, 0, 0)"  # from a dark page, too
        pages = re.findall(rb"/Type\s*/Page\b", (folder / "page.pdf").read_bytes())
        assert 5 < len(pages) < 40
