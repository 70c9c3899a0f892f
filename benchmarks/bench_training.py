"""Training throughput of every network against a plain eager loop, in turn, on the same threads.

The plain loop uses the same network with ordinary layers, a `DataLoader` over a `TensorDataset` of
all windows, sequences padded to the longest, and PyTorch's optimiser. Each network must first give
the same logits in both forms, so equal steps give equal accuracy. The corpora are generated:
captures like CoST's, or of 432 frames at 54 Hz like HAART's. On a busy machine, use the ratio of
processor time.

    python benchmarks/bench_training.py [system ...] [threads=1] [rounds=5] [precision=bfloat16]

With a device it compares the way of a card: the product, the order of a processor on the same
device, a plain loop over windows on the device that never reads the loss, and a CUDA graph of its
step. It prints seconds per epoch and launches per step, then the time of all LOSO folds at once
and of one of them alone. On a processor, launches are the operations that compute or copy; a graph
needs a card.

    python benchmarks/bench_training.py device=cuda [system ...] [captures=746] [folds=10]
        [epochs=50] [rounds=5] [data=haart]
    python benchmarks/bench_training.py device=cpu captures=84 folds=3 epochs=1 rounds=1
"""

import copy
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.data import DataLoader, TensorDataset

import bench
from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.models.nets.cnn85 import CNN85, SelectiveSGD
from bench.models.nets.hughes2017 import (
    COST,
    Hughes2017,
    Hughes2017AERNN,
    Hughes2017CNN,
    Hughes2017CNNRNN,
    Recurrent,
)
from bench.models.nets.ren2023 import Ren2023Transformer
from bench.models.nets.taxel_major import run_taxel_major
from bench.models.nets.touchnet import TouchNet
from bench.models.nets.training import (
    Dropout,
    Optimiser,
    Schedule,
    Sequences,
    Training,
    train_alone,
    upload,
)
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

ON_DEVICE = {
    "cnn85": (CNN85, SGD),
    "hughes2017_cnn": (Hughes2017CNN, RMSPROP),
    "zhou2016_3dcnn": (Zhou2016CNN3D, partial(torch.optim.Adam, lr=1e-3)),
    "touchnet": (TouchNet, partial(torch.optim.AdamW, lr=4e-3)),
}
NO_LAUNCH = ("_unsafe_view", "detach", "lift_fresh", "_to_copy.meta")


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
    if isinstance(net, Recurrent):
        first, within = net.input_layer, net.recurrent_layer
        rnn = nn.RNN(first.in_features, net.units, batch_first=True)
        weights = (first.weight, within.weight, first.bias, torch.zeros(net.units))
        with torch.no_grad():
            for ours, theirs in zip(rnn.parameters(), weights, strict=True):
                ours.copy_(theirs)
        return Padded(with_library_layers(net.encoder), rnn, net.head)
    for layer in net.modules():
        for name, child in layer.named_children():
            if isinstance(child, Dropout):
                setattr(layer, name, nn.Dropout(child.p))
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
    sgd.before_epoch = lambda *_: ()  # the others do not search their rate
    schedule = Schedule(1, batch, seed=0)
    training = Training(net, samples, target, sgd, schedule, lambda _, x: forward(x))
    epochs = {
        "plain": partial(train_plainly, theirs, optimiser(theirs.parameters()), loader),
        "ours": lambda: train_alone(training.iterate(), 0),
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


class Operations(TorchDispatchMode):
    """Counts operations that compute or copy: what a card launches."""

    def __init__(self) -> None:
        super().__init__()
        self.counts = Counter()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        """Run an operation, and count it unless it is a view."""
        if not func.is_view and not str(func).startswith(tuple(f"aten.{n}" for n in NO_LAUNCH)):
            self.counts[str(func)] += 1
        return func(*args, **kwargs or {})


@contextmanager
def counted_launches(device: torch.device, counts: dict[str, int]):
    """Count launches meanwhile: kernels, copies and waits of a card, else operations."""
    if device.type != "cuda":
        with Operations() as operations:
            yield
        counts["operations"] = operations.counts.total()
        return
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    with torch.profiler.profile(activities=activities) as profile:
        yield
        torch.cuda.synchronize()
    events = profile.events()
    names = [e.name for e in events if e.device_type == torch.autograd.DeviceType.CUDA]
    counts["copies"] = sum(name.startswith(("Memcpy", "Memset")) for name in names)
    counts["kernels"] = len(names) - counts["copies"]
    counts["waits"] = sum("Synchronize" in e.name for e in events) - 1


def epoch_seconds(epoch: Callable[[], object], device: torch.device, rounds: int) -> float:
    """Median seconds of an epoch, after one that is not timed."""
    seconds = []
    for _ in range(rounds + 1):
        started = time.perf_counter()
        epoch()
        if device.type == "cuda":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds[1:]))


def begin_training(system: type[WindowNet], corpus: Corpus, device: str) -> Training:
    """One epoch of a system's training, without the search of a rate."""
    model = system(device=device)
    torch.manual_seed(0)
    training = next(model.train_in_steps(corpus, corpus.gestures)).training
    training.optimiser.before_epoch = lambda *_: ()
    if hasattr(training.optimiser, "inner"):
        for group in training.optimiser.inner.param_groups:
            group["foreach"] = True  # the default of a card
    return replace(training, schedule=replace(training.schedule, epochs=1), judge=None)


def plain_steps(training: Training, optimiser: Callable) -> tuple[Callable, Callable, list]:
    """A plain step on a batch, one on row numbers, and the tensors of a first batch."""
    device, samples = training.device, training.samples
    net = with_library_layers(training.net).train()
    smoothing = training.schedule.smoothing
    descent, criterion = optimiser(net.parameters()), nn.CrossEntropyLoss(label_smoothing=smoothing)
    labels = torch.from_numpy(training.target).to(device)
    rows = np.arange(min(training.schedule.batch, len(samples)))
    if isinstance(samples.make_example(), tuple):  # drawn anew in each batch
        cut = samples.make_batch
    else:
        windows = torch.cat(
            [
                samples.make_batch(part)
                for part in np.split(np.arange(len(samples)), range(1000, len(samples), 1000))
            ]
        )
        cut = lambda rows: windows[upload(torch.from_numpy(rows), device)]  # noqa: E731

    def learn(x: object, expected: torch.Tensor) -> None:
        descent.zero_grad(set_to_none=True)
        criterion(net(x), expected).backward()
        descent.step()

    def learn_rows(rows: np.ndarray) -> None:
        learn(cut(rows), labels[upload(torch.from_numpy(rows), device)])

    return learn, learn_rows, [cut(rows), labels[: len(rows)].clone()]


def capture_graph(learn: Callable, batch: list) -> torch.cuda.CUDAGraph:
    """A CUDA graph of a step on fixed tensors."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(3):
            learn(*batch)
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        learn(*batch)
    return graph


def compare_on_device(
    name: str, device: torch.device, corpus: Corpus, folds: int, epochs: int, rounds: int
) -> None:
    """Print seconds per epoch and launches per step of each loop, and the time of all folds."""
    system, optimiser = ON_DEVICE[name]
    optimiser = partial(optimiser, foreach=True)
    if device.type == "cuda" and name != "cnn85":
        optimiser = partial(optimiser, capturable=True)
    card, processor = (type(name, (system,), {"on_card": way}) for way in (True, False))
    training = begin_training(card, corpus, str(device))
    batch = min(training.schedule.batch, len(training.samples))
    batches = np.random.default_rng(0).permutation(len(training.samples))
    batches = batches[: len(batches) // batch * batch].reshape(-1, batch)
    print(f"{name}: {len(batches)} steps of {batch} on {device}, torch {torch.__version__}")
    learn, learn_rows, fixed = plain_steps(training, optimiser)
    loops = {
        "product": (training.learn, lambda: train_alone(training.iterate(), 0)),
        "plain": (learn_rows, lambda: [learn_rows(rows) for rows in batches]),
    }
    if device.type == "cuda":
        graph = capture_graph(learn, fixed)
        loops["graph"] = lambda rows: graph.replay(), lambda: [graph.replay() for _ in batches]
    else:
        before = begin_training(processor, corpus, "cpu")
        loops["processor's order"] = before.learn, lambda: train_alone(before.iterate(), 0)
    for loop, (step, epoch) in loops.items():
        seconds, counts = epoch_seconds(epoch, device, rounds), {}
        with counted_launches(device, counts):
            step(batches[0])
        words = ", ".join(f"{count} {word}" for word, count in counts.items())
        print(f"  {loop:18} {seconds:8.4f} s per epoch; a step: {words}", flush=True)
    people = np.unique(corpus.subjects)[:folds]
    parts = [corpus[corpus.subjects != person] for person in people]
    length = {"updates": 30 * epochs} if name == "touchnet" else {"epochs": epochs}
    alone, *systems = (card(device=str(device), **length) for _ in range(len(parts) + 1))
    one = epoch_seconds(lambda: alone.fit(parts[0], parts[0].gestures), device, 1)
    started = time.perf_counter()
    failures = card.fit_together(systems, parts)
    words = f"{len(parts)} LOSO folds at once {time.perf_counter() - started:.1f} s"
    print(f"  {words}, one alone {one:.1f} s, failed {sum(map(bool, failures))}", flush=True)


def main(*arguments: str) -> None:
    """Compare the systems that are named, or all."""
    options = dict(a.split("=") for a in arguments if "=" in a)
    threads = int(options.get("threads", 1))
    torch.set_num_threads(threads)
    names = [a for a in arguments if "=" not in a]
    if device := options.get("device"):
        sizes = {"folds": 10, "epochs": 50, "rounds": 5}
        sizes = {key: int(options.get(key, size)) for key, size in sizes.items()}
        corpus = generate_haart_like(int(options.get("captures", 746)))
        if data := options.get("data"):
            corpus = bench.corpus(data)
        for name in names or ON_DEVICE:
            compare_on_device(name, torch.device(device), corpus, **sizes)
        return
    for name in names or SYSTEMS:
        compare_loops(name, threads, int(options.get("rounds", 5)), options.get("precision", ""))


if __name__ == "__main__":
    main(*sys.argv[1:])
