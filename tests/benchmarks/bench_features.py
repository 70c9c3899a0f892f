"""Feature extraction on one thread: a generated corpus of CoST's size, and one capture of 200 frames.

OMP_NUM_THREADS=1 python tests/benchmarks/bench_features.py
"""

import time

import numpy as np

from bench.corpora.synth import generate
from bench.corpus import Corpus
from features.jung28 import Jung28
from features.jung54 import Jung54


def main() -> None:
    """Print seconds per corpus and milliseconds per capture of each set."""
    corpus = generate(subjects=31, repetitions=6)
    long = int(np.flatnonzero(corpus.lengths >= 200)[0])
    one = Corpus.from_captures([corpus[long][:200]], corpus.captures[:1], corpus.rate_hz)
    print(f"{len(corpus)} synthetic captures, {len(corpus.frames)} frames")
    for features in (Jung28(), Jung54()):
        started = time.perf_counter()
        features.transform(corpus)
        seconds = time.perf_counter() - started
        times = []
        for _ in range(200):
            started = time.perf_counter()
            features.transform(one)
            times.append(time.perf_counter() - started)
        print(f"{type(features).__name__}: {seconds:.2f} s, one capture {1000 * np.median(times):.2f} ms (median)")


if __name__ == "__main__":
    main()
