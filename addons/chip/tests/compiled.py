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
from bench.features.touch_profiles import TouchProfiles
from bench.models.classic.bayes import bayes
from bench.models.classic.lda import lda
from bench.models.classic.perceptron import Perceptron, perceptron
from bench.models.classic.rf import et, rf
from bench.models.classic.softmax import softmax
from bench.models.classic.svm import svm
from bench.models.classic.xgb import xgb
from bench.models.nets.hughes2017 import Hughes2017CNN
from bench.models.recipe import Recipe
from bench.models.reflex import Reflex
from bench.running.replay import learn_stopping_rule
from bench.running.saved import Recogniser
from touchbench_chip.write import write_c_sources
from touchbench_people.adaptation import adapt_system
from touchbench_people.scaler import adaptable

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-ffp-contract=off", "-O1")
HERE = Path(__file__).parent
WINDOW = {"window": 0.4, "repair": ("stuck", "dead")}
SYSTEMS = {
    "reflex": lambda: Reflex(units=6, copies=1, window=0.4, early=0.2),
    "lda": lambda: Recipe(lda(TouchFeatures()), **WINDOW),
    "lda denoised": lambda: Recipe(lda(TouchFeatures()), window=0.4, repair=("dead", "noise")),
    "lda on profiles": lambda: Recipe(lda(TouchProfiles()), **WINDOW),
    "lda scaled": lambda: Recipe(
        lda(TouchFeatures()), window=0.4, repair=("offset",), scale="peak"
    ),
    "perceptron": lambda: Recipe(perceptron(TouchFeatures(), units=6, updates=200), **WINDOW),
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
STOPPING = {"lda", "bayes"}  # in 32 bits they learn when to decide, too


class Answer(NamedTuple):
    """Output of the C for a capture: label or code, probabilities after each frame, and more."""

    label: int
    proba: np.ndarray
    settled: float
    features: np.ndarray
    ready: np.ndarray


def describe_missing(*programs):
    """Name programs that are not installed; empty if all are."""
    missing = [name for name in programs if shutil.which(name) is None]
    return f"{', '.join(missing)} not installed" if missing else ""


def write_files(recogniser, folder, bits=32, prefix="touch"):
    """Write the C files of a system into a folder, which is returned."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in write_c_sources(recogniser, bits, "a test", prefix).items():
        (folder / name).write_text(text)
    return folder


def to_double_precision(text):
    """Change C to double precision: types, functions and constants, pi in full."""
    text = re.sub(r"\bfloat\b", "double", text)
    text = re.sub(r"\b(sqrt|log|exp|fabs|fmax|fmin|cos|sin)f\b", r"\1", text)
    text = re.sub(r"(?<![\w.])(\d+\.?\d*(?:e-?\d+)?)f\b", r"\1", text)
    return text.replace("#define PI 3.1415927", f"#define PI {np.pi!r}")


def load_library(folder, text):
    """Compile C that includes the exported C of a folder, and load it."""
    (folder / "library.c").write_text(text)
    call = ["gcc", *STRICT, "-shared", "-fPIC", "library.c", "-lm", "-o", "library.so"]
    subprocess.run(call, cwd=folder, check=True, capture_output=True, text=True)
    return ctypes.CDLL(str(folder / "library.so"))


class Library:
    """The compiled C of a system; a call with frames returns an `Answer`."""

    def __init__(self, recogniser, bits=32, precision=np.float32):
        self.classes, self.precision = len(recogniser.classes), precision
        with tempfile.TemporaryDirectory() as name:
            folder = write_files(recogniser, Path(name), bits)
            change = to_double_precision if precision is np.float64 else str
            for path in (folder / name for name in ("touch.c", "touch.h", "tables.h")):
                path.write_text(change(path.read_text()))
            self.code = load_library(folder, change((HERE / "library.c").read_text()))

    def __call__(self, frames, every=False):
        n = len(frames)
        values = np.ascontiguousarray(frames.reshape(n, -1), dtype=self.precision)
        proba, settled, features = (
            np.zeros(size, self.precision) for size in ((n, self.classes), 1, 2000)
        )
        ready = np.zeros(n, np.int32)
        point = [
            a.ctypes.data_as(ctypes.c_void_p) for a in (values, proba, settled, features, ready)
        ]
        label = self.code.library(point[0], n, int(every), *point[1:])
        return Answer(label, proba, float(settled[0]), features, ready)


def fit_recogniser(model, corpus, stopping=False):
    """Fit a system to save; the network inside reflex is trained for a shorter time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "bench.models.out_of_distribution.Perceptron", partial(Perceptron, updates=300)
        )
        taught = (
            learn_stopping_rule(lambda: model, corpus, np.arange(len(corpus)))[0]
            if stopping
            else None
        )
        return Recogniser(model.fit(corpus, corpus.gestures), corpus, taught)


@cache
def touch_corpus(rows=5, cols=7, rate_hz=40.0, classes=3):
    """Captures of a few gestures of four generated people; some taxels are dead or stuck."""
    corpus = generate(subjects=4, rows=rows, cols=cols, rate_hz=rate_hz, variants=("normal",))
    names = sorted(set(corpus.gestures))[2 : 2 + classes]
    part = corpus[np.flatnonzero(np.isin(corpus.gestures, names))].detach()
    frames = part.frames.copy()
    for i in range(0, len(part), 4):
        frames[part.starts[i] : part.starts[i] + part.lengths[i], 1, 2] = 1023 if i % 8 else 0
    return part.with_fields(frames=frames)


@cache
def fit_system(name, stopping=False):
    """Fit one of `SYSTEMS`, once for all tests."""
    recogniser = fit_recogniser(SYSTEMS[name](), touch_corpus(), stopping)
    if name == "a person":
        captures = touch_corpus()[touch_corpus().subjects == "2"]
        recogniser.estimator = adapt_system(recogniser.estimator, captures, captures.gestures)
    return recogniser


@cache
def compile_system(name, bits):
    """Compile the C of one of `SYSTEMS`, once for all tests."""
    return Library(fit_system(name, name in STOPPING and bits == 32), bits)
