"""Frames from standard input, decided on as they come."""

from __future__ import annotations

import csv
import re
import sys
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.read.limits import checked_values, highest_value, quote_text
from bench.errors import InputError
from bench.running.replay import GROWTH
from bench.values.stopping import NO_SAVING

if TYPE_CHECKING:
    from bench.running.saved import Recogniser
    from touchbench_streams.detectors.ticks import TickWatcher

CHARACTERS = 32  # most of a number; a line has at most as many for each channel, its end included
MOST_BAD = 10  # lines in a row that are no frames: more are another format, or a broken sensor
LASTS_S = 5.0  # seconds that a status lasts before it is told
TOLD = {
    "ok": "frames are as in training again",
    "refused": "touches may be missed: no taxel changes, or frames differ from training or look like a broken sensor",
    "saturated": "a tenth of the taxels or more are at full scale",
}
NUMBER = re.compile(rb"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


def run_stream(model: str, hop_ms: float, events: bool) -> int:
    """Decide on frames from standard input with a saved model until it ends: on an endless stream, or on captures."""
    from bench.running.saved import load_recogniser

    recogniser = load_recogniser(model)
    if recogniser.watcher is not None and events:
        return report_touches_live(recogniser, recogniser.watcher)
    frame_ms = 1000 / recogniser.rate_hz
    if hop_ms < frame_ms:
        raise InputError(
            f"hop_ms={hop_ms:g}: one frame takes {frame_ms:.4g} ms; give at least that"
        )
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
    frames = read_frames(sys.stdin.buffer, rows * cols, recogniser.full_scale)
    current, settled, labels = 0, False, deque[tuple[int, str]]()
    for capture, seen, window in decision_windows(frames, recogniser.rate_hz, hop_ms, longest):
        if capture != current:
            current, settled, labels = capture, False, deque()
        label, confidence, share = recogniser.decide_on(
            _one_capture(window, recogniser), earlier_label(labels, seen)
        )
        labels.append((seen, label))
        settled = settled or recogniser.is_settled(share)
        word = "-" if share is None else "yes" if settled else "no"
        out.writerow([capture, f"{seen * frame_ms:.0f}", label, f"{confidence:.3f}", word])
        sys.stdout.flush()
    return 0


def report_touches_live(recogniser: Recogniser, watcher: TickWatcher) -> int:
    """Report the touches of an endless stream until standard input ends; empty lines mean nothing."""
    rows, cols = recogniser.grid
    full_scale, frame_ms = recogniser.full_scale, 1000 / recogniser.rate_hz
    print(
        f"expecting frames of {rows}x{cols}, values 0 to {full_scale:g}, at {recogniser.rate_hz:g} Hz; "
        f"a touch is reported after {watcher.soonest * frame_ms:.0f} ms or later",
        file=sys.stderr,
    )
    stream = watcher.open_stream(recogniser.grid, recogniser.rate_hz, full_scale)
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(["ms", "news", "label", "confidence"])
    sys.stdout.flush()
    lasting, seen, told, since, skipped, in_a_row = False, 0, "ok", 0, 0, 0
    counts = dict.fromkeys(TOLD, 0)
    for at, line in read_lines(sys.stdin.buffer, rows * cols):
        try:
            frame = _parse_frame(line, at, rows * cols, full_scale)
        except InputError as e:
            skipped, in_a_row = skipped + 1, in_a_row + 1
            if in_a_row > MOST_BAD:
                raise
            if skipped == 1:
                print(
                    f"{e}; this line is skipped, as up to {MOST_BAD} in a row are", file=sys.stderr
                )
            continue
        if frame is None:
            continue
        seen, in_a_row = seen + 1, 0
        for event in stream.push(
            checked_values(frame.reshape(1, rows, cols), full_scale, "input", "frame")[0]
        ):
            news = "ended" if event.end is not None else "changed" if lasting else "reported"
            lasting = event.end is None
            out.writerow([f"{seen * frame_ms:.0f}", news, event.label, f"{event.confidence:.3f}"])
            sys.stdout.flush()
        counts[stream.status] += 1
        since = since + 1 if stream.status != told else 0
        if since * frame_ms >= 1000 * LASTS_S:
            told, since = stream.status, 0
            print(f"{seen * frame_ms:.0f} ms: {TOLD[told]}", file=sys.stderr)
    strange = [(count, name) for name, count in counts.items() if name != "ok"] + [
        (skipped, "lines skipped")
    ]
    if words := [f"{count} {name}" for count, name in strange if count]:
        print(f"of {seen} frames: {', '.join(words)}", file=sys.stderr)
    return 0


def earlier_label(labels: deque[tuple[int, str]], seen: int) -> str | None:
    """The label when 1/1.41 as much as now had been seen, None if there was none; of older ones one remains."""
    while len(labels) > 1 and labels[1][0] * GROWTH <= seen:
        labels.popleft()
    return labels[0][1] if labels and labels[0][0] * GROWTH <= seen else None


def _one_capture(window: list[np.ndarray], recogniser: Recogniser) -> Corpus:
    """One capture, of the type that a file with these values would have."""
    values = checked_values(
        np.stack(window).reshape(-1, *recogniser.grid), recogniser.full_scale, "input", "frame"
    )
    return Corpus.from_captures(
        [values], pd.DataFrame(index=[0]), recogniser.rate_hz, full_scale=recogniser.full_scale
    )


def read_frames(stream: BinaryIO, channels: int, full_scale: float) -> Iterator[np.ndarray | None]:
    """Frames of a stream, float64 [channels] rounded to single precision, and None where a capture ends.

    A line is a frame: decimal numbers with a comma between two of them, and blanks (spaces, tabs) around it, or with
    blanks alone. A line of blanks alone, or of nothing, ends a capture. Lines end with LF or CR LF. The C of ``bench
    export`` reads the same.
    """
    return (
        _parse_frame(line, at, channels, full_scale) for at, line in read_lines(stream, channels)
    )


def read_lines(stream: BinaryIO, channels: int) -> Iterator[tuple[int, bytes]]:
    """Lines with their numbers from 1; of one that is too long for a frame, its beginning."""
    at, most = 0, channels * CHARACTERS
    while line := stream.readline(most + 1):
        at += 1
        yield at, line
        while len(line) > most and not line.endswith(b"\n"):
            line = stream.readline(most + 1)


def _parse_frame(line: bytes, at: int, channels: int, full_scale: float) -> np.ndarray | None:
    """The frame in a line of some number; None in an empty one."""
    most = channels * CHARACTERS
    if len(line) > most:
        raise InputError(
            f"line {at}: longer than {most} bytes; send one frame of {channels} values per line"
        )
    text = line.removesuffix(b"\n").removesuffix(b"\r").strip(b" \t")
    if not text:
        return None
    cells = (
        [cell.strip(b" \t") for cell in text.split(b",")]
        if b"," in text
        else re.split(rb"[ \t]+", text)
    )
    if len(cells) != channels:
        raise InputError(
            f"line {at}: {len(cells)} values instead of {channels}; send one frame per line"
        )
    if wrong := [c for c in cells if len(c) > CHARACTERS or not NUMBER.fullmatch(c)]:
        word = quote_text(wrong[0].decode("utf-8", "replace"))
        raise InputError(f"line {at}: {word} is not a decimal number; send sensor values")
    with np.errstate(over="ignore"):
        values = np.array(cells, dtype=np.float64).astype(np.float32).astype(np.float64)
    within = (values >= 0) & (values <= highest_value(full_scale))
    if not within.all():
        wrong_value = f"{values[~within][0]:g} is not between 0 and the full scale {full_scale:g}"
        raise InputError(f"line {at}: {wrong_value}; send sensor values")
    return values


def decision_windows(
    frames: Iterator[np.ndarray | None], rate_hz: float, hop_ms: float, longest: int
) -> Iterator[tuple[int, int, list[np.ndarray]]]:
    """Decisions on captures with None between them: every hop, and at the end of one with undecided frames.

    Yields:
        Number of the capture from 1, frames since its beginning, and at most the ``longest`` last frames of it.
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
