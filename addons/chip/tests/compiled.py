"""Exported C as a library that tests call, and the small systems that they export."""

import ctypes
import re
import shutil
import subprocess
import tempfile
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from bench.corpora.synth import generate
from bench.features.jung28 import Jung28
from bench.features.touch import TouchFeatures
from bench.models.classic.bayes import bayes
from bench.models.classic.lda import lda
from bench.models.classic.perceptron import Perceptron
from bench.models.classic.rf import et, rf
from bench.models.classic.softmax import softmax
from bench.models.classic.svm import svm
from bench.models.classic.xgb import xgb
from bench.models.nets.hughes2017 import Hughes2017CNN
from bench.models.recipe import Recipe
from bench.models.reflex import Reflex
from bench.models.sizes import sizes
from bench.work.replay import learned
from bench.work.saved import Recogniser
from touchbench_chip.tables import chip_of
from touchbench_chip.write import files_of
from touchbench_people.adaptation import adapted
from touchbench_people.scaler import adaptable

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-O1")
LIBRARY = """#include "touch.c"
static touch_t t;
int state_bytes(void) { return sizeof t; }
int library(const float *frames, int n, int every, float *proba, float *settled, float *features, int *ready)
{
    int label = touch_init(&t);
    for (int i = 0; i < n && label >= 0; i++) {
        label = ready[i] = touch_push(&t, frames + (long)i * TAXELS);
        if (label >= 0 && (every || i == n - 1))
            label = touch_label(&t, proba + (long)i * CLASSES, settled);
    }
    memcpy(features, t.features, sizeof t.features);
    return label;
}
"""
ABUSE = """#include "touch.c"
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
WINDOW = {"window": 0.4, "repair": ("stuck", "dead")}
SYSTEMS = {
    "reflex": lambda: Reflex(units=6, copies=1, window=0.4, early=0.2),
    "lda": lambda: Recipe(lda(TouchFeatures()), **WINDOW),
    "lda scaled": lambda: Recipe(lda(TouchFeatures()), window=0.4, repair=("offset",), scale="peak"),
    "softmax on jung28": lambda: softmax(Jung28()),
    "bayes": lambda: bayes(Jung28()),
    "svm": lambda: svm(Jung28()),
    "linear svm, z": lambda: svm(Jung28(), C=1.0, kernel="linear", scaling="z"),
    "rf": lambda: rf(Jung28(), trees=9),
    "et": lambda: Recipe(et(TouchFeatures(), trees=5), window=0.4),
    "xgb": lambda: xgb(Jung28(), trees=5),
    "hughes2017_cnn": lambda: Recipe(Hughes2017CNN(epochs=4, rate=1e-3), repair=("stuck", "dead")),
    "windows of a frame": lambda: Recipe(rf(TouchFeatures(), trees=9), window=0.02),
    "a person": lambda: adaptable(Jung28()),
}
STOPPING = {"lda", "bayes"}  # learn when to decide, too
SAME_IN_8_BITS = {"lda", "lda scaled", "softmax on jung28", "bayes"}  # Python computes what C does


class Answer(NamedTuple):
    """What the C says of a capture: label or code, probabilities after each frame, and so on."""

    label: int
    proba: np.ndarray
    settled: float
    features: np.ndarray
    ready: np.ndarray


def lacking(*programs):
    """Which programs are not installed, in words; nothing if all are."""
    missing = [name for name in programs if shutil.which(name) is None]
    return f"{', '.join(missing)} not installed" if missing else ""


def written(recogniser, folder, bits=32):
    """The files of a system in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files_of(recogniser, bits, "a test").items():
        (folder / name).write_text(text)
    return folder


def in_double(text):
    """C of single precision in double: types, functions and constants, pi in full."""
    text = re.sub(r"\bfloat\b", "double", text)
    text = re.sub(r"\b(sqrt|log|exp|fabs|fmax|fmin|cos|sin)f\b", r"\1", text)
    text = re.sub(r"(?<![\w.])(\d+\.?\d*(?:e-?\d+)?)f\b", r"\1", text)
    return text.replace("#define PI 3.1415927", f"#define PI {np.pi!r}")


class Library:
    """The C of a system, compiled; called with frames, it gives an `Answer`, also after every frame."""

    def __init__(self, recogniser, bits=32, precision=np.float32):
        self.classes, self.precision = len(recogniser.classes), precision
        with tempfile.TemporaryDirectory() as name:
            folder = written(recogniser, Path(name), bits)
            (folder / "library.c").write_text(LIBRARY)
            if precision is np.float64:
                for path in (folder / name for name in ("library.c", "touch.c", "touch.h", "tables.h")):
                    path.write_text(in_double(path.read_text()))
            call = ["gcc", *STRICT, "-shared", "-fPIC", "library.c", "-lm", "-o", "library.so"]
            subprocess.run(call, cwd=folder, check=True, capture_output=True, text=True)
            self.code = ctypes.CDLL(str(folder / "library.so"))

    def __call__(self, frames, every=False):
        n = len(frames)
        values = np.ascontiguousarray(frames.reshape(n, -1), dtype=self.precision)
        proba, settled, features = (np.zeros(size, self.precision) for size in ((n, self.classes), 1, 2000))
        ready = np.zeros(n, np.int32)
        point = [a.ctypes.data_as(ctypes.c_void_p) for a in (values, proba, settled, features, ready)]
        label = self.code.library(point[0], n, int(every), *point[1:])
        return Answer(label, proba, float(settled[0]), features, ready)


def fitted(model, corpus, stopping=False):
    """A saved system, as `bench fit` makes one; the network inside reflex learns for a shorter time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.models.out_of_distribution.Perceptron", partial(Perceptron, updates=300))
        taught = learned(lambda: model, corpus, np.arange(len(corpus)))[0] if stopping else None
        return Recogniser(model.fit(corpus, corpus.gestures), corpus, taught)


@cache
def touched(rows=5, cols=7, rate_hz=40.0, classes=3):
    """Four people who press here or there, for long or short, hard or not; some taxels are dead or stuck."""
    corpus = generate(subjects=4, rows=rows, cols=cols, rate_hz=rate_hz, variants=("normal",))
    names = sorted(set(corpus.gestures))[2 : 2 + classes]
    part = corpus[np.flatnonzero(np.isin(corpus.gestures, names))].detached()
    frames = part.frames.copy()
    for i in range(0, len(part), 4):
        frames[part.starts[i] : part.starts[i] + part.lengths[i], 1, 2] = 1023 if i % 8 else 0
    return part.changed(frames=frames)


@cache
def made(name, stopping=False):
    """A system, fitted once for all tests."""
    recogniser = fitted(SYSTEMS[name](), touched(), stopping)
    if name == "a person":
        captures = touched()[touched().subjects == "2"]
        recogniser.estimator = adapted(recogniser.estimator, captures, captures.gestures)
    return recogniser


def check_agreement(name, bits):
    """C labels and weighs as Python does; what is counted of tables and state is what is written."""
    corpus, recogniser = touched(), made(name, name in STOPPING)
    library = Library(recogniser, bits)
    table = recogniser.label(corpus)
    expected = table.filter(like="p_").to_numpy()
    answers = [library(frames) for frames in corpus]
    proba = np.array([answer.proba[-1] for answer in answers])
    labels = np.array([recogniser.classes[answer.label] for answer in answers])
    second, first = np.sort(expected, axis=1)[:, -2:].T
    close = 0.02 if bits == 32 else 0.2
    assert (labels == table["label"])[first - second > 2 * close].all() and (labels == table["label"]).mean() > 0.9
    assert np.median(np.abs(proba - expected).max(axis=1)) < close / 4
    for i in (0, 5) if recogniser.stopping is not None else ():
        _, confidence, settled = recogniser.decision(corpus[i : i + 1], None)
        assert answers[i].settled == pytest.approx(settled, abs=2 * close)
        assert proba[i].max() == pytest.approx(confidence, abs=2 * close)


def check_sizes(name, bits):
    """What is counted of tables and state is what is written, and Python in 8 bits computes what C does."""
    corpus, system = touched(), SYSTEMS[name]()
    library, plain = Library(made(name), bits), made(name)
    if bits == 8:
        system = system.set_params(bits=8) if "bits" in system.get_params() else Recipe(system, bits=8)
        plain = fitted(system, corpus)
        expected = plain.label(corpus).filter(like="p_").to_numpy()
        apart = np.abs([library(frames).proba[-1] for frames in corpus] - expected).max(axis=1)
        assert np.median(apart) < 1e-4 and np.quantile(apart, 0.95) < 0.01
    counted, chip = sizes(plain.estimator, 35, int(corpus.lengths.max())), chip_of(made(name), bits)
    parts = (chip, *chip.deciders.values())
    arrays = [a for part in parts for name, a in part.arrays.items() if name != "usual"]  # only linked if it is used
    assert counted["flash_bytes"] == pytest.approx(sum(a.nbytes for a in arrays), rel=0.1, abs=64)
    assert counted["ram_bytes"] == pytest.approx(library.code.state_bytes(), rel=0.1)


def check_bad_input(name, folder, compiler="gcc"):
    """What is no frame is a code and changes nothing, and nothing is undefined."""
    folder = written(made(name, stopping=name == "bayes"), folder, 8)
    (folder / "abuse.c").write_text(ABUSE)
    checked = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"] if compiler == "gcc" else []
    flags = [*STRICT, *checked]  # clang has its sanitizers in a package of their own
    subprocess.run([compiler, *flags, "abuse.c", "-lm", "-o", "abuse"], cwd=folder, check=True, capture_output=True)
    done = subprocess.run(["./abuse"], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
