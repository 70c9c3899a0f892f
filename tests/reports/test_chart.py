"""The chart of accuracy against a cost."""

import re

import numpy as np
import pandas as pd
import pytest

from bench.reports import chart
from bench.values.measures import all_costs


def places(drawing):
    """Of each mark its place across in percent, by name."""
    found = re.findall(r' x="([\d.]+)%" y="[\d.]+"><title>.*?>([^<]*)</text></svg>', drawing)
    return {name: float(place) for place, name in found}


def relative_place(drawing, first, name, last):
    """Place of a mark from 0 to 1 between two others."""
    x = places(drawing)
    return (x[name] - x[first]) / (x[last] - x[first])


@pytest.fixture
def points():
    """A network that is cheapest and best, 19 classifiers on features, and an own system."""
    table = pd.DataFrame({"name": ["a<b", *(f"s{i}" for i in range(20))], "kind": "other"})
    table["accuracy"] = [90.0, *np.linspace(50, 80, 20)]
    table["family"] = ["networks", *["features"] * 19, "own"]
    table = table.assign(low=[80.0, *[45.0] * 20], high=99.0, ram=np.nan, flash=range(1, 22))
    table["worst_person"] = [0.0, *range(10, 30)]
    return table.assign(verdict="v", chosen=table.index == 0, out=table.index == 20)


def test_marks_show_the_choice_budgets_and_what_these_rule_out(points):
    best = ("Zhou & Du", "CNN", 76.1)
    flash, _ = chart.draw_cost_chart("g", points, all_costs()["flash"], 20.5, omitted=3, best=best)
    drawn = re.findall('<svg class="mark.*?</svg>', flash)
    marks = {re.search(r">([^<]*)</text>", mark)[1]: mark for mark in drawn}
    assert len(marks) == 21
    assert "<title>a&lt;b: 90.0 [80.0, 99.0] %, 1 kB; v</title>" in marks["a&lt;b"]
    classes = {name: {*mark.split('"')[1].split()} for name, mark in marks.items()}
    assert [name for name in marks if "named" in classes[name]] == ["a&lt;b"]  # alone on the front
    assert [name for name in marks if "out" in classes[name]] == ["s19"]
    assert [name for name, mark in marks.items() if 'class="ring"' in mark] == ["a&lt;b"]
    families = (marks[name] for name in ("a&lt;b", "s0", "s19"))
    shapes = {re.search(r"<(circle r|path d)=\"(.*?)\"/><text", mark)[0] for mark in families}
    assert len(shapes) == 3
    assert "budget 20.5 kB" in flash and "published: Zhou &amp; Du, 76.1 %" in flash
    bars = re.findall(r'y="([\d.]+)"><title>.*?<line y1="([-\d.]+)" y2="([-\d.]+)"/>', flash)
    ends = [float(y) + float(shift) for y, *shifts in bars for shift in shifts]
    assert chart.ABOVE < min(ends) and max(ends) < chart.ABOVE + chart.HEIGHT  # none is cut off


def test_axes_are_logarithmic_or_linear_and_have_the_budget(points):
    costs = all_costs()
    flash, _ = chart.draw_cost_chart("g", points, costs["flash"])
    worst, _ = chart.draw_cost_chart("g", points, costs["worst_person"])
    assert chart.draw_cost_chart("g", points, costs["ram"]) is None
    log = relative_place(flash, "a&lt;b", "s2", "s19")
    assert log == pytest.approx(np.log(4) / np.log(21), abs=0.002)
    assert relative_place(worst, "a&lt;b", "s0", "s19") == pytest.approx(10 / 29, abs=0.002)
    zero, _ = chart.draw_cost_chart("g", points.iloc[1:], costs["worst_person"], 0.0)
    assert float(re.search(r'<line x1="(.*?)%".*?b85c00', zero)[1]) == chart.LEFT


def test_names_of_the_front_cover_neither_each_other_nor_points():
    names = [f"system {i} · features" for i in range(5)]
    points = pd.DataFrame({"name": names, "flash": [1, 2, 4, 8, 900.0]})
    points = points.assign(accuracy=[60, 70, 72, 80, 81.0], low=np.nan, high=np.nan, kind="other")
    points = points.assign(family="features", verdict="v", chosen=False, out=False)
    drawing, caption = chart.draw_cost_chart("g", points, all_costs()["flash"])
    assert "interval" not in caption  # of too few subjects
    mark = r'x="([\d.]+)%" y="([\d.]+)"><title>.*?<text x="(-?\d+)" y="(-?\d+)"(.*?)>'
    boxes, spots = [], []
    for x, y, right, down, anchor in re.findall(mark, drawing):
        spots.append((float(x) * chart.NARROW / 100, float(y)))
        left = spots[-1][0] + float(right) - 7 * 19 * ("end" in anchor)
        boxes.append((left, left + 7 * 19, float(y) + int(down) - 10, float(y) + int(down) + 2))
    assert len(boxes) == 5
    for i, (left, right, top, bottom) in enumerate(boxes):
        assert not any(left < x < right and top < y < bottom for x, y in spots)
        assert all(right < a or b < left or bottom < c or d < top for a, b, c, d in boxes[:i])
