"""Training throughput of cnn85 against a plain eager PyTorch loop over the same network, in turn, on the same threads.

The plain loop is what one would write first: NCHW tensors, a `DataLoader` over all windows, `torch.optim.SGD`.

    python tests/benchmarks/bench_training.py [threads] [rounds]
"""

import os
import sys
import time
from functools import partial

import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader, TensorDataset

from bench.corpora.synth import generate
from models.cnn85 import CNN85, SelectiveSGD
from models.taxel_major import taxel_major
from models.training import train

BATCH = 250


def plain(net: nn.Module, loader: DataLoader) -> float:
    """Windows per second of one epoch of the plain loop."""
    optimiser = torch.optim.SGD(net.parameters(), lr=0.05, momentum=0.9)
    criterion = nn.CrossEntropyLoss()
    net.train()
    seen, started = 0, time.perf_counter()
    for x, y in loader:
        optimiser.zero_grad()
        loss = criterion(net(x), y)
        loss.backward()
        optimiser.step()
        loss.item()
        seen += len(x)
    return seen / (time.perf_counter() - started)


def ours(net: nn.Module, windows: object, target: np.ndarray) -> float:
    """Windows per second of one epoch of the project's loop, without the search of the rate."""
    sgd = SelectiveSGD(net, (0.05,))
    started = time.perf_counter()
    train(net, windows, target, sgd, epochs=1, batch=BATCH, seed=0, forward=partial(taxel_major, net))
    return len(windows) // BATCH * BATCH / (time.perf_counter() - started)


def main(threads: int = 1, rounds: int = 5) -> None:
    """Print both throughputs of each round and their ratio."""
    torch.set_num_threads(threads)
    corpus = generate(subjects=8, repetitions=4)
    model = CNN85()
    windows = model.samples(corpus)
    target = np.unique(corpus.gestures, return_inverse=True)[1][windows.capture]
    nets = [model.network(8, 8, 14) for _ in range(2)]
    for net in nets:
        net(windows.batch(np.arange(1)))
    x = windows.batch(np.arange(len(windows))).contiguous()
    loader = DataLoader(TensorDataset(x, torch.from_numpy(target)), batch_size=BATCH, shuffle=True, drop_last=True)
    print(f"{len(windows)} windows, {threads} threads, torch {torch.__version__}, {os.cpu_count()} cores")
    ratios = []
    for _ in range(rounds):
        a, b = plain(nets[0], loader), ours(nets[1], windows, target)
        ratios.append(b / a)
        print(f"plain {a:7.0f} windows/s   ours {b:7.0f} windows/s   ratio {b / a:.2f}", flush=True)
    print(f"median ratio {np.median(ratios):.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
