"""The page of a corpus."""

import numpy as np

from bench.corpora.survey import Survey
from bench.reports import corpus_page
from tests.conftest import random_corpus


def test_the_page_says_that_captures_are_synthetic_and_shows_mean_pressure(tmp_path, monkeypatch):
    figures, save_figure = [], corpus_page.save_figure

    def keep(figure, *more):
        figures.append(figure)
        return save_figure(figure, *more)

    monkeypatch.setattr(corpus_page, "save_figure", keep)
    corpus = random_corpus(subjects=2, per_class=2, info={"synthetic": True})
    survey = Survey(corpus)
    corpus_page.write_page(survey, tmp_path)
    text = (tmp_path / "index.html").read_text()
    assert text.count("not people") >= 6  # on top, of every table, of every figure
    panels = [ax.images[0].get_array() for ax in figures[0].axes[:: corpus_page.FILMED + 2]]
    for gesture, panel in zip(survey.gestures, panels, strict=True):
        frames = np.concatenate(list(corpus[corpus.gestures == gesture]))
        np.testing.assert_allclose(panel, frames.mean(axis=0))
