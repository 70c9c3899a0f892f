"""Figures show their numbers and keep names apart; the page of a corpus; CSV files hold no formulas."""

import csv
import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from bench.corpora.survey import survey
from bench.measures import costs
from bench.pareto import staircase
from bench.reports import chart, corpus_page, details, figures
from bench.reports.comparison import command
from bench.reports.layout import inline_svg
from bench.table import write_sheet
from tests.conftest import random_corpus
from tests.reports.store import made_up

NAN = float("nan")


def test_front_by_a_plain_loop():
    rng = np.random.default_rng(0)
    cost, accuracy = rng.integers(1, 6, 40).astype(float), rng.integers(50, 60, 40).astype(float)
    cost[3] = np.nan
    beaten = [
        any(cost[j] <= c and accuracy[j] >= a and (cost[j] < c or accuracy[j] > a) for j in range(40))
        for c, a in zip(cost, accuracy, strict=True)
    ]
    expected = {(c, a) for c, a, b in zip(cost, accuracy, beaten, strict=True) if not b and np.isfinite(c)}
    on = staircase(accuracy, cost)
    assert {(cost[i], accuracy[i]) for i in on} == expected and (np.diff(cost[on]) > 0).all()


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


def test_a_drawing_in_a_page_is_the_same_in_fewer_words(tmp_path):
    """Marks, texts and their places, by a plain parse of both."""
    points = pd.DataFrame({"name": ["a", "b"], "kind": "other", "verdict": "v", "chosen": False, "out": False})
    points = points.assign(accuracy=[60.0, 70.04], low=[50.0, 60.0], high=80.0, flash=[1.04, 20.0])
    figure, caption = chart.cost_chart("g", points, costs()["flash"])
    picture = figures.save(figure, tmp_path, "c", "g", caption)
    before = ElementTree.fromstring(picture.path.read_text())
    text = str(inline_svg(picture, 3))
    after = ElementTree.fromstring(text)

    def seen(root):
        tags = [(element.tag.rpartition("}")[2], element) for element in root.iter()]
        words = [(tag, "".join(e.itertext()).strip()) for tag, e in tags if tag in ("text", "title")]
        places = [float(e.get(k)) for tag, e in tags if tag in ("use", "text") for k in "xy" if e.get(k)]
        return (
            [w for w in words if "matplotlib" not in w[1].lower()],
            len([t for t, _ in tags if t in ("path", "use")]),
            places,
        )

    (words, marks, places), (same_words, same_marks, same_places) = seen(before), seen(after)
    assert same_words == words and same_marks == marks and same_places == pytest.approx(places, abs=0.1)
    assert {i for i in re.findall(r' id="([^"]+)"', text)} >= {*re.findall(r'(?:url\(|href=")#([^)"]+)', text)}
    assert all(i.startswith("f3-") for i in re.findall(r' id="([^"]+)"', text))
    assert len(text) < 0.5 * picture.path.stat().st_size


def test_calibration_by_a_plain_loop():
    table = made_up(4, windows=3, seed=2)
    bins, error = details.calibration(table)
    gaps = {}
    for _, part in table.groupby("capture"):
        mean = part.filter(like="p_").mean()
        hit = mean.idxmax()[2:] == part["true"].iloc[0]
        gaps.setdefault(min(int(mean.max() * 10), 9), []).append((mean.max(), hit))
    captures = table["capture"].nunique()
    expected = sum(abs(sum(c for c, _ in v) - sum(h for _, h in v)) for v in gaps.values()) / captures
    assert error == pytest.approx(expected) and len(bins) == len(gaps) and bins["n"].sum() == captures
    assert details.calibration(made_up(2, hard=True)) is None


def test_the_page_of_a_corpus_is_whole_and_says_that_captures_are_synthetic(tmp_path, monkeypatch):
    kept = {}
    saved = corpus_page.save
    monkeypatch.setattr(
        corpus_page,
        "save",
        lambda figure, folder, name, *more: kept.update({name: figure}) or saved(figure, folder, name, *more),
    )
    corpus = random_corpus(subjects=2, per_class=2, info={"synthetic": True})
    found = survey(corpus)
    paths = corpus_page.write(corpus, found, tmp_path)
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


@pytest.mark.parametrize("text", ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3", "\t=1", "-a"])
def test_a_text_that_would_be_a_formula_is_led_by_an_apostrophe(text, tmp_path):
    write_sheet(pd.DataFrame({text: [text]}), tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as f:
        assert list(csv.reader(f)) == [[f"'{text}"], [f"'{text}"]]


def test_numbers_dashes_and_other_texts_stay(tmp_path):
    table = pd.DataFrame({"n": [-1.5, np.nan], "t": ["-1.5", "-"], "u": ["a=b", ""]})
    table["i"] = pd.array([-3, None], "Int64")
    write_sheet(table, tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == table.to_csv(index=False)


def test_a_figure_drawn_twice_is_the_same_file(tmp_path):
    for name in ("a", "b"):
        figure, axes = figures.new_figure((3, 2))
        axes[0, 0].plot([1, 2], [3, 4], label="line")
        axes[0, 0].legend()
        figures.write_svg(figure, tmp_path / f"{name}.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
