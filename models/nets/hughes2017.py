"""The three networks of Hughes, Krauthammer and Correll 2017: CNN, CNN-RNN and autoencoder-RNN.

All are trained by RMSProp at 1e-4 on values divided by full scale, until the training loss has
converged. Weights start from a truncated normal of SD 0.1, biases at 0.1. The paper states neither
the batch size nor the initial weights nor when the loss has converged; these are our readings
(docs/notes/systems.md, hughes2017).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import check_value
from bench.models.nets.time_blocks import TimeConv3d, convolve_and_pool
from bench.models.nets.training import (
    Forward,
    Optimiser,
    Samples,
    Sequences,
    Steps,
    Windows,
    upload,
)
from bench.models.nets.window import WindowNet
from bench.models.quantised import BITS, round_weights

UNITS = 50
ENCODER = (200, 100, 50, 25, 10)


class Design(NamedTuple):
    """The paper's numbers for one corpus."""

    rate_hz: float
    frames: int  # of a window
    hop: int  # frames
    convolutions: tuple  # filters and kernel (frames, rows, columns) of each of the two layers
    sequence: int  # most windows of a sequence of the CNN-RNN
    chunk: int  # most frames of a sequence of the autoencoder-RNN


COST = Design(135.0, 45, 15, ((30, (20, 2, 2)), (10, (5, 2, 2))), sequence=36, chunk=270)
HAART = Design(54.0, 27, 9, ((30, (10, 3, 3)), (20, (5, 2, 2))), sequence=46, chunk=432)


class Hughes2017(WindowNet):
    """Base of the three networks: the training, and the design for the corpus with the nearer rate.

    Attributes:
        design_: `COST` or `HAART`.
    """

    epochs: int = 500
    batch: int = 10
    rate: float = 1e-4

    patience = 10

    def train_in_steps(self, X: Corpus, y: np.ndarray) -> Steps:
        """Train on captures and their class names."""
        self.design_ = min(COST, HAART, key=lambda design: abs(np.log(design.rate_hz / X.rate_hz)))
        yield from super().train_in_steps(X, y)

    def samples(self, corpus: Corpus) -> Samples:
        """Windows of captures: 45 frames every 15 with CoST's network, 27 every 9 with HAART's."""
        return Windows(corpus, self.design_.frames, self.design_.hop)

    def prepare(self, net: nn.Module, samples: Samples) -> list[dict[str, float]] | None:
        """Initialise the weights."""
        initialise_weights(net)

    def optimiser(self, net: nn.Module, samples: Samples) -> Optimiser:
        """RMSProp."""
        return Optimiser(torch.optim.RMSprop(net.parameters(), self.rate))


class Hughes2017CNN(Hughes2017):
    """Two 3-D convolutions over windows of a third to half a second; a decision per window.

    Windows are 45 frames every 15 with CoST's network, or 27 every 9 with HAART's, whichever
    corpus's rate is nearer. Kernels and poolings that are larger than the grid are cut to its size.

    Args:
        bits: bits of a learnt weight in prediction: 32, or 8 as `bench export` stores them.
        epochs, batch, rate, seed, device: see `WindowNet`.
    """

    stacks = True

    batch: int = 100
    bits: int = 32

    def check(self) -> None:
        """Check the parameters.

        Raises:
            InputError: as of `WindowNet.check`, or other bits than 32 and 8.
        """
        super().check()
        check_value("model.bits", self.bits, self.bits in BITS, "32 or 8")

    def train_in_steps(self, X: Corpus, y: np.ndarray) -> Steps:
        """Train on captures and their class names."""
        yield from super().train_in_steps(X, y)
        if self.bits != 32:
            self.bytes_saved_ = 3 * round_network(self.net_, self.bits)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """11 204 parameters for CoST, 17 157 for HAART."""
        return nn.Sequential(
            *convolution_layers(self.design_, rows, cols),
            nn.LazyLinear(UNITS),
            nn.ReLU(),
            nn.Linear(UNITS, classes),
        )

    def forward(self, net: nn.Module, x: torch.Tensor) -> torch.Tensor:
        """The output of ``net(x)``, the first layer pooled before its bias is added."""
        return run_with_pooled_input(net, x)


class Hughes2017CNNRNN(Hughes2017):
    """The same convolutions on each window, a plain recurrent layer over windows, majority vote.

    A sequence has at most 36 windows with CoST's network and 46 with HAART's, which is a whole
    capture; each sequence gets one decision. The cell is tanh, as the paper contrasts it with LSTM;
    the loss is a mean over windows.

    Args:
        epochs, batch, rate, seed, device: see `WindowNet`; ``batch`` sequences per step.
    """

    def samples(self, corpus: Corpus) -> Sequences:
        """Sequences of windows."""
        return Sequences(super().samples(corpus), self.design_.sequence)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """16 254 parameters for CoST, 22 207 for HAART."""
        head = nn.Sequential(nn.Linear(UNITS, UNITS), nn.ReLU(), nn.Linear(UNITS, classes))
        return Recurrent(nn.Sequential(*convolution_layers(self.design_, rows, cols)), UNITS, head)

    def forward(self, net: nn.Module, x: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
        """Output of ``net(x)``, whose encoder runs as that of `Hughes2017CNN`."""
        return net(x, partial(run_with_pooled_input, net.encoder))


class Hughes2017AERNN(Hughes2017):
    """The code of an autoencoder of single frames, a recurrent layer over frames, majority vote.

    The autoencoder, 64-200-100-50-25-10 and back, learns to reconstruct training frames; then the
    recurrent layer is attached to its code and everything is trained. Each chunk of frames gets one
    decision. It has at most 270 frames (2 s) with CoST's network, and 432, a whole capture, with
    HAART's, whichever corpus's rate is nearer.

    Args:
        pretraining: passes of the autoencoder over the training frames.
        epochs, batch, rate, seed, device: see `WindowNet`; ``batch`` chunks per step.
    """

    pretraining: int = 20

    def check(self) -> None:
        """Check the parameters.

        Raises:
            InputError: as of `WindowNet.check`, or no pass of pretraining.
        """
        super().check()
        check_value("model.pretraining", self.pretraining, self.pretraining >= 1, "at least 1")

    def samples(self, corpus: Corpus) -> Sequences:
        """Chunks of frames."""
        return Sequences(Windows(corpus, 1, 1), self.design_.chunk)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """40 949 parameters for CoST, 40 767 for HAART, without the decoder."""
        encoder = nn.Sequential(nn.Flatten(), *dense_layers([rows * cols, *ENCODER]))
        return Recurrent(encoder, 25, nn.Linear(25, classes))

    def prepare(self, net: nn.Module, samples: Sequences) -> list[dict[str, float]]:
        """Train the autoencoder on frames; return its loss of each pass."""
        initialise_weights(net)
        sizes = [net.encoder[1].in_features, *ENCODER][::-1]
        decoder = nn.Sequential(*dense_layers(sizes)).to(self.device)
        initialise_weights(decoder)
        autoencoder = nn.Sequential(net.encoder, decoder)
        rmsprop = torch.optim.RMSprop(autoencoder.parameters(), self.rate)
        generator = np.random.default_rng(self.seed)
        batches = -(-len(samples) // self.batch)
        losses = []
        for _ in range(self.pretraining):
            summed = 0.0
            for rows in np.array_split(generator.permutation(len(samples)), batches):
                frames = samples.make_batch(rows)[0]
                rmsprop.zero_grad()
                loss = nn.functional.mse_loss(autoencoder(frames), frames.flatten(1))
                loss.backward()
                rmsprop.step()
                summed += loss.item() * len(rows)
            losses.append({"reconstruction": summed / len(samples)})
        return losses


class Recurrent(nn.Module):
    """An encoder of windows, a plain recurrent layer over a sequence of windows, a head at each.

    It is called with the windows of some sequences, one sequence after another, and the number of
    windows of each, and returns logits [windows, classes] in the same order.
    """

    def __init__(self, encoder: nn.Module, units: int, head: nn.Module) -> None:
        super().__init__()
        self.encoder = encoder
        self.units = units
        self.input_layer = nn.LazyLinear(units)
        self.recurrent_layer = nn.Linear(units, units, bias=False)
        self.head = head

    def forward(
        self, batch: tuple[torch.Tensor, torch.Tensor], encode: Forward | None = None
    ) -> torch.Tensor:
        """Logits at each window; ``encode`` is a faster way to compute ``encoder(x)``."""
        windows, lengths = batch[0], batch[1].cpu()
        inputs = self.input_layer((encode or self.encoder)(windows))
        # With the longest sequences first, those that have a window at a step are the first ones.
        order = torch.argsort(lengths, descending=True, stable=True)
        first = (lengths.cumsum(0) - lengths)[order]
        step = torch.arange(int(lengths.max()))[:, None]
        running = lengths[order][None] > step
        index = (first + step)[running]
        counts = running.sum(1).tolist()
        index = upload(index, inputs.device)
        states = _TanhStates.apply(inputs[index], self.recurrent_layer.weight, counts)
        return self.head(torch.empty_like(states).index_copy(0, index, states))


class _TanhStates(torch.autograd.Function):
    """States of a tanh layer [windows, units] from its inputs.

    Inputs are the first windows of all sequences, then the second ones and so on. ``counts`` has
    the number of sequences at each step; they are the first ones of the step before.
    """

    @staticmethod
    def forward(
        ctx: object, inputs: torch.Tensor, weight: torch.Tensor, counts: list[int]
    ) -> torch.Tensor:
        states = inputs.clone()
        steps = states.split(counts)
        steps[0].tanh_()
        for before, now in zip(steps, steps[1:], strict=False):
            now.addmm_(before[: len(now)], weight.T).tanh_()
        ctx.save_for_backward(states, weight)
        ctx.counts = counts
        return states

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> tuple:
        states, weight = ctx.saved_tensors
        slopes = (1 - states.square()).split(ctx.counts)
        gradient = gradient.clone()
        steps = gradient.split(ctx.counts)
        for t in reversed(range(len(steps))):
            steps[t].mul_(slopes[t])
            if t:
                steps[t - 1][: len(steps[t])].addmm_(steps[t], weight)
        for_weight = torch.zeros_like(weight)
        for before, now in zip(states.split(ctx.counts), steps[1:], strict=False):
            for_weight.addmm_(now.T, before[: len(now)])
        return gradient, for_weight, None


def run_with_pooled_input(net: nn.Sequential, x: torch.Tensor) -> torch.Tensor:
    """Output of ``net(x)``, with the first convolution pooled before its bias is added."""
    conv, pool, relu, *rest = net
    return nn.Sequential(*rest)(convolve_and_pool(conv, x, pool.kernel_size).relu_())


def convolution_layers(design: Design, rows: int, cols: int) -> list[nn.Module]:
    """Convolution, pooling and ReLU, twice, down to a vector."""
    layers: list[nn.Module] = []
    shape, channels = (design.frames, rows, cols), 1
    for filters, kernel in design.convolutions:
        size = tuple(min(k, n) for k, n in zip(kernel, shape, strict=True))
        layers.append(nn.Conv3d(channels, filters, size) if layers else TimeConv3d(filters, size))
        shape = tuple(n - k + 1 for n, k in zip(shape, size, strict=True))
        pool = tuple(min(2, n) for n in shape)
        layers += [nn.MaxPool3d(pool), nn.ReLU()]
        shape, channels = tuple(n // p for n, p in zip(shape, pool, strict=True)), filters
    return [*layers, nn.Flatten()]


def round_network(net: nn.Module, bits: int) -> int:
    """Round the weights of a network in place, each filter or unit in its own steps; biases stay.

    Returns:
        Number of rounded weights.
    """
    weights = [p for p in net.parameters() if p.ndim > 1]
    with torch.no_grad():
        for p in weights:
            rounded = round_weights(p.flatten(1).cpu().numpy(), bits)
            p.copy_(torch.from_numpy(rounded).view_as(p))
    return sum(p.numel() for p in weights)


def dense_layers(sizes: list[int]) -> list[nn.Module]:
    """Linear layers with ReLU between them, none after the last."""
    layers: list[nn.Module] = []
    for inputs, outputs in zip(sizes[:-1], sizes[1:], strict=True):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return layers[:-1]


def initialise_weights(net: nn.Module) -> None:
    """Draw weights from a truncated normal of SD 0.1; set biases to 0.1."""
    for p in net.parameters():
        if p.ndim > 1:
            nn.init.trunc_normal_(p, std=0.1, a=-0.2, b=0.2)
        else:
            nn.init.constant_(p, 0.1)
