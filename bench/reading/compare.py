"""Two systems on the same captures, paired over subjects: files of predictions of any tool, tables, stored runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from bench.corpora.read.limits import called, check_columns
from bench.corpora.read.rows import CsvTable, PandasTable, ParquetTable, Table, words_of
from bench.errors import InputError, nearest, plain
from bench.reading import statistics
from bench.reading.frame import names
from bench.values import few, scores
from bench.values.measures import Measure, p_value
from bench.values.result import MARK, Result, notes_on, several
from bench.values.sentences import sentences

COLUMNS = ["id", "subject", "truth", "prediction"]  # of a file
SHOWN = 8  # captures that a sentence names
SHORTEST = 8  # letters of the id of a run that name it
P = Measure("p", form=p_value)


@dataclass(frozen=True)
class Side:
    """What one system predicted."""

    name: str  # the system, or the file
    # ``id``, ``subject``, ``truth``, ``prediction`` and ``right`` (1, 0, or a share of a tied vote): a row for each
    # capture, or of stored runs for each capture, fold and seed
    rows: pd.DataFrame
    on: str = ""  # data, subset and protocol of stored runs in words; empty for a file
    notes: Sequence[
        str
    ] = ()  # sentences on captures with several rows, tied votes and missing predictions

    def captures(self) -> pd.DataFrame:
        """A row for each capture, by its id; ``right`` is a mean over seeds."""
        by = self.rows.groupby("id", sort=False)
        labels = by["prediction"].agg(lambda each: " / ".join(dict.fromkeys(each)))
        return by[["subject", "truth"]].first().assign(prediction=labels, right=by["right"].mean())


@dataclass(frozen=True, repr=False)
class Compared:
    """Two systems on the same captures; prints as a sentence each.

    Attributes:
        system: the first one, as tables name it, or its file.
        other: the second one.
        on: data, subset and protocol, in words.
        accuracy: percent of correctly classified captures [subjects, 2], means over seeds.
        difference: accuracy of the first system less that of the second, mean over subjects, in points.
        low: lower end of the 95 % interval of the difference by the same test; NaN for fewer than 6 subjects.
        high: upper end of it.
        p: p-value of the two-sided paired Wilcoxon test, which needs no correction; NaN for fewer than 6 subjects.
        smallest: mean difference in points above which the test rejects (p < 0.05), in either direction, where
            differences spread over the subjects as these do; NaN for fewer than 6 subjects.
        subjects: number of them.
        gain: subjects on whom the first system is more accurate.
        lose: subjects on whom the second system is more accurate.
        captures: a row for each capture that both predicted: ``id``, ``subject``, ``truth``, and of each system its
            ``prediction`` and whether it is ``right``, a share over seeds and tied votes.
        gestures: a row for each gesture: ``captures``, ``accuracy`` and ``other_accuracy`` in percent, means over
            subjects, ``difference`` with its interval, and the numbers of captures that ``only`` the first or only the
            second (``other_only``) classifies correctly.
        notes: sentences on captures that one of them lacks, several rows of a capture, and tied votes.
    """

    system: str
    other: str
    on: str
    accuracy: pd.DataFrame
    difference: float
    low: float
    high: float
    p: float
    smallest: float
    subjects: int
    gain: list[str]
    lose: list[str]
    captures: pd.DataFrame
    gestures: pd.DataFrame
    notes: list[str]

    def only(self) -> tuple[list[str], list[str]]:
        """Ids of the captures that only the first, and only the second system classifies correctly."""
        one, other = _only(self.captures)
        return [*self.captures["id"][one]], [*self.captures["id"][other]]

    def __repr__(self) -> str:
        notes = [
            note
            for name in (self.system, self.other)
            for note in notes_on(name, self.on.split(",")[0])
        ]
        words = {"p": P.of({"p": self.p}), "few": few.too_few(self.subjects), "listed": _listed}
        words["only"] = [*zip((self.system, self.other), self.only(), strict=True)]
        words["notes"] = [f"{note.rstrip('.')}." for note in dict.fromkeys([*self.notes, *notes])]
        return "\n".join(sentences("bench.reading", "compare", "pair", pair=self, **words))


def compared(one: Side, other: Side) -> Compared:
    """Two systems on the captures that both predicted, matched by id."""
    if one.name == other.name:
        raise InputError(f"both are {one.name}; give two systems")
    sides = (one, other)
    first, second = (side.captures() for side in sides)
    both = first.index.intersection(second.index, sort=False)
    if both.empty:
        one_id, other_id = (
            f"{first.index[0]!r} in {one.name}",
            f"{second.index[0]!r} in {other.name}",
        )
        raise InputError(
            f"no capture is in both; the first id is {one_id}, {other_id}; give captures equal ids"
        )
    notes = [
        f"Only {side.name} has {several(len(ids), 'capture')} ({_listed(ids)}); the comparison leaves them out."
        for side, table in zip(sides, (first, second), strict=True)
        if len(ids := table.index.difference(both, sort=False))
    ]
    if len({*(side.on for side in sides)}) > 1:
        notes += [
            f"touchbench cannot verify the protocol of {side.name}."
            for side in sides
            if not side.on
        ]
    first, second = first.loc[both], second.loc[both]
    for column in ("truth", "subject"):
        if len(wrong := both[(first[column] != second[column]).to_numpy()]):
            here, there = (table.at[wrong[0], column] for table in (first, second))
            more = (
                f" ({len(wrong)} of {several(len(both), 'capture')} differ)"
                if len(wrong) > 1
                else ""
            )
            raise InputError(
                f"capture {wrong[0]}: {column} is {here!r} in {one.name}, {there!r} in {other.name}{more}; correct one"
            )
    rows = [side.rows[side.rows["id"].isin(both)] for side in sides]
    accuracy = pd.DataFrame(
        {
            side.name: 100 * each.groupby("subject")["right"].mean()
            for side, each in zip(sides, rows, strict=True)
        }
    )
    columns = accuracy[one.name], accuracy[other.name]
    numbers, gained = statistics.paired(*columns), statistics.gains(*columns)
    captures = (
        first.join(second[["prediction", "right"]].add_prefix("other_"))
        .rename_axis("id")
        .reset_index()
    )
    return Compared(
        system=one.name,
        other=other.name,
        on=one.on or other.on,
        accuracy=accuracy,
        **{name: numbers[name] for name in ("difference", "low", "high", "p")},
        smallest=max(
            numbers["difference"] - numbers["low"], numbers["high"] - numbers["difference"]
        ),
        subjects=len(accuracy),
        gain=[*accuracy.index[gained > 0]],
        lose=[*accuracy.index[gained < 0]],
        captures=captures,
        gestures=_gestures(captures, *rows),
        notes=[*notes, *one.notes, *other.notes],
    )


def _only(captures: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """Which captures only the first and only the second system gets right, by most of its seeds."""
    one, other = (captures[column] > 0.5 for column in ("right", "other_right"))
    return one & ~other, other & ~one


def _gestures(captures: pd.DataFrame, one: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """The comparison of each gesture."""
    people = [100 * rows.groupby(["truth", "subject"])["right"].mean() for rows in (one, other)]
    rows = []
    for gesture, each in captures.groupby("truth"):
        first, second = (accuracy[gesture] for accuracy in people)
        numbers = statistics.paired(first, second)
        row = {
            "gesture": gesture,
            "captures": len(each),
            "accuracy": first.mean(),
            "other_accuracy": second.mean(),
        }
        row |= {name: numbers[name] for name in ("difference", "low", "high")}
        rows.append(row | dict(zip(("only", "other_only"), map(sum, _only(each)), strict=True)))
    return pd.DataFrame(rows)


def _listed(ids: list[str] | pd.Index) -> str:
    """The first ids of captures, and how many more there are."""
    more = f" and {len(ids) - SHOWN} more" if len(ids) > SHOWN else ""
    return ", ".join(ids[:SHOWN]) + more


# Predictions of other tools


def of_file(path: Path, name: str = "") -> Side:
    """The predictions of a CSV or parquet file; the file's name stands for the system unless ``name`` does."""
    name = name or called(path)
    if path.suffix.lower() != ".parquet":
        return of_table(CsvTable(path, name, counts=()), name)
    try:
        return of_table(ParquetTable(path), name)
    except InputError:
        raise
    except Exception as e:  # pyarrow raises a dozen types for damaged bytes
        raise InputError(f"{name}: not a readable parquet file ({plain(e)}); save it again") from e


def of_frame(frame: pd.DataFrame, name: str) -> Side:
    """The same of a table in memory."""
    check_columns([*map(str, frame)], COLUMNS, name)
    return of_table(PandasTable(frame[COLUMNS], name), name)


def of_table(table: Table, name: str) -> Side:
    """The label of each capture: that of its row, or the majority vote of its rows."""
    rows = _rows(table)
    by = rows.groupby("id", sort=False)
    for column in ("truth", "subject"):
        counts = by[column].nunique()
        for capture in counts.index[counts > 1]:
            values = " and ".join(map(repr, rows[column][rows["id"] == capture].unique()[:2]))
            raise InputError(
                f"{name}: capture {capture} has {values} as {column}; correct its rows"
            )
    votes = (
        rows[rows["prediction"] != scores.ABSTAINED]
        .groupby(["id", "prediction"], sort=False)
        .size()
    )
    most = votes[votes == votes.groupby(level="id").transform("max")].reset_index()
    captures = by[["subject", "truth"]].first()
    most["right"] = (
        most["prediction"].to_numpy() == captures["truth"].reindex(most["id"]).to_numpy()
    )
    voted = most.groupby("id", sort=False)
    captures["prediction"] = voted["prediction"].agg(" / ".join)
    captures["right"] = voted["right"].mean()
    silent = captures.index[captures["prediction"].isna()]
    captures = captures.fillna({"prediction": scores.ABSTAINED, "right": 0.0})
    notes = {
        "several rows; the label is their majority vote": by.size()
        .loc[lambda counts: counts > 1]
        .index,
        "a tied vote, which counts as the share of its labels that is right": voted.size()
        .loc[lambda n: n > 1]
        .index,
        "no prediction, which counts as wrong": silent,
    }
    found = {
        end: f"{several(len(ids), 'capture')} ({_listed(ids)})"
        for end, ids in notes.items()
        if len(ids)
    }
    return Side(
        name,
        captures.reset_index(),
        notes=[f"{name} has {which} with {end}." for end, which in found.items()],
    )


def _rows(table: Table) -> pd.DataFrame:
    """The columns `COLUMNS` as text; only the prediction may be missing."""
    check_columns(table.columns, COLUMNS, table.header)
    blocks, first = [], table.first
    for batch in table.batches([]):
        cells = {
            name: batch.column(table.columns.index(name)).cast(pa.string()) for name in COLUMNS
        }
        words = {
            n: words_of(cell, n, table.where, first, n == "prediction") for n, cell in cells.items()
        }
        blocks.append(pd.DataFrame({name: np.asarray(column) for name, column in words.items()}))
        first += len(batch)
    if not blocks:
        raise InputError(
            f"{table.header}: there are no predictions in it; give a row for each capture"
        )
    return pd.concat(blocks, ignore_index=True)


# Stored runs


def of_runs(results: Sequence[Result], name: str, on: str) -> Side:
    """The labels of stored runs of one system on whole captures."""
    parts = [scores.captures(r.tables["predictions"]) for r in results]
    rows = (
        pd.concat(parts)
        .sort_values("capture", kind="stable")
        .astype({"capture": str, "subject": str})
    )
    rows = rows.rename(columns={"capture": "id", "true": "truth", "predicted": "prediction"})
    return Side(
        name, rows[COLUMNS].assign(right=(rows["truth"] == rows["prediction"]).astype(float)), on
    )


def stored_sides(named: Sequence[tuple[str, Mapping[str, Sequence[Result]]]]) -> list[Side]:
    """One or two systems, each by its name or the id of a run with results by group, on the one group they share."""
    groups = [_groups(name, runs) for name, runs in named]
    both = [group for group in groups[0] if group in groups[-1]]
    words = " and ".join(name for name, _ in named)
    if not both:
        on = "; ".join(
            f"{name} on {', '.join(each)}" for (name, _), each in zip(named, groups, strict=True)
        )
        raise InputError(
            f"{words} share no data, subset and protocol: {on}; run one of them where the other was run"
        )
    if len(both) > 1:
        have = "both have" if len(named) > 1 else f"{words} has"
        raise InputError(
            f"{have} runs on {'; '.join(both)}; name one with data=, where=, target= or protocol="
        )
    found = [each[both[0]] for each in groups]
    if len(found) > 1 and found[0][0] is found[1][0]:
        raise InputError(f"both are {found[0][0].system}; give two systems")
    labels = names([results[0] for results in found])
    sides = [of_runs(results, label, both[0]) for results, label in zip(found, labels, strict=True)]
    if len({frozenset(side.rows["subject"]) for side in sides}) > 1:
        raise InputError(
            f"{words} were tested on different subjects of {both[0]}; run the one that lacks some again"
        )
    return sides


def _groups(name: str, runs: Mapping[str, Sequence[Result]]) -> dict[str, list[Result]]:
    """Groups in which a system has complete runs, with these."""
    groups, systems = {}, set()
    for group, results in runs.items():
        complete = [r for r in results if r.complete]
        systems |= {r.system for r in complete}
        if matching := [r for r in complete if _is(name, r)]:
            groups[group] = [r for r in matching if r.system == matching[0].system]
    if not groups:
        raise InputError(f"no complete run of {name!r} is tracked; {nearest(name, systems)}")
    return groups


def _is(name: str, result: Result) -> bool:
    """Whether a name means a run: its id, or its system with or without the dot and the marks that tables add."""
    unmarked = result.system.removesuffix(f" {MARK}")
    by_name = _words(name) in map(_words, (result.system, unmarked, unmarked.split(" (uses ")[0]))
    return by_name or (len(name) >= SHORTEST and str(result["run_id"]).startswith(name))


def _words(name: str) -> list[str]:
    """The words of a name without the dot between model and features, which few keyboards have."""
    return name.replace("\N{MIDDLE DOT}", " ").split()
