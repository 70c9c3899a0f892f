"""The report page in headless Chromium: it loads nothing, is readable, works by keys, prints."""

import csv
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from bench.reports.page import write_report
from bench.store.client import connect
from tests.reports.store import make_predictions, stressed, tracked_run

pytestmark = pytest.mark.live
# npm install --prefix build/browser, as in .ci/run
PACKAGES = Path(__file__).parents[2] / "build" / "browser"
HAART = {"data": "haart", "synthetic": "false"}
NAMES = (
    "svm · jung54",
    "rf[trees=50] · jung28",
    "lda[window=1.0, repair=stuck+dead, bits=8] · touch",
    "<b>&'\" · x",
)


CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
MODULES = [PACKAGES / "node_modules" / name for name in ("axe-core", "puppeteer-core")]
COMPLETE = CHROMIUM and shutil.which("node") and all(path.is_dir() for path in MODULES)
LACKING = "Chromium, node and the npm packages of tests/browser/package.json are needed"


def tables(i):
    """Predictions of the lowest seed of a system."""
    return make_predictions(10, skill=0.5 + 0.1 * i, seed=i, windows=1 + 2 * (i == 2))


def hits_of(i):
    """Which captures a system labels correctly, in the order of captures."""
    table = tables(i)
    means = table.groupby("capture")[[c for c in table if c.startswith("p_")]].mean()
    return means.idxmax(axis=1).str[2:] == table.groupby("capture")["true"].first()


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
                tracked_run(store, system, tables(i), cost=4.0**i, **HAART)
            tracked_run(store, NAMES[0], make_predictions(10, skill=0.55, seed=9), seed=1, **HAART)
            tracked_run(
                store,
                "ta2015_rf",
                make_predictions(3),
                protocol="challenge",
                protocol_label="challenge",
                **HAART,
            )
            tracked_run(store, "svm · jung54", make_predictions(6))
            for system, lost in (("svm", 0.1), ("rf", 0.2)):
                stressed(store, system, 0.7, {"noise": lost, "shift": 0.05})
            write_report(store, Path("report"), {"flash": 100.0, "predict": 2.0})
    finally:
        os.chdir(before)
    return place / "report"


@pytest.fixture(scope="module")
def seen(folder):
    """What the browser saw."""
    command = [
        "node",
        str(Path(__file__).with_name("look.cjs")),
        CHROMIUM,
        str(folder / "index.html"),
    ]
    env = os.environ | {"NODE_PATH": str(PACKAGES / "node_modules")}
    downloads = folder / "downloads"
    downloads.mkdir()
    command += [str(folder / "page.pdf"), str(downloads)]
    done = subprocess.run(command, capture_output=True, text=True, env=env, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.real_store
@pytest.mark.skipif(not COMPLETE, reason=LACKING)
class TestPage:
    def test_it_is_small_and_loads_nothing(self, folder, seen):
        assert (folder / "index.html").stat().st_size < 1e6
        assert seen["console"] == [] and seen["requests"] == []

    def test_it_has_no_fault_that_axe_finds(self, seen):
        assert {*seen["violations"]} >= {
            f"{s} {w}" for s in ("light", "dark", "compared") for w in (1200, 390)
        }
        assert not any(seen["violations"].values()), seen["violations"]

    def test_verdicts_are_in_view_and_nothing_else_goes_sideways(self, seen):
        for name, view in seen["views"].items():
            assert view["sideways"] <= 0, name
            assert len(view["verdicts"]) > 5 and all(view["verdicts"]), name

    def test_small_text_has_one_size_and_marks_have_titles(self, seen):
        for name, view in seen["views"].items():
            assert all(12.5 < size < 13.5 for size in view["sizes"]), (name, view["sizes"])
            assert all(
                any(title.startswith(f"{system}: ") for title in view["titles"]) for system in NAMES
            ), name

    def test_the_front_is_one_screen_and_all_else_is_closed(self, seen):
        assert all(
            view["first"] < (600 if "390" in name else 300) for name, view in seen["views"].items()
        )
        for name, front in seen["fronts"].items():
            assert front["closed"] and front["sideways"] <= 0, name
            assert front["panes"][0] and not any(front["panes"][1:]), name
            assert front["systems"] < 960 or "390" in name, name

    def test_tabs_work_by_keyboard(self, seen):
        assert [i for i, shown in enumerate(seen["keys"]["second"]["panes"]) if shown] == [1]

    def test_systems_are_sorted_by_click_and_by_keyboard(self, folder, seen):
        statistics = pd.read_csv(folder / "statistics.csv").query("group.str.contains('LOSO')")
        first, clicked, typed = (seen["live"][name] for name in ("first", "clicked", "by keyboard"))
        assert first["sorted"] == {} and first["address"] == ""
        systems = dict.fromkeys(statistics["system"])  # a later group has one of them again
        assert first["names"] == [name for name in systems if name in NAMES]
        assert clicked["names"] == [*NAMES]  # cost 4 ** i
        assert clicked["sorted"] == {"flash kB": "ascending"}
        assert typed["names"] == [*NAMES[::-1]] and typed["sorted"] == {"flash kB": "descending"}
        assert clicked["address"] == "#sort=flash" and typed["address"] == "#sort=-flash"
        assert typed["focus"] == "flash"

    def test_filter_seeds_and_columns_are_what_is_downloaded(self, folder, seen):
        filtered, unfolded, fewer = (
            seen["live"][name] for name in ("filtered", "unfolded", "fewer columns")
        )
        assert filtered["names"] == [NAMES[1], NAMES[0]] and "filter=jung" in filtered["address"]
        assert (
            unfolded["seeds"] == ["seed 0", "seed 1"] and f"open={NAMES[0]}" in unfolded["address"]
        )
        assert [head for head in unfolded["heads"] if head not in fewer["heads"]] == ["test"]
        (file,) = (folder / "downloads").glob("*.csv")
        head, *rows = csv.reader(file.read_text(encoding="utf-8").splitlines())
        assert file.stem == "loso" and head == fewer["heads"]
        assert [row[0] for row in rows] == [NAMES[1], NAMES[0], "seed 0", "seed 1"]
        assert [row[1:] for row in rows] == [row[1:] for row in fewer["rows"]]

    def test_two_systems_are_compared_from_numbers_of_the_page(self, folder, seen):
        """Test and interval are those of pairs.csv; captures are counted from the predictions."""
        found = seen["live"]["compared"]
        one, two = re.findall("pin=([^&]+)", found["address"])
        pairs = pd.read_csv(folder / "pairs.csv").query("group.str.contains('LOSO')")
        row = pairs[pairs["system"].isin([one, two]) & pairs["other"].isin([one, two])].iloc[0]
        sign = 1 if row["system"] == one else -1
        low, high = sorted((sign * row["low"], sign * row["high"]))
        more = "more" if sign * row["difference"] >= 0 else "less"
        p = "< 0.001" if row["p"] < 0.001 else f"= {row['p']:.3f}"
        words = f"{one} is {abs(row['difference']):.1f} points {more} accurate than {two}. "
        words += f"95 % interval [{low:+.1f}, {high:+.1f}], p {p} (both"
        assert words in found["pair"]
        hits = [hits_of(NAMES.index(name)) for name in (one, two)]
        only = [int((a & ~b).sum()) for a, b in (hits, hits[::-1])]
        for name, count in zip((one, two), only, strict=True):
            assert f"Only {name} classifies {count} capture" in found["pair"]
        measures, gestures = found["cells"]
        assert [
            "flash kB",
            *(f"{4.0 ** NAMES.index(name) * 4:.3g}" for name in (one, two)),
        ] in measures
        assert [sum(int(row[i]) for row in gestures) for i in (5, 6)] == only
        gaps = [abs(float(row[4])) for row in gestures]
        assert gaps == sorted(gaps, reverse=True) and len(gestures) == 3
        assert {*found["pinned"]} == {one, two} and seen["live"]["first"]["pinned"] == []

    def test_an_address_shows_the_same_to_a_colleague(self, seen):
        found = seen["live"]["compared"]
        for width in (1200, 390):
            again = seen["live"][f"opened {width}"]
            assert {k: again[k] for k in ("address", "rows", "sorted", "pair", "pinned")} == {
                k: found[k] for k in ("address", "rows", "sorted", "pair", "pinned")
            }
            assert again["sideways"] <= 0
        assert seen["live"]["no networks"]["names"] == []

    def test_marks_of_the_chart_tell_their_numbers_by_keyboard(self, seen):
        found = seen["live"]["next mark"]
        assert (
            re.search(r": [\d.]+ \[[\d.]+, [\d.]+\] %, [\d.]+ kB", found["before"])
            and found["about"] != found["before"]
        )

    def test_it_prints(self, folder, seen):
        assert set(seen["print"]["headings"]) == set(seen["print"]["whole"]) == {"avoid"}
        assert seen["print"]["ink"] == "rgb(0, 0, 0)"  # from a dark page, too
        pages = re.findall(rb"/Type\s*/Page\b", (folder / "page.pdf").read_bytes())
        assert 5 < len(pages) < 40
