"""A small network of our own on the signals of touch: the deep contender to `reflex`."""

from __future__ import annotations

from copy import copy

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus
from bench.corpora.windows import Windows
from bench.errors import InputError, check_value
from bench.features.touch import SIGNALS, STEP_SIGNALS, frame_signals
from bench.models.by_source import NO_SCALES, SourceScales, count_batches, learn_scales
from bench.models.nets.training import Dropout, Optimiser, upload
from bench.models.nets.window import WindowNet

CLIP_SDS = 3.0  # at which signals are clipped
DROPOUT = 0.3  # of the inputs of the last layer
WEIGHT_DECAY = 0.05  # decoupled (Loshchilov and Hutter 2019)
SHORTEST_SHARE = 0.4  # of a window: shorter training windows teach early decisions
ROW, COL, FLOW_ROW, FLOW_COL = map(SIGNALS.index, ("row", "col", "flow_row", "flow_col"))


class SignalWindows:
    """Windows of the signals of captures; a short capture is one shorter window.

    Args:
        corpus: the captures.
        frames: length of a window.
        hop: frames from one window's start to the next.
        is_random: True for training windows: PyTorch draws start and length, and whether the skin
            is mirrored or has its rows and columns exchanged.
        scales: scales of the signals by source.

    Attributes are those of `bench.models.nets.training.Windows`, and ``values``, float32 [frames,
    signals].
    """

    def __init__(
        self,
        corpus: Corpus,
        frames: int,
        hop: int,
        is_random: bool = False,
        scales: SourceScales = NO_SCALES,
    ) -> None:
        counts = np.maximum(corpus.lengths - frames, 0) // hop + 1
        self.capture = np.repeat(np.arange(len(corpus)), counts)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        self.start = (np.arange(counts.sum()) - first) * hop
        self.seen = np.minimum(frames, corpus.lengths[self.capture])
        self.steps = np.ones(len(self.capture), dtype=np.int64)
        values = scales.apply(_all_signals(corpus), np.repeat(corpus.sources, corpus.lengths))
        self.values = torch.from_numpy(values)
        self._begin = torch.from_numpy((np.cumsum(corpus.lengths) - corpus.lengths)[self.capture])
        self._length = torch.from_numpy(corpus.lengths[self.capture])
        self.is_added = corpus.is_added[self.capture]
        self._frames, self._hop, self._is_random = frames, hop, is_random

    def __len__(self) -> int:
        return len(self.capture)

    def make_example(self) -> tuple[torch.Tensor, torch.Tensor]:
        """A batch of one full window."""
        return self._cut_windows(self._begin[:1], torch.tensor([self._frames]))

    def place(self, device: torch.device) -> SignalWindows:
        """The same windows, whose signals lie on a device."""
        placed = copy(self)
        placed.values = self.values.to(device)
        return placed

    def make_batch(self, rows: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Signals float32 [rows, frames, signals], arbitrary after an end, and frames of each."""
        start, seen = torch.from_numpy(self.start[rows]), torch.from_numpy(self.seen[rows])
        if not self._is_random:
            return self._cut_windows(self._begin[rows] + start, seen)
        seen = (seen * (SHORTEST_SHARE + (1 - SHORTEST_SHARE) * torch.rand(1))).long().clamp(min=1)
        room = (self._length[rows] - seen - start).clamp(max=self._hop)
        start = start + (torch.rand(len(rows)) * (room + 1)).long()
        values, seen = self._cut_windows(self._begin[rows] + start, seen)
        return _mount_randomly(values), seen

    def _cut_windows(
        self, first: torch.Tensor, seen: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        index = (first[:, None] + torch.arange(int(seen.max()))).clamp(max=len(self.values) - 1)
        device = self.values.device
        return self.values[upload(index, device)], upload(seen, device)


def _all_signals(corpus: Corpus) -> np.ndarray:
    """Signals of all captures, float32 [frames, signals]."""
    return np.concatenate([_capture_signals(frames, corpus.full_scale) for frames in corpus])


def _capture_signals(frames: np.ndarray, full_scale: float) -> np.ndarray:
    """Signals of a capture, float32 [frames, signals]; its first frame has the second's steps."""
    values = frame_signals(frames.astype(np.float32) / np.float32(full_scale)).astype(np.float32)
    values[0, [*STEP_SIGNALS]] = values[min(1, len(values) - 1), [*STEP_SIGNALS]]
    return values


def _mount_randomly(values: torch.Tensor) -> torch.Tensor:
    """Signals [windows, frames, signals] of each window as on a skin in a random mounting."""
    draws = torch.rand(3, len(values), 1) < 0.5
    flip_rows, flip_cols, swap = upload(draws, values.device)
    row = torch.where(flip_rows, 1 - values[..., ROW], values[..., ROW])
    flow_row = torch.where(flip_rows, -values[..., FLOW_ROW], values[..., FLOW_ROW])
    col = torch.where(flip_cols, 1 - values[..., COL], values[..., COL])
    flow_col = torch.where(flip_cols, -values[..., FLOW_COL], values[..., FLOW_COL])
    values = values.clone()
    values[..., ROW] = torch.where(swap, col, row)
    values[..., COL] = torch.where(swap, row, col)
    values[..., FLOW_ROW] = torch.where(swap, flow_col, flow_row)
    values[..., FLOW_COL] = torch.where(swap, flow_row, flow_col)
    return values


class TouchNet(WindowNet):
    """Three convolutions over time of the 19 signals of `bench.features.touch`, pooled over time.

    Signals are standardised on the training frames and clipped at 3 SDs. Mean, maximum and SD over
    time go to a linear layer. Windows are 1 s, one every 0.5 s; shorter captures, and 0.4 to 1 s of
    training windows, are used as they are, so that early decisions are learnt, too. Training
    windows are mirrored and turned at random. Nothing depends on the number of frames or taxels, or
    on sensor units. Every number was chosen on the training part of HAART's challenge split, or is
    round (docs/notes/systems.md, touchnet).

    Args:
        width: channels of the first layer; the second has one and a half, the third two times as
            many.
        kernel: frames under a filter of the first two layers.
        updates: number of training batches, rounded up to whole passes over the training windows.
        smoothing: share of a label that is spread over all classes.
        rate: highest learning rate, a third of the way (one cycle, Smith and Topin 2019).
        seconds, batch, seed, device: see `WindowNet`; ``batch`` windows per update.
    """

    stacks = True

    seconds: float = 1.0
    width: int = 16
    kernel: int = 9
    updates: int = 1500
    batch: int = 128
    rate: float = 4e-3
    smoothing: float = 0.1

    def check(self) -> None:
        """Check the parameters."""
        super().check()
        check_value("model.width", self.width, 1 <= self.width <= 4096, "1 to 4096")
        is_valid = self.kernel % 2 == 1 and 1 <= self.kernel <= 99
        check_value("model.kernel", self.kernel, is_valid, "an odd number from 1 to 99")
        check_value("model.updates", self.updates, 1 <= self.updates <= 10_000_000, "1 to 10000000")
        check_value("model.batch", self.batch, self.batch >= 2, "at least 2, for batch norm")
        check_value("model.seconds", self.seconds, self.seconds > 0, "a number above 0")
        check_value("model.smoothing", self.smoothing, 0 <= self.smoothing < 1, "0 to below 1")

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the training captures."""
        super().check_training(X, y)
        if len(Windows(self.seconds).source_rows(X)) < 2:
            raise InputError("touchnet needs two training windows at least")

    def samples(self, corpus: Corpus) -> SignalWindows:
        """Windows, one every half window."""
        return SignalWindows(corpus, self.window, (self.window + 1) // 2, scales=self.scales_)

    def training_samples(self, corpus: Corpus) -> SignalWindows:
        """Windows that are drawn anew in every batch."""
        return SignalWindows(corpus, self.window, (self.window + 1) // 2, True, self.scales_)

    def learn_scales(self, X: Corpus) -> SourceScales:
        """Scales of the signals by source."""
        return learn_scales(X, _all_signals)

    def at_one_scale(self, X: Corpus) -> Corpus:
        """The captures as they are, since `SignalWindows` scales their signals."""
        return X

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """Network of 4 to 40 thousand parameters on any grid."""
        width, middle, wide = self.width, self.width * 3 // 2, 2 * self.width
        layers = [
            _make_block(len(SIGNALS), width, self.kernel),
            _make_block(width, middle, self.kernel),
            _make_block(middle, wide, 3),
        ]
        return _SignalNet(layers, nn.Linear(3 * wide, classes))

    def prepare(self, net: nn.Module, samples: SignalWindows) -> list[dict[str, float]] | None:
        """Learn mean and SD of the signals from the training frames."""
        net.learn_scale(samples.values)

    def epoch_limit(self, samples: SignalWindows) -> int:
        """Number of whole passes with at least ``updates`` batches."""
        return -(-self.updates // count_batches(samples.is_added, self.batch))

    def optimiser(self, net: nn.Module, samples: SignalWindows) -> OneCycle:
        """AdamW with one cycle of the rate."""
        adam = torch.optim.AdamW(net.parameters(), self.rate, weight_decay=WEIGHT_DECAY)
        steps = self.epoch_limit(samples) * count_batches(samples.is_added, self.batch)
        return OneCycle(adam, self.rate, steps)


class _SignalNet(nn.Module):
    """Signals [windows, frames, signals] and frames of each window to logits [windows, classes]."""

    def __init__(self, layers: list[nn.Module], last: nn.Linear) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers)
        self.dropout = Dropout(DROPOUT)
        self.last = last
        self.register_buffer("mean", torch.zeros(len(SIGNALS)))
        self.register_buffer("scale", torch.ones(len(SIGNALS)))

    def learn_scale(self, values: torch.Tensor) -> None:
        """Learn mean and SD of signals [frames, signals]; constant ones become 0.

        Raises:
            ValueError: a signal is not finite.
        """
        if not torch.isfinite(values).all():
            raise ValueError("some readings of the training captures are not finite")
        sd, mean = torch.std_mean(values.double(), dim=0, correction=0)
        self.mean.copy_(mean)
        self.scale.copy_(torch.where(sd > 1e-6, sd, torch.inf))

    def forward(self, batch: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
        values, seen = batch
        x = ((values - self.mean) / self.scale).clamp(-CLIP_SDS, CLIP_SDS).transpose(1, 2)
        for number, layer in enumerate(self.layers):
            x = layer(x * _frame_mask(x, seen))
            if number < 2 and x.shape[2] > 1:
                x, seen = nn.functional.max_pool1d(x, 2), (seen // 2).clamp(min=1)
        mask = _frame_mask(x, seen)
        count = seen[:, None]
        mean = (x * mask).sum(2) / count
        sd = (((x - mean[:, :, None]) * mask).square().sum(2) / count + 1e-6).sqrt()
        maximum = (x * mask).amax(2)  # values are rectified, so masked zeros do not exceed it
        return self.last(self.dropout(torch.cat([mean, maximum, sd], 1)))


def _frame_mask(x: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """1 within a window and 0 after its end [windows, 1, frames]."""
    return (torch.arange(x.shape[2], device=x.device) < seen[:, None])[:, None].to(x.dtype)


def _make_block(inputs: int, outputs: int, kernel: int) -> nn.Module:
    """Convolution over time that keeps the number of frames, batch norm and ReLU."""
    convolution = nn.Conv1d(inputs, outputs, kernel, padding=kernel // 2, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm1d(outputs), nn.ReLU())


class OneCycle(Optimiser):
    """An optimiser whose rate rises to its highest and falls to 0 in a number of steps."""

    def __init__(self, optimiser: torch.optim.Optimizer, rate: float, steps: int) -> None:
        super().__init__(optimiser)
        self.rate = rate
        self.cycle = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps)

    def step(self) -> None:
        """Update the parameters, then the rate."""
        super().step()
        if self.cycle.last_epoch < self.cycle.total_steps - 1:
            self.cycle.step()
