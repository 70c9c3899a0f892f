"""C that makes frames of a designed skin from those of the recorded one."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bench.corpora.skin import SAMPLINGS, Design
from bench.errors import InputError
from touchbench_chip.classifiers import format_float

if TYPE_CHECKING:
    from bench.running.saved import Recogniser

CODE = Path(__file__).parent / "code"
MOST_CURVED = 2**12  # codes of a curve, which lie in tables


class SkinContents(NamedTuple):
    """What the C of a design consists of: part of the header, constants and tables."""

    header: str
    defines: dict[str, Any]
    arrays: dict[str, np.ndarray]


def convert_design(recogniser: Recogniser) -> SkinContents | None:
    """Convert the design of a saved system; None for one that was fitted to the recorded skin.

    Raises:
        InputError: the converter has too many codes of a curve.
    """
    if not recogniser.skin:
        return None
    design, recorded = recogniser.design, recogniser.skin["recorded"]
    weights = design.weights(tuple(recorded["grid"])).astype(np.float32)
    period, full_scale = design.period(recorded["rate_hz"]), recogniser.full_scale
    thresholds, levels = design.converter(full_scale, recorded["whole"])
    is_curved = design.curve != "linear"
    if is_curved and len(levels) > MOST_CURVED:
        raise InputError(f"skin.curve={design.curve} has C with 12 bits at most; give skin.bits=12")
    taxels = [np.flatnonzero(row) for row in weights]
    defines = {name.upper(): i for i, name in enumerate(SAMPLINGS)}
    defines |= {"SAMPLING": SAMPLINGS.index(design.sampling), "CURVED": int(is_curved)}
    defines |= {"PERIOD": period.numerator, "OF_FRAME": period.denominator}
    first = (thresholds[0], levels[0], levels[1] - levels[0]) if len(levels) else (0, 0, 0)
    names = ("FIRST_VALUE", "FIRST_READING", "CODE_STEP")
    defines |= {name: format_float(value) for name, value in zip(names, first, strict=True)}
    arrays = {
        "reading_ends": np.cumsum([len(each) for each in taxels]).astype(np.int32),
        "reading_taxels": np.concatenate(taxels).astype(np.int32),
        "reading_weights": weights[weights > 0],
    }
    if is_curved:
        arrays |= {"code_values": thresholds.astype(np.float32)}
        arrays |= {"code_readings": levels.astype(np.float32)}
    words = {
        "grid": "x".join(map(str, recorded["grid"])),
        "rate": f"{recorded['rate_hz']:g}",
        "readings": "\n".join(_reading_lines(weights)),
        "frames": _frames_sentence(period, design.sampling),
        "codes": _codes_sentence(design, levels),
        "recorded": str(weights.shape[1]),
        "count": str(len(levels)),
        "taxels": str(len(weights)),
    }
    template = Template((CODE / "skin.h").read_text(encoding="utf-8"))
    return SkinContents(template.substitute(words), defines, arrays)


def _reading_lines(weights: np.ndarray) -> list[str]:
    """A line for each reading: the recorded taxels that it is the mean of, then those skipped."""
    lines = []
    for i, row in enumerate(weights):
        places = np.flatnonzero(row)
        is_even = np.allclose(row[places], 1 / max(1, len(places)))
        words = [
            f"{place + 1}" if is_even else f"{row[place]:.3g} x {place + 1}" for place in places
        ]
        lines.append(f"   frame[{i}]: {', '.join(words) or 'none, without pressure'}")
    skipped = np.flatnonzero(~weights.any(axis=0)) + 1
    return [*lines, f"   skipped: {', '.join(map(str, skipped)) or 'none'}."]


def _frames_sentence(period: Fraction, sampling: str) -> str:
    """How many recorded frames become one."""
    if period == 1:
        return "Each recorded frame becomes a frame."
    count = f"{float(period):.6g} recorded frames"
    return {
        "mean": f"A frame is the mean of {count}, in which parts of a frame count as such.",
        "pick": f"Of {count}, the first is taken and the others are skipped.",
        "peak": f"A frame has the largest value of each reading in {count}.",
    }[sampling]


def _codes_sentence(design: Design, levels: np.ndarray) -> str:
    """What the codes of the converter stand for."""
    if not len(levels):
        return "Readings are not rounded."
    ends = f"{levels[0]:g} to {levels[-1]:g}"
    return f"Codes 0 to {len(levels) - 1} stand for readings of {ends}, {design.curve}."
