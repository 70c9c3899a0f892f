"""Classify frames from standard input as they come."""

from __future__ import annotations

import csv
import sys
from collections import Counter, deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.limits import checked_values
from bench.errors import InputError
from bench.running.replay import GROWTH
from bench.values.stopping import NO_SAVING
from touchbench_streams.detectors.status import REASONS
from touchbench_streams.lines import MOST_BAD_LINES, parse_frame, read_frames, read_lines
from touchbench_streams.show import View

if TYPE_CHECKING:
    from bench.running.saved import Recogniser
    from touchbench_streams.detectors.ticks import TickWatcher
    from touchbench_streams.sensor import Sensor

STATUS_S = 5.0  # that a new status must last before it is printed
STATUS_MESSAGES = (  # of the reasons, in the order of their bits
    "a reading is not a number",
    "a reading is out of range",
    "taxels are at full scale, or touches are cut off below it",
    "readings change more than in training, or all swing together",
    "some taxels never change; they are dead or short-circuited",
    "frames repeat, or come at another rate than in training",
    "readings without touch are higher or lower than in training",
    "readings without touch change less than in training",
    "touches are unlike those of training",
)


def run_stream(model: str, hop_ms: float, events: bool, show: bool, sensor: Sensor) -> int:
    """Classify frames of a sensor with a saved model until it ends.

    With ``events`` and a model that can watch, touches of an endless stream are reported;
    otherwise captures are classified.
    """
    from bench.running.saved import load_recogniser

    recogniser = load_recogniser(model)
    channels = recogniser.grid[0] * recogniser.grid[1]
    stream = sensor.open(channels, recogniser.full_scale)
    if recogniser.watcher is not None and events:
        return report_touches_live(recogniser, recogniser.watcher, stream, show)
    if show:
        raise InputError("show=yes needs a model that watches an endless stream; see bench fit")
    return classify_captures_live(recogniser, hop_ms, stream)


def classify_captures_live(recogniser: Recogniser, hop_ms: float, source: BinaryIO) -> int:
    """Classify captures every so many milliseconds; an empty line ends one."""
    frame_ms = 1000 / recogniser.rate_hz
    if hop_ms < frame_ms:
        raise InputError(
            f"hop_ms={hop_ms:g}: one frame takes {frame_ms:.4g} ms; give at least that"
        )
    longest = recogniser.longest
    print(
        f"{_expected_frames(recogniser)}; decisions use at most the last "
        f"{longest * frame_ms:g} ms of a capture",
        file=sys.stderr,
    )
    if recogniser.stopping is not None and not recogniser.stopping.saves:
        print(f"{NO_SAVING}: settled is -", file=sys.stderr)
    output = _start_csv("capture", "ms", "label", "confidence", "settled")
    channels = recogniser.grid[0] * recogniser.grid[1]
    frames = read_frames(source, channels, recogniser.full_scale)
    current, is_settled, labels = 0, False, deque[tuple[int, str]]()
    for capture, seen, window in decision_windows(frames, recogniser.rate_hz, hop_ms, longest):
        if capture != current:
            current, is_settled, labels = capture, False, deque()
        label, confidence, share = recogniser.decide_on(
            _capture_of_window(window, recogniser), earlier_label(labels, seen)
        )
        labels.append((seen, label))
        is_settled = is_settled or recogniser.is_settled(share)
        settled = "yes" if is_settled else "no"
        if share is None:
            settled = "-"
        output.writerow([capture, f"{seen * frame_ms:.0f}", label, f"{confidence:.3f}", settled])
        sys.stdout.flush()
    return 0


def report_touches_live(
    recogniser: Recogniser, watcher: TickWatcher, source: BinaryIO, show: bool
) -> int:
    """Report the touches of an endless stream until it ends; skip empty lines."""
    view = View(recogniser.grid, recogniser.full_scale)
    with view.open(show):
        return _report_touches(recogniser, watcher, source, view)


def _report_touches(
    recogniser: Recogniser, watcher: TickWatcher, source: BinaryIO, view: View
) -> int:
    """Print each report, and show it."""
    rows, cols = recogniser.grid
    full_scale, frame_ms = recogniser.full_scale, 1000 / recogniser.rate_hz
    print(
        f"{_expected_frames(recogniser)}; a touch is reported after "
        f"{watcher.soonest * frame_ms:.0f} ms or later",
        file=sys.stderr,
    )
    stream = watcher.open_stream(recogniser.grid, recogniser.rate_hz, full_scale)
    output = _start_csv("ms", "news", "label", "confidence")
    is_touched, taken, skipped, skipped_in_a_row = False, 0, 0, 0
    printed_status, frames_since_change = 0, 0
    counts = Counter[str]()
    for number, line in read_lines(source, rows * cols):
        try:
            frame = parse_frame(line, number, rows * cols, full_scale)
        except InputError as e:
            skipped, skipped_in_a_row = skipped + 1, skipped_in_a_row + 1
            if skipped_in_a_row > MOST_BAD_LINES:
                raise
            if skipped == 1:
                print(
                    f"{e}; this line counts as a lost frame, as up to {MOST_BAD_LINES} in a row do",
                    file=sys.stderr,
                )
            events = stream.miss(1)
        else:
            if frame is None:
                continue
            taken, skipped_in_a_row = taken + 1, 0
            (values,) = checked_values(frame.reshape(1, rows, cols), full_scale, "input", "frame")
            view.values = values
            events = stream.push(values)
        for event in events:
            news = "changed" if is_touched else "reported"
            is_touched = event.end is None
            if not is_touched:
                news = "ended"
            ms, confidence = f"{stream.seen * frame_ms:.0f}", f"{event.confidence:.3f}"
            view.tell(event.label, event.confidence, is_touched)
            output.writerow([ms, news, event.label, confidence])
            sys.stdout.flush()
        reasons = [k for k in range(len(REASONS)) if stream.status >> k & 1]
        counts.update(REASONS[k] for k in reasons)
        frames_since_change = frames_since_change + 1 if stream.status != printed_status else 0
        if frames_since_change * frame_ms >= 1000 * STATUS_S:
            printed_status, frames_since_change = stream.status, 0
            messages = [f"{REASONS[k]}: {STATUS_MESSAGES[k]}" for k in reasons]
            words = "; ".join(messages) or "frames are as in training again"
            print(f"{stream.seen * frame_ms:.0f} ms: {words}", file=sys.stderr)
    counts["lines lost"] = skipped
    if counts.total():
        words = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
        print(f"of {taken} frames: {words}", file=sys.stderr)
    return 0


def _expected_frames(recogniser: Recogniser) -> str:
    """Words on the frames that a system takes."""
    rows, cols = recogniser.grid
    return (
        f"expecting frames of {rows}x{cols}, values 0 to {recogniser.full_scale:g}, "
        f"at {recogniser.rate_hz:g} Hz"
    )


def _start_csv(*columns: str) -> Any:
    """A writer of CSV to standard output, after it has printed the header."""
    output = csv.writer(sys.stdout, lineterminator="\n")
    output.writerow(columns)
    sys.stdout.flush()
    return output


def earlier_label(labels: deque[tuple[int, str]], seen: int) -> str | None:
    """The label at 1 / `GROWTH` of the frames seen by now, or None; older labels are dropped."""
    while len(labels) > 1 and labels[1][0] * GROWTH <= seen:
        labels.popleft()
    return labels[0][1] if labels and labels[0][0] * GROWTH <= seen else None


def _capture_of_window(window: list[np.ndarray], recogniser: Recogniser) -> Corpus:
    """A corpus of one capture, with the type that a file of these values would have."""
    frames, full_scale = np.stack(window).reshape(-1, *recogniser.grid), recogniser.full_scale
    values = checked_values(frames, full_scale, "input", "frame")
    table = pd.DataFrame(index=[0])
    return Corpus.from_captures([values], table, recogniser.rate_hz, full_scale=full_scale)


def decision_windows(
    frames: Iterator[np.ndarray | None], rate_hz: float, hop_ms: float, longest: int
) -> Iterator[tuple[int, int, list[np.ndarray]]]:
    """Yield what to decide on: every hop, and at the end of a capture with frames since the last.

    Args:
        frames: frames of captures, with None between captures.
        rate_hz: frames per second.
        hop_ms: milliseconds between decisions.
        longest: most frames of a window.

    Yields:
        Number of the capture from 1, frames since its beginning, and its last frames.
    """
    capture, seen, decided = 1, 0, 0
    window: deque[np.ndarray] = deque(maxlen=longest)
    per_hop = hop_ms * rate_hz / 1000
    for frame in frames:
        if frame is not None:
            window.append(frame)
            seen += 1
            hops = int((seen + 1e-6) / per_hop)
            if hops > int((seen - 1 + 1e-6) / per_hop):
                decided = seen
                yield capture, seen, list(window)
        elif seen:
            if decided < seen:
                yield capture, seen, list(window)
            capture, seen, decided = capture + 1, 0, 0
            window.clear()
    if decided < seen:
        yield capture, seen, list(window)
