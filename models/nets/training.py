"""The one training loop that the networks share.

Windows are cut from the corpus batch by batch, by one gather of frames in the memory layout of
`taxel_major` and `time_blocks`. These two are faster than a plain loop over a DataLoader; the rest
of the loop is as fast (benchmarks/bench_training.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus, shared_frames


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
        self._begin = starts[self.capture] + self.start
        self._values = stored.reshape(len(stored), -1)
        self._scale = 1 / corpus.full_scale

    def __len__(self) -> int:
        return len(self.capture)

    def make_example(self) -> torch.Tensor:
        """A batch of the first window."""
        return self.make_batch(np.arange(1))

    def make_batch(self, rows: np.ndarray) -> torch.Tensor:
        """Windows scaled to 0..1, float32 [rows, frames, grid rows, grid cols]."""
        seen = self.seen[rows]
        index = self._begin[rows, None] + np.minimum(np.arange(self.frames), seen[:, None] - 1)
        values = self._values[index].astype(np.float32)  # [rows, frames, taxels]
        if self.padding == "zero":
            values[np.arange(self.frames) >= seen[:, None]] = 0
        by_taxel = torch.from_numpy(values).flatten(0, 1).T.contiguous().mul_(self._scale)
        return by_taxel.view(*self.grid, len(rows), self.frames).permute(2, 3, 0, 1)


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


Samples = Windows | Sequences
LearnRows = Callable[[np.ndarray], float]
Forward = Callable[[object], torch.Tensor]


class Optimiser:
    """An optimiser of PyTorch with the interface of the training loop.

    Attributes:
        rate: the learning rate.
    """

    def __init__(self, inner: torch.optim.Optimizer) -> None:
        self.inner = inner
        self.rate = inner.param_groups[0]["lr"]

    def before_epoch(self, epoch: int, batches: np.ndarray, step: LearnRows) -> None:
        """Set the rate of an epoch, from 0; ``step`` can try its batches [batches, samples]."""

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


def train_network(
    net: nn.Module,
    samples: Samples,
    target: np.ndarray,
    optimiser: Optimiser,
    schedule: Schedule,
    forward: Forward | None = None,
    judge: Callable[[], float] | None = None,
) -> list[dict[str, float]]:
    """Minimise cross-entropy over shuffled batches; an epoch leaves out its incomplete last batch.

    Args:
        net: maps a batch to logits [decisions, classes]; trained in place.
        samples: training samples.
        target: int64 [samples], class of each.
        optimiser: optimiser of the parameters of ``net``.
        schedule: epochs, batches, and when to stop.
        forward: a faster way to compute ``net(x)`` (`WindowNet.compute_logits`).
        judge: measures the accuracy on held-out captures; the first epoch with the highest one is
            kept. The loss may then become infinite.

    Returns:
        Per epoch ``loss`` (mean over its batches), ``rate``, and ``held_accuracy`` with a judge.
    """
    generator, history = np.random.default_rng(schedule.seed), []
    best: tuple[float, dict] | None = None  # accuracy and weights of the best epoch
    step = _make_step(net, samples, target, optimiser, schedule.smoothing, forward or net)
    batch = min(schedule.batch, len(samples))
    for epoch in range(schedule.epochs):
        net.train()
        order = generator.permutation(len(samples))
        batches = order[: len(samples) // batch * batch].reshape(-1, batch)
        optimiser.before_epoch(epoch, batches, step)
        losses = [step(rows) for rows in batches]
        history.append({"loss": float(np.mean(losses)), "rate": optimiser.rate})
        if not np.isfinite(history[-1]["loss"]):
            if best:
                break
            raise FloatingPointError(
                f"training diverged: the loss of epoch {epoch + 1} is not finite at a learning "
                f"rate of {optimiser.rate:g}; give a lower one"
            )
        if judge:
            accuracy = history[-1]["held_accuracy"] = judge()
            if best is None or accuracy > best[0]:
                best = accuracy, {name: value.clone() for name, value in net.state_dict().items()}
        if schedule.patience and _has_converged(
            [row["loss"] for row in history], schedule.patience
        ):
            break
    if best:
        net.load_state_dict(best[1])
    return history


def _make_step(
    net: nn.Module,
    samples: Samples,
    target: np.ndarray,
    optimiser: Optimiser,
    smoothing: float,
    forward: Forward,
) -> LearnRows:
    """Make a function that trains on the samples of some rows and returns their previous loss."""
    device = next(net.parameters()).device
    labels = torch.from_numpy(np.asarray(target, dtype=np.int64))
    steps = torch.from_numpy(samples.steps)

    def step(rows: np.ndarray) -> float:
        optimiser.zero_grad()
        expected = labels[rows].repeat_interleave(steps[rows]).to(device)
        logits = forward(to_device(samples.make_batch(rows), device))
        loss = nn.functional.cross_entropy(logits, expected, label_smoothing=smoothing)
        loss.backward()
        optimiser.step()
        return loss.item()

    return step


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


def predict_samples(net: nn.Module, samples: Samples, batch: int, forward: Forward) -> np.ndarray:
    """Softmax of the logits of every decision, float32 [decisions, classes]."""
    net.eval()
    device = next(net.parameters()).device
    parts = []
    with torch.inference_mode():
        for first in range(0, len(samples), batch):
            rows = np.arange(first, min(first + batch, len(samples)))
            logits = forward(to_device(samples.make_batch(rows), device))
            parts.append(logits.softmax(dim=1).cpu())
    return torch.cat(parts).numpy()


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
