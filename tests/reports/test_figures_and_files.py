"""Figures show their numbers; the page of a corpus; CSV files hold no formulas."""

import csv
import re

import numpy as np
import pandas as pd

from bench.corpora.survey import Survey
from bench.measures import costs
from bench.reports import chart, corpus_page, figures
from bench.reports.comparison import command
from bench.table import write_sheet
from tests.conftest import random_corpus


def test_the_chart_marks_the_choice_budgets_and_what_they_rule_out(tmp_path):
    names = ["a<b", *(f"s{i}" for i in range(20))]
    points = pd.DataFrame({"name": names, "kind": "other", "verdict": "v", "chosen": False, "out": False})
    points = points.assign(accuracy=[90.0, *np.linspace(50, 80, 20)], low=[80.0, *[45.0] * 20], high=99.0)
    points = points.assign(flash=range(1, 22), worst_person=[0.0, *range(10, 30)], ram=np.nan)
    points.loc[0, "chosen"], points.loc[20, "out"] = True, True
    figure, caption = chart.cost_chart("g", points, costs()["flash"], 20.5, left=3)
    other, plain = chart.cost_chart("g", points, costs()["worst_person"])
    (flash,), (worst,) = figure.axes, other.axes
    assert chart.cost_chart("g", points, costs()["ram"]) is None and "Dashed" not in plain
    assert (flash.get_xscale(), worst.get_xscale()) == ("log", "linear") and worst.get_xlim()[0] < 0
    assert flash.get_ylim()[0] < 45 and flash.get_ylim()[1] > 99  # no interval is cut off
    assert {t.get_text() for t in flash.texts} == {"choice: a<b", "budget 20.5 kB"}  # the only one on the front
    assert [line.get_alpha() for line in flash.lines if line.get_gid()].count(0.35) == 1
    assert all(words in caption for words in ("Ring", "Dashed", "Pale", "3 less accurate"))
    figures.save(figure, tmp_path, "c", "g", caption)
    titles = re.findall("<title>(.*?)</title>", (tmp_path / "c.svg").read_text())
    assert len(titles) == 21 and "a&lt;b: 90.0 [80.0, 99.0] %, 1 kB; v" in titles
    few = chart.cost_chart("g", points[:16], costs()["flash"])[0].axes[0]
    assert len(few.texts) == 16


def test_the_page_of_a_corpus_is_whole_and_says_that_captures_are_synthetic(tmp_path, monkeypatch):
    kept = {}
    saved = corpus_page.save
    monkeypatch.setattr(
        corpus_page,
        "save",
        lambda figure, folder, name, *more: kept.update({name: figure}) or saved(figure, folder, name, *more),
    )
    corpus = random_corpus(subjects=2, per_class=2, info={"synthetic": True})
    found = Survey(corpus)
    paths = corpus_page.write(found, tmp_path)
    assert [p.name for p in paths] == [p.name for p in paths if p.stat().st_size] and len(paths) == 3
    text = (tmp_path / "index.html").read_text()
    assert text.count("not people") >= 7  # on top, of every table, of every figure
    panels = [ax.images[0].get_array() for ax in kept["pressure"].axes if ax.images]
    for gesture, panel in zip(found.gestures, panels, strict=True):
        np.testing.assert_allclose(panel, np.concatenate(list(corpus[corpus.gestures == gesture])).mean(axis=0))


def test_the_command_of_a_run_is_what_was_tracked():
    tags = {"touchbench.command": "stress", "touchbench.arguments": '{"data": "haart", "where": "v == \'rough\'"}'}
    assert command(tags) == """bench stress data=haart 'where=v == '"'"'rough'"'"''"""
    assert command({"system": "svm · jung54"}) == "-"  # of Python objects


def test_a_text_that_would_be_a_formula_is_led_by_an_apostrophe_and_numbers_stay(tmp_path):
    texts = ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3", "\t=1", "-a"]
    harmless = pd.DataFrame({"n": [-1.5, np.nan], "t": ["-1.5", "-"], "u": ["a=b", ""]})
    for name, table in (("formulas", pd.DataFrame([texts], columns=texts)), ("harmless", harmless)):
        write_sheet(table, tmp_path / f"{name}.csv")
    with (tmp_path / "formulas.csv").open(newline="") as f:
        assert list(csv.reader(f)) == [[f"'{text}" for text in texts]] * 2
    assert (tmp_path / "harmless.csv").read_text() == harmless.to_csv(index=False)


def test_a_figure_drawn_twice_is_the_same_file(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        figure, axes = figures.new_figure((3, 2))
        axes[0, 0].plot([1, 2], [3, 4], label="line")
        axes[0, 0].legend()
        figures.write_svg(figure, tmp_path / folder / "c.svg")
    assert (tmp_path / "a" / "c.svg").read_bytes() == (tmp_path / "b" / "c.svg").read_bytes()
