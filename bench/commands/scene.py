"""The command ``bench scene``: groups of gestures that can be told apart, from stored predictions."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bench.arguments import Values, items, parse, setting
from bench.commands.choose import AMONG
from bench.commands.printing import grid, output, say, then, unwritable, writable
from bench.comparable import MIXED, Row, context_of, facts_of, system_of
from bench.errors import InputError
from bench.options import keys
from bench.outcomes.candidates import eligible
from bench.outcomes.groups import LEVELS, Grouping, enough, groupings, reactions
from bench.outcomes.runs import needed, rows_of, tracked, without_runs
from bench.outcomes.store import connect
from bench.progress import warn


def scene(arguments: list[str]) -> int:
    """Print accuracy against the number of groups, with a table ``[reactions]`` for 90, 95 and 99 %, and draw it.

    Raises:
        InputError: something in the arguments cannot be used, or no run is stored for them.
    """
    values = parse(arguments, keys("scene"))
    table, title, notes = grouped(values)
    out = writable(Path(str(values.get("out", "scene"))))
    found = rows_of(table)
    rows = [
        {
            "groups": f"{row['groups']}",
            "gestures in one group": _words([g for g in row["grouping"] if len(g) > 1]) or "every gesture alone",
            "accuracy %": _accuracy(row),
            "largest group %": f"{row['largest']:.1f}",
            "same choice": f"{row['same']} of {row['subjects']}",
        }
        for row in found
    ]
    grid(
        output(),
        f"{title}; accuracy is the mean over subjects with its 95 % interval",
        rows,
        ("gestures in one group",),
    )
    say(
        "The groups of each subject are chosen on the other subjects. same choice: subjects with the groups above.",
        "largest group: accuracy of always naming the largest group.",
        *notes,
    )
    reached = {level: enough(table, level) for level in LEVELS}
    for level, index in reached.items():
        how = "not even two groups reach it."
        if index is not None:
            row = found[index]
            how = f"{row['groups']} groups reach {_accuracy(row)} %."
        say(f"{level} %: {how}")
    for index in dict.fromkeys(i for i in reached.values() if i):  # 0 is every gesture alone
        row = found[index]
        say("", f"# {row['groups']} groups: {_accuracy(row)} %", reactions(row["grouping"]))
    from bench.table import write_sheet
    from reports.dendrogram import draw  # loads all plotting

    with unwritable(out):
        write_sheet(table.assign(grouping=table["grouping"].map(_words)), out / "groups.csv")
        paths = [out / "groups.csv", *draw(table, out, title).paths]
    say("", f"table and figure: {', '.join(map(str, paths))}")
    then("bench choose")
    return 0


def grouped(values: Values) -> tuple[pd.DataFrame, str, list[str]]:
    """Groups for the most accurate stored system; all its seeds are used.

    Returns:
        Table of `bench.outcomes.groups.groupings`; captures, protocol and system in words; limits in sentences.

    Raises:
        InputError: something in the values cannot be used, or no run is stored for them.
    """
    if dotted := [k for k in values if "." in k and not k.startswith("protocol.")]:
        raise InputError(f"{dotted[0]}= runs a system, and bench scene reads stored runs; leave {dotted[0]}= out")
    asked = {k: items(k, v) for k, v in values.items() if k in AMONG or k.startswith("protocol.")}
    store = connect()
    stored = tracked(store)
    for lacking in without_runs([stored], asked):
        warn(f"warning: {lacking}: no run is stored")
    runs, notes = eligible([stored], asked, batch=bool(setting("scene", "batch", values)))
    best = runs.groupby("system")["subject_accuracy_mean"].mean().idxmax()
    seeds = rows_of(runs[runs["system"] == best])
    if facts_of(seeds[-1]).mixes_subjects:
        notes = [*notes, MIXED]
    tables = [pd.read_parquet(needed(store, run, "predictions.parquet")).assign(seed=run["seed"]) for run in seeds]
    title = f"{', '.join(context_of(seeds[-1]))}; {system_of(seeds[-1])}"
    return groupings(pd.concat(tables, ignore_index=True)), title, notes


def _words(grouping: Grouping | list[tuple[str, ...]]) -> str:
    return "; ".join(" + ".join(group) for group in grouping)


def _accuracy(row: Row) -> str:
    return f"{row['accuracy']:.1f} [{row['low']:.1f}, {row['high']:.1f}]"
