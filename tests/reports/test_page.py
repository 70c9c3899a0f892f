"""The report as a whole, on stores that hold what real ones may hold."""

import json
import re
import socket
from html import escape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from bench.errors import InputError
from bench.leaderboard.tasks import HAART
from bench.outcomes.comparable import BATCH, MARK, MARKED
from bench.outcomes.runs import tracked, with_groups
from reports import curves, details, layout, page, speed
from reports.comparison import comparison, published
from reports.figures import spread
from reports.numbers import DESIGNED
from reports.provenance import command
from tests.reports.store import made_up, tracked_run, with_hits

HOSTILE = 'svm[x=<script>alert(1)</script>|"&*_] · `a`'


class Loads(HTMLParser):
    """Collects what a page would fetch, its text, and tags that are never closed."""

    def __init__(self):
        super().__init__()
        self.loaded, self.scripts, self.open, self.words = [], 0, [], []

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.scripts += tag == "script"
        self.loaded += [found[k] for k in ("src", "srcset", "data", "poster", "action") if k in found]
        if tag != "a":
            self.loaded += [found[k] for k in ("href", "xlink:href") if k in found]
        if tag not in ("meta", "br", "img", "input"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.handle_endtag(tag)

    def handle_endtag(self, tag):
        if tag in self.open:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def read(folder="report"):
    text = Path(folder, "index.html").read_text(encoding="utf-8")
    parser = Loads()
    parser.feed(text)
    return text, parser


@pytest.fixture
def quick(monkeypatch):
    """Figures are made, but what is drawn is nothing: most of the time would go there."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda self, path, **_: Path(path).write_text("<svg/>"))


def report(store):
    return [p.relative_to("report").as_posix() for p in page.write_report(store, Path("report"))]


def test_the_whole_report(store):
    for i, system in enumerate(["cnn85", "cnn85[frames=40]", "svm · jung54", HOSTILE]):
        frames = {"model.frames": 40 if "frames" in system else 85}
        table = made_up(7, skill=0.4 + 0.1 * i, seed=i, windows=3 if "cnn" in system else 1)
        about = {"features": "raw frames"} | frames | typed(frames["model.frames"]) if "cnn" in system else {}
        tracked_run(store, system, table, history=[2.0, 1.0] if "cnn" in system else (), cost=1 + i, **about)
    tracked_run(store, "svm · jung54", made_up(7, seed=9), seed=1)
    files = report(store)
    assert {
        "index.html",
        "comparison.md",
        "comparison.csv",
        "published.csv",
        "recomputed.csv",
        "statistics.csv",
        "provenance.csv",
        "pairs.csv",
    } <= set(files)
    kinds = {Path(f).stem.split("subjects-")[1] for f in files if f.endswith(".svg")}
    assert kinds == {"ranks", "subjects", "speed", "gestures", "confusion", "calibration", "training", "lengths"}
    assert all(Path("report", f).stat().st_size > 500 for f in files)
    text, found = read()
    assert not found.open and all(v[0] == "#" for v in found.loaded)
    assert "<script>alert" not in text and found.scripts == 2  # the data of the chart and the chart
    assert "http" not in "".join(re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?([^\"') >]*)", text))
    words = " ".join(" ".join(found.words).split())
    assert "<script>alert(1)</script>" in words and "say nothing about people" in words
    for row in published().itertuples():
        assert " ".join(row.classifier.split()) in words and row.reference in words
    markdown = Path("report/comparison.md").read_text(encoding="utf-8")
    for line in markdown.splitlines():
        if line.startswith("|") and "alert" in line:
            assert r"\<script\>" in line or "`" in line
    tables = [block.splitlines() for block in markdown.split("\n\n") if block.startswith("|")]
    for table in tables:
        rows = [len(re.findall(r"(?<!\\)\|", line)) for line in table if line.startswith("|")]
        assert len(set(rows)) == 1
    assert "hover" not in markdown and markdown.count("| data not here |") == len(published())


def test_generated_captures_are_marked_on_every_table_and_figure(store):
    tracked_run(store, "a", made_up(6))
    tracked_run(store, "b", made_up(6, seed=1))
    files = report(store)
    drawings = [Path("report", f).read_text(encoding="utf-8") for f in files if f.endswith(".svg")]
    assert drawings and all("synthetic captures, not people" in d for d in drawings)
    table = pd.read_csv("report/comparison.csv")
    assert table["data"].str.contains("synthetic").all() and table["published"].isna().all()
    for name in ("statistics", "provenance"):
        assert pd.read_csv(f"report/{name}.csv")["group"].str.contains("synthetic").all()
    text, _ = read()
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", text)
    assert captions and all("Synthetic" in c for c in captions)


@pytest.mark.parametrize(
    "predictions",
    [made_up(1), made_up(2, per_class=1, gestures=("only",)), made_up(3, hard=True), made_up(12, windows=2, skill=1.0)],
)
def test_one_run_one_subject_one_class_labels_only(quick, store, predictions):
    tracked_run(store, "a", predictions, protocol_label="LOSO")
    report(store)
    text, found = read()
    assert not found.open
    subjects = predictions["subject"].nunique()
    assert ("too few to conclude" in text) == (subjects < 6)
    probabilities = predictions.filter(like="p_").to_numpy()
    assert ("Labels only" in text) == bool(np.isin(probabilities, (0, 1)).all())


def test_failed_folds_are_told_and_compared_with_nothing(quick, store):
    for i, failed in enumerate([0, 0, 0, 2]):
        tracked_run(store, f"system{i}", made_up(6, seed=i, skill=0.2 + 0.2 * i), failed=failed)
    report(store)
    text, _ = read()
    assert "Runs with failed folds are scored on the others and compared with nothing: system3." in text
    assert set(pd.read_csv("report/statistics.csv")["system"]) == {"system0", "system1", "system2"}
    assert "6/8" in set(pd.read_csv("report/comparison.csv")["folds"])


def test_runs_that_depend_on_the_batch_are_marked_and_left_out_of_verdict_and_statistics(quick, store):
    for place, name in enumerate("abcd"):
        tracked_run(store, name, with_hits([18 - place] * 7), **({BATCH: "true"} if name == "a" else {}))
    report(store)
    text, _ = read()
    assert text.count(f"{MARKED}: a {MARK}.") == 1 and text.count(f">{MARKED}</li>") == 1
    assert set(pd.read_csv("report/statistics.csv")["system"]) == {"b", "c", "d"}
    pairs = pd.read_csv("report/pairs.csv").set_index(["system", "other"])
    assert [*pairs.index] == [("b", "c"), ("b", "d"), ("c", "d")]
    # All of seven subjects lose one capture of 20: p = 2 / 2 ** 7, times three pairs.
    assert pairs.loc[("b", "c"), "difference"] == pytest.approx(5)
    assert pairs.loc[("b", "c"), "p_holm"] == pytest.approx(6 / 2**7)
    assert pairs["gain"].tolist() == [7, 7, 7] and not pairs["lose"].any()
    answer = text[text.index('class="answer"') :]
    assert "a \N{DAGGER}" not in answer[: answer.index("</div>")]
    assert "<td>+5.0</td><td>+10.0</td>" in text and "<td>0.047</td>" in text  # the matrix


def test_reference_results_and_the_people_of_haart_are_told(quick, store):
    about = {"data": "haart", "synthetic": "false", "corpus_digest": HAART, "protocol_label": "LOSO (10 subjects)"}
    tracked_run(store, "mine · touch", with_hits([18] * 10), **about)
    tracked_run(store, "other", with_hits([16] * 10), **about)
    report(store)
    text, _ = read()
    assert text.count(f">{escape(DESIGNED)}</li>") == 2  # under the runs and under the statistics
    rows = pd.read_csv("report/statistics.csv").set_index("system")
    table = pd.read_csv("report/comparison.csv").set_index("system")
    assert "reflex (reference)" in rows.index and (table["source"] == "reference").sum() == 8
    assert table["p_holm"].to_dict() == pytest.approx(rows["p_holm"].to_dict(), nan_ok=True)


def test_only_incomplete_runs_still_make_a_report(quick, store):
    tracked_run(store, "a", made_up(4), failed=1)
    report(store)
    assert "no complete run to compare" in read()[0]


def test_folds_of_several_subjects_are_corrected_by_fold(quick, store):
    for i in range(2):
        tracked_run(
            store,
            f"s{i}",
            made_up(8, seed=i, skill=0.8 - 0.3 * i, folds=4),
            protocol="groupkfold[folds=4]",
            protocol_label="4-fold by subject",
        )
    report(store)
    row = pd.read_csv("report/statistics.csv").iloc[1]
    assert np.isfinite(row["nb_low"]) and row["nb_low"] != row["low"]


def test_figures_of_an_earlier_report_go_and_other_files_stay(quick, store):
    tracked_run(store, "a", made_up(3))
    Path("report/figures").mkdir(parents=True)
    Path("report/figures/9-old-speed.png").touch()
    Path("report/figures/mine.png").touch()
    report(store)
    assert not Path("report/figures/9-old-speed.png").exists() and Path("report/figures/mine.png").exists()


def test_a_report_that_is_cut_off_leaves_the_earlier_one(quick, store, monkeypatch):
    def found():
        return {p: p.read_bytes() for p in Path("report").rglob("*") if p.is_file()}

    tracked_run(store, "a", made_up(3))
    report(store)
    before = found()
    tracked_run(store, "b", made_up(3, seed=1))

    def cut(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(page, "page", cut)
        with pytest.raises(KeyboardInterrupt):
            report(store)
    assert found() == before
    left = Path("report", f".{socket.gethostname()}-{2**22 + 1}-abc")  # of a process that was killed; no PID is so high
    left.mkdir()
    report(store)
    assert found() != before and not left.exists()


def test_one_line_where_nothing_is_tracked_or_nothing_can_be_written(quick, store, capsys):
    with pytest.raises(InputError, match="no scored run"):
        page.write_report(store, Path("report"))
    tracked_run(store, "a", made_up(3))
    Path("taken").touch()
    with pytest.raises(InputError, match="cannot be written"):
        page.write_report(store, Path("taken"))
    assert main(["report", "out=there"]) == 0 and "there/index.html" in capsys.readouterr().out


def test_corpora_of_one_name_are_told_apart(store):
    for digest in ("1" * 64, "2" * 64):
        tracked_run(store, "a", made_up(3), corpus_digest=digest)
    groups = set(with_groups(tracked(store))["group"])
    assert groups == {f"synth (synthetic), all, LOSO (3 subjects), corpus {d * 8}" for d in "12"}


def test_a_newer_run_with_failed_folds_hides_no_complete_one(store):
    table = made_up()
    whole = tracked_run(store, "a", table)
    tracked_run(store, "a", table, failed=1)
    assert tracked(store)["run_id"].tolist() == [whole]
    newer = tracked_run(store, "a", table)
    assert tracked(store)["run_id"].tolist() == [newer]


def test_seeds_are_in_the_order_of_numbers(store):
    for seed in (10, 9, 100):
        tracked_run(store, "a", made_up(3), seed=seed)
    assert comparison(store, tracked(store), published())["seed"].tolist() == ["9", "10", "100"]


def test_published_numbers_stand_beside_the_runs_they_belong_to(store):
    haart = {"data": "haart", "synthetic": "false", "protocol": "challenge"}
    tracked_run(store, "ta2015_rf", made_up(3), **haart)
    tracked_run(store, "ta2015_rf", made_up(3), **haart | {"data": "synth", "synthetic": "true"})
    table = comparison(store, tracked(store), published()).set_index("data")
    assert table.loc["haart", "published"] == "70.91 (capture, ta2015-haart-test)"
    assert table.loc["synth (synthetic)", "published"] == ""


def test_numbers_on_corpora_that_nothing_is_tracked_on_wait_behind_a_switch(quick, store):
    for corpora, hidden in ((["haart"], {"CoST"}), (["cost"], set())):
        for data in corpora:
            tracked_run(store, "ta2015_rf", made_up(7), data=data, synthetic="false", protocol="challenge")
        report(store)
        text, _ = read()
        groups = re.findall(r'<tbody( class="away")?>(?:\s*)<tr class="group"><th[^>]*><span>(CoST|HAART): ', text)
        assert {name for away, name in groups if away} == hidden and {name for _, name in groups} == {"CoST", "HAART"}
        assert ('type="checkbox"' in text) == bool(hidden)
    assert "2 of our results stand beside a published number" in text


def test_the_command_of_a_run_is_what_was_tracked():
    told = {
        "touchbench.command": "stress",
        "touchbench.arguments": '{"data": "haart", "where": "variant == \'rough\'"}',
    }
    assert command(told) == """bench stress data=haart 'where=variant == '"'"'rough'"'"''"""
    assert command({"system": "svm · jung54", "touchbench.arguments": np.nan}) == "-"  # before it was tracked


def test_front_by_a_plain_loop():
    rng = np.random.default_rng(0)
    cost, accuracy = rng.integers(1, 6, 40).astype(float), rng.integers(50, 60, 40).astype(float)
    cost[3] = np.nan
    beaten = [
        any(cost[j] <= c and accuracy[j] >= a and (cost[j] < c or accuracy[j] > a) for j in range(40))
        for c, a in zip(cost, accuracy, strict=True)
    ]
    expected = {(c, a) for c, a, b in zip(cost, accuracy, beaten, strict=True) if not b and np.isfinite(c)}
    found = speed.front(cost, accuracy)
    assert {(cost[i], accuracy[i]) for i in found} == expected and (np.diff(cost[found]) > 0).all()


def test_names_keep_apart_and_inside():
    places = spread(np.array([1.0, 1.0, 1.1, 5, 9.9]), 0.8, 0.4, 9.6)
    assert np.diff(places).min() >= 0.8 - 1e-9 and places.min() >= 0.4 and places.max() <= 9.6
    assert spread(np.array([2.0, 5.0]), 1, 0, 10) == pytest.approx([2, 5])


def test_calibration_by_a_plain_loop():
    table = made_up(4, windows=3, seed=2)
    bins, error = details.calibration(table)
    gaps = {}
    for _, part in table.groupby("capture"):
        mean = part.filter(like="p_").mean()
        hit = mean.idxmax()[2:] == part["true"].iloc[0]
        gaps.setdefault(min(int(mean.max() * 10), 9), []).append((mean.max(), hit))
    expected = sum(abs(sum(c for c, _ in v) - sum(h for _, h in v)) for v in gaps.values()) / table["capture"].nunique()
    assert error == pytest.approx(expected) and len(bins) == len(gaps) and bins["n"].sum() == table["capture"].nunique()
    assert details.calibration(made_up(2, hard=True)) is None


def test_recall_by_gesture_and_its_interval():
    labelled = pd.DataFrame({"subject": list("aabb"), "true": ["x", "y", "x", "x"], "predicted": ["x", "x", "y", "x"]})
    found = details.recall_interval(labelled, ["x", "y", "z"])
    assert found.loc["x", "recall"] == pytest.approx(200 / 3) and found.loc["y", "recall"] == 0
    assert (found.loc["x", "low"], found.loc["x", "high"]) == (50, 100) and np.isnan(found.loc["z"]).all()


def typed(frames):
    """What is tracked of a network's arguments."""
    given = {"model": "cnn85", "model.epochs": "2"} | ({"model.frames": str(frames)} if frames != 85 else {})
    return {"touchbench.command": "run", "touchbench.arguments": json.dumps(given)}


def test_lengths_of_windows_in_frames_and_milliseconds(store):
    for frames, system in ((10, "cnn85[epochs=2, frames=10]"), (85, "cnn85[epochs=2]")):
        tracked_run(store, system, made_up(4, windows=2), **{"model.frames": frames}, **typed(frames))
    found = curves.lengths(store, tracked(store))
    assert list(found) == ["cnn85[epochs=2]"]
    assert found["cnn85[epochs=2]"]["ms"].tolist() == pytest.approx([200, 1700])  # at 50 frames a second


def test_markup_in_names_is_text():
    assert layout.md_escape("a|b *c* [d](e) <f>\ng") == r"a\|b \*c\* \[d\](e) \<f\> g"
    block = layout.Table(pd.DataFrame({"a": ["<b>", "x|`y`"]}), "c", code=("a",))
    assert '<th scope="row"><code>&lt;b&gt;</code></th>' in layout.page([layout.Heading("t", 1), block], "t")
    assert r"`` x\|`y` ``" in layout.markdown([block], Path("."))
    named = layout.Table(pd.DataFrame({"<img src=x>": ["1"], "a|b": ["2"]}), "c")
    assert layout.markdown([named], Path(".")).splitlines()[2] == r"| \<img src=x\> | a\|b |"
