"""The sensor at rest, by session: against numbers that were put in."""

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.corpora.sensor import sensor_table

RNG = np.random.default_rng(3)


def make_sessions(quiet):
    """Captures of two days: the second has three times the noise, and each frame twice."""
    streams, rows = [], []
    for day, noise, level, twice in (("mon", 2, 100, 1), ("tue", 6, 140, 2)):
        for gesture, height in ((quiet, 0), ("pat", 300)):
            for subject in "12":
                touched = height * (np.arange(60) >= 30)[:, None, None]
                frames = level + RNG.normal(0, noise, (60, 4, 4)) + touched
                streams.append(np.rint(np.repeat(frames, twice, axis=0)).astype(np.uint16))
                rows.append((subject, gesture, day))
    table = pd.DataFrame(rows, columns=["subject", "gesture", "session"])
    return Corpus.from_captures(streams, table, 30.0, full_scale=1023)


@pytest.mark.parametrize("quiet", ["notouch", "rub"])
def test_level_noise_and_a_wrong_rate_of_a_session_are_seen(quiet):
    corpus = make_sessions(quiet)
    table = sensor_table(corpus)
    assert table["session"].tolist() == ["mon", "tue"] and table["captures"].tolist() == [4, 4]
    assert table["seconds"].tolist() == [2, 4]
    assert table["repeated"].tolist() == [0, pytest.approx(50, abs=1)]
    if quiet == "notouch":  # each frame twice halves the squares of the changes
        assert table["level"].tolist() == pytest.approx([100, 140], abs=0.5)
        assert table["noise"].tolist() == pytest.approx([2, 6 / np.sqrt(2)], rel=0.15)
    else:  # one half of two captures has a touch, and the rest is known from the pressure alone
        assert table["noise"][1] > 1.5 * table["noise"][0]
    del corpus.captures["session"]
    assert sensor_table(corpus)["session"].tolist() == ["all"]
