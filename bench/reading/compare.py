"""Compare two systems on the same captures, paired over subjects: files, tables, stored runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from bench.corpora.read.limits import check_columns, file_name, first_names
from bench.corpora.read.rows import (
    CsvTable,
    Table,
    table_from_pandas,
    table_from_parquet,
    text_categories,
)
from bench.corpora.spellings import known_spelling, spelling_doubts
from bench.errors import InputError, one_line
from bench.reading import statistics
from bench.reading.captures import stale_sentences
from bench.reading.frame import group_results, name_rows, rename_labels
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
    """What one system predicted.

    Args:
        name: the system, or the file.
        rows: ``id``, ``subject``, ``truth``, ``prediction`` and ``right`` (1, 0, or a share of a
            tied vote): a row for each capture, or of stored runs for each capture, fold and seed.
        on: data, subset and protocol of stored runs in words; empty for a file.
        notes: sentences on captures with several rows, tied votes and missing predictions.
    """

    name: str
    rows: pd.DataFrame
    on: str = ""
    notes: Sequence[str] = ()

    def rows_by_capture(self) -> pd.DataFrame:
        """A row for each capture, by its id; ``right`` is a mean over seeds."""
        by_id = self.rows.groupby("id", sort=False)
        labels = by_id["prediction"].agg(lambda each: " / ".join(dict.fromkeys(each)))
        first = by_id[["subject", "truth"]].first()
        return first.assign(prediction=labels, right=by_id["right"].mean())


@dataclass(frozen=True, repr=False)
class Compared:
    """Two systems on the same captures; prints as a sentence each.

    Attributes:
        system: the first one, as tables name it, or its file.
        other: the second one.
        on: data, subset and protocol, in words.
        accuracy: percent of correctly classified captures [subjects, 2], means over seeds.
        difference: accuracy of the first system less that of the second, mean over subjects, in
            points.
        low: lower end of the 95 % interval of the difference by the same test; NaN for fewer than
            6 subjects.
        high: upper end of it.
        p: p-value of the two-sided paired Wilcoxon test, which needs no correction; NaN for fewer
            than 6 subjects.
        smallest: mean difference in points above which the test rejects (p < 0.05), in either
            direction, where differences spread over the subjects as these do; NaN for fewer than
            6 subjects.
        subjects: number of them.
        gain: subjects on whom the first system is more accurate.
        lose: subjects on whom the second system is more accurate.
        captures: a row for each capture that both predicted: ``id``, ``subject``, ``truth``, and of
            each system its ``prediction`` and whether it is ``right``, a share over seeds and tied
            votes.
        gestures: a row for each gesture: ``captures``, ``accuracy`` and ``other_accuracy`` in
            percent, means over subjects, ``difference`` with its interval, and the numbers of
            captures that ``only`` the first or only the second (``other_only``) classifies
            correctly.
        notes: sentences on captures that one of them lacks, several rows of a capture, and tied
            votes.
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
        """Ids of captures that only the first, and only the second system classifies correctly."""
        ids = self.captures["id"]
        first, second = _right_alone(self.captures)
        return [*ids[first]], [*ids[second]]

    def __repr__(self) -> str:
        notes, data = [*self.notes], self.on.split(",")[0]
        for system in (self.system, self.other):
            notes += footnotes_of_system(system, data)
        lines = render_sentences(
            *("bench.reading", "compare", "pair"),
            pair=self,
            p=P.as_text({"p": self.p}),
            few=few.too_few_sentence(self.subjects),
            list_ids=_list_ids,
            only=[*zip((self.system, self.other), self.only(), strict=True)],
            notes=[f"{note.rstrip('.')}." for note in dict.fromkeys(notes)],
        )
        return "\n".join(lines)


def compare_sides(first: Side, second: Side) -> Compared:
    """Compare two systems on the captures that both predicted, matched by id."""
    if first.name == second.name:
        raise InputError(f"both are {first.name}; give two systems")
    sides, tables = (first, second), (first.rows_by_capture(), second.rows_by_capture())
    both = tables[0].index.intersection(tables[1].index, sort=False)
    if both.empty:
        ids = [f"{t.index[0]!r} in {side.name}" for side, t in zip(sides, tables, strict=True)]
        raise InputError(
            f"no capture is in both; the first id is {', '.join(ids)}; give captures equal ids"
        )
    notes = []
    for side, table in zip(sides, tables, strict=True):
        alone = table.index.difference(both, sort=False)
        if len(alone):
            words = f"{format_count(len(alone), 'capture')} ({_list_ids(alone)})"
            notes.append(f"Only {side.name} has {words}; the comparison leaves them out.")
    if first.on != second.on:
        unknown = [side.name for side in sides if not side.on]
        notes += [f"touchbench cannot verify the protocol of {name}." for name in unknown]
    first_rows, second_rows = (table.loc[both] for table in tables)
    _check_equal_captures(first.name, second.name, first_rows, second_rows)
    for column in ("subject", "truth"):
        notes += spelling_doubts(column, Counter(first_rows[column]))
    truths = {*first.rows["truth"], *second.rows["truth"]}
    notes += [note for side in sides for note in _foreign_notes(side, truths)]
    rows = [side.rows[side.rows["id"].isin(both)] for side in sides]
    people = [100 * each.groupby("subject")["right"].mean() for each in rows]
    accuracy = pd.DataFrame({first.name: people[0], second.name: people[1]})
    test = statistics.paired_test(accuracy[first.name], accuracy[second.name])
    gained = statistics.subject_differences(accuracy[first.name], accuracy[second.name])
    captures = first_rows.join(second_rows[["prediction", "right"]].add_prefix("other_"))
    captures = captures.rename_axis("id").reset_index()
    return Compared(
        system=first.name,
        other=second.name,
        on=first.on or second.on,
        accuracy=accuracy,
        **{name: test[name] for name in ("difference", "low", "high", "p")},
        smallest=max(test["difference"] - test["low"], test["high"] - test["difference"]),
        subjects=len(accuracy),
        gain=[*accuracy.index[gained > 0]],
        lose=[*accuracy.index[gained < 0]],
        captures=captures,
        gestures=_compare_gestures(captures, *rows),
        notes=[*notes, *first.notes, *second.notes],
    )


def _check_equal_captures(
    first_name: str, second_name: str, first: pd.DataFrame, second: pd.DataFrame
) -> None:
    """Refuse captures whose truth or subject differs between the sides."""
    for column in ("truth", "subject"):
        wrong = first.index[(first[column] != second[column]).to_numpy()]
        if len(wrong):
            one, other = (table.at[wrong[0], column] for table in (first, second))
            more = f" ({len(wrong)} of {format_count(len(first), 'capture')} differ)"
            raise InputError(
                f"capture {wrong[0]}: {column} is {one!r} in {first_name}, {other!r} in "
                f"{second_name}{more if len(wrong) > 1 else ''}; correct one"
            )


def _foreign_notes(side: Side, truths: set[str]) -> list[str]:
    """A sentence on predictions that are no truth.

    Raises:
        InputError: one may be a truth, spelt differently, or none of the predictions is a truth.
    """
    counts: Counter[str] = Counter()
    for label, count in Counter(side.rows["prediction"]).items():
        for one in [label] if label in truths else label.split(" / "):  # of a tied vote
            counts[one] += count
    del counts[scores.ABSTAINED]
    foreign = {name: count for name, count in counts.items() if name not in truths}
    for name, count in foreign.items():
        if other := known_spelling(name, truths):
            raise InputError(
                f"{side.name}: prediction {name!r} ({count}x) may be the truth {other!r}, spelt "
                "differently; write predictions as the truth is written"
            )
    if not foreign:
        return []
    words = first_names([f"{name!r} ({count}x)" for name, count in foreign.items()])
    if len(foreign) == len(counts):
        raise InputError(
            f"{side.name} predicts {words}, which no capture has as truth (such as "
            f"{min(truths)!r}); write predictions as the truth is written"
        )
    return [f"{side.name} predicts {words}, which no capture has as truth; these are wrong."]


def _right_alone(captures: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """Which captures only the first and only the second system gets right, by most of its seeds."""
    first_right, second_right = (captures[column] > 0.5 for column in ("right", "other_right"))
    return first_right & ~second_right, second_right & ~first_right


def _compare_gestures(
    captures: pd.DataFrame, first_rows: pd.DataFrame, second_rows: pd.DataFrame
) -> pd.DataFrame:
    """The comparison of each gesture."""
    people = [
        100 * rows.groupby(["truth", "subject"])["right"].mean()
        for rows in (first_rows, second_rows)
    ]
    rows = []
    for gesture, each in captures.groupby("truth"):
        first, second = (accuracy[gesture] for accuracy in people)
        row = {"gesture": gesture, "captures": len(each)}
        row |= {"accuracy": first.mean(), "other_accuracy": second.mean()}
        test = statistics.paired_test(first, second)
        row |= {name: test[name] for name in ("difference", "low", "high")}
        row["only"], row["other_only"] = map(sum, _right_alone(each))
        rows.append(row)
    return pd.DataFrame(rows)


def _list_ids(ids: list[str] | pd.Index) -> str:
    """The first ids of captures, and how many more there are."""
    more = f" and {len(ids) - SHOWN} more" if len(ids) > SHOWN else ""
    return ", ".join(ids[:SHOWN]) + more


def side_of_file(path: Path, name: str = "") -> Side:
    """The predictions of a CSV or parquet file; ``name`` replaces the name of the file."""
    name = name or file_name(path)
    if path.suffix.lower() != ".parquet":
        return side_of_table(CsvTable(path, name, counts=()), name)
    try:
        return side_of_table(table_from_parquet(path), name)
    except InputError:
        raise
    except Exception as e:  # pyarrow raises a dozen types for damaged bytes
        raise InputError(
            f"{name}: not a readable parquet file ({one_line(e)}); save it again"
        ) from e


def side_of_frame(frame: pd.DataFrame, name: str) -> Side:
    """The predictions of a table in memory."""
    check_columns([*map(str, frame)], COLUMNS, name)
    return side_of_table(table_from_pandas(frame[COLUMNS], name), name)


def side_of_table(table: Table, name: str) -> Side:
    """The label of each capture: that of its row, or the majority vote of its rows."""
    rows = _read_rows(table)
    by_id = rows.groupby("id", sort=False)
    for column in ("truth", "subject"):
        counts = by_id[column].nunique()
        for capture in counts.index[counts > 1]:
            values = " and ".join(map(repr, rows[column][rows["id"] == capture].unique()[:2]))
            raise InputError(
                f"{name}: capture {capture} has {values} as {column}; correct its rows"
            )
    predicted = rows[rows["prediction"] != scores.ABSTAINED]
    votes = predicted.groupby(["id", "prediction"], sort=False).size()
    most = votes[votes == votes.groupby(level="id").transform("max")].reset_index()
    captures = by_id[["subject", "truth"]].first()
    truth = captures["truth"].reindex(most["id"]).to_numpy()
    most["right"] = most["prediction"].to_numpy() == truth
    voted = most.groupby("id", sort=False)
    captures["prediction"] = voted["prediction"].agg(" / ".join)
    captures["right"] = voted["right"].mean()
    sizes, ties = by_id.size(), voted.size()
    special = {
        "several rows; the label is their majority vote": sizes.index[sizes > 1],
        "a tied vote, which counts as the share of its labels that is right": ties.index[ties > 1],
        "no prediction, which counts as wrong": captures.index[captures["prediction"].isna()],
    }
    notes = [
        f"{name} has {format_count(len(ids), 'capture')} ({_list_ids(ids)}) with {words}."
        for words, ids in special.items()
        if len(ids)
    ]
    captures = captures.fillna({"prediction": scores.ABSTAINED, "right": 0.0})
    return Side(name, captures.reset_index(), notes=notes)


def _read_rows(table: Table) -> pd.DataFrame:
    """The columns `COLUMNS` as text; only the prediction may be missing."""
    check_columns(table.columns, COLUMNS, table.header_prefix)
    blocks, first = [], table.first
    for batch in table.read_batches([]):
        columns = {}
        for name in COLUMNS:
            cells = batch.column(table.columns.index(name)).cast(pa.string())
            optional = name == "prediction"
            columns[name] = np.asarray(
                text_categories(cells, name, table.row_prefix, first, optional)
            )
        blocks.append(pd.DataFrame(columns))
        first += len(batch)
    if not blocks:
        raise InputError(
            f"{table.header_prefix}: there are no predictions in it; give a row for each capture"
        )
    return pd.concat(blocks, ignore_index=True)


def side_of_runs(results: Sequence[Result], name: str, on: str) -> Side:
    """Labels of whole captures that the runs of one system predicted."""
    parts = [scores.label_captures(r.tables["predictions"]) for r in results]
    rows = pd.concat(parts).sort_values("capture", kind="stable")
    rows = rows.astype({"capture": str, "subject": str})
    rows = rename_labels(rows)
    right = (rows["truth"] == rows["prediction"]).astype(float)
    return Side(name, rows[COLUMNS].assign(right=right), on, stale_sentences(results))


def find_runs(name: str, results: Sequence[Result]) -> list[Result]:
    """The complete runs on captures with a name of ``bench runs``, an id, or its unique beginning.

    Raises:
        InputError: no such run exists, or several ids begin like this.
    """
    labels = name_rows(results)
    pairs = zip(results, labels, strict=True)
    runs = [r for r, label in pairs if name in (label, r.system)]
    runs = runs or [r for r in results if name == r["system"]]  # without the marks of tables
    if not runs:
        runs = [r for r in results if str(r["run_id"]).startswith(name)]
        if len(runs) > 1:
            raise InputError(f"{name}: {len(runs)} run ids begin like this; give more letters")
    complete = [r for r in results_on_captures(runs) if r.is_complete]
    if not complete:
        raise InputError(
            f"no file and no complete run is called {name!r}; give a CSV or parquet file, or the "
            "id or name of a run as bench runs prints it"
        )
    return [r for r in complete if r.system == complete[0].system]


def sides_of_runs(runs_by_name: Mapping[str, Sequence[Result]]) -> dict[str, Side]:
    """The sides of one or two systems by name, on the captures and under the protocol they share.

    Raises:
        InputError: they share none, or several.
    """
    runs_by_setting = [{r.values_to_agree: r for r in runs} for runs in runs_by_name.values()]
    first, last = runs_by_setting[0], runs_by_setting[-1]
    shared = [setting for setting in first if setting in last]
    shared = [setting for setting in shared if not first[setting].is_stale] or shared
    contexts = [*group_results([first[setting] for setting in shared])]
    words = " and ".join(runs_by_name)
    if not shared:
        each = [f"{name} on {', '.join(runs[0].context)}" for name, runs in runs_by_name.items()]
        raise InputError(
            f"{words} share no data, subset and protocol: {'; '.join(each)}; "
            "run one of them where the other was run"
        )
    if len(shared) > 1:
        raise InputError(
            f"{words}: there are runs on {'; '.join(contexts)}; name one with data=, where=, "
            "target= or protocol="
        )
    runs = [[r for r in each if r.values_to_agree == shared[0]] for each in runs_by_name.values()]
    labels = name_rows([each[0] for each in runs])
    return {
        name: side_of_runs(each, label, contexts[0])
        for name, each, label in zip(runs_by_name, runs, labels, strict=True)
    }
