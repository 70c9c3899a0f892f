"""The results of `bench stress` to read: tables in text for the console and markdown, CSV files and figures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bench import scores
from bench.comparable import notes_on
from bench.errors import InputError
from bench.measures import Measure, percent, text
from bench.reports import fault_curves as figures
from bench.reports.contexts import noted
from bench.reports.layout import markdown
from bench.result import Result
from bench.sentences import sentences
from bench.table import Table, of_text, rows_of, write_sheet
from bench.words import CLEAN
from bench.work.curves import joined, unharmed
from bench.work.stability import ALPHA, learning, ranks, seeds

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
    lines: dict[Path, str] = {}
    for members in groups.values():
        folder, title = out, ", ".join(members[0].context)
        if len(groups) > 1:
            name = re.sub(r"[^A-Za-z0-9]+", "-", " ".join(members[0].context)).strip("-").lower()
            folder = out / name if out / name not in lines else out / f"{name}-{len(lines) + 1}"
        write(members, folder)
        words = "failing subjects, classes, conditions and faults, with figures"
        lines[folder] = f"{title}: {words}: {folder / 'stability.md'}"
    return [*lines.values()]


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
    note = f"Chance is the share of the most frequent class: {100 * results[0]['chance']:.1f} %."
    parts = [("Clean", note, _clean_table(results))]
    if len(table := _condition_table(results)):
        parts.append(("By class, condition and length", "Accuracy in percent; subjects are in the CSV.", table))
    under_faults = len(results[0].tables["faults"]) > 0
    if under_faults:
        note = "Accuracy in percent at severities 1 to 5, mean loss in points, and the lowest severity at which "
        note += "accuracy is significantly below that of the system."
        parts.append(("Worst faults", note, _worst_faults(results)))
    parts += [(f"Failing groups: {r.method}", *_failing(r)) for r in results]
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


def _failing(result: Result) -> tuple[str, Table]:
    """How many groups of captures were tested and fail, and the worst of those that fail without a fault."""
    slices = result.tables["slices"]
    tested = slices[slices["tested"]]
    words = sentences(
        *("bench.reports", "sentences", "groups"),
        failing=int(tested["failing"].sum()),
        tested=len(tested),
        under=int((tested["failing"] & (tested["fault"] != "")).sum()),
        level=ALPHA,
        untested=len(slices) - len(tested),
    )
    rows = tested[tested["failing"] & (tested["fault"] == "")].sort_values("gap", ascending=False)
    return words[0], Table(SLICES, rows_of(rows.head(TOP)))


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
