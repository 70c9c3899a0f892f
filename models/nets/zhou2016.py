"""The 3-D CNN of Zhou and Du 2016 and the three networks that they compare it with.

The abstract states the filters and kernels of the 3-D CNN and the kinds of the other networks.
Everything else is our reading (docs/notes/systems.md, zhou2016): batch norm, poolings, the dense
layer, Adam at 1e-3, and the epoch, which one training subject chooses.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import check_value
from bench.models.nets.training import Dropout
from bench.models.nets.window import FrameNet

FILTERS = (16, 32, 64, 128)
UNITS = 128


class Zhou2016(FrameNet):
    """A network on windows of 432 frames, HAART's whole 8 s, of which each 4 are averaged.

    Windows are zero-padded at the end.

    Args:
        average: number of frames that are averaged into one; 1 keeps the full rate and takes four
            times as long.
        frames, epochs, batch, rate, seed, device, seconds, precision: see `WindowNet`.
    """

    holds_out = True

    frames: int = 432
    average: int = 4
    epochs: int = 60
    batch: int = 32
    rate: float = 1e-3

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the training captures."""
        frames = self.length(X.rate_hz)
        advice = f"1 to {frames}, the frames of a window"
        check_value("model.average", self.average, 1 <= self.average <= frames, advice)
        super().check_training(X, y)


class Zhou2016CNN3D(Zhou2016):
    """Four layers of 16, 32, 64 and 128 kernels of 3 x 3 x 3, a dense layer of 256 with dropout."""

    stacks = True

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """490 119 parameters for 8 x 8 taxels and 7 classes."""
        shape = (self.window // self.average, rows, cols)
        poolings = ((2, 1, 1), (2, 2, 2), (2, 2, 2), (2, 2, 2))
        return nn.Sequential(
            _FrameAverage(self.average),
            *_convolution_layers(shape, (3, 3, 3), poolings),
            nn.Flatten(),
            *_dense_layers(classes),
        )


class Zhou2016CNN2D(Zhou2016):
    """The same kernels without their extent in time, and a dense layer on the mean over time."""

    stacks = True

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        shape = (self.window // self.average, rows, cols)
        return nn.Sequential(
            _FrameAverage(self.average),
            *_frame_layers(shape),
            _TimeMean(),
            *_dense_layers(classes),
        )


class Zhou2016LRCN(Zhou2016):
    """The 2-D layers on each frame, an LSTM of 128 units over frames, its last state decides."""

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        shape = (self.window // self.average, rows, cols)
        pooled_rows, pooled_cols = (max(n // 8, 1) for n in (rows, cols))
        size = pooled_rows * pooled_cols * FILTERS[-1]
        return nn.Sequential(
            _FrameAverage(self.average),
            *_frame_layers(shape),
            _TimeFirst(),
            _LastState(nn.LSTM(size, UNITS, batch_first=True)),
            nn.Linear(UNITS, classes),
        )


class Zhou2016GMLSTM(Zhou2016):
    """Ten geometric moments of each frame and an LSTM of 128 units, whose last state decides."""

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        return nn.Sequential(
            _FrameAverage(self.average),
            _GeometricMoments(rows, cols),
            nn.LazyBatchNorm1d(),
            _TimeFirst(),
            _LastState(nn.LSTM(10, UNITS, batch_first=True)),
            nn.Linear(UNITS, classes),
        )


class _FrameAverage(nn.Module):
    """Means over frames, [batch, frames, rows, cols] to [batch, 1, means, rows, cols]."""

    def __init__(self, frames: int) -> None:
        super().__init__()
        self.frames = frames

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        used = x.shape[1] // self.frames * self.frames
        return x[:, :used].unflatten(1, (-1, self.frames)).mean(2)[:, None].contiguous()


class _TimeMean(nn.Module):
    """[batch, channels, frames, ...] to the mean over frames [batch, values]."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x.mean(2).flatten(1)


class _TimeFirst(nn.Module):
    """[batch, channels, frames, ...] to [batch, frames, values]."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x.transpose(1, 2).flatten(2)


class _LastState(nn.Module):
    """Last state of a recurrent layer."""

    def __init__(self, layer: nn.LSTM) -> None:
        super().__init__()
        self.layer = layer

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.layer(x)[1][0][-1]


class _GeometricMoments(nn.Module):
    """Moments of order 0 to 3, [batch, 1, frames, rows, cols] to [batch, 10, frames].

    Coordinates of the taxels are 0 to 1.
    """

    def __init__(self, rows: int, cols: int) -> None:
        super().__init__()
        axes = torch.linspace(0, 1, rows), torch.linspace(0, 1, cols)
        row, col = torch.meshgrid(*axes, indexing="ij")
        powers = [row**p * col**q for p in range(4) for q in range(4 - p)]
        self.register_buffer("powers", torch.stack(powers).flatten(1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return (x[:, 0].flatten(2) @ self.powers.T).transpose(1, 2)


def _convolution_layers(
    shape: tuple[int, ...], kernel: tuple[int, ...], poolings: tuple[tuple[int, ...], ...]
) -> list[nn.Module]:
    """Convolutions that keep the size, batch norm, ReLU and pooling; poolings are cut to the size.

    Channels come last in memory, which makes the library's layers faster
    (docs/notes/performance.md).
    """
    layers: list[nn.Module] = []
    padding, channels = tuple(k // 2 for k in kernel), 1
    for filters, pooling in zip(FILTERS, poolings, strict=True):
        pool = tuple(min(p, n) for p, n in zip(pooling, shape, strict=True))
        conv = nn.Conv3d(channels, filters, kernel, padding=padding)
        conv = conv.to(memory_format=torch.channels_last_3d)
        layers += [conv, nn.BatchNorm3d(filters), nn.ReLU(), nn.MaxPool3d(pool)]
        shape, channels = tuple(n // p for n, p in zip(shape, pool, strict=True)), filters
    return layers


def _dense_layers(classes: int) -> list[nn.Module]:
    return [nn.LazyLinear(256), nn.ReLU(), Dropout(0.5), nn.Linear(256, classes)]


def _frame_layers(shape: tuple[int, ...]) -> list[nn.Module]:
    """The convolutions without their extent in time."""
    return _convolution_layers(shape, (1, 3, 3), ((1, 1, 1), (1, 2, 2), (1, 2, 2), (1, 2, 2)))
