"""Frames from standard input, decided on as they come."""

from __future__ import annotations

import csv
import re
import sys
from collections import deque
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.limits import quoted
from bench.corpora.read.sensor_values import checked, highest_of
from bench.errors import InputError
from bench.work.replay import GROWTH
from bench.work.stopping import NO_SAVING

if TYPE_CHECKING:
    from bench.work.saved import Recogniser
    from touchbench_streams.detectors.base import Watches

CHARACTERS = 32  # most of a number; a line has at most as many for each channel, its end included
MOST_BAD = 10  # lines in a row that are no frames: more are another format, or a broken sensor
LASTS_S = 5.0  # seconds that a status lasts before it is told
TOLD = {
    "ok": "frames are as in training again",
    "refused": "touches may be missed: no taxel changes, or frames differ from training or look like a broken sensor",
    "saturated": "a tenth of the taxels or more are at full scale",
}
NUMBER = re.compile(rb"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


def decide(model: str, hop_ms: float, events: bool) -> int:
    """Decide on frames from standard input until it ends.

    Args:
        model: address or folder of a saved model.
        hop_ms: time between decisions on a capture.
        events: False to classify captures with a model that can watch an endless stream.

    Raises:
        InputError: an argument, or a line that is not a frame; the decisions before it are out already.
    """
    from bench.work.saved import load

    recogniser = load(model)
    if recogniser.watcher is not None and events:
        return watched(recogniser, recogniser.watcher)
    frame_ms = 1000 / recogniser.rate_hz
    if hop_ms < frame_ms:
        raise InputError(f"hop_ms={hop_ms:g}: one frame takes {frame_ms:.4g} ms; give at least that")
    longest = recogniser.longest
    rows, cols = recogniser.grid
    print(
        f"expecting frames of {rows}x{cols}, values 0 to {recogniser.full_scale:g}, at {recogniser.rate_hz:g} Hz; "
        f"decisions use at most the last {longest * frame_ms:g} ms of a capture",
        file=sys.stderr,
    )
    if recogniser.stopping is not None and not recogniser.stopping.saves:
        print(f"{NO_SAVING}: settled is -", file=sys.stderr)
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(["capture", "ms", "label", "confidence", "settled"])
    sys.stdout.flush()
    frames = frames_of(sys.stdin.buffer, rows * cols, recogniser.full_scale)
    current, settled, labels = 0, False, deque[tuple[int, str]]()
    for capture, seen, window in decided_at(frames, recogniser.rate_hz, hop_ms, longest):
        if capture != current:
            current, settled, labels = capture, False, deque()
        label, confidence, share = recogniser.decision(_corpus(window, recogniser), earlier(labels, seen))
        labels.append((seen, label))
        settled = settled or recogniser.is_settled(share)
        word = "-" if share is None else "yes" if settled else "no"
        out.writerow([capture, f"{seen * frame_ms:.0f}", label, f"{confidence:.3f}", word])
        sys.stdout.flush()
    return 0


def watched(recogniser: Recogniser, watcher: Watches) -> int:
    """Report the touches of an endless stream until standard input ends; empty lines mean nothing.

    Raises:
        InputError: more than `MOST_BAD` lines in a row that are not frames; news before them is printed already.
    """
    rows, cols = recogniser.grid
    frame_ms = 1000 / recogniser.rate_hz
    print(
        f"expecting frames of {rows}x{cols}, values 0 to {recogniser.full_scale:g}, at {recogniser.rate_hz:g} Hz; "
        f"a touch is reported after {watcher.soonest * frame_ms:.0f} ms or later",
        file=sys.stderr,
    )
    stream, skipped = watcher.stream(recogniser.grid, recogniser.rate_hz, recogniser.full_scale), Skipped()
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(["ms", "news", "label", "confidence"])
    sys.stdout.flush()
    lasting, seen, told, since = False, 0, "ok", 0
    counts = dict.fromkeys(TOLD, 0)
    for frame in frames_of(sys.stdin.buffer, rows * cols, recogniser.full_scale, skipped):
        if frame is None:
            continue
        seen, skipped.row = seen + 1, 0
        for event in stream.push(checked(frame.reshape(1, rows, cols), recogniser.full_scale, "input", "frame")[0]):
            news = "ended" if event.end is not None else "changed" if lasting else "reported"
            lasting = event.end is None
            out.writerow([f"{seen * frame_ms:.0f}", news, event.label, f"{event.confidence:.3f}"])
            sys.stdout.flush()
        counts[stream.status] += 1
        since = since + 1 if stream.status != told else 0
        if since * frame_ms >= 1000 * LASTS_S:
            told, since = stream.status, 0
            print(f"{seen * frame_ms:.0f} ms: {TOLD[told]}", file=sys.stderr)
    strange = [(count, name) for name, count in counts.items() if name != "ok"] + [(skipped.count, "lines skipped")]
    if words := [f"{count} {name}" for count, name in strange if count]:
        print(f"of {seen} frames: {', '.join(words)}", file=sys.stderr)
    return 0


class Skipped:
    """Lines that are no frames, and are left out.

    Attributes:
        count: lines so far.
        row: lines since the last frame.
    """

    def __init__(self) -> None:
        self.count = self.row = 0

    def __call__(self, error: InputError) -> None:
        """Count a line.

        Raises:
            InputError: there are more than `MOST_BAD` in a row.
        """
        self.count, self.row = self.count + 1, self.row + 1
        if self.row > MOST_BAD:
            raise error
        if self.count == 1:
            print(f"{error}; this line is skipped, as up to {MOST_BAD} in a row are", file=sys.stderr)


def earlier(labels: deque[tuple[int, str]], seen: int) -> str | None:
    """The label when 1/1.41 as much had been seen, None if there was none; older ones are removed.

    Args:
        labels: frames seen and label of the decisions on a capture, in their order; at most one older one remains.
        seen: frames by now.
    """
    while len(labels) > 1 and labels[1][0] * GROWTH <= seen:
        labels.popleft()
    return labels[0][1] if labels and labels[0][0] * GROWTH <= seen else None


def _corpus(window: list[np.ndarray], recogniser: Recogniser) -> Corpus:
    """One capture, of the type that a file with these values would have."""
    values = checked(np.stack(window).reshape(-1, *recogniser.grid), recogniser.full_scale, "input", "frame")
    return Corpus.from_captures([values], pd.DataFrame(index=[0]), recogniser.rate_hz, full_scale=recogniser.full_scale)


def frames_of(
    stream: BinaryIO, channels: int, full_scale: float, skip: Callable[[InputError], None] | None = None
) -> Iterator[np.ndarray | None]:
    """Frames of a stream, float64 [channels] rounded to single precision, and None where a capture ends.

    A line is a frame: decimal numbers with a comma between two of them, and blanks (spaces, tabs) around it, or with
    blanks alone. A line of blanks alone, or of nothing, ends a capture. Lines end with LF or CR LF. The C of ``bench
    export`` reads the same.

    Args:
        stream: lines.
        channels: number of taxels.
        full_scale: largest value of a channel.
        skip: called with what is wrong with a line that is not a frame; without it, that is raised.

    Raises:
        InputError: a line that is not a frame, with its number.
    """
    at, most = 0, channels * CHARACTERS
    while line := stream.readline(most + 1):
        at += 1
        try:
            yield _frame_of(line, at, channels, full_scale)
        except InputError as e:
            if skip is None:
                raise
            while len(line) > most and not line.endswith(b"\n"):
                line = stream.readline(most + 1)
            skip(e)


def _frame_of(line: bytes, at: int, channels: int, full_scale: float) -> np.ndarray | None:
    """The frame in a line of some number; None in an empty one.

    Raises:
        InputError: it is none.
    """
    most = channels * CHARACTERS
    if len(line) > most:
        raise InputError(f"line {at}: longer than {most} bytes; send one frame of {channels} values per line")
    text = line.removesuffix(b"\n").removesuffix(b"\r").strip(b" \t")
    if not text:
        return None
    cells = [cell.strip(b" \t") for cell in text.split(b",")] if b"," in text else re.split(rb"[ \t]+", text)
    if len(cells) != channels:
        raise InputError(f"line {at}: {len(cells)} values instead of {channels}; send one frame per line")
    if wrong := [c for c in cells if len(c) > CHARACTERS or not NUMBER.fullmatch(c)]:
        word = quoted(wrong[0].decode("utf-8", "replace"))
        raise InputError(f"line {at}: {word} is not a decimal number; send sensor values")
    with np.errstate(over="ignore"):
        values = np.array(cells, dtype=np.float64).astype(np.float32).astype(np.float64)
    within = (values >= 0) & (values <= highest_of(full_scale))
    if not within.all():
        wrong_value = f"{values[~within][0]:g} is not between 0 and the full scale {full_scale:g}"
        raise InputError(f"line {at}: {wrong_value}; send sensor values")
    return values


def decided_at(
    frames: Iterator[np.ndarray | None], rate_hz: float, hop_ms: float, longest: int
) -> Iterator[tuple[int, int, list[np.ndarray]]]:
    """Times of decisions, and their frames: every hop, and the end of a capture with undecided frames.

    Args:
        frames: frames of one capture after another, with None between them.
        rate_hz: frames per second.
        hop_ms: milliseconds between decisions, at least one frame.
        longest: frames that are kept; older ones are forgotten.

    Yields:
        Number of the capture from 1, frames since its beginning, and the frames that are kept of it.
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
