"""Detectors of touch in a stream, a file each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.ground.typed import Values, split_values
from touchbench_streams import DETECTOR

if TYPE_CHECKING:
    from bench.plan.cells import Part

PARTS = {
    "frames": "touchbench_streams.detectors.frames:Frames",
    "threshold": "touchbench_streams.detectors.threshold:Threshold",
}


def values_of_detector(values: Values) -> Values:
    """The typed values of ``detector`` and its parameters."""
    return {key: value for key, value in values.items() if key.partition(".")[0] == "detector"}


def parse_detectors(values: Values) -> list[Part]:
    """The detectors of ``detector=``, with every combination of their parameters.

    Without the key it is the default one.
    """
    from bench.plan.grid import make_part_variants

    siblings = split_values("detector", values.get("detector", DETECTOR))
    if not all(isinstance(name, str) for name in siblings):
        raise InputError("detector= takes names; give one of them, or my.py:Mine")
    parts = [
        part
        for name in siblings
        for part in make_part_variants(
            values, "detector", name, siblings, group="touchbench_streams.detectors"
        )
    ]
    for part in parts:
        part.make_object()  # which refuses values
    return parts
