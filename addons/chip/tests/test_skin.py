"""C of a designed skin: frames of the recorded one become those that Python converts."""

import ctypes
import re

import numpy as np
import pytest

from addons.chip.tests.compiled import (
    HERE,
    describe_missing,
    fit_recogniser,
    load_library,
    touch_corpus,
    write_files,
)
from bench.corpora.skin import Design
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.models.classic.bayes import bayes
from touchbench_chip.write import write_c_sources

pytestmark = pytest.mark.skipif(bool(describe_missing("gcc")), reason=describe_missing("gcc"))
DESIGNS = {
    "merged": Design(grid="2x3", rate_hz=20.0, bits=6),
    "uneven periods": Design(grid="3x4", rate_hz=15.3),
    "log, picked": Design(rate_hz=13.0, bits=5, curve="log", sampling="pick", taxels=("1-9", "30")),
    "sqrt, peaks": Design(grid="1x1", rate_hz=13.0, bits=8, curve="sqrt", sampling="peak"),
    "learned range": Design(grid="4x4", bits=4, range="auto"),
    "wired": Design(taxels=("1", "7", "35"), range="9-300"),
}


def as_pointer(values):
    return values.ctypes.data_as(ctypes.c_void_p)


@pytest.fixture(scope="module", params=DESIGNS)
def designed(request, tmp_path_factory):
    """Captures as recorded, the same of a design, and the C of a system that was fitted to it."""
    recorded, design = touch_corpus(), DESIGNS[request.param]
    corpus = design.fit_range(design.convert(recorded), np.arange(len(recorded)))
    recogniser = fit_recogniser(bayes(Jung28()), corpus)
    folder = write_files(recogniser, tmp_path_factory.mktemp("skin"))
    return recorded, corpus, recogniser, load_library(folder, (HERE / "skin.c").read_text()), folder


def test_frames_of_c_are_those_of_python(designed):
    recorded, corpus, recogniser, code, _ = designed
    for frames, wanted in zip(recorded, corpus, strict=True):
        values = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
        got = np.zeros((len(frames) + 1, *corpus.grid), dtype=np.float32)
        count = code.skin(as_pointer(values), len(values), as_pointer(got))
        # C cannot know that a capture ends within the period of a peak
        ends_early = recogniser.design.sampling == "peak" and count == len(wanted) + 1
        assert count == len(wanted) or ends_early
        np.testing.assert_allclose(got[: len(wanted)], wanted, rtol=3e-7, atol=1e-4)


def test_codes_stand_for_the_readings_of_python(designed):
    _, corpus, recogniser, code, folder = designed
    code.touch_reading.restype = ctypes.c_float
    levels = recogniser.design.converter(recogniser.full_scale, True)[1]
    number = re.search(r"#define TOUCH_CODES (\d+)", (folder / "touch.h").read_text())
    assert int(number[1]) == len(levels)
    got = [code.touch_reading(i) for i in (-1, *range(len(levels)), len(levels))]
    np.testing.assert_allclose(got, [-1, *levels, -1], rtol=3e-7, atol=1e-4)


def test_the_header_names_what_is_merged_and_skipped(designed):
    _, corpus, recogniser, _, folder = designed
    weights = recogniser.design.weights(touch_corpus().grid)
    text = (folder / "touch.h").read_text()
    lines = dict(re.findall(r"^   frame\[(\d+)\]: (.+)$", text, flags=re.MULTILINE))
    assert [*lines] == [*map(str, range(len(weights)))]
    for line, row in zip(lines.values(), weights, strict=True):
        named = [int(number) for number in re.findall(r"(\d+)(?:,|$)", line)]
        assert named == [*np.flatnonzero(row) + 1]
    (skipped,) = re.findall(r"skipped: (.+)\.", text)
    unused = [str(i + 1) for i in np.flatnonzero(~weights.any(axis=0))]
    assert skipped == (", ".join(unused) or "none")


def test_a_curve_with_more_codes_than_a_table_holds_is_refused():
    corpus = touch_corpus().with_fields(full_scale=65535.0)
    made = Design(bits=13, curve="log").convert(corpus)
    with pytest.raises(InputError, match="skin.bits=12"):
        write_c_sources(fit_recogniser(bayes(Jung28()), made), 32, "a test")
