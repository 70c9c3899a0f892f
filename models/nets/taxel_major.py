"""Fast convolutions of small images: matrix products on [rows, cols, batch, channels].

A touch frame has 8 x 8 taxels, which a network halves twice, so a library convolution spends up to
two fifths of its work on zero padding. With the grid as the outer axes, one row of one kernel tap
is a contiguous matrix, and taps on padding are not computed at all. The network stays an ordinary
`nn.Sequential`; `run_taxel_major` only runs it in another order (tests/models/test_taxel_major.py
compares outputs and gradients).
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import nn


def run_taxel_major(net: nn.Sequential, x: torch.Tensor) -> torch.Tensor:
    """Run blocks of a convolution, ReLU and 2 x 2 pooling, then `nn.Flatten` and the other layers.

    Args:
        net: ``Conv2d`` (stride 1, zero padding), ``ReLU``, ``MaxPool2d(2, ceil_mode=True)``,
            repeated up to ``Flatten``.
        x: [batch, channels, rows, cols]; fastest with the memory layout [rows, cols, batch,
            channels].

    Returns:
        The output of ``net(x)``, up to rounding.
    """
    end = next(i for i, layer in enumerate(net) if isinstance(layer, nn.Flatten))
    grid = x.permute(2, 3, 0, 1).contiguous()
    for conv in net[:end:3]:
        weight = conv.weight.permute(2, 3, 1, 0).contiguous()
        grid = convolve_grid(grid, weight, conv.bias, *conv.padding)
        # ReLU and pooling commute, and pooling first leaves a quarter of the work
        grid = max_pool(grid).relu()
    return net[end:](grid.permute(2, 3, 0, 1))


def max_pool(grid: torch.Tensor) -> torch.Tensor:
    """Maximum of 2 x 2 positions, stride 2, incomplete ones at the end included."""
    return _Halving.apply(_Halving.apply(grid, 0), 1)


class _Halving(torch.autograd.Function):
    """The larger of each pair along an axis (the first of equal ones); an odd last one stays."""

    @staticmethod
    def forward(ctx: object, grid: torch.Tensor, axis: int) -> torch.Tensor:
        first, second, odd = _split_pairs(grid, axis)
        ctx.save_for_backward(first >= second)
        ctx.axis, ctx.shape = axis, grid.shape
        larger = torch.maximum(first, second)
        return torch.cat([larger, odd], axis) if odd is not None else larger

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> tuple:
        (is_first,) = ctx.saved_tensors
        for_grid = gradient.new_empty(ctx.shape)
        first, second, odd = _split_pairs(for_grid, ctx.axis)
        pairs = gradient.narrow(ctx.axis, 0, first.shape[ctx.axis])
        torch.mul(pairs, is_first, out=first)
        torch.sub(pairs, first, out=second)
        if odd is not None:
            odd.copy_(gradient.narrow(ctx.axis, gradient.shape[ctx.axis] - 1, 1))
        return for_grid, None


def _split_pairs(
    grid: torch.Tensor, axis: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
    size = grid.shape[axis]
    pairs = grid.narrow(axis, 0, size - size % 2).unflatten(axis, (-1, 2))
    odd = grid.narrow(axis, size - 1, 1) if size % 2 else None
    return pairs.select(axis + 1, 0), pairs.select(axis + 1, 1), odd


class _Convolution(torch.autograd.Function):
    """Cross-correlation, stride 1, zero padding.

    Input [rows, cols, batch, in], weight [kernel rows, kernel cols, in, out].
    """

    @staticmethod
    def forward(
        ctx: object,
        x: torch.Tensor,
        weight: torch.Tensor,
        bias: torch.Tensor,
        down: int,
        right: int,
    ) -> torch.Tensor:
        rows, cols, batch, channels = x.shape
        high, wide, _, outputs = weight.shape
        shape = rows + 2 * down - high + 1, cols + 2 * right - wide + 1, batch, outputs
        out = bias.expand(shape).contiguous()
        for tap, into, source in _iter_kernel_rows(x.shape, weight.shape, down, right):
            out[into].view(-1, outputs).addmm_(x[source].view(-1, channels), weight[tap])
        ctx.save_for_backward(x, weight)
        ctx.padding = down, right
        return out

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> tuple:
        x, weight = ctx.saved_tensors
        gradient = gradient.contiguous()
        channels, outputs = x.shape[3], weight.shape[3]
        for_x = torch.zeros_like(x) if ctx.needs_input_grad[0] else None
        for_weight = torch.zeros_like(weight)
        for tap, into, source in _iter_kernel_rows(x.shape, weight.shape, *ctx.padding):
            part = gradient[into].view(-1, outputs)
            for_weight[tap].addmm_(x[source].view(-1, channels).T, part)
            if for_x is not None:
                for_x[source].view(-1, channels).addmm_(part, weight[tap].T)
        return for_x, for_weight, gradient.sum((0, 1, 2)), None, None


convolve_grid = _Convolution.apply
halve_axis = _Halving.apply


def _iter_kernel_rows(x: torch.Size, weight: torch.Size, down: int, right: int) -> Iterator[tuple]:
    """Yield each kernel tap with its part of an output row and of an input row.

    Rows follow one another, so that the data of a row is still in the cache.
    """
    rows, cols = x[:2]
    high, wide = weight[:2]
    for row in range(rows + 2 * down - high + 1):
        for i in range(max(0, down - row), min(high, rows + down - row)):
            for j in range(wide):
                first = max(0, right - j)
                last = min(cols + 2 * right - wide + 1, cols + right - j)
                source = slice(first + j - right, last + j - right)
                if last > first:
                    yield (i, j), (row, slice(first, last)), (row + i - down, source)
