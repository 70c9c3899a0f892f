"""The three networks of Hughes, Krauthammer and Correll 2017: CNN, CNN-RNN and autoencoder-RNN.

All are trained by RMSProp at 1e-4 on values divided by full scale, from weights of a truncated normal of SD 0.1 and
biases of 0.1, until the training loss stands still. The paper tells neither batch size nor how weights start nor when
the loss has converged; these are our readings (docs/notes/systems.md, hughes2017).
"""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.models.nets.time_blocks import TimeConv3d, convolve_and_pool
from bench.models.nets.training import Forward, Optimiser, Samples, Sequences, Windows, to_device
from bench.models.nets.window import WindowNet
from bench.models.quantised import BITS, round_weights

# By corpus: rate in Hz, frames and hop of a window, then filters and kernel (frames, rows, columns) of both layers.
COST = (135.0, 45, 15, (30, (20, 2, 2)), (10, (5, 2, 2)))
HAART = (54.0, 27, 9, (30, (10, 3, 3)), (20, (5, 2, 2)))
CHUNKS = {COST: 270, HAART: 432}  # frames of a sequence of single frames
UNITS = 50
ENCODER = (200, 100, 50, 25, 10)


class Hughes2017(WindowNet):
    """Base of the three: the design for the corpus, CoST or HAART, whose rate is nearer, and the training.

    Attributes:
        design_: `COST` or `HAART`.
    """

    epochs: int = 500
    batch: int = 10
    rate: float = 1e-4

    patience = 10

    def fit(self, X: Corpus, y: np.ndarray) -> WindowNet:
        """Train on captures and their class names."""
        self.design_ = min(COST, HAART, key=lambda design: abs(np.log(design[0] / X.rate_hz)))
        return super().fit(X, y)

    def samples(self, corpus: Corpus) -> Samples:
        """Windows of captures: 45 frames every 15 with CoST's network, 27 every 9 with HAART's."""
        return Windows(corpus, *self.design_[1:3])

    def prepare(self, net: nn.Module, samples: Samples) -> list[dict[str, float]]:
        """Initialise the weights by `initialise_weights`."""
        initialise_weights(net)
        return []

    def optimiser(self, net: nn.Module, samples: Samples) -> Optimiser:
        """RMSProp."""
        return Optimiser(torch.optim.RMSprop(net.parameters(), self.rate))


class Hughes2017CNN(Hughes2017):
    """Two 3-D convolutions over windows of a third to half a second; a decision per window.

    Windows are 45 frames every 15 with CoST's network, or 27 every 9 with HAART's, whichever corpus's rate is nearer.
    On grids that are too small for a kernel or a pooling, these are cut to what is there.

    Args:
        bits: bits of a learnt weight in prediction: 32, or 8 as `bench export` stores them.
        epochs, batch, rate, seed, device: see `WindowNet`.
    """

    batch: int = 100
    bits: int = 32

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run.

        Raises:
            InputError: as of `WindowNet.check`, or other bits than 32 and 8.
        """
        super().check()
        if self.bits not in BITS:
            raise InputError(f"model.bits={self.bits}: give 32 or 8")

    def fit(self, X: Corpus, y: np.ndarray) -> WindowNet:
        """Train on captures and their class names."""
        super().fit(X, y)
        if self.bits != 32:
            self.bytes_saved_ = 3 * round_network(self.net_, self.bits)
        return self

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
    """The same convolutions on each window, then a plain recurrent layer over up to 36 windows; majority vote.

    A capture with more windows makes several sequences, which is what a decision is of. On HAART the 46 windows of a
    capture are one sequence. The cell is tanh, the paper contrasts it with LSTM; the loss is a mean over windows.

    Args:
        epochs, batch, rate, seed, device: see `WindowNet`; ``batch`` sequences per step.
    """

    def samples(self, corpus: Corpus) -> Sequences:
        """Sequences of windows."""
        return Sequences(super().samples(corpus), 36 if self.design_ == COST else 46)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """16 254 parameters for CoST, 22 207 for HAART."""
        head = nn.Sequential(nn.Linear(UNITS, UNITS), nn.ReLU(), nn.Linear(UNITS, classes))
        return Recurrent(nn.Sequential(*convolution_layers(self.design_, rows, cols)), UNITS, head)

    def forward(self, net: nn.Module, x: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
        """The output of ``net(x)``, with the encoder of each window as `Hughes2017CNN` runs it."""
        return net(x, partial(run_with_pooled_input, net.encoder))


class Hughes2017AERNN(Hughes2017):
    """The code of an autoencoder of single frames, a recurrent layer over them; majority vote over chunks of frames.

    The autoencoder, 64-200-100-50-25-10 and back, learns to reconstruct training frames; then the recurrent layer is
    attached to its code and everything is trained. A chunk, which is what a decision is of, has at most 270 frames
    (2 s) with CoST, and 432, a whole capture, with HAART, whichever corpus's rate is nearer.

    Args:
        pretraining: passes of the autoencoder over the training frames.
        epochs, batch, rate, seed, device: see `WindowNet`; ``batch`` chunks per step.
    """

    pretraining: int = 20

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run.

        Raises:
            InputError: a count below 1.
        """
        super().check()
        if self.pretraining < 1:
            raise InputError(f"model.pretraining={self.pretraining}: give at least 1")

    def samples(self, corpus: Corpus) -> Sequences:
        """Chunks of frames."""
        return Sequences(Windows(corpus, 1, 1), CHUNKS[self.design_])

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """40 949 parameters for CoST, 40 767 for HAART, and the decoder, which is not kept."""
        sizes = [rows * cols, *ENCODER]
        return Recurrent(
            nn.Sequential(nn.Flatten(), *dense_layers(sizes)), 25, nn.Linear(25, classes)
        )

    def prepare(self, net: nn.Module, samples: Sequences) -> list[dict[str, float]]:
        """Train the autoencoder on frames; its losses by pass."""
        initialise_weights(net)
        sizes = [net.encoder[1].in_features, *ENCODER][::-1]
        decoder = nn.Sequential(*dense_layers(sizes)).to(self.device)
        initialise_weights(decoder)
        autoencoder = nn.Sequential(net.encoder, decoder)
        rmsprop = torch.optim.RMSprop(autoencoder.parameters(), self.rate)
        order = np.random.default_rng(self.seed)
        losses = []
        for _ in range(self.pretraining):
            summed = 0.0
            for rows in np.array_split(
                order.permutation(len(samples)), -(-len(samples) // self.batch)
            ):
                frames = to_device(samples.make_batch(rows), torch.device(self.device))[0]
                rmsprop.zero_grad()
                loss = nn.functional.mse_loss(autoencoder(frames), frames.flatten(1))
                loss.backward()
                rmsprop.step()
                summed += loss.item() * len(rows)
            losses.append({"reconstruction": summed / len(samples)})
        return losses


class Recurrent(nn.Module):
    """An encoder of windows, a plain recurrent layer over the windows of a sequence, and a head at each of them.

    Called with the windows of some sequences, one sequence after another, and how many each has; gives logits
    [windows, classes] in the same order.
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
        windows, steps = batch
        inputs = self.input_layer((encode or self.encoder)(windows))
        # Longest sequences first: those that still run at a step are then the first ones.
        order = torch.argsort(steps, descending=True, stable=True)
        first = (steps.cumsum(0) - steps)[order]
        runs = steps[order][None] > torch.arange(int(steps.max()), device=steps.device)[:, None]
        index = (first + torch.arange(len(runs), device=steps.device)[:, None])[runs]
        states = _TanhStates.apply(inputs[index], self.recurrent_layer.weight, runs.sum(1).tolist())
        return self.head(torch.empty_like(states).index_copy(0, index, states))


class _TanhStates(torch.autograd.Function):
    """States of a tanh layer [windows, units] from its inputs, all first windows, then all second ones and so on.

    ``running`` counts the sequences at each step, which are the first ones of the step before.
    """

    @staticmethod
    def forward(
        ctx: object, inputs: torch.Tensor, weight: torch.Tensor, running: list[int]
    ) -> torch.Tensor:
        states = inputs.clone()
        steps = states.split(running)
        steps[0].tanh_()
        for before, now in zip(steps, steps[1:], strict=False):
            now.addmm_(before[: len(now)], weight.T).tanh_()
        ctx.save_for_backward(states, weight)
        ctx.running = running
        return states

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> tuple:
        states, weight = ctx.saved_tensors
        slope = (1 - states.square()).split(ctx.running)
        gradient = gradient.clone()
        steps = gradient.split(ctx.running)
        for t in reversed(range(len(steps))):
            steps[t].mul_(slope[t])
            if t:
                steps[t - 1][: len(steps[t])].addmm_(steps[t], weight)
        for_weight = torch.zeros_like(weight)
        for before, now in zip(states.split(ctx.running), steps[1:], strict=False):
            for_weight.addmm_(now.T, before[: len(now)])
        return gradient, for_weight, None


def run_with_pooled_input(net: nn.Sequential, x: torch.Tensor) -> torch.Tensor:
    """The output of `convolution_layers` and later layers for windows; the first is pooled before its bias is added."""
    conv, pool, relu, *rest = net
    return nn.Sequential(*rest)(convolve_and_pool(conv, x, pool.kernel_size).relu_())


def convolution_layers(design: tuple, rows: int, cols: int) -> list[nn.Module]:
    """Convolution, pooling and ReLU, twice, down to a vector."""
    (filters, kernel), (filters2, kernel2) = design[3:]
    stack: list[nn.Module] = []
    shape = (design[1], rows, cols)
    for number, (outputs, size) in enumerate(((filters, kernel), (filters2, kernel2))):
        size = tuple(min(k, n) for k, n in zip(size, shape, strict=True))
        stack.append(
            TimeConv3d(outputs, size) if number == 0 else nn.Conv3d(filters, outputs, size)
        )
        shape = tuple(n - k + 1 for n, k in zip(shape, size, strict=True))
        pool = tuple(min(2, n) for n in shape)
        stack += [nn.MaxPool3d(pool), nn.ReLU()]
        shape = tuple(n // p for n, p in zip(shape, pool, strict=True))
    return [*stack, nn.Flatten()]


def round_network(net: nn.Module, bits: int) -> int:
    """Round the weights of a network in place, in steps of their own for each filter or unit; how many. Biases stay."""
    weights = [p for p in net.parameters() if p.ndim > 1]
    with torch.no_grad():
        for p in weights:
            p.copy_(torch.from_numpy(round_weights(p.flatten(1).cpu().numpy(), bits)).view_as(p))
    return sum(p.numel() for p in weights)


def dense_layers(sizes: list[int]) -> list[nn.Module]:
    """Linear layers with ReLU between them, none after the last."""
    stack: list[nn.Module] = []
    for inputs, outputs in zip(sizes[:-1], sizes[1:], strict=True):
        stack += [nn.Linear(inputs, outputs), nn.ReLU()]
    return stack[:-1]


def initialise_weights(net: nn.Module) -> None:
    """Weights from a truncated normal of SD 0.1, biases 0.1."""
    for p in net.parameters():
        nn.init.trunc_normal_(p, std=0.1, a=-0.2, b=0.2) if p.ndim > 1 else nn.init.constant_(
            p, 0.1
        )
