"""A survey of a corpus before any training: counts and gaps, durations, pressure, broken taxels, duplicates."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.ndimage import convolve

from bench.corpora.corpus import Corpus
from bench.corpora.doubts import Seam, measure_seams
from bench.corpora.duplicates import CHANGES, identical_groups, is_quiet
from bench.errors import InputError

ODD = 3.0  # times more, or less, than the taxels around it: such a taxel is suspicious
ALONE = 1.0  # percent of captures in which it alone does not vary: beyond it, a taxel is suspicious
CROSSED = 10  # combinations for each capture, beyond which nobody meant to record them all
LESS = "varies far less than its neighbours"
DURATIONS = "seconds of a capture of each gesture"
PRESSURE = "sensor values; full_scale: readings at full scale in percent; still: captures without any change"
AROUND = np.array([[[1, 1, 1], [1, 0, 1], [1, 1, 1]]])  # of a taxel, the eight next to it
NAMED = 12  # of a kind that are named in print; the tables have all


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
        """Columns that ``counts`` crosses: subject, gesture, and columns of text that repeat, without ``split``."""
        captures, factors = self.corpus.captures, ["subject", "gesture"]
        combinations = captures[factors].nunique().prod()
        texts = captures.drop(columns=[*factors, "split", "captures", "corpus"], errors="ignore")
        for column, several in texts.select_dtypes(exclude="number").nunique(dropna=False).items():
            if several > 1 and combinations * several <= CROSSED * len(captures):
                factors.append(str(column))
                combinations *= several
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
        every: Any = pd.MultiIndex.from_product(levels, names=self.factors)
        return words.value_counts().reindex(every, fill_value=0).rename("captures").reset_index()

    @cached_property
    def usual(self) -> int:
        """The commonest number of captures of a combination, of those that were recorded."""
        return int(self.counts.loc[self.counts["captures"] > 0, "captures"].mode().iloc[0])

    @property
    def gaps(self) -> pd.DataFrame:
        """Rows of ``counts`` that have another number of captures than most: none, fewer or more."""
        return self.counts[self.counts["captures"] != self.usual].reset_index(drop=True)

    @property
    def classes(self) -> pd.DataFrame:
        """Captures and subjects of each class of the target."""
        labelled = pd.DataFrame({"class": self.corpus.gestures, "subject": self.corpus.subjects})
        return (
            labelled.groupby("class")["subject"]
            .agg(captures="size", subjects="nunique")
            .reset_index()
        )

    @property
    def _seconds(self) -> np.ndarray:
        return self.corpus.lengths / self.corpus.rate_hz

    @cached_property
    def durations(self) -> pd.DataFrame:
        """Captures, subjects, and median, shortest and longest seconds of each gesture."""
        names = np.array(self.gestures, dtype=object)[self._code]
        of = pd.DataFrame(
            {"gesture": names, "subject": self.corpus.subjects, "s": self._seconds}
        ).groupby("gesture")
        seconds = of["s"].agg(captures="size", median="median", shortest="min", longest="max")
        seconds.insert(1, "subjects", of["subject"].nunique())
        return seconds.reset_index()

    def _by_gesture(self, values: np.ndarray) -> Any:
        return pd.DataFrame(values).groupby(self._code)

    @cached_property
    def means(self) -> np.ndarray:
        """Mean pressure of each gesture, each frame counted once, float64 [gestures, rows, cols]."""
        frames = np.bincount(self._code, self.corpus.lengths)
        return (self._by_gesture(self._read[2]).sum().to_numpy() / frames[:, None]).reshape(
            -1, *self.corpus.grid
        )

    @cached_property
    def pressure(self) -> pd.DataFrame:
        """Sensor values of each gesture: lowest, mean and highest reading, percent of readings at full scale.

        ``still`` are captures in which nothing varies.
        """
        lowest, highest, _, full, _ = self._read
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
    def typical(self) -> dict[str, int]:
        """Capture nearest to the middle in duration, mean and highest pressure, by gesture."""
        mean = self._read[2].sum(axis=1) / self.corpus.lengths
        ranks = self._by_gesture(
            np.stack([self._seconds, mean, self._read[1].max(axis=1)], axis=1)
        ).rank()
        middle = (1 + np.bincount(self._code)[self._code]) / 2
        nearest = ranks.sub(middle, axis=0).abs().sum(axis=1).groupby(self._code).idxmin()
        return {g: int(self.corpus.index[i]) for g, i in zip(self.gestures, nearest, strict=True)}

    @cached_property
    def taxels(self) -> pd.DataFrame:
        """Readings of each taxel, row by row, and a ``verdict``, empty where nothing is odd.

        ``full_scale`` is the percent of frames at full scale; ``sd`` is around the mean of each capture; ``around`` is
        the median SD of the up to eight taxels around it that do vary; ``still`` is the percent of captures in which it
        does not vary while all of those around it do.
        """
        (lowest, highest, sums, full, squares), grid = self._read, self.corpus.grid
        constant, several = (
            lowest == highest,
            self.corpus.lengths > 1,
        )  # a single frame shows no change
        frames = self.corpus.lengths.sum()
        row, col = np.indices(grid).reshape(2, -1)
        table = pd.DataFrame(
            {
                "row": row,
                "col": col,
                "lowest": lowest.min(axis=0),
                "mean": sums.sum(axis=0) / frames,
            }
        )
        table = table.assign(
            highest=highest.max(axis=0), full_scale=100 * full.sum(axis=0) / frames
        )
        table["sd"] = sd = np.sqrt(squares.sum(axis=0) / frames)
        never = (
            constant[several].all(axis=0) if several.any() else table["lowest"] == table["highest"]
        )
        edged = np.pad(np.where(never, np.nan, sd).reshape(grid), 1, constant_values=np.nan)
        near = np.delete(
            np.lib.stride_tricks.sliding_window_view(edged, (3, 3)).reshape(-1, 9), 4, axis=1
        )
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # nan where nothing around varies, and comparisons with it are false
            table["around"] = median = np.nanmedian(near, axis=1)
        beside = convolve(
            constant.reshape(-1, *grid).astype(np.uint8), AROUND, mode="constant"
        ).reshape(constant.shape)
        alone = constant & (beside == 0) & (grid != (1, 1))
        table["still"] = 100 * alone[several].sum(axis=0) / max(1, several.sum())
        verdicts = {
            "always at full scale": table["lowest"] >= self.corpus.full_scale,
            "never varies": table["lowest"] == table["highest"],
            "never varies within a capture": never,
            "often constant while its neighbours vary": table["still"] > ALONE,
            LESS: ODD * sd < median,
            "varies far more than its neighbours": sd > ODD * median,
        }
        return table.assign(verdict=np.select([*verdicts.values()], [*verdicts], ""))

    @property
    def odd_taxels(self) -> pd.DataFrame:
        """Rows of ``taxels`` with a verdict."""
        return self.taxels[self.taxels["verdict"] != ""].reset_index(drop=True)

    @cached_property
    def seams(self) -> list[Seam]:
        """Fit of neighbouring rows and columns."""
        return measure_seams(self.corpus)

    @cached_property
    def duplicates(self) -> pd.DataFrame:
        """Captures with the same frames as another one: their group, labels, and the columns that differ within it.

        ``quiet`` is True if so little changes that they can be equal by chance; such groups come last.
        """
        corpus = self.corpus
        labels = corpus.captures.drop(
            columns=["capture", "group", "differs", "quiet"], errors="ignore"
        )
        parts = [labels[:0].assign(group=0, capture=0, differs="", quiet=False)]
        for number, group in enumerate(
            sorted(identical_groups(corpus), key=lambda group: is_quiet(corpus[group[0]])), 1
        ):
            rows, still = labels.iloc[group], is_quiet(corpus[group[0]])
            differs = ", ".join(labels.columns[rows.nunique(dropna=False) > 1])
            parts.append(
                rows.assign(group=number, capture=corpus.index[group], differs=differs, quiet=still)
            )
        table = pd.concat(parts)[["group", "capture", *labels, "differs", "quiet"]]
        return table.sort_values(["group", "capture"], kind="stable", ignore_index=True)

    @cached_property
    def _read(self) -> list[np.ndarray]:
        """Of each capture and taxel: lowest and highest reading, sum, frames at full scale, squares around the mean."""
        parts = []
        for capture in self.corpus:
            frames = capture.reshape(len(capture), -1)
            squares = len(frames) * frames.var(axis=0, dtype=np.float64)
            full = (frames >= self.corpus.full_scale).sum(axis=0)
            parts.append(
                (
                    frames.min(axis=0),
                    frames.max(axis=0),
                    frames.sum(axis=0, dtype=np.float64),
                    full,
                    squares,
                )
            )
        return [np.stack(values) for values in zip(*parts, strict=True)]

    def __str__(self) -> str:
        target = self.corpus.target
        parts = [
            [
                self.title,
                *(["synthetic: generated captures, not people"] if self.corpus.synthetic else []),
            ],
            *(
                []
                if target == "gesture"
                else [[f"Classes of target={target}:", _text(self.classes)]]
            ),
            [f"Durations: {DURATIONS}", _text(self.durations)],
            [f"Pressure: {PRESSURE}", _text(self.pressure)],
            self.gap_lines(),
            self.taxel_lines(),
            *([[*map(str, self.seams)]] if self.seams else []),
            self.duplicate_lines(),
        ]
        return "\n\n".join("\n".join(part) for part in parts)

    __repr__ = __str__

    def gap_lines(self) -> list[str]:
        """Balance of the counts: a sentence, and the first examples."""
        counts, usual = self.counts, self.usual
        absent, other = counts["captures"] == 0, ~counts["captures"].isin([0, usual])
        factors = ", ".join(self.factors[:-1]) + f" and {self.factors[-1]}"
        summary = (
            f"Gaps: of {len(counts)} combinations of {factors}, {len(counts) - absent.sum() - other.sum()} have "
            f"{_number(usual)}, {other.sum()} have another number, {absent.sum()} have none"
        )
        # A gesture that a subject never did is one gap, not one for each condition.
        pairs = counts.groupby(["subject", "gesture"], sort=False)["captures"].transform("sum") == 0
        missing = counts[pairs].drop_duplicates(["subject", "gesture"])[["subject", "gesture"]]
        rows = [*missing.to_dict("records"), *counts[(absent | other) & ~pairs].to_dict("records")]
        numbers = [row.pop("captures", 0) for row in rows]
        lines = [
            f"{_labels(row)}: {_number(n) if n else 'none'}"
            for row, n in zip(rows, numbers, strict=True)
        ]
        return [summary, *_first(lines, len(lines))]

    def taxel_lines(self) -> list[str]:
        """Odd taxels: a sentence, and the first examples."""
        odd = self.odd_taxels
        if not len(odd):
            return [f"Taxels: none of {len(self.taxels)} is odd"]
        lines = [
            f"row {t['row']}, col {t['col']}: {t['verdict']} (SD {t['sd']:.3g}, neighbours {t['around']:.3g}; "
            f"readings {t['lowest']:g} to {t['highest']:g}; alone constant in {t['still']:.3g} % of captures)"
            for t in odd.to_dict("records")
        ]
        summary = f"Taxels: {len(odd)} of {len(self.taxels)} odd; rows and columns from 0"
        if odd["verdict"].isin([LESS]).any():
            summary += "; a taxel that varies far less may be broken or seldom touched"
        return [summary, *_first(lines, len(lines))]

    def duplicate_lines(self) -> list[str]:
        """Duplicate captures: a sentence, and the first examples."""
        if not len(self.duplicates):
            return ["Duplicates: none; no two captures have the same frames"]
        firsts = self.duplicates.drop_duplicates("group")
        lines = []
        for _, part in self.duplicates[self.duplicates["group"] <= NAMED].groupby("group"):
            rows = part.drop(columns=["group", "differs", "quiet"]).to_dict("records")
            lines.append(
                " = ".join(map(_labels, rows[:2]))
                + (f" and {len(rows) - 2} more" if len(rows) > 2 else "")
            )
        several = firsts["differs"].str.contains(r"\b(?:subject|gesture)\b")
        summary = (
            f"Duplicates: {len(self.duplicates)} captures have the same frames as another one, in {len(firsts)} "
            f"groups; {several.sum()} of them under several subjects or gestures"
        )
        if firsts["quiet"].any():
            summary += f"; {firsts['quiet'].sum()} may be equal by chance: fewer than {CHANGES} readings change"
        return [summary, *_first(lines, len(firsts))]

    def repeat_warnings(self) -> list[str]:
        """A warning where one recording is in the corpus twice; nothing where captures can be equal by chance."""
        return (
            []
            if self.duplicates["quiet"].all()
            else [". ".join(map(str.strip, self.duplicate_lines()[:2]))]
        )


def _text(table: pd.DataFrame) -> str:
    return table.to_string(index=False, float_format=lambda v: f"{v:.4g}")


def _number(captures: int) -> str:
    return f"{captures} capture{'' if captures == 1 else 's'}"


def _labels(row: dict) -> str:
    """A row of a table in words."""
    return ", ".join(f"{name} {value}" for name, value in row.items())


def _first(lines: list[str], total: int) -> list[str]:
    """Those that are printed, indented, and how many there are besides."""
    more = [f"... and {total - NAMED} more"] if total > NAMED else []
    return [f"  {line}" for line in [*lines[:NAMED], *more]]
