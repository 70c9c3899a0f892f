"""A network that decides once per window of a capture."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
import pandas as pd
import torch
from sklearn.utils.validation import check_is_fitted
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import InputError, check_value
from bench.ground.machine import check_memory
from bench.ground.registry import parameter_defaults
from bench.models.by_source import SourceScales, learn_scales, read_readings
from bench.models.most_probable import MostProbable, mean_by_capture
from bench.models.nets.training import (
    Optimiser,
    Samples,
    Schedule,
    Step,
    Training,
    Windows,
    count_activations,
    predict_samples,
    to_device,
    train_alone,
    train_together,
)

MAX_WINDOW_S = 3600.0
PRECISIONS = ("float32", "bfloat16")

network_parameters = partial(dataclass, kw_only=True, eq=False, repr=False)


@network_parameters
class WindowNet(MostProbable):
    """A network that predicts samples of a capture, whose mean probabilities are the capture's.

    A system is a subclass. Its annotated attributes are its parameters, as in a dataclass: keyword
    arguments of its constructor with their defaults. ``network(rows, cols, classes)`` returns its
    untrained network. A system that is not trained by Adam on consecutive windows overrides
    ``samples``, ``training_samples``, ``prepare``, ``optimiser``, ``epoch_limit`` or ``forward``.

    Args:
        seed: random seed of the weights, the shuffles and other draws, and of the held-out subject
            if there is one.
        device: PyTorch device.
        batch: samples per step; every system has it.
        epochs: most passes over the training samples. With a held-out subject, the epoch that is
            best for that subject is kept. This and the following ones are parameters of the systems
            that list them.
        rate: learning rate.
        frames: length of a window.
        seconds: length of a window in seconds at the corpus's rate; 0 uses ``frames``.
        precision: ``float32``, or ``bfloat16``: matrix products in half the bits, up to twice as
            fast on processors that support it; weights, norms and the loss keep 32 bits.

    Attributes:
        classes_: class names.
        net_: the trained network.
        history_: reports of the training loop, per epoch.
        activations_: numbers in memory during one decision, or one step of a sequence
            (`count_activations`).
    """

    seed: int = 0
    device: str = "cpu"

    # Values of systems that do not list these among their parameters.
    epochs: ClassVar[int | None] = None
    rate: ClassVar[float] = 1.0
    frames: ClassVar[int | None] = None
    hop: ClassVar[int | None] = None
    seconds: ClassVar[float] = 0.0
    precision: ClassVar[str] = "float32"

    patience: ClassVar[int | None] = None  # as of `Schedule`
    smoothing: ClassVar[float] = 0.0
    holds_out: ClassVar[bool] = False  # whether one training subject chooses the epoch
    stacks: ClassVar[bool] = False  # whether all layers can compute several networks in one pass

    def __init_subclass__(cls, **more: object) -> None:
        super().__init_subclass__(**more)
        network_parameters(cls)
        _, *params = inspect.signature(cls.__init__).parameters.values()
        # Own parameters name the runs, so they stand before the inherited ones.
        base = inspect.signature(cls.__mro__[1]).parameters
        order = [*vars(cls).get("__annotations__", {}), *base, *(p.name for p in params)]
        params.sort(key=lambda p: order.index(p.name))
        cls.__signature__ = inspect.Signature(params)

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        raise NotImplementedError

    def forward(self, net: nn.Module, x: object) -> torch.Tensor:
        """Output of ``net(x)``, up to rounding; a system may compute it faster on a processor."""
        return net(x)

    @property
    def on_card(self) -> bool:
        """True for a card: it runs the library's layers on windows gathered there."""
        return torch.device(self.device).type != "cpu"

    def prepare(self, net: nn.Module, samples: Samples) -> list[dict[str, float]] | None:
        """Prepare training, such as initial weights; may return values to report."""

    def optimiser(self, net: nn.Module, samples: Samples) -> Optimiser:
        """Optimiser of the network: Adam."""
        return Optimiser(torch.optim.Adam(net.parameters(), self.rate))

    def epoch_limit(self, samples: Samples) -> int:
        """Largest number of epochs on these samples."""
        return self.epochs

    def compute_logits(self, net: Callable, x: object) -> torch.Tensor:
        """Logits of a batch, float32, computed in the system's precision."""
        if self.precision == "float32":
            return net(x) if self.on_card else self.forward(net, x)
        with torch.autocast(torch.device(self.device).type, torch.bfloat16):
            return (net(x) if self.on_card else self.forward(net, x)).float()

    def length(self, rate_hz: float) -> int:
        """Frames of a window at a rate: those of ``seconds``, else ``frames``."""
        return max(1, round(self.seconds * rate_hz)) if self.seconds else self.frames

    @property
    def window(self) -> int:
        """Frames of a window, ``seconds`` at the rate of the training captures."""
        return vars(self).get("window_", self.frames)

    def samples(self, corpus: Corpus) -> Samples:
        """Samples of captures: windows that do not overlap."""
        return Windows(corpus, self.window, self.window)

    def learn_scales(self, X: Corpus) -> SourceScales:
        """Scales of the readings of training captures by source."""
        return learn_scales(X, read_readings)

    def at_one_scale(self, X: Corpus) -> Corpus:
        """Captures with the readings of each source at its scale."""
        return self.scales_.apply_to_frames(X)

    def training_samples(self, corpus: Corpus) -> Samples:
        """Samples of training captures."""
        return self.samples(corpus)

    def check(self) -> None:
        """Check the parameters.

        Raises:
            InputError: a parameter is out of its range, or the device is missing.
        """
        for name in ("frames", "hop", "epochs", "batch"):
            count = getattr(self, name)
            check_value(f"model.{name}", count, count is None or count >= 1, "at least 1")
        is_known = self.precision in PRECISIONS
        check_value("model.precision", self.precision, is_known, " or ".join(PRECISIONS))
        advice = f"a number above 0 up to {MAX_WINDOW_S:g}, or 0 to use frames"
        check_value("model.seconds", self.seconds, 0 <= self.seconds <= MAX_WINDOW_S, advice)
        if self.seconds and self.frames is not None:
            is_default = self.frames == parameter_defaults(type(self))["frames"]
            check_value("model.frames", self.frames, is_default, "either frames or seconds")
        check_value("model.rate", self.rate, 0 < self.rate < float("inf"), "a number above 0")
        try:
            torch.zeros(1, device=self.device).item()
        except (RuntimeError, AssertionError) as e:
            reason = str(e).splitlines()[0]
            raise InputError(f"model.device={self.device}: {reason}; give cpu") from e

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the training captures.

        Raises:
            InputError: one training subject shall choose the epoch and there is no other; a batch
                of windows does not fit into memory.
        """
        if self.frames is not None:
            length = f"seconds={self.seconds:g}" if self.seconds else f"frames={self.frames}"
            values = self.batch * float(self.length(X.rate_hz)) * int(np.prod(X.grid))
            check_memory(f"model.{length} model.batch={self.batch}", 4 * values)
        if self.holds_out and len(set(X.subjects[~X.is_added])) < 2:
            name = type(self).__name__
            raise InputError(
                f"{name}: one training subject chooses the epoch; train on two or more"
            )

    def _is_held_out(self, X: Corpus) -> np.ndarray:
        """True for captures of the training subject that chooses the epoch, bool [captures]."""
        if not self.holds_out:
            return np.zeros(len(X), dtype=bool)
        names = np.unique(X.subjects[~X.is_added].astype(str))
        return X.subjects == names[np.random.default_rng(self.seed).integers(len(names))]

    def fit(self, X: Corpus, y: np.ndarray) -> WindowNet:
        """Train on captures and their class names.

        Raises:
            InputError: as of `check_training`.
        """
        train_alone(self.train_in_steps(X, y), self.seed)
        return self

    @property
    def trains_together(self) -> bool:
        """True if several of it train in one pass, which only a card does in less time."""
        return self.stacks and self.on_card and type(self).fit is WindowNet.fit

    @staticmethod
    def fit_together(
        systems: Sequence[WindowNet], parts: Sequence[Corpus]
    ) -> list[Exception | None]:
        """Train each system on captures of its own, all at once; return why each failed, or None.

        Their parameters are equal, except the seed.
        """
        pairs = zip(systems, parts, strict=True)
        trainings = [system.train_in_steps(X, X.gestures) for system, X in pairs]
        return train_together(trainings, [system.seed for system in systems])

    def train_in_steps(self, X: Corpus, y: np.ndarray) -> Generator[Step, torch.Tensor, None]:
        """Train on captures and their class names; others take the steps (`Training.iterate`)."""
        self.check()
        self.classes_, codes = np.unique(y, return_inverse=True)
        self.check_training(X, y)
        held_out = self._is_held_out(X)
        self.window_ = self.length(X.rate_hz)
        self.scales_ = self.learn_scales(X[~held_out])
        X = self.at_one_scale(X)
        samples = self.training_samples(X[~held_out])
        example = samples.make_example()
        self.net_ = net = self.network(*X.grid, len(self.classes_))
        with torch.no_grad():  # lazy layers get their size before an optimiser asks for it
            net.eval()
            net(example)
        net.to(self.device)
        samples = self._place(samples)
        judge = None
        if held_out.any():
            judged = self._place(self.samples(X[held_out]))
            judge = partial(self._measure_accuracy, judged, codes[held_out])
        target = codes[~held_out][samples.capture]
        reports = self.prepare(net, samples) or []
        epochs = self.epoch_limit(samples)
        schedule = Schedule(epochs, self.batch, self.seed, self.patience, self.smoothing)
        optimiser = self.optimiser(net, samples)
        training = Training(net, samples, target, optimiser, schedule, self.compute_logits, judge)
        history = yield from training.iterate()
        self.history_ = reports + history
        self.activations_ = count_activations(net, to_device(example, torch.device(self.device)))

    def _place(self, samples: Samples) -> Samples:
        """Samples on the system's device."""
        return samples.place(torch.device(self.device)) if self.on_card else samples

    def _measure_accuracy(self, samples: Samples, codes: np.ndarray) -> float:
        proba = mean_by_capture(self._decide_samples(samples), samples.capture)
        return float((proba.argmax(axis=1) == codes).mean())

    def _decide_samples(self, samples: Samples) -> np.ndarray:
        """Probabilities of each sample [decisions, classes]."""
        proba = predict_samples(self.net_, samples, self.batch, self.compute_logits)
        return vote_shares(proba, samples.steps)

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Predict each sample.

        Returns:
            A table with ``capture`` (position in X), ``start`` and ``frames`` (first frame and
            frames seen), and probabilities [decisions, classes].
        """
        check_is_fitted(self, "net_")
        samples = self._place(self.samples(self.at_one_scale(X)))
        columns = {"capture": samples.capture, "start": samples.start, "frames": samples.seen}
        return pd.DataFrame(columns), self._decide_samples(samples)

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Mean probability over the samples of each capture [captures, classes]."""
        table, proba = self.decide(X)
        return mean_by_capture(proba, table["capture"].to_numpy())

    @property
    def parameters_(self) -> int:
        """Number of weights and biases."""
        check_is_fitted(self, "net_")
        return sum(p.numel() for p in self.net_.parameters())


class FrameNet(WindowNet):
    """A network on windows of a number of frames or seconds, in either precision."""

    seconds: float = 0.0
    precision: str = "float32"


def vote_shares(proba: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Shares of a majority vote over the steps of each sample [samples, classes].

    A sample of one step keeps its probabilities. A tie goes to the class with the higher mean
    probability, which is added with a weight that is too small to change a majority.
    """
    first = np.cumsum(steps) - steps
    votes = np.eye(proba.shape[1])[proba.argmax(axis=1)]
    share = np.add.reduceat(votes, first) / steps[:, None]
    mean = np.add.reduceat(proba.astype(np.float64), first) / steps[:, None]
    # shares differ by at least 1 / steps
    weight = np.where(steps > 1, 1 / (2 * steps), 1.0)[:, None]
    return ((1 - weight) * share + weight * mean).astype(np.float32)
