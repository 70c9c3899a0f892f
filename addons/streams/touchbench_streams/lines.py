"""Lines of numbers, one for each frame, as `bench live` and the C of ``bench export`` read them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from bench.corpora.corpus import NEGATIVE_SHARE
from bench.corpora.read.limits import highest_value, quote_text
from bench.errors import InputError

CHARACTERS = 32  # most of a number; a line has at most as many per channel, its end included
MOST_BAD_LINES = 10  # in a row; more come from another format or a broken sensor
NUMBER = re.compile(rb"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


def read_frames(stream: BinaryIO, channels: int, full_scale: float) -> Iterator[np.ndarray | None]:
    """Yield the frames of a stream, rounded to single precision, float64 [channels].

    None marks the end of a capture. A line is a frame: decimal numbers, separated either by commas
    with optional blanks (spaces, tabs) around them, or by blanks alone. An empty or blank line ends
    a capture. Lines end with LF or CR LF. The C of ``bench export`` reads the same.
    """
    for number, line in read_lines(stream, channels):
        yield parse_frame(line, number, channels, full_scale)


def read_lines(stream: BinaryIO, channels: int) -> Iterator[tuple[int, bytes]]:
    """Yield lines with their numbers from 1; only the beginning of one too long for a frame."""
    number, most = 0, channels * CHARACTERS
    while line := stream.readline(most + 1):
        number += 1
        yield number, line
        while len(line) > most and not line.endswith(b"\n"):
            line = stream.readline(most + 1)


def parse_frame(line: bytes, number: int, channels: int, full_scale: float) -> np.ndarray | None:
    """The frame in a line, whose number is used in messages; None for an empty line."""
    most = channels * CHARACTERS
    if len(line) > most:
        raise InputError(
            f"line {number}: longer than {most} bytes; send one frame of {channels} values per line"
        )
    text = line.removesuffix(b"\n").removesuffix(b"\r").strip(b" \t")
    if not text:
        return None
    if b"," in text:
        cells = [cell.strip(b" \t") for cell in text.split(b",")]
    else:
        cells = re.split(rb"[ \t]+", text)
    if len(cells) != channels:
        raise InputError(
            f"line {number}: {len(cells)} values instead of {channels}; send one frame per line"
        )
    if wrong := [c for c in cells if len(c) > CHARACTERS or not NUMBER.fullmatch(c)]:
        word = quote_text(wrong[0].decode("utf-8", "replace"))
        raise InputError(f"line {number}: {word} is not a decimal number; send sensor values")
    with np.errstate(over="ignore"):
        values = np.array(cells, dtype=np.float64).astype(np.float32).astype(np.float64)
    values[(values < 0) & (values >= -NEGATIVE_SHARE * full_scale)] = 0
    is_valid = (values >= 0) & (values <= highest_value(full_scale))
    if not is_valid.all():
        raise InputError(
            f"line {number}: {values[~is_valid][0]:g} is not between 0 and the full scale "
            f"{full_scale:g}; send sensor values"
        )
    return values
