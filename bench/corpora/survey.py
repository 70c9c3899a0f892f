"""A survey of a corpus before any training: counts and gaps, durations, pressure, broken taxels, duplicates."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.duplicates import CHANGES, identical, quiet
from bench.corpora.seams import Seam, seams
from bench.errors import InputError

ODD = 3.0  # times more, or less, than the taxels around it: such a taxel is suspicious
ALONE = 1.0  # percent of captures in which it alone does not vary: beyond it, a taxel is suspicious
CROSSED = 10  # combinations for each capture, beyond which nobody meant to record them all
LESS = "varies far less than its neighbours"
DURATIONS = "seconds of a capture of each gesture"
PRESSURE = "sensor values; full_scale: readings at full scale in percent; still: captures without any change"
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
        combinations = captures["subject"].nunique() * captures["gesture"].nunique()
        for column in captures.columns.drop([*factors, "split", "captures", "corpus"], errors="ignore"):
            values = captures[column]
            if pd.api.types.is_numeric_dtype(values) and not pd.api.types.is_bool_dtype(values):
                continue
            several = values.nunique(dropna=False)
            if several > 1 and combinations * several <= CROSSED * len(captures):
                factors.append(column)
                combinations *= several
        return factors

    @cached_property
    def counts(self) -> pd.DataFrame:
        """Number of ``captures`` of each combination of the factors, whether recorded or not."""
        words = self.corpus.captures[self.factors].astype(object)
        words = words.where(words.notna(), "").astype(str)
        levels: list[Any] = [sorted(set(words[f]), key=_counted) for f in self.factors]
        every: Any = pd.MultiIndex.from_product(levels, names=self.factors)
        return words.groupby(self.factors).size().reindex(every, fill_value=0).rename("captures").reset_index()

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
        return labelled.groupby("class")["subject"].agg(captures="size", subjects="nunique").reset_index()

    @property
    def _seconds(self) -> np.ndarray:
        return self.corpus.lengths / self.corpus.rate_hz

    @cached_property
    def durations(self) -> pd.DataFrame:
        """Captures, subjects, and median, shortest and longest seconds of each gesture."""
        groups = pd.DataFrame({"subject": self.corpus.subjects, "s": self._seconds}).groupby(self._code)
        durations = groups.agg(
            captures=("s", "size"),
            subjects=("subject", "nunique"),
            median=("s", "median"),
            shortest=("s", "min"),
            longest=("s", "max"),
        )
        durations.insert(0, "gesture", self.gestures)
        return durations

    @cached_property
    def _frames(self) -> np.ndarray:
        """Frames of each gesture."""
        return np.bincount(self._code, self.corpus.lengths, len(self.gestures))

    @cached_property
    def means(self) -> np.ndarray:
        """Mean pressure of each gesture, each frame counted once, float64 [gestures, rows, cols]."""
        return (self._read.sums / self._frames[:, None]).reshape(-1, *self.corpus.grid)

    @cached_property
    def pressure(self) -> pd.DataFrame:
        """Sensor values of each gesture: lowest, mean and highest reading, percent of readings at full scale.

        ``still`` are captures in which nothing varies.
        """
        read, code = self._read, self._code
        return pd.DataFrame(
            {
                "gesture": self.gestures,
                "lowest": pd.Series(read.lowest.min(axis=1)).groupby(code).min(),
                "mean": self.means.mean(axis=(1, 2)),
                "highest": pd.Series(read.highest.max(axis=1)).groupby(code).max(),
                "full_scale": 100 * read.full.sum(axis=1) / (self._frames * self.means[0].size),
                "still": pd.Series(read.still.all(axis=1)).groupby(code).sum(),
            }
        )

    @cached_property
    def typical(self) -> dict[str, int]:
        """Capture nearest to the middle in duration, mean and highest pressure, by gesture."""
        highest = self._read.highest.max(axis=1)
        course = pd.DataFrame({"s": self._seconds, "mean": self._read.level, "highest": highest})
        ranks = course.groupby(self._code).rank(pct=True)
        size = np.bincount(self._code)[self._code]
        away = (ranks.sub((1 + 1 / size) / 2, axis=0)).abs().sum(axis=1)
        nearest = away.groupby(self._code).idxmin()
        return {g: int(self.corpus.index[i]) for g, i in zip(self.gestures, nearest, strict=True)}

    @cached_property
    def taxels(self) -> pd.DataFrame:
        """Readings of each taxel, row by row, and a ``verdict``, empty where nothing is odd.

        ``full_scale`` is the percent of frames at full scale; ``sd`` is around the mean of each capture; ``around`` is
        the median SD of the up to eight taxels around it that do vary; ``still`` is the percent of captures in which it
        does not vary while all of those around it do.
        """
        read, corpus = self._read, self.corpus
        frames = int(corpus.lengths.sum())
        lowest, highest = read.lowest.min(axis=0), read.highest.max(axis=0)
        sd = np.sqrt(read.within / frames)
        several = corpus.lengths > 1  # a single frame shows no change
        never = read.still[several].all(axis=0) if several.any() else lowest == highest
        moving = _near((~read.still).reshape(-1, *corpus.grid), True)
        alone = read.still & np.logical_and.reduce(moving).reshape(read.still.shape) & (corpus.grid != (1, 1))
        still = 100 * alone[several].sum(axis=0) / max(1, several.sum())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # nan where nothing around varies, and comparisons with it are false
            around = np.nanmedian(_near(np.where(never, np.nan, sd).reshape(1, *corpus.grid), np.nan), axis=0).ravel()
            verdicts = {
                "always at full scale": lowest >= corpus.full_scale,
                "never varies": lowest == highest,
                "never varies within a capture": never,
                "often constant while its neighbours vary": still > ALONE,
                LESS: ODD * sd < around,
                "varies far more than its neighbours": sd > ODD * around,
            }
        row, col = np.indices(corpus.grid).reshape(2, -1)
        return pd.DataFrame(
            {
                "row": row,
                "col": col,
                "lowest": lowest,
                "mean": read.sums.sum(axis=0) / frames,
                "highest": highest,
                "full_scale": 100 * read.full.sum(axis=0) / frames,
                "sd": sd,
                "around": around,
                "still": still,
                "verdict": np.select([*verdicts.values()], [*verdicts], ""),
            }
        )

    @property
    def odd_taxels(self) -> pd.DataFrame:
        """Rows of ``taxels`` with a verdict."""
        return self.taxels[self.taxels["verdict"] != ""].reset_index(drop=True)

    @cached_property
    def seams(self) -> list[Seam]:
        """Fit of neighbouring rows and columns."""
        return seams(self.corpus)

    @cached_property
    def duplicates(self) -> pd.DataFrame:
        """Captures with the same frames as another one: their group, labels, and the columns that differ within it.

        ``quiet`` is True if so little changes that they can be equal by chance; such groups come last.
        """
        corpus = self.corpus
        labels = corpus.captures.drop(columns=["capture", "group", "differs", "quiet"], errors="ignore")
        parts = [labels[:0].assign(group=0, capture=0, differs="", quiet=False)]
        for number, group in enumerate(sorted(identical(corpus), key=lambda group: quiet(corpus[group[0]])), 1):
            rows, still = labels.iloc[group], quiet(corpus[group[0]])
            differs = ", ".join(labels.columns[rows.nunique(dropna=False) > 1])
            parts.append(rows.assign(group=number, capture=corpus.index[group], differs=differs, quiet=still))
        table = pd.concat(parts)[["group", "capture", *labels, "differs", "quiet"]]
        return table.sort_values(["group", "capture"], kind="stable", ignore_index=True)

    @cached_property
    def _read(self) -> _Readings:
        """All readings, from one capture at a time."""
        corpus, taxels = self.corpus, self.corpus.grid[0] * self.corpus.grid[1]
        lowest, highest = (np.empty((len(corpus), taxels), corpus.frames.dtype) for _ in range(2))
        level, within = np.empty(len(corpus)), np.zeros(taxels)
        sums, full = np.zeros((len(self.gestures), taxels)), np.zeros((len(self.gestures), taxels), np.int64)
        for i, (capture, code) in enumerate(zip(corpus, self._code, strict=True)):
            frames = capture.reshape(len(capture), taxels)
            lowest[i], highest[i] = frames.min(axis=0), frames.max(axis=0)
            level[i] = frames.mean(dtype=np.float64)
            within += len(frames) * frames.var(axis=0, dtype=np.float64)
            sums[code] += frames.sum(axis=0, dtype=np.float64)
            full[code] += (frames >= corpus.full_scale).sum(axis=0)
        return _Readings(lowest, highest, lowest == highest, level, sums, full, within)

    def __str__(self) -> str:
        target = self.corpus.target
        parts = [
            [self.title, *(["synthetic: generated captures, not people"] if self.corpus.synthetic else [])],
            *([] if target == "gesture" else [[f"Classes of target={target}:", _text(self.classes)]]),
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
            f"{_number(usual, 'capture')}, {other.sum()} have another number, {absent.sum()} have none"
        )
        # A gesture that a subject never did is one gap, not one for each condition.
        pairs = counts.groupby(["subject", "gesture"], sort=False)["captures"].transform("sum") == 0
        missing = counts[pairs].drop_duplicates(["subject", "gesture"])[["subject", "gesture", "captures"]]
        rest = counts[(absent | other) & ~pairs]
        lines = [_labels(row) for row in [*missing.to_dict("records"), *rest.to_dict("records")]]
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
        lines = []
        for _, part in self.duplicates[self.duplicates["group"] <= NAMED].groupby("group"):
            first, *others = part.drop(columns=["group", "differs", "quiet"]).to_dict("records")
            shown = ["capture", *part["differs"].iloc[0].split(", ")]
            lines.append(" = ".join([_labels(first), *(_labels(row, shown) for row in others[:NAMED])]))
            lines[-1] += f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
        firsts = self.duplicates.drop_duplicates("group")
        differs = [set(names.split(", ")) for names in firsts["differs"]]
        other = sum(bool({"subject", "gesture"} & names) for names in differs)
        summary = (
            f"Duplicates: {len(self.duplicates)} captures have the same frames as another one, in {len(firsts)} "
            f"groups; {other} of them under several subjects or gestures"
        )
        copied = zip(differs, firsts["quiet"], strict=True)
        if refused := sum("subject" in names and not still for names, still in copied):
            summary += f"; protocols that separate subjects refuse {refused}"
        if firsts["quiet"].any():
            summary += f"; {firsts['quiet'].sum()} may be equal by chance: fewer than {CHANGES} readings change"
        return [summary, *_first(lines, len(firsts))]


def _text(table: pd.DataFrame) -> str:
    return table.to_string(index=False, float_format=lambda v: f"{v:.4g}")


def _number(n: int, word: str) -> str:
    return f"{n} {word}{'' if n == 1 else 's'}"


def _labels(row: dict, columns: list[str] | None = None) -> str:
    """A row of a table in words; a count comes last."""
    words = [f"{k} {v}" for k, v in row.items() if k != "captures" and (columns is None or k in columns)]
    count = f": {_number(row['captures'], 'capture') if row['captures'] else 'none'}" if "captures" in row else ""
    return ", ".join(words) + count


def _first(lines: list[str], total: int) -> list[str]:
    """Those that are printed, indented, and how many there are besides."""
    more = [f"... and {total - NAMED} more"] if total > NAMED else []
    return [f"  {line}" for line in [*lines[:NAMED], *more]]


@dataclass(frozen=True)
class _Readings:
    """What is read off the frames: by capture and taxel, by capture, by gesture and taxel, by taxel."""

    lowest: np.ndarray  # [captures, taxels]
    highest: np.ndarray
    still: np.ndarray  # whether a taxel has one value throughout a capture
    level: np.ndarray  # mean of a capture [captures]
    sums: np.ndarray  # [gestures, taxels]
    full: np.ndarray  # frames at full scale
    within: np.ndarray  # squared differences from the mean of the taxel in the capture, summed [taxels]


def _counted(name: str) -> tuple[int, str]:
    """Sorts subject 10 behind subject 9."""
    return (len(name) if name.isdigit() else 0, name)


def _near(values: np.ndarray, beyond: float) -> list[np.ndarray]:
    """The values on each of the eight sides of every taxel, each [captures, rows, cols]; ``beyond`` off the edge."""
    _, rows, cols = values.shape
    edged = np.pad(values, ((0, 0), (1, 1), (1, 1)), constant_values=beyond)
    return [edged[:, i : i + rows, j : j + cols] for i, j in np.ndindex(3, 3) if (i, j) != (1, 1)]
