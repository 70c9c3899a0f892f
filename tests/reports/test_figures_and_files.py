"""Figures show their numbers; the page of a corpus; CSV files hold no formulas."""

import csv
import re
from xml.etree.ElementTree import fromstring

import numpy as np
import pandas as pd
import pytest

from bench.corpora.survey import Survey
from bench.reports import chart, corpus_page, figures
from bench.reports.embedded import embed_svg
from bench.values.measures import all_costs
from bench.values.table import write_sheet
from tests.conftest import random_corpus


def places(drawing):
    """Of each mark its place across in percent, by name."""
    found = re.findall(r' x="([\d.]+)%" y="[\d.]+"><title>.*?>([^<]*)</text></svg>', drawing)
    return {name: float(place) for place, name in found}


def test_the_chart_marks_the_choice_budgets_and_what_they_rule_out():
    names = ["a<b", *(f"s{i}" for i in range(20))]
    points = pd.DataFrame(
        {"name": names, "kind": "other", "verdict": "v", "chosen": False, "out": False}
    )
    points = points.assign(family=["networks", *["features"] * 19, "own"])
    points = points.assign(
        accuracy=[90.0, *np.linspace(50, 80, 20)], low=[80.0, *[45.0] * 20], high=99.0
    )
    points = points.assign(flash=range(1, 22), worst_person=[0.0, *range(10, 30)], ram=np.nan)
    points.loc[0, "chosen"], points.loc[20, "out"] = True, True
    flash, _ = chart.draw_cost_chart(
        "g", points, all_costs()["flash"], 20.5, omitted=3, best=("Zhou & Du", "CNN", 76.1)
    )
    worst, _ = chart.draw_cost_chart("g", points, all_costs()["worst_person"])
    assert chart.draw_cost_chart("g", points, all_costs()["ram"]) is None
    zero, _ = chart.draw_cost_chart("g", points.iloc[1:], all_costs()["worst_person"], 0.0)
    assert (
        float(re.search(r'<line x1="(.*?)%".*?b85c00', zero)[1]) == chart.LEFT
    )  # a budget of 0 is on the axis
    marks = {
        re.search(r">([^<]*)</text>", mark)[1]: mark
        for mark in re.findall('<svg class="mark.*?</svg>', flash)
    }
    assert (
        len(marks) == 21
        and "<title>a&lt;b: 90.0 [80.0, 99.0] %, 1 kB; v</title>" in marks["a&lt;b"]
    )
    classes = {name: {*mark.split('"')[1].split()} for name, mark in marks.items()}
    assert [name for name in marks if "named" in classes[name]] == [
        "a&lt;b"
    ]  # the only one on the front
    assert [name for name in marks if "out" in classes[name]] == ["s19"]
    assert [name for name, mark in marks.items() if 'class="ring"' in mark] == ["a&lt;b"]
    shapes = {
        re.search(r"<(circle r|path d)=\"(.*?)\"/><text", marks[name])[0]
        for name in ("a&lt;b", "s0", "s19")
    }
    assert len(shapes) == 3  # of three families
    assert "budget 20.5 kB" in flash and "published: Zhou &amp; Du, 76.1 %" in flash
    bars = re.findall(r'y="([\d.]+)"><title>.*?<line y1="([-\d.]+)" y2="([-\d.]+)"/>', flash)
    ends = [float(y) + float(shift) for y, *shifts in bars for shift in shifts]
    assert (
        chart.ABOVE < min(ends) and max(ends) < chart.ABOVE + chart.HEIGHT
    )  # no interval is cut off
    x, linear = places(flash), places(worst)
    low, high = x["a&lt;b"], x["s19"]
    assert (x["s2"] - low) / (high - low) == pytest.approx(
        np.log(4) / np.log(21), abs=0.002
    )  # a log axis
    low, high = linear["a&lt;b"], linear["s19"]
    assert (linear["s0"] - low) / (high - low) == pytest.approx(
        10 / 29, abs=0.002
    )  # a linear one, from a value of 0


def test_names_of_the_front_cover_neither_each_other_nor_points():
    points = pd.DataFrame(
        {"name": [f"system {i} · features" for i in range(5)], "kind": "other", "verdict": "v"}
    )
    points = points.assign(
        chosen=False,
        out=False,
        family="features",
        low=np.nan,
        high=np.nan,
        flash=[1, 2, 4, 8, 900.0],
    )
    drawing, caption = chart.draw_cost_chart(
        "g", points.assign(accuracy=[60, 70, 72, 80, 81.0]), all_costs()["flash"]
    )
    assert "interval" not in caption  # of too few subjects
    boxes, spots = [], []
    found = re.findall(
        r'x="([\d.]+)%" y="([\d.]+)"><title>.*?<text x="(-?\d+)" y="(-?\d+)"(.*?)>', drawing
    )
    for x, y, right, down, anchor in found:
        spots.append((float(x) * chart.NARROW / 100, float(y)))
        left = spots[-1][0] + float(right) - 7 * 19 * ("end" in anchor)
        boxes.append((left, left + 7 * 19, float(y) + int(down) - 10, float(y) + int(down) + 2))
    assert len(found) == 5
    for i, (left, right, top, bottom) in enumerate(boxes):
        assert not any(left < x < right and top < y < bottom for x, y in spots)
        assert all(right < a or b < left or bottom < c or d < top for a, b, c, d in boxes[:i])


def test_the_page_of_a_corpus_says_that_captures_are_synthetic_and_shows_mean_pressure(
    tmp_path, monkeypatch
):
    kept, saved = {}, corpus_page.save_figure
    keep = lambda figure, folder, name, *more: (
        kept.update({name: figure}) or saved(figure, folder, name, *more)
    )  # noqa: E731
    monkeypatch.setattr(corpus_page, "save_figure", keep)
    corpus = random_corpus(subjects=2, per_class=2, info={"synthetic": True})
    corpus_page.write_page(found := Survey(corpus), tmp_path)
    assert (tmp_path / "index.html").read_text().count(
        "not people"
    ) >= 6  # on top, of every table, of every figure
    panels = [ax.images[0].get_array() for ax in kept["captures"].axes[:: corpus_page.FILMED + 2]]
    for gesture, panel in zip(found.gestures, panels, strict=True):
        np.testing.assert_allclose(
            panel, np.concatenate(list(corpus[corpus.gestures == gesture])).mean(axis=0)
        )


def test_a_text_that_would_be_a_formula_is_led_by_an_apostrophe_and_numbers_stay(tmp_path):
    texts = ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3", "\t=1", "-a"]
    harmless = pd.DataFrame({"n": [-1.5, np.nan], "t": ["-1.5", "-"], "u": ["a=b", ""]})
    for name, table in (("formulas", pd.DataFrame([texts], columns=texts)), ("harmless", harmless)):
        write_sheet(table, tmp_path / f"{name}.csv")
    with (tmp_path / "formulas.csv").open(newline="") as f:
        assert list(csv.reader(f)) == [[f"'{text}" for text in texts]] * 2
    assert (tmp_path / "harmless.csv").read_text() == harmless.to_csv(index=False)


def corners(root):
    """Colour and place of each point of the lines and markers of an SVG, or of its shortened form."""
    named = {}
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
        if element.get("id"):
            named[f"#{element.get('id')}"] = element
    found = []
    for element in root.iter():
        link = next((v for k, v in element.attrib.items() if k.endswith("href")), "")
        path = named.get(link, element)
        if path.tag != "path" or (element.get("id") and f"#{element.get('id')}" in named):
            continue
        look = f"{element.get('style', '')}; {path.get('style', '')}"
        colour = re.findall(r"(?:stroke|fill): (#\w+)", look)
        x, y = (float(element.get(name, "0")) if link else 0.0 for name in "xy")
        at = [0.0, 0.0]
        for letter, rest in re.findall("([MLHVCQ])([^MLHVCQz]*)", path.get("d")):
            numbers = [float(n) for n in rest.split()]
            at = (
                [numbers[0], at[1]]
                if letter == "H"
                else [at[0], numbers[0]]
                if letter == "V"
                else numbers[-2:]
            )
            found.append((colour[-1], at[0] + x, at[1] + y))
    return sorted(point for point in found if point[0] != "#ffffff")


def test_a_drawing_on_the_page_has_the_points_and_words_of_its_file(tmp_path):
    figure, axes = figures.new_figure((5, 3), title="a <b> & $1$")
    axes[0, 0].pcolormesh(np.arange(9.0).reshape(3, 3), cmap="Blues")
    for marker in ("|", "o", "^"):
        axes[0, 0].errorbar([0.5, 1.234567, 2], [1, 2, 0.3], yerr=0.25, fmt=marker, capsize=2)
    figures.write_svg(figure, tmp_path / "c.svg")
    text, styles = (tmp_path / "c.svg").read_text(encoding="utf-8"), {}
    short = embed_svg(text, 'all "of" it', styles)
    assert len(short) + len("".join(styles)) < len(text) / 2
    whole, root = fromstring(text), fromstring(short)
    for element in root.iter():  # its classes as styles again
        element.set(
            "style",
            next((style for style, name in styles.items() if name == element.get("class")), ""),
        )
    assert [e.text for e in root.iter("text")] == [
        e.text for e in whole.iter() if e.tag.endswith("}text")
    ]
    assert root.get("aria-label") == 'all "of" it' and root.get("viewBox") == whole.get("viewBox")
    before, after = corners(whole), corners(root)
    assert [point[0] for point in before] == [point[0] for point in after] and len(before) > 60
    for colour in {point[0] for point in before}:
        ours, theirs = (
            np.array([p[1:] for p in points if p[0] == colour]) for points in (after, before)
        )
        assert max(np.hypot(*(theirs - place).T).min() for place in ours) < 0.15
        assert max(np.hypot(*(ours - place).T).min() for place in theirs) < 0.15
