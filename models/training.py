"""The one training loop that the networks share.

Windows are cut from the corpus batch by batch: one gather of frames by index, laid out as `taxel_major` wants
it. On two cores these two are what beats a plain loop over a DataLoader (tests/benchmarks/bench_training.py).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch
from torch import nn

from bench.corpus import Corpus


class Windows:
    """Windows of equal length over ragged captures, the tail of a capture padded with zeros.

    A capture of T frames has max(1, ceil((T - frames) / hop) + 1) windows (FACTS of both papers: 1 to 85 windows for
    10 to 1297 frames at 45 / 15).

    Args:
        corpus: the captures.
        frames: length of a window.
        hop: frames from one window's start to the next.

    Attributes:
        capture: int64 [windows], position in the corpus of the capture that a window is cut from.
        start: int64 [windows], first frame within the capture.
        seen: int64 [windows], frames of touch in the window; fewer than ``frames`` where it is padded.
    """

    def __init__(self, corpus: Corpus, frames: int, hop: int) -> None:
        counts = np.maximum(1, -(-(corpus.lengths - frames) // hop) + 1)
        self.capture = np.repeat(np.arange(len(corpus)), counts)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        self.start = (np.arange(counts.sum()) - first) * hop
        self.seen = np.minimum(frames, corpus.lengths[self.capture] - self.start)
        self.frames = frames
        self.grid = corpus.grid
        self._begin = corpus.starts[self.capture] + self.start
        self._values = corpus.frames.reshape(len(corpus.frames), -1)
        self._scale = 1 / corpus.full_scale

    def __len__(self) -> int:
        return len(self.capture)

    def batch(self, rows: np.ndarray) -> torch.Tensor:
        """Windows scaled to 0..1, float32 [rows, frames, grid rows, grid cols], in memory grid first."""
        seen = self.seen[rows]
        index = self._begin[rows, None] + np.minimum(np.arange(self.frames), seen[:, None] - 1)
        values = self._values[index].astype(np.float32)  # [rows, frames, taxels]
        for i in np.flatnonzero(seen < self.frames):
            values[i, seen[i] :] = 0
        by_taxel = torch.from_numpy(values).flatten(0, 1).T.contiguous().mul_(self._scale)
        return by_taxel.view(*self.grid, len(rows), self.frames).permute(2, 3, 0, 1)


class Optimiser(Protocol):
    """What the loop needs of an optimiser: forget gradients, take a step, name its current rate."""

    rate: float

    def zero_grad(self) -> None:
        """Forget the gradients."""

    def step(self) -> None:
        """Move the parameters along their gradients."""


Step = Callable[[np.ndarray], float]


def train(
    net: nn.Module,
    windows: Windows,
    target: np.ndarray,
    optimiser: Optimiser,
    epochs: int,
    batch: int,
    seed: int,
    before_epoch: Callable[[int, np.ndarray, Step], None] | None = None,
    forward: Callable[[torch.Tensor], torch.Tensor] | None = None,
) -> list[dict[str, float]]:
    """Minimise cross-entropy over shuffled batches; the incomplete last batch of an epoch is left out.

    Args:
        net: maps [batch, frames, rows, cols] to logits [batch, classes]; trained in place.
        windows: what it is trained on.
        target: int64 [windows], class of each window.
        optimiser: of the parameters of ``net``.
        epochs: passes over the windows.
        batch: windows per step; with fewer windows than that, all of them are one batch.
        seed: of the shuffles.
        before_epoch: called with the epoch (from 0), its batches and the step, to set the learning rate.
        forward: a faster way to compute ``net(x)``.

    Returns:
        Per epoch ``loss`` (mean over its batches) and ``rate``.
    """
    order = np.random.default_rng(seed)
    labels = torch.from_numpy(np.asarray(target, dtype=np.int64))
    cross_entropy = nn.CrossEntropyLoss()
    forward = forward or net

    def step(rows: np.ndarray) -> float:
        optimiser.zero_grad()
        loss = cross_entropy(forward(windows.batch(rows)), labels[rows])
        loss.backward()
        optimiser.step()
        return loss.item()

    net.train()
    history = []
    whole = max(len(windows) // batch, 1) * min(batch, len(windows))
    for epoch in range(epochs):
        batches = order.permutation(len(windows))[:whole].reshape(-1, min(batch, len(windows)))
        if before_epoch:
            before_epoch(epoch, batches, step)
        losses = [step(rows) for rows in batches]
        history.append({"loss": float(np.mean(losses)), "rate": optimiser.rate})
    return history


def probabilities(net: nn.Module, windows: Windows, batch: int) -> np.ndarray:
    """Softmax of the logits of every window, float32 [windows, classes]."""
    net.eval()
    with torch.inference_mode():
        parts = [
            net(windows.batch(np.arange(i, min(i + batch, len(windows))))).softmax(dim=1)
            for i in range(0, len(windows), batch)
        ]
    return torch.cat(parts).numpy()
