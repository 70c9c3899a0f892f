"""What would ruin an evening, found before the first prompt: a line each, with what to do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from touchbench_streams.sensor_frames import Frame

OTHER_RATE = 0.1  # share by which the measured rate may differ
AT_REST = 0.05  # of full scale, mean of all taxels
JITTER = 0.5  # periods, of the middle nine tenths of the times between frames
LOW = 0.1  # of full scale: a press that stays below it suggests another full scale
SATURATED = 0.1  # share of readings at full scale at rest
SEEN = 0.02  # of full scale, by which a press raises a taxel
LOST = 0.02  # share of frames


def measure_rate(frames: Sequence[Frame]) -> float:
    """Frames per second, lost ones included; 0 for fewer than two frames."""
    if len(frames) < 2 or frames[-1].seconds <= frames[0].seconds:
        return 0.0
    count = len(frames) - 1 + sum(frame.lost for frame in frames[1:])
    return count / (frames[-1].seconds - frames[0].seconds)


def check_rest(frames: Sequence[Frame], rate_hz: float | None, full_scale: float) -> list[str]:
    """Look at frames without touch.

    Args:
        frames: some seconds of frames.
        rate_hz: the stated rate, if there is one.
        full_scale: largest possible reading.
    """
    readings = np.stack([frame.values for frame in frames])
    measured, lines = measure_rate(frames), []
    if rate_hz and abs(measured / rate_hz - 1) > OTHER_RATE:
        lines.append(f"frames come at {measured:.3g} Hz, not {rate_hz:g}; correct rate_hz=")
    if (level := float(readings.mean()) / full_scale) > AT_REST:
        advice = "take the weight off, or calibrate it"
        lines.append(f"at rest the skin reads {100 * level:.0f} % of full scale; {advice}")
    if (share := float((readings >= full_scale).mean())) > SATURATED:
        lines.append(f"{100 * share:.0f} % of readings are at full scale; check full_scale=")
    steps = np.diff([frame.seconds for frame in frames]) * measured
    low, high = np.quantile(steps, [0.05, 0.95])
    if high - low > 2 * JITTER:
        lines.append(
            f"frames come unevenly: {low / measured * 1000:.0f} to {high / measured * 1000:.0f} ms "
            "apart; send each frame at once, without a buffer"
        )
    if (lost := sum(frame.lost for frame in frames)) > LOST * len(frames):
        lines.append(
            f"{lost} of {lost + len(frames)} frames are lost; raise baud= or lower the rate"
        )
    return lines


def check_strokes(frames: Sequence[Frame], grid: tuple[int, int], full_scale: float) -> list[str]:
    """Look at frames of strokes over the whole skin."""
    readings, lines = np.stack([frame.values for frame in frames]), []
    if (still := np.flatnonzero(np.ptp(readings, axis=0) == 0)).size:
        places = ", ".join(f"row {i // grid[1]} col {i % grid[1]}" for i in still[:4].tolist())
        more = f" and {still.size - 4} more" if still.size > 4 else ""
        lines.append(f"taxels that never change: {places}{more}; check wires, or stroke them")
    if 0 < readings.max() < LOW * full_scale:
        lines.append(
            f"the largest reading is {readings.max():g}, full scale {full_scale:g}; check "
            "full_scale=, or press harder"
        )
    return lines


def check_corner(
    rest: Sequence[Frame], press: Sequence[Frame], grid: tuple[int, int], full_scale: float
) -> list[str]:
    """Look at a press on the corner at the end of the first row."""
    rows, cols = grid
    rise = np.mean([frame.values for frame in press], axis=0)
    rise = rise - np.mean([frame.values for frame in rest], axis=0)
    if rise.max() < SEEN * full_scale:
        return ["no press was seen; press the corner harder, and repeat the command"]
    row, col = divmod(int(rise.argmax()), cols)
    is_first, is_last = row < rows / 2, col >= cols / 2
    if is_first and is_last:
        return []
    names = {(False, False): "transposed", (True, False): "mirrored", (False, True): "upside down"}
    return [
        f"the press appears in row {row}, col {col}: the grid is {names[is_first, is_last]}; "
        "send rows from the top, each from left to right"
    ]
