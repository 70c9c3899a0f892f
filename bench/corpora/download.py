"""Downloads of published corpora, continued where the connection broke."""

from __future__ import annotations

import os
import time
from pathlib import Path

import requests
from filelock import FileLock, Timeout
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

from bench.corpora.sources import Source
from bench.errors import InputError, one_line
from bench.ground.progress import console
from bench.ground.scratch import data_folder

TRIES = 4  # of a connection that breaks off or a server that is busy
PAUSE = 2  # seconds before the second try, then twice as long each time
LONGEST_PAUSE = 60  # seconds that a server may ask for
TIMEOUT = (15, 60)  # seconds to connect, and between two pieces
CHUNK = 1 << 16  # bytes; what a broken connection loses
BUSY = (429, 500, 502, 503, 504)
TOO_FAR = 416  # the part that has arrived is as long as the file, or longer


class UnansweredError(Exception):
    """A server gave no file; the message says why, and what to do by hand is added to it."""


def download_source(source: Source, name: str, address: str = "") -> Path:
    """Download the file of a corpus into the data folder.

    A part that an earlier command left is continued if the server has the same file and can. A
    whole file is taken as it is.

    Args:
        source: what to download.
        name: name of the corpus.
        address: of the file, in place of the published one.

    Returns:
        The file, which the caller removes.

    Raises:
        InputError: the server does not answer or has no such file, or the disk is full.
    """
    folder = data_folder() / "downloads"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder / f"{name}.lock", timeout=0):
            if not (file := folder / source.file).exists():
                _download_patiently(address or _find_address(source), file)
            return file
    except Timeout as e:
        raise InputError(f"another download of {name} is under way; wait for it") from e
    except UnansweredError as e:
        raise InputError(f"{name}: {e}; {advise_by_hand(source, name)}") from e
    except OSError as e:
        reason = one_line(e.strerror or e)
        advice = "set TOUCHBENCH_HOME to a folder that can"
        raise InputError(f"{one_line(folder, 150)} cannot be written ({reason}); {advice}") from e


def advise_by_hand(source: Source, name: str) -> str:
    """Say how to get a corpus without a download."""
    command = f'bench data import {name} "{source.file}"'
    return f"get {source.file} by hand from {source.page} and run: {command}; or give address="


def _find_address(source: Source) -> str:
    """The address of a file, which a repository may have to be asked for."""
    if not source.is_listing:
        return source.address
    try:
        with _ask(source.address, {}) as answer:
            listed = answer.json()
        files = {file["name"]: file["download_url"] for file in listed}
        return files[source.file]
    except (ValueError, TypeError, KeyError) as e:
        raise UnansweredError(f"{source.address} lists no {source.file}") from e


def _download_patiently(address: str, file: Path) -> None:
    """Download a file; try again if the connection breaks off."""
    part, mark = file.with_name(f"{file.name}.part"), file.with_name(f"{file.name}.mark")
    for trial in range(1, TRIES + 1):
        try:
            _download_rest(address, part, mark)
            break
        except requests.RequestException as e:
            if trial == TRIES:
                kept = " (the part that has arrived is kept)" if part.exists() else ""
                raise UnansweredError(f"{address} broke off: {_reason(e)}{kept}") from e
            time.sleep(PAUSE << (trial - 1))
        except KeyboardInterrupt as e:
            raise KeyboardInterrupt("interrupted; the same command continues the download") from e
    os.replace(part, file)
    mark.unlink(missing_ok=True)


def _download_rest(address: str, part: Path, mark: Path) -> None:
    """Download what is missing of a file, or all of it if the server has another one by now.

    Args:
        address: of the file.
        part: what has arrived.
        mark: file with the server's mark of the version of ``part``.
    """
    headers = {"Accept-Encoding": "identity"}  # a part of a packed answer is of no use
    arrived = part.stat().st_size if part.exists() else 0
    if arrived and mark.exists():
        headers |= {"Range": f"bytes={arrived}-", "If-Range": mark.read_text()}
    with _ask(address, headers) as answer:
        if answer.status_code == TOO_FAR:
            part.unlink(missing_ok=True)
            raise requests.ConnectionError("the part that has arrived does not fit")
        begin = f"bytes {arrived}-"
        is_rest = answer.status_code == 206 and begin in answer.headers.get("Content-Range", "")
        if not is_rest:
            arrived = 0
        _write_mark(answer, mark)
        rest = int(answer.headers.get("Content-Length") or 0)
        columns = TextColumn("{task.description}"), BarColumn(), DownloadColumn()
        with (
            Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as progress,
            open(part, "ab" if is_rest else "wb") as file,
        ):
            total = arrived + rest if rest else None
            task = progress.add_task(part.stem, total=total, completed=arrived)
            for piece in answer.iter_content(CHUNK):
                progress.advance(task, file.write(piece))


def _write_mark(answer: requests.Response, mark: Path) -> None:
    """Store the mark of the version that a server gives; without one, no part can be continued."""
    tag = answer.headers.get("ETag", "")
    version = tag if tag and not tag.startswith("W/") else answer.headers.get("Last-Modified", "")
    if version:
        mark.write_text(version)
    else:
        mark.unlink(missing_ok=True)


def _ask(address: str, headers: dict[str, str]) -> requests.Response:
    """Open an address; wait while its server is busy.

    Raises:
        UnansweredError: no server can be reached there, or it refuses.
    """
    for trial in range(1, TRIES + 1):
        try:
            answer = requests.get(address, headers=headers, stream=True, timeout=TIMEOUT)
        except requests.RequestException as e:
            raise UnansweredError(f"{address} cannot be reached: {_reason(e)}") from e
        if answer.ok or answer.status_code == TOO_FAR:
            return answer
        answer.close()
        asked = answer.headers.get("Retry-After", "")
        pause = int(asked) if asked.isdecimal() else PAUSE << (trial - 1)
        if answer.status_code not in BUSY or trial == TRIES or pause > LONGEST_PAUSE:
            break
        time.sleep(pause)
    later = ", and asks to come back later" if answer.status_code == 429 else ""
    raise UnansweredError(f"{address} answers {answer.status_code} {answer.reason}{later}")


def _reason(error: Exception) -> str:
    """The innermost cause of an error of the network, in one line."""
    while error.__cause__ or error.__context__:
        error = error.__cause__ or error.__context__
    return one_line(getattr(error, "strerror", None) or error, 100)
