"""Figures show their numbers; the page of a corpus; CSV files hold no formulas."""

import csv
import re

import numpy as np
import pandas as pd
import pytest

from bench.corpora.survey import Survey
from bench.measures import costs
from bench.reports import chart, corpus_page, figures
from bench.reports.comparison import command
from bench.table import write_sheet
from tests.conftest import random_corpus


def test_the_chart_marks_the_choice_budgets_and_what_they_rule_out(tmp_path):
    names = ["a<b", *(f"s{i}" for i in range(20))]
    points = pd.DataFrame({"name": names, "kind": "other", "verdict": "v", "chosen": False, "out": False})
    points = points.assign(family=["networks", *["features"] * 19, "own"])
    points = points.assign(accuracy=[90.0, *np.linspace(50, 80, 20)], low=[80.0, *[45.0] * 20], high=99.0)
    points = points.assign(flash=range(1, 22), worst_person=[0.0, *range(10, 30)], ram=np.nan)
    points.loc[0, "chosen"], points.loc[20, "out"] = True, True
    flash, caption = chart.cost_chart("g", points, costs()["flash"], 20.5, left=3, best=("Zhou & Du", "CNN", 76.1))
    worst, plain = chart.cost_chart("g", points, costs()["worst_person"])
    assert chart.cost_chart("g", points, costs()["ram"]) is None and "Dashed" not in plain
    assert all(words in caption for words in ("Ring", "Dashed", "Dotted", "Pale", "3 less accurate", "networks", "own"))
    marks = {re.search(r">([^<]*)</text>", mark)[1]: mark for mark in re.findall('<svg class="mark.*?</svg>', flash)}
    assert len(marks) == 21 and "<title>a&lt;b: 90.0 [80.0, 99.0] %, 1 kB; v</title>" in marks["a&lt;b"]
    assert [name for name, mark in marks.items() if " named" in mark.split('"')[1]] == [
        "a&lt;b"
    ]  # the only one on the front
    assert [name for name, mark in marks.items() if " out" in mark.split('"')[1]] == ["s19"]
    assert [name for name, mark in marks.items() if 'class="ring"' in mark] == ["a&lt;b"]
    shapes = {
        name: re.search(r"<(circle r|path d)=\"(.*?)\"/><text", marks[name])[0] for name in ("a&lt;b", "s0", "s19")
    }
    assert len({*shapes.values()}) == 3  # of three families
    assert "budget 20.5 kB" in flash and "published: Zhou &amp; Du, 76.1 %" in flash
    bars = re.findall(r'y="([\d.]+)"><title>.*?<line y1="([-\d.]+)" y2="([-\d.]+)"/>', flash)
    ends = [float(y) + float(shift) for y, *shifts in bars for shift in shifts]
    assert chart.ABOVE < min(ends) and max(ends) < chart.ABOVE + chart.HEIGHT  # no interval is cut off
    x = {name: float(re.search(r' x="([\d.]+)%"', mark)[1]) for name, mark in marks.items()}
    low, high = x["a&lt;b"], x["s19"]
    assert (x["s2"] - low) / (high - low) == pytest.approx(np.log(4) / np.log(21), abs=0.002)  # a log axis
    linear = {
        name: float(place)
        for place, name in re.findall(r' x="([\d.]+)%" y="[\d.]+"><title>.*?>([^<]*)</text></svg>', worst)
    }
    share = (linear["s0"] - linear["a&lt;b"]) / (linear["s19"] - linear["a&lt;b"])
    assert share == pytest.approx(10 / 29, abs=0.002)  # a linear one, from a value of 0


def test_names_of_the_front_cover_neither_each_other_nor_points():
    points = pd.DataFrame({"name": [f"system {i} · features" for i in range(5)], "kind": "other", "verdict": "v"})
    points = points.assign(
        chosen=False, out=False, family="features", low=np.nan, high=np.nan, flash=[1, 2, 4, 8, 900.0]
    )
    drawing, _ = chart.cost_chart("g", points.assign(accuracy=[60, 70, 72, 80, 81.0]), costs()["flash"])
    boxes, spots = [], []
    found = re.findall(r'x="([\d.]+)%" y="([\d.]+)"><title>.*?<text x="(-?\d+)" y="(-?\d+)"(.*?)>', drawing)
    for x, y, right, down, anchor in found:
        spots.append((float(x) * chart.NARROW / 100, float(y)))
        left = spots[-1][0] + float(right) - 7 * 19 * ("end" in anchor)
        boxes.append((left, left + 7 * 19, float(y) + int(down) - 10, float(y) + int(down) + 2))
    assert len(found) == 5
    for i, (left, right, top, bottom) in enumerate(boxes):
        assert not any(left < x < right and top < y < bottom for x, y in spots)
        assert all(right < a or b < left or bottom < c or d < top for a, b, c, d in boxes[:i])


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
