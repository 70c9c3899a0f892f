"""The command ``bench compare``: two systems on the same captures, of files, tables or stored runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import COMPARE, STORED, Command, Option, keys, parse_words, values_of
from bench.grammar.options import KEYS as RUN_KEYS
from bench.ground.words import Values, items
from bench.values.measures import Measure, text

if TYPE_CHECKING:
    from bench.reading.compare import Compared, Side

COMMAND = Command(
    COMPARE,
    "compare two systems on the same captures: files of predictions or stored runs",
    "A and B are each a CSV or parquet file, a stored system (its name as in tables) or the id of a stored run. A file "
    "has the columns id, subject, truth and prediction. Several rows of an id vote. Captures are matched by id. The id "
    "in stored runs is the place of the capture in the corpus, from 0. Prints the paired difference over subjects with "
    "its interval and test. It also prints the smallest difference that these subjects can show, each gesture, and the "
    "captures that only one system classifies correctly. The keys of bench run, run= and latest=yes select the stored "
    "runs.",
    'bench compare mine.csv theirs.parquet\nbench compare mine.csv "svm touch" data=haart protocol=loso',
    "A B [key=value ...]",
    options=(
        *STORED,
        Option("out", "text", "", "CSV file for all captures with the predictions of both systems"),
    ),
)
GESTURES = (
    text("gesture"),
    Measure("captures", form=".0f"),
    Measure("accuracy", "A %"),
    Measure("other_accuracy", "B %"),
    Measure("difference", "A - B", form="+.1f", ends="difference"),
    Measure("only", "only A right", form=".0f"),
    Measure("other_only", "only B right", form=".0f"),
)
GROUP = ("data", "where", "target", "protocol")  # keys that a system may come with


def command(arguments: list[str]) -> int:
    """Print how two systems differ, and write their captures."""
    from bench.commands.printing import output, say, unwritable
    from bench.ground.scratch import replacing
    from bench.values.table import Table, rows_of, write_sheet

    words, values = parse_words(arguments, keys("compare"), 2)
    if len(words) < 2:
        raise InputError(
            "give two files, systems or runs: bench compare A B; see bench compare --help"
        )
    out = values.pop("out", "")
    result = paired(words, values)
    say(*repr(result).splitlines())
    rows = rows_of(
        result.gestures.rename(columns={"low": "difference_low", "high": "difference_high"})
    )
    title = f"A: {result.system}; B: {result.other}; means over subjects, not corrected for several gestures"
    Table(GESTURES, rows, title).print(output())
    if out:
        with unwritable(Path(out)), replacing(Path(out)) as beside:
            write_sheet(result.captures, beside)
        say(f"{out}: {len(result.captures)} captures")
    return 0


def paired(given: Sequence[object], values: Values) -> Compared:
    """Two systems, each a table, a file, the name of a stored system, its values, or the id of a run."""
    from bench.reading.compare import compared, stored_sides
    from bench.reading.frame import grouped
    from bench.reading.runs import asked_of, selected, stored
    from bench.store.client import connect

    typed = values_of(values, {option.key for option in STORED})
    sides = _files(given)
    if typed and all(sides):
        raise InputError(
            f"{next(iter(typed))}= selects stored runs, and both are files; leave it out"
        )
    named = []
    if not all(sides):
        every = selected(stored(connect()), asked_of(typed))
        for one, side in zip(given, sides, strict=True):
            if side is None:
                about = values_of(one, RUN_KEYS) if isinstance(one, Mapping) else {}
                on = {key: items(key, about.pop(key)) for key in GROUP if key in about}
                groups = {group: selected(members, on) for group, members in grouped(every).items()}
                named.append(
                    (
                        _system(about) if about else str(one),
                        {k: held for k, held in groups.items() if held},
                    )
                )
    from_store = iter(stored_sides(named) if named else ())
    one, other = (side or next(from_store) for side in sides)
    return compared(one, other)


def _files(given: Sequence[object]) -> list[Side | None]:
    """The sides that are tables or files; None for stored systems."""
    import pandas as pd

    from bench.reading.compare import of_file, of_frame

    sides: list[Side | None] = []
    names = [Path(one).name if isinstance(one, str | Path) else "" for one in given]
    for one, name, title in zip(given, names, ("the first table", "the second table"), strict=True):
        if isinstance(one, pd.DataFrame):
            sides.append(of_frame(one, title))
        elif isinstance(one, Path) or (
            isinstance(one, str)
            and (one.lower().endswith((".csv", ".parquet")) or Path(one).is_file())
        ):
            sides.append(of_file(Path(one), str(one) if names.count(name) > 1 else ""))
        else:
            sides.append(None)
    return sides


def _system(values: dict[str, object]) -> str:
    """The name of the one system that some values mean."""
    from bench.plan.cells import cells

    systems = {cell.system() for cell in cells(values)}
    if len(systems) > 1:
        raise InputError(f"{values} describe {len(systems)} systems; give one")
    return systems.pop()
