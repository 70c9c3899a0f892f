"""Figures of a corpus: they show its captures, whatever their names, grid and length."""

import base64
import re

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from bench.corpora.corpus import Corpus
from bench.corpora.survey import survey
from bench.errors import InputError
from reports import corpus_page as look
from reports import layout
from tests.conftest import random_corpus

NAMES = ["pressure.png", "pressure.svg", "films.png", "films.svg", "motion.gif", "index.html"]


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    corpus = random_corpus(info={"synthetic": True})
    folder = tmp_path_factory.mktemp("look")
    return corpus, folder, look.write(corpus, survey(corpus), folder)


def test_all_files_are_there_and_say_that_captures_are_synthetic(drawn):
    _, folder, paths = drawn
    assert [p.name for p in paths] == NAMES == [p.name for p in paths if p.stat().st_size]
    for name in ("pressure.svg", "films.svg"):
        assert "synthetic captures, not people" in (folder / name).read_text()
    page = (folder / "index.html").read_text()
    assert page.count("not people") >= 8  # on top, of every table, of every figure
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page.partition("</style>")[2].split("<script>")[0])
    (gif,) = re.findall(r'src="data:image/gif;base64,([^"]+)"', page)
    assert layout.markdown([layout.Animation(paths[4], "moving")], folder) == "![moving](motion.gif)\n"
    assert base64.b64decode(gif) == (folder / "motion.gif").read_bytes()


def test_no_synthetic_mark_on_recorded_captures(tmp_path):
    corpus = random_corpus(subjects=1, per_class=1)
    paths = look.write(corpus, survey(corpus), tmp_path)
    texts = [p.read_text() for p in paths if p.suffix in (".svg", ".html")]
    assert len(texts) == 3 and not any("ynthetic" in t.partition("</style>")[2] or "not people" in t for t in texts)


def test_figures_show_the_means_and_the_frames(tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(look, "save", lambda figure, *_: kept.append(figure))
    corpus = random_corpus()
    found = survey(corpus)
    look.pressure_figure(found, "random", tmp_path)
    look.film_figure(corpus, found, "random", tmp_path)
    panels = [ax.images[0].get_array() for ax in kept[0].axes if ax.images]
    for gesture, panel in zip(found.gestures, panels, strict=True):
        np.testing.assert_allclose(panel, np.concatenate(list(corpus[corpus.gestures == gesture])).mean(axis=0))
    axes = kept[1].axes
    for i, gesture in enumerate(found.gestures):
        frames = corpus[found.typical[gesture]]
        *strip, curve = axes[i * (look.FILMED + 1) : (i + 1) * (look.FILMED + 1)]
        for j, ax in enumerate(strip):
            middle = int(len(frames) * (2 * j + 1) / (2 * look.FILMED))
            assert np.array_equal(ax.images[0].get_array(), frames[middle])
        np.testing.assert_allclose(curve.lines[0].get_ydata(), [f.sum() for f in frames])


def test_the_animation_takes_as_long_as_the_touch(tmp_path):
    frames = np.random.default_rng(0).integers(0, 900, (250, 4, 4)).astype(np.uint16)
    about = pd.DataFrame({"subject": ["1", "1"], "gesture": ["a", "b"]})
    corpus = Corpus.from_captures([frames, frames[:20]], about, 100.0)
    for chosen, seconds in (([0, 1], 2.5), ([1], 0.2)):
        with Image.open(look.animation(corpus, chosen, "own", tmp_path).path) as gif:
            spent = 0
            for i in range(gif.n_frames):
                gif.seek(i)
                spent += gif.info["duration"]
        assert spent / 1000 == pytest.approx(seconds, abs=0.1 * seconds + 0.02)


@pytest.mark.filterwarnings("ignore:Glyph")  # of a font that a machine may not have
@pytest.mark.parametrize("grid", [(1, 1), (1, 40), (40, 1), (3, 17)])
def test_odd_names_grids_and_lengths_are_drawn(grid, tmp_path):
    names = ["$x_1$ \\frac <b>&amp;", "a$b", "長い" * 30, "w" * 200]
    rng = np.random.default_rng(0)
    kinds = [np.uint16, np.float32]
    for kind in kinds:
        arrays = [rng.integers(0, 3, (n, *grid)).astype(kind) for n in (1, 2, 3, 30)]
        about = pd.DataFrame({"subject": ["<i>1</i>", "$", "2", "2"], "gesture": names})
        corpus = Corpus.from_captures(arrays, about, 50.0, name="odd")
        look.write(corpus, survey(corpus), tmp_path)
    page = (tmp_path / "index.html").read_text()
    assert "<b>" not in page and "<i>" not in page and "&lt;b&gt;&amp;amp;" in page
    assert "$x_1$" in (tmp_path / "films.svg").read_text()  # as text, not as a formula


def test_only_so_many_gestures_are_drawn_and_the_caption_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(look, "DRAWN", 2)
    corpus = random_corpus(subjects=1, per_class=1)
    look.write(corpus, survey(corpus), tmp_path)
    page = (tmp_path / "index.html").read_text()
    assert page.count("1 more gestures are not drawn") >= 2


def test_a_capture_is_named_by_its_place_in_the_whole_corpus(tmp_path):
    corpus = random_corpus()
    some = corpus[np.array([30, 7])]
    assert look.place(some, 7) == 1
    with pytest.raises(InputError, match=r"capture=8: not among the 2 captures looked at.*\(7 to 30\)"):
        look.write(some, survey(some), tmp_path / "new", 8)
    assert not (tmp_path / "new").exists()
    look.write(some, survey(some), tmp_path, 7)
    assert "capture 7" in (tmp_path / "index.html").read_text()
