"""Designs of a skin: recorded captures as a smaller skin measures them."""

from fractions import Fraction
from math import ceil, floor

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.skin import CURVES, SAMPLINGS, Design
from bench.errors import InputError
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.running.evaluation import captures_of_fold


def ragged(lengths, grid=(4, 4), rate_hz=54.0, full_scale=1023.0, seed=0):
    """Captures of whole numbers, most of them low, of a subject each."""
    rng = np.random.default_rng(seed)
    arrays = [(full_scale * rng.random((n, *grid)) ** 4).round().astype(np.uint16) for n in lengths]
    table = pd.DataFrame({"subject": [*map(str, range(len(lengths)))], "gesture": "tap"})
    return Corpus.from_captures(arrays, table, rate_hz, full_scale=full_scale, digest="d")


def overlap(first, last, start, end):
    return max(Fraction(0), min(last, end) - max(first, start))


def naive_taxel(frame, wired, shape, row, col):
    """Mean of the wired readings under a merged taxel, by exact areas; 0 without any."""
    total, area = Fraction(0), Fraction(0)
    high, wide = (Fraction(n, m) for n, m in zip(frame.shape, shape, strict=True))
    for r, c in zip(*np.nonzero(wired), strict=True):
        share = overlap(row * high, (row + 1) * high, r, r + 1)
        share *= overlap(col * wide, (col + 1) * wide, c, c + 1)
        total, area = total + share * int(frame[r, c]), area + share
    return total / area if area else area


def naive_frames(frames, wired, shape, period, sampling):
    """A list of frames of fractions, taxel by taxel and period by period."""
    merged = [
        [[naive_taxel(f, wired, shape, r, c) for c in range(shape[1])] for r in range(shape[0])]
        for f in frames
    ]
    if sampling == "pick":
        return [merged[floor(k * period)] for k in range(ceil(Fraction(len(frames)) / period))]
    if sampling == "peak":
        count, peaks = max(1, floor(Fraction(len(frames)) / period)), []
        for k in range(count):
            seen = merged[floor(k * period) : floor((k + 1) * period)]
            peaks.append(
                [[max(m[r][c] for m in seen) for c in range(shape[1])] for r in range(shape[0])]
            )
        return peaks
    means = []
    for k in range(max(1, floor(Fraction(len(frames)) / period))):
        shares = [overlap(k * period, (k + 1) * period, i, i + 1) for i in range(len(frames))]
        means.append(
            [
                [
                    sum(s * m[r][c] for s, m in zip(shares, merged, strict=True)) / sum(shares)
                    for c in range(shape[1])
                ]
                for r in range(shape[0])
            ]
        )
    return means


def naive_code(value, low, high, bits, curve):
    """The nearest code, the upper of two, of a value on the scale of a curve."""
    share = min(max((float(value) + 1e-6 * 1023 - low) / (high - low), 0), 1)  # its guard
    mu = 1000 * (high - low) / 1023
    bent = {"linear": share, "sqrt": share**0.5, "log": np.log1p(mu * share) / np.log1p(mu)}[curve]
    return floor(bent * (2**bits - 1) + 0.5)


designs = st.fixed_dictionaries(
    {
        "shape": st.tuples(st.integers(1, 4), st.integers(1, 3)),
        "rate_hz": st.sampled_from([54.0, 40.5, 27.0, 20.0, 13.5, 10.0]),
        "sampling": st.sampled_from(SAMPLINGS),
        "wired": st.lists(st.booleans(), min_size=12, max_size=12).filter(any),
        "lengths": st.lists(st.integers(1, 12), min_size=1, max_size=3),
        "seed": st.integers(0, 99),
    }
)


@given(designs)
def test_taxels_and_frames_are_merged_as_by_a_naive_loop(case):
    corpus = ragged(case["lengths"], (4, 3), seed=case["seed"])
    wired = np.array(case["wired"]).reshape(4, 3)
    channels = tuple(str(i + 1) for i in np.flatnonzero(wired))
    grid = "x".join(map(str, case["shape"]))
    design = Design(grid, case["rate_hz"], taxels=channels, sampling=case["sampling"])
    made, period = design.convert(corpus), Fraction(54.0) / Fraction(case["rate_hz"])
    assert made.rate_hz == pytest.approx(case["rate_hz"]) and made.full_scale == corpus.full_scale
    area = np.array(
        [
            [naive_taxel(wired, wired, case["shape"], r, c) > 0 for c in range(case["shape"][1])]
            for r in range(case["shape"][0])
        ]
    )
    lines = np.ix_(area.any(1), area.any(0))
    for got, frames in zip(made, corpus, strict=True):
        values = naive_frames(frames, wired, case["shape"], period, case["sampling"])
        wanted = np.array(values)[:, *lines]
        assert got.shape == wanted.shape and got.dtype == np.uint16
        rounded = np.vectorize(lambda value: floor(value + Fraction(1, 2)))(wanted)
        np.testing.assert_array_equal(got, rounded)
    costs = made.info["skin_costs"]
    assert costs["taxels"] == area.sum()
    assert costs["wires"] == min(sum(made.grid), area.sum() + 1)


@given(
    st.integers(1, 8), st.sampled_from([*CURVES]), st.sampled_from([(0, 1023), (0, 255), (9, 300)])
)
def test_codes_are_the_nearest_on_their_curve(bits, curve, ends):
    corpus = ragged([5, 1, 9])
    design = Design(bits=bits, curve=curve, range="-".join(map(str, ends)))
    made, levels = design.convert(corpus), np.arange(2**bits) / (2**bits - 1)
    decoded = ends[0] + (ends[1] - ends[0]) * CURVES[curve](
        levels, 1000 * (ends[1] - ends[0]) / 1023
    )
    codes = [naive_code(value, *ends, bits, curve) for value in corpus.frames.ravel()]
    np.testing.assert_allclose(made.frames.ravel(), decoded[codes], rtol=1e-6)
    assert made.info["skin_costs"]["bits"] == bits


def test_a_recorded_skin_stays_as_it_is():
    corpus = ragged([3, 7])
    made = Design("4x4", 54.0, 10, "0-1023", taxels=("1-16",)).convert(corpus)
    np.testing.assert_array_equal(made.frames, corpus.frames)
    assert made.frames.dtype == corpus.frames.dtype and made.rate_hz == corpus.rate_hz


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"grid": "5x4"}, "skin.grid=5x4: give at most the recorded 4x4"),
        ({"rate_hz": 55.0}, "skin.rate_hz=55: give at most the recorded 54"),
        ({"bits": 11}, "skin.bits=11: give 1 to 10: no finer steps than recorded from 0 to 1023"),
        ({"bits": 8, "range": "0-100"}, "skin.bits=8: give 1 to 6"),
        ({"bits": 12, "range": "auto"}, "skin.bits=12"),
        ({"range": "0-2000"}, "skin.range=0-2000: give readings to 1023"),
        ({"taxels": ("17",)}, "skin.taxels=17: give channels from 1 to 16"),
        ({"taxels": ("3-2",)}, "skin.taxels=3-2"),
    ],
)
def test_a_finer_skin_than_recorded_is_refused(changed, words):
    with pytest.raises(InputError, match=words):
        Design(**changed).convert(ragged([4]))


@pytest.mark.parametrize("changed", [{"grid": "4"}, {"range": "9-1"}, {"curve": "cubic"}])
def test_a_design_that_is_none_is_refused(changed):
    with pytest.raises(InputError, match=f"skin.{next(iter(changed))}="):
        Design(**changed)


def test_a_learned_range_sees_training_captures_alone():
    corpus = ragged([20] * 4)
    test_frames = np.array(corpus.frames)
    test_frames[60:] = 1023
    changed = corpus.with_fields(frames=test_frames)
    design, train = Design(bits=6, range="auto"), np.arange(3)
    fitted, other = (design.fit_range(design.convert(c), train) for c in (corpus, changed))
    high = ceil(np.quantile(corpus.frames[:60], 0.999))
    assert fitted.info["design"]["range"] == f"{corpus.frames[:60].min()}-{high}"
    np.testing.assert_array_equal(fitted.frames[:60], other.frames[:60])
    everyone = design.fit_range(design.convert(changed), np.arange(4))
    assert everyone.info["design"]["range"] != fitted.info["design"]["range"]


@pytest.mark.parametrize("full_scale", [4.5, 2 / 3, 1e-3])
@pytest.mark.parametrize("bits", [1, 6, 16])
def test_a_range_of_decimals_is_learned_in_fine_steps(full_scale, bits):
    whole = ragged([20] * 3)
    values = (whole.frames / 1023 * full_scale * 0.4).astype(np.float32)
    corpus = whole.with_fields(frames=values, full_scale=full_scale)
    design = Design(bits=bits, range="auto")
    made = design.fit_range(design.convert(corpus), np.arange(2))
    low, high = map(float, made.info["design"]["range"].split("-"))
    readings, step = values[:40], full_scale / 2**16
    assert 0 <= low <= readings.min() and high <= full_scale
    top = max(np.quantile(readings, 0.999), low + (2**bits - 1) * step)
    assert -1e-6 * full_scale <= high - top <= step * 1.001
    assert len(np.unique(made.frames)) <= 2**bits


def test_a_design_is_a_corpus_of_its_own_with_the_captures_of_the_recorded_one():
    values = {"model": "lda", "features": "touch", "data.subjects": "3", "data.repetitions": "2"}
    cells = make_cells(values | {"skin.grid": "4x4,2x2", "skin.rate_hz": "27"})
    recorded, small, smaller = (p for p in make_plans([*make_cells(values), *cells], 1))
    assert len({p.key for p in (recorded, small, smaller)}) == 3
    assert len({p.corpus.digest for p in (recorded, small, smaller)} - {""}) == 3
    assert small.facts == recorded.facts and small.corpus.path is not None
    assert cells[0].arguments() == values | {
        "data": "synth",
        "protocol": "loso",
        "skin.grid": "4x4",
        "skin.rate_hz": "27.0",
    }


def test_each_fold_learns_its_range_from_its_training_captures_alone():
    values = {"model": "lda", "features": "touch", "data.subjects": "3", "data.repetitions": "1"}
    (cell,) = make_cells(values | {"skin.grid": "2x2", "skin.bits": "5", "skin.range": "auto"})
    (plan,) = make_plans([cell], 1)
    for fold in plan.folds:
        learned = captures_of_fold(cell, plan.corpus, fold)
        trained = plan.corpus[fold.train].frames
        high = ceil(np.quantile(trained, 0.999))
        assert learned.info["design"]["range"] == f"{floor(trained.min())}-{high}"
        assert len(np.unique(learned.frames)) <= 2**5
