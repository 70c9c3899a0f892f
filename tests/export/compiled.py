"""Exported C as a library that tests can ask."""

import ctypes
import re
import shutil
import subprocess

import numpy as np

from bench.export.write import files_of
from bench.work.replay import Replay, learned
from bench.work.saved import Recogniser

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-O1")
ASKED = """#include "touch.c"
#include <stdlib.h>
int asked(const float *frames, int n, float *proba, float *settled, float *features)
{
    touch_t *t = malloc(sizeof *t);
    int label = touch_init(t);
    for (int i = 0; i < n && label >= 0; i++)
        label = touch_push(t, frames + (long)i * TAXELS);
    if (label >= 0)
        label = touch_label(t, proba, settled);
    memcpy(features, t->features, sizeof t->features);
    free(t);
    return label;
}
"""


def written(found, folder, bits=32):
    """The files of a system in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files_of(found, bits, "a test").items():
        (folder / name).write_text(text)
    return folder


def in_double(text):
    """C of single precision in double: types, functions and constants, pi in full."""
    text = re.sub(r"\bfloat\b", "double", text)
    text = re.sub(r"\b(sqrt|log|exp|fabs|fmax|fmin|cos|sin)f\b", r"\1", text)
    text = re.sub(r"(?<![\w.])(\d+\.?\d*(?:e-?\d+)?)f\b", r"\1", text)
    return text.replace("#define PI 3.1415927", f"#define PI {np.pi!r}")


def built(found, folder, bits=32, precision=np.float32):
    """A function from frames to label, probabilities, how settled, and features."""
    written(found, folder, bits)
    (folder / "asked.c").write_text(ASKED)
    if precision is np.float64:
        for path in (folder / name for name in ("asked.c", "touch.c", "touch.h", "tables.h")):
            path.write_text(in_double(path.read_text()))
    library = folder / "asked.so"
    call = ["gcc", *STRICT, "-shared", "-fPIC", str(folder / "asked.c"), "-lm", "-o", str(library)]
    subprocess.run(call, check=True, capture_output=True, text=True)
    run = ctypes.CDLL(str(library)).asked
    floats = ctypes.POINTER(ctypes.c_float if precision is np.float32 else ctypes.c_double)

    def asked(frames):
        given = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=precision)
        proba, settled, features = (np.zeros(n, precision) for n in (len(found.classes), 1, 2000))
        told = [a.ctypes.data_as(floats) for a in (given, proba, settled, features)]
        return run(told[0], len(given), *told[1:]), proba, float(settled[0]), features

    return asked


def fitted(model, corpus, stopping=False):
    """A saved system, as `bench fit` makes one."""
    taught = learned(lambda: model, corpus, np.arange(len(corpus)), Replay())[0] if stopping else None
    return Recogniser(model.fit(corpus, corpus.gestures), corpus, taught)


def lacking(*programs):
    """Which programs are not installed, in words; nothing if all are."""
    missing = [name for name in programs if shutil.which(name) is None]
    return f"{', '.join(missing)} not installed" if missing else ""
