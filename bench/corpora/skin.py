"""A design of the skin: the recorded captures as a smaller skin would measure them.

The order is that of the hardware. Electrodes: readings of taxels that are not wired are left out,
and a merged taxel is the mean of the wired readings that it covers, by area. Readout: a lower rate
is the mean of each period, takes the frame at its beginning, or keeps the largest values, as peak
detectors do. Converter: each of these values is clipped to a range, companded and rounded to a
code. Systems get the decoded codes, in units of the recorded readings, and the recorded full scale.

Nothing is learned, except with ``range=auto``, in each fold from its training captures alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from bench.errors import check_value
from bench.ground.typed import format_value

if TYPE_CHECKING:
    import numpy as np

    from bench.corpora.corpus import Corpus

PARTS = {"design": "bench.corpora.skin:Design"}
MU = 1000.0  # of the logarithmic curve over the full scale, as of ``model.scale=log``
# Code as a share of its largest, and mu of the range, to the share of the range, by curve
CURVES: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "linear": lambda codes, mu: codes,
    "log": lambda codes, mu: ((1 + mu) ** codes - 1) / mu,
    "sqrt": lambda codes, mu: codes**2,
}
SAMPLINGS = ("mean", "pick", "peak")
AUTO, AUTO_QUANTILE = "auto", 0.999  # of the training readings, the upper end of the range
MOST_BITS = 16
# Of full scale, by which a value may miss the middle between two codes and get the upper one. So
# rounding errors of means, which differ between Python and C, decide nothing.
GUARD = 1e-6
MOST_PERIOD = 10**6  # numerator and denominator of a period in frames


@dataclass(frozen=True)
class Design:
    """A smaller skin, made of the recorded one.

    In this order: taxels, grid, rate, range, curve, bits. Values cannot be finer than recorded.

    Args:
        grid: rows and columns, such as 4x4; as recorded without it.
        rate_hz: frames per second; 0 as recorded.
        bits: bits of the converter; 0 for the recorded steps.
        range: readings that the converter spans, such as 0-255; auto learns them in training.
        curve: how codes spread over the range: linear, log (mu-law, with mu 1000 for the
            full scale) or sqrt.
        taxels: numbers of the wired channels, such as 1-8+57-64 for the edges of 8x8; without it,
            all. Rows and columns without any are left out, other unwired taxels read 0.
        sampling: mean of each period, pick for the frame at its beginning, or peak for the largest
            value of each taxel in it.
    """

    grid: str = ""
    rate_hz: float = 0.0
    bits: int = 0
    range: str = ""
    curve: str = "linear"
    taxels: tuple[str, ...] = ()
    sampling: str = "mean"

    def __post_init__(self) -> None:
        is_grid = re.fullmatch(r"([1-9]\d{0,3}x[1-9]\d{0,3})?", self.grid)
        check_value("skin.grid", self.grid, bool(is_grid), "rows and columns, such as 4x4")
        is_rate = 0 <= self.rate_hz < math.inf
        check_value("skin.rate_hz", self.rate_hz, is_rate, "frames per second, such as 27")
        check_value("skin.bits", self.bits, 0 <= self.bits <= MOST_BITS, f"1 to {MOST_BITS}")
        is_range = self.range in ("", AUTO) or self._ends is not None
        check_value("skin.range", self.range, is_range, "two readings, such as 0-255, or auto")
        check_value("skin.curve", self.curve, self.curve in CURVES, " or ".join(CURVES))
        known = self.sampling in SAMPLINGS
        check_value("skin.sampling", self.sampling, known, " or ".join(SAMPLINGS))
        is_list = all(re.fullmatch(r"[1-9]\d{0,6}(-[1-9]\d{0,6})?", word) for word in self.taxels)
        names = "+".join(self.taxels)
        check_value("skin.taxels", names, is_list, "numbers of channels, such as 1-8+57-64")

    @property
    def _ends(self) -> tuple[float, float] | None:
        """The typed ends of the range; None for others."""
        ends = re.fullmatch(r"(\d{1,9}(?:\.\d+)?)-(\d{1,9}(?:\.\d+)?)", self.range)
        low, high = map(float, ends.groups()) if ends else (0.0, 0.0)
        return (low, high) if low < high else None

    def typed_arguments(self) -> dict[str, str]:
        """Write the design as typed; values as recorded are left out."""
        values, recorded = asdict(self), asdict(Design())
        changed = {name: value for name, value in values.items() if value != recorded[name]}
        return {f"skin.{name}": format_value(value) for name, value in changed.items()}

    def convert(self, corpus: Corpus) -> Corpus:
        """Captures as the skin measures them; with ``range=auto``, before the converter.

        Raises:
            InputError: the recorded skin is coarser.
        """
        import numpy as np

        shape, period = self._shape(corpus), self.period(corpus.rate_hz)
        area, lines = self._wired_areas(corpus.grid, shape)
        arrays = [self._merge(frames, area, period)[:, *lines] for frames in corpus]
        made = corpus.with_fields(
            frames=np.concatenate(arrays),
            lengths=np.array([len(frames) for frames in arrays], dtype=np.int64),
            rate_hz=float(corpus.rate_hz / period),
            digest="",
            path=None,
            info=corpus.info | self._facts(corpus, area),
        )
        encoded = self.encode(made)  # which also checks a design whose range is not known yet
        return made if self.range == AUTO else encoded

    def fit_range(self, corpus: Corpus, train: np.ndarray) -> Corpus:
        """Captures of `convert` after the converter, whose range some of them determine.

        Args:
            corpus: captures.
            train: positions of the training captures; with a range that is typed, of no effect.
        """
        import numpy as np

        if self.range != AUTO:
            return corpus
        readings = np.concatenate([corpus[int(i)].ravel() for i in train])
        steps = 2**self.bits - 1 if self.bits else 1  # which are no finer than recorded
        unit = 1.0 if corpus.info["recorded"]["whole"] else corpus.full_scale / 2**MOST_BITS
        least, most = float(readings.min()), float(np.quantile(readings, AUTO_QUANTILE))
        low = min(least // unit, corpus.full_scale // unit - steps)
        high = max(-(-most // unit), low + steps)
        ends = (np.format_float_positional(end * unit, trim="-") for end in (low, high))
        fitted = replace(self, range="-".join(ends))
        design = {"design": asdict(fitted)}
        return fitted.encode(corpus.with_fields(info=corpus.info | design, digest="", path=None))

    def _shape(self, corpus: Corpus) -> tuple[int, int]:
        """Rows and columns of merged taxels."""
        rows, cols = map(int, self.grid.split("x")) if self.grid else corpus.grid
        recorded = "x".join(map(str, corpus.grid))
        is_coarser = rows <= corpus.grid[0] and cols <= corpus.grid[1]
        check_value("skin.grid", self.grid, is_coarser, f"at most the recorded {recorded}")
        return rows, cols

    def _wired_areas(
        self, recorded: tuple[int, int], shape: tuple[int, int]
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Wired share of each merged taxel [rows, cols], and the lines that reach a wired one."""
        import numpy as np

        from bench.corpora.joined import regrid

        area = regrid(self._wired(recorded)[None], *shape)[0]
        return area, np.ix_(area.any(axis=1), area.any(axis=0))

    def weights(self, recorded: tuple[int, int]) -> np.ndarray:
        """Weights that recorded readings have in those of the design [taxels, recorded taxels]."""
        import numpy as np

        single = np.eye(recorded[0] * recorded[1]).reshape(-1, *recorded)
        shape = tuple(map(int, self.grid.split("x"))) if self.grid else recorded
        area, lines = self._wired_areas(recorded, shape)
        return self._merge(single, area, Fraction(1))[:, *lines].reshape(len(single), -1).T

    def period(self, rate_hz: float) -> Fraction:
        """Recorded frames of a frame."""
        if not self.rate_hz:
            return Fraction(1)
        advice = f"at most the recorded {rate_hz:g}"
        check_value("skin.rate_hz", self.rate_hz, self.rate_hz <= rate_hz * (1 + 1e-9), advice)
        period = Fraction(rate_hz) / Fraction(self.rate_hz)
        return max(Fraction(1), period.limit_denominator(MOST_PERIOD))

    def _wired(self, recorded: tuple[int, int]) -> np.ndarray:
        """True for each recorded taxel that is wired [rows, cols]."""
        import numpy as np

        count = recorded[0] * recorded[1]
        is_wired = np.full(count, not self.taxels)
        for word in self.taxels:
            first, _, last = word.partition("-")
            is_known = int(first) <= int(last or first) <= count
            check_value("skin.taxels", word, is_known, f"channels from 1 to {count}")
            is_wired[int(first) - 1 : int(last or first)] = True
        return is_wired.reshape(recorded)

    def _merge(self, frames: np.ndarray, area: np.ndarray, period: Fraction) -> np.ndarray:
        """Frames of merged taxels at the rate of the design, float32 if they are means."""
        import numpy as np

        from bench.corpora.joined import regrid, sum_between

        if self.taxels:
            frames = frames * self._wired(frames.shape[1:])
        if self.grid:
            frames = regrid(frames, *area.shape) / np.where(area > 0, area, 1)
        if period == 1:
            return frames
        count, (over, under) = len(frames), period.as_integer_ratio()
        if self.sampling == "pick":
            return frames[np.arange(-(-count * under // over)) * over // under]
        steps = np.arange(max(1, count * under // over) + 1)
        if self.sampling == "peak":
            first = steps * over // under
            return np.maximum.reduceat(frames[: first[-1]], first[:-1])
        edges = steps * over / under
        edges = np.minimum(edges, count)  # a shorter capture becomes one frame
        return (sum_between(frames.astype(np.float64), edges) / edges[1]).astype(np.float32)

    def _facts(self, corpus: Corpus, area: np.ndarray) -> dict[str, object]:
        """Facts for ``info``: the design, what was recorded, and costs of the skin."""
        from bench.corpora.corpus import shared_frames

        taxels, lines = int((area > 0).sum()), int(area.any(axis=1).sum() + area.any(axis=0).sum())
        recorded = {"digest": corpus.digest, "grid": [*corpus.grid], "rate_hz": corpus.rate_hz}
        recorded["whole"] = shared_frames(corpus)[0].dtype.kind in "iu"
        costs = {"taxels": taxels, "wires": min(lines, taxels + 1)}
        return {"recorded": recorded, "design": asdict(self), "skin_costs": costs}

    def encode(self, corpus: Corpus) -> Corpus:
        """Captures of `convert` after the converter: in decoded codes, whole numbers if they are.

        A design with ``range=auto`` cannot; one of `fit_range` lies in ``info`` of its captures.
        """
        import numpy as np

        info = corpus.info
        thresholds, levels = self.converter(corpus.full_scale, info["recorded"]["whole"])
        bits = len(thresholds).bit_length() or MOST_BITS
        corpus = corpus.with_fields(info=info | {"skin_costs": info["skin_costs"] | {"bits": bits}})
        if not len(levels):
            return corpus
        is_whole = (levels == levels.round()).all() and levels[-1] < 2**16
        levels = levels.astype(np.uint16 if is_whole else np.float32)
        codes = np.searchsorted(thresholds, corpus.frames, side="right")
        return corpus.with_fields(frames=levels[codes])

    def converter(self, full_scale: float, is_whole: bool) -> tuple[np.ndarray, np.ndarray]:
        """Least values of codes 1, 2, ... and the reading that each code stands for, from 0.

        Both are empty if readings pass as they are: decimals, whose steps are unknown.

        Args:
            full_scale: the largest reading.
            is_whole: True for readings in whole numbers; False for decimals.
        """
        import numpy as np

        low, high = self._ends or (0.0, full_scale)
        check_value("skin.range", self.range, high <= full_scale, f"readings to {full_scale:g}")
        steps = 2**self.bits - 1 if self.bits else round(high - low) * is_whole
        most = math.floor(math.log2(high - low + 1)) if is_whole else MOST_BITS
        is_changed = bool(self.range) or self.curve != "linear"
        is_known = self.bits <= most and (steps > 0 or not is_changed)
        advice = f"1 to {most}: no finer steps than recorded from {low:g} to {high:g}"
        check_value("skin.bits", self.bits, is_known, advice)
        if not steps:
            return np.zeros(0), np.zeros(0)
        spread, codes = CURVES[self.curve], np.arange(steps + 1)
        mu = MU * (high - low) / full_scale
        thresholds, levels = (
            low + (high - low) * spread(shares, mu)
            for shares in ((codes[1:] - 0.5) / steps, codes / steps)
        )
        return thresholds - GUARD * full_scale, levels.round(9)


def design_of(facts: Mapping[str, Any]) -> Design | None:
    """The skin in the ``info`` of a corpus, its range learned; None for the recorded one."""
    design = facts.get("design")
    return Design(**design | {"taxels": tuple(design["taxels"])}) if design else None
