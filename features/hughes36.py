"""Likelihoods and gesture-level features of Hughes, Farrow, Profita and Correll 2015.

ICMI, pp. 367-374.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain, pairwise

import numpy as np
import pandas as pd
from scipy.fft import rfft
from scipy.special import expit
from sklearn.utils.validation import check_is_fitted

from bench.corpora.corpus import Corpus, shared_frames
from bench.errors import InputError
from bench.features.base import FeatureSet
from bench.features.hmm import GaussianHMMs
from bench.features.signals import Touch, capture_blocks, feature_table

HIDDEN_UNITS = (200, 100, 50, 25, 10)
FRAMES_TO_ENCODE = 100_000
FRAMES_TO_SCORE = 2**16
BATCH_FRAMES = 512
LEARNING_RATE = 4e-3
MOMENT_ORDERS = [(p, q) for p in range(4) for q in range(4 - p)]
BAND_HZ = (0.625, 5.0)
SHORTEST_FFT = 64
LOG_FLOOR = 1e-4  # of full scale, inside logarithms
MAX_DEVIATION = 1e3  # standard deviations
MIN_LOG_LIKELIHOOD = -100.0  # per frame
GESTURE_LEVEL_NAMES = pd.Index(
    [
        *("g1_log_level", "g2_temporal_sd", "g3_log_temporal_sd", "g4_frequency"),
        *("g5_log_amplitude", "g6_row_of_maximum", "g7_col_of_maximum", "g8_duration"),
    ]
)


class Hughes36(FeatureSet):
    """Log-likelihoods under hidden Markov models of all gestures, and 8 gesture-level features.

    With C gestures there are 2 C + 8 columns: 36 for the 14 of CoST.

    =========== ====================================================================================
    hmm_moments C log-likelihoods per frame; the models see the moments of each frame, sum of p(r,c)
                r^i c^j with i + j <= 3, rows and columns counted from 1, sensor values as shares of
                full scale
    hmm_code    C log-likelihoods per frame; the models see the 10 units in the middle of an
                autoencoder
    g1          log of the mean over time of the summed pressure above each taxel's least value in
                the capture
    g2, g3      SD over time of the mean pressure, sensor value, and its log
    g4, g5      frequency (Hz) with the largest amplitude of the summed pressure between 0.625 and 5
                Hz, and the log of that amplitude; the spectrum is that of the capture, padded to at
                least 64 frames
    g6, g7      mean over time of the row / column of the frame's first maximum, counted from 1
    g8          frames; left out if the captures that it is fitted to are all equally long, as in
                HAART
    =========== ====================================================================================

    The paper leaves open, and we chose: 5 states, any of which may follow any other, diagonal
    covariances, 20 iterations from k-means of the frames; observations standardised on the training
    frames. The autoencoder sees frames less the mean frame, divided by one SD, and learns with Adam
    in batches of 512 from Xavier weights. The spectrum has the corpus's own rate; the authors took
    CoST's 135 frames per second for 152. The amplitude is that of a sine, in sensor values of the
    sum. 1e-4 of full scale is added inside logarithms. If the sum is constant or the band has no
    frequency, g4 and the amplitude are 0. Likelihoods are at least -100 per frame, so one unusual
    capture does not decide the scale of a column.

    Args:
        states: number of states of each model.
        iterations: EM iterations of each model.
        epochs: passes of the autoencoder over at most 100 000 training frames.
        seed: random seed of k-means, of the choice of these frames, of the autoencoder's weights
            and batches.

    Attributes:
        classes_: gestures, as ``y`` names them.
        encoder_: weights and biases of the layers up to the code; the first also standardises.
        models_: the `GaussianHMMs` on moments and on the code.
        standard_: mean and SD over the training frames of moments and code.
    """

    learns = True

    def __init__(
        self, states: int = 5, iterations: int = 20, epochs: int = 20, seed: int = 0
    ) -> None:
        self.states = states
        self.iterations = iterations
        self.epochs = epochs
        self.seed = seed

    def check(self) -> None:
        """Raise an InputError for wrong parameters, before anything is run."""
        for name in ("states", "iterations", "epochs"):
            if getattr(self, name) < 1:
                raise InputError(f"features.{name}={getattr(self, name)}: give at least 1")

    def fit(self, X: Corpus, y: np.ndarray) -> Hughes36:
        """Learn the autoencoder and the models from captures and their class names."""
        self.check()
        self.classes_, codes = np.unique(np.asarray(y), return_inverse=True)
        sample = _sample_frames(X, FRAMES_TO_ENCODE, self.seed)
        self.encoder_ = _train_encoder(sample, self.epochs, self.seed)
        self.models_, self.standard_ = [], []
        for observe in self._observation_functions():
            frames = np.concatenate([observe(X[block]) for block in capture_blocks(X)])
            mean, sd = frames.mean(axis=0), frames.std(axis=0)
            sd[sd <= 1e-9 * np.abs(mean)] = 1  # a constant up to rounding
            self.standard_.append((mean, sd))
            frames = _standardise_frames(frames, mean, sd)
            models = GaussianHMMs(self.states, self.iterations, self.seed)
            self.models_.append(models.fit(frames, X.lengths, codes))
        is_ragged = len(np.unique(X.lengths)) > 1
        self.level_ = GESTURE_LEVEL_NAMES if is_ragged else GESTURE_LEVEL_NAMES[:-1]
        moment_names = [f"hmm_moments_{gesture}" for gesture in self.classes_]
        code_names = [f"hmm_code_{gesture}" for gesture in self.classes_]
        self.names_ = pd.Index([*moment_names, *code_names, *self.level_])
        return self

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Features of each capture [captures, 2 classes + 8 or 7]."""
        check_is_fitted(self, "names_")
        classes = len(self.classes_)
        columns = np.empty((len(X), 2, classes))
        for i, observe in enumerate(self._observation_functions()):
            for block in capture_blocks(X, FRAMES_TO_SCORE * X.grid[0] * X.grid[1]):
                part = X[block]
                frames = _standardise_frames(observe(part), *self.standard_[i])
                likelihood = self.models_[i].log_likelihood(frames, part.lengths)
                per_frame = likelihood / part.lengths[:, None]
                columns[block, i] = np.maximum(per_frame, MIN_LOG_LIKELIHOOD)
        others = self.extracted_table(X)[self.level_]
        names = self.names_[: 2 * classes]
        likelihoods = pd.DataFrame(columns.reshape(-1, len(names)), others.index, names)
        return pd.concat([likelihoods, others], axis=1)

    def extract(self, corpus: Corpus) -> pd.DataFrame:
        """Compute the gesture-level features of every capture, with the duration."""
        return feature_table(corpus, GESTURE_LEVEL_NAMES, _gesture_level_columns)

    @property
    def parameters_(self) -> int:
        """Number of learned numbers: of the encoder, the models, means and SDs of their inputs."""
        arrays = [*chain(*self.encoder_, *self.standard_)]
        for models in self.models_:
            arrays += [models.start_, models.transition_, models.mean_, models.variance_]
        return sum(array.size for array in arrays)

    def _observation_functions(self) -> list[Callable[[Corpus], np.ndarray]]:
        return [frame_moments, lambda corpus: _encode_frames(_scaled_frames(corpus), self.encoder_)]


def frame_moments(corpus: Corpus) -> np.ndarray:
    """Raw geometric moments of every frame [frames, 10], in the order of `MOMENT_ORDERS`."""
    row, col = np.indices(corpus.grid).reshape(2, -1) + 1.0
    return _scaled_frames(corpus) @ np.stack([row**p * col**q for p, q in MOMENT_ORDERS], axis=1)


def _scaled_frames(corpus: Corpus) -> np.ndarray:
    """Frames as shares of full scale, float64 [frames, taxels]."""
    frames = np.concatenate(list(corpus), dtype=np.float64)
    frames /= corpus.full_scale
    return frames.reshape(len(frames), -1)


def _sample_frames(corpus: Corpus, max_count: int, seed: int) -> np.ndarray:
    """Equally spaced frames of all captures, as shares of full scale, float32 [frames, taxels]."""
    total = int(corpus.lengths.sum())
    count = min(total, max_count)
    frame = (np.arange(count) + np.random.default_rng(seed).random()) * total // count
    end = np.cumsum(corpus.lengths)
    capture = np.searchsorted(end, frame, side="right")
    position = frame - (end - corpus.lengths)[capture]
    stored, starts = shared_frames(corpus)
    frames = stored[starts[capture] + position.astype(np.int64)].reshape(count, -1)
    return frames.astype(np.float32) / np.float32(corpus.full_scale)


def _train_encoder(
    frames: np.ndarray, epochs: int, seed: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Train the autoencoder to reconstruct frames; return the layers up to its code."""
    import torch
    from torch import nn

    mean = frames.mean(axis=0, dtype=np.float64)
    # One SD for all taxels: otherwise the noise of untouched ones would count.
    sd = np.sqrt(frames.var(axis=0, dtype=np.float64).mean())
    sd = sd if sd > LOG_FLOOR else 1.0
    frames = torch.from_numpy(((frames - mean) / sd).astype(np.float32))
    sizes = [frames.shape[1], *HIDDEN_UNITS, *HIDDEN_UNITS[-2::-1], frames.shape[1]]
    code = len(HIDDEN_UNITS) - 1
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        linear = [nn.Linear(a, b) for a, b in pairwise(sizes)]
        layers = []
        for i, layer in enumerate(linear):
            is_linear = i in (code, len(linear) - 1)
            gain = 1.0 if is_linear else 4.0  # the slope of a sigmoid is at most 1/4
            nn.init.xavier_uniform_(layer.weight, gain=gain)
            layers += [layer] if is_linear else [layer, nn.Sigmoid()]
        net = nn.Sequential(*layers)
        batch = min(BATCH_FRAMES, len(frames))
        batches = len(frames) // batch
        adam = torch.optim.Adam(net.parameters(), lr=LEARNING_RATE)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            adam, LEARNING_RATE, total_steps=epochs * batches + 1
        )
        for _ in range(epochs):
            order = torch.randperm(len(frames))[: batches * batch]
            for rows in order.view(batches, batch):
                x = frames[rows]
                adam.zero_grad()
                loss = nn.functional.mse_loss(net(x), x)
                loss.backward()
                adam.step()
                schedule.step()
    learnt = [
        (layer.weight.detach().double().numpy(), layer.bias.detach().double().numpy())
        for layer in linear
    ]
    weight, bias = learnt[0]
    learnt[0] = weight / sd, bias - weight @ mean / sd
    return learnt[: code + 1]


def _encode_frames(values: np.ndarray, encoder: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Code of each frame [frames, 10]."""
    *hidden, (weight, bias) = encoder
    for w, b in hidden:
        values = values @ w.T
        values += b
        expit(values, out=values)
    return values @ weight.T + bias


def _standardise_frames(frames: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    frames = frames - mean
    frames /= sd
    return np.clip(frames, -MAX_DEVIATION, MAX_DEVIATION, out=frames)


def _gesture_level_columns(touch: Touch) -> list[np.ndarray]:
    floor = LOG_FLOOR * touch.full_scale
    lowest = np.minimum.reduceat(touch.values, touch.starts, axis=0)
    sum_of_lowest = lowest.sum(axis=1, dtype=np.float64)
    sd = np.sqrt(touch.variance(touch.total)) / touch.taxels
    frequency, amplitude = _dominant_oscillation(touch)
    row, col = np.divmod(touch.values.argmax(axis=1), touch.grid[1])
    return [
        np.log(np.maximum(touch.mean(touch.total) - sum_of_lowest, 0) + floor),
        sd,
        np.log(sd + floor),
        frequency,
        np.log(amplitude + floor),
        touch.mean(row + 1.0),
        touch.mean(col + 1.0),
        touch.lengths,
    ]


def _dominant_oscillation(touch: Touch) -> tuple[np.ndarray, np.ndarray]:
    """Frequency of the largest amplitude of the total in the band, and the amplitude, or zeros."""
    frequency, amplitude = np.zeros((2, len(touch.lengths)))
    centred = touch.total - touch.mean(touch.total)[touch.capture_of_frame]
    varies = touch.value_range(touch.total) > 1e-9 * touch.full_scale
    for i in np.flatnonzero(varies):
        start, length = touch.starts[i], int(touch.lengths[i])
        points = max(length, SHORTEST_FFT)
        bins = np.arange(points // 2 + 1) * touch.rate_hz / points
        inside = np.flatnonzero((bins >= BAND_HZ[0]) & (bins <= BAND_HZ[1]))
        if len(inside):
            size = np.abs(rfft(centred[start : start + length], points)[inside])
            # The first of equal amplitudes: rounding must not choose.
            best = (size >= size.max() * (1 - 1e-9)).argmax()
            frequency[i] = bins[inside[best]]
            amplitude[i] = 2 * size[best] / length
    return frequency, amplitude
