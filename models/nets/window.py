"""A network that decides once per window of a capture."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial
from inspect import signature

import numpy as np
import pandas as pd
import torch
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import check_is_fitted
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.memory import ensure
from models.nets.checkpoint import Checkpoint, checkpoint
from models.nets.last_layer import relearnt
from models.nets.training import Samples, Windows, activations, moved, probabilities
from models.person import codes_of

LONGEST_S = 3600.0  # of a window
PRECISIONS = ("float32", "bfloat16")


class WindowNet(ClassifierMixin, BaseEstimator):
    """Cuts captures into samples, decides on each, and labels a capture by the mean of its probabilities.

    A system gives ``network(rows, cols, classes)`` and ``learn(net, samples, target)``, and has ``epochs``,
    ``batch``, ``seed`` and ``device`` among its parameters. One whose sample is not
    a window that follows the last one has its own ``samples``, and ``training_samples`` if it trains on others.

    Attributes:
        classes_: class names.
        net_: the trained network.
        history_: per epoch what the training loop reports.
        fit_seconds_: of the clock and of the processor, those before a kill included; only where training went on.
        activations_: numbers in memory while it decides on one window, or takes one step of a sequence (`activations`).
    """

    linear_last = True  # its last linear layer gives the logits, so that it can learn a person
    holds_out = False  # whether one training subject chooses the epoch
    frames: int | None = None  # parameters that some have
    hop: int | None = None
    seconds = 0.0
    rate = 1.0
    precision = "float32"

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        raise NotImplementedError

    def forward(self, net: nn.Module, x: object) -> torch.Tensor:
        """What ``net(x)`` gives, up to rounding; a system may have a faster way."""
        return net(x)

    def halved(self, net: nn.Module, x: torch.Tensor) -> torch.Tensor:
        """What ``net(x)`` gives, float32, with products in bfloat16; what is learnt and the loss keep their 32 bits."""
        with torch.autocast(x.device.type, torch.bfloat16):
            return net(x).float()

    def learn(
        self,
        net: nn.Module,
        samples: Samples,
        target: np.ndarray,
        judge: Callable[[], float] | None = None,
        kept: Checkpoint | None = None,
    ) -> list[dict[str, float]]:
        """Train the network in place and return its history; ``judge`` and ``kept`` are those of `train`."""
        raise NotImplementedError

    def length(self, rate_hz: float) -> int:
        """Frames of a window at some rate: ``seconds`` of it, or ``frames`` at any."""
        return max(1, round(self.seconds * rate_hz)) if self.seconds else self.frames

    @property
    def window(self) -> int:
        """Frames of a window, ``seconds`` at the rate of the training captures."""
        return vars(self).get("window_", self.frames)

    def samples(self, corpus: Corpus) -> Samples:
        """What captures are cut into: windows that do not overlap."""
        return Windows(corpus, self.window, self.window)

    def training_samples(self, corpus: Corpus) -> Samples:
        """What training captures are cut into."""
        return self.samples(corpus)

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run.

        Raises:
            InputError: a count below 1, a time, rate or precision that cannot be, or a device that is not there.
        """
        counts = {"frames": self.frames, "hop": self.hop, "epochs": self.epochs, "batch": self.batch}
        for name, value in counts.items():
            if value is not None and value < 1:
                raise InputError(f"model.{name}={value}: give at least 1")
        if self.precision not in PRECISIONS:
            raise InputError(f"model.precision={self.precision}: give {' or '.join(PRECISIONS)}")
        if not 0 <= self.seconds <= LONGEST_S:
            raise InputError(
                f"model.seconds={self.seconds:g}: give a number above 0 up to {LONGEST_S:g}, or 0 for what frames says"
            )
        if (
            self.seconds
            and self.frames is not None
            and self.frames != signature(type(self)).parameters["frames"].default
        ):
            raise InputError(f"model.frames={self.frames} and model.seconds={self.seconds:g}: give one of them")
        if not 0 < self.rate < float("inf"):
            raise InputError(f"model.rate={self.rate:g}: give a number above 0")
        try:
            torch.zeros(1, device=self.device).item()
        except (RuntimeError, AssertionError) as e:
            raise InputError(f"model.device={self.device}: {str(e).splitlines()[0]}; give cpu") from e

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse a training part before anything is run.

        Raises:
            InputError: a system that lets one training subject choose the epoch has only one; a batch of windows does
                not fit into memory.
        """
        if self.frames is not None:
            said = f"model.seconds={self.seconds:g}" if self.seconds else f"model.frames={self.frames}"
            values = self.batch * float(self.length(X.rate_hz)) * int(np.prod(X.grid))
            ensure(f"{said} model.batch={self.batch}", 4 * values)
        if self.holds_out and len(set(X.subjects.astype(str))) < 2:
            raise InputError(f"{type(self).__name__} lets one training subject choose the epoch; train on two or more")

    def _held_out(self, X: Corpus) -> np.ndarray:
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
        held = self._held_out(X)
        self.window_ = self.length(X.rate_hz)
        kept = checkpoint(self, X, y)
        samples = self.training_samples(X[~held])
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            net = self.network(*X.grid, len(self.classes_)).to(self.device)
            with torch.no_grad():  # gives lazy layers their size before an optimiser asks for parameters
                net.eval()
                net(moved(samples.one(), torch.device(self.device)))
            self.net_ = net
            judge = partial(self._accuracy, X[held], codes[held]) if held.any() else None
            self.history_ = self.learn(net, samples, codes[~held][samples.capture], judge, kept)
        vars(self).pop("fit_seconds_", None)
        if kept.resumed:
            self.fit_seconds_ = kept.seconds()
        self.activations_ = activations(net, moved(samples.one(), torch.device(self.device)))[0]
        return self

    @available_if(lambda self: self.linear_last)
    def adapt(self, X: Corpus, y: np.ndarray | None) -> WindowNet:
        """The same for one person, whose captures the last layer learns (`nets.last_layer`); itself without labels.

        Args:
            X: some captures of the person.
            y: their class names; None where they are not known.
        """
        check_is_fitted(self, "net_")
        if y is None:
            return self
        found = copy(self)
        found.net_ = relearnt(
            self.net_, self.samples(X), codes_of(np.asarray(y), self.classes_), self.batch, self.forward
        )
        return found

    def _accuracy(self, X: Corpus, codes: np.ndarray) -> float:
        return float((self.predict_proba(X).argmax(axis=1) == codes).mean())

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """One decision per sample.

        Returns:
            A table with ``capture`` (position in X), ``start`` and ``frames`` (first frame and frames seen), and
            probabilities [decisions, classes].
        """
        check_is_fitted(self, "net_")
        samples = self.samples(X)
        table = pd.DataFrame({"capture": samples.capture, "start": samples.start, "frames": samples.seen})
        proba = probabilities(self.net_, samples, self.batch, partial(self.forward, self.net_))
        return table, votes(proba, samples.steps)

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Mean probability over the samples of each capture [captures, classes]."""
        table, proba = self.decide(X)
        capture = table["capture"].to_numpy()
        return np.add.reduceat(proba, np.flatnonzero(np.diff(capture, prepend=-1))) / np.bincount(capture)[:, None]

    def predict(self, X: Corpus) -> np.ndarray:
        """Class name of each capture."""
        return self.classes_[self.predict_proba(X).argmax(axis=1)]

    @property
    def parameters_(self) -> int:
        """Learnt numbers in the network."""
        check_is_fitted(self, "net_")
        return sum(p.numel() for p in self.net_.parameters())


def votes(proba: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Probabilities of samples [samples, classes] from those of their steps, as shares of a majority vote.

    A sample of one step keeps its probabilities. A tie goes to the class with the higher mean probability: this is
    added with a weight that is too small to change a majority.
    """
    first = np.cumsum(steps) - steps
    ballots = np.eye(proba.shape[1])[proba.argmax(axis=1)]
    share = np.add.reduceat(ballots, first) / steps[:, None]
    mean = np.add.reduceat(proba.astype(np.float64), first) / steps[:, None]
    weight = np.where(steps > 1, 1 / (2 * steps), 1.0)[:, None]  # shares differ by at least 1 / steps
    return ((1 - weight) * share + weight * mean).astype(np.float32)
