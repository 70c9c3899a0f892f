"""Feature extraction on one thread: time and memory on corpora of CoST's size, and time for one capture.

The generated corpus is what the sensor sees; in the random one a quarter of the values may be a spatial peak, which is
the slowest case. Sets that learn are fitted first, which is not timed; hughes36 is fitted to one tenth of the corpus.

    OMP_NUM_THREADS=1 python benchmarks/bench_features.py
"""

import resource
import time
import warnings

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.features.balli import Balli
from bench.features.gaus import Gaus
from bench.features.hughes36 import Hughes36
from bench.features.jung28 import Jung28
from bench.features.jung54 import Jung54
from bench.features.ta273 import Ta273
from bench.features.wingerden45 import Wingerden45

SETS = (Jung28(), Jung54(), Wingerden45(), Ta273(), Balli(0), Gaus(), Hughes36())


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


def seconds_of(call: object, *arguments: object) -> float:
    """Wall seconds of one call."""
    started = time.perf_counter()
    call(*arguments)
    return time.perf_counter() - started


def main() -> None:
    """Print seconds and added memory per corpus, and milliseconds per capture, of each set."""
    makers = {"random": random_corpus, "generated": lambda: generate(subjects=31, repetitions=6)}
    for (
        name,
        make,
    ) in makers.items():  # random first: the peak of generating would hide what is added
        corpus = make()
        long = int(np.flatnonzero(corpus.lengths >= 200)[0])
        one = Corpus.from_captures([corpus[long][:200]], corpus.captures[:1], corpus.rate_hz)
        print(
            f"{name}: {len(corpus)} captures, {len(corpus.frames)} frames, {corpus.frames.nbytes / 2**20:.0f} MiB"
        )
        for features in SETS:
            part = corpus[::10] if isinstance(features, Hughes36) else corpus
            features.fit(part, part.gestures)
            before = peak_mib()
            seconds = seconds_of(features.transform, corpus)
            added = peak_mib() - before
            alone = np.median([seconds_of(features.transform, one) for _ in range(100)])
            print(
                f"  {type(features).__name__}: {seconds:.2f} s, peak memory +{added:.0f} MiB; "
                f"one capture {1000 * alone:.2f} ms (median)",
                flush=True,
            )


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    with threadpool_limits(1):
        main()
