"""The one training loop that the networks share, one at a time or several at once.

On a processor, windows are cut from the corpus batch by batch, by one gather of frames in the
memory layout of `taxel_major` and `time_blocks`. These two are faster than a plain loop over a
DataLoader; the rest of the loop is as fast (benchmarks/bench_training.py). On a card, the frames
lie on the device, batches are gathered there, and nothing waits for it before the end of an epoch.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from copy import copy, deepcopy
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn
from torch.func import functional_call, vmap

from bench.corpora.corpus import Corpus, shared_frames
from bench.models.by_source import draw_batches


class Windows:
    """Windows of equal length over captures of any length, the last one of a capture padded.

    A capture of T frames has max(1, ceil((T - frames) / hop) + 1) windows, as in Hughes et al.
    2017: 1 to 85 for 10 to 1297 frames at 45 / 15.

    Args:
        corpus: the captures.
        frames: length of a window.
        hop: frames from one window's start to the next.
        padding: padding of windows that reach beyond their capture: ``zero``, or ``edge`` to repeat
            its last frame.

    Attributes:
        capture: int64 [windows], position of the window's capture in the corpus.
        start: int64 [windows], first frame within the capture.
        seen: int64 [windows], frames of the capture in the window; fewer than ``frames`` where it
            is padded.
        steps: int64 [windows], decisions of a network on each: one.
        is_added: bool [windows], True for windows of captures of ``also=``.
    """

    def __init__(self, corpus: Corpus, frames: int, hop: int, padding: str = "zero") -> None:
        counts = np.maximum(1, -(-(corpus.lengths - frames) // hop) + 1)
        self.capture = np.repeat(np.arange(len(corpus)), counts)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        self.start = (np.arange(counts.sum()) - first) * hop
        self.seen = np.minimum(frames, corpus.lengths[self.capture] - self.start)
        self.steps = np.ones(len(self.capture), dtype=np.int64)
        self.frames = frames
        self.padding = padding
        self.grid = corpus.grid
        stored, starts = shared_frames(corpus)
        self.is_added = corpus.is_added[self.capture]
        self._begin = starts[self.capture] + self.start
        self._stored = stored
        self._values = stored.reshape(len(stored), -1)
        self._scale = 1 / corpus.full_scale

    def __len__(self) -> int:
        return len(self.capture)

    def make_example(self) -> torch.Tensor:
        """A batch of the first window."""
        return self.make_batch(np.arange(1))

    def make_batch(self, rows: np.ndarray) -> torch.Tensor:
        """Windows scaled to 0..1, float32 [rows, frames, grid rows, grid cols]."""
        index, is_padding = self._find_frames(rows)
        values = self._values[index].astype(np.float32)  # [rows, frames, taxels]
        values[is_padding] = 0
        by_taxel = torch.from_numpy(values).flatten(0, 1).T.contiguous().mul_(self._scale)
        return by_taxel.view(*self.grid, len(rows), self.frames).permute(2, 3, 0, 1)

    def _find_frames(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stored frames of windows, and True where zeros replace them [rows, frames]."""
        seen, place = self.seen[rows, None], np.arange(self.frames)
        index = self._begin[rows, None] + np.minimum(place, seen - 1)
        return index, (place >= seen) & (self.padding == "zero")

    def place(self, device: torch.device) -> PlacedWindows:
        """The same windows, gathered on a device."""
        return PlacedWindows(self, device)


class PlacedWindows(Windows):
    """Windows that are gathered on a device, in the memory layout of the library's layers."""

    def __init__(self, windows: Windows, device: torch.device) -> None:
        vars(self).update(vars(windows))
        self._device = device
        self._on_device = frames_on_device(self._stored, self._scale, device)
        index, is_padding = self._find_frames(np.arange(len(self)))
        index[is_padding] = len(self._on_device) - 1
        self._index = torch.from_numpy(index).to(device)

    def make_batch(self, rows: np.ndarray) -> torch.Tensor:
        """Windows scaled to 0..1, float32 [rows, frames, grid rows, grid cols]."""
        index = self._index[upload(torch.from_numpy(rows), self._device)]
        return self._on_device[index].unflatten(2, self.grid)


_frames_on_devices: dict[tuple[int, torch.device], torch.Tensor] = {}


def frames_on_device(stored: np.ndarray, scale: float, device: torch.device) -> torch.Tensor:
    """Copy stored frames to a device, once as long as they exist: float32 [frames + 1, taxels].

    They are scaled to 0..1; the last one is zero.
    """
    key = id(stored), device
    if key not in _frames_on_devices:
        values = np.zeros((len(stored) + 1, stored[0].size), dtype=np.float32)
        values[:-1] = stored.reshape(len(stored), -1)
        _frames_on_devices[key] = torch.from_numpy(values).mul_(scale).to(device)
        weakref.finalize(stored, _frames_on_devices.pop, key)
    return _frames_on_devices[key]


def upload(tensor: torch.Tensor, device: torch.device) -> torch.Tensor:
    """Copy a tensor to a device, from pinned memory: a card then goes on without waiting."""
    if device.type == "cuda":
        tensor = tensor.pin_memory()
    return tensor.to(device, non_blocking=True)


class Sequences:
    """Sequences of at most ``longest`` consecutive windows of a capture, for recurrent networks.

    Attributes are those of `Windows`; ``steps`` is the number of windows of each sequence.
    """

    def __init__(self, windows: Windows, longest: int) -> None:
        step = np.arange(len(windows)) - np.searchsorted(windows.capture, windows.capture)
        self._first = np.flatnonzero(step % longest == 0)
        self._windows = windows
        self.steps = np.diff(self._first, append=len(windows))
        last = self._first + self.steps - 1
        self.capture = windows.capture[self._first]
        self.is_added = windows.is_added[self._first]
        self.start = windows.start[self._first]
        self.seen = windows.start[last] + windows.seen[last] - self.start

    def __len__(self) -> int:
        return len(self._first)

    def make_example(self) -> tuple[torch.Tensor, torch.Tensor]:
        """A batch of the first window, as a sequence of one step."""
        return self._windows.make_example(), torch.ones(1, dtype=torch.int64)

    def make_batch(self, rows: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Windows of some sequences, one sequence after another, and the length of each."""
        steps = self.steps[rows]
        within = np.arange(steps.sum()) - np.repeat(np.cumsum(steps) - steps, steps)
        windows = self._windows.make_batch(np.repeat(self._first[rows], steps) + within)
        return windows, torch.from_numpy(steps)

    def place(self, device: torch.device) -> Sequences:
        """The same sequences, whose windows are gathered on a device."""
        placed = copy(self)
        placed._windows = self._windows.place(device)
        return placed


Samples = Windows | Sequences
Forward = Callable[[Callable, object], torch.Tensor]
History = list[dict[str, float]]


class Optimiser:
    """An optimiser of PyTorch with the interface of the training loop.

    Attributes:
        rate: the learning rate.
    """

    def __init__(self, inner: torch.optim.Optimizer) -> None:
        self.inner = inner
        self.rate = inner.param_groups[0]["lr"]

    def before_epoch(self, epoch: int, steps: Sequence[Step]) -> Steps:
        """Set the rate of an epoch, from 0; may first try some of its steps."""
        yield from ()

    def zero_grad(self) -> None:
        """Forget the gradients."""
        self.inner.zero_grad()

    def step(self) -> None:
        """Update the parameters."""
        self.inner.step()


@dataclass(frozen=True)
class Schedule:
    """Length and step sizes of a network's training."""

    epochs: int  # most passes over the samples
    batch: int  # samples per step; with fewer than that, all of them are one batch
    seed: int  # of the shuffles
    patience: int | None = None  # epochs, see `_has_converged`
    smoothing: float = 0.0  # share of a label that is spread over all classes


@dataclass
class Training:
    """A network in training.

    Args:
        net: maps a batch to logits [decisions, classes]; trained in place.
        samples: training samples.
        target: int64 [samples], class of each.
        optimiser: optimiser of the parameters of ``net``.
        schedule: epochs, batches, and when to stop.
        forward: maps ``net`` and a batch x to ``net(x)`` (`WindowNet.compute_logits`).
        judge: measures the accuracy on held-out captures; the first epoch with the highest one is
            kept. The loss may then become infinite.
    """

    net: nn.Module
    samples: Samples
    target: np.ndarray
    optimiser: Optimiser
    schedule: Schedule
    forward: Forward
    judge: Callable[[], float] | None = None

    def __post_init__(self) -> None:
        self.device = next(self.net.parameters()).device
        self._labels = torch.from_numpy(np.asarray(self.target, dtype=np.int64))
        self._steps = torch.from_numpy(self.samples.steps)

    def iterate(self) -> Generator[Step, torch.Tensor, History]:
        """Minimise cross-entropy over shuffled batches; an incomplete last one is left out.

        It yields each step, and is sent its loss, a tensor that is read at the end of an epoch.

        Returns:
            Per epoch ``loss`` (mean over its batches), ``rate``, and ``held_accuracy`` with a
            judge.
        """
        net, schedule, optimiser = self.net, self.schedule, self.optimiser
        generator, history = np.random.default_rng(schedule.seed), History()
        best: tuple[float, dict] | None = None  # accuracy and weights of the best epoch
        batch = min(schedule.batch, len(self.samples))
        for epoch in range(schedule.epochs):
            net.train()
            batches = draw_batches(generator, self.samples.is_added, batch)
            steps = [Step(self, rows) for rows in batches]
            yield from optimiser.before_epoch(epoch, steps)
            losses = []
            for step in steps:
                losses.append((yield step))
            loss = float(np.mean(torch.stack(losses).tolist()))
            history.append({"loss": loss, "rate": optimiser.rate})
            if not np.isfinite(loss):
                if best:
                    break
                raise FloatingPointError(
                    f"training diverged: the loss of epoch {epoch + 1} is not finite at a "
                    f"learning rate of {optimiser.rate:g}; give a lower one"
                )
            if self.judge:
                accuracy = history[-1]["held_accuracy"] = self.judge()
                if best is None or accuracy > best[0]:
                    weights = {name: value.clone() for name, value in net.state_dict().items()}
                    best = accuracy, weights
            if schedule.patience and _has_converged(
                [row["loss"] for row in history], schedule.patience
            ):
                break
        if best:
            net.load_state_dict(best[1])
        return history

    def make_batch(self, rows: np.ndarray) -> tuple[Any, torch.Tensor]:
        """A batch of some samples, and the class of each decision on it."""
        expected = self._labels[rows].repeat_interleave(self._steps[rows])
        return self.samples.make_batch(rows), upload(expected, self.device)

    def learn(self, rows: np.ndarray) -> torch.Tensor:
        """Train on the samples of some rows; return their previous loss."""
        self.optimiser.zero_grad()
        x, expected = self.make_batch(rows)
        loss = self.measure_loss(self.forward(self.net, x), expected)
        loss.backward()
        self.optimiser.step()
        return loss.detach()

    def measure_loss(self, logits: torch.Tensor, expected: torch.Tensor) -> torch.Tensor:
        """Mean cross-entropy of the decisions on a batch."""
        smoothing = self.schedule.smoothing
        return nn.functional.cross_entropy(logits, expected, label_smoothing=smoothing)

    @cached_property
    def parameters(self) -> dict[str, torch.Tensor]:
        """The parameters of the network by name, without their gradients."""
        return {name: p.detach() for name, p in self.net.named_parameters()}

    @cached_property
    def buffers(self) -> dict[str, torch.Tensor]:
        """What the network holds besides its parameters, by name."""
        return dict(self.net.named_buffers())

    @cached_property
    def structure(self) -> nn.Module:
        """The network without values, in training; it computes with those of any of its shape."""
        structure = deepcopy(self.net).to("meta").train()
        for layer in structure.modules():
            if isinstance(layer, Dropout):
                layer.factors = torch.empty(0, device="meta")
        return structure


class Step(NamedTuple):
    """A batch of a training, by the rows of its samples."""

    training: Training
    rows: np.ndarray

    def draw_batch(self) -> Batch:
        """Draw all that is random in this step."""
        x, expected = self.training.make_batch(self.rows)
        factors = {
            f"{name}.factors": upload(
                layer.draw_factors((len(self.rows), *layer.shape)), self.training.device
            )
            for name, layer in self.training.net.named_modules()
            if isinstance(layer, Dropout)
        }
        return Batch(self.training, x, expected, factors)


class Batch(NamedTuple):
    """Tensors of a step."""

    training: Training
    x: Any  # a tensor or several
    expected: torch.Tensor  # class of each decision
    factors: dict[str, torch.Tensor]  # of each dropout

    @property
    def shape(self) -> tuple[torch.Size, ...]:
        """Shapes of the tensors; batches of equal shape are learnt in one pass."""
        return tuple(tensor.shape for tensor in (*as_tuple(self.x), self.expected))


Steps = Generator[Step, torch.Tensor, None]


def train_alone(steps: Generator[Step, torch.Tensor, Any], seed: int) -> Any:
    """Take the steps of one training, whose random numbers start from a seed; return its result."""
    with Draws(seed).resume():
        try:
            step = next(steps)
            while True:
                step = steps.send(step.training.learn(step.rows))
        except StopIteration as e:
            return e.value


def train_together(
    trainings: Sequence[Generator[Step, torch.Tensor, Any]], seeds: Sequence[int]
) -> list[Exception | None]:
    """Take the steps of several trainings side by side, those of equal shape in one pass.

    Each has the random numbers of its own seed, as in `train_alone`.

    Returns:
        Why each training failed; None for one that did not.
    """
    failures: list[Exception | None] = [None] * len(trainings)
    draws = [Draws(seed) for seed in seeds]
    stack = Stack(len(trainings))
    losses: dict[int, Any] = dict.fromkeys(range(len(trainings)))
    while losses:
        groups: dict[tuple, dict[int, Batch]] = {}
        for place, loss in losses.items():
            try:
                with draws[place].resume():
                    batch = trainings[place].send(loss).draw_batch()
            except StopIteration:
                continue
            except Exception as e:
                failures[place] = e
                continue
            groups.setdefault(batch.shape, {})[place] = batch
        losses = {}
        for batches in groups.values():
            for place, loss in zip(batches, stack.learn([*batches.values()]), strict=True):
                if isinstance(loss, Exception):
                    failures[place] = loss
                else:
                    losses[place] = loss
    return failures


@dataclass
class Stack:
    """Networks of one shape that learn in one pass, as many as the memory of the device holds."""

    most: int  # networks in a pass

    def learn(self, batches: Sequence[Batch]) -> list[torch.Tensor | Exception]:
        """Train on a batch of each network; return their previous losses, or why they failed."""
        losses: list[torch.Tensor | Exception] = []
        while len(losses) < len(batches):
            part = batches[len(losses) : len(losses) + self.most]
            try:
                losses += learn_together(part)
            except Exception as e:
                if isinstance(e, torch.OutOfMemoryError) and len(part) > 1:
                    self.most = len(part) // 2
                else:
                    losses += [e] * len(part)
        return losses


def learn_together(batches: Sequence[Batch]) -> list[torch.Tensor]:
    """Train networks of one shape in one pass, each on its batch; return their previous losses."""
    trainings = [batch.training for batch in batches]
    first = trainings[0]
    parameters = _stack_tensors([training.parameters for training in trainings])
    for stacked in parameters.values():
        stacked.requires_grad_()
    buffers = _stack_tensors([training.buffers for training in trainings])
    factors = _stack_tensors([batch.factors for batch in batches])
    inputs = tuple(map(torch.stack, zip(*(as_tuple(batch.x) for batch in batches), strict=True)))

    def measure_loss(
        values: dict[str, torch.Tensor], x: tuple[torch.Tensor, ...], expected: torch.Tensor
    ) -> torch.Tensor:
        net = partial(functional_call, first.structure, values)
        logits = first.forward(lambda x: net((x,)), x if len(x) > 1 else x[0])
        return first.measure_loss(logits, expected)

    expected = torch.stack([batch.expected for batch in batches])
    losses = vmap(measure_loss)(parameters | buffers | factors, inputs, expected)
    gradients = torch.autograd.grad(losses.sum(), [*parameters.values()])
    for place, training in enumerate(trainings):
        for p, gradient in zip(training.net.parameters(), gradients, strict=True):
            p.grad = gradient[place]
        training.optimiser.step()
    for name, stacked in buffers.items():
        torch._foreach_copy_([training.buffers[name] for training in trainings], [*stacked])
    return [*losses.detach()]


def _stack_tensors(nets: Sequence[dict[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """Tensors of several networks by name, stacked along a new first axis."""
    return {name: torch.stack([tensors[name] for tensors in nets]) for name in nets[0]}


class Draws:
    """PyTorch's random numbers of one training, whatever others draw in between."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._state: torch.Tensor | None = None

    @contextmanager
    def resume(self) -> Iterator[None]:
        """Draw from here on where this training stopped."""
        with torch.random.fork_rng(devices=[]):
            if self._state is None:
                torch.manual_seed(self._seed)
            else:
                torch.set_rng_state(self._state)
            yield
            self._state = torch.get_rng_state()


def _has_converged(losses: list[float], patience: int) -> bool:
    """True if the median loss of the last epochs is less than 0.1 % below that of those before."""
    if len(losses) < 2 * patience:
        return False
    # Medians, as the loss of a recurrent network on long sequences may rise for single epochs.
    return np.median(losses[-patience:]) > 0.999 * np.median(losses[-2 * patience : -patience])


def to_device(batch: object, device: torch.device) -> object:
    """Move a batch, one tensor or several, to a device."""
    if device.type == "cpu":
        return batch
    if isinstance(batch, tuple):
        return tuple(tensor.to(device) for tensor in batch)
    return batch.to(device)


def as_tuple(batch: Any) -> tuple[torch.Tensor, ...]:
    """The tensors of a batch, which is one or several."""
    return batch if isinstance(batch, tuple) else (batch,)


def predict_samples(net: nn.Module, samples: Samples, batch: int, forward: Forward) -> np.ndarray:
    """Softmax of the logits of every decision, float32 [decisions, classes]."""
    net.eval()
    parts = []
    with torch.inference_mode():
        for first in range(0, len(samples), batch):
            rows = np.arange(first, min(first + batch, len(samples)))
            parts.append(forward(net, samples.make_batch(rows)).softmax(dim=1))
    return torch.cat(parts).cpu().numpy()


class Dropout(nn.Dropout):
    """Dropout that draws on the processor: equal factors on every device.

    Attributes:
        factors: of the inputs, if they are drawn beforehand.
        shape: of the inputs of one sample, in the last pass.
    """

    def __init__(self, p: float) -> None:
        super().__init__(p)
        self.register_buffer("factors", None)

    def draw_factors(self, shape: Sequence[int]) -> torch.Tensor:
        """Factors of inputs: zeros, and what keeps their mean."""
        return torch.empty(tuple(shape)).bernoulli_(1 - self.p).div_(1 - self.p)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Multiply the inputs by drawn factors, in training."""
        if self.factors is not None:
            return x * self.factors
        self.shape = x.shape[1:]
        if x.is_cpu or not self.training:
            return super().forward(x)
        return x * upload(self.draw_factors(x.shape), x.device)


IN_PLACE_LAYERS = (nn.ReLU, nn.Flatten, nn.Dropout, nn.BatchNorm1d, nn.BatchNorm3d, nn.LayerNorm)


def count_activations(net: nn.Module, example: torch.Tensor | tuple) -> int:
    """Count the numbers in memory during one forward pass: the input and the outputs of all layers.

    Layers that can overwrite their input (ReLU, normalisation, dropout) add nothing. Hughes et al.
    2017, Table VIII, counts in this way, without outputs of convolutions that are pooled at once.
    Self-attention holds queries, keys, values, scores and their product besides its output.

    Args:
        net: the network.
        example: a batch of one sample.
    """
    sizes: list[int] = []

    def record_output(layer: nn.Module, inputs: tuple, output: torch.Tensor | tuple) -> None:
        sizes.append(_first_tensor(output).numel())
        if isinstance(layer, nn.MultiheadAttention):
            windows, steps, _ = inputs[0].shape
            sizes.append(4 * inputs[0].numel() + windows * layer.num_heads * steps**2)

    attention = [layer for layer in net.modules() if isinstance(layer, nn.MultiheadAttention)]
    in_attention = {part for layer in attention for part in layer.modules()}
    leaves = [layer for layer in net.modules() if not list(layer.children())]
    counted = [layer for layer in leaves if not isinstance(layer, IN_PLACE_LAYERS)]
    counted = [layer for layer in counted if layer not in in_attention] + attention
    hooks = [layer.register_forward_hook(record_output) for layer in counted]
    try:
        net.eval()
        with torch.inference_mode():
            net(example)
    finally:
        for hook in hooks:
            hook.remove()
    return _first_tensor(example).numel() + sum(sizes)


def _first_tensor(value: torch.Tensor | tuple) -> torch.Tensor:
    return value[0] if isinstance(value, tuple) else value
