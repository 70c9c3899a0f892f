"""The 3-D CNN of Zhou and Du 2016 and the three networks that they compare it with.

The abstract gives the filters and kernels of the 3-D CNN and the kinds of its rivals; everything else is our reading
(docs/notes/systems.md, zhou2016): batch norm, poolings, the dense layer, Adam at 1e-3, and the epoch, which one
training subject chooses.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.models.nets.window import FrameNet

FILTERS = (16, 32, 64, 128)
UNITS = 128


class Zhou2016(FrameNet):
    """A network on 432 frames, HAART's whole 8 s, averaged over each 4 of them; longer captures make several windows.

    Windows are zero-padded at the end.

    Args:
        average: frames that are averaged into one; 1 for the full rate, which takes four times as long.
        frames, epochs, batch, rate, seed, device, seconds, precision: see `WindowNet`.
    """

    holds_out = True

    frames: int = 432
    average: int = 4
    epochs: int = 60
    batch: int = 32
    rate: float = 1e-3

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse a training part before anything is run."""
        frames = self.length(X.rate_hz)
        if not 1 <= self.average <= frames:
            raise InputError(
                f"model.average={self.average}: give 1 to {frames}, the frames of a window"
            )
        super().check_training(X, y)


class Zhou2016CNN3D(Zhou2016):
    """Four layers of 16, 32, 64 and 128 kernels of 3 x 3 x 3, a dense layer of 256 with dropout."""

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
    """The same kernels without their extent in time; the mean over time goes to the dense layer."""

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        return nn.Sequential(
            _FrameAverage(self.average),
            *_frame_layers((self.window // self.average, rows, cols)),
            _MeanOverTime(),
            *_dense_layers(classes),
        )


class Zhou2016LRCN(Zhou2016):
    """The 2-D layers on each frame, an LSTM of 128 units over them, a decision from its last state."""

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        shape = (self.window // self.average, rows, cols)
        size = _pooled_size(shape, FILTERS[-1])
        return nn.Sequential(
            _FrameAverage(self.average),
            *_frame_layers(shape),
            _TimeFirst(),
            _LastState(nn.LSTM(size, UNITS, batch_first=True)),
            nn.Linear(UNITS, classes),
        )


class Zhou2016GMLSTM(Zhou2016):
    """Ten geometric moments of each frame, an LSTM of 128 units over them, a decision from its last state."""

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
    """[batch, frames, rows, cols] to [batch, 1, fewer frames, rows, cols]; frames that are left over are dropped."""

    def __init__(self, frames: int) -> None:
        super().__init__()
        self.frames = frames

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        used = x.shape[1] // self.frames * self.frames
        return x[:, :used].unflatten(1, (-1, self.frames)).mean(2)[:, None].contiguous()


class _MeanOverTime(nn.Module):
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
    """[batch, 1, frames, rows, cols] to moments of order 0 to 3 [batch, 10, frames], of coordinates from 0 to 1."""

    def __init__(self, rows: int, cols: int) -> None:
        super().__init__()
        row, col = torch.meshgrid(
            torch.linspace(0, 1, rows), torch.linspace(0, 1, cols), indexing="ij"
        )
        powers = [row**p * col**q for p in range(4) for q in range(4 - p)]
        self.register_buffer("powers", torch.stack(powers).flatten(1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return (x[:, 0].flatten(2) @ self.powers.T).transpose(1, 2)


def _convolution_layers(
    shape: tuple[int, ...], kernel: tuple[int, ...], poolings: tuple[tuple[int, ...], ...]
) -> list[nn.Module]:
    """Convolutions that keep the size, batch norm, ReLU and pooling; poolings are cut to what is there.

    Channels come last in memory, which makes the library's layers faster (docs/notes/performance.md).
    """
    layers: list[nn.Module] = []
    channels = 1
    for filters, pooling in zip(FILTERS, poolings, strict=True):
        cut = tuple(min(p, n) for p, n in zip(pooling, shape, strict=True))
        padding = tuple(k // 2 for k in kernel)
        conv = nn.Conv3d(channels, filters, kernel, padding=padding).to(
            memory_format=torch.channels_last_3d
        )
        layers += [conv, nn.BatchNorm3d(filters), nn.ReLU(), nn.MaxPool3d(cut)]
        shape, channels = tuple(n // p for n, p in zip(shape, cut, strict=True)), filters
    return layers


def _dense_layers(classes: int) -> list[nn.Module]:
    return [nn.LazyLinear(256), nn.ReLU(), nn.Dropout(0.5), nn.Linear(256, classes)]


def _frame_layers(shape: tuple[int, ...]) -> list[nn.Module]:
    return _convolution_layers(shape, (1, 3, 3), ((1, 1, 1), (1, 2, 2), (1, 2, 2), (1, 2, 2)))


def _pooled_size(shape: tuple[int, ...], channels: int) -> int:
    rows, cols = shape[1:]
    for _ in range(3):
        rows, cols = max(rows // 2, 1), max(cols // 2, 1)
    return rows * cols * channels
