"""Milliseconds to decide on one sample from raw frames, and the peak memory of a fold on a corpus of CoST's size.

Each network is untrained, warm and on one thread; its sample is a whole window or sequence. Processor time is printed
beside wall time, for cores that others use too.

    python benchmarks/bench_windows.py [system ...]
    python benchmarks/bench_windows.py memory
"""

import sys
import tempfile
import time
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from bench_training import SYSTEMS, haart_like

from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.models.nets.hughes2017 import COST, Hughes2017, Hughes2017CNN
from bench.models.nets.training import probabilities

ROUNDS = 300


def latency(name: str) -> None:
    """Print percentiles of the time from raw frames to probabilities."""
    torch.manual_seed(0)
    system, _, size = SYSTEMS[name]
    model = system()
    corpus = haart_like(1) if isinstance(size, int) else generate(1)
    if isinstance(model, Hughes2017):
        model.design_ = COST
    longest = corpus[[int(corpus.lengths.argmax())]].detached()
    samples = model.samples(longest)
    one = Corpus.from_captures(
        [longest[0][samples.start[0] :][: samples.seen[0]]], longest.captures, longest.rate_hz, full_scale=1023.0
    )
    net = model.network(*one.grid, 14)
    net.eval()(samples.batch(np.arange(1)))
    decide = partial(model.logits, net)
    times = []
    for _ in range(ROUNDS):
        wall, cpu = time.perf_counter(), time.process_time()
        probabilities(net, model.samples(one), 1, decide)
        times.append((1000 * (time.perf_counter() - wall), 1000 * (time.process_time() - cpu)))
    wall, cpu = (np.percentile(column, (50, 95, 99)) for column in np.array(times[ROUNDS // 10 :]).T)
    steps = int(model.samples(one).steps[0])
    print(
        f"{name:22}{one.lengths[0]:5} frames{steps:4} steps   wall ms p50 {wall[0]:6.2f}  p95 {wall[1]:6.2f}  "
        f"p99 {wall[2]:6.2f}   processor ms p50 {cpu[0]:6.2f}  p95 {cpu[1]:6.2f}",
        flush=True,
    )


def peak_bytes() -> int:
    """Most memory that this process has held, pages of mapped files included (`ru_maxrss` would count its parent's)."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024


def fold(path: str, parts: tuple) -> None:
    """Train for one epoch on frames that are memory-mapped, and print the peak."""
    frames = np.load(path, mmap_mode="r")
    corpus = Corpus(frames, *parts, "synth")
    before = peak_bytes()
    model = Hughes2017CNN(epochs=1)
    model.fit(corpus, corpus.gestures)
    model.predict(corpus[:250])
    windows = len(model.samples(corpus))
    gib = [f"{n / 2**30:.2f}" for n in (peak_bytes(), before, frames.nbytes)]
    print(f"hughes2017_cnn: {len(corpus)} captures, {windows} windows of 45 frames")
    print(f"  GiB: peak {gib[0]}, before the fold {gib[1]}, corpus {gib[2]}")


def memory() -> None:
    """Run one fold of a network with overlapping windows in a process of its own."""
    corpus = generate(subjects=31, repetitions=6)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.npy"
        np.save(path, corpus.frames)
        parts = corpus.starts, corpus.lengths, corpus.captures, corpus.rate_hz, corpus.full_scale
        child = get_context("spawn").Process(target=fold, args=(str(path), parts))
        child.start()
        child.join()


if __name__ == "__main__":
    torch.set_num_threads(1)
    if sys.argv[1:] == ["memory"]:
        memory()
    else:
        for name in sys.argv[1:] or SYSTEMS:
            latency(name)
