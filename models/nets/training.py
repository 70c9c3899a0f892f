"""The one training loop that the networks share.

Windows are cut from the corpus batch by batch: one gather of frames by index, laid out grid first, as `taxel_major`
and `time_blocks` want it. These two are what beats a plain loop over a DataLoader; the rest of the loop is at par with
it (benchmarks/bench_training.py).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import deepcopy
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus, storage
from bench.progress import tell

if TYPE_CHECKING:
    from models.nets.checkpoint import Checkpoint


class Windows:
    """Windows of equal length over ragged captures, the tail of a capture padded.

    A capture of T frames has max(1, ceil((T - frames) / hop) + 1) windows, as Hughes et al. 2017 count them: 1 to 85
    for 10 to 1297 frames at 45 / 15.

    Args:
        corpus: the captures.
        frames: length of a window.
        hop: frames from one window's start to the next.
        padding: of windows that reach beyond their capture: ``zero``, or ``edge`` to repeat its last frame.

    Attributes:
        capture: int64 [windows], position in the corpus of the capture that a window is cut from.
        start: int64 [windows], first frame within the capture.
        seen: int64 [windows], frames of touch in the window; fewer than ``frames`` where it is padded.
        steps: int64 [windows], decisions that a network makes on each: one.
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
        stored, starts = storage(corpus)
        self._begin = starts[self.capture] + self.start
        self._values = stored.reshape(len(stored), -1)
        self._scale = 1 / corpus.full_scale

    def __len__(self) -> int:
        return len(self.capture)

    def one(self) -> torch.Tensor:
        """The first window, a batch of one."""
        return self.batch(np.arange(1))

    def batch(self, rows: np.ndarray) -> torch.Tensor:
        """Windows scaled to 0..1, float32 [rows, frames, grid rows, grid cols], in memory grid first."""
        seen = self.seen[rows]
        index = self._begin[rows, None] + np.minimum(np.arange(self.frames), seen[:, None] - 1)
        values = self._values[index].astype(np.float32)  # [rows, frames, taxels]
        if self.padding == "zero":
            values[np.arange(self.frames) >= seen[:, None]] = 0
        by_taxel = torch.from_numpy(values).flatten(0, 1).T.contiguous().mul_(self._scale)
        return by_taxel.view(*self.grid, len(rows), self.frames).permute(2, 3, 0, 1)


class Sequences:
    """Runs of consecutive windows of a capture, for networks that read them one after another.

    A capture with more windows than ``longest`` makes several sequences.

    Args:
        windows: the windows of a corpus.
        longest: most windows in a sequence.

    Attributes:
        capture: int64 [sequences], position in the corpus of the capture that a sequence is cut from.
        start: int64 [sequences], its first frame within the capture.
        seen: int64 [sequences], frames of touch in it.
        steps: int64 [sequences], number of its windows.
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

    def one(self) -> tuple[torch.Tensor, torch.Tensor]:
        """The first window, as a sequence of one step."""
        return self._windows.one(), torch.ones(1, dtype=torch.int64)

    def batch(self, rows: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """The windows of some sequences, one sequence after another, and how many each has."""
        steps = self.steps[rows]
        within = np.arange(steps.sum()) - np.repeat(np.cumsum(steps) - steps, steps)
        return self._windows.batch(np.repeat(self._first[rows], steps) + within), torch.from_numpy(steps)


Samples = Windows | Sequences


class Optimiser(Protocol):
    """What the loop needs of an optimiser: forget gradients, take a step, name its current rate, keep its state."""

    rate: float

    def zero_grad(self) -> None:
        """Forget the gradients."""

    def step(self) -> None:
        """Move the parameters along their gradients."""

    def state_dict(self) -> dict:
        """All that the next step depends on, besides the parameters."""

    def load_state_dict(self, state: dict) -> None:
        """Go on from such a state."""


Step = Callable[[np.ndarray], float]
Forward = Callable[[object], torch.Tensor]


def train(
    net: nn.Module,
    samples: Samples,
    target: np.ndarray,
    optimiser: Optimiser,
    epochs: int,
    batch: int,
    seed: int,
    before_epoch: Callable[[int, np.ndarray, Step], None] | None = None,
    forward: Forward | None = None,
    judge: Callable[[], float] | None = None,
    patience: int | None = None,
    kept: Checkpoint | None = None,
    smoothing: float = 0.0,
) -> list[dict[str, float]]:
    """Minimise cross-entropy over shuffled batches; the incomplete last batch of an epoch is left out.

    Args:
        net: maps a batch to logits [decisions, classes]; trained in place.
        samples: what it is trained on.
        target: int64 [samples], class of each.
        optimiser: of the parameters of ``net``.
        epochs: most passes over the samples.
        batch: samples per step; with fewer than that, all of them are one batch.
        seed: of the shuffles.
        before_epoch: called with the epoch (from 0), its batches and the step, to set the learning rate.
        forward: a faster way to compute ``net(x)`` (`WindowNet.forward`).
        judge: accuracy of the network on captures it is not trained on; the epoch with the highest, the first of equal
            ones, is the one that is kept.
        patience: stop when the median loss of this many epochs is not 0.1 % below that of as many before them.
        kept: where the state after each epoch is kept and, after a kill, found again; on a processor the result is
            then the same bit for bit. What has been trained to the end is not trained again.
        smoothing: share of a label that is spread over all classes.

    Returns:
        Per epoch ``loss`` (mean over its batches), ``rate``, and ``held_accuracy`` with a judge.

    Raises:
        FloatingPointError: the loss is not finite any more, and no epoch was judged before.
    """
    order = np.random.default_rng(seed)
    device = next(net.parameters()).device
    labels = torch.from_numpy(np.asarray(target, dtype=np.int64))
    steps = torch.from_numpy(samples.steps)
    forward = forward or net

    def step(rows: np.ndarray) -> float:
        optimiser.zero_grad()
        decided = labels[rows].repeat_interleave(steps[rows]).to(device)
        logits = forward(moved(samples.batch(rows), device))
        loss = nn.functional.cross_entropy(logits, decided, label_smoothing=smoothing)
        loss.backward()
        optimiser.step()
        return loss.item()

    history: list[dict[str, float]] = []
    best: tuple[float, dict] | None = None
    whole = max(len(samples) // batch, 1) * min(batch, len(samples))
    if kept and (state := kept.read()):
        fresh = deepcopy((net.state_dict(), optimiser.state_dict(), order.bit_generator.state, torch.get_rng_state()))
        try:
            if "optimiser" not in state:  # it was done
                net.load_state_dict(state["net"])
                return state["history"]
            _go_on(net, optimiser, order, (state["net"], state["optimiser"], state["order"], state["random"]))
            history, best = state["history"], state["best"]
        except (AttributeError, KeyError, RuntimeError, TypeError, ValueError):  # somebody else's state
            _go_on(net, optimiser, order, fresh)
            kept.begin_anew()
    begun = len(history)
    began, at_most = time.monotonic(), " at most" if patience else ""
    for epoch in range(begun, epochs):
        net.train()
        batches = order.permutation(len(samples))[:whole].reshape(-1, min(batch, len(samples)))
        if before_epoch:
            before_epoch(epoch, batches, step)
        losses = []
        for rows in batches:
            losses.append(step(rows))
            done = epoch + len(losses) / len(batches)
            left = (time.monotonic() - began) * (epochs - done) / (done - begun)
            tell(f"epoch {epoch + 1} of {epochs}{at_most}, loss {losses[-1]:.3g}", left)
        history.append({"loss": float(np.mean(losses)), "rate": optimiser.rate})
        if not np.isfinite(history[-1]["loss"]):
            if best:
                break
            raise FloatingPointError(
                f"training diverged: the loss of epoch {epoch + 1} is not finite at a learning rate of "
                f"{optimiser.rate:g}; give a lower one"
            )
        if judge:
            history[-1]["held_accuracy"] = accuracy = judge()
            if best is None or accuracy > best[0]:
                best = accuracy, {name: value.clone() for name, value in net.state_dict().items()}
        if patience and _stands_still([row["loss"] for row in history], patience):
            break
        if kept:
            kept.write(
                {
                    "net": net.state_dict(),
                    "optimiser": optimiser.state_dict(),
                    "order": order.bit_generator.state,
                    "random": torch.get_rng_state(),
                    "history": history,
                    "best": best,
                }
            )
    if best:
        net.load_state_dict(best[1])
    if kept:
        kept.done({"net": net.state_dict(), "history": history})
    return history


def _go_on(net: nn.Module, optimiser: Optimiser, order: np.random.Generator, state: tuple) -> None:
    """Take weights, the optimiser's state, that of the shuffles and that of PyTorch's draws."""
    weights, moved_so_far, shuffles, draws = state
    net.load_state_dict(weights)
    optimiser.load_state_dict(moved_so_far)
    order.bit_generator.state = shuffles
    torch.set_rng_state(draws)


def _stands_still(losses: list[float], patience: int) -> bool:
    if len(losses) < 2 * patience:
        return False
    # Medians: a recurrent network on long sequences now and then falls back for an epoch.
    return np.median(losses[-patience:]) > 0.999 * np.median(losses[-2 * patience : -patience])


class Torch:
    """An optimiser of PyTorch as the loop wants it."""

    def __init__(self, optimiser: torch.optim.Optimizer) -> None:
        self.zero_grad = optimiser.zero_grad
        self.step = optimiser.step
        self.state_dict = optimiser.state_dict
        self.load_state_dict = optimiser.load_state_dict
        self.rate = optimiser.param_groups[0]["lr"]


def moved(batch: object, device: torch.device) -> object:
    """A batch, a tensor or several, on a device."""
    if device.type == "cpu":
        return batch
    return tuple(part.to(device) for part in batch) if isinstance(batch, tuple) else batch.to(device)


def probabilities(net: nn.Module, samples: Samples, batch: int, forward: Forward) -> np.ndarray:
    """Softmax of the logits of every decision, float32 [decisions, classes]; ``forward`` computes ``net(x)``."""
    net.eval()
    device = next(net.parameters()).device
    with torch.inference_mode():
        parts = [
            forward(moved(samples.batch(np.arange(i, min(i + batch, len(samples)))), device)).softmax(dim=1).cpu()
            for i in range(0, len(samples), batch)
        ]
    return torch.cat(parts).numpy()


IN_PLACE = (nn.ReLU, nn.Flatten, nn.Dropout, nn.BatchNorm1d, nn.BatchNorm3d, nn.LayerNorm)


def activations(net: nn.Module, one: object) -> tuple[int, int]:
    """Numbers that are in memory while one sample goes through a network: its input and the outputs of its layers.

    Layers that can overwrite their input (ReLU, normalisation, dropout) add nothing. Hughes et al. 2017, Table VIII,
    counts in this way. Self-attention holds queries, keys, values, scores and what they give besides its output.

    Args:
        net: the network.
        one: a batch of one sample.

    Returns:
        All of them, and without outputs of convolutions that are pooled at once.
    """
    outputs: list[tuple[nn.Module, int]] = []

    def note(layer: nn.Module, given: object, output: object) -> None:
        tensor = output[0] if isinstance(output, tuple) else output
        inside = 0
        if isinstance(layer, nn.MultiheadAttention):
            steps = given[0].shape[1]
            inside = 4 * given[0].numel() + len(given[0]) * layer.num_heads * steps**2
        outputs.append((layer, tensor.numel() + inside))

    attention = [m for m in net.modules() if isinstance(m, nn.MultiheadAttention)]
    within = {id(m) for layer in attention for m in layer.modules()}
    leaves = [
        m for m in net.modules() if not list(m.children()) and not isinstance(m, IN_PLACE) and id(m) not in within
    ]
    hooks = [layer.register_forward_hook(note) for layer in [*leaves, *attention]]
    try:
        net.eval()
        with torch.inference_mode():
            net(one)
    finally:
        for hook in hooks:
            hook.remove()
    given = one[0] if isinstance(one, tuple) else one
    total = given.numel() + sum(size for _, size in outputs)
    pooled = (nn.MaxPool2d, nn.MaxPool3d)
    pairs = zip(outputs[:-1], outputs[1:], strict=True)
    return total, total - sum(size for (_, size), (after, _) in pairs if isinstance(after, pooled))
