"""Exported C: it decides as Python does, refuses what is no frame, and fits on a chip or does not link."""

import io
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.errors import InputError
from bench.export.classifiers import decider
from bench.export.tables import chip_of
from bench.work.saved import quiet
from features.jung28 import Jung28
from features.touch import TouchFeatures
from models.classic.bayes import bayes
from models.classic.lda import lda
from models.classic.rf import et, rf
from models.classic.softmax import softmax
from models.classic.svm import svm
from models.classic.tree import tree
from models.classic.xgb import xgb
from models.nets.hughes2017 import Hughes2017CNN
from models.quantised import rounded
from models.recipe import Recipe
from models.reflex import Reflex
from models.sizes import sizes
from tests.export.compiled import STRICT, built, fitted, lacking, written

pytestmark = pytest.mark.skipif(bool(lacking("gcc")), reason=lacking("gcc"))
WINDOW = {"window": 0.4, "repair": ("stuck", "dead")}
SYSTEMS = {
    "reflex": lambda: Reflex(units=6, copies=1, window=0.4, early=0.2),
    "lda": lambda: Recipe(lda(TouchFeatures()), **WINDOW),
    "lda scaled": lambda: Recipe(lda(TouchFeatures()), window=0.4, repair=("offset",), scale="peak"),
    "softmax": lambda: Recipe(softmax(TouchFeatures()), **WINDOW),
    "softmax on jung28": lambda: softmax(Jung28()),
    "bayes": lambda: bayes(Jung28()),
    "svm": lambda: svm(Jung28()),
    "linear svm, z": lambda: svm(Jung28(), C=1.0, kernel="linear", scaling="z"),
    "rf": lambda: rf(Jung28(), trees=9),
    "et": lambda: Recipe(et(TouchFeatures(), trees=5), window=0.4),
    "tree": lambda: tree(Jung28(), level=2),
    "xgb": lambda: xgb(Jung28(), trees=5),
    "hughes2017_cnn": lambda: Recipe(Hughes2017CNN(epochs=4, rate=1e-3), repair=("stuck", "dead")),
    "windows of a frame": lambda: Recipe(rf(TouchFeatures(), trees=9), window=0.02),
    "a person": lambda: Recipe(svm(Jung28()), person=("centre", "scale")),
}


@cache
def touched(rows=5, cols=7, rate_hz=40.0, classes=3):
    """Four people who press here or there, for long or short, hard or not; some taxels are dead or stuck."""
    corpus = generate(subjects=4, rows=rows, cols=cols, rate_hz=rate_hz, variants=("normal",))
    names = sorted(set(corpus.gestures))[2 : 2 + classes]
    part = corpus[np.flatnonzero(np.isin(corpus.gestures, names))].detached()
    frames = part.frames.copy()
    for i in range(0, len(part), 4):
        own = slice(part.starts[i], part.starts[i] + part.lengths[i])
        frames[own, 1, 2] = 1023 if i % 8 else 0
    return part.changed(frames=frames)


@cache
def made(name, stopping=False):
    """A system, fitted once for all tests."""
    found = fitted(SYSTEMS[name](), touched(), stopping)
    if name == "a person":
        own = touched()[touched().subjects == "2"]
        found.estimator = found.estimator.adapt(own, own.gestures)
    return found


@pytest.mark.parametrize("bits", [32, 8])
@pytest.mark.parametrize("name", SYSTEMS)
def test_it_decides_as_python_does(name, bits, tmp_path):
    corpus, found = touched(), made(name, stopping=name in ("lda", "bayes", "hughes2017_cnn"))
    asked = built(found, tmp_path / "c", bits)
    told = found.label(corpus)
    proba = told.filter(like="p_").to_numpy()
    answers = [asked(frames) for frames in corpus]
    apart = np.abs(np.array([p for _, p, _, _ in answers]) - proba).max(axis=1)
    labels = np.array([found.classes[label] for label, *_ in answers])
    sure = np.sort(proba, axis=1)[:, -1] - np.sort(proba, axis=1)[:, -2]
    close = 0.02 if bits == 32 else 0.2
    assert (labels == told["label"])[sure > 2 * close].all() and (labels == told["label"]).mean() > 0.9
    assert np.median(apart) < close / 4
    if found.stopping is not None:
        for i in (0, 5):
            one = corpus[i : i + 1]
            _, confidence, settled = found.decision(one, None)
            label, p, how, _ = asked(one[0])
            assert how == pytest.approx(settled, abs=2 * close) and p.max() == pytest.approx(confidence, abs=2 * close)


@pytest.mark.parametrize("bits", [32, 8])
@pytest.mark.parametrize("name", SYSTEMS)
def test_what_is_counted_is_what_is_written(name, bits, tmp_path):
    found, corpus = made(name), touched()
    estimator = found.estimator
    if bits == 8:
        try:
            estimator = in_eight(SYSTEMS[name]()).fit(corpus, corpus.gestures)
        except InputError as e:
            pytest.skip(str(e))
    counted = sizes(estimator, 35, int(corpus.lengths.max()))
    chip = chip_of(found, bits)
    tables = sum(
        a.nbytes for arrays in (chip.arrays, *(d.arrays for d in chip.deciders.values())) for a in arrays.values()
    )
    assert counted["flash_bytes"] == pytest.approx(tables, rel=0.1, abs=64)
    folder = written(found, tmp_path / "c", bits)
    (folder / "size.c").write_text(
        '#include <stdio.h>\n#include "touch.h"\nint main(void) { printf("%zu", sizeof(touch_t)); }'
    )
    subprocess.run(["gcc", *STRICT, "size.c", "-o", "size"], cwd=folder, check=True, capture_output=True)
    state = int(subprocess.run(["./size"], cwd=folder, check=True, capture_output=True, text=True).stdout)
    if name == "hughes2017_cnn":  # of networks the outputs of all layers are counted, as papers do, and C keeps less
        assert counted["ram_bytes"] > state
    else:
        assert counted["ram_bytes"] == pytest.approx(state, rel=0.1)


@pytest.mark.parametrize("name", ["reflex", "lda", "lda scaled", "softmax", "softmax on jung28", "bayes"])
def test_eight_bits_in_python_are_those_of_c(name, tmp_path):
    corpus = touched()
    asked = built(made(name), tmp_path / "c", 8)
    proba = fitted(in_eight(SYSTEMS[name]()), corpus).label(corpus).filter(like="p_").to_numpy()
    apart = np.abs(np.array([asked(frames)[1] for frames in corpus]) - proba).max(axis=1)
    assert np.median(apart) < 1e-4 and np.quantile(apart, 0.95) < 0.01


def in_eight(system):
    """The same with weights of 8 bits."""
    if "bits" in system.get_params():
        found = system.set_params(bits=8)
    else:
        found = Recipe(system, bits=8)
    found.check()
    return found


@pytest.mark.parametrize(
    ("rows", "cols", "rate_hz", "window"), [(5, 7, 40.0, 0.4), (8, 8, 135.0, 1.0), (1, 3, 20.0, 2.0), (2, 2, 31.0, 0.5)]
)
def test_features_of_touch_are_those_of_python(rows, cols, rate_hz, window, tmp_path):
    corpus = touched(rows, cols, rate_hz) if rows * cols > 8 else None
    rng = np.random.default_rng(rows)
    frames = round(window * rate_hz)
    lengths = [1, 2, 3, frames // 2, frames - 1, frames]
    arrays = [np.round(np.cumsum(rng.normal(0, 40, (n, rows, cols)), axis=0)).clip(0, 1000) for n in lengths]
    if corpus is not None:
        arrays += [corpus[i][:frames] for i in range(6)]
    arrays = [a.astype(np.uint16) for a in arrays]
    about = pd.DataFrame({"subject": ["1", "2"] * (len(arrays) // 2), "gesture": ["a", "a", "b"] * (len(arrays) // 3)})
    made = Corpus.from_captures(arrays, about, rate_hz)
    # a forest leaves features as they are; others measure them in place
    found = fitted(Recipe(rf(TouchFeatures(), trees=1), window=window), made)
    single, double = (built(found, tmp_path / p.__name__, precision=p) for p in (np.float32, np.float64))
    expected = TouchFeatures().extract(made).to_numpy()
    spread = expected.std(axis=0)
    # what is counted changes by one where a value lies on its mean but for rounding
    counted = np.array([name.endswith(("crossings", "turns")) for name in TouchFeatures().fit(made).names_])
    for i in range(len(made)):
        size = np.maximum(np.abs(expected[i]), np.maximum(spread, 1e-3))
        got, exact = (asked(made[i])[3][: len(size)] for asked in (single, double))
        apart = np.abs(got - expected[i]) / size
        assert np.quantile(apart, 0.98) < 1e-3 and np.median(apart) < 1e-5
        # Python has frames and gradients in single precision, too, which skewness and kurtosis show most
        for apart, most in ((np.abs(exact - expected[i]) / size, 1e-3), (np.abs(got - exact) / size, 1e-2)):
            apart = apart[~counted]
            assert apart.max() < most and np.quantile(apart, 0.98) < 1e-4 and np.quantile(apart, 0.85) < 1e-5


def test_features_of_jung_are_those_of_python(tmp_path):
    corpus = touched()
    found = fitted(rf(Jung28(), trees=1), corpus)
    asked = built(found, tmp_path / "c")
    expected = Jung28().extract(corpus).to_numpy()
    for i in range(len(corpus)):
        np.testing.assert_allclose(asked(corpus[i])[3][: expected.shape[1]], expected[i], rtol=2e-5, atol=1e-4)


def test_readings_between_whole_numbers_count_as_what_they_are(tmp_path):
    corpus = touched()
    asked = built(fitted(rf(Jung28(), trees=1), corpus), tmp_path / "c")
    frames = np.full((3, 5, 7), 5.0, np.float32)
    frames[:, 0, :3] = [2.25, 2.5, 2.75]
    one = Corpus.from_captures([frames], corpus.captures[:1], corpus.rate_hz)
    expected = Jung28().extract(one).to_numpy()[0]
    np.testing.assert_allclose(asked(frames)[3][: len(expected)], expected, rtol=1e-5)


def test_what_only_rounding_tells_apart_decides_nothing(tmp_path):
    """A grid of one taxel: whatever is told of its row or of how alike two frames are, is rounding."""
    rng = np.random.default_rng(0)
    arrays = [rng.integers(0, 1000, (n, 1, 1)).astype(np.uint16) for n in rng.integers(2, 40, 24)]
    about = pd.DataFrame({"subject": list("1234") * 6, "gesture": ["a", "b", "c"] * 8})
    corpus = Corpus.from_captures(arrays, about, 20.0)
    found = fitted(Recipe(lda(TouchFeatures()), window=0.5), corpus)
    weights = decider(found.estimator.system_, 427, 32).arrays["b"]
    names = TouchFeatures().fit(corpus).names_
    assert not weights[[i for i, name in enumerate(names) if name.startswith(("row_q", "col_q"))]].any()
    asked = built(found, tmp_path / "c")
    assert all(asked(frames)[0] >= 0 for frames in corpus)


def test_eight_bits_by_hand():
    weights = np.array([[1.0, -127.0, 63.4], [0.0, 0.0, 0.0]])
    whole, step = rounded(weights, 8)
    assert whole.tolist() == [[1, -127, 63], [0, 0, 0]] and step.tolist() == [1, 1] and whole.dtype == np.int8
    assert rounded(weights, 16)[0][0].tolist() == [258, -32767, 16358]


ALL = """#include "touch.c"
#include <stdio.h>
#include <stdlib.h>
static touch_t t, kept;
int main(void)
{
    static float frame[TAXELS], proba[CLASSES], settled;
    unsigned seed = 1;
    if (touch_init(0) != TOUCH_BAD || touch_push(0, frame) != TOUCH_BAD || touch_label(0, proba, 0) != TOUCH_BAD)
        return 1;
    touch_init(&t);
    if (touch_push(&t, 0) != TOUCH_BAD || touch_label(&t, 0, 0) != TOUCH_BAD)
        return 2;
    if (touch_label(&t, proba, 0) != TOUCH_EMPTY)
        return 2;
    const float odd[] = {NAN, INFINITY, -INFINITY, -0.001f, FULL_SCALE * 1.001f, -1e-40f};
    for (int n = 0; n < 3000; n++) {
        int bad = 0;
        for (int i = 0; i < TAXELS; i++) {
            seed = seed * 1103515245u + 12345u;
            frame[i] = seed % 3 ? (float)(seed >> 16 & 1023) : (n / 50 % 2 ? FULL_SCALE : 0);
        }
        if (n % 7 == 0) {
            frame[n % TAXELS] = odd[n % 6];
            bad = 1;
        }
        memcpy(&kept, &t, sizeof t);
        int code = touch_push(&t, frame);
        if (bad && (code != TOUCH_BAD || memcmp(&kept, &t, sizeof t)))
            return 3;
        if (!bad && code == TOUCH_LONG) {
            if (t.seen != LONGEST || memcmp(&kept, &t, sizeof t))
                return 4;
            touch_init(&t);
            continue;
        }
        if (!bad && code < 0)
            return 5;
        if (n % 11 == 5 && t.seen) {
            int label = touch_label(&t, proba, n % 2 ? &settled : 0);
            float sum = 0;
            if (label < 0 || label >= CLASSES || !touch_name(label)[0])
                return 6;
            for (int c = 0; c < CLASSES; c++) {
                if (!(proba[c] >= 0 && proba[c] <= proba[label]))
                    return 7;
                sum += proba[c];
            }
            if (!(fabsf(sum - 1) < 1e-3f))
                return 8;
        }
        if (n % 500 == 499)
            touch_init(&t);
    }
    return touch_name(-1)[0] || touch_name(CLASSES)[0];
}
"""


@pytest.mark.parametrize("name", ["reflex", "lda scaled", "bayes", "svm", "rf", "xgb", "hughes2017_cnn"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_bad_input_is_a_code_and_nothing_is_undefined(name, compiler, tmp_path):
    if lacking(compiler):
        pytest.skip(lacking(compiler))
    folder = written(made(name, stopping=name == "bayes"), tmp_path / "c", 8)
    (folder / "all.c").write_text(ALL)
    checked = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"] if compiler == "gcc" else []
    flags = [*STRICT, *checked]  # clang has its sanitizers in a package of their own
    subprocess.run([compiler, *flags, "all.c", "-lm", "-o", "all"], cwd=folder, check=True, capture_output=True)
    done = subprocess.run(["./all"], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def saved(tmp_path, model, corpus, stopping=True):
    import mlflow

    found = fitted(model, corpus, stopping)
    with quiet():
        mlflow.pyfunc.save_model(str(tmp_path / "rec"), **found.model([], corpus[0][:2]))
    return found


def lines_of(corpus, captures):
    """Frames as text, a blank line behind each capture."""
    text = ["\n".join(" ".join(map(str, f)) for f in corpus[i].reshape(corpus.lengths[i], -1)) for i in captures]
    return "\n\n".join(text) + "\n"


def test_the_program_prints_what_bench_stream_prints(tmp_path, monkeypatch, capsys):
    corpus = touched()
    saved(tmp_path, SYSTEMS["lda"](), corpus)
    assert main(["export", "rec", "out=c"]) == 0
    assert "next: make -C c check" in capsys.readouterr().out
    subprocess.run(["make", "-C", "c", "CC=gcc"], check=True, capture_output=True)
    shorter = [i for i in range(len(corpus)) if corpus.lengths[i] < corpus.lengths.max()][:5]
    text = lines_of(corpus, shorter)
    printed = subprocess.run(["c/touch"], input=text, capture_output=True, text=True, check=True).stdout
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text.encode())))
    assert main(["stream", "source=-", "model=rec"]) == 0
    mine, theirs = ([line.split(",") for line in out.splitlines()] for out in (printed, capsys.readouterr().out))
    assert [row[:3] + row[4:] for row in mine] == [row[:3] + row[4:] for row in theirs]
    np.testing.assert_allclose(*([float(row[3]) for row in rows[1:]] for rows in (mine, theirs)), atol=0.01)
    large = " ".join(["2000"] * 35)
    for wrong, told in (("1 2\n", "send 35 decimal numbers"), ("x\n", "send"), (large, "out of range")):
        done = subprocess.run(["c/touch"], input=wrong, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and "line 1: " in done.stderr and told in done.stderr


def test_where_no_saving_was_found_nothing_is_settled(tmp_path, monkeypatch, capsys):
    import mlflow

    corpus = touched()
    found = fitted(SYSTEMS["bayes"](), corpus, stopping=True)
    found.stopping = replace(found.stopping, threshold=float("inf"))
    with quiet():
        mlflow.pyfunc.save_model(str(tmp_path / "rec"), **found.model([], corpus[0][:2]))
    assert main(["export", "rec", "out=c"]) == 0
    assert "no saving found" in capsys.readouterr().out
    header = (tmp_path / "c/touch.h").read_text()
    assert "define TOUCH_THRESHOLD" not in header and "#define TOUCH_STOPPING 0" in header
    label, proba, settled, _ = built(found, tmp_path / "asked")(corpus[0])
    assert settled == 0 and proba.max() == pytest.approx(found.decision(corpus[:1], None)[1], abs=0.02)  # calibrated
    subprocess.run(["make", "-C", "c", "CC=gcc"], check=True, capture_output=True)
    text = lines_of(corpus, [0])
    printed = subprocess.run(["c/touch"], input=text, capture_output=True, text=True, check=True).stdout
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text.encode())))
    assert main(["stream", "source=-", "model=rec"]) == 0
    said = capsys.readouterr()
    assert "no saving found" in said.err
    for out in (printed, said.out):
        assert {line.split(",")[4] for line in out.splitlines()[1:]} == {"-"}


@pytest.mark.skipif(bool(lacking("make", "gcc", "awk")), reason=lacking("make", "gcc", "awk"))
def test_make_check_is_strict_and_quiet(tmp_path):
    folder = written(made("bayes", stopping=True), tmp_path / "c")
    done = subprocess.run(["make", "-C", str(folder), "check", "CC=gcc"], capture_output=True, text=True, check=True)
    assert "2," in done.stdout and done.stderr == ""
    code = (folder / "touch.c").read_text()
    assert "t->total[t->seen] = total;" in code
    (folder / "touch.c").write_text(code.replace("t->total[t->seen] = total;", "t->total[t->seen + LONGEST] = total;"))
    done = subprocess.run(["make", "-C", str(folder), "check", "CC=gcc"], capture_output=True, text=True, check=False)
    assert done.returncode and "runtime error" in done.stderr


ARM = ("arm-none-eabi-gcc", "qemu-system-arm", "make")


@pytest.mark.live
@pytest.mark.skipif(bool(lacking(*ARM)), reason=lacking(*ARM))
def test_a_cortex_m4_prints_what_this_machine_prints(tmp_path):
    corpus = touched()
    folder = written(made("reflex"), tmp_path / "c", 8)
    subprocess.run(["make", "-C", str(folder), "touch", "chip", "CC=gcc"], check=True, capture_output=True)
    text = lines_of(corpus, range(0, 12, 3))
    here = subprocess.run([folder / "touch"], input=text, capture_output=True, text=True, check=True).stdout
    chip = ["qemu-system-arm", "-machine", "mps2-an386", "-cpu", "cortex-m4", "-nographic", "-monitor", "none"]
    chip += ["-serial", "none", "-semihosting-config", "enable=on,target=native", "-kernel", str(folder / "touch.elf")]
    there = subprocess.run(chip, input=text, capture_output=True, text=True, check=True, timeout=120).stdout
    assert there == here and len(here.splitlines()) > 10
    said = subprocess.run(
        ["make", "-s", "-C", folder, "flash", "count"], capture_output=True, text=True, check=True
    ).stdout
    numbers = [int(word) for word in said.replace(",", " ").split() if word.isdecimal()]
    code, tables, state, linked, mean, idle, most, both, stack = numbers
    arrays = made("reflex").estimator
    assert 0 < code < 20_000 and tables > arrays.whole_.system_.steps[-1][1].parameters_ and 0 < state < 32_000
    assert code + tables < linked < code + tables + 20_000
    assert idle < mean < most <= both and 100 < stack < 2000


@pytest.mark.live
@pytest.mark.skipif(bool(lacking(*ARM)), reason=lacking(*ARM))
def test_what_is_too_large_is_not_linked(tmp_path):
    rng = np.random.default_rng(0)
    corpus = touched()
    noise = corpus.changed(captures=corpus.captures.assign(gesture=rng.choice(list("abc"), len(corpus))))
    repeated = noise[np.repeat(np.arange(len(noise)), 3)]
    folder = written(fitted(et(Jung28(), trees=3000), repeated), tmp_path / "c")
    done = subprocess.run(["make", "-C", str(folder), "chip"], capture_output=True, text=True, check=False)
    first, *rest = done.stderr.splitlines()
    assert done.returncode and len(rest) <= 1  # what make says of it
    assert first.startswith("touch.elf does not fit: FLASH=256K is ")
    lost = int(re.search(r"FLASH=256K is (\d+) bytes too small; ", first)[1])
    for spare, fits in ((-1, False), (0, True)):  # kilobytes beyond the next whole one
        asked = ["make", "-C", str(folder), "chip", f"FLASH={256 + -(-lost // 1024) + spare}K"]
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        assert (done.returncode == 0) is fits
        assert (folder / "touch.elf").exists() is fits
    used, spare = (int(n) for n in re.search(r"and (\d+) of RAM, and (\d+) more of RAM", done.stdout).groups())
    assert (
        f"RAM=1K is {used + spare - 1024} bytes too small"
        in subprocess.run([*asked, "RAM=1K"], capture_output=True, text=True, check=False).stderr
    )


def test_what_has_no_c_is_one_line(tmp_path, capsys, monkeypatch):
    corpus = touched()
    saved(tmp_path, lda(TouchFeatures()), corpus, stopping=False)
    for arguments, said in {
        ("rec", "out=c"): "fit with model.window=1",
        ("rec",): "needs out=",
        ("out=c",): "give a model",
        ("rec", "out=c", "bits=16"): "bits=16: give 32 or 8",
        ("rec", "out=c", "target=rust"): "target=rust: give c99",
        ("rec", "out=c", "size=3"): "no such option",
        ("rec", "out=rec"): "there is something already",
        ("nothing", "out=c"): "not a saved model",
    }.items():
        assert main(["export", *arguments]) == 2
        told = "".join(capsys.readouterr())
        assert said in told and "Traceback" not in told and not Path("c").exists()
    for model, said in (
        (Recipe(lda(TouchFeatures()), window=0.4, hop=0.1), "leave model.hop= out"),
        (lda(Jung28(area="capture")), "Jung28 has no C"),
    ):
        with pytest.raises(InputError, match=said):
            written(fitted(clone(model), corpus), tmp_path / "d")
