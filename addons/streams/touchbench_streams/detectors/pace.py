"""The pace of touches: whether their frames come faster or slower than in training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.linear_model import Ridge

from bench.corpora.corpus import Corpus, shared_frames
from bench.features.touch import TouchFeatures
from bench.models.search.inner_folds import split_subjects
from touchbench_streams.detectors.names import LONGEST_S, cut_touches
from touchbench_streams.recordings import Recordings

COUNT = 24  # features; half of the weights of 48 for the same power on HAART and CuddleBot
TOUCHES = 240  # most training touches that are learned from
CLIP = 6.0  # SDs of a feature in training
MOST = 1.5  # largest pace of a touch
RIDGE = 30.0
GROUPS = "3"  # of units for paces of training touches


@dataclass(frozen=True)
class Pace:
    """A linear rule on features of `TouchFeatures`.

    Attributes:
        places: positions of the features.
        weights: of each.
        bias: added to their sum.
    """

    places: np.ndarray
    weights: np.ndarray
    bias: float

    def of_features(self, features: np.ndarray) -> np.ndarray:
        """Log2 of frames that are missing of one: 1 if every second is lost, -1 if doubled."""
        return np.clip(features[:, self.places] @ self.weights + self.bias, -MOST, MOST)

    def of_spans(self, recording: Corpus, spans: Sequence[tuple[int, int]]) -> np.ndarray:
        """Pace of spans of one recording after the steps that work frame by frame."""
        return self.of_features(span_features(recording, spans)) if spans else np.zeros(0)


NO_PACE = Pace(np.zeros(1, np.int64), np.zeros(1), 0.0)


def span_features(recording: Corpus, spans: Sequence[tuple[int, int]]) -> np.ndarray:
    """Features of spans of one recording, float64 [spans, features]."""
    begin, end = np.array(spans, dtype=np.int64).T
    starts = shared_frames(recording)[1][0] + begin
    captures = recording[np.zeros(len(begin), np.int64)]
    captures = captures.with_fields(starts=starts, lengths=end - begin, digest="", path=None)
    return TouchFeatures().fit(captures).transform(captures).to_numpy(np.float64)


def learn_pace(
    recordings: Recordings, units: np.ndarray, spans: list[list[tuple[int, int]]]
) -> tuple[Pace, list[np.ndarray]]:
    """Learn from touches with all frames, with every second one, and with frames between them.

    Args:
        recordings: training recordings after the steps that work frame by frame.
        units: name of the unit of each recording; units are left out together.
        spans: of touches found in each recording, that they are named from.

    Returns:
        The rule, and the pace of each span by a rule that was learned without its unit.
    """
    corpus = recordings.corpus
    kept = recordings.events.iloc[:: max(1, -(-len(recordings.events) // TOUCHES))]
    touches = cut_touches(Recordings(corpus, kept), (LONGEST_S,), (0.0,))
    owner = units[kept["recording"].to_numpy(np.int64)]
    copies = [[*touches], [frames[::2] for frames in touches], [_double(f) for f in touches]]
    features = []
    for part in copies:
        captures = Corpus.from_captures(
            part, touches.captures, corpus.rate_hz, full_scale=corpus.full_scale
        )
        features.append(TouchFeatures().fit(captures).transform(captures).to_numpy(np.float64))
    table, owners = np.concatenate(features), np.tile(owner, len(copies))
    target = np.repeat([0.0, 1.0, -1.0], len(owner))
    paces = [np.zeros(0)] * len(spans)
    for _, left_out in split_subjects(units, GROUPS):
        is_other = ~np.isin(owners, units[left_out])
        rule = _fit_rule(table[is_other], target[is_other])
        for i in left_out:
            paces[i] = rule.of_spans(corpus[[i]], spans[i])
    return _fit_rule(table, target), paces


def _double(frames: np.ndarray) -> np.ndarray:
    """Frames with one between each two, at the latest as many as before."""
    doubled = np.repeat(frames.astype(np.float32), 2, axis=0)[: len(frames)]
    doubled[1:-1:2] = (doubled[1:-1:2] + doubled[2::2]) / 2
    return doubled


def _fit_rule(features: np.ndarray, target: np.ndarray) -> Pace:
    mean, sd = features.mean(axis=0), features.std(axis=0) + 1e-9
    units = np.clip((features - mean) / sd, -CLIP, CLIP)
    places = np.argsort(-np.abs(Ridge(alpha=10 * RIDGE).fit(units, target).coef_))[:COUNT]
    model = Ridge(alpha=RIDGE).fit(units[:, places], target)
    weights = model.coef_ / sd[places]
    return Pace(places, weights, float(model.intercept_ - mean[places] @ weights))
