"""Stacks of 3-D convolution, batch norm, ReLU and pooling, fast: few passes over memory, products as in `taxel_major`.

A library spends half of its time on such a network in batch norm, ReLU and pooling, which compute next to nothing. Here
pooling comes first, so that the rest has a half to an eighth of the values to do. The three commute where batch norm
keeps the order of values; where its scale is negative, the filter is negated. The layers stay the ordinary modules with
their ordinary parameters (tests/models/test_volumes.py compares outputs, gradients and running statistics).
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import nn

from models.taxel_major import convolve


def volumes(layers: Iterable[nn.Module], x: torch.Tensor) -> torch.Tensor:
    """Run layers in fours: convolution, batch norm, ReLU, pooling.

    In training a convolution's bias gets no gradient: batch norm subtracts it again, so it is zero.

    Args:
        layers: ``Conv3d`` (stride 1, zero padding), ``BatchNorm3d``, ``ReLU`` and ``MaxPool3d`` (a tuple of 1 and 2).
        x: [batch, channels, frames, rows, cols].

    Returns:
        What ``nn.Sequential(*layers)(x)`` returns, up to rounding.
    """
    grid = x.permute(3, 4, 2, 0, 1).contiguous()
    for conv, norm, _, pool in zip(*[iter(layers)] * 4, strict=True):
        sign = torch.where(norm.weight < 0, -1.0, 1.0).to(x.dtype)
        found = _convolution(grid, conv.weight * sign[:, None, None, None, None], conv.padding)
        # Columns first, then of equal values the one is taken that the library takes.
        axes = [axis for axis, size in zip((1, 0, 2), pool.kernel_size[::-1], strict=True) if size == 2]
        if norm.training:
            grid, mean, variance = _PoolNorm.apply(found, norm.weight * sign, norm.bias, norm.eps, axes)
            _remember(norm, mean * sign + conv.bias, variance, found[..., 0].numel())
        else:
            for axis in axes:
                found = torch.maximum(*_pairs(found, axis))
            scale = norm.weight / (norm.running_var + norm.eps).sqrt()
            shift = norm.bias + (conv.bias - norm.running_mean) * scale
            grid = torch.addcmul(shift, found, scale * sign).relu_()
    return grid.permute(3, 4, 2, 0, 1)


def _convolution(grid: torch.Tensor, weight: torch.Tensor, padding: tuple[int, int, int]) -> torch.Tensor:
    """Cross-correlation of [rows, cols, frames, batch, in] with [out, in, frames, rows, cols], without a bias."""
    filters, channels, long, high, wide = weight.shape
    before, down, right = padding
    if channels == 1:  # one matrix product for all taps together
        padded = nn.functional.pad(grid[..., 0], (0, 0, before, before, right, right, down, down))
        rows, cols, frames = (n - k + 1 for n, k in zip(padded.shape, (high, wide, long), strict=False))
        taps = [
            padded[i : i + rows, j : j + cols, k : k + frames]
            for k in range(long)
            for i in range(high)
            for j in range(wide)
        ]
        found = torch.stack(taps).flatten(1).T @ weight.flatten(1).T
        return found.view(rows, cols, frames, -1, filters)
    if long > 1:
        grid = _Unfold.apply(grid, long, before)
    by_tap = weight.permute(3, 4, 2, 1, 0).reshape(high, wide, -1, filters)
    found = convolve(grid.flatten(2, 3), by_tap, weight.new_zeros(filters), down, right)
    return found.unflatten(2, grid.shape[2:4])


def _remember(norm: nn.BatchNorm3d, mean: torch.Tensor, variance: torch.Tensor, count: int) -> None:
    """Move the running statistics as the layer itself does."""
    with torch.no_grad():
        norm.running_mean.lerp_(mean, norm.momentum)
        norm.running_var.lerp_(variance * (count / max(count - 1, 1)), norm.momentum)
        norm.num_batches_tracked += 1


class _Unfold(torch.autograd.Function):
    """The frames under a kernel side by side as channels, [rows, cols, frames, batch, long x channels]."""

    @staticmethod
    def forward(ctx: object, grid: torch.Tensor, long: int, before: int) -> torch.Tensor:
        rows, cols, frames, batch, channels = grid.shape
        ctx.frames, ctx.long, ctx.before = frames, long, before
        out = grid.new_zeros(rows, cols, frames + 2 * before - long + 1, batch, long, channels)
        for k, into, source in _shifts(frames, long, before):
            out[:, :, into, :, k] = grid[:, :, source]
        return out.flatten(4)

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> tuple:
        taps = gradient.unflatten(4, (ctx.long, -1))
        for_grid = gradient.new_zeros(*taps.shape[:2], ctx.frames, taps.shape[3], taps.shape[5])
        for k, into, source in _shifts(ctx.frames, ctx.long, ctx.before):
            for_grid[:, :, source] += taps[:, :, into, :, k]
        return for_grid, None, None


def _shifts(frames: int, long: int, before: int) -> Iterable[tuple[int, slice, slice]]:
    """Every frame of a kernel with the output frames it adds to and the input frames it reads."""
    for k in range(long):
        first = max(0, before - k)
        last = max(first, min(frames + 2 * before - long + 1, frames + before - k))
        yield k, slice(first, last), slice(first + k - before, last + k - before)


class _PoolNorm(torch.autograd.Function):
    """Pooling by halving some axes, then batch norm with the statistics before pooling, then ReLU.

    Takes [rows, cols, frames, batch, channels] and scales that are not negative; gives mean and variance, too.
    """

    @staticmethod
    def forward(
        ctx: object, grid: torch.Tensor, scale: torch.Tensor, bias: torch.Tensor, eps: float, axes: list[int]
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        mean = grid.flatten(0, 3).mean(0)
        grid = grid.sub(mean)
        variance = grid.flatten(0, 3).square().mean(0)
        pooled, is_first = grid, []
        for axis in axes:
            first, second = _pairs(pooled, axis)
            is_first.append(first >= second)
            pooled = torch.maximum(first, second)
        spread = (variance + eps).rsqrt()
        out = torch.addcmul(bias, pooled, scale * spread).relu_()
        ctx.save_for_backward(grid, pooled, out, scale, spread, *is_first)
        ctx.axes = axes
        ctx.mark_non_differentiable(mean, variance)
        return out, mean, variance

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor, *_: None) -> tuple:
        grid, pooled, out, scale, spread, *is_first = ctx.saved_tensors
        gradient = gradient * (out > 0)
        for_bias = gradient.flatten(0, 3).sum(0)
        for_scale = (gradient * pooled).flatten(0, 3).sum(0) * spread
        factor = scale * spread
        for_grid = gradient * factor
        shapes = [list(grid.shape)]
        for axis in ctx.axes:
            shapes.append([n // 2 if i == axis else n for i, n in enumerate(shapes[-1])])
        for axis, shape, was_first in zip(ctx.axes[::-1], shapes[-2::-1], is_first[::-1], strict=True):
            below, for_grid = for_grid, grid.new_zeros(shape) if shape[axis] % 2 else grid.new_empty(shape)
            first, second = _pairs(for_grid, axis)
            torch.mul(below, was_first, out=first)
            torch.sub(below, first, out=second)
        count = grid[..., 0].numel()
        for_grid.addcmul_(grid, factor * spread * for_scale / -count).sub_(factor * for_bias / count)
        return for_grid, for_scale, for_bias, None, None


def _pairs(grid: torch.Tensor, axis: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Each two neighbours along an axis; an odd one at the end is left out."""
    pairs = grid.narrow(axis, 0, grid.shape[axis] // 2 * 2).unflatten(axis, (-1, 2))
    return pairs.select(axis + 1, 0), pairs.select(axis + 1, 1)
