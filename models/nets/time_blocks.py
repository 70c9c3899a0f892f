"""A 3-D convolution of single-channel windows over time and grid, fast: a few large matrix products.

The first convolution of a network on raw frames has one input channel, which leaves a library convolution with 40 to 90
products per output and little to share. Here a short block of output frames is one product: the taxels under the kernel
over the frames that the block needs, times the kernel laid out once per output frame.
"""

from __future__ import annotations

import torch
from torch import nn

from bench.models.nets.taxel_major import halve_axis

BLOCK = 2  # output frames; more of them share input but multiply more zeros


class TimeConv3d(nn.Conv3d):
    """`nn.Conv3d` of one input channel, stride 1 and no padding, with the same parameters and values.

    Input [batch, frames, rows, cols], output [batch, filters, frames, rows, cols] as `nn.Conv3d` gives it for
    [batch, 1, frames, rows, cols].
    """

    def __init__(self, filters: int, kernel: tuple[int, int, int]) -> None:
        super().__init__(1, filters, kernel)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Convolve windows [batch, frames, rows, cols]."""
        return self.filter_frames(x).permute(2, 4, 3, 0, 1) + self.bias[:, None, None, None]

    def filter_frames(self, x: torch.Tensor) -> torch.Tensor:
        """Filtered windows without the bias, [rows, cols, batch, frames, filters]."""
        long, high, wide = self.kernel_size
        batch, frames, rows, cols = x.shape
        out = frames - long + 1, rows - high + 1, cols - wide + 1
        blocks = -(-out[0] // BLOCK)
        need = blocks * BLOCK + long - 1
        grid = x.permute(2, 3, 0, 1)
        if need > frames:
            grid = nn.functional.pad(grid, (0, need - frames))
        taps = [(i, j) for i in range(high) for j in range(wide)]
        under = torch.stack(
            [grid[i : i + out[1], j : j + out[2]] for i, j in taps], 3
        )  # [r, c, batch, taps, frames]
        # [r, c, batch, blocks, taps, frames]
        pieces = under.unfold(4, BLOCK + long - 1, BLOCK).permute(0, 1, 2, 4, 3, 5)
        kernel = self.weight.flatten(3).permute(3, 2, 1, 0)[:, :, 0]  # [taps, frames, filters]
        shifted = [nn.functional.pad(kernel, (0, 0, i, BLOCK - 1 - i)) for i in range(BLOCK)]
        weight = torch.stack(shifted, 2).reshape(len(taps) * (BLOCK + long - 1), -1)
        filtered = pieces.reshape(-1, len(weight)) @ weight
        return filtered.view(*out[1:], batch, blocks * BLOCK, -1)[:, :, :, : out[0]]


def convolve_and_pool(
    conv: TimeConv3d, x: torch.Tensor, pool: tuple[int, int, int]
) -> torch.Tensor:
    """``nn.MaxPool3d(pool)(conv(x))`` for pools of 1 or 2 a side, without work that no pool reaches."""
    used = [
        (n - k + 1) // p * p + k - 1
        for n, k, p in zip(x.shape[1:], conv.kernel_size, pool, strict=True)
    ]
    filtered = conv.filter_frames(x[:, : used[0], : used[1], : used[2]])
    # Columns first, then of equal values the one is taken that the library takes.
    for axis, size in ((1, pool[2]), (0, pool[1]), (3, pool[0])):
        if size == 2:
            filtered = halve_axis(filtered, axis)
    return (filtered + conv.bias).permute(2, 4, 3, 0, 1)
