"""What tests share: a data folder of their own, and small ragged corpora."""

import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small networks are slower on two threads than on one

import numpy as np
import pandas as pd
import pytest
from hypothesis import settings

from bench.corpora.corpus import Corpus

# The command in a process of its own. What a shell starts in the background ignores Ctrl-C, and so do its children.
BENCH = [
    sys.executable,
    "-c",
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from bench.cli import main; sys.exit(main())",
]

settings.register_profile("patient", parent=settings(), deadline=None)  # a busy machine is no failure
settings.load_profile("patient")


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    """No test reads or writes the user's data folder or store."""
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.chdir(tmp_path)


def random_corpus(subjects=4, per_class=3, gestures=("pat", "rub", "tap"), grid=(8, 8), longest=40, seed=0, **fields):
    """Captures of different lengths and levels, so that classes can be told apart but not perfectly."""
    rng = np.random.default_rng(seed)
    arrays, about = [], []
    for subject in range(1, subjects + 1):
        for c, gesture in enumerate(gestures):
            for repetition in range(1, per_class + 1):
                frames = int(rng.integers(1, longest))
                arrays.append(rng.poisson(20 + 60 * c + 5 * subject, (frames, *grid)).clip(0, 1023).astype(np.uint16))
                about.append((str(subject), gesture, repetition))
    captures = pd.DataFrame(about, columns=["subject", "gesture", "repetition"])
    return Corpus.from_captures(arrays, captures, 100.0, name="random", **fields)


def with_other_values(corpus, captures):
    """The same corpus with random values in some captures, to show that they are not looked at."""
    frames = corpus.frames.copy()
    for start, length in zip(corpus.starts[captures], corpus.lengths[captures], strict=True):
        frames[start : start + length] = np.random.default_rng(1).integers(0, 1023, (length, *corpus.grid))
    return type(corpus)(**{**vars(corpus), "frames": frames})


@pytest.fixture
def corpus():
    """4 subjects, 3 gestures, 36 captures of 1 to 39 frames on 8 x 8."""
    return random_corpus()
