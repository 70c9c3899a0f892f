"""What a protocol adds: systems under every protocol that was run, and published numbers without what theirs adds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.ground.words import typed
from bench.reading import statistics
from bench.reading.frame import by_subject
from bench.reports.comparison import ROWS, published
from bench.reports.contexts import METHODS, Part, Section, scarce
from bench.reports.curves import curves
from bench.reports.figures import save
from bench.values.measures import CODE, Measure, p_value, text
from bench.values.result import COMPARABLE, Result, notes_on
from bench.values.sentences import sentences
from bench.values.table import Table, rows_of

BASE = "loso"  # what points are over
USUAL = ("windows", "kfold", "within", BASE)  # protocols of a whole ledger
COLUMNS = (
    text("protocol"),
    Measure("accuracy", "accuracy % [95 %]", ends="accuracy"),
    Measure("points", "points over LOSO [95 %]", form="+.1f", ends="points"),
    Measure("p", "p Wilcoxon", form=p_value, spare=1),
    text("place"),
    Measure("subjects", form=".0f"),
)
PRINTED = (
    text("number"),
    Measure("printed", "printed %", form="g"),
    text("says", "protocol in the paper"),
    text("nearest", "nearest of ours"),
    Measure("points", "points of the protocol [95 %]", form="+.1f", ends="points"),
    Measure("less", "printed less points"),
)
NAMES = "data subset system protocol key mixes_subjects accuracy accuracy_low accuracy_high points".split()
NAMES += "points_low points_high p place subjects".split()  # columns of `ledger`
Under = dict[
    str, tuple[Result, pd.DataFrame]
]  # by protocol: a run, and accuracy in percent [systems, subjects]


def sets_of(results: Sequence[Result]) -> list[list[Result]]:
    """Complete runs on the same captures under two protocols or more, a list for each set of captures."""
    key = lambda r: tuple(str(r.get(name, "")) for name in ("synthetic", *COMPARABLE[:-1]))  # noqa: E731
    usable = sorted((r for r in results if r.complete and r.alone), key=key)
    sets = [[*members] for _, members in groupby(usable, key)]
    return [members for members in sets if len({r["protocol_label"] for r in members}) > 1]


def under(members: Sequence[Result]) -> Under:
    """The first run under each protocol and accuracies of people, the highest mean accuracy first."""
    runs: dict[str, list[Result]] = {}
    for r in members:
        runs.setdefault(str(r["protocol_label"]), []).append(r)
    found = [(label, each[0], by_subject(each)[0]) for label, each in runs.items()]
    full = sorted(
        (one for one in found if one[2].size), key=lambda one: -one[2].to_numpy(float).mean()
    )
    return {
        label: (first, table) for label, first, table in full
    }  # a table may be gone from the store


def gains(table: pd.DataFrame, base: pd.DataFrame) -> pd.DataFrame:
    """Points over the base, of the systems and people of both [systems, subjects]."""
    systems, people = table.index.intersection(base.index), table.columns.intersection(base.columns)
    return (table.loc[systems, people] - base.loc[systems, people]).round(9)


def base_of(tables: Under) -> pd.DataFrame:
    """Accuracies under LOSO; an empty table if it was not run."""
    return next(
        (table for first, table in tables.values() if first["protocol_name"] == BASE),
        pd.DataFrame(),
    )


def ledger(results: Sequence[Result]) -> pd.DataFrame:
    """Each system under each protocol that was run, on captures with runs under two protocols or more.

    Returns:
        A row per captures, system and protocol, in percent: ``accuracy``, the mean over subjects with its 95 %
        t-interval (``accuracy_low``, ``accuracy_high``); ``points`` over LOSO, the mean paired difference over the
        subjects of both, with ``points_low``, ``points_high`` and ``p`` (two-sided Wilcoxon test); ``place`` of the
        system under this protocol; ``subjects``; ``mixes_subjects``. NaN where LOSO was not run.
    """
    parts = [_rows(members, under(members)) for members in sets_of(results)]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=NAMES)


def _rows(members: Sequence[Result], tables: Under) -> pd.DataFrame:
    """The rows of one set."""
    rows = []
    base, (data, subset, _) = base_of(tables), members[0].context
    for label, (first, table) in tables.items():
        about = {"data": data, "subset": subset, "protocol": label, "key": first["protocol"]}
        about |= {"mixes_subjects": first.mixed}
        points = gains(table, base)
        for place, (system, people) in enumerate(table.iterrows(), 1):
            low, high = np.clip(statistics.interval(people.to_numpy(float)), 0, 100)
            row = about | {
                "system": system,
                "accuracy": people.mean(),
                "accuracy_low": low,
                "accuracy_high": high,
            }
            row |= {"place": f"{place} of {len(table)}", "subjects": len(people)}
            if system in points.index and len(points.columns) and table is not base:
                tested = statistics.paired(points.loc[system], 0 * points.loc[system])
                names = {
                    "points": "difference",
                    "points_low": "low",
                    "points_high": "high",
                    "p": "p",
                }
                row |= {name: tested[key] for name, key in names.items()}
            rows.append(row)
    return pd.DataFrame(rows).reindex(columns=NAMES)


def printed_on(data: str) -> pd.DataFrame:
    """Published numbers on a corpus, with the nearest of our protocols in ``key``; empty for an unknown one."""
    papers = published()
    papers = papers[(papers["data"] == data) & papers["accuracy"].notna()]
    return papers.assign(
        key=papers["protocol_key"].where(papers["protocol_key"] != "other", papers["nearest_key"])
    )


def explained(members: Sequence[Result], tables: Under) -> pd.DataFrame:
    """Published numbers on the captures of a set, a row each, with the points over LOSO of the nearest protocol.

    These are the mean of all systems of the set that were run under both, with a 95 % t-interval over people: 0 for
    LOSO, NaN where the protocol of a number is unknown or was not run. No rows without runs under LOSO.
    """
    base, found = base_of(tables), {BASE: (0.0, np.nan, np.nan)}
    if base.empty:
        return pd.DataFrame()
    for first, table in tables.values():
        if first["protocol_name"] != BASE and (points := gains(table, base)).size:
            people = points.mean(axis=0).to_numpy(float)
            found.setdefault(
                first["protocol_name"], (float(people.mean()), *statistics.interval(people))
            )
    rows = []
    for paper in printed_on(members[0]["data"]).itertuples():
        key, stated = paper.key, paper.protocol_key != "other"
        points, low, high = found.get(key, (np.nan,) * 3)
        nearest = (
            f"{key}{'' if stated else ' (inferred)'}{'' if key in found else ', not run'}"
            if key
            else "unknown"
        )
        row = {
            "id": paper.id,
            "number": f"{paper.reference}: {paper.classifier}",
            "printed": paper.accuracy,
        }
        row |= {
            "says": paper.protocol,
            "nearest": nearest,
            "points": points,
            "less": paper.accuracy - points,
        }
        rows.append(row | {"points_low": low, "points_high": high})
    return pd.DataFrame(rows)


def share(printed: pd.Series, left: pd.Series) -> float:
    """Share of the variance of some numbers that is not in what is left of them; NaN for fewer than three."""
    return 1 - float(left.var() / printed.var()) if len(printed) > 2 else np.nan


def told(numbers: pd.DataFrame, beside: pd.DataFrame, data: str) -> list[str]:
    """Sentences on how much of the spread of published numbers is explained: by protocols, and by runs of ours."""
    known = numbers[numbers["points"].notna()]
    both = beside[(beside["data"] == data) & beside["ours"].notna()].drop_duplicates("id")
    off = both["published"] - both["ours"]
    total = float(((both["published"] - both["published"].mean()) ** 2).sum())
    return sentences(
        *("bench.reports", "sentences", "explained"),
        known=known["printed"],
        share=share(known["printed"], known["less"]),
        unknown=int((numbers["nearest"] == "unknown").sum()),
        not_run=int(numbers["nearest"].str.endswith("not run").sum()),
        ours=len(both) if len(both) > 2 else 0,
        own=1 - float((off**2).sum()) / total if total else np.nan,
        off=float(off.abs().mean()),
    )


def missing(members: Sequence[Result]) -> list[str]:
    """Commands that run what some system of a set lacks: one, if all systems share command and other arguments.

    Wanted are the protocols of a whole ledger, of other systems of the set, and of published numbers on its captures.
    """
    alike: dict[tuple[str, str], list[Result]] = {}
    for r in members:
        if arguments := r.get("touchbench.arguments"):
            other = {
                k: v
                for k, v in json.loads(arguments).items()
                if k != "model" and not k.startswith("protocol")
            }
            alike.setdefault((str(r["touchbench.command"]), json.dumps(other)), []).append(r)
    wanted = [
        *USUAL,
        *(str(r["protocol_name"]) for r in members),
        *printed_on(members[0]["data"])["key"],
    ]
    names, commands = dict.fromkeys(filter(None, wanted)), []
    for (command, other), runs in alike.items():
        models = dict.fromkeys(str(r["model_name"]) for r in runs)
        done = {
            name: {r["model_name"] for r in runs if r["protocol_name"] == name} for name in names
        }
        if lacking := [name for name, had in done.items() if had != {*models}]:
            words = json.loads(other)
            words = {
                "data": words.pop("data"),
                "protocol": ",".join(lacking),
                "model": ",".join(models),
            } | words
            commands.append(typed(command, words))
    return commands


def slopes(rows: pd.DataFrame, title: str) -> Figure:
    """Accuracy under each protocol, a line per system, with intervals; lines cross where the order changes."""
    names = [*dict.fromkeys(rows["protocol"])]
    systems = [
        *dict.fromkeys(rows.sort_values("accuracy", ascending=False, kind="stable")["system"])
    ][:METHODS]
    lines = []
    for i, system in enumerate(systems):
        own = (
            rows[rows["system"] == system].set_index("protocol").reindex(names)
        )  # NaN interrupts the line
        place = np.arange(len(names)) + 0.05 * (i - (len(systems) - 1) / 2)
        ends = (own[name] / 100 for name in ("accuracy", "accuracy_low", "accuracy_high"))
        lines.append(
            (
                i,
                system,
                pd.DataFrame(
                    dict(zip(("level", "accuracy", "low", "high"), (place, *ends), strict=True))
                ),
            )
        )
    figure = curves("", lines, title=title, inches=1.5 * len(names))
    keys = dict(zip(rows["protocol"], rows["key"], strict=True))
    mixed = dict(zip(rows["protocol"], rows["mixes_subjects"], strict=True))
    marks = [
        "optimistic" if "optimistic" in n else "subjects mixed" if mixed[n] else "new subjects"
        for n in names
    ]
    figure.axes[0].set_xticks(
        range(len(names)), [f"{keys[n]}\n{mark}" for n, mark in zip(names, marks, strict=True)]
    )
    return figure


def section(
    results: Sequence[Result], beside: pd.DataFrame, folder: Path
) -> tuple[list[Section], pd.DataFrame]:
    """The section of the page, if some captures have runs under two protocols or more, and all rows of `ledger`.

    Args:
        results: runs on captures.
        beside: published numbers beside ours (`bench.reports.papers.against`).
        folder: folder for figures.
    """
    parts, every = [], [pd.DataFrame(columns=NAMES)]
    for i, members in enumerate(sets_of(results), 1):
        tables, (data, subset, _) = under(members), members[0].context
        every.append(rows := _rows(members, tables))
        words = data + f", {subset}" * (subset != "all")
        everywhere = rows[
            rows.groupby("system")["key"].transform("size") == rows["protocol"].nunique()
        ]
        first = everywhere.loc[everywhere.groupby("protocol", sort=False)["accuracy"].idxmax()]
        told_of = {
            "systems": everywhere["system"].nunique(),
            "windows": rows["key"].str.startswith("windows").any(),
        }
        best = dict(zip(first["key"], first["system"], strict=True))
        lines = sentences(*("bench.reports", "sentences", "ledger"), best=best, **told_of)
        known = bool(rows["accuracy_low"].notna().any())
        caption = f"{words}: accuracy under each protocol, mean over subjects{' with 95 % t-intervals' * known}."
        picture = save(slopes(rows, words), folder, f"0-protocols-{i}", words, caption)
        first = [*dict.fromkeys(rows["system"])][
            : max(1, ROWS // len(tables))
        ]  # most accurate under one protocol
        rows = rows[rows["system"].isin(first)].sort_values("system", kind="stable")
        remarks = [notes_on(system, data) for system in rows["system"]]
        shown = Table(COLUMNS, rows_of(rows), remarks=remarks, groups=[*rows["system"]])
        caption = f"{words}: systems under each protocol; points are paired over the subjects of both protocols."
        caption += " protocols.csv has all systems." * (len(rows) < len(every[-1]))
        parts.append(Part(picture, shown, caption, [*lines, *scarce(members)]))
        if commands := missing(members):
            rows_left = [{"command": command} for command in commands]
            parts.append(
                Part(
                    None,
                    Table([Measure("command", form=CODE)], rows_left),
                    f"{words}: not run yet.",
                )
            )
        if len(numbers := explained(members, tables)) and members[0]["synthetic"] != "true":
            caption = f"{words}: published numbers and the points over LOSO that their protocol alone adds to our systems."
            parts.append(
                Part(
                    None,
                    Table(PRINTED, rows_of(numbers)),
                    caption,
                    told(numbers, beside, members[0]["data"]),
                )
            )
    sections = (
        [Section("What a protocol adds", parts, "the same systems under several protocols")]
        if parts
        else []
    )
    return sections, pd.concat(every[bool(parts) :], ignore_index=True)
