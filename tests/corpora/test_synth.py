"""The generator against the published descriptives of CoST."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr
from sklearn.metrics import confusion_matrix
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from bench.corpora.folder import content_digest
from bench.corpora.read.cost import GESTURES
from bench.corpora.synth import generate
from bench.errors import InputError
from bench.features.jung54 import Jung54

# Jung et al. 2017, Table 4: mean and maximum pressure (g/cm2), contact area (feature 21), duration
# (ms) and its SD; and the median number of frames of the 2015 challenge's training captures.
PUBLISHED = pd.DataFrame(
    {
        "grab": (349, 1774, 0.59, 1373, 715, 160),
        "hit": (101, 1643, 0.15, 337, 403, 31),
        "massage": (172, 1621, 0.36, 3538, 1898, 400),
        "pat": (100, 1057, 0.15, 709, 753, 76),
        "pinch": (126, 1701, 0.12, 1132, 597, 127),
        "poke": (95, 1258, 0.08, 650, 502, 67),
        "press": (188, 1660, 0.23, 1181, 608, 130),
        "rub": (131, 1282, 0.21, 2170, 1142, 259),
        "scratch": (106, 1064, 0.17, 2205, 1268, 241),
        "slap": (95, 1165, 0.15, 321, 462, 25),
        "squeeze": (286, 1980, 0.47, 1502, 813, 178),
        "stroke": (116, 1135, 0.20, 1722, 829, 241),
        "tap": (92, 1055, 0.12, 564, 486, 61),
        "tickle": (96, 911, 0.18, 2491, 1446, 268),
    },
    index=["f01_mean_pressure", "f02_max_pressure", "f21_peak_contact_area", "ms", "sd", "median"],
).T


@pytest.fixture(scope="module")
def described():
    """Features of 24 subjects, with gesture, subject, variant and duration in ms."""
    corpus = generate(subjects=24, repetitions=1)
    table = Jung54().transform(corpus)
    return table.assign(**corpus.captures, ms=table["f28_duration"] / 135 * 1000)


def test_durations_areas_and_the_order_of_pressures_are_as_published(described):
    by = described.groupby("gesture")
    means = by[[*PUBLISHED.columns[:4]]].mean()
    assert (means["ms"] / PUBLISHED["ms"]).between(0.75, 1.25).all()
    assert (by["ms"].std() / PUBLISHED["sd"]).between(0.45, 1.7).all()
    medians = described[described["variant"] != "rough"].groupby("gesture")["f28_duration"].median()
    assert (medians / PUBLISHED["median"]).between(0.7, 1.3).all()
    assert described["f28_duration"].between(10, 1747).all()
    assert (means - PUBLISHED)["f21_peak_contact_area"].abs().max() < 0.06
    for pressure in PUBLISHED.columns[:2]:
        assert spearmanr(means[pressure], PUBLISHED[pressure]).statistic > 0.75, pressure
    variants = described.groupby("variant")[[*PUBLISHED.columns[:3]]].mean()
    assert (variants.loc["gentle"] < variants.loc["normal"]).all()
    assert (variants.loc["normal"] < variants.loc["rough"]).all()


def test_it_is_as_hard_as_people(described):
    """Jung et al. 2017 reach 48 to 60 % on unseen subjects; five pairs are confused."""
    values = described.filter(regex=r"^f\d\d").to_numpy()
    gestures = described["gesture"].to_numpy(dtype=str)
    svm = make_pipeline(StandardScaler(), SVC(C=10, gamma=0.01))
    predicted = cross_val_predict(
        svm, values, gestures, groups=described["subject"], cv=GroupKFold(6)
    )
    assert 0.5 < np.mean(predicted == gestures) < 0.72
    names = sorted(PUBLISHED.index)
    confused = confusion_matrix(gestures, predicted, labels=names)
    confused = confused + confused.T
    np.fill_diagonal(confused, 0)
    pairs = {"grab": "squeeze", "pat": "tap", "rub": "stroke", "scratch": "tickle", "hit": "slap"}
    assert {g: names[confused[names.index(g)].argmax()] for g in pairs} == pairs


def test_the_same_arguments_give_the_same_bytes_counted_and_ordered_as_cost():
    first = generate(subjects=2, repetitions=2, seed=4)
    np.random.seed(1)
    assert content_digest(generate(subjects=2, repetitions=2, seed=4)) == content_digest(first)
    more = generate(subjects=3, repetitions=2, seed=4)
    assert np.array_equal(more.frames[: len(first.frames)], first.frames)
    assert more.captures.iloc[: len(first)].equals(first.captures)
    ordered = {name: list(dict.fromkeys(values)) for name, values in first.captures.items()}
    variants = ["gentle", "normal", "rough"]
    assert ordered == {
        "subject": ["1", "2"],
        "variant": variants,
        "gesture": list(GESTURES),
        "repetition": [1, 2],
    }
    other = generate(subjects=2, repetitions=2, seed=5)
    assert len(first) == 2 * 3 * 14 * 2 and len({c.tobytes() for c in [*first, *other]}) == 2 * len(
        first
    )
    assert first.synthetic and first.frames.dtype == np.uint16 and first.frames.max() <= 1023


@given(st.integers(1, 20), st.integers(1, 20), st.floats(5, 300), st.integers(0, 2**31))
def test_any_grid_and_rate(rows, cols, rate_hz, seed):
    how = {"subjects": 1, "variants": ("normal",), "repetitions": 1}
    corpus = generate(**how, rows=rows, cols=cols, rate_hz=rate_hz, seed=seed)
    assert corpus.grid == (rows, cols) and len(corpus) == 14 and corpus.rate_hz == rate_hz
    seconds = corpus.lengths / rate_hz
    assert (seconds >= 10 / 135 - 1 / rate_hz).all() and (seconds <= 1747 / 135 + 1 / rate_hz).all()


COUNTS = [(name, -1) for name in ("subjects", "repetitions", "rows", "cols", "seed", "noise")]
REALS = [
    (name, value) for name in ("rate_hz", "gain") for value in (0.0, float("inf"), float("nan"))
]


@pytest.mark.parametrize(
    ("name", "value"), [*COUNTS, ("rows", 0), *REALS, ("variants", ("wild",)), ("variants", ())]
)
def test_impossible_arguments(name, value):
    with pytest.raises(InputError, match=f"data.{name}="):
        generate(**{name: value})
