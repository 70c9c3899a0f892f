"""CNN85 (Albawi et al. 2018): 85 frames as the channels of a small image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import check_value
from bench.models.nets.taxel_major import run_taxel_major
from bench.models.nets.training import Optimiser, Samples, Step, Steps, Windows
from bench.models.nets.window import FrameNet

RATES = {
    "paper": (1.0, 0.5, 0.1, 0.05, 0.001),
    "toolbox": (1.0, 0.5, 0.1, 0.05, 0.01, 0.005, 0.001, 0.0005),
}
PADDINGS = ("zero", "edge")
SEARCH_EVERY = 10  # epochs
SEARCH_BATCHES = 30


class CNN85(FrameNet):
    """Three convolutions over 85 frames, 630 ms of CoST, as channels (Albawi et al. 2018, Table 1).

    Input [batch, frames, rows, cols] scaled to 0..1; output one logit per class. The paper's
    pooling "pad 2" is read as stride 2 with ceiling, the only reading that gives its 256 x 2 x 2
    (docs/notes/systems.md, cnn85). It is trained by SGD with momentum, whose learning rate is
    searched every ten epochs on the training windows (`SelectiveSGD`).

    Args:
        hop: frames from one training window to the next, None for windows that do not overlap;
            windows of predictions never overlap.
        padding: padding of the last window of a capture: ``zero``, as published, or ``edge``, which
            repeats its last frame.
        rates: candidate learning rates: those that the ``paper`` lists, or those of its
            ``toolbox``.
        width: share of the published number of filters and units.
        frames, epochs, batch, seed, device, seconds, precision: see `WindowNet`.
    """

    stacks = True

    frames: int = 85
    hop: int | None = None
    padding: str = "zero"
    rates: str = "paper"
    width: float = 1.0
    epochs: int = 50
    batch: int = 250

    def check(self) -> None:
        """Check the parameters."""
        super().check()
        advice = "a share of the published width, above 0 and up to 16"
        check_value("model.width", self.width, 0 < self.width <= 16, advice)
        check_value("model.padding", self.padding, self.padding in PADDINGS, "zero or edge")
        check_value("model.rates", self.rates, self.rates in RATES, "paper or toolbox")

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the training captures."""
        frames = self.length(X.rate_hz)
        check_value("model.hop", self.hop, (self.hop or 1) <= frames, f"at most a window, {frames}")
        super().check_training(X, y)

    def samples(self, corpus: Corpus) -> Windows:
        """Windows that do not overlap."""
        return Windows(corpus, self.window, self.window, self.padding)

    def training_samples(self, corpus: Corpus) -> Windows:
        """Training windows, which may overlap."""
        return Windows(corpus, self.window, self.hop or self.window, self.padding)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """909 070 parameters for 8 x 8 taxels, 85 frames and 14 classes."""
        a, b, c, d = (max(round(n * self.width), 1) for n in (64, 128, 256, 512))
        return nn.Sequential(
            nn.Conv2d(self.window, a, 3, padding=1),
            nn.ReLU(),
            nn.MaxPool2d(2, ceil_mode=True),
            nn.Conv2d(a, b, 2, padding=1),
            nn.ReLU(),
            nn.MaxPool2d(2, ceil_mode=True),
            nn.Conv2d(b, c, 3, padding=1),
            nn.ReLU(),
            nn.MaxPool2d(2, ceil_mode=True),
            nn.Flatten(),
            nn.LazyLinear(d),
            nn.ReLU(),
            nn.Linear(d, classes),
        )

    def forward(self, net: nn.Module, x: torch.Tensor) -> torch.Tensor:
        """Output of ``net(x)``; taxel-major in training, with channels last in bfloat16."""
        if self.precision == "bfloat16":
            return net(x.contiguous(memory_format=torch.channels_last))
        return run_taxel_major(net, x) if net.training else net(x)

    def prepare(self, net: nn.Module, samples: Samples) -> list[dict[str, float]] | None:
        """Draw weights from He's normal and set biases to 0.

        The paper does not state the initial weights. From the normal of SD 0.01 of the toolbox's
        examples, and from PyTorch's default, this network stayed at chance on HAART; from He's
        normal it learned.
        """
        for p in net.parameters():
            if p.ndim > 1:
                nn.init.kaiming_normal_(p)
            else:
                nn.init.zeros_(p)

    def optimiser(self, net: nn.Module, samples: Samples) -> SelectiveSGD:
        """SGD of the paper's toolbox, which searches the learning rate."""
        return SelectiveSGD(net, RATES[self.rates])


class SelectiveSGD(Optimiser):
    """SGD with bias-corrected momentum 0.9 and a searched rate, as in the toolbox LightNet.

    m <- 0.9 m - 0.1 gradient - 1e-4 weight (no decay of biases); weight <- weight + rate m / (1 -
    0.9^t).
    """

    def __init__(self, net: nn.Module, rates: tuple[float, ...]) -> None:
        self.parameters = list(net.parameters())
        self.momentum = [torch.zeros_like(p) for p in self.parameters]
        self.steps = 0
        self.rate = rates[0]
        self.rates = rates

    def zero_grad(self) -> None:
        """Forget the gradients."""
        for p in self.parameters:
            p.grad = None

    @torch.no_grad()
    def step(self) -> None:
        """Move the parameters along the momentum."""
        self.steps += 1
        torch._foreach_mul_(self.momentum, 0.9)
        torch._foreach_add_(self.momentum, [p.grad for p in self.parameters], alpha=-0.1)
        decayed = [i for i, p in enumerate(self.parameters) if p.ndim > 1]
        torch._foreach_add_(
            [self.momentum[i] for i in decayed], [self.parameters[i] for i in decayed], alpha=-1e-4
        )
        torch._foreach_add_(self.parameters, self.momentum, alpha=self.rate / (1 - 0.9**self.steps))

    @torch.no_grad()
    def _restore(
        self, weights: list[torch.Tensor], momentum: list[torch.Tensor], steps: int
    ) -> None:
        torch._foreach_copy_(self.parameters, weights)
        torch._foreach_copy_(self.momentum, momentum)
        self.steps = steps

    def before_epoch(self, epoch: int, steps: Sequence[Step]) -> Steps:
        """Every ten epochs, keep the rate with the lowest loss after up to 30 steps.

        Each rate starts from the current weights; its weights are discarded. Rates above the first
        one kept are not tried again.
        """
        if epoch % SEARCH_EVERY:
            return
        weights = [p.detach().clone() for p in self.parameters]
        momentum = [m.clone() for m in self.momentum]
        count = self.steps
        losses = []
        for rate in self.rates:
            self.rate = rate
            for step in steps[:SEARCH_BATCHES]:
                loss = yield step
            losses.append(loss)  # once it is not finite, it stays so
            self._restore(weights, momentum, count)
        values = torch.stack(losses).nan_to_num(torch.inf).tolist()
        self.rate = self.rates[int(np.argmin(values))]
        if epoch == 0:
            self.rates = tuple(r for r in self.rates if r <= self.rate)
