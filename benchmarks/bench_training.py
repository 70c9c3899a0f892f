"""Training throughput of every network against a plain eager loop, in turn, on the same threads.

The plain loop uses the same network with ordinary layers, a `DataLoader` over a `TensorDataset` of
all windows, sequences padded to the longest, and PyTorch's optimiser. Each network must first give
the same logits in both forms, so equal steps give equal accuracy. The corpora are generated:
captures like CoST's, or of 432 frames at 54 Hz like HAART's. On a busy machine, use the ratio of
processor time.

    python benchmarks/bench_training.py [system ...] [threads=1] [rounds=5] [precision=bfloat16]
"""

import copy
import sys
import time
from functools import partial

import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader, TensorDataset

from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.models.nets.cnn85 import CNN85, SelectiveSGD
from bench.models.nets.hughes2017 import (
    COST,
    Hughes2017,
    Hughes2017AERNN,
    Hughes2017CNN,
    Hughes2017CNNRNN,
)
from bench.models.nets.ren2023 import Ren2023Transformer
from bench.models.nets.taxel_major import run_taxel_major
from bench.models.nets.time_blocks import TimeConv3d
from bench.models.nets.training import Optimiser, Schedule, Sequences, train_network
from bench.models.nets.window import WindowNet
from bench.models.nets.zhou2016 import Zhou2016CNN2D, Zhou2016CNN3D, Zhou2016GMLSTM, Zhou2016LRCN

SGD = partial(torch.optim.SGD, lr=0.05, momentum=0.9)
RMSPROP = partial(torch.optim.RMSprop, lr=1e-4)
# The system, its optimiser, and the size of its corpus: subjects and repetitions of CoST-like
# captures, or the number of HAART-like ones.
SYSTEMS = {
    "cnn85": (CNN85, SGD, (8, 4)),
    "hughes2017_cnn": (Hughes2017CNN, RMSPROP, (4, 1)),
    "hughes2017_cnn_rnn": (Hughes2017CNNRNN, RMSPROP, (4, 1)),
    "hughes2017_ae_rnn": (Hughes2017AERNN, RMSPROP, (10, 1)),
    "zhou2016_3dcnn": (Zhou2016CNN3D, partial(torch.optim.Adam, lr=1e-3), 96),
    "zhou2016_2dcnn": (Zhou2016CNN2D, partial(torch.optim.Adam, lr=1e-3), 96),
    "zhou2016_lrcn": (Zhou2016LRCN, partial(torch.optim.Adam, lr=1e-3), 96),
    "zhou2016_gm_lstm": (Zhou2016GMLSTM, partial(torch.optim.Adam, lr=1e-3), 320),
    "ren2023_transformer": (Ren2023Transformer, partial(torch.optim.Adam, lr=1e-4), 43),
}


class Padded(nn.Module):
    """Map windows [batch, steps, frames, rows, cols] to logits [batch, classes, steps]."""

    def __init__(self, encoder: nn.Module, rnn: nn.RNN, head: nn.Module) -> None:
        super().__init__()
        self.encoder, self.rnn, self.head = encoder, rnn, head

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Logits of every step, padded ones included."""
        encoded = self.encoder(x.flatten(0, 1)).unflatten(0, x.shape[:2])
        return self.head(self.rnn(encoded)[0]).transpose(1, 2)


def with_library_layers(net: nn.Module) -> nn.Module:
    """A copy of a network with the library's layers in place of our own."""
    net = copy.deepcopy(net).to(memory_format=torch.contiguous_format)
    if hasattr(net, "within"):
        rnn = nn.RNN(net.into.in_features, net.units, batch_first=True)
        weights = (net.into.weight, net.within.weight, net.into.bias, torch.zeros(net.units))
        with torch.no_grad():
            for ours, theirs in zip(rnn.parameters(), weights, strict=True):
                ours.copy_(theirs)
        return Padded(with_library_layers(net.encoder), rnn, net.head)
    if isinstance(net[0], TimeConv3d):
        conv = nn.Conv3d(1, net[0].out_channels, net[0].kernel_size)
        conv.load_state_dict(net[0].state_dict())
        return nn.Sequential(nn.Unflatten(1, (1, -1)), conv, *net[1:])
    return net


def padded_dataset(samples: object, target: np.ndarray) -> TensorDataset:
    """All samples as one tensor, sequences and their labels padded."""
    labels = torch.from_numpy(target)
    if not isinstance(samples, Sequences):
        return TensorDataset(samples.make_batch(np.arange(len(samples))).contiguous(), labels)
    windows, steps = samples.make_batch(np.arange(len(samples)))
    is_step = torch.arange(int(steps.max())) < steps[:, None]
    x = torch.zeros(*is_step.shape, *windows.shape[1:])
    x[is_step] = windows
    return TensorDataset(x, torch.where(is_step, labels[:, None], -100))


def train_plainly(net: nn.Module, optimiser: torch.optim.Optimizer, loader: DataLoader) -> None:
    """One epoch of the plain loop."""
    criterion = nn.CrossEntropyLoss()
    net.train()
    for x, y in loader:
        optimiser.zero_grad()
        loss = criterion(net(x), y)
        loss.backward()
        optimiser.step()
        loss.item()


def generate_haart_like(captures: int) -> Corpus:
    """Captures of 432 frames at 54 Hz; generated ones are repeated up to there."""
    corpus = generate(subjects=-(-captures // 42), rate_hz=54.0)[:captures]
    frames = [np.resize(capture, (432, *corpus.grid)) for capture in corpus]
    return Corpus.from_captures(frames, corpus.captures, 54.0, full_scale=corpus.full_scale)


def compare_loops(name: str, threads: int, rounds: int, precision: str = "") -> None:
    """Print samples per second of each round, and the medians of their ratios.

    A precision is that of our loop alone.
    """
    torch.manual_seed(0)
    system, optimiser, size = SYSTEMS[name]
    corpus = generate_haart_like(size) if isinstance(size, int) else generate(*size)
    model: WindowNet = system(**({"precision": precision} if precision else {}))
    if isinstance(model, Hughes2017):
        model.design_ = COST
    samples = model.samples(corpus)
    classes, target = np.unique(corpus.gestures, return_inverse=True)
    target = target[samples.capture]
    net = model.network(*corpus.grid, len(classes))
    first = samples.make_batch(np.arange(2))
    net.eval()(first)
    theirs = with_library_layers(net)
    data = padded_dataset(samples, target)
    forward = partial(
        run_taxel_major if name == "cnn85" and not precision else model.compute_logits, net
    )
    with torch.inference_mode():
        expected = theirs.eval()(data.tensors[0][:2])
        if isinstance(samples, Sequences):
            expected = expected.transpose(1, 2)[data.tensors[1][:2] >= 0]
        rtol, atol = (0.05, 0.05 * float(expected.abs().max())) if precision else (1e-3, 1e-4)
        torch.testing.assert_close(forward(first), expected, rtol=rtol, atol=atol)

    batch = min(model.batch, len(samples))
    loader = DataLoader(data, batch_size=batch, shuffle=True, drop_last=True)
    rate = optimiser.keywords["lr"]
    sgd = SelectiveSGD(net, (rate,)) if name == "cnn85" else Optimiser(optimiser(net.parameters()))
    sgd.before_epoch = lambda *_: None  # the others do not search their rate
    epochs = {
        "plain": partial(train_plainly, theirs, optimiser(theirs.parameters()), loader),
        "ours": partial(
            train_network, net, samples, target, sgd, Schedule(1, batch, seed=0), forward
        ),
    }
    count = len(samples) // batch * batch
    line = f"{name}: {len(samples)} samples, batches of {batch}, {threads} threads"
    print(f"{line}, torch {torch.__version__}", flush=True)
    speeds = {key: [] for key in epochs}
    for _ in range(rounds):
        for key, epoch in epochs.items():
            started = np.array([time.perf_counter(), time.process_time()])
            epoch()
            spent = np.array([time.perf_counter(), time.process_time()]) - started
            speeds[key].append(count / spent)
        print("", *(f"{key} {speeds[key][-1][0]:8.1f} /s" for key in epochs), sep="  ", flush=True)
    wall, cpu = np.median(np.array(speeds["ours"]) / np.array(speeds["plain"]), axis=0)
    print(f"  ours over plain: {wall:.2f} (processor time {cpu:.2f})", flush=True)


def main(*arguments: str) -> None:
    """Compare the systems that are named, or all."""
    options = dict(a.split("=") for a in arguments if "=" in a)
    threads = int(options.get("threads", 1))
    torch.set_num_threads(threads)
    for name in [a for a in arguments if "=" not in a] or SYSTEMS:
        compare_loops(name, threads, int(options.get("rounds", 5)), options.get("precision", ""))


if __name__ == "__main__":
    main(*sys.argv[1:])
