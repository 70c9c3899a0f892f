"""The arrays of a ``.npz`` file."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from bench.corpora.read.archive import opened
from bench.corpora.read.limits import called, check_names, plain
from bench.errors import InputError

_BROKEN = "not a .npz file of plain arrays ({}); save it again, without objects"


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays by name, in the byte order of this machine.

    Raises:
        InputError: a member is no array, holds objects, or is not of the size that its header says.
    """
    arrays = {}
    with opened(path, _BROKEN) as (archive, members), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about headers that Python 2 wrote
        for member in members:
            if not member.filename.endswith(".npy"):
                name = plain(member.filename, 60)
                raise InputError(f"{called(path)}: {name} is not an array; save the file with np.savez")
        check_names([member.filename.removesuffix(".npy") for member in members], called(path))
        for member in members:
            with archive.open(member) as file:
                array = np.lib.format.read_array(file, allow_pickle=False)
                if file.read(1) or not array.dtype.itemsize:
                    raise ValueError(f"{plain(member.filename, 40)} is not of the size that its header says")
            arrays[member.filename.removesuffix(".npy")] = array.astype(array.dtype.newbyteorder("="), copy=False)
    return arrays
