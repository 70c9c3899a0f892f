"""The generator against the published descriptives of CoST."""

import numpy as np
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

# Jung et al. 2017, Table 4: mean and maximum pressure (g/cm2), contact area (feature 21), duration (ms) and its SD.
TABLE4 = {
    "grab": (349, 1774, 0.59, 1373, 715),
    "hit": (101, 1643, 0.15, 337, 403),
    "massage": (172, 1621, 0.36, 3538, 1898),
    "pat": (100, 1057, 0.15, 709, 753),
    "pinch": (126, 1701, 0.12, 1132, 597),
    "poke": (95, 1258, 0.08, 650, 502),
    "press": (188, 1660, 0.23, 1181, 608),
    "rub": (131, 1282, 0.21, 2170, 1142),
    "scratch": (106, 1064, 0.17, 2205, 1268),
    "slap": (95, 1165, 0.15, 321, 462),
    "squeeze": (286, 1980, 0.47, 1502, 813),
    "stroke": (116, 1135, 0.20, 1722, 829),
    "tap": (92, 1055, 0.12, 564, 486),
    "tickle": (96, 911, 0.18, 2491, 1446),
}
# Medians over the gentle and normal captures of the 2015 challenge's training part, in frames, in the same order.
CHALLENGE_MEDIANS = dict(zip(TABLE4, (160, 31, 400, 76, 127, 67, 130, 259, 241, 25, 178, 241, 61, 268), strict=True))


@pytest.fixture(scope="module")
def described():
    """Features of 24 subjects, with gesture, subject, variant and duration in ms."""
    corpus = generate(subjects=24, repetitions=2)
    table = Jung54().transform(corpus)
    return table.assign(
        gesture=corpus.gestures,
        subject=corpus.subjects,
        variant=corpus.captures["variant"],
        ms=table["f28_duration"] / 135 * 1000,
    )


def test_durations_are_as_published(described):
    by = described.groupby("gesture")["ms"]
    for gesture, (_, _, _, mean, sd) in TABLE4.items():
        assert by.mean()[gesture] == pytest.approx(mean, rel=0.25), gesture
        assert 0.45 * sd < by.std()[gesture] < 1.7 * sd, gesture
    medians = described[described["variant"] != "rough"].groupby("gesture")["f28_duration"].median()
    for gesture, median in CHALLENGE_MEDIANS.items():
        assert medians[gesture] == pytest.approx(median, rel=0.3), gesture
    assert described["f28_duration"].between(10, 1747).all()


def test_contact_areas_are_as_published(described):
    areas = described.groupby("gesture")["f21_peak_contact_area"].mean()
    for gesture, (_, _, area, _, _) in TABLE4.items():
        assert areas[gesture] == pytest.approx(area, abs=0.06), gesture


def test_the_order_of_pressures_is_as_published(described):
    means = described.groupby("gesture")[["f01_mean_pressure", "f02_max_pressure"]].mean()
    for i, column in enumerate(means):
        published = [TABLE4[g][i] for g in means.index]
        assert spearmanr(means[column], published).statistic > 0.75, column
    variants = described.groupby("variant")[["f01_mean_pressure", "f02_max_pressure", "f21_peak_contact_area"]].mean()
    assert (variants.loc["gentle"] < variants.loc["normal"]).all()
    assert (variants.loc["normal"] < variants.loc["rough"]).all()


def test_it_is_as_hard_as_people(described):
    """Jung et al. 2017 get 48 to 60 % over unseen subjects, and name five pairs that are confused (Tables 6 and 8)."""
    values = described.filter(regex=r"^f\d\d").to_numpy()
    gestures = described["gesture"].to_numpy(dtype=str)
    svm = make_pipeline(StandardScaler(), SVC(C=10, gamma=0.01))
    predicted = cross_val_predict(svm, values, gestures, groups=described["subject"], cv=GroupKFold(6))
    assert 0.5 < np.mean(predicted == gestures) < 0.72
    names = sorted(TABLE4)
    confused = confusion_matrix(gestures, predicted, labels=names)
    confused = confused + confused.T
    np.fill_diagonal(confused, 0)
    pairs = {"grab": "squeeze", "pat": "tap", "rub": "stroke", "scratch": "tickle", "hit": "slap"}
    assert {g: names[confused[names.index(g)].argmax()] for g in pairs} == pairs


def test_the_same_arguments_give_the_same_bytes():
    first = generate(subjects=3, seed=4)
    np.random.seed(1)
    assert content_digest(generate(subjects=3, seed=4)) == content_digest(first)
    assert content_digest(generate(subjects=3, seed=5)) != content_digest(first)
    more = generate(subjects=5, seed=4)
    assert np.array_equal(more.frames[: len(first.frames)], first.frames)
    assert more.captures.iloc[: len(first)].equals(first.captures)


def test_it_is_counted_and_ordered_as_cost():
    corpus = generate(subjects=2, repetitions=6)
    ordered = [list(dict.fromkeys(corpus.captures[name])) for name in ("subject", "variant", "gesture", "repetition")]
    assert ordered == [["1", "2"], ["gentle", "normal", "rough"], list(GESTURES), list(range(1, 7))]
    assert len(corpus) == 2 * 3 * 14 * 6 == len({c.tobytes() for c in corpus})
    assert list(corpus.captures.columns) == ["subject", "variant", "gesture", "repetition"]
    assert corpus.synthetic and corpus.frames.dtype == np.uint16 and corpus.frames.max() <= 1023


@given(st.integers(1, 20), st.integers(1, 20), st.floats(5, 300), st.integers(0, 2**31))
def test_any_grid_and_rate(rows, cols, rate_hz, seed):
    corpus = generate(subjects=1, variants=("normal",), rows=rows, cols=cols, rate_hz=rate_hz, seed=seed)
    assert corpus.grid == (rows, cols) and len(corpus) == 14 and corpus.rate_hz == rate_hz
    seconds = corpus.lengths / rate_hz
    assert (seconds >= 10 / 135 - 1 / rate_hz).all() and (seconds <= 1747 / 135 + 1 / rate_hz).all()


@pytest.mark.parametrize(
    ("name", "values"),
    {
        **dict.fromkeys(("subjects", "repetitions", "rows", "cols"), [0, -1]),
        "seed": [-1],
        **dict.fromkeys(("rate_hz", "gain"), [0.0, float("inf"), float("nan")]),
        "noise": [-0.1, float("inf")],
        "variants": [("wild",), ()],
    }.items(),
)
def test_impossible_arguments(name, values):
    for value in values:
        with pytest.raises(InputError, match=f"data.{name}="):
            generate(**{name: value})
