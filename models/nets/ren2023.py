"""The attention network of Ren, Hou and Belpaeme 2023 (HRI companion)."""

from __future__ import annotations

import torch
from torch import nn

from bench.models.nets.window import FrameNet

WIDTH = 512
HEADS = 8
LAYERS = 6


class Ren2023Transformer(FrameNet):
    """Six layers of self-attention over 144 frames, no feed-forward layers, positions or masks.

    The authors keep the epoch that is best on the test part. Here it is the best one for a held-out
    training subject. Windows do not overlap; a capture of HAART has three.

    Args:
        frames, epochs, batch, rate, seed, device, seconds, precision: see `WindowNet`.
    """

    holds_out = True
    stacks = True

    frames: int = 144
    epochs: int = 100
    batch: int = 64
    rate: float = 1e-4

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


class _Attention(nn.Module):
    """Self-attention with a residual and layer norm."""

    def __init__(self) -> None:
        super().__init__()
        self.attention = _SelfAttention(WIDTH, HEADS, batch_first=True)
        self.norm = nn.LayerNorm(WIDTH)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.norm(x + self.attention(x))


class _SelfAttention(nn.MultiheadAttention):
    """Attention of windows to themselves, by matrix products that can be computed in bfloat16."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        windows, frames, _ = x.shape
        projected = nn.functional.linear(x, self.in_proj_weight, self.in_proj_bias)
        by_head = projected.view(windows, frames, 3, HEADS, -1).permute(2, 0, 3, 1, 4)
        query, key, value = by_head.flatten(1, 2)
        scores = torch.bmm(query, key.transpose(1, 2)) * (HEADS / WIDTH) ** 0.5
        attended = torch.bmm(scores.softmax(-1).to(value.dtype), value)
        return self.out_proj(attended.view(windows, HEADS, frames, -1).transpose(1, 2).flatten(2))
