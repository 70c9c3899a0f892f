"""A fast 3-D convolution of single-channel windows over time and grid: a few large matrix products.

The first convolution of a network on raw frames has one input channel, so a library convolution has
only 40 to 90 products per output. Here a short block of output frames is one matrix product: the
taxels under the kernel over the frames of the block, times the kernel shifted to each output frame.
"""

from __future__ import annotations

import torch
from torch import nn

from bench.models.nets.taxel_major import halve_axis

BLOCK = 2  # output frames; larger blocks share more input, but multiply more zeros


class TimeConv3d(nn.Conv3d):
    """`nn.Conv3d` of one input channel, stride 1, no padding, with the same parameters.

    Input [batch, frames, rows, cols], output [batch, filters, frames, rows, cols] as `nn.Conv3d`
    gives it for [batch, 1, frames, rows, cols].
    """

    def __init__(self, filters: int, kernel: tuple[int, int, int]) -> None:
        super().__init__(1, filters, kernel)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Convolve windows [batch, frames, rows, cols], by the library."""
        return super().forward(x[:, None])

    def filter_frames(self, x: torch.Tensor) -> torch.Tensor:
        """Filtered windows without the bias, [rows, cols, batch, frames, filters]."""
        long, high, wide = self.kernel_size
        batch, frames, rows, cols = x.shape
        out = frames - long + 1, rows - high + 1, cols - wide + 1
        blocks = -(-out[0] // BLOCK)
        block_frames = BLOCK + long - 1
        missing = blocks * BLOCK + long - 1 - frames
        grid = x.permute(2, 3, 0, 1)
        if missing > 0:
            grid = nn.functional.pad(grid, (0, missing))
        taps = [(i, j) for i in range(high) for j in range(wide)]
        shifted_grids = [grid[i : i + out[1], j : j + out[2]] for i, j in taps]
        under_kernel = torch.stack(shifted_grids, 3)  # [r, c, batch, taps, frames]
        # [r, c, batch, blocks, taps, frames]
        pieces = under_kernel.unfold(4, block_frames, BLOCK).permute(0, 1, 2, 4, 3, 5)
        kernel = self.weight.flatten(3).permute(3, 2, 1, 0)[:, :, 0]  # [taps, frames, filters]
        kernels = [nn.functional.pad(kernel, (0, 0, i, BLOCK - 1 - i)) for i in range(BLOCK)]
        weight = torch.stack(kernels, 2).reshape(len(taps) * block_frames, -1)
        filtered = pieces.reshape(-1, len(weight)) @ weight
        return filtered.view(*out[1:], batch, blocks * BLOCK, -1)[:, :, :, : out[0]]


def convolve_and_pool(
    conv: TimeConv3d, x: torch.Tensor, pool: tuple[int, int, int]
) -> torch.Tensor:
    """Compute ``nn.MaxPool3d(pool)(conv(x))`` for pools of side 1 or 2, and no unused output."""
    sides = zip(x.shape[1:], conv.kernel_size, pool, strict=True)
    frames, rows, cols = ((n - k + 1) // p * p + k - 1 for n, k, p in sides)
    filtered = conv.filter_frames(x[:, :frames, :rows, :cols])
    # Columns come first, so that ties are resolved as in the library.
    for axis, size in ((1, pool[2]), (0, pool[1]), (3, pool[0])):
        if size == 2:
            filtered = halve_axis(filtered, axis)
    return (filtered + conv.bias).permute(2, 4, 3, 0, 1)
