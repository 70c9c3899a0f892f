"""Generating touch: captures per second and peak memory at CoST's size.

python benchmarks/bench_synth.py
"""

import resource
import time

from bench.corpora.synth import generate


def main() -> None:
    """Print captures per second and the peak memory of the process in MiB."""
    started = time.perf_counter()
    corpus = generate(subjects=31, repetitions=6)
    seconds = time.perf_counter() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    print(f"{len(corpus)} captures in {seconds:.1f} s, {len(corpus) / seconds:.0f} captures/s, peak {peak:.0f} MiB")


if __name__ == "__main__":
    main()
