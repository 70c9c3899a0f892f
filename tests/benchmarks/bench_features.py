"""Feature extraction on one thread: corpora of CoST's size in time and memory, and one capture of 200 frames.

The generated corpus is what the sensor sees; in the random one a quarter of the values may be a spatial peak, which is
as slow as it gets.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_features.py
"""

import resource
import time

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench.corpora.synth import generate
from bench.corpus import Corpus
from features.jung28 import Jung28
from features.jung54 import Jung54


def random_corpus(captures: int = 7805, frames: int = 1_500_000) -> Corpus:
    """Ragged captures of random values 0..990 on 8 x 8, at least 10 frames each."""
    rng = np.random.default_rng(0)
    lengths = rng.lognormal(5, 0.7, captures)
    lengths = np.clip(lengths * frames / lengths.sum(), 10, 1747).astype(np.int64)
    values = rng.integers(0, 991, (lengths.sum(), 8, 8), dtype=np.uint16)
    about = pd.DataFrame({"subject": ["1"] * captures, "gesture": ["pat"] * captures})
    return Corpus(values, np.cumsum(lengths) - lengths, lengths, about, 135.0)


def peak_mib() -> float:
    """High-water mark of this process so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10


def main() -> None:
    """Print seconds and added memory per corpus, and milliseconds per capture, of each set."""
    makers = {"random": random_corpus, "generated": lambda: generate(subjects=31, repetitions=6)}
    for name, make in makers.items():  # random first: the peak of generating would hide what is added
        corpus = make()
        long = int(np.flatnonzero(corpus.lengths >= 200)[0])
        one = Corpus.from_captures([corpus[long][:200]], corpus.captures[:1], corpus.rate_hz)
        print(f"{name}: {len(corpus)} captures, {len(corpus.frames)} frames, {corpus.frames.nbytes / 2**20:.0f} MiB")
        for features in (Jung28(), Jung54()):
            before, started = peak_mib(), time.perf_counter()
            features.transform(corpus)
            seconds, added = time.perf_counter() - started, peak_mib() - before
            times = []
            for _ in range(300):
                started = time.perf_counter()
                features.transform(one)
                times.append(time.perf_counter() - started)
            print(
                f"  {type(features).__name__}: {seconds:.2f} s, peak memory +{added:.0f} MiB; "
                f"one capture {1000 * np.median(times):.2f} ms (median)"
            )


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
