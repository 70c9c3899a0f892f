"""The attention network of Ren, Hou and Belpaeme 2023 (HRI companion), trained without a look at the test part."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from torch import nn

from models.nets.checkpoint import Checkpoint
from models.nets.training import Torch, Windows, train
from models.nets.window import WindowNet

WIDTH = 512
HEADS = 8
LAYERS = 6


class Ren2023Transformer(WindowNet):
    """Six layers of self-attention over 144 frames, without feed-forward layers, positions or masks.

    The authors pick the epoch that is best on the test part. Here one training subject, who is not trained on, picks.

    Args:
        frames: length of a window; windows do not overlap, a capture of HAART has three.
        epochs: passes over the training windows, of which the best for the held-out subject is kept.
        batch: windows per step.
        rate: learning rate.
        seed: of the weights, the shuffles and the held-out subject.
        device: of PyTorch.
        seconds: length of a window in seconds at the corpus's rate; 0 for what ``frames`` says.
        precision: ``float32``, or ``bfloat16``: matrix products in half the bits, twice as fast where the processor has
            them; weights, norms and the loss stay as they are.
    """

    holds_out = True

    def __init__(
        self,
        frames: int = 144,
        epochs: int = 100,
        batch: int = 64,
        rate: float = 1e-4,
        seed: int = 0,
        device: str = "cpu",
        seconds: float = 0.0,
        precision: str = "float32",
    ) -> None:
        self.frames = frames
        self.epochs = epochs
        self.batch = batch
        self.rate = rate
        self.seed = seed
        self.device = device
        self.seconds = seconds
        self.precision = precision

    def forward(self, net: nn.Module, x: torch.Tensor) -> torch.Tensor:
        """Logits of windows, float32; whichever the precision of the products."""
        return self.halved(net, x) if self.precision == "bfloat16" else net(x)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """6.42 million parameters for 8 x 8 taxels and 7 classes."""
        return nn.Sequential(
            nn.Flatten(2),
            nn.Linear(rows * cols, WIDTH),
            nn.BatchNorm1d(self.window),
            *(_Attention() for _ in range(LAYERS)),
            nn.Linear(WIDTH, 128),
            nn.ReLU(),
            nn.Linear(128, 16),
            nn.ReLU(),
            nn.Linear(16, 4),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(4 * self.window, classes),
        )

    def learn(
        self,
        net: nn.Module,
        samples: Windows,
        target: np.ndarray,
        judge: Callable[[], float] | None = None,
        kept: Checkpoint | None = None,
    ) -> list[dict[str, float]]:
        """Train with Adam and keep the epoch that is best for the held-out subject."""
        adam = Torch(torch.optim.Adam(net.parameters(), self.rate))
        how = partial(self.forward, net)
        return train(net, samples, target, adam, self.epochs, self.batch, self.seed, None, how, judge, kept=kept)


class _Attention(nn.Module):
    """Self-attention with a residual and layer norm."""

    def __init__(self) -> None:
        super().__init__()
        self.attention = _SelfAttention(WIDTH, HEADS, batch_first=True)
        self.norm = nn.LayerNorm(WIDTH)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.norm(x + self.attention(x))


class _SelfAttention(nn.MultiheadAttention):
    """The layer for queries, keys and values of the same windows, as products that can be of half the bits."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        windows, frames, _ = x.shape
        three = nn.functional.linear(x, self.in_proj_weight, self.in_proj_bias)
        query, key, value = three.view(windows, frames, 3, HEADS, -1).permute(2, 0, 3, 1, 4).flatten(1, 2)
        scores = torch.bmm(query, key.transpose(1, 2)) * (HEADS / WIDTH) ** 0.5
        found = torch.bmm(scores.softmax(-1).to(value.dtype), value)
        return self.out_proj(found.view(windows, HEADS, frames, -1).transpose(1, 2).flatten(2))
