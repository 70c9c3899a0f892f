"""The results of `bench stress` to read: tables in text for the console and markdown, CSV files and figures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from bench import scores
from bench.comparable import notes_on
from bench.errors import InputError
from bench.measures import Measure, percent, text
from bench.reports import stability_figures as figures
from bench.reports.layout import markdown
from bench.reports.numbers import noted
from bench.result import Result
from bench.sentences import sentences
from bench.table import Table, of_text, rows_of, write_sheet
from bench.usual import CLEAN
from bench.work.curves import joined, unharmed
from bench.work.stability import ALPHA, FAMILIES, families, learning, ranks, seeds

TOP = 10  # rows of a table
SEEDS = (
    text("system"),
    text("seeds"),
    *(percent(name) for name in ("accuracy", "sd", "lowest", "highest")),
    Measure("changed", read=lambda r: f"{r['changed']} of {r['captures']} ({100 * r['share_changed']:.1f} %)"),
)
SLICES = (
    text("slice", "group"),
    Measure("right", read=lambda r: f"{r['right']} of {r['captures']}"),
    Measure("subjects", form=".0f"),
    percent("accuracy"),
    percent("gap", "below system by"),
    Measure("p", form=".2g"),
    Measure("p_corrected", "corrected p", form=".2g"),
)


def write_all(results: Sequence[Result], out: Path) -> list[str]:
    """Write the tables and figures of each corpus, subset and protocol; lines that say where.

    Raises:
        InputError: the folder cannot be written.
    """
    groups: dict[tuple, list[Result]] = {}
    for r in results:
        groups.setdefault(r.comparable, []).append(r)
    folders: dict[Path, list[Result]] = {}
    for members in groups.values():
        folder = out
        if len(groups) > 1:
            name = re.sub(r"[^A-Za-z0-9]+", "-", " ".join(members[0].context)).strip("-").lower()
            folder = out / name if out / name not in folders else out / f"{name}-{len(folders) + 1}"
        folders[folder] = members
    lines = []
    for folder, members in folders.items():
        write(members, folder)
        title = ", ".join(members[0].context)
        words = "failing subjects, classes, conditions and faults, with figures"
        lines.append(f"{title}: {words}: {folder / 'stability.md'}")
    return lines


def write(results: Sequence[Result], folder: Path) -> list[Path]:
    """Write the tables as CSV, ``stability.md``, and the figures as SVG, for results of one context.

    Raises:
        InputError: the folder cannot be written.
    """
    files = {"faults": "faults", "half_margins": "margins", "conditions": "conditions", "slices": "slices"}
    tables = {name: joined(results, table) for name, table in files.items()}
    tables["learning"] = joined(results, "learning", lambda r: learning(r.tables["labels"]))
    tables |= {"ranks": _in_context(results[0], ranks(results)), "seeds": _in_context(results[0], seeds(results))}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("stability_*.[ps][nv]g"):  # of an earlier command
            old.unlink()
        paths = []
        for name, table in tables.items():
            paths.append(folder / f"stability_{name}.csv")
            write_sheet(noted(table), paths[-1])
        paths.append(folder / "stability.md")
        text = markdown("stability.jinja", context=", ".join(results[0].context), sections=sections(results))
        paths[-1].write_text(text, encoding="utf-8")
        return paths + figures.draw(results, folder)
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e.strerror}); choose another out=") from e


def _in_context(result: Result, table: pd.DataFrame) -> pd.DataFrame:
    about = dict(zip(("data", "subset", "protocol"), result.context, strict=True))
    return table.assign(**about)[[*about, *table.columns]]


def sections(results: Sequence[Result]) -> list[tuple[str, str, Table | None]]:
    """Heading, remark and table of everything that is shown to a reader, in percent and points."""
    parts = [
        (
            "Clean",
            f"Chance is the share of the most frequent class: {100 * results[0]['chance']:.1f} %.",
            _clean_table(results),
        )
    ]
    if len(table := _condition_table(results)):
        parts.append(("By class, condition and length", "Accuracy in percent; subjects are in the CSV.", table))
    under_faults = len(results[0].tables["faults"]) > 0
    if under_faults:
        note = "Accuracy in percent at severities 1 to 5, mean loss in points, and the lowest severity at which "
        note += "accuracy is significantly below that of the system."
        parts.append(("Worst faults", note, _worst_faults(results)))
        note = "Interpolated between severities 1 to 5; 0 means clean captures, >5 means never."
        parts.append(("Severity at which half of the margin over chance is lost", note, _half_table(results)))
    for r in results:
        slices = r.tables["slices"]
        faulty = slices["fault"] != ""
        parts.append((f"Failing groups: {r.method}", _tests_words(slices, ~faulty), _slice_table(slices, ~faulty)))
        if faulty.any():
            table = _slice_table(slices, faulty & ~_as_such(slices) & ~_before(slices))
            note = (
                "Each listed group fails at a severity at which all captures together do not; clean, it does not fail."
            )
            parts.append(
                (f"Groups that fail under a fault: {r.method}", f"{_tests_words(slices, faulty)} {note}", table)
            )
    if len(results) > 1 and under_faults:
        note = "By mean accuracy over severities; Kendall's tau compares the order with the clean one."
        parts.append(("Ranks", note, _rank_table(results)))
    if len(varied := seeds(results)):
        parts.append(("Seeds", "", Table(SEEDS, rows_of(varied))))
    if any("learning" in r.tables for r in results):
        parts.append(("Fewer training subjects", "", _learning_table(results)))
    return [(heading, note, table if len(table) else None) for heading, note, table in parts]


def _clean_table(results: Sequence[Result]) -> Table:
    columns = [
        text("system", read=lambda row: row["result"].method),
        Measure("units", "captures", form=".0f"),
        percent("accuracy", "accuracy [95 %]", ends="accuracy"),
    ]
    rows, names = [], {}
    for r in results:
        units = unharmed(r.tables["labels"])
        scored = scores.over_people(units)
        row = {"result": r, "units": len(units), "accuracy": scored["accuracy"]}
        row |= {f"accuracy_{side}": scored[side] for side in ("low", "high")}
        for factor, part in r.tables["conditions"].groupby("factor", sort=False):
            worst = part.loc[part["accuracy"].idxmin()]
            names[f"worst {factor}"] = None
            row[f"worst {factor}"] = f"{worst['value']}: {100 * worst['accuracy']:.1f}"
        rows.append(row)
    remarks = [notes_on(r.system, str(r["data"])) for r in results]
    return Table([*columns, *(text(name) for name in names)], rows, remarks=remarks)


def _condition_table(results: Sequence[Result]) -> Table:
    keys = ["factor", "value"]
    rest = [r.tables["conditions"].query("factor != 'subject'").set_index(keys) for r in results]
    shown = {r.method: part["accuracy"] for r, part in zip(results, rest, strict=True)}
    table = pd.DataFrame(shown).reindex(rest[0].index).assign(captures=rest[0]["captures"]).reset_index()
    columns = [text("factor"), text("value"), *(percent(r.method) for r in results), Measure("captures", form=".0f")]
    return Table(columns, rows_of(table))


def _worst_faults(results: Sequence[Result]) -> Table:
    rows, severities = [], []
    for r in results:
        slices, margins = r.tables["slices"], r.tables["margins"].sort_values("loss", ascending=False).head(TOP)
        by = r.tables["faults"].pivot(index="fault", columns="severity", values="accuracy")
        failing = slices[(slices["kind"] == "fault") & slices["failing"]]
        lowest = failing.groupby("fault")["severity"].min().astype(str)
        severities = severities or [str(s) for s in by.columns]
        for row in rows_of(margins):
            by_severity = dict(zip(severities, by.loc[row["fault"]], strict=True))
            rows.append(row | by_severity | {"method": r.method, "fails": lowest.get(row["fault"])})
    columns = [
        text("method", "system"),
        text("fault"),
        *map(percent, severities),
        percent("loss"),
        text("fails", "fails from"),
        text("where", "half of the margin is lost at"),
    ]
    return Table(columns, rows)


def _half_table(results: Sequence[Result]) -> Table:
    top = max(int(r.tables["faults"]["severity"].max()) for r in results)
    shown = {r.method: r.tables["margins"].set_index("fault")["half_margin"] for r in results}
    table = pd.DataFrame(shown).reindex(results[0].tables["margins"]["fault"])
    table = table.map(lambda v: "no margin" if pd.isna(v) else f">{top}" if np.isinf(v) else f"{v:.1f}")
    curve = results[0].tables["faults"]
    unit = curve["amount"].str.partition(" ")
    amounts = unit[0].groupby(curve["fault"]).agg(", ".join) + " " + unit[2].groupby(curve["fault"]).first()
    return of_text(table.assign(**{"severities 1 to 5": amounts}).rename_axis("fault").reset_index())


def _tests_words(slices: pd.DataFrame, mask: pd.Series) -> str:
    """How many slices were tested and failed, and what the number of subjects cannot show."""
    tested, failing = slices[mask & slices["tested"]], slices[mask & slices["failing"]]
    several = tested[tested["subjects"] > 1]
    floor, count = several["floor"].min(), families(tested).value_counts() if len(several) else pd.Series(dtype=int)
    needed = {name: int(np.ceil(round(FAMILIES * n * floor / ALPHA, 6))) for name, n in count.items()}
    return sentences(
        *("bench.reports", "sentences", "groups"),
        failing=len(failing),
        tested=len(tested),
        level=ALPHA,
        untested=int((mask & ~slices["tested"]).sum()),
        people=several["subjects"].max(),
        floor=floor,
        needed=[f"{max(n, 1)} {name.replace('slices', 'groups' if n > 1 else 'group')}" for name, n in needed.items()],
    )[0]


def _as_such(slices: pd.DataFrame) -> pd.Series:
    """Slices under a fault that fails at that severity with all captures together, and those faults themselves."""
    alone = slices["kind"] == "fault"
    failing = slices[alone & slices["failing"]]
    return alone | pd.MultiIndex.from_frame(slices[["fault", "severity"]]).isin(
        pd.MultiIndex.from_frame(failing[["fault", "severity"]])
    )


def _before(slices: pd.DataFrame) -> pd.Series:
    """Slices under a fault that fail without it."""
    failing = set(slices.loc[slices["failing"] & (slices["fault"] == ""), "slice"])
    return (slices["fault"] != "") & _bare(slices).isin(failing)


def _bare(slices: pd.DataFrame) -> pd.Series:
    """Names of slices without the fault."""
    words = slices[["slice", "fault", "amount"]].to_numpy()
    return pd.Series(
        [name.removesuffix(f"{fault} {amount}").removesuffix(", ") for name, fault, amount in words],
        slices.index,
        dtype=object,
    )


def _slice_table(slices: pd.DataFrame, mask: pd.Series) -> Table:
    """The worst failing slices; of a fault, only the lowest severity at which each fails."""
    failing = slices[mask & slices["failing"]]
    if (failing["fault"] != "").any():
        failing = failing.assign(bare=_bare(failing)).sort_values("severity").drop_duplicates(["bare", "fault"])
        failing = failing.sort_values(["severity", "gap"], ascending=[True, False])
    else:
        failing = failing.sort_values("gap", ascending=False)
    return Table(SLICES, rows_of(failing.head(TOP)))


def _rank_table(results: Sequence[Result]) -> Table:
    table = ranks(results).replace({"fault": {CLEAN: "clean"}})
    systems = [name for name in table if name not in ("fault", "kendall_tau")]
    columns = [text("fault"), *(Measure(name, form="g") for name in systems)]
    return Table([*columns, Measure("kendall_tau", "Kendall's tau", form=".2f")], rows_of(table))


def _learning_table(results: Sequence[Result]) -> Table:
    accuracy = percent("accuracy", ends="accuracy")
    shown = {}
    for r in results:
        curve = rows_of(learning(r.tables["labels"]).rename(columns={"low": "accuracy_low", "high": "accuracy_high"}))
        shown[r.method] = {f"{row['train_subjects']:g}": accuracy.of(row) for row in curve}
    return of_text(pd.DataFrame(shown).fillna("-").rename_axis("training subjects").reset_index())
