"""The report as a whole: its numbers by hand, and a page that is complete and loads nothing."""

import base64
import gzip
import hashlib
import html
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bench
from bench.cli import main
from bench.commands import printing
from bench.errors import InputError
from bench.ground.registry import load_views
from bench.reading.frame import group_results
from bench.reports import page
from bench.reports.chart import chart_points
from bench.reports.comparison import load_published
from bench.reports.live import page_data
from bench.reports.summary import summarise_group
from bench.values.measures import all_costs
from bench.values.result import BATCH_MARK, BATCH_TAG
from tests.reading.results import (
    HAART,
    make_predictions,
    make_replay_run,
    make_run,
    make_stress_run,
    predictions_with_hits,
)
from tests.reports.store import keep, tracked_run

HOSTILE = 'svm[x=<script>alert(1)</script>|"&*_] · `a`'


def summarise(runs, budgets=None):
    (name, members), *_ = group_results(runs).items()
    return summarise_group(name, members, runs, budgets or {})


class Parsed(HTMLParser):
    """What a page would fetch, its text, its ids, and tags that are never closed."""

    def __init__(self, text):
        super().__init__()
        self.loaded, self.open, self.words, self.ids, self.scripts = [], [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.ids += [found["id"]] if "id" in found else []
        self.scripts += [found.get("type", "code")] * (tag == "script")
        self.loaded += [
            found[k] for k in ("src", "srcset", "data", "poster", "action") if k in found
        ]
        self.loaded += [
            found[k] for k in ("href", "xlink:href") if k in found and found[k][0] != "#"
        ]
        if tag not in (
            "meta",
            "br",
            "img",
            "input",
            "thead",
            "tbody",
            "tr",
            "th",
            "td",
        ):  # the last end by themselves
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.handle_endtag(tag)

    def handle_endtag(self, tag):
        if tag in self.open:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_the_page_loads_nothing_is_whole_and_names_are_text(store, quick):
    tracked_run(store, "svm · jung54", make_predictions(10), **HAART)
    tracked_run(store, "batchy", predictions_with_hits([19] * 10), **HAART, **{BATCH_TAG: "true"})
    tracked_run(store, "cut", make_predictions(8), failed=2, **HAART)
    tracked_run(store, HOSTILE, make_predictions(7), subset="variant == 'rough'")
    keep(
        store,
        make_stress_run("svm", 0.6, {"noise": 0.1, "shift": 0.234}, {"half_margin.shift": 2.25}),
    )
    page.write_report(store, Path("report"), {"flash": 50.0})
    text = Path("report/index.html").read_text(encoding="utf-8")
    parsed = Parsed(text)
    assert not parsed.open and not parsed.loaded and len(set(parsed.ids)) == len(parsed.ids)
    assert {link for link in re.findall(r'href="#([^"]+)"', text)} <= set(parsed.ids)
    assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:\"" in text
    code = Path(page.__file__).with_name("page.js").read_text(encoding="utf-8")
    assert {*parsed.scripts} == {"code", "text/plain"} and parsed.scripts.count("code") == 1
    digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
    assert (
        f"script-src 'sha256-{digest}'; default-src" in text and f"<script>{code}</script>" in text
    )
    assert len(code.splitlines()) <= 250
    words = " ".join(" ".join(parsed.words).split())
    assert HOSTILE in words
    for row in load_published().itertuples():
        assert " ".join(row.classifier.split()) in words and row.reference in words
    for table in re.findall(r"(?:^\|.*\n)+", Path("report/comparison.md").read_text(), re.M):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1
    warnings = " ".join(re.findall(r'<p class="warning">(.*?)</p>', text, re.DOTALL))
    assert all(fact in warnings for fact in ("(synthetic)", "cut", f"batchy {BATCH_MARK}"))


def test_the_table_of_systems_by_hand():
    """Each of 8 people loses a capture of 20 with b (p = 2 / 2 ** 8), every other one with c."""
    hits = {"a": [15] * 8, "b": [14] * 8, "c": [14, 15] * 4}
    runs = [
        make_run(name, predictions_with_hits(each), cost=1.0 + i)
        for i, (name, each) in enumerate(hits.items())
    ]
    texts = pd.DataFrame(summarise(runs).table.texts)
    assert [name.split()[0] for name in texts["system"]] == ["a", "c", "b"]
    assert texts["difference"].tolist() == ["-", "-2.5", "-5.0"]
    assert texts["test"].tolist() == ["reference", "n.s.", "0.016"]  # two tests, 2 * 2 / 2 ** 8
    assert texts["rank"].tolist() == ["1-2 ≈", "1-3 ≈", "2-3"]
    assert texts["flash kB"].tolist() == ["4", "12", "8"]
    five = [make_run(name, predictions_with_hits(each[:5])) for name, each in hits.items()]
    texts = pd.DataFrame(summarise(five).table.texts)
    assert {*texts["test"]} == {"reference", "too few subjects"} and {*texts["rank"]} == {"1-3 ≈"}


def test_numbers_for_the_script_by_hand():
    """Two seeds of a, whose mean stands above them; its captures are those of the lowest seed."""
    runs = [
        make_run("a", predictions_with_hits([15] * 8), seed=1),
        make_run("a", predictions_with_hits([13] * 8), seed=0, cost=3.0),
        make_run("b", predictions_with_hits(range(10, 18))),
    ]
    text = page_data(summarise(runs), {"a": "rf", "b": "mine.py:B"})
    data = json.loads(gzip.decompress(base64.b64decode(text)))
    heads = [column["name"] for column in data["columns"]]
    cells, seeds = (dict(zip(heads, data[name], strict=True)) for name in ("cells", "seeds"))
    assert data["name"] == ["a", "b"] and data["family"] == ["features", "own"]
    assert data["counts"] == [2, 0] and len(cells["system"]) == 2
    assert seeds["system"] == ["seed 0", "seed 1"] and seeds["flash kB"] == ["12", "4"]
    accuracies = (*seeds["accuracy % [95 %]"], cells["accuracy % [95 %]"][0])
    assert [words.split()[0] for words in accuracies] == ["65.0", "75.0", "70.0"]
    assert cells["flash kB"][0] == "8" and data["people"] == [*"12345678"]
    assert [each[0] for each in data["scores"]] == [70.0] * 8
    (pair,) = data["pairs"]  # differences from -15 to 20 in steps of 5
    assert pair[:2] == [0, 1] and pair[2] < 0 < pair[3] and 0.05 < pair[4] <= 1
    assert data["hits"][0].count("1") == 13 * 8
    table = runs[1].tables["predictions"].sort_values("capture")
    assert [data["gestures"][i] for i in data["true"]] == table["true"].tolist()
    assert np.cumsum(data["captures"]).tolist() == table["capture"].tolist()


def test_a_report_that_is_cut_off_leaves_the_earlier_one(quick, store, monkeypatch):
    def files():
        return {p: p.read_bytes() for p in Path("report").rglob("*") if p.is_file()}

    with pytest.raises(InputError):  # nothing is tracked
        page.write_report(store, Path("report"))
    tracked_run(store, "a", make_predictions(3))
    Path("report/figures").mkdir(parents=True)
    for name in ("9-old-speed.png", "mine.png"):
        Path("report/figures", name).touch()
    page.write_report(store, Path("report"))
    assert {"9-old-speed.png", "mine.png"} & {p.name for p in files()} == {"mine.png"}
    before = files()
    tracked_run(store, "b", make_predictions(3, seed=1))
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(page, "comparison_latex", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
        page.write_report(store, Path("report"))
    assert files() == before
    left = Path("report", ".touchbench-1-abc")  # of a process that was killed
    left.mkdir()
    page.write_report(store, Path("report"))
    assert files() != before and not left.exists()


def test_p_values_compare_with_the_system_that_was_asked_for(quick, store):
    for i, name in enumerate("abc"):
        tracked_run(store, name, predictions_with_hits(range(12 - i, 18 - i)))
    page.write_report(store, Path("report"), against="b")
    rows = pd.read_csv("report/statistics.csv").set_index("system")
    assert rows["difference"].tolist() == pytest.approx([5, 0, -5]) and np.isnan(rows.loc["b", "p"])
    p_values = rows["p_holm"].dropna().tolist()
    assert p_values == pytest.approx([4 / 2**6] * 2)  # six of one sign, two tests
    pairs = pd.read_csv("report/pairs.csv").set_index(["system", "other"])
    assert pairs.loc[("a", "b"), "p_holm"] == pytest.approx(6 / 2**6)
    assert pairs["gain"].tolist() == [6] * 3
    text = Path("report/index.html").read_text()
    assert "every system against b" in text and "was selected by these results" not in text
    with pytest.raises(InputError, match="against=d: no complete run of this system is stored"):
        page.write_report(store, Path("report"), against="d")


def test_all_groups_have_statistics_and_figures_in_the_width_of_a_paper(store, capsys):
    """Sizes are read from the PDF; a figure of one seed of several names it."""
    for i, protocol in enumerate(("kfold", "loso", "groupkfold", "challenge", "within")):
        tags = {"protocol": protocol, "protocol_label": protocol.upper()}
        tags |= {"mixes_subjects": "true"} if protocol in ("kfold", "within") else {}
        tags |= {"official_split": "true"} if protocol == "challenge" else {}
        tags |= {"protocol.seed": 0} if protocol not in ("loso", "within") else {}
        people = 3 if protocol == "challenge" else 6
        for seed in (0, 1) if i < 2 else (0,):
            tracked_run(store, "a", predictions_with_hits([12] * people), seed=seed, **tags)
        tracked_run(store, "b" * 30, predictions_with_hits([11] * people), **tags)
    page.write_report(store, Path("report"))
    table = pd.read_csv("report/statistics.csv")
    assert table["group"].nunique() == 5
    folder = Path("report/figures")
    papers = {path.name for path in folder.glob("*-paper.*")}
    assert {name.split("-")[0] for name in papers} == {*"12345"}
    assert {name[:-4] for name in papers if name.endswith("pdf")} == {
        name[:-4] for name in papers if name.endswith("svg")
    }
    order = [next(folder.glob(f"{i}-*-subjects.svg")).name.split("-")[4] for i in "123"]
    assert order == ["loso", "challenge", "groupkfold"]  # a declared split precedes random ones
    widths = {
        kind: float(re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ", path.read_bytes())[1]) / 72
        for kind in ("confusion", "gestures", "subjects", "speed-flash")
        for path in folder.glob(f"1-*-{kind}-paper.pdf")
    }
    expected = {"confusion": 3.3, "gestures": 3.3, "subjects": 6.9, "speed-flash": 3.3}
    assert widths == pytest.approx(expected)
    drawn = next(folder.glob("1-*-confusion-paper.svg")).read_text()
    assert "a, seed 0" in drawn and "predicted" in drawn and "true" in drawn
    assert "b" * 30 in next(folder.glob("1-*-speed-flash-paper.svg")).read_text()


def test_the_footnote_of_reflex_stands_wherever_it_is_compared_on_haart(quick, store, capsys):
    for name, hits in (("reflex", range(12, 18)), ("svm · jung54", range(11, 17))):
        arguments = json.dumps({"data": "haart", "model": name})
        tags = {"touchbench.command": "run", "touchbench.arguments": arguments}
        tracked_run(store, name, predictions_with_hits(hits), **HAART, **tags)
        keep(store, make_replay_run(name))
    words = "designed on seven of HAART's ten people"
    assert words in str(bench.choose(data="haart"))
    page.write_report(store, Path("report"))
    for name in ("comparison.tex", "comparison.md", "index.html"):
        text = html.unescape(Path("report", name).read_text())
        assert words in text.replace(r"\textquotesingle{}", "'"), name
    for name in ("comparison", "statistics", "pairs", "streaming"):
        rows = pd.read_csv(f"report/{name}.csv").fillna("").astype(str)
        others = rows.drop(columns=["note", "against"], errors="ignore")
        compared = others.agg(" ".join, axis=1).str.contains("reflex")
        assert rows["note"].str.contains(words).tolist() == compared.tolist(), name
    runs = [make_run("reflex", **HAART)]
    assert printing.print_results_and_failures(runs, [(load_views()["run"], runs)]) == 0
    assert words in capsys.readouterr().out
    assert words in repr(bench.compare("reflex", "svm · jung54"))


def test_one_subject_one_class_labels_only_folds_of_several_and_no_complete_run(quick, store):
    odd = [
        make_predictions(1),
        make_predictions(2, per_class=1, gestures=("only",)),
        make_predictions(3, hard=True),
        make_predictions(8, folds=4),
        make_predictions(4),
    ]
    for protocol, predictions in enumerate(odd):
        for i in (0, 1):
            tracked_run(
                store, f"s{i}", predictions, failed=protocol == 4, protocol_label=f"P{protocol}"
            )
    page.write_report(store, Path("report"))
    text = Path("report/index.html").read_text()
    assert not Parsed(text).open and "no complete run" in text
    rows = pd.read_csv("report/statistics.csv")
    of_folds = rows[rows["group"].str.contains("P3")]
    assert np.isfinite(of_folds["nb_low"].iloc[1]) and of_folds["nb_p"].iloc[1] == 1


def test_the_page_chooses_as_bench_choose_does_and_the_chart_marks_it(store, capsys):
    """Costs are 4, 40 and 400 kB; the last is far more accurate, unless a budget rules it out."""
    runs = []
    for i, system in enumerate(("svm", "rf", "ta2015_rf[trees=9]")):
        arguments = json.dumps({"data": "synth", "protocol": "loso", "model": system})
        tags = {"touchbench.command": "run", "touchbench.arguments": arguments}
        predictions = make_predictions(8, skill=0.3 + 0.25 * i, seed=i)
        runs.append(make_run(system, predictions, cost=10.0**i, **tags))
        keep(store, runs[-1])
    budgets = {"flash": 100.0, "worst_person": 0.0}
    for limits, system in (({}, "ta2015_rf[trees=9]"), (budgets, "rf")):
        summary = summarise(runs, limits)
        assert summary.choice.system == system in summary.lines[0]
        words = [all_costs()[key].format_budget(value) for key, value in limits.items()]
        command = " ".join(["bench choose data=synth where=all protocol=loso", *words])
        assert summary.command == command
        assert main([*command.split()[1:], "why=yes"]) == 0
        printed = capsys.readouterr().out
        assert all(line in printed for line in summary.lines)
    models = {r.system: r["model_name"] for r in runs}
    points = chart_points(summary, models, {*load_published()["system"]}).set_index("name")
    least = min(summary.choice.candidates.subjects.loc[summary.choice.chosen])
    assert points.loc[points["chosen"], "worst_person"].tolist() == pytest.approx([least])
    assert points[["chosen", "out", "kind", "flash"]].T.to_dict("list") == {
        "svm": [False, False, "other", 4.0],
        "rf": [True, False, "other", 40.0],
        "ta2015_rf[trees=9]": [False, True, "changed", 400.0],
    }
    other_version = make_run("svm", make_predictions(8), corpus_digest="e" * 64)
    assert summarise([*runs, other_version]).command == ""  # its words would mean both versions
