"""A network that decides once per window of a capture."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
import pandas as pd
import torch
from sklearn.utils.validation import check_is_fitted
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.ground.machine import check_memory
from bench.ground.registry import parameter_defaults
from bench.models.most_probable import MostProbable
from bench.models.nets.training import (
    Optimiser,
    Samples,
    Schedule,
    Windows,
    count_activations,
    predict_samples,
    to_device,
    train_network,
)

MAX_WINDOW_S = 3600.0  # of a window
PRECISIONS = ("float32", "bfloat16")

network_parameters = partial(dataclass, kw_only=True, eq=False, repr=False)


@network_parameters
class WindowNet(MostProbable):
    """Cuts captures into samples, decides on each, and labels a capture by the mean of its probabilities.

    A system is a subclass. Its annotated attributes are its parameters, as in a dataclass: keyword arguments of its
    constructor, with the values that stand there as defaults. ``network(rows, cols, classes)`` makes its network.
    Where it differs from Adam on windows that follow one another, it has its own ``samples``, ``training_samples``,
    ``prepare``, ``optimiser``, ``passes`` or ``forward``.

    Args:
        seed: random seed of the weights, the shuffles and other draws, and of the held-out subject if there is one.
        device: PyTorch device.
        batch: samples per step; every system has it.
        epochs: most passes over the training samples. With a held-out subject, the epoch that is best for that subject
            is kept. This and the following are parameters of those systems that list them.
        rate: learning rate.
        frames: length of a window.
        seconds: length of a window in seconds at the corpus's rate; 0 uses ``frames``.
        precision: ``float32``, or ``bfloat16``: matrix products in half the bits, up to twice as fast on processors
            that support it; weights, norms and the loss keep 32 bits.

    Attributes:
        classes_: class names.
        net_: the trained network.
        history_: reports of the training loop, per epoch.
        activations_: numbers in memory while it decides on one window, or takes one step of a sequence (`activations`).
    """

    seed: int = 0
    device: str = "cpu"

    # What systems have that do not list them among their parameters.
    epochs: ClassVar[int | None] = None
    rate: ClassVar[float] = 1.0
    frames: ClassVar[int | None] = None
    hop: ClassVar[int | None] = None
    seconds: ClassVar[float] = 0.0
    precision: ClassVar[str] = "float32"

    patience: ClassVar[int | None] = None  # as of `Schedule`
    smoothing: ClassVar[float] = 0.0
    holds_out: ClassVar[bool] = False  # whether one training subject chooses the epoch

    def __init_subclass__(cls, **more: object) -> None:
        super().__init_subclass__(**more)
        network_parameters(cls)
        _, *params = inspect.signature(cls.__init__).parameters.values()
        # What a class declares itself names its runs, so it stands before what it inherits.
        base = inspect.signature(cls.__mro__[1]).parameters
        order = [*vars(cls).get("__annotations__", {}), *base, *(p.name for p in params)]
        params.sort(key=lambda p: order.index(p.name))
        cls.__signature__ = inspect.Signature(params)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        raise NotImplementedError

    def forward(self, net: nn.Module, x: object) -> torch.Tensor:
        """The output of ``net(x)``, up to rounding; a system may have a faster way."""
        return net(x)

    def prepare(self, net: nn.Module, samples: Samples) -> list[dict[str, float]]:
        """Prepare training, such as initial weights; return values to report. Nothing by default."""
        return []

    def optimiser(self, net: nn.Module, samples: Samples) -> Optimiser:
        """Optimiser of the network: Adam."""
        return Optimiser(torch.optim.Adam(net.parameters(), self.rate))

    def epoch_limit(self, samples: Samples) -> int:
        """Most epochs on these samples."""
        return self.epochs

    def compute_logits(self, net: nn.Module, x: object) -> torch.Tensor:
        """Logits of a batch, float32, by products of the wanted precision."""
        if self.precision == "float32":
            return self.forward(net, x)
        with torch.autocast(torch.device(self.device).type, torch.bfloat16):
            return self.forward(net, x).float()

    def length(self, rate_hz: float) -> int:
        """Frames of a window at some rate: ``seconds`` of it, or ``frames`` at any."""
        return max(1, round(self.seconds * rate_hz)) if self.seconds else self.frames

    @property
    def window(self) -> int:
        """Frames of a window, ``seconds`` at the rate of the training captures."""
        return vars(self).get("window_", self.frames)

    def samples(self, corpus: Corpus) -> Samples:
        """Samples of captures: windows that do not overlap."""
        return Windows(corpus, self.window, self.window)

    def training_samples(self, corpus: Corpus) -> Samples:
        """Samples of training captures."""
        return self.samples(corpus)

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run.

        Raises:
            InputError: a count below 1, a time, rate or precision that cannot be, or a device that is not there.
        """
        counts = {
            "frames": self.frames,
            "hop": self.hop,
            "epochs": self.epochs,
            "batch": self.batch,
        }
        for name, value in counts.items():
            if value is not None and value < 1:
                raise InputError(f"model.{name}={value}: give at least 1")
        if self.precision not in PRECISIONS:
            raise InputError(f"model.precision={self.precision}: give {' or '.join(PRECISIONS)}")
        if not 0 <= self.seconds <= MAX_WINDOW_S:
            raise InputError(
                f"model.seconds={self.seconds:g}: give a number above 0 up to {MAX_WINDOW_S:g}, or 0 for what frames says"
            )
        if (
            self.seconds
            and self.frames is not None
            and self.frames != parameter_defaults(type(self))["frames"]
        ):
            raise InputError(
                f"model.frames={self.frames} and model.seconds={self.seconds:g}: give one of them"
            )
        if not 0 < self.rate < float("inf"):
            raise InputError(f"model.rate={self.rate:g}: give a number above 0")
        try:
            torch.zeros(1, device=self.device).item()
        except (RuntimeError, AssertionError) as e:
            raise InputError(
                f"model.device={self.device}: {str(e).splitlines()[0]}; give cpu"
            ) from e

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse a training part before anything is run.

        Raises:
            InputError: a system that lets one training subject choose the epoch has only one; a batch of windows does
                not fit into memory.
        """
        if self.frames is not None:
            length = (
                f"model.seconds={self.seconds:g}" if self.seconds else f"model.frames={self.frames}"
            )
            values = self.batch * float(self.length(X.rate_hz)) * int(np.prod(X.grid))
            check_memory(f"{length} model.batch={self.batch}", 4 * values)
        if self.holds_out and len(set(X.subjects.astype(str))) < 2:
            raise InputError(
                f"{type(self).__name__} lets one training subject choose the epoch; train on two or more"
            )

    def _is_held_out(self, X: Corpus) -> np.ndarray:
        """Captures of the training subject that chooses the epoch, bool [captures]."""
        if not self.holds_out:
            return np.zeros(len(X), dtype=bool)
        names = np.unique(X.subjects.astype(str))
        return X.subjects == names[np.random.default_rng(self.seed).integers(len(names))]

    def fit(self, X: Corpus, y: np.ndarray) -> WindowNet:
        """Train on captures and their class names.

        Raises:
            InputError: as of `check_training`.
        """
        self.check()
        self.classes_, codes = np.unique(y, return_inverse=True)
        self.check_training(X, y)
        held = self._is_held_out(X)
        self.window_ = self.length(X.rate_hz)
        samples = self.training_samples(X[~held])
        one = to_device(samples.make_example(), torch.device(self.device))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            self.net_ = net = self.network(*X.grid, len(self.classes_)).to(self.device)
            with (
                torch.no_grad()
            ):  # gives lazy layers their size before an optimiser asks for parameters
                net.eval()
                net(one)
            judge = partial(self._accuracy, X[held], codes[held]) if held.any() else None
            target = codes[~held][samples.capture]
            before = self.prepare(net, samples)
            schedule = Schedule(
                self.epoch_limit(samples), self.batch, self.seed, self.patience, self.smoothing
            )
            optimiser, forward = self.optimiser(net, samples), partial(self.compute_logits, net)
            self.history_ = before + train_network(
                net, samples, target, optimiser, schedule, forward, judge
            )
        self.activations_ = count_activations(net, one)
        return self

    def _accuracy(self, X: Corpus, codes: np.ndarray) -> float:
        return float((self.predict_proba(X).argmax(axis=1) == codes).mean())

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Predict each sample: frames seen, and probabilities.

        Returns:
            A table with ``capture`` (position in X), ``start`` and ``frames`` (first frame and frames seen), and
            probabilities [decisions, classes].
        """
        check_is_fitted(self, "net_")
        samples = self.samples(X)
        table = pd.DataFrame(
            {"capture": samples.capture, "start": samples.start, "frames": samples.seen}
        )
        proba = predict_samples(
            self.net_, samples, self.batch, partial(self.compute_logits, self.net_)
        )
        return table, vote_shares(proba, samples.steps)

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Mean probability over the samples of each capture [captures, classes]."""
        table, proba = self.decide(X)
        capture = table["capture"].to_numpy()
        return (
            np.add.reduceat(proba, np.flatnonzero(np.diff(capture, prepend=-1)))
            / np.bincount(capture)[:, None]
        )

    @property
    def parameters_(self) -> int:
        """Learnt numbers in the network."""
        check_is_fitted(self, "net_")
        return sum(p.numel() for p in self.net_.parameters())


class FrameNet(WindowNet):
    """A network on windows of so many ``frames``, or of seconds, whose products may have half the bits."""

    seconds: float = 0.0
    precision: str = "float32"


def vote_shares(proba: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Probabilities of samples [samples, classes] from those of their steps, as shares of a majority vote.

    A sample of one step keeps its probabilities. A tie goes to the class with the higher mean probability: this is
    added with a weight that is too small to change a majority.
    """
    first = np.cumsum(steps) - steps
    ballots = np.eye(proba.shape[1])[proba.argmax(axis=1)]
    share = np.add.reduceat(ballots, first) / steps[:, None]
    mean = np.add.reduceat(proba.astype(np.float64), first) / steps[:, None]
    weight = np.where(steps > 1, 1 / (2 * steps), 1.0)[
        :, None
    ]  # shares differ by at least 1 / steps
    return ((1 - weight) * share + weight * mean).astype(np.float32)
