"""The files of an evening, written as it goes: a kill loses at most the capture being made.

``day1.csv`` has the captures, ``day1-stream.csv`` all frames with their labels, and
``day1.journal`` a line for each capture with the size of ``day1.csv`` after it, so that what a kill
has left of a capture is cut off again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from bench.errors import InputError, one_line

TAIL = 1 << 20  # bytes of a file in which its last line lies


class Files:
    """The files of an evening, open for more.

    Args:
        path: the table of captures; a new file, or one of `Files` with the same settings.
        settings: what all captures of a file share.
        channels: number of channels.

    Raises:
        InputError: the file is not of `Files`, has other settings, is in use, or cannot be written.
    """

    def __init__(self, path: Path, settings: dict[str, Any], channels: int) -> None:
        self.path, self.settings = path, settings
        self.journal = path.with_suffix(".journal")
        self.stream_path = path.with_name(f"{path.stem}-stream.csv")
        names = ",".join(f"ch{number}" for number in range(1, channels + 1))
        conditions = "".join(f"{name}," for name in settings["columns"])
        self.heads = (
            f"subject,gesture,repetition,{conditions}frame,{names}\n",
            f"recording,subject,label,{conditions}{names}\n",
        )
        try:
            self.lock = FileLock(f"{path}.lock", timeout=0)
            self.lock.acquire()
            self.done = self._continue_or_begin()
            self.stream = open(self.stream_path, "ab")
        except Timeout as e:
            raise InputError(f"{path} is being recorded by another command; wait for it") from e
        except OSError as e:
            raise self._unwritable(e) from e
        self.recording = self._count_recordings()

    def _continue_or_begin(self) -> list[dict[str, Any]]:
        """Captures that are in the files; what a kill has left of another one is cut off."""
        if not self.journal.exists():
            for path in (self.path, self.stream_path):
                if path.exists():
                    raise InputError(f"{path} exists and was not recorded here; give another name")
            return self._begin()
        try:
            lines = self.journal.read_bytes().split(b"\n")
            settings, *entries = [json.loads(line) for line in lines[:-1]]
            if not entries and "grid" in settings:  # its keys may have been wrong
                return self._begin()
            size = entries[-1]["size"]
            is_whole = self.path.stat().st_size >= size
        except (LookupError, TypeError, ValueError, OSError) as e:
            raise InputError(f"{self.journal} is damaged; record into another file") from e
        for key, value in self.settings.items():
            if settings.get(key) != value:
                before = settings.get(key)
                raise InputError(f"{self.path} was begun with {key}={before}, now {value}")
        if not is_whole:
            raise InputError(f"{self.path} has lost captures that its journal names; restore it")
        os.truncate(self.journal, sum(len(line) + 1 for line in lines[:-1]))
        os.truncate(self.path, size)
        os.truncate(self.stream_path, _end_of_last_line(self.stream_path))
        done: list[dict[str, Any]] = []
        for entry in entries:
            if entry["gesture"]:
                done.append(entry)
            else:  # the one before was taken back
                done.pop()
        return done

    def _begin(self) -> list[dict[str, Any]]:
        """Write files without captures; the journal comes first, which says whose they are."""
        self.journal.unlink(missing_ok=True)
        self._append(self.settings)
        self.path.write_text(self.heads[0])
        self.stream_path.write_text(self.heads[1])
        return []

    def _count_recordings(self) -> int:
        """The number of the next recording."""
        with open(self.stream_path, "rb") as file:
            file.seek(max(0, self.stream_path.stat().st_size - TAIL))
            *_, last = file.read().decode().splitlines()
        number = last.partition(",")[0]
        return int(number) + 1 if number.isdecimal() else 1

    def _append(self, entry: dict[str, Any]) -> None:
        """Write a line of the journal to the disk."""
        with open(self.journal, "ab") as file:
            file.write(json.dumps(entry).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())

    def add_capture(
        self, subject: str, gesture: str, repetition: int, frames: Sequence[np.ndarray]
    ) -> None:
        """Write a capture; on an error, the file is as before."""
        conditions = "".join(f"{value}," for value in self.settings["columns"].values())
        head = f"{subject},{gesture},{repetition},{conditions}"
        rows = [f"{head}{i},{format_values(values)}\n" for i, values in enumerate(frames, 1)]
        size = self.path.stat().st_size
        try:
            with open(self.path, "ab") as file:
                file.write("".join(rows).encode())
                file.flush()
                os.fsync(file.fileno())
            entry = {"subject": subject, "gesture": gesture, "repetition": repetition}
            entry |= {"frames": len(frames), "size": self.path.stat().st_size}
            self._append(entry)
        except OSError as e:
            os.truncate(self.path, size)
            raise self._unwritable(e) from e
        self.done.append(entry)

    def take_back(self) -> dict[str, Any]:
        """Remove the last capture."""
        last = self.done.pop()
        size = self.done[-1]["size"] if self.done else len(self.heads[0])
        try:
            self._append({"subject": "", "gesture": "", "repetition": 0, "size": size})
            os.truncate(self.path, size)  # a kill before it leaves what the journal cuts off
        except OSError as e:
            raise self._unwritable(e) from e
        return last

    def add_frame(self, subject: str, label: str, values: np.ndarray) -> None:
        """Write a frame of the stream."""
        conditions = "".join(f"{value}," for value in self.settings["columns"].values())
        text = f"{self.recording},{subject},{label},{conditions}{format_values(values)}\n"
        try:
            self.stream.write(text.encode())
        except OSError as e:
            raise self._unwritable(e) from e

    def flush(self) -> None:
        """Write what has come to the disk."""
        try:
            self.stream.flush()
        except OSError as e:
            raise self._unwritable(e) from e

    def close(self) -> None:
        """Close the files."""
        try:
            self.stream.close()
        except OSError as e:
            raise self._unwritable(e) from e
        finally:
            self.lock.release()

    def _unwritable(self, error: OSError) -> InputError:
        place = error.filename or self.path
        reason = one_line(error.strerror or error)
        advice = "free space or choose another place, and repeat the command: it continues"
        return InputError(f"{one_line(place, 150)} cannot be written ({reason}); {advice}")


def _end_of_last_line(path: Path) -> int:
    """Bytes of a file up to the end of its last whole line."""
    size = path.stat().st_size
    with open(path, "rb") as file:
        file.seek(max(0, size - TAIL))
        tail = file.read()
    return size - len(tail) + tail.rfind(b"\n") + 1


def format_values(values: np.ndarray) -> str:
    """Readings separated by commas; whole ones without a decimal point."""
    return ",".join(f"{value:.9g}" for value in values.tolist())
