"""Detectors of touch in a stream, a file each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.ground.words import Values, items
from touchbench_streams import DETECTOR

if TYPE_CHECKING:
    from bench.plan.cells import Part

PARTS = {
    "frames": "touchbench_streams.detectors.frames:Frames",
    "threshold": "touchbench_streams.detectors.threshold:Threshold",
}


def detectors(values: Values) -> list[Part]:
    """The detectors that ``detector=`` names, the usual one without it, with every combination of their parameters."""
    from bench.plan.cells import variants

    siblings = items("detector", values.get("detector", DETECTOR))
    if not all(isinstance(name, str) for name in siblings):
        raise InputError("detector= takes names; give one of them, or my.py:Mine")
    parts = [
        part
        for name in siblings
        for part in variants(
            values, "detector", name, siblings, room="touchbench_streams.detectors"
        )
    ]
    for part in parts:
        part.make()  # which refuses values
    return parts
