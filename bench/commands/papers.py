"""The command ``bench papers``: every published number and the command that repeats it here."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bench.commands.printing import then
from bench.errors import InputError
from bench.registry import names
from bench.reports.comparison import published
from bench.words import quoted

Published = Any  # a row of published.csv, with an attribute per column
UNREAD = {"abstract-only", "unknown", "not-a-target"}


def papers(arguments: list[str]) -> int:
    """Print id, published accuracy and command of every row of ``published.csv``, paper by paper.

    Raises:
        InputError: there are arguments.
    """
    if arguments:
        raise InputError(f"bench papers takes no arguments, not {arguments[0]!r}; leave it out")
    rows = published()
    rows = rows.assign(command=[command(row) for row in rows.itertuples()])
    for reference, part in rows.groupby("reference", sort=False):
        print(f"\n{reference}")
        for row in part.itertuples():
            print(f"  {_number(row)}  {row.id}\n    {row.command}")
    repeatable = int((rows["command"].str[:1] != "-").sum())
    print(f"\n{len(rows)} published numbers, in percent, ± SD over subjects; {repeatable} have a command.")
    print("Data, subset and unit of each: reports/published.csv")
    then("bench report")
    return 0


def command(row: Published) -> str:
    """The command that repeats one published number, or why there is none."""
    if row.system not in names("models"):
        if row.id.startswith("saadun"):
            return "- not included: a network that was trained on photographs"
        return "- the paper describes too little to build it" if row.confidence in UNREAD else "- not included yet"
    if row.protocol_key == "other":
        return f"- protocol not published; the system is model={row.system}"
    parts = ["bench run", f"data={row.data}"]
    if row.subset_key != "all":
        parts.append("where=" + quoted(row.subset_key))
    if row.target_key != "gesture":
        parts.append(f"target={row.target_key}")
    return " ".join([*parts, f"protocol={row.protocol_key}", f"model={row.system}"])


def _number(row: Published) -> str:
    if pd.isna(row.accuracy):
        return "-"
    return f"{row.accuracy:g}" + ("" if pd.isna(row.sd) else f" ± {row.sd:g}")
