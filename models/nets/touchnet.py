"""A small network of our own on the signals of touch: the deep contender to `reflex`."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.touch import SIGNALS, STEP_SIGNALS, frame_signals
from bench.models.nets.training import Optimiser
from bench.models.nets.window import WindowNet

CLIP_SDS = 3.0  # SDs beyond which a signal says no more
DROPOUT = 0.3  # of what the last layer sees, while it learns
WEIGHT_DECAY = 0.05  # of the weights, decoupled (Loshchilov and Hutter 2019)
SHORTEST_SHARE = 0.4  # of a training window, in windows: what is right early is learnt, too
ROW, COL, FLOW_ROW, FLOW_COL = (
    SIGNALS.index(name) for name in ("row", "col", "flow_row", "flow_col")
)


class SignalWindows:
    """Windows of the signals of captures; short captures are shorter windows.

    Args:
        corpus: the captures.
        frames: length of a window.
        hop: frames from one window's start to the next.
        drawn: True for windows of training: start and length are drawn, and the skin is mirrored or has its rows and
            columns exchanged by a draw. PyTorch draws.

    Attributes are those of `bench.models.nets.training.Windows`, and ``values``, float32 [frames, signals].
    """

    def __init__(self, corpus: Corpus, frames: int, hop: int, drawn: bool = False) -> None:
        counts = np.maximum(corpus.lengths - frames, 0) // hop + 1
        self.capture = np.repeat(np.arange(len(corpus)), counts)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        self.start = (np.arange(counts.sum()) - first) * hop
        self.seen = np.minimum(frames, corpus.lengths[self.capture])
        self.steps = np.ones(len(self.capture), dtype=np.int64)
        values = [_capture_signals(corpus[int(i)], corpus.full_scale) for i in range(len(corpus))]
        self.values = torch.from_numpy(np.concatenate(values))
        self._begin = torch.from_numpy((np.cumsum(corpus.lengths) - corpus.lengths)[self.capture])
        self._length = torch.from_numpy(corpus.lengths[self.capture])
        self._frames, self._hop, self._drawn = frames, hop, drawn

    def __len__(self) -> int:
        return len(self.capture)

    def make_example(self) -> tuple[torch.Tensor, torch.Tensor]:
        """A batch of one window of full length."""
        return self._cut_windows(self._begin[:1], torch.tensor([self._frames]))

    def make_batch(self, rows: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Signals float32 [rows, frames, signals], of anything behind the end of a window, and the frames of each."""
        start, seen = torch.from_numpy(self.start[rows]), torch.from_numpy(self.seen[rows])
        if not self._drawn:
            return self._cut_windows(self._begin[rows] + start, seen)
        seen = (seen * (SHORTEST_SHARE + (1 - SHORTEST_SHARE) * torch.rand(1))).long().clamp(min=1)
        room = (self._length[rows] - seen - start).clamp(max=self._hop)
        start = start + (torch.rand(len(rows)) * (room + 1)).long()
        values, seen = self._cut_windows(self._begin[rows] + start, seen)
        return _mount_randomly(values), seen

    def _cut_windows(
        self, first: torch.Tensor, seen: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        index = first[:, None] + torch.arange(int(seen.max()))
        return self.values[index.clamp(max=len(self.values) - 1)], seen


def _capture_signals(frames: np.ndarray, full_scale: float) -> np.ndarray:
    """Of a capture, float32 [frames, signals]; of its first frame, what belongs to a step is that of the second."""
    values = frame_signals(frames.astype(np.float32) / np.float32(full_scale)).astype(np.float32)
    values[0, [*STEP_SIGNALS]] = values[min(1, len(values) - 1), [*STEP_SIGNALS]]
    return values


def _mount_randomly(values: torch.Tensor) -> torch.Tensor:
    """Signals [windows, frames, signals] of each window as on a skin that was mounted otherwise."""
    upside, aside, exchanged = torch.rand(3, len(values), 1) < 0.5
    row = torch.where(upside, 1 - values[..., ROW], values[..., ROW])
    flow_row = torch.where(upside, -values[..., FLOW_ROW], values[..., FLOW_ROW])
    col = torch.where(aside, 1 - values[..., COL], values[..., COL])
    flow_col = torch.where(aside, -values[..., FLOW_COL], values[..., FLOW_COL])
    values = values.clone()
    values[..., ROW], values[..., COL] = (
        torch.where(exchanged, col, row),
        torch.where(exchanged, row, col),
    )
    values[..., FLOW_ROW] = torch.where(exchanged, flow_col, flow_row)
    values[..., FLOW_COL] = torch.where(exchanged, flow_row, flow_col)
    return values


class TouchNet(WindowNet):
    """Three convolutions over time of the 19 signals of `bench.features.touch`; mean, largest value and SD decide.

    Signals are in SDs of the training frames, cut off at 3. Windows of a second, one every half second; shorter
    captures, and 0.4 to 1 s of training windows, are taken as they are, so that it decides early, too. Training
    windows are mirrored and turned at random. Nothing counts frames, taxels or sensor units. Every number was chosen on
    the training part of HAART's challenge split, or is round (docs/notes/systems.md, touchnet).

    Args:
        width: channels of the first layer; the second has one and a half, the third two times as many.
        kernel: frames under a filter of the first two layers.
        updates: batches that it learns from, rounded up to whole passes over the training windows.
        smoothing: share of a label that is spread over all classes.
        rate: highest learning rate, a third of the way (one cycle, Smith and Topin 2019).
        seconds, batch, seed, device: see `WindowNet`; ``batch`` windows per update.
    """

    seconds: float = 1.0
    width: int = 16
    kernel: int = 9
    updates: int = 1500
    batch: int = 128
    rate: float = 4e-3
    smoothing: float = 0.1

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run."""
        super().check()
        for name, most in (("width", 4096), ("kernel", 99), ("updates", 10_000_000)):
            if not 1 <= getattr(self, name) <= most:
                raise InputError(f"model.{name}={getattr(self, name)}: give 1 to {most}")
        if self.batch < 2:
            raise InputError(f"model.batch={self.batch}: give at least 2, batch norm compares")
        if self.kernel % 2 == 0:
            raise InputError(f"model.kernel={self.kernel}: give an odd number")
        if not self.seconds:
            raise InputError("model.seconds=0: give a number above 0")
        if not 0 <= self.smoothing < 1:
            raise InputError(f"model.smoothing={self.smoothing:g}: give 0 to below 1")

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse a training part before anything is run."""
        super().check_training(X, y)
        frames = self.length(X.rate_hz)
        if (np.maximum(X.lengths - frames, 0) // ((frames + 1) // 2) + 1).sum() < 2:
            raise InputError("touchnet needs two training windows at least")

    def samples(self, corpus: Corpus) -> SignalWindows:
        """Windows, one every half window."""
        return SignalWindows(corpus, self.window, (self.window + 1) // 2)

    def training_samples(self, corpus: Corpus) -> SignalWindows:
        """The same, drawn anew in every batch."""
        return SignalWindows(corpus, self.window, (self.window + 1) // 2, drawn=True)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """Network of 4 to 40 thousand parameters on any grid."""
        widths = (len(SIGNALS), self.width, self.width * 3 // 2, 2 * self.width)
        kernels = (self.kernel, self.kernel, 3)
        layers = [
            _Convolved(*sizes) for sizes in zip(widths[:-1], widths[1:], kernels, strict=True)
        ]
        return _SignalNet(layers, nn.Linear(3 * widths[-1], classes))

    def prepare(self, net: nn.Module, samples: SignalWindows) -> list[dict[str, float]]:
        """Take mean and SD of the training frames."""
        net.learn_scale(samples.values)
        return []

    def epoch_limit(self, samples: SignalWindows) -> int:
        """Whole passes that make at least so many updates."""
        return -(-self.updates // max(len(samples) // self.batch, 1))

    def optimiser(self, net: nn.Module, samples: SignalWindows) -> OneCycle:
        """AdamW and one cycle of the rate."""
        adam = torch.optim.AdamW(net.parameters(), self.rate, weight_decay=WEIGHT_DECAY)
        return OneCycle(
            adam, self.rate, self.epoch_limit(samples) * max(len(samples) // self.batch, 1)
        )


class _SignalNet(nn.Module):
    """From signals [windows, frames, signals] and frames of each window to logits [windows, classes]."""

    def __init__(self, layers: list[nn.Module], last: nn.Linear) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers)
        self.dropout = nn.Dropout(DROPOUT)
        self.last = last
        self.register_buffer("mean", torch.zeros(len(SIGNALS)))
        self.register_buffer("scale", torch.ones(len(SIGNALS)))

    def learn_scale(self, values: torch.Tensor) -> None:
        """Take mean and SD of the signals of training frames [frames, signals]; one that never varies is always 0.

        Raises:
            ValueError: a signal is not finite.
        """
        if not torch.isfinite(values).all():
            raise ValueError("some readings of the training captures are not finite")
        spread, mean = torch.std_mean(values.double(), dim=0, correction=0)
        self.mean.copy_(mean)
        self.scale.copy_(torch.where(spread > 1e-6, spread, torch.inf))

    def forward(self, batch: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
        values, seen = batch
        x = ((values - self.mean) / self.scale).clamp(-CLIP_SDS, CLIP_SDS).transpose(1, 2)
        for number, layer in enumerate(self.layers):
            x = layer(x * _frame_mask(x, seen))
            if number < 2 and x.shape[2] > 1:
                x, seen = nn.functional.max_pool1d(x, 2), (seen // 2).clamp(min=1)
        inside = _frame_mask(x, seen)
        count = seen[:, None]
        mean = (x * inside).sum(2) / count
        spread = (((x - mean[:, :, None]) * inside).square().sum(2) / count + 1e-6).sqrt()
        most = (x * inside).amax(2)  # rectified, so that 0 is never above it
        return self.last(self.dropout(torch.cat([mean, most, spread], 1)))


def _frame_mask(x: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """1 within a window and 0 behind its end, [windows, 1, frames]."""
    return (torch.arange(x.shape[2], device=x.device) < seen[:, None])[:, None].to(x.dtype)


class _Convolved(nn.Sequential):
    """Convolution over time, batch norm and ReLU, as many frames as before."""

    def __init__(self, inputs: int, outputs: int, kernel: int) -> None:
        super().__init__(
            nn.Conv1d(inputs, outputs, kernel, padding=kernel // 2, bias=False),
            nn.BatchNorm1d(outputs),
            nn.ReLU(),
        )


class OneCycle(Optimiser):
    """An optimiser whose rate rises to its highest and falls to nothing in so many steps, as the loop wants it."""

    def __init__(self, optimiser: torch.optim.Optimizer, rate: float, steps: int) -> None:
        super().__init__(optimiser)
        self.rate = rate
        self.cycle = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps)

    def step(self) -> None:
        """Move the parameters, then the rate."""
        super().step()
        if self.cycle.last_epoch < self.cycle.total_steps - 1:
            self.cycle.step()
