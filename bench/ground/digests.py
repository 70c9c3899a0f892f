"""Digests of the files that we write, checked where they are read: damage is never read as data.

Each writer has its reader beside it, which raises a `DamagedFile` for a file that differs from what
was written. This finds damage and accidental changes, not forgery.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, BinaryIO


class DamagedFile(ValueError):
    """A file differs from what was written; the message has no name of the file."""


DIGITS = 64  # of a SHA-256
KEY = "sha256"  # of a JSON object, for the digest of its other values
FOLDER_FILE = "sha256.json"  # in a folder, with the digests of its other files
PARQUET_END = 8  # bytes after the footer of a parquet file: its length, and "PAR1"


def append_digest(content: bytes) -> bytes:
    """Append the digest of some bytes."""
    return content + _digest(content)


def split_digest(content: bytes) -> bytes:
    """Return the bytes that `append_digest` was given."""
    if content[-DIGITS:] != _digest(content[:-DIGITS]):
        raise DamagedFile("it differs from what was written")
    return content[:-DIGITS]


def write_parquet_with_digest(content: bytes | memoryview, file: BinaryIO) -> None:
    """Write the content of a parquet file with a digest before its footer, where readers skip it.

    The content is not copied, as it may be large.
    """
    with memoryview(content) as view:
        footer = _footer_start(view)
        for part in (view[:footer], _digest(view), view[footer:]):
            file.write(part)


def check_parquet(content: bytes | memoryview) -> None:
    """Check the content that `write_parquet_with_digest` has written; it is not copied."""
    with memoryview(content) as view:
        footer = _footer_start(view)
        start = max(0, footer - DIGITS)
        if view[start:footer] != _digest(view[:start], view[footer:]):
            raise DamagedFile("it differs from what was written")


def _footer_start(content: memoryview) -> int:
    length = int.from_bytes(content[-PARQUET_END:][:4], "little")
    return max(0, len(content) - PARQUET_END - length)


def json_with_digest(text: str) -> str:
    """Add the digest of its values to the text of a JSON object; white space may change."""
    return f'{{"{KEY}": "{_json_digest(json.loads(text))}", {text[1:].lstrip()}'


def read_json_with_digest(path: Path) -> dict[str, Any]:
    """Read the values of a file that `json_with_digest` has made."""
    try:
        values = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as e:
        raise DamagedFile("it is no JSON") from e
    if not isinstance(values, dict) or values.pop(KEY, None) != _json_digest(values):
        raise DamagedFile("it differs from what was written")
    return values


def write_folder_digest(folder: Path, file: Path | None = None) -> None:
    """Write the digests of all files of a folder, to a file in the folder or to another one."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    digests = {path.relative_to(folder).as_posix(): _file_digest(path) for path in paths}
    text = json_with_digest(json.dumps({"files": digests}, indent=1))
    (file or folder / FOLDER_FILE).write_text(text)


def check_folder(folder: Path) -> None:
    """Check the files that `write_folder_digest` found; later ones may lie beside them."""
    try:
        digests = read_json_with_digest(folder / FOLDER_FILE)["files"]
    except (OSError, DamagedFile) as e:
        raise DamagedFile(f"{FOLDER_FILE} is missing or differs from what was written") from e
    for name, digest in digests.items():
        if not (folder / name).is_file() or _file_digest(folder / name) != digest:
            raise DamagedFile(f"{name} is missing or differs from what was written")


def _file_digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digest(*parts: bytes | memoryview) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest().encode()


def _json_digest(values: object) -> str:
    return _digest(json.dumps(values, sort_keys=True).encode()).decode()
