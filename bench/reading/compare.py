"""Two systems on the same captures, paired over subjects: files of predictions of any tool, tables, stored runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from bench.corpora.read.limits import check_columns, file_name
from bench.corpora.read.rows import CsvTable, PandasTable, ParquetTable, Table, text_categories
from bench.errors import InputError, one_line
from bench.reading import statistics
from bench.reading.frame import group_results, name_rows
from bench.reading.runs import results_on_captures
from bench.values import few, scores
from bench.values.measures import Measure, format_p_value
from bench.values.result import Result, footnotes_of_system, format_count
from bench.values.sentences import render_sentences

COLUMNS = ["id", "subject", "truth", "prediction"]  # of a file
SHOWN = 8  # captures that a sentence names
P = Measure("p", form=format_p_value)


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
        one, other = _right_only(self.captures)
        return [*self.captures["id"][one]], [*self.captures["id"][other]]

    def __repr__(self) -> str:
        notes = [
            note
            for name in (self.system, self.other)
            for note in footnotes_of_system(name, self.on.split(",")[0])
        ]
        words = {
            "p": P.as_text({"p": self.p}),
            "few": few.too_few_sentence(self.subjects),
            "listed": _list_ids,
        }
        words["only"] = [*zip((self.system, self.other), self.only(), strict=True)]
        words["notes"] = [f"{note.rstrip('.')}." for note in dict.fromkeys([*self.notes, *notes])]
        return "\n".join(render_sentences("bench.reading", "compare", "pair", pair=self, **words))


def compare_sides(one: Side, other: Side) -> Compared:
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
        f"Only {side.name} has {format_count(len(ids), 'capture')} ({_list_ids(ids)}); the comparison leaves them out."
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
                f" ({len(wrong)} of {format_count(len(both), 'capture')} differ)"
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
    numbers, gained = statistics.paired_test(*columns), statistics.subject_differences(*columns)
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
        gestures=_compare_gestures(captures, *rows),
        notes=[*notes, *one.notes, *other.notes],
    )


def _right_only(captures: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """Which captures only the first and only the second system gets right, by most of its seeds."""
    one, other = (captures[column] > 0.5 for column in ("right", "other_right"))
    return one & ~other, other & ~one


def _compare_gestures(
    captures: pd.DataFrame, one: pd.DataFrame, other: pd.DataFrame
) -> pd.DataFrame:
    """The comparison of each gesture."""
    people = [100 * rows.groupby(["truth", "subject"])["right"].mean() for rows in (one, other)]
    rows = []
    for gesture, each in captures.groupby("truth"):
        first, second = (accuracy[gesture] for accuracy in people)
        numbers = statistics.paired_test(first, second)
        row = {
            "gesture": gesture,
            "captures": len(each),
            "accuracy": first.mean(),
            "other_accuracy": second.mean(),
        }
        row |= {name: numbers[name] for name in ("difference", "low", "high")}
        rows.append(
            row | dict(zip(("only", "other_only"), map(sum, _right_only(each)), strict=True))
        )
    return pd.DataFrame(rows)


def _list_ids(ids: list[str] | pd.Index) -> str:
    """The first ids of captures, and how many more there are."""
    more = f" and {len(ids) - SHOWN} more" if len(ids) > SHOWN else ""
    return ", ".join(ids[:SHOWN]) + more


# Predictions of other tools


def side_of_file(path: Path, name: str = "") -> Side:
    """The predictions of a CSV or parquet file; the file's name stands for the system unless ``name`` does."""
    name = name or file_name(path)
    if path.suffix.lower() != ".parquet":
        return side_of_table(CsvTable(path, name, counts=()), name)
    try:
        return side_of_table(ParquetTable(path), name)
    except InputError:
        raise
    except Exception as e:  # pyarrow raises a dozen types for damaged bytes
        raise InputError(
            f"{name}: not a readable parquet file ({one_line(e)}); save it again"
        ) from e


def side_of_frame(frame: pd.DataFrame, name: str) -> Side:
    """The same of a table in memory."""
    check_columns([*map(str, frame)], COLUMNS, name)
    return side_of_table(PandasTable(frame[COLUMNS], name), name)


def side_of_table(table: Table, name: str) -> Side:
    """The label of each capture: that of its row, or the majority vote of its rows."""
    rows = _read_rows(table)
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
        end: f"{format_count(len(ids), 'capture')} ({_list_ids(ids)})"
        for end, ids in notes.items()
        if len(ids)
    }
    return Side(
        name,
        captures.reset_index(),
        notes=[f"{name} has {which} with {end}." for end, which in found.items()],
    )


def _read_rows(table: Table) -> pd.DataFrame:
    """The columns `COLUMNS` as text; only the prediction may be missing."""
    check_columns(table.columns, COLUMNS, table.header_prefix)
    blocks, first = [], table.first
    for batch in table.read_batches([]):
        cells = {
            name: batch.column(table.columns.index(name)).cast(pa.string()) for name in COLUMNS
        }
        words = {
            n: text_categories(cell, n, table.row_prefix, first, n == "prediction")
            for n, cell in cells.items()
        }
        blocks.append(pd.DataFrame({name: np.asarray(column) for name, column in words.items()}))
        first += len(batch)
    if not blocks:
        raise InputError(
            f"{table.header_prefix}: there are no predictions in it; give a row for each capture"
        )
    return pd.concat(blocks, ignore_index=True)


# Stored runs


def side_of_runs(results: Sequence[Result], name: str, on: str) -> Side:
    """Labels of whole captures that the runs of one system predicted."""
    parts = [scores.label_captures(r.tables["predictions"]) for r in results]
    rows = pd.concat(parts).sort_values("capture", kind="stable")
    rows = rows.astype({"capture": str, "subject": str})
    rows = rows.rename(columns={"capture": "id", "true": "truth", "predicted": "prediction"})
    right = (rows["truth"] == rows["prediction"]).astype(float)
    return Side(name, rows[COLUMNS].assign(right=right), on)


def find_runs(name: str, results: Sequence[Result]) -> list[Result]:
    """The runs that a name of ``bench runs`` or an id, or its unique beginning, stands for.

    Raises:
        InputError: nothing has this name or id, or several ids begin like this.
    """
    labels = name_rows(results)
    named = [r for r, label in zip(results, labels, strict=True) if name in (label, r.system)]
    if named:
        return named
    begun = [r for r in results if str(r["run_id"]).startswith(name)]
    if len(begun) == 1:
        return begun
    if begun:
        raise InputError(f"{name}: {len(begun)} run ids begin like this; give more letters")
    raise InputError(
        f"no file, run or system is called {name!r}; give a CSV or parquet file, or a run id or "
        "system as bench runs prints it"
    )


def sides_of_runs(
    found: Mapping[str, Sequence[Result]], results: Sequence[Result]
) -> dict[str, Side]:
    """The sides of one or two systems by name, on the captures and under the protocol they share.

    Args:
        found: runs of each name.
        results: all runs among which they were found.

    Raises:
        InputError: they share no captures and protocol, or several, or tested other subjects.
    """
    complete = {name: _complete_runs(name, runs) for name, runs in found.items()}
    by_group: dict[str, list[list[Result]]] = {}
    for group, members in group_results([r for r in results if r.is_complete]).items():
        by_group[group] = [[r for r in runs if r in members] for runs in complete.values()]
    shared = [group for group, sides in by_group.items() if all(sides)]
    words = " and ".join(found)
    if not shared:
        groups = [[g for g, sides in by_group.items() if sides[i]] for i in range(len(found))]
        each = [f"{name} on {', '.join(on)}" for name, on in zip(found, groups, strict=True)]
        raise InputError(
            f"{words} share no data, subset and protocol: {'; '.join(each)}; "
            "run one of them where the other was run"
        )
    if len(shared) > 1:
        have = "both have" if len(found) > 1 else f"{words} has"
        raise InputError(
            f"{have} runs on {'; '.join(shared)}; name one with data=, where=, target= or protocol="
        )
    (group,) = shared
    labels = name_rows([runs[0] for runs in by_group[group]])
    sides = {
        name: side_of_runs(runs, label, group)
        for name, runs, label in zip(found, by_group[group], labels, strict=True)
    }
    if len({frozenset(side.rows["subject"]) for side in sides.values()}) > 1:
        raise InputError(
            f"{words} were tested on different subjects of {group}; run the one that lacks some again"
        )
    return sides


def _complete_runs(name: str, results: Sequence[Result]) -> list[Result]:
    """The newest complete run on captures of each seed of the first system."""
    complete = [r for r in results_on_captures(results) if r.is_complete]
    if not complete:
        raise InputError(f"no run of {name} on captures is complete; run it again")
    return [r for r in complete if r.system == complete[0].system]
