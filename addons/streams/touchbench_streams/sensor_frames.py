"""Frames of a sensor, decoded from lines of numbers or from packets."""

from __future__ import annotations

import binascii
import queue
import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

from bench.errors import InputError, one_line
from touchbench_streams.lines import MOST_BAD_LINES, parse_frame, read_lines

FEW = 20  # frames that tell a counter from a time stamp
SILENCE_S = 3.0  # without a frame
LATE = 1.5  # periods between two time stamps that mean a lost frame
WRAPS = (1 << 8, 1 << 16, 1 << 32)  # frames after which counters begin again
END = b"\0"  # of a packet
NO_TEXT = "what arrived is no text; check baud=, or give format=packets"


def is_text(content: bytes) -> bool:
    """Return True if most bytes are of text, as those of a wrong baud are not."""
    readable = sum(32 <= byte < 127 or byte in b"\r\n\t" for byte in content)
    return readable >= 0.7 * len(content)


class Frame(NamedTuple):
    """A frame as it arrived.

    Attributes:
        seconds: time of arrival, of a clock that only goes forward.
        values: float64 [channels].
        lost: frames that are missing before it, by its counter or time stamp.
        is_restart: the sensor counts from the beginning again.
    """

    seconds: float
    values: np.ndarray
    lost: int = 0
    is_restart: bool = False


class Lines:
    """Decode lines: values row by row, with commas or blanks, after a counter or a time stamp.

    Up to `MOST_BAD_LINES` wrong lines in a row are skipped and counted.
    """

    def __init__(self, channels: int, full_scale: float) -> None:
        self.channels, self.full_scale = channels, full_scale
        self.bad, self.beginning, self.why = 0, b"", ""
        self.gaps = Gaps()

    def decode(self, stream: BinaryIO) -> Iterator[Frame]:
        """Yield frames until the stream ends."""
        bad_in_a_row = 0
        for number, line in read_lines(stream, self.channels + 1):
            self.beginning = self.beginning or line[:60]
            if not (text := line.strip()):
                continue
            first, text = self._split_number(text)
            try:
                values = parse_frame(text, number, self.channels, self.full_scale)
                stamp = None if first is None else float(first)
            except (InputError, ValueError) as e:
                self.why = self.why or str(e)
                bad_in_a_row += 1
                self.bad += number > 1  # the first line may be a header, or half a line
                if bad_in_a_row > MOST_BAD_LINES:
                    reason = str(e) if is_text(line[:60]) else f"line {number}: {NO_TEXT}"
                    raise InputError(f"{reason}; {MOST_BAD_LINES} lines in a row are wrong") from e
                continue
            bad_in_a_row = 0
            yield Frame(time.monotonic(), values, *self.gaps.before(stamp))

    def _split_number(self, text: bytes) -> tuple[bytes | None, bytes]:
        """A counter or time stamp in front of the values, or None, and the values."""
        separator = b"," if b"," in text else None
        cells = text.split(separator)
        if len(cells) != self.channels + 1:
            return None, text
        return cells[0], (separator or b" ").join(cells[1:])


class Packets:
    """Decode packets: a counter, the values and CRC-16 (CCITT, from 0xFFFF), uint16, COBS-framed.

    Numbers are little-endian. COBS (Cheshire and Baker 1999) removes zeros, so that a zero ends a
    packet. Wrong packets are skipped and counted.
    """

    def __init__(self, channels: int, full_scale: float) -> None:
        self.channels, self.full_scale = channels, full_scale
        self.bad, self.beginning, self.why = 0, b"", ""
        self.gaps = Gaps(is_counter=True)

    def decode(self, stream: BinaryIO) -> Iterator[Frame]:
        """Yield frames until the stream ends."""
        size, rest, number = 2 * (self.channels + 2), b"", 0
        read = getattr(stream, "read1", stream.read)
        while content := read(4096):
            *packets, rest = (rest + content).split(END)
            rest = rest[-2 * size :]  # a sensor that never ends a packet fills no memory
            self.beginning = self.beginning or content[:60]
            for packet in packets:
                number += 1
                whole = remove_cobs(packet)
                if len(whole) != size or binascii.crc_hqx(whole[:-2], 0xFFFF) != int.from_bytes(
                    whole[-2:], "little"
                ):
                    self.bad += number > 1  # the first may be half a packet
                    self.why = self.why or f"packet of {len(whole)} bytes instead of {size}"
                    continue
                counter, *values = np.frombuffer(whole[:-2], "<u2").tolist()
                if max(values) > self.full_scale:
                    reason = f"reading {max(values)} is above full_scale={self.full_scale:g}"
                    raise InputError(f"packet {number}: {reason}; correct full_scale=")
                frame = np.array(values, dtype=np.float64)
                yield Frame(time.monotonic(), frame, *self.gaps.before(counter))


def remove_cobs(packet: bytes) -> bytes:
    """The content of a packet without its framing; b"" if it cannot be right."""
    content, place = bytearray(), 0
    while place < len(packet):
        code = packet[place]
        block = packet[place + 1 : place + code]
        if len(block) != code - 1:
            return b""
        content += block
        place += code
        if code < 0xFF and place < len(packet):
            content += b"\0"
    return bytes(content)


def make_decoder(name: str, channels: int, full_scale: float) -> Lines | Packets:
    """The decoder of a format of the key ``format=``."""
    return {"lines": Lines, "packets": Packets}[name](channels, full_scale)


class Gaps:
    """Counts frames that are missing, by a counter or by time stamps in any unit."""

    def __init__(self, is_counter: bool | None = None) -> None:
        self.is_counter = is_counter
        self.last: float | None = None
        self.steps: deque[float] = deque(maxlen=FEW)

    def before(self, stamp: float | None) -> tuple[int, bool]:
        """Frames that are missing before this one, and whether the sensor has begun anew."""
        last, self.last = self.last, stamp
        if stamp is None or last is None:
            return 0, False
        step = stamp - last
        if step <= 0:
            return self._after_wrap(last, stamp)
        if len(self.steps) < FEW:
            self.steps.append(step)
            return 0, False
        if self.is_counter is None:
            self.is_counter = float(np.median(self.steps)) == 1
        usual = 1.0 if self.is_counter else float(np.median(self.steps))
        self.steps.append(step)
        if step < LATE * usual:
            return 0, False
        return round(step / usual) - 1, False

    def _after_wrap(self, last: float, stamp: float) -> tuple[int, bool]:
        """A counter has reached its end, or the sensor has begun anew."""
        for wrap in WRAPS:
            lost = stamp + wrap - last - 1
            if self.is_counter and last < wrap and 0 <= lost < wrap / 8:
                return int(lost), False
        self.steps.clear()
        return 0, True


class Receiver:
    """Receives frames in a thread of its own, so that none waits for the screen or the disk."""

    def __init__(self, decoder: Lines | Packets, stream: BinaryIO) -> None:
        self.decoder = decoder
        self.error: InputError | None = None
        self.is_ended = False
        self._arrived: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._receive, args=(stream,), daemon=True)
        self._thread.start()

    def _receive(self, stream: BinaryIO) -> None:
        try:
            for frame in self.decoder.decode(stream):
                self._arrived.put(frame)
        except InputError as e:
            self.error = e
        except (OSError, ValueError):  # unplugged, or closed at the end
            pass
        self.is_ended = True

    def take(self) -> list[Frame]:
        """Take the frames that have arrived since the last call.

        Raises:
            InputError: what arrives cannot be read, or nothing will arrive any more.
        """
        is_ended, frames = self.is_ended, self.drain()
        if not frames and self.error:
            raise self.error
        if not frames and is_ended:
            raise InputError("the sensor has gone; plug it in and repeat the command: it continues")
        return frames

    def drain(self) -> list[Frame]:
        """Take the frames that have arrived, if any."""
        frames = []
        while not self._arrived.empty():
            frames.append(self._arrived.get())
        return frames

    def describe_silence(self) -> str:
        """Say what has arrived in place of frames."""
        beginning = self.decoder.beginning
        if not beginning:
            return "nothing arrived; check the cable, and that the sensor sends"
        if isinstance(self.decoder, Lines) and not is_text(beginning):
            return NO_TEXT
        if isinstance(self.decoder, Packets) and is_text(beginning):
            return "what arrived is text; give format=lines"
        shown = one_line(beginning.decode("ascii", "replace"), 40)
        why = self.decoder.why or "no packet ends"
        return f"what arrived begins with {shown!r} ({one_line(why, 120)})"


class PlainLines:
    """Lines of a sensor without counters or framing, as a file that can be read by lines."""

    def __init__(self, decoder: Lines | Packets, stream: BinaryIO) -> None:
        self.receiver = Receiver(decoder, stream)
        self.waiting: deque[Frame] = deque()
        self.has_begun = False

    def readline(self, most: int = -1) -> bytes:
        """The next frame as a line, b"" at the end; all are shorter than ``most``.

        Raises:
            InputError: the sensor sends nothing, or nothing readable.
        """
        begin = time.monotonic()
        while not self.waiting:
            is_ended = self.receiver.is_ended
            self.waiting.extend(self.receiver.drain())
            if self.waiting:
                break
            if self.receiver.error:
                raise self.receiver.error
            if is_ended and self.has_begun:
                return b""
            if is_ended or time.monotonic() - begin > SILENCE_S:
                raise InputError(
                    f"no frame for {SILENCE_S:g} s: {self.receiver.describe_silence()}"
                )
            time.sleep(0.005)
        self.has_begun = True
        values = self.waiting.popleft().values
        return ",".join(f"{value:.9g}" for value in values.tolist()).encode() + b"\n"
