"""Gaussian hidden Markov models of ragged sequences, one per class, fitted in the same passes.

Frames of all sequences lie in one array [frames, values], sequence after sequence. A recursion over
time visits them in another order, that of `VisitOrder`: first the first frame of every sequence,
longest sequence first, then all second frames, and so on. The sequences that still run at one time
are then the first ones, and nothing is padded.

In arrays of states the states come first, so that the arithmetic of one time step runs along the
sequences.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from sklearn.cluster import KMeans

PROBABILITY_FLOOR = 1e-6
VARIANCE_FLOOR = 1e-3
KMEANS_FRAMES = 20_000
MIN_OCCUPATION = 1e-3  # frames; a state with less keeps its mean and variance


class VisitOrder:
    """The order in which recursions over time visit the frames of ragged sequences.

    Attributes:
        sequence: int64 [sequences], sequences from the longest to the shortest.
        spans: begin and end of each time step in the order.
        frame: int64 [frames], frame at each position of the order.
        position: int64 [frames], position of each frame in the order.
    """

    def __init__(self, lengths: np.ndarray) -> None:
        self.sequence = np.argsort(-lengths, kind="stable")
        first = (np.cumsum(lengths) - lengths)[self.sequence]
        ended = np.searchsorted(np.sort(lengths), np.arange(lengths.max()), side="right")
        running = len(lengths) - ended
        edges = np.concatenate([[0], np.cumsum(running)])
        self.spans = list(pairwise(edges.tolist()))
        time = np.repeat(np.arange(len(running)), running)
        self.frame = first[np.arange(edges[-1]) - edges[time]] + time
        self.position = np.empty_like(self.frame)
        self.position[self.frame] = np.arange(edges[-1])


def forward(
    emission: np.ndarray, start: np.ndarray, transition: np.ndarray, order: VisitOrder
) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities of the states given the past, scaled in every frame.

    Args:
        emission: density of each frame in each state, up to a factor per frame [states, frames], in
            the visit order.
        start: probability of the first state [states, sequences], in order of ``order.sequence``.
        transition: transition matrices, old state by new state [states, states, sequences], in the
            same order.
        order: visit order.

    Returns:
        Probability of each state given the frames up to its own [states, frames], and the density
        of each frame given those before it [frames], both in the visit order.
    """
    state = np.empty_like(emission)
    scale = np.empty(emission.shape[1])
    expected, before = start, 0
    for begin, end in order.spans:
        if begin:
            running = end - begin
            now = state[:, None, before : before + running]
            expected = (now * transition[:, :, :running]).sum(axis=0)
        joint = expected * emission[:, begin:end]
        scale[begin:end] = joint.sum(axis=0)
        np.divide(joint, scale[begin:end], out=state[:, begin:end])
        before = begin
    return state, scale


def backward(
    emission: np.ndarray, scale: np.ndarray, transition: np.ndarray, order: VisitOrder
) -> np.ndarray:
    """Density of all later frames given the state, relative to that given the past.

    Args:
        emission: emissions, as in `forward`.
        scale: scale that `forward` returns.
        transition: transition matrices, as in `forward`.
        order: visit order.

    Returns:
        Relative densities [states, frames], in the visit order.
    """
    future = np.ones_like(emission)
    for (begin, _), (later, end) in zip(order.spans[-2::-1], order.spans[:0:-1], strict=True):
        running = end - later
        ahead = emission[:, later:end] * future[:, later:end] / scale[later:end]
        future[:, begin : begin + running] = (transition[:, :, :running] * ahead).sum(axis=1)
    return future


class GaussianHMMs:
    """One hidden Markov model per class: any state may follow any other, diagonal covariances.

    Fitted by expectation maximisation from k-means of the frames of each class, uniform
    probabilities of the first state and, at first, states that last for 10 frames on average.
    Values should be standardised; variances are at least 1e-3 and probabilities at least about
    1e-6, so no sequence is impossible.

    Args:
        states: number of states.
        iterations: EM iterations.
        seed: random seed of k-means.

    Attributes:
        start_: probability of the first state [classes, states].
        transition_: transition matrices, old state by new state [classes, states, states].
        mean_: [classes, states, values].
        variance_: [classes, states, values].
    """

    def __init__(self, states: int = 5, iterations: int = 20, seed: int = 0) -> None:
        self.states = states
        self.iterations = iterations
        self.seed = seed

    def fit(self, frames: np.ndarray, lengths: np.ndarray, classes: np.ndarray) -> GaussianHMMs:
        """Fit every class's model to its sequences.

        Args:
            frames: float64 [frames, values].
            lengths: int64 [sequences], at least 1 each.
            classes: int64 [sequences], numbered from 0 without gaps.
        """
        by_class = np.argsort(classes, kind="stable")
        first = (np.cumsum(lengths) - lengths)[by_class]
        lengths, classes = lengths[by_class], classes[by_class]
        begin = np.cumsum(lengths) - lengths
        values = frames[np.repeat(first - begin, lengths) + np.arange(len(frames))]
        edges = np.searchsorted(np.repeat(classes, lengths), np.arange(classes.max() + 2))
        parts = [slice(a, b) for a, b in pairwise(edges.tolist())]
        self._initialise_models([values[part] for part in parts])
        both = np.concatenate([values, values**2], axis=1)
        del values

        order = VisitOrder(lengths)
        owner = classes[order.sequence]
        for _ in range(self.iterations):
            emission = np.empty((self.states, len(both)))
            for i, part in enumerate(parts):
                emission[:, part] = self._log_densities(both[part], i)
            _scale_by_largest(emission)
            emission = emission[:, order.frame]
            transition = self.transition_[owner].transpose(1, 2, 0).copy()
            state, scale = forward(emission, self.start_[owner].T.copy(), transition, order)

            future = backward(emission, scale, transition, order)
            emission *= future
            emission /= scale  # the evidence for each state from its frame on
            ahead = emission[:, order.position]
            ahead[:, begin] = 0  # no transition leads to a first frame
            share = state * future
            state, share = state[:, order.position], share[:, order.position]
            for i, part in enumerate(parts):
                before = state[:, part.start : part.stop - 1]
                after = ahead[:, part.start + 1 : part.stop]
                moves = self.transition_[i] * (before @ after.T)
                first = share[:, begin[classes == i]]
                self._update_model(i, share[:, part], first, moves, both[part])
        return self

    def log_likelihood(self, frames: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Log-likelihood of every sequence under every class's model [sequences, classes].

        It needs memory for classes x states x frames numbers, so give blocks of sequences.
        """
        classes = len(self.start_)
        both = np.concatenate([frames, frames**2], axis=1)
        emission = np.concatenate([self._log_densities(both, i) for i in range(classes)], axis=1)
        best = _scale_by_largest(emission)
        order = VisitOrder(np.tile(lengths, classes))
        owner = order.sequence // len(lengths)
        transition = self.transition_[owner].transpose(1, 2, 0).copy()
        _, scale = forward(emission[:, order.frame], self.start_[owner].T.copy(), transition, order)
        begin = np.cumsum(lengths) - lengths
        per_frame = (best + np.log(scale)[order.position]).reshape(classes, -1)
        return np.add.reduceat(per_frame, begin, axis=1).T

    def _initialise_models(self, parts: list[np.ndarray]) -> None:
        classes, values = len(parts), parts[0].shape[1]
        self.start_ = np.full((classes, self.states), 1 / self.states)
        stay = 0.9 if self.states > 1 else 1.0
        leave = (1 - stay) / max(self.states - 1, 1)
        self.transition_ = np.tile(np.eye(self.states) * (stay - leave) + leave, (classes, 1, 1))
        self.mean_ = np.empty((classes, self.states, values))
        self.variance_ = np.empty((classes, self.states, values))
        for i, frames in enumerate(parts):
            some = frames[:: -(-len(frames) // KMEANS_FRAMES)]
            # Values of states without a cluster, if there are few frames.
            self.mean_[i] = some.mean(axis=0)
            self.variance_[i] = some.var(axis=0)
            clusters = min(self.states, len(np.unique(some, axis=0)))
            label = KMeans(clusters, n_init=1, random_state=self.seed).fit(some).labels_
            for k in range(clusters):
                self.mean_[i, k] = some[label == k].mean(axis=0)
                self.variance_[i, k] = some[label == k].var(axis=0)
        np.maximum(self.variance_, VARIANCE_FLOOR, out=self.variance_)

    def _log_densities(self, both: np.ndarray, i: int) -> np.ndarray:
        """Log-densities in the states of one model [states, frames].

        Args:
            both: values and their squares, side by side [frames, 2 values].
            i: class of the model.
        """
        precision = 1 / self.variance_[i]
        weights = np.concatenate([precision * self.mean_[i], -0.5 * precision], axis=1)
        constant = np.log(2 * np.pi * self.variance_[i]) + precision * self.mean_[i] ** 2
        density = weights @ both.T
        density -= 0.5 * constant.sum(axis=1)[:, None]
        return density

    def _update_model(
        self, i: int, share: np.ndarray, first: np.ndarray, moves: np.ndarray, both: np.ndarray
    ) -> None:
        occupation = share.sum(axis=1)
        occurs = occupation > MIN_OCCUPATION
        mean, square = np.split(share[occurs] @ both / occupation[occurs, None], 2, axis=1)
        self.mean_[i, occurs] = mean
        self.variance_[i, occurs] = np.maximum(square - mean**2, VARIANCE_FLOOR)
        self.start_[i] = _shares_above_floor(first.sum(axis=1))
        moves_on = moves.sum(axis=1) > MIN_OCCUPATION
        self.transition_[i, moves_on] = _shares_above_floor(moves[moves_on])


def _scale_by_largest(logs: np.ndarray) -> np.ndarray:
    """Replace logs [states, frames] by exponentials relative to the largest; return its log."""
    best = logs.max(axis=0)
    logs -= best
    np.exp(logs, out=logs)
    return best


def _shares_above_floor(counts: np.ndarray) -> np.ndarray:
    """Shares of counts along the last axis, all above 0."""
    shares = np.maximum(counts / counts.sum(axis=-1, keepdims=True), PROBABILITY_FLOOR)
    return shares / shares.sum(axis=-1, keepdims=True)
