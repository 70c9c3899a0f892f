"""The pace of touches: whether their frames come faster or slower than in training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.linear_model import Ridge

from bench.corpora.corpus import Corpus, shared_frames
from bench.features.touch import TouchFeatures
from bench.models.search.inner_folds import split_subjects
from touchbench_streams.detectors.spans import Span, longest_spans

COUNT = 24  # features; half of the weights of 48 for the same power on HAART and CuddleBot
TOUCHES = 240  # most training touches that are learned from
CLIP = 6.0  # SDs of a feature in training
MOST = 1.5  # largest pace of a touch
RIDGE = 30.0
FEWEST = 30  # touches, with changed ones, to learn from
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

    def of_touches(self, recording: Corpus, touches: list[Span]) -> np.ndarray:
        """Pace of each touch of one recording after the steps that work frame by frame."""
        return self.of_features(span_features(recording, longest_spans(touches)))


NO_PACE = Pace(np.zeros(1, np.int64), np.zeros(1), 0.0)


def span_features(recording: Corpus, spans: Sequence[tuple[int, int]]) -> np.ndarray:
    """Features of spans of one recording, float64 [spans, features]."""
    begin, end = np.array(spans, dtype=np.int64).reshape(-1, 2).T
    captures = recording[np.zeros(len(begin), np.int64)]
    starts = shared_frames(recording)[1][0] + begin
    captures = captures.with_fields(starts=starts, lengths=end - begin, digest="", path=None)
    return TouchFeatures().fit(captures).transform(captures).to_numpy(np.float64)


def learn_pace(
    recordings: Corpus, units: np.ndarray, touches: list[list[Span]]
) -> tuple[Pace, list[np.ndarray]]:
    """Learn from touches with all frames, with every second one, and with one between each two.

    Args:
        recordings: training recordings after the steps that work frame by frame.
        units: name of the unit of each recording; units are left out together.
        touches: found in each recording by a detector that was fitted without it.

    Returns:
        The rule, and the pace of each touch by a rule that was learned without its unit.
    """
    features, copies, owners = [], [], []
    step = max(1, -(-sum(map(len, touches)) // TOUCHES))
    for i, found in enumerate(touches):
        features.append(span_features(recordings[[i]], longest_spans(found)))
        for touch in found[::step]:
            copies += _change_pace(recordings[i], touch)
            owners.append(i)
    rows = np.concatenate(features)
    owner = np.repeat(np.arange(len(touches)), [len(found) for found in touches])
    if len(rows) + len(copies) < FEWEST:
        return NO_PACE, [np.zeros(len(found)) for found in touches]
    captures = Corpus.from_captures(
        copies,
        recordings.captures.iloc[np.repeat(owners, 2)],
        recordings.rate_hz,
        full_scale=recordings.full_scale,
    )
    changed = TouchFeatures().fit(captures).transform(captures).to_numpy(np.float64)
    table = np.concatenate([rows, changed])
    target = np.concatenate([np.zeros(len(rows)), np.tile([1.0, -1.0], len(owners))])
    owner = np.concatenate([owner, np.repeat(owners, 2)])
    weight = np.where(target == 0, len(owners) / len(rows), 1.0)
    paces = [np.zeros(0)] * len(touches)
    for _, left_out in split_subjects(units, GROUPS):
        is_other = ~np.isin(owner, left_out)
        rule = _fit_rule(table[is_other], target[is_other], weight[is_other])
        for i in left_out:
            paces[i] = rule.of_features(features[i])
    return _fit_rule(table, target, weight), paces


def _change_pace(frames: np.ndarray, touch: Span) -> list[np.ndarray]:
    """A touch with every second frame, and with one between each two, named as far as before."""
    ((begin, end),) = longest_spans([touch])
    every_second = frames[begin : max(begin + 4, min(2 * end - begin, touch.end)) : 2]
    doubled = np.repeat(frames[begin : (begin + end + 1) // 2 + 1].astype(np.float32), 2, axis=0)
    doubled[1:-1:2] = (doubled[1:-1:2] + doubled[2::2]) / 2
    return [every_second, doubled[:-1]]


def _fit_rule(features: np.ndarray, target: np.ndarray, weight: np.ndarray) -> Pace:
    if len(features) < FEWEST:
        return NO_PACE
    mean, sd = features.mean(axis=0), features.std(axis=0) + 1e-9
    units = np.clip((features - mean) / sd, -CLIP, CLIP)
    places = np.argsort(-np.abs(Ridge(alpha=10 * RIDGE).fit(units, target, weight).coef_))[:COUNT]
    model = Ridge(alpha=RIDGE).fit(units[:, places], target, weight)
    weights = model.coef_ / sd[places]
    return Pace(places, weights, float(model.intercept_ - mean[places] @ weights))
