"""A sensor on a serial port, at a network address or on standard input, read as it sends."""

from __future__ import annotations

import io
import os
import socket
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

from bench.errors import InputError, one_line
from bench.grammar.options import Option

SENSOR_OPTIONS = (
    Option("port", "text", "", "serial port of the sensor, such as /dev/ttyACM0 or COM3"),
    Option("baud", "counts", 115200, "bits a second of the serial port"),
    Option("tcp", "text", "", "network address of the sensor, as HOST:PORT"),
    Option(
        "format",
        "text",
        "lines",
        "what the sensor sends: lines of numbers with commas or blanks, after a counter or time "
        "stamp if there is one; or binary packets",
        ("lines", "packets"),
    ),
)
CONNECT_S = 5.0


@dataclass(frozen=True)
class Sensor:
    """The sensor that keys name."""

    port: str
    baud: int
    tcp: str
    format: str

    def open(self, channels: int, full_scale: float) -> BinaryIO:
        """Open it as lines of numbers; those of standard input stay as they are."""
        stream = open_sensor(self.port, self.baud, self.tcp)
        if not (self.port or self.tcp) and self.format == "lines":
            return stream
        from touchbench_streams.sensor_frames import PlainLines, make_decoder

        decoder = make_decoder(self.format, channels, full_scale)
        return cast(BinaryIO, PlainLines(decoder, stream))


def open_sensor(port: str, baud: int, tcp: str) -> BinaryIO:
    """Open the sensor that keys name; without any, standard input.

    Raises:
        InputError: there is no such port or address, or it may not be used.
    """
    if port and tcp:
        raise InputError("port= and tcp= are two sensors; give one")
    if port:
        return io.BufferedReader(_SerialPort(_open_port(port, baud)))
    if tcp:
        return _open_address(tcp)
    if sys.stdin is None:
        raise InputError("standard input is closed; give port= or tcp=, or send frames to it")
    return sys.stdin.buffer


class _SerialPort(io.RawIOBase):
    """A serial port that gives what has arrived, and waits only for the first byte."""

    def __init__(self, port: Any) -> None:
        super().__init__()
        self.port = port

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read at least a byte; 0 once the sensor is unplugged."""
        try:
            content = self.port.read(1)
            content += self.port.read(min(self.port.in_waiting, len(buffer) - len(content)))
        except OSError:  # so is pyserial's error of a port that is gone
            return 0
        buffer[: len(content)] = content
        return len(content)


def _open_port(name: str, baud: int) -> Any:
    """Open a serial port."""
    try:
        import serial
        from serial.tools.list_ports import comports
    except ImportError as e:
        raise InputError("port= needs pyserial: pip install pyserial") from e
    try:
        return serial.Serial(name, baud, exclusive=True if os.name == "posix" else None)
    except (OSError, ValueError) as e:
        ports = ", ".join(port.device for port in comports()) or "none"
        if not os.path.exists(name) and os.name == "posix":
            raise InputError(f"port={one_line(name)}: there is no such port; known: {ports}") from e
        if getattr(e, "errno", None) == 13:
            group = _group_of(Path(name))
            advice = f"join the group {group}: sudo usermod -aG {group} $USER, and log in again"
            raise InputError(f"port={name}: you may not use it; {advice}") from e
        advice = f"close other programs that use it, or check baud={baud}; ports: {ports}"
        raise InputError(f"port={one_line(name)} cannot be opened ({one_line(e)}); {advice}") from e


def _group_of(path: Path) -> str:
    """The name of the group that owns a file, or its number."""
    try:
        return path.group()
    except (KeyError, OSError):
        return str(path.stat().st_gid)


def _open_address(address: str) -> BinaryIO:
    """Connect to a sensor in the network."""
    host, _, number = address.rpartition(":")
    if not host or not number.isdecimal() or int(number) > 65535:
        raise InputError(f"tcp={one_line(address)}: give HOST:PORT, such as 192.168.0.7:5000")
    try:
        connection = socket.create_connection((host.strip("[]"), int(number)), CONNECT_S)
    except OSError as e:
        reason = one_line(e.strerror or e)
        advice = "check the address, and that the sensor is on"
        raise InputError(f"tcp={address} cannot be reached ({reason}); {advice}") from e
    connection.settimeout(None)
    with connection:  # it stays open until the file is closed
        return connection.makefile("rb")
