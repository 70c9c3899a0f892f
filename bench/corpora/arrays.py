"""The arrays of a ``.npz`` file, whose headers are compared with what is there before memory is asked for."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipInfo

import numpy as np

from bench.corpora.limits import called, check_names, plain, quoted, size
from bench.corpora.packed import Archive
from bench.errors import InputError

_LONGEST_HEADER = 1 << 16  # bytes; NumPy reads none above 10 000
_BROKEN = "not a .npz file of plain arrays ({}); save it again, without objects"


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays by name, in the byte order of this machine.

    Raises:
        InputError: a member is no array, holds objects, or is not of the size that its header says.
    """
    with Archive(path, _BROKEN) as archive:
        for member in archive.members:
            if not member.filename.endswith(".npy"):
                name = plain(member.filename, 60)
                raise InputError(f"{called(path)}: {name} is not an array; save the file with np.savez")
        names = [member.filename.removesuffix(".npy") for member in archive.members]
        check_names(names, called(path))
        return {n: _array(archive, member, n) for n, member in zip(names, archive.members, strict=True)}


def _array(archive: Archive, member: ZipInfo, name: str) -> np.ndarray:
    parts = archive.content(member)
    try:
        first = _beginning(parts)
        shape, fortran, dtype, begin = _header(first)
        if dtype.hasobject or not dtype.itemsize:
            raise ValueError(f"{quoted(name)} holds {'objects' if dtype.hasobject else 'nothing'}")
        needed, there = math.prod(shape) * dtype.itemsize, member.file_size - begin
    except InputError:
        raise
    except Exception as e:  # a header is a Python literal, which can be broken in many ways
        raise InputError(f"{called(archive.path)}: {_BROKEN.format(plain(e))}") from e
    if needed != there:
        raise InputError(
            f"{called(archive.path)}: {plain(name, 60)} says that it holds {size(needed)}, {size(there)} are there; "
            "save it again"
        )
    data = np.empty(needed, np.uint8)
    at = 0
    for part in _from(first[begin:], parts):
        data[at : at + len(part)] = np.frombuffer(part, np.uint8)
        at += len(part)
    if dtype.kind == "b":
        data = (data != 0).view(np.uint8)  # a byte that is neither 0 nor 1 is no truth value
    array = np.ndarray(shape, dtype, data, order="F" if fortran else "C")
    return array.astype(dtype.newbyteorder("="), copy=False)


def _beginning(parts: Iterator[bytes]) -> bytes:
    """As much as holds any header."""
    found = b""
    for part in parts:
        found += part
        if len(found) > _LONGEST_HEADER:
            break
    return found


def _from(first: bytes, others: Iterator[bytes]) -> Iterator[bytes]:
    yield first
    yield from others


def _header(content: bytes) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """Shape, order, type and where the values begin."""
    f = io.BytesIO(content)
    version = np.lib.format.read_magic(f)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"version {version[0]}.{version[1]} of the array format")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about headers that Python 2 wrote
        shape, fortran, dtype = readers[version](f)
    if any(n < 0 for n in shape):
        raise ValueError(f"a shape of {shape}")
    return shape, fortran, dtype, f.tell()
