"""A survey of a corpus before training: counts, durations, pressure, broken taxels, duplicates."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.ndimage import convolve

from bench.corpora.corpus import Corpus
from bench.corpora.doubts import Seam, measure_seams
from bench.corpora.duplicates import LEAST_CHANGES, identical_groups, is_quiet
from bench.corpora.sensor import sensor_table
from bench.errors import InputError

ODD_RATIO = 3.0  # of SDs: beyond it, or below its inverse, a taxel differs from its neighbours
MOST_STILL = 1.0  # percent of captures in which a taxel may be the only one that does not vary
MOST_COMBINATIONS = 10  # per capture; nobody meant to record more
VARIES_LESS = "varies far less than its neighbours"
DURATIONS = "seconds of a capture of each gesture"
PRESSURE = (
    "sensor values; full_scale: readings at full scale in percent; "
    "still: captures without any change"
)
SENSOR = (
    "at rest, in counts: level, and noise of a taxel from frame to frame (SD); "
    "repeated: frames like the one before in percent; seconds of a capture (median)"
)
NEIGHBOURS = np.array([[[1, 1, 1], [1, 0, 1], [1, 1, 1]]])  # of a taxel
MOST_LINES = 12  # of a kind that are printed; the tables have all


class Survey:
    """Survey of captures; prints as sentences and short tables, which are its attributes.

    Args:
        corpus: corpus, or some captures of one; repeated ones are measured as often as they occur.

    Attributes:
        gestures: names, in the order of ``means`` and of the tables.

    Raises:
        InputError: there is no capture.
    """

    def __init__(self, corpus: Corpus) -> None:
        if not len(corpus):
            raise InputError(f"{corpus.name} has no captures to show; widen where=")
        self.corpus = corpus
        labels = corpus.captures["gesture"].astype(str).to_numpy(dtype=object)
        gestures, self._code = np.unique(labels, return_inverse=True)
        self.gestures: list[str] = gestures.tolist()
        self.title = repr(corpus).strip("<>") + f", full scale {corpus.full_scale:g}"

    @cached_property
    def factors(self) -> list[str]:
        """Columns that ``counts`` crosses: subject, gesture, and text that repeats."""
        captures, factors = self.corpus.captures, ["subject", "gesture"]
        combinations = captures[factors].nunique().prod()
        texts = captures.drop(columns=[*factors, "split", "captures", "corpus"], errors="ignore")
        for column, levels in texts.select_dtypes(exclude="number").nunique(dropna=False).items():
            if levels > 1 and combinations * levels <= MOST_COMBINATIONS * len(captures):
                factors.append(str(column))
                combinations *= levels
        return factors

    @cached_property
    def counts(self) -> pd.DataFrame:
        """Number of ``captures`` of each combination of the factors, whether recorded or not."""
        words = self.corpus.captures[self.factors].astype(object)
        words = words.where(words.notna(), "").astype(str)
        levels: list[Any] = [  # subject 10 behind subject 9
            sorted(set(words[f]), key=lambda name: (len(name) if name.isdigit() else 0, name))
            for f in self.factors
        ]
        index: Any = pd.MultiIndex.from_product(levels, names=self.factors)
        return words.value_counts().reindex(index, fill_value=0).rename("captures").reset_index()

    @cached_property
    def usual(self) -> int:
        """The most frequent number of captures of a recorded combination."""
        return int(self.counts.loc[self.counts["captures"] > 0, "captures"].mode().iloc[0])

    @property
    def gaps(self) -> pd.DataFrame:
        """Rows of ``counts`` with another number of captures than usual."""
        return self.counts[self.counts["captures"] != self.usual].reset_index(drop=True)

    @property
    def classes(self) -> pd.DataFrame:
        """Captures and subjects of each class of the target."""
        table = pd.DataFrame({"class": self.corpus.gestures, "subject": self.corpus.subjects})
        subjects = table.groupby("class")["subject"]
        return subjects.agg(captures="size", subjects="nunique").reset_index()

    @property
    def _seconds(self) -> np.ndarray:
        return self.corpus.lengths / self.corpus.rate_hz

    @cached_property
    def durations(self) -> pd.DataFrame:
        """Captures, subjects, and median, shortest and longest seconds of each gesture."""
        names = np.array(self.gestures, dtype=object)[self._code]
        by = pd.DataFrame({"subject": self.corpus.subjects, "s": self._seconds}).groupby(names)
        table = by["s"].agg(captures="size", median="median", shortest="min", longest="max")
        table.insert(1, "subjects", by["subject"].nunique())
        return table.rename_axis("gesture").reset_index()

    def _by_gesture(self, values: np.ndarray) -> Any:
        return pd.DataFrame(values).groupby(self._code)

    @cached_property
    def means(self) -> np.ndarray:
        """Mean pressure over the frames of each gesture, float64 [gestures, rows, cols]."""
        frames = np.bincount(self._code, self.corpus.lengths)
        sums = self._by_gesture(self._statistics["sum"]).sum().to_numpy()
        return (sums / frames[:, None]).reshape(-1, *self.corpus.grid)

    @cached_property
    def pressure(self) -> pd.DataFrame:
        """Lowest, mean and highest reading of each gesture, percent of readings at full scale.

        ``still`` is the number of captures in which nothing varies.
        """
        lowest, highest = self._statistics["lowest"], self._statistics["highest"]
        full = self._statistics["full_scale"]
        readings = np.bincount(self._code, self.corpus.lengths) * lowest.shape[1]
        table = {
            "gesture": self.gestures,
            "lowest": self._by_gesture(lowest.min(axis=1)).min()[0],
            "mean": self.means.mean(axis=(1, 2)),
            "highest": self._by_gesture(highest.max(axis=1)).max()[0],
            "full_scale": 100 * self._by_gesture(full.sum(axis=1)).sum()[0] / readings,
            "still": self._by_gesture((lowest == highest).all(axis=1)).sum()[0],
        }
        return pd.DataFrame(table)

    @cached_property
    def sensor(self) -> pd.DataFrame:
        """The sensor at rest in each session (`sensor_table`)."""
        return sensor_table(self.corpus)

    @cached_property
    def typical(self) -> dict[str, int]:
        """Capture nearest to the middle in duration, mean and highest pressure, by gesture."""
        mean = self._statistics["sum"].sum(axis=1) / self.corpus.lengths
        highest = self._statistics["highest"].max(axis=1)
        ranks = self._by_gesture(np.stack([self._seconds, mean, highest], axis=1)).rank()
        middle = (1 + np.bincount(self._code)[self._code]) / 2
        nearest = ranks.sub(middle, axis=0).abs().sum(axis=1).groupby(self._code).idxmin()
        return {g: int(self.corpus.index[i]) for g, i in zip(self.gestures, nearest, strict=True)}

    @cached_property
    def taxels(self) -> pd.DataFrame:
        """Readings of each taxel, row by row, and a ``verdict``, empty where nothing is odd.

        ``full_scale`` is the percent of frames at full scale; ``sd`` is around the mean of each
        capture; ``around`` is the median SD of those of the up to eight neighbours that vary;
        ``still`` is the percent of captures in which a taxel does not vary while all of its
        neighbours do.
        """
        lowest, highest = self._statistics["lowest"], self._statistics["highest"]
        grid, frames = self.corpus.grid, self.corpus.lengths.sum()
        row, col = np.indices(grid).reshape(2, -1)
        sd = np.sqrt(self._statistics["squares"].sum(axis=0) / frames)
        table = pd.DataFrame(
            {
                "row": row,
                "col": col,
                "lowest": lowest.min(axis=0),
                "mean": self._statistics["sum"].sum(axis=0) / frames,
                "highest": highest.max(axis=0),
                "full_scale": 100 * self._statistics["full_scale"].sum(axis=0) / frames,
                "sd": sd,
            }
        )
        constant = lowest == highest
        several = self.corpus.lengths > 1  # a single frame shows no change
        never = table["lowest"] == table["highest"]
        if several.any():
            never = pd.Series(constant[several].all(axis=0))
        table["around"] = around = _median_of_neighbours(np.where(never, np.nan, sd).reshape(grid))
        constant_grids = constant.reshape(-1, *grid).astype(np.uint8)
        neighbours = convolve(constant_grids, NEIGHBOURS, mode="constant").reshape(constant.shape)
        alone = constant & (neighbours == 0) & (grid != (1, 1))
        table["still"] = 100 * alone[several].sum(axis=0) / max(1, several.sum())
        verdicts = {
            "always at full scale": table["lowest"] >= self.corpus.full_scale,
            "never varies": table["lowest"] == table["highest"],
            "never varies within a capture": never,
            "often constant while its neighbours vary": table["still"] > MOST_STILL,
            VARIES_LESS: ODD_RATIO * sd < around,
            "varies far more than its neighbours": sd > ODD_RATIO * around,
        }
        return table.assign(verdict=np.select([*verdicts.values()], [*verdicts], ""))

    @property
    def odd_taxels(self) -> pd.DataFrame:
        """Rows of ``taxels`` with a verdict."""
        return self.taxels[self.taxels["verdict"] != ""].reset_index(drop=True)

    @cached_property
    def seams(self) -> list[Seam]:
        """How well neighbouring rows and columns fit."""
        return measure_seams(self.corpus)

    @cached_property
    def duplicates(self) -> pd.DataFrame:
        """Captures with the same frames as another one.

        Columns are their group, labels, and the names of columns that differ within the group.
        ``quiet`` is True if so little changes that they can be equal by chance; these come last.
        """
        corpus, own = self.corpus, ["capture", "group", "differs", "quiet"]
        labels = corpus.captures.drop(columns=own, errors="ignore")
        parts = [labels[:0].assign(group=0, capture=0, differs="", quiet=False)]
        groups = sorted((is_quiet(corpus[group[0]]), group) for group in identical_groups(corpus))
        for number, (quiet, group) in enumerate(groups, start=1):
            rows, captures = labels.iloc[group], corpus.index[group]
            differs = ", ".join(labels.columns[rows.nunique(dropna=False) > 1])
            parts.append(rows.assign(group=number, capture=captures, differs=differs, quiet=quiet))
        table = pd.concat(parts)[["group", "capture", *labels, "differs", "quiet"]]
        return table.sort_values(["group", "capture"], kind="stable", ignore_index=True)

    @cached_property
    def _statistics(self) -> dict[str, np.ndarray]:
        """Statistics of the readings, each [captures, taxels]; ``squares`` are around the mean."""
        parts = []
        for capture in self.corpus:
            frames = capture.reshape(len(capture), -1)
            parts.append(
                {
                    "lowest": frames.min(axis=0),
                    "highest": frames.max(axis=0),
                    "sum": frames.sum(axis=0, dtype=np.float64),
                    "full_scale": (frames >= self.corpus.full_scale).sum(axis=0),
                    "squares": len(frames) * frames.var(axis=0, dtype=np.float64),
                }
            )
        return {name: np.stack([part[name] for part in parts]) for name in parts[0]}

    def __str__(self) -> str:
        target = self.corpus.target
        parts = [[self.title]]
        if self.corpus.synthetic:
            parts[0].append("synthetic: generated captures, not people")
        if target != "gesture":
            parts.append([f"Classes of target={target}:", _format_table(self.classes)])
        parts += [
            [f"Durations: {DURATIONS}", _format_table(self.durations)],
            [f"Pressure: {PRESSURE}", _format_table(self.pressure)],
            [f"Sensor: {SENSOR}", _format_table(self.sensor)],
            self.gap_lines(),
            self.taxel_lines(),
            [str(seam) for seam in self.seams],
            self.duplicate_lines(),
        ]
        return "\n\n".join("\n".join(part) for part in parts if part)

    __repr__ = __str__

    def gap_lines(self) -> list[str]:
        """A sentence on the balance of the counts, and the first gaps."""
        counts, factors = self.counts, ", ".join(self.factors[:-1])
        absent = counts["captures"] == 0
        other = ~counts["captures"].isin([0, self.usual])
        summary = (
            f"Gaps: of {len(counts)} combinations of {factors} and {self.factors[-1]}, "
            f"{len(counts) - absent.sum() - other.sum()} have {_format_captures(self.usual)}, "
            f"{other.sum()} have another number, {absent.sum()} have none"
        )
        # A gesture that a subject never did is one gap, not one for each condition.
        pair = ["subject", "gesture"]
        never = counts.groupby(pair, sort=False)["captures"].transform("sum") == 0
        gaps = counts.loc[never, [*pair, "captures"]].drop_duplicates(pair).to_dict("records")
        gaps += counts[(absent | other) & ~never].to_dict("records")
        numbers = [_format_captures(gap.pop("captures")) for gap in gaps]
        lines = [f"{_format_row(gap)}: {n}" for gap, n in zip(gaps, numbers, strict=True)]
        return [summary, *_first_lines(lines)]

    def taxel_lines(self) -> list[str]:
        """A sentence on odd taxels, and the first of them."""
        odd = self.odd_taxels
        if not len(odd):
            return [f"Taxels: none of {len(self.taxels)} is odd"]
        lines = [
            f"row {t['row']}, col {t['col']}: {t['verdict']} (SD {t['sd']:.3g}, neighbours "
            f"{t['around']:.3g}; readings {t['lowest']:g} to {t['highest']:g}; alone constant in "
            f"{t['still']:.3g} % of captures)"
            for t in odd.to_dict("records")
        ]
        summary = f"Taxels: {len(odd)} of {len(self.taxels)} odd; rows and columns from 0"
        if odd["verdict"].isin([VARIES_LESS]).any():
            summary += "; a taxel that varies far less may be broken or seldom touched"
        return [summary, *_first_lines(lines)]

    def duplicate_lines(self) -> list[str]:
        """A sentence on duplicate captures, and the first groups."""
        if not len(self.duplicates):
            return ["Duplicates: none; no two captures have the same frames"]
        lines = []
        for _, group in self.duplicates.groupby("group"):
            rows = group.drop(columns=["group", "differs", "quiet"]).to_dict("records")
            more = f" and {len(rows) - 2} more" if len(rows) > 2 else ""
            lines.append(" = ".join(map(_format_row, rows[:2])) + more)
        firsts = self.duplicates.drop_duplicates("group")
        several = firsts["differs"].str.contains(r"\b(?:subject|gesture)\b").sum()
        summary = (
            f"Duplicates: {len(self.duplicates)} captures have the same frames as another one, "
            f"in {len(firsts)} groups; {several} of them under several subjects or gestures"
        )
        if quiet := firsts["quiet"].sum():
            reason = f"fewer than {LEAST_CHANGES} readings change"
            summary += f"; {quiet} may be equal by chance: {reason}"
        return [summary, *_first_lines(lines)]

    def repeat_warnings(self) -> list[str]:
        """A warning if one recording is in the corpus twice, not if equal by chance."""
        if self.duplicates["quiet"].all():
            return []
        return [". ".join(map(str.strip, self.duplicate_lines()[:2]))]


def _median_of_neighbours(values: np.ndarray) -> np.ndarray:
    """Median over the neighbours of each taxel that are not NaN [taxels]; NaN if there is none."""
    padded = np.pad(values, 1, constant_values=np.nan)
    blocks = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).reshape(-1, 9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about NaN, with which comparisons are false
        return np.nanmedian(np.delete(blocks, 4, axis=1), axis=1)


def _format_table(table: pd.DataFrame) -> str:
    return table.to_string(index=False, float_format=lambda value: f"{value:.4g}")


def _format_captures(count: int) -> str:
    return "none" if not count else f"{count} capture{'' if count == 1 else 's'}"


def _format_row(row: dict) -> str:
    """A row of a table in words."""
    return ", ".join(f"{name} {value}" for name, value in row.items())


def _first_lines(lines: list[str]) -> list[str]:
    """The lines that are printed, indented, and how many more there are."""
    more = [f"... and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
    return [f"  {line}" for line in [*lines[:MOST_LINES], *more]]
