"""Exported C decides as Python does, refuses bad frames, and fits on a chip or is not linked."""

import io
import re
import shutil
import subprocess
import sys
from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from addons.chip.tests.compiled import (
    HERE,
    STOPPING,
    STRICT,
    SYSTEMS,
    Library,
    compile_system,
    describe_missing,
    fit_recogniser,
    fit_system,
    touch_corpus,
    write_files,
)
from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.corpora.joined import add_corpora, join_corpora
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.features.touch import (
    STEP_SIGNALS,
    STILL_SHARE,
    TouchFeatures,
    feature_names,
    frame_signals,
)
from bench.models.classic.bayes import bayes
from bench.models.classic.perceptron import perceptron
from bench.models.classic.rf import et, rf
from bench.models.recipe import Recipe
from bench.models.sizes import measure_sizes
from bench.running.saved import Recogniser, save_model, silence_mlflow
from tests.conftest import random_corpus
from tests.corpora.made import study
from touchbench_chip.tables import collect_contents

pytestmark = pytest.mark.skipif(bool(describe_missing("gcc")), reason=describe_missing("gcc"))
ARM = ("arm-none-eabi-gcc", "qemu-system-arm", "make")


ALIKE = {
    "linear svm, z",
    "et",
    "windows of a frame",
    "a person",
}  # in 8 bits they have the code of others
SAME_IN_8_BITS = {
    "lda",
    "lda scaled",
    "perceptron",
    "softmax on jung28",
    "bayes",
}  # Python computes what C does


@pytest.mark.parametrize(
    "name, bits", [*((n, 32) for n in SYSTEMS), *((n, 8) for n in SYSTEMS if n not in ALIKE)]
)
def test_it_decides_as_python_does(name, bits):
    corpus, library, recogniser = (
        touch_corpus(),
        compile_system(name, bits),
        fit_system(name, name in STOPPING and bits == 32),
    )
    table = recogniser.label(corpus)
    expected = table.filter(like="p_").to_numpy()
    answers = [library(frames) for frames in corpus]
    proba = np.array([answer.proba[-1] for answer in answers])
    labels = np.array([recogniser.classes[answer.label] for answer in answers])
    second, first = np.sort(expected, axis=1)[:, -2:].T
    close = 0.02 if bits == 32 else 0.2
    assert (labels == table["label"])[first - second > 2 * close].all() and (
        labels == table["label"]
    ).mean() > 0.9
    assert np.median(np.abs(proba - expected).max(axis=1)) < close / 4
    for i in (0, 5) if recogniser.stopping is not None else ():
        _, confidence, settled = recogniser.decide_on(corpus[i : i + 1], None)
        assert answers[i].settled == pytest.approx(settled, abs=2 * close)
        assert proba[i].max() == pytest.approx(confidence, abs=2 * close)


@pytest.mark.parametrize("name", sorted(SAME_IN_8_BITS))
def test_it_decides_as_python_in_8_bits_does_in_as_many_bytes_as_are_counted(name):
    corpus, system, library = touch_corpus(), SYSTEMS[name](), compile_system(name, 8)
    system = system.set_params(bits=8) if "bits" in system.get_params() else Recipe(system, bits=8)
    plain = fit_recogniser(system, corpus)
    expected = plain.label(corpus).filter(like="p_").to_numpy()
    apart = np.abs([library(frames).proba[-1] for frames in corpus] - expected).max(axis=1)
    assert np.median(apart) < 1e-4 and np.quantile(apart, 0.95) < 0.01
    check_sizes(plain, fit_system(name), library, 8)


@pytest.mark.parametrize("name", ["svm", "rf", "xgb"])
def test_it_has_as_many_bytes_as_are_counted(name):
    check_sizes(fit_system(name), fit_system(name), compile_system(name, 32), 32)


def check_sizes(counted_of, exported, library, bits):
    counted = measure_sizes(counted_of.estimator, 35, int(touch_corpus().lengths.max()))
    chip = collect_contents(exported, bits)
    tables = [part.arrays.items() for part in (chip, *chip.deciders.values())]
    arrays = [
        a for each in tables for name, a in each if name != "usual"
    ]  # only linked if it is used
    assert counted["flash_bytes"] == pytest.approx(sum(a.nbytes for a in arrays), rel=0.1, abs=64)
    assert counted["ram_bytes"] == pytest.approx(library.code.state_bytes(), rel=0.1)


RARE = ["reflex", "lda scaled", "bayes", "svm", "rf", "xgb", "hughes2017_cnn"]


@pytest.mark.parametrize(
    "compiler, name",
    [
        *(("gcc", name) for name in ("lda scaled", "bayes")),
        *(
            pytest.param("gcc", name, marks=pytest.mark.nightly)
            for name in RARE
            if name not in ("lda scaled", "bayes")
        ),
        *(pytest.param("clang", name, marks=pytest.mark.nightly) for name in RARE),
    ],
)
def test_bad_input_is_a_code_that_changes_nothing_and_nothing_is_undefined(
    compiler, name, tmp_path
):
    if describe_missing(compiler):
        pytest.skip(describe_missing(compiler))
    write_files(fit_system(name, stopping=name == "bayes"), tmp_path, 8)
    shutil.copy(HERE / "abuse.c", tmp_path)
    checked = (
        ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
        if compiler == "gcc"
        else []
    )
    flags = [*STRICT, *checked]  # clang has its sanitizers in a package of their own
    subprocess.run(
        [compiler, *flags, "abuse.c", "-lm", "-o", "abuse"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )
    done = subprocess.run(["./abuse"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


SMALL_GRIDS = ["1x1", "1x8", "2x2"]
WINDOW_S = 14 / 13.5


def coarse_captures(grid, captures=60):
    """Generated captures in 40 steps of a logarithmic converter, some as rests or as one push.

    Equal readings come again and again, so many sums are equal but for their rounding.
    """
    shape, rng = tuple(map(int, grid.split("x"))), np.random.default_rng(0)
    arrays = []
    for i in range(captures):
        moving = shape if i % 2 else (1, 1)  # taxels move on their own, or all by one step
        codes = np.cumsum(rng.integers(-2, 3, (14, *moving)), axis=0) + rng.integers(0, 20)
        codes[rng.random(14) < 0.2] = 0
        levels = 1001 ** (codes.clip(0, 40) / 40) - 1
        arrays.append(np.broadcast_to(levels, (14, *shape)).round().astype(np.uint16))
    labels = {
        "subject": [str(i // 4 % 5) for i in range(captures)],
        "gesture": ["a" if i % 4 < 2 else "b" for i in range(captures)],
    }
    return Corpus.from_captures(arrays, pd.DataFrame(labels), 13.5, full_scale=1000.0)


def shares_of_rounding(frames):
    """Shares of crossings and of turns of each signal that only rounding decides.

    Of a signal that varies by rounding alone, both sides take the first value for all.
    """
    x = frame_signals(frames / np.float32(1000))
    x[0, STEP_SIGNALS] = x[1, STEP_SIGNALS]
    level = STILL_SHARE * np.maximum(np.abs(x[0]), 1)
    varies = np.ptp(x, axis=0) > level
    on_mean = (np.abs(x - x.mean(axis=0)) <= level) & varies
    even = (np.abs(np.diff(x, axis=0)) <= level) & varies
    return {
        "crossings": (on_mean[1:] | on_mean[:-1]).mean(axis=0),
        "turns": (even[1:] | even[:-1]).mean(axis=0),
    }


@pytest.mark.parametrize("grid", SMALL_GRIDS)
def test_features_of_a_small_skin_differ_only_in_counts_that_rounding_decides(grid):
    corpus, names = coarse_captures(grid), feature_names()
    # a forest leaves features as they are
    recogniser = fit_recogniser(Recipe(rf(TouchFeatures(), trees=1), window=WINDOW_S), corpus)
    library, expected = Library(recogniser), TouchFeatures().extract(corpus).to_numpy()
    counted = {end: names.str.endswith(f"_{end}") for end in ("crossings", "turns")}
    is_other, undecided = ~(counted["crossings"] | counted["turns"]), []
    for wanted, frames in zip(expected, corpus, strict=True):
        found = library(frames).features[: len(names)]
        np.testing.assert_allclose(found[is_other], wanted[is_other], rtol=1e-2, atol=1e-3)
        for end, most in shares_of_rounding(frames).items():
            assert (np.abs(found - wanted)[counted[end]] <= most + 1e-6).all()
            undecided.append(most)
    assert 0.01 < np.mean(undecided) < 0.5  # or this would show nothing


@pytest.mark.parametrize(
    ("rows", "cols", "rate_hz", "window"),
    [(5, 7, 40.0, 0.4), (8, 8, 135.0, 1.0), (1, 3, 20.0, 2.0)],
)
def test_features_of_touch_are_those_of_python(rows, cols, rate_hz, window):
    rng = np.random.default_rng(rows)
    frames = round(window * rate_hz)
    lengths = [1, 2, 3, frames // 2, frames - 1, frames]
    arrays = [
        np.round(np.cumsum(rng.normal(0, 40, (n, rows, cols)), axis=0)).clip(0, 1000)
        for n in lengths
    ]
    if rows * cols > 8:
        arrays += [touch_corpus(rows, cols, rate_hz)[i][:frames] for i in range(6)]
    arrays = [a.astype(np.uint16) for a in arrays]
    labels = {
        "subject": ["1", "2"] * (len(arrays) // 2),
        "gesture": ["a", "a", "b"] * (len(arrays) // 3),
    }
    corpus = Corpus.from_captures(arrays, pd.DataFrame(labels), rate_hz)
    # a forest leaves features as they are; others measure them in place
    recogniser = fit_recogniser(Recipe(rf(TouchFeatures(), trees=1), window=window), corpus)
    single, double = (Library(recogniser, precision=p) for p in (np.float32, np.float64))
    expected = TouchFeatures().extract(corpus).to_numpy()
    spread = expected.std(axis=0)
    # what is counted changes by one where a value lies on its mean but for rounding
    counted = np.array(
        [name.endswith(("crossings", "turns")) for name in TouchFeatures().fit(corpus).names_]
    )
    for i in range(len(corpus)):
        size = np.maximum(np.abs(expected[i]), np.maximum(spread, 1e-3))
        got, exact = (library(corpus[i]).features[: len(size)] for library in (single, double))
        apart = np.abs(got - expected[i]) / size
        assert np.quantile(apart, 0.98) < 1e-3 and np.median(apart) < 1e-5
        # Python has frames and gradients in single precision, too; most so for skewness, kurtosis
        for apart, most in (
            (np.abs(exact - expected[i]) / size, 1e-3),
            (np.abs(got - exact) / size, 1e-2),
        ):
            apart = apart[~counted]
            assert (
                apart.max() < most
                and np.quantile(apart, 0.98) < 1e-4
                and np.quantile(apart, 0.85) < 1e-5
            )


def test_features_of_jung_are_those_of_python():
    fractions = np.full((3, 5, 7), 5.0, np.float32)
    fractions[:, 0, :3] = [2.25, 2.5, 2.75]  # readings count as what they are, not as whole numbers
    library = Library(fit_system("rf"))
    for frames in (*touch_corpus(), fractions):
        one = Corpus.from_captures([frames], touch_corpus().captures[:1], touch_corpus().rate_hz)
        expected = Jung28().extract(one).to_numpy()[0]
        np.testing.assert_allclose(
            library(frames).features[: len(expected)], expected, rtol=2e-5, atol=1e-4
        )


def frames_as_text(corpus, captures):
    """Frames as text, a blank line behind each capture."""
    text = [
        "\n".join(" ".join(map(str, f)) for f in corpus[i].reshape(corpus.lengths[i], -1))
        for i in captures
    ]
    return "\n\n".join(text) + "\n"


def test_c_finds_the_captures_unlike_training_that_python_finds(tmp_path):
    corpus, recogniser = touch_corpus(), fit_system("rf")
    odd = np.arange(len(corpus)) % 3 == 0
    write_files(recogniser, tmp_path)
    program_output(["make", "-C", str(tmp_path), "CC=gcc"])
    for inverted in (0 * odd, odd, 0 * odd + 1):
        frames = np.where(
            np.repeat(inverted, corpus.lengths)[:, None, None], 1023 - corpus.frames, corpus.frames
        )
        captures = corpus.with_fields(frames=frames)
        text = frames_as_text(captures, range(len(captures)))
        done = subprocess.run(
            [tmp_path / "touch"], input=text, capture_output=True, text=True, check=True
        )
        strange = int(recogniser.label(captures)["unlike"].sum())
        told = (
            f"{strange} of {len(corpus)} captures look unlike all training captures\n"
            if strange
            else ""
        )
        assert done.stderr == told and strange == inverted.sum()


def program_output(call, text="", **options):
    """What a program prints, which must not fail."""
    return subprocess.run(
        call, input=text, capture_output=True, text=True, check=True, **options
    ).stdout


def test_the_program_prints_what_bench_live_prints(tmp_path, monkeypatch, capsys):
    corpus, recogniser = touch_corpus(), fit_system("lda", stopping=True)
    with silence_mlflow():
        save_model(tmp_path / "rec", recogniser.mlflow_arguments([], corpus[0][:2]))
    assert (
        main(["export", "rec", "out=c"]) == 0 and "TOUCH_THRESHOLD" not in capsys.readouterr().out
    )
    assert compile_system("lda", 32)(corpus[0]).settled > 0
    program_output(["make", "-C", "c", "CC=gcc"])
    text = frames_as_text(
        corpus, [i for i in range(len(corpus)) if corpus.lengths[i] < corpus.lengths.max()][:5]
    )
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text.encode())))
    assert main(["live", "rec"]) == 0
    outputs = program_output(["c/touch"], text), capsys.readouterr().out
    mine, theirs = ([line.split(",") for line in out.splitlines()] for out in outputs)
    assert [row[:3] + row[4:] for row in mine] == [row[:3] + row[4:] for row in theirs]
    np.testing.assert_allclose(
        *([float(row[3]) for row in rows[1:]] for rows in (mine, theirs)), atol=0.01
    )
    done = subprocess.run(["c/touch"], input="1 2\n", capture_output=True, text=True, check=False)
    words = "line 1: send 35 decimal numbers, all with commas or all with blanks between them\n"
    assert (done.returncode, done.stderr) == (2, words)


def test_what_never_settles_has_no_threshold_in_c(tmp_path):
    recogniser = copy(fit_system("lda", stopping=True))
    header = (write_files(recogniser, tmp_path) / "touch.h").read_text()
    assert "#define TOUCH_STOPPING 1" in header and "define TOUCH_THRESHOLD" in header
    recogniser.stopping = replace(recogniser.stopping, threshold=float("inf"))
    header = (write_files(recogniser, tmp_path) / "touch.h").read_text()
    assert "#define TOUCH_STOPPING 0" in header and "define TOUCH_THRESHOLD" not in header


@pytest.mark.live
@pytest.mark.skipif(bool(describe_missing(*ARM)), reason=describe_missing(*ARM))
def test_a_cortex_m4_prints_what_this_machine_prints(tmp_path):
    folder = write_files(fit_system("reflex"), tmp_path, 8)
    program_output(["make", "-C", folder, "touch", "chip", "CC=gcc"])
    text = frames_as_text(touch_corpus(), range(0, 12, 3))
    here = program_output([folder / "touch"], text)
    chip = [
        "qemu-system-arm",
        "-machine",
        "mps2-an386",
        "-cpu",
        "cortex-m4",
        "-nographic",
        "-monitor",
        "none",
    ]
    chip += [
        "-serial",
        "none",
        "-semihosting-config",
        "enable=on,target=native",
        "-kernel",
        folder / "touch.elf",
    ]
    assert program_output(chip, text, timeout=120) == here and len(here.splitlines()) > 10


@pytest.mark.live
@pytest.mark.skipif(bool(describe_missing(*ARM)), reason=describe_missing(*ARM))
def test_what_is_too_large_is_not_linked(tmp_path):
    corpus, rng = touch_corpus(), np.random.default_rng(0)
    noise = corpus.with_fields(
        captures=corpus.captures.assign(gesture=rng.choice(list("abc"), len(corpus)))
    )
    folder = write_files(
        fit_recogniser(et(Jung28(), trees=3000), noise[np.repeat(np.arange(len(noise)), 3)]),
        tmp_path,
    )

    def linked(*sizes):
        return subprocess.run(
            ["make", "-C", folder, "chip", *sizes], capture_output=True, text=True, check=False
        )

    done = linked()
    first, *rest = done.stderr.splitlines()
    assert done.returncode and len(rest) <= 1  # what make adds
    lost = int(re.match(r"touch.elf does not fit: FLASH=256K is (\d+) bytes too small; ", first)[1])
    enough = 256 + -(-lost // 1024)  # kilobytes
    assert linked(f"FLASH={enough - 1}K").returncode and not (folder / "touch.elf").exists()
    done = linked(f"FLASH={enough}K")
    assert not done.returncode and (folder / "touch.elf").exists()
    used, spare = (
        int(n) for n in re.search(r"and (\d+) of RAM, and (\d+) more of RAM", done.stdout).groups()
    )
    assert (
        f"RAM=1K is {used + spare - 1024} bytes too small"
        in linked(f"FLASH={enough}K", "RAM=1K").stderr
    )


@pytest.mark.nightly
@pytest.mark.skipif(bool(describe_missing("make", "awk")), reason=describe_missing("make", "awk"))
def test_make_check_is_strict_and_quiet(tmp_path):
    folder = write_files(fit_system("bayes", stopping=True), tmp_path)
    call = ["make", "-C", str(folder), "check", "CC=gcc"]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert "2," in done.stdout and done.stderr == ""
    code, right = (folder / "touch.c").read_text(), "t->total[t->seen] = total;"
    assert right in code
    (folder / "touch.c").write_text(code.replace(right, "t->total[t->seen + LONGEST] = total;"))
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode and "runtime error" in done.stderr


def test_headers_take_no_plain_names(tmp_path):
    folder = write_files(fit_system("bayes", stopping=True), tmp_path)
    headers = "".join(path.read_text() for path in folder.glob("*.h"))
    names = re.findall(r"^(?:typedef .*|} )\b(\w+);$", headers, flags=re.MULTILINE)
    assert names and all(name.startswith("touch_") for name in names)


USE = """#include "{model}/touch.h"
static {prefix}_t t;
const char *label_{model}(const float *frame)
{{
    float probabilities[{macro}_CLASSES];
    {prefix}_init(&t);
    for (int n = 0; n < 20; n++)
        {prefix}_push(&t, frame);
    return {prefix}_name({prefix}_label(&t, probabilities, 0));
}}
"""
MAIN = """#include <stdio.h>
const char *label_one(const float *frame), *label_two(const float *frame);
static const float frame[36];
int main(void) { printf("%s %s\\n", label_one(frame), label_two(frame)); return 0; }
"""


def link_two(folder, prefixes, order):
    """Link the models one and two, each a library, into a program with the address sanitizer."""
    flags = [*STRICT, "-g", "-fsanitize=address"]
    for model, prefix in prefixes.items():
        use = USE.format(model=model, prefix=prefix, macro=prefix.upper())
        (folder / f"use_{model}.c").write_text(use)
        library = ["gcc", *flags, "-c", f"{model}/touch.c", "-o", f"{model}.o"]
        for call in (library, ["ar", "rcs", f"lib{model}.a", f"{model}.o"]):
            subprocess.run(call, cwd=folder, check=True)
    (folder / "main.c").write_text(MAIN)
    call = ["gcc", *flags, "main.c", "use_one.c", "use_two.c", "-L.", *order, "-lm", "-o", "both"]
    return subprocess.run(call, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("order", [("-lone", "-ltwo"), ("-ltwo", "-lone")])
def test_two_models_with_prefixes_share_a_program_and_without_one_are_not_linked(tmp_path, order):
    gestures = {"one": ["tap", "touch_hard"], "two": ["pat", "rub"]}
    for number, (model, names) in enumerate(gestures.items()):
        corpus = random_corpus(3, 2, grid=(4 + number, 4))
        captures = corpus.captures.assign(gesture=[names[i % 2] for i in range(len(corpus))])
        recogniser = fit_recogniser(bayes(Jung28()), corpus.with_fields(captures=captures))
        write_files(recogniser, tmp_path / model, prefix=f"{model}_skin")
        write_files(recogniser, tmp_path / "plain" / model)
    linked = link_two(tmp_path, {model: f"{model}_skin" for model in gestures}, order)
    assert linked.returncode == 0, linked.stderr
    labels = program_output([tmp_path / "both"]).split()
    assert [label in names for label, names in zip(labels, gestures.values(), strict=True)] == [
        1,
        1,
    ]
    assert '"touch_hard"' in (tmp_path / "one/tables.h").read_text()  # no name of the C
    linked = link_two(tmp_path / "plain", dict.fromkeys(gestures, "touch"), order)
    assert linked.returncode and "multiple definition of `touch_push'" in linked.stderr


@pytest.mark.parametrize("detector", [False, True])
def test_no_name_of_the_c_is_without_its_prefix(detector, tmp_path):
    recogniser = fit_system("reflex" if detector else "bayes", stopping=not detector)
    folder = write_files(recogniser, tmp_path, prefix="Skin2")
    for path in folder.iterdir():
        assert not re.search(r"(\b|\\n)(touch|TOUCH)_\w", path.read_text()), path.name
    program_output(["make", "-C", folder, "check", "CC=gcc"])


@pytest.mark.parametrize("prefix", ["", "9skin", "my skin", "a-b", "_skin", "size", "uint8", "sum"])
def test_a_prefix_that_makes_no_names_is_refused(prefix, tmp_path):
    with pytest.raises(InputError, match=f"prefix={prefix}: .*; give "):
        write_files(fit_system("reflex"), tmp_path, prefix=prefix)


@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
def test_c_that_would_take_nan_for_a_reading_is_not_compiled(flag, tmp_path):
    folder = write_files(fit_system("bayes", stopping=True), tmp_path)
    call = ["gcc", "-std=c99", flag, "-c", "touch.c"]
    done = subprocess.run(call, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode and "build touch.c without -ffast-math" in done.stderr


def test_a_model_with_a_scale_for_each_of_several_sensors_has_no_c():
    studies = [study("one", ("1", "2", "3")), study("two", ("1", "2", "3"))]
    joined, added = join_corpora(studies), add_corpora(studies[0], studies[1:])
    for corpus in (added, joined):
        system = Recipe(perceptron(TouchFeatures(), updates=2), window=0.2)
        recogniser = Recogniser(system.fit(corpus, corpus.gestures), corpus, None)
        if corpus is added:
            collect_contents(recogniser, 32)
    with pytest.raises(InputError, match="C has one sensor"):
        collect_contents(recogniser, 32)
