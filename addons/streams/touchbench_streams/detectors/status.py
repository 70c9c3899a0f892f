"""The status of a watched sensor: numbers of its stream, compared with their range in training.

Background is judged by blocks of ticks without touch, and by the least of longer blocks, whatever
the detector takes for touch; touches by blocks of touches. The C computes the same (``status.c`` of
`touchbench_chip`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bench.corpora.corpus import NEGATIVE_SHARE, Corpus
from bench.running.unlike import combine_statistics, mean_gaps
from touchbench_streams.recent import find_saturated

QUIET_TICKS = 64  # of a block of background; eight seconds
CALM_TICKS = 240  # of a block whose calmest ticks count; longer than most touches
TOUCHES = 8  # of a block
FEWEST_BLOCKS = 10  # to learn a range from
SLIGHT = 1e-5  # of full scale, added before logarithms; movement of a sensor at rest
LEAST_MARGIN = 0.5  # of a range in training, by which it is widened
BLOCK = 1000  # ticks at once, which bounds memory

NOT_A_NUMBER, OUT_OF_RANGE, SATURATED, NOISE, STUCK, RATE, OFFSET, GAIN, UNLIKE = (
    1 << k for k in range(9)
)
REASONS = (  # in the order of bits; the C has the same
    "not a number",
    "out of range",
    "saturated",
    "noise",
    "stuck",
    "rate",
    "offset",
    "gain",
    "unlike",
)


class Number(NamedTuple):
    """A number of a block.

    Attributes:
        below: reason if it is below its range in training; 0 for none.
        above: reason if it is above.
        grain: least width of the range, which a constant number has, too.
    """

    below: int
    above: int
    grain: float


LOG = 0.1  # grain of logarithms
QUIET = (  # means over ticks
    Number(OFFSET, OFFSET, LOG),  # log of the mean reading
    Number(GAIN, NOISE, LOG),  # log of the mean change of a reading
    Number(GAIN, NOISE, LOG),  # log of the change of the mean reading
    Number(RATE, RATE, 0.04),  # share of frames where the mean reading turns
    Number(0, RATE, 0.1),  # share of frames, not all 0, that repeat the one before
)
CALM = (Number(0, OFFSET, LOG), Number(0, NOISE, LOG), Number(0, NOISE, LOG))  # least of these
TOUCHED = (  # means over touches
    *(
        Number(0, 0, LOG) for _ in range(2)
    ),  # `bench.running.unlike`: mean, largest (people differ),
    Number(0, OFFSET, LOG),  # least mean,
    *(Number(UNLIKE, UNLIKE, LOG) for _ in range(4)),  # neighbours, and zeros
    Number(0, SATURATED, LOG),  # log of the count of readings that equal the largest, a frame
    Number(0, RATE, 0.1),  # share of frames that repeat the one before
    Number(0, RATE, 0.1),  # pace (`touchbench_streams.detectors.pace`), half from blocks before;
    # some people are slower, and turns tell a doubled rate
    Number(0, STUCK, 1.0),  # taxels that never changed in the block
)
NUMBERS = QUIET + CALM + TOUCHED
FIRST_CALM, FIRST_TOUCHED = len(QUIET), len(QUIET) + len(CALM)  # places
REPEATS, TOUCH_REPEATS = 4, FIRST_TOUCHED + 8
PACE = 9  # in `TOUCHED`


@dataclass(frozen=True)
class Limits:
    """Range of each of `NUMBERS` in training, float64 [numbers]."""

    low: np.ndarray
    high: np.ndarray

    def in_c(self) -> tuple[dict[str, float | str], dict[str, np.ndarray]]:
        """Constants and tables of the C."""
        constants: dict[str, float | str] = {
            "QUIETS": len(QUIET),
            "CALMS": len(CALM),
            "TOUCHEDS": len(TOUCHED),
            "QUIET_TICKS": QUIET_TICKS,
            "CALM_TICKS": CALM_TICKS,
            "TOUCHES": TOUCHES,
            "SLIGHT": SLIGHT,
        }
        arrays = {"low": self.low.astype(np.float32), "high": self.high.astype(np.float32)}
        arrays["below"] = np.array([number.below for number in NUMBERS], np.int16)
        arrays["above"] = np.array([number.above for number in NUMBERS], np.int16)
        return constants, {f"status_{name}": values for name, values in arrays.items()}


NO_LIMITS = Limits(np.full(len(NUMBERS), -1e30), np.full(len(NUMBERS), 1e30))


def check_frame(frame: np.ndarray, full_scale: float) -> tuple[np.ndarray, int]:
    """A frame with small negative readings as 0, and its status by itself.

    Frames with `NOT_A_NUMBER` or `OUT_OF_RANGE` are refused.
    """
    if np.isnan(frame).any():
        return frame, NOT_A_NUMBER
    if frame.max() > full_scale or frame.min() < -NEGATIVE_SHARE * full_scale:
        return frame, OUT_OF_RANGE
    frame = np.maximum(frame, 0)
    return frame, SATURATED * bool(find_saturated(frame[None], full_scale)[0])


class Health:
    """Numbers of one stream, in fixed memory, and the reasons not to trust the sensor.

    Args:
        limits: learned range of the numbers.
        full_scale: largest reading.
    """

    def __init__(self, limits: Limits, full_scale: float) -> None:
        self.limits, self.full_scale = limits, full_scale
        self.before: np.ndarray | None = None  # the last frame
        self.step, self.moved = 0.0, np.zeros(0, bool)
        self.tick = np.zeros(len(QUIET))  # sums over its frames, in the order of `QUIET`
        self.tick_frames, self.is_lasting = 0, False
        self.quiet, self.quiet_ticks = np.zeros(len(QUIET)), 0
        self.calm, self.calm_ticks = np.full(len(CALM), np.inf), 0
        self.touched, self.touches = np.zeros(len(TOUCHED)), 0
        self.slow_pace: float | None = None  # of the blocks so far
        self.quiet_status = self.calm_status = self.touch_status = 0
        self._forget_touch()

    def _forget_touch(self) -> None:
        self.touch_frames, self.largest, self.at_largest, self.least = 0, 0.0, 0, np.inf
        self.sums = np.zeros(5)  # of a touch: mean, neighbours, zeros, repeats

    @property
    def status(self) -> int:
        """Reasons of the last blocks, an OR of their bits."""
        return self.quiet_status | self.calm_status | self.touch_status

    def lose_frames(self) -> None:
        """Forget the last frame, as the next one does not follow it."""
        self.before, self.step = None, 0.0

    def drop_tick(self) -> None:
        """Begin a tick and forget the touch that lasts."""
        self.tick, self.tick_frames, self.is_lasting = np.zeros(len(QUIET)), 0, False

    def take(self, frames: np.ndarray) -> None:
        """Take the next frames [frames, rows, cols] of a tick; one without a previous is kept."""
        if self.before is None and len(frames):
            self.before, frames = frames[0].astype(np.float64) / self.full_scale, frames[1:]
        if len(frames):
            for _ in self.take_ticks(frames, len(frames)):
                pass

    def take_ticks(self, frames: np.ndarray, count: int) -> Iterator[None]:
        """Take whole ticks of ``count`` frames, after a previous frame; yield after each one."""
        now = frames.astype(np.float64) / self.full_scale
        change = np.diff(now, axis=0, prepend=self.before[None])
        self.before = now[-1]
        has_moved = change != 0
        if not len(self.moved):
            self.moved = np.zeros(now[0].shape, bool)
        steps = np.append(self.step, change.mean(axis=(1, 2)))
        self.step = float(steps[-1])
        turns = steps[1:] * steps[:-1] < 0
        is_repeat = ~has_moved.any(axis=(1, 2)) & (now > 0).any(axis=(1, 2))
        means = now.mean(axis=(1, 2))
        gaps = [mean_gaps(now, axis) for axis in (2, 1)]
        of_frames = [np.abs(change).mean(axis=(1, 2)), np.abs(steps[1:]), turns, is_repeat]
        of_frames = [means, *of_frames, means, *gaps, (now == 0).mean(axis=(1, 2)), is_repeat]
        sums = np.stack([each.reshape(-1, count).sum(axis=1) for each in of_frames], axis=1)
        of_ticks, of_touch = np.split(sums, [len(QUIET)], axis=1)  # in the order of `QUIET`
        ticks = now.reshape(len(sums), -1)
        moved = has_moved.reshape(len(sums), count, *now[0].shape).any(axis=1)
        largest, least = ticks.max(axis=1), means.reshape(-1, count).min(axis=1)
        at_largest = (ticks == largest[:, None]).sum(axis=1)
        for i, numbers in enumerate(of_ticks):
            self.tick += numbers
            self.moved |= moved[i]
            self.tick_frames += count
            if self.is_lasting:
                self.touch_frames += count
                self.sums += of_touch[i]
                self.least = min(self.least, float(least[i]))
                if largest[i] > self.largest:
                    self.largest, self.at_largest = float(largest[i]), 0
                self.at_largest += int(at_largest[i]) * (largest[i] == self.largest)
            yield

    def finish_tick(
        self, since: int, report: bool, pace: float = 0.0
    ) -> list[tuple[int, np.ndarray]]:
        """End a tick with the sign of the detector.

        Args:
            since: ticks since a touch began; 0 without touch.
            report: True if a touch is reported.
            pace: of the touch that this tick may end.

        Returns:
            Numbers of the blocks that end: place of the first number, and means.
        """
        blocks = []
        if self.is_lasting and (report or since <= 1):
            self.is_lasting = False
            if self.touch_frames:
                blocks += self._finish_touch(pace)
        if report:
            self.is_lasting = True
            self._forget_touch()
        if self.tick_frames:
            means = self.tick / self.tick_frames
            means[: len(CALM)] = np.log(means[: len(CALM)] + SLIGHT)
            if not self.is_lasting and not since:
                self.quiet, self.quiet_ticks = self.quiet + means, self.quiet_ticks + 1
            self.calm = np.minimum(self.calm, means[: len(CALM)])
            self.calm_ticks += 1
        self.tick, self.tick_frames = np.zeros(len(QUIET)), 0
        if self.quiet_ticks == QUIET_TICKS:
            means = self.quiet / QUIET_TICKS
            self.quiet, self.quiet_ticks = np.zeros(len(QUIET)), 0
            self.quiet_status = self._judge(0, means, 0)
            blocks.append((0, means))
        if self.calm_ticks == CALM_TICKS:
            least, self.calm = self.calm, np.full(len(CALM), np.inf)
            self.calm_ticks = 0
            self.calm_status = self._judge(FIRST_CALM, least, 0)
            blocks.append((FIRST_CALM, least))
        return blocks

    def _finish_touch(self, pace: float) -> list[tuple[int, np.ndarray]]:
        """Add the numbers of a touch; return those of its block if it is the last."""
        mean, across, down, zeros, repeats = self.sums / self.touch_frames
        numbers = combine_statistics(mean, self.largest, self.least, across, down, zeros)
        at_largest = np.log(self.at_largest / self.touch_frames)
        self.touched += [*numbers, at_largest, repeats, pace, 0.0]
        self.touches += 1
        if self.touches < TOUCHES:
            return []
        means = self.touched / TOUCHES
        means[-1] = (~self.moved).sum()
        if self.slow_pace is not None:
            means[PACE] = (means[PACE] + self.slow_pace) / 2
        self.slow_pace = float(means[PACE])
        self.touched, self.touches = np.zeros(len(TOUCHED)), 0
        self.moved[:] = False
        self.touch_status = self._judge(FIRST_TOUCHED, means, self.quiet_status | self.calm_status)
        return [(FIRST_TOUCHED, means)]

    def _judge(self, first: int, means: np.ndarray, known: int) -> int:
        """Reasons of a block besides known ones.

        Repeated frames explain all others, and any other explains turns and pace.
        """
        status = 0
        for k, value in enumerate(means, first):
            if value < self.limits.low[k]:
                status |= NUMBERS[k].below
            elif value > self.limits.high[k]:
                status |= NUMBERS[k].above
                if k in (REPEATS, TOUCH_REPEATS):
                    return RATE
        return status & ~RATE if (status | known) & ~RATE else status


def watch_health(
    health: Health, frames: np.ndarray, signs: np.ndarray, count: int, paces: np.ndarray
) -> tuple[np.ndarray, list[tuple[int, np.ndarray]]]:
    """Status after each tick of a recording, int64 [ticks], and all its blocks.

    Args:
        health: of a new stream.
        frames: of the recording.
        signs: of the detector, for each tick.
        count: frames of a tick.
        paces: of the touches, in order.
    """
    status, blocks, touch = np.zeros(len(signs), np.int64), [], 0
    pace_of_touch = np.append(0.0, paces)  # by the count of reports so far
    for tick, _ in enumerate(_take_all(health, frames[: len(signs) * count], count)):
        _, since, report = signs[tick]
        blocks += health.finish_tick(int(since), bool(report), float(pace_of_touch[touch]))
        touch += int(report)
        status[tick] = health.status
    return status, blocks


def _take_all(health: Health, frames: np.ndarray, count: int) -> Iterator[None]:
    """Take the ticks of a recording, many at once; yield after each one."""
    if len(frames):
        yield health.take(frames[:count])
    for first in range(count, len(frames), BLOCK * count):
        yield from health.take_ticks(frames[first : first + BLOCK * count], count)


def learn_limits(
    recordings: Corpus,
    signs: Sequence[np.ndarray],
    count: int,
    paces: Sequence[np.ndarray],
    units: np.ndarray,
) -> Limits:
    """Learn the range of each number from the blocks of training recordings.

    The range of all units is widened so far that the blocks of each unit lie in the range of the
    others, widened by the same share.

    Args:
        recordings: training recordings.
        signs: of each recording, from a detector that was fitted without it.
        count: frames of a tick.
        paces: of the touches of each recording, in order.
        units: name of the unit of each recording; units are left out together.
    """
    rows: dict[int, list[np.ndarray]] = {0: [], FIRST_CALM: [], FIRST_TOUCHED: []}
    owners: dict[int, list[str]] = {first: [] for first in rows}
    for i, unit in enumerate(units):
        health = Health(NO_LIMITS, recordings.full_scale)
        for first, means in watch_health(health, recordings[i], signs[i], count, paces[i])[1]:
            rows[first].append(means)
            owners[first].append(unit)
    low, high = NO_LIMITS.low.copy(), NO_LIMITS.high.copy()
    for first, blocks in rows.items():
        owner = np.array(owners[first])
        if len(blocks) < FEWEST_BLOCKS or len(set(owner)) < 2:
            continue
        span = slice(first, first + len(blocks[0]))
        grain = np.array([number.grain for number in NUMBERS[span]])
        low[span], high[span] = _widened_range(np.stack(blocks), owner, grain)
    return Limits(low, high)


def _widened_range(
    values: np.ndarray, owner: np.ndarray, grain: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Range of numbers [blocks, numbers], widened as of `learn_limits`."""
    margin = np.full(values.shape[1], LEAST_MARGIN)
    for unit in np.unique(owner):
        others, own = values[owner != unit], values[owner == unit]
        above = own.max(axis=0) - others.max(axis=0)
        below = others.min(axis=0) - own.min(axis=0)
        width = np.maximum(np.ptp(others, axis=0), grain)
        margin = np.maximum(margin, np.maximum(above, below) / width)
    margin *= np.maximum(np.ptp(values, axis=0), grain)
    return values.min(axis=0) - margin, values.max(axis=0) + margin
