"""Of ``bench choose``: groups of gestures that a system can tell apart (``groups=yes``)."""

from __future__ import annotations

from statistics import mean

import pandas as pd

from bench.commands.printing import print_lines, print_next_commands, results_console
from bench.errors import InputError
from bench.grammar.options import BATCH, STORED_OPTIONS, typed_settings
from bench.ground.typed import Values
from bench.reading.candidates import comparable_runs
from bench.reading.captures import stale_sentences
from bench.reading.frame import choose_command
from bench.reading.groups import Grouping, accuracy_by_grouping, reactions_table
from bench.reading.runs import load_results_on_captures, parse_selection, warn_of_missing_runs
from bench.store.client import connect
from bench.values.few import FEWEST_FOR_INTERVAL, too_few_sentence
from bench.values.measures import Measure, text_measure
from bench.values.result import MIXED_NOTE, Result
from bench.values.table import Table, rows_of_frame

KEYS = {option.key for option in (*STORED_OPTIONS, BATCH)}
LEVELS = (90, 95, 99)  # percent
ACCURACY = Measure("accuracy", "accuracy %", ends="accuracy")
COLUMNS = (
    Measure("groups", form=".0f"),
    text_measure("grouping", "gestures in one group", lambda row: _format_groups(row["grouping"])),
    ACCURACY,
    Measure("largest", "largest group %"),
    Measure("same", "same choice", lambda row: f"{row['same']} of {row['subjects']}"),
)


def print_groups(values: Values) -> int:
    """Print accuracy by number of groups, with a table ``[reactions]`` for 90, 95 and 99 %."""
    typed = {key: value for key, value in values.items() if key != "groups"}
    table, title, notes, results = find_groups(typed)
    rows = rows_of_frame(table.rename(columns={"low": "accuracy_low", "high": "accuracy_high"}))
    title += "; accuracy is the mean over subjects with its 95 % t-interval"
    Table(COLUMNS, rows, title).print(results_console())
    print_lines(
        "The groups of each subject are chosen on the other subjects. "
        "same choice: subjects with the groups above.",
        "largest group: accuracy of always naming the largest group.",
    )
    people = int(table["subjects"].iloc[0])
    if people < FEWEST_FOR_INTERVAL:
        print_lines(f"{too_few_sentence(people)}.")
    print_lines(*notes)
    reached = {}
    for level in LEVELS:
        good_rows = [row for row in rows if round(row["accuracy"], 9) >= level]
        if not good_rows:
            print_lines(f"{level} %: not even two groups reach it.")
            continue
        row = good_rows[0]
        print_lines(f"{level} %: {row['groups']} groups reach {ACCURACY.as_text(row)} %.")
        if row is not rows[0]:
            reached[row["groups"]] = row
    for count, row in reached.items():
        heading = f"# {count} groups: {ACCURACY.as_text(row)} %"
        print_lines("", heading, reactions_table(row["grouping"]))
    print_next_commands(choose_command(results))
    return 0


def find_groups(values: Values) -> tuple[pd.DataFrame, str, list[str], list[Result]]:
    """Find groups of gestures for the most accurate stored system, with all its seeds.

    Returns:
        `accuracy_by_grouping`, the captures and the system in words, notes, and the runs.
    """
    for key in values:
        if key not in KEYS and "." not in key:
            raise InputError(f"{key}= has no effect on groups; leave {key}= out")
    selection = parse_selection(values)
    results = load_results_on_captures(connect())
    warn_of_missing_runs(results, selection)
    is_batch = typed_settings("choose", values)["batch"]
    results, notes = comparable_runs(results, selection, batch=is_batch)
    runs_by_system: dict[str, list[Result]] = {}
    for result in sorted(results, key=lambda result: result["system"]):
        runs_by_system.setdefault(result["system"], []).append(result)
    runs = max(runs_by_system.values(), key=lambda runs: mean(r["accuracy"] for r in runs))
    if runs[-1].mixes_subjects:
        notes = [*notes, MIXED_NOTE]
    notes = [*stale_sentences(runs), *notes]
    predictions = [r.tables["predictions"].assign(seed=r["seed"]) for r in runs]
    title = f"{', '.join(runs[-1].context)}; {runs[-1].system}"
    return accuracy_by_grouping(pd.concat(predictions, ignore_index=True)), title, notes, runs


def _format_groups(grouping: Grouping) -> str:
    """The groups of several gestures."""
    groups = [" + ".join(group) for group in grouping if len(group) > 1]
    return "; ".join(groups) or "every gesture alone"
