"""Exported C: it decides as Python does, refuses what is no frame, and fits on a chip or does not link."""

import io
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from addons.chip.tests.compiled import (
    SAME_IN_8_BITS,
    SYSTEMS,
    Library,
    check_agreement,
    check_bad_input,
    check_sizes,
    fitted,
    lacking,
    made,
    touched,
    written,
)
from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.classic.rf import et, rf
from bench.models.recipe import Recipe
from bench.models.reflex import Reflex
from bench.work.saved import quiet
from touchbench_chip.tables import check

pytestmark = pytest.mark.skipif(bool(lacking("gcc")), reason=lacking("gcc"))
ARM = ("arm-none-eabi-gcc", "qemu-system-arm", "make")


@pytest.mark.parametrize("bits", [32, 8])
@pytest.mark.parametrize("name", SYSTEMS)
def test_it_decides_as_python_does(name, bits):
    check_agreement(name, bits)


@pytest.mark.parametrize(
    "name, bits", [*((name, 8) for name in sorted(SAME_IN_8_BITS)), ("svm", 32), ("rf", 32), ("xgb", 32)]
)
def test_it_has_as_many_bytes_as_are_counted(name, bits):
    check_sizes(name, bits)


@pytest.mark.parametrize("name", ["lda scaled", "bayes"])
def test_bad_input_is_a_code_and_nothing_is_undefined(name, tmp_path):
    check_bad_input(name, tmp_path)


@pytest.mark.parametrize(
    ("rows", "cols", "rate_hz", "window"), [(5, 7, 40.0, 0.4), (8, 8, 135.0, 1.0), (1, 3, 20.0, 2.0)]
)
def test_features_of_touch_are_those_of_python(rows, cols, rate_hz, window):
    rng = np.random.default_rng(rows)
    frames = round(window * rate_hz)
    lengths = [1, 2, 3, frames // 2, frames - 1, frames]
    arrays = [np.round(np.cumsum(rng.normal(0, 40, (n, rows, cols)), axis=0)).clip(0, 1000) for n in lengths]
    if rows * cols > 8:
        arrays += [touched(rows, cols, rate_hz)[i][:frames] for i in range(6)]
    arrays = [a.astype(np.uint16) for a in arrays]
    labels = {"subject": ["1", "2"] * (len(arrays) // 2), "gesture": ["a", "a", "b"] * (len(arrays) // 3)}
    corpus = Corpus.from_captures(arrays, pd.DataFrame(labels), rate_hz)
    # a forest leaves features as they are; others measure them in place
    recogniser = fitted(Recipe(rf(TouchFeatures(), trees=1), window=window), corpus)
    single, double = (Library(recogniser, precision=p) for p in (np.float32, np.float64))
    expected = TouchFeatures().extract(corpus).to_numpy()
    spread = expected.std(axis=0)
    # what is counted changes by one where a value lies on its mean but for rounding
    counted = np.array([name.endswith(("crossings", "turns")) for name in TouchFeatures().fit(corpus).names_])
    for i in range(len(corpus)):
        size = np.maximum(np.abs(expected[i]), np.maximum(spread, 1e-3))
        got, exact = (library(corpus[i]).features[: len(size)] for library in (single, double))
        apart = np.abs(got - expected[i]) / size
        assert np.quantile(apart, 0.98) < 1e-3 and np.median(apart) < 1e-5
        # Python has frames and gradients in single precision, too, which skewness and kurtosis show most
        for apart, most in ((np.abs(exact - expected[i]) / size, 1e-3), (np.abs(got - exact) / size, 1e-2)):
            apart = apart[~counted]
            assert apart.max() < most and np.quantile(apart, 0.98) < 1e-4 and np.quantile(apart, 0.85) < 1e-5


def test_features_of_jung_are_those_of_python():
    fractions = np.full((3, 5, 7), 5.0, np.float32)
    fractions[:, 0, :3] = [2.25, 2.5, 2.75]  # readings count as what they are, not as whole numbers
    library = Library(made("rf"))
    for frames in (*touched(), fractions):
        one = Corpus.from_captures([frames], touched().captures[:1], touched().rate_hz)
        expected = Jung28().extract(one).to_numpy()[0]
        np.testing.assert_allclose(library(frames).features[: len(expected)], expected, rtol=2e-5, atol=1e-4)


def lines_of(corpus, captures):
    """Frames as text, a blank line behind each capture."""
    text = ["\n".join(" ".join(map(str, f)) for f in corpus[i].reshape(corpus.lengths[i], -1)) for i in captures]
    return "\n\n".join(text) + "\n"


def test_c_finds_the_captures_unlike_training_that_python_finds(tmp_path):
    corpus, recogniser = touched(), made("rf")
    order = np.repeat(np.arange(len(corpus)) % 3 == 0, corpus.lengths)[:, None, None]
    some = corpus.changed(frames=np.where(order, 1023 - corpus.frames, corpus.frames))
    inverted = corpus.changed(frames=1023 - corpus.frames)
    written(recogniser, tmp_path)
    printed(["make", "-C", str(tmp_path), "CC=gcc"])
    shares = []
    for captures in (corpus, some, inverted):
        strange = int(recogniser.label(captures)["unlike"].sum())
        done = subprocess.run(
            [tmp_path / "touch"],
            input=lines_of(captures, range(len(captures))),
            capture_output=True,
            text=True,
            check=True,
        )
        told = f"{strange} of {len(corpus)} captures look unlike all training captures\n" if strange else ""
        assert done.stderr == told
        shares.append(strange / len(corpus))
    assert shares == [0, np.mean(np.arange(len(corpus)) % 3 == 0), 1]


def printed(call, text="", **options):
    """What a program prints, which must not fail."""
    return subprocess.run(call, input=text, capture_output=True, text=True, check=True, **options).stdout


@pytest.mark.parametrize("saves", [True, False])
def test_the_program_prints_what_bench_stream_prints(saves, tmp_path, monkeypatch, capsys):
    import mlflow

    corpus = touched()
    recogniser = made("lda", stopping=True)
    stopping = recogniser.stopping if saves else replace(recogniser.stopping, threshold=float("inf"))
    with quiet(), monkeypatch.context() as patch:
        patch.setattr(recogniser, "stopping", stopping)
        mlflow.pyfunc.save_model(str(tmp_path / "rec"), **recogniser.model([], corpus[0][:2]))
        settled = Library(recogniser)(corpus[0]).settled
    assert main(["export", "rec", "out=c"]) == 0
    assert ("TOUCH_THRESHOLD" in capsys.readouterr().out) is not saves
    header = (tmp_path / "c/touch.h").read_text()
    assert f"#define TOUCH_STOPPING {int(saves)}" in header and ("define TOUCH_THRESHOLD" in header) is saves
    assert (settled > 0) is saves
    printed(["make", "-C", "c", "CC=gcc"])
    shorter = [i for i in range(len(corpus)) if corpus.lengths[i] < corpus.lengths.max()][:5]
    text = lines_of(corpus, shorter)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text.encode())))
    assert main(["live", "rec"]) == 0
    outputs = printed(["c/touch"], text), capsys.readouterr().out
    mine, theirs = ([line.split(",") for line in out.splitlines()] for out in outputs)
    assert [row[:3] + row[4:] for row in mine] == [row[:3] + row[4:] for row in theirs]
    assert saves or {row[4] for row in mine[1:]} == {"-"}
    np.testing.assert_allclose(*([float(row[3]) for row in rows[1:]] for rows in (mine, theirs)), atol=0.01)
    for wrong, reason in (("1 2\n", "35"), ("x\n", "35"), (" ".join(["2000"] * 35), "range")):
        done = subprocess.run(["c/touch"], input=wrong, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and "line 1: " in done.stderr and reason in done.stderr


def test_what_has_no_c_is_one_line(tmp_path, capsys):
    import mlflow

    with quiet():
        mlflow.pyfunc.save_model("rec", **fitted(lda(TouchFeatures()), touched()).model([], touched()[0][:2]))
    for arguments, reason in {("rec", "out=c"): "model.window=1", ("rec", "out=rec"): "rec"}.items():
        assert main(["export", *arguments]) == 2
        output = "".join(capsys.readouterr())
        assert reason in output and len(output.strip().splitlines()) == 1 and not Path("c").exists()


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        (Recipe(lda(TouchFeatures()), window=0.4, hop=0.1), "model.hop="),
        (lda(TouchFeatures()), "model.window="),
        (lda(Jung28(area="capture")), "Jung28 has no C"),
        (Recipe(lda(Jung28()), window=0.4), "model.window="),
        (Recipe(Reflex(), scale="log"), "model.scale="),
        (Recipe(lda(TouchFeatures()), window=0.4, scale="log"), "model.scale=log"),  # else scaled by the peak in C
    ],
)
def test_systems_without_c_are_refused_before_and_after_they_are_fitted(model, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        check(model)
    if not isinstance(model, Recipe) or not isinstance(model.system, Reflex):
        with pytest.raises(InputError, match=reason):
            written(fitted(model, touched()), tmp_path)


@pytest.mark.live
@pytest.mark.skipif(bool(lacking(*ARM)), reason=lacking(*ARM))
def test_a_cortex_m4_prints_what_this_machine_prints(tmp_path):
    folder = written(made("reflex"), tmp_path, 8)
    printed(["make", "-C", folder, "touch", "chip", "CC=gcc"])
    text = lines_of(touched(), range(0, 12, 3))
    here = printed([folder / "touch"], text)
    chip = ["qemu-system-arm", "-machine", "mps2-an386", "-cpu", "cortex-m4", "-nographic", "-monitor", "none"]
    chip += ["-serial", "none", "-semihosting-config", "enable=on,target=native", "-kernel", folder / "touch.elf"]
    assert printed(chip, text, timeout=120) == here and len(here.splitlines()) > 10


@pytest.mark.live
@pytest.mark.skipif(bool(lacking(*ARM)), reason=lacking(*ARM))
def test_what_is_too_large_is_not_linked(tmp_path):
    rng = np.random.default_rng(0)
    corpus = touched()
    noise = corpus.changed(captures=corpus.captures.assign(gesture=rng.choice(list("abc"), len(corpus))))
    folder = written(fitted(et(Jung28(), trees=3000), noise[np.repeat(np.arange(len(noise)), 3)]), tmp_path)

    def linked(*sizes):
        return subprocess.run(["make", "-C", folder, "chip", *sizes], capture_output=True, text=True, check=False)

    done = linked()
    first, *rest = done.stderr.splitlines()
    assert done.returncode and len(rest) <= 1  # what make adds
    lost = int(re.match(r"touch.elf does not fit: FLASH=256K is (\d+) bytes too small; ", first)[1])
    enough = 256 + -(-lost // 1024)  # kilobytes
    assert linked(f"FLASH={enough - 1}K").returncode and not (folder / "touch.elf").exists()
    done = linked(f"FLASH={enough}K")
    assert not done.returncode and (folder / "touch.elf").exists()
    used, spare = (int(n) for n in re.search(r"and (\d+) of RAM, and (\d+) more of RAM", done.stdout).groups())
    assert f"RAM=1K is {used + spare - 1024} bytes too small" in linked(f"FLASH={enough}K", "RAM=1K").stderr


@pytest.mark.nightly
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("name", ["reflex", "lda scaled", "bayes", "svm", "rf", "xgb", "hughes2017_cnn"])
def test_bad_input_is_a_code_with_other_compilers_and_systems(name, compiler, tmp_path):
    if lacking(compiler):
        pytest.skip(lacking(compiler))
    check_bad_input(name, tmp_path, compiler)


@pytest.mark.nightly
@pytest.mark.skipif(bool(lacking("make", "awk")), reason=lacking("make", "awk"))
def test_make_check_is_strict_and_quiet(tmp_path):
    folder = written(made("bayes", stopping=True), tmp_path)
    call = ["make", "-C", str(folder), "check", "CC=gcc"]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert "2," in done.stdout and done.stderr == ""
    code, right = (folder / "touch.c").read_text(), "t->total[t->seen] = total;"
    assert right in code
    (folder / "touch.c").write_text(code.replace(right, "t->total[t->seen + LONGEST] = total;"))
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode and "runtime error" in done.stderr


@pytest.mark.skipif(bool(lacking("g++")), reason=lacking("g++"))
def test_a_program_in_cpp_links_and_headers_take_no_plain_names(tmp_path):
    folder = written(made("bayes", stopping=True), tmp_path)
    Path("main.cpp").write_text('#include "touch.h"\nstatic touch_t t;\nint main() { return touch_init(&t); }\n')
    printed(["gcc", "-c", f"{folder}/touch.c", "-o", "touch.o"])
    printed(["g++", "-I", str(folder), "main.cpp", "touch.o", "-lm", "-o", "program"])
    printed(["./program"])
    headers = "".join(path.read_text() for path in folder.glob("*.h"))
    names = re.findall(r"^(?:typedef .*|} )\b(\w+);$", headers, flags=re.MULTILINE)
    assert names and all(name.startswith("touch_") for name in names)
