"""The results of `bench stress` to read: tables in text for the console and markdown, CSV files and figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.outcomes import scores
from bench.outcomes.stability import ALPHA, CLEAN, FAMILIES, Analysis, families, ranks, seeds
from reports import stability_figures as figures
from reports.layout import Table, markdown
from reports.numbers import bounded, number, percent
from reports.spreadsheet import write_sheet

TOP = 10  # rows of a table


def write(analyses: list[Analysis], folder: Path) -> list[Path]:
    """Write the tables as CSV, ``stability.md``, and the figures as PNG and SVG, for methods of one context.

    Raises:
        InputError: the folder cannot be written.
    """
    tables = {
        "faults": _joined(analyses, "curves"),
        "half_margins": _joined(analyses, "margins"),
        "conditions": _joined(analyses, "conditions"),
        "learning": _joined(analyses, "learning"),
        "slices": _joined(analyses, "slices"),
        "ranks": _in_context(analyses[0], ranks(analyses)),
        "seeds": _in_context(analyses[0], seeds(analyses)),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("stability_*.[ps][nv]g"):  # of an earlier command
            old.unlink()
        paths = []
        for name, table in tables.items():
            paths.append(folder / f"stability_{name}.csv")
            write_sheet(table, paths[-1])
        paths.append(folder / "stability.md")
        shown = [(heading, note, Table(table) if len(table) else None) for heading, note, table in sections(analyses)]
        text = markdown("stability.jinja", context=title(analyses[0]), sections=shown)
        paths[-1].write_text(text, encoding="utf-8")
        return paths + figures.draw(analyses, folder)
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e.strerror}); choose another out=") from e


def _joined(analyses: list[Analysis], name: str) -> pd.DataFrame:
    parts = [(a, getattr(a, name)) for a in analyses]
    named = [(a, part.assign(system=a.system, seed=a.seed)[["system", "seed", *part.columns]]) for a, part in parts]
    return pd.concat([_in_context(a, part) for a, part in named], ignore_index=True)


def _in_context(one: Analysis, table: pd.DataFrame) -> pd.DataFrame:
    about = dict(zip(("data", "subset", "protocol"), one.context, strict=True))
    return table.assign(**about)[[*about, *table.columns]]


def title(one: Analysis) -> str:
    """Data, subset and protocol, the heading of every table and figure."""
    return ", ".join(one.context)


def sections(analyses: list[Analysis]) -> list[tuple[str, str, pd.DataFrame]]:
    """Heading, remark and table (of text) of everything that is shown to a reader, in percent and points."""
    parts = [
        (
            "Clean",
            f"Chance is the share of the most frequent class: {percent(analyses[0].chance)} %.",
            _clean_table(analyses),
        )
    ]
    if len(table := _condition_table(analyses)):
        parts.append(("By class, condition and length", "Accuracy in percent; subjects are in the CSV.", table))
    if len(analyses[0].curves):
        note = "Accuracy in percent at severities 1 to 5, mean loss in points, and the lowest severity at which "
        note += "accuracy is significantly below that of the system."
        worst = pd.concat([_worst_faults(a) for a in analyses], ignore_index=True)
        parts.append(("Worst faults", note, worst))
        note = "Interpolated between severities 1 to 5; 0 means clean captures, >5 means never."
        parts.append(("Severity at which half of the margin over chance is lost", note, _half_table(analyses)))
    for a in analyses:
        faulty = a.slices["fault"] != ""
        parts.append((f"Failing groups: {a.method}", _tests_words(a.slices, ~faulty), _slice_table(a, ~faulty)))
        if faulty.any():
            table = _slice_table(a, faulty & ~_as_such(a.slices) & ~_before(a.slices))
            note = (
                "Each listed group fails at a severity at which all captures together do not; clean, it does not fail."
            )
            parts.append(
                (f"Groups that fail under a fault: {a.method}", f"{_tests_words(a.slices, faulty)} {note}", table)
            )
    if len(analyses) > 1 and len(analyses[0].curves):
        parts.append(
            (
                "Ranks",
                "By mean accuracy over severities; Kendall's tau compares the order with the clean one.",
                _rank_table(analyses),
            )
        )
    if len(varied := seeds(analyses)):
        shown = varied.assign(**{c: varied[c].map(percent) for c in ("accuracy", "sd", "lowest", "highest")})
        shown["changed"] = [f"{r.changed} of {r.captures} ({percent(r.share_changed)} %)" for r in varied.itertuples()]
        parts.append(("Seeds", "", shown[["system", "seeds", "accuracy", "sd", "lowest", "highest", "changed"]]))
    if any(len(a.learning) > 1 for a in analyses):
        parts.append(("Fewer training subjects", "", _learning_table(analyses)))
    return parts


def _clean_table(analyses: list[Analysis]) -> pd.DataFrame:
    rows = []
    for a in analyses:
        low, high = scores.subject_interval(a.units)
        accuracy = bounded(100 * a.clean, 100 * low, 100 * high)
        row = {"system": a.method, "captures": str(len(a.units)), "accuracy [95 %]": accuracy}
        for factor, part in a.conditions.groupby("factor", sort=False):
            worst = part.loc[part["accuracy"].idxmin()]
            row[f"worst {factor}"] = f"{worst['value']}: {percent(worst['accuracy'])}"
        rows.append(row)
    return pd.DataFrame(rows).fillna("-")


def _condition_table(analyses: list[Analysis]) -> pd.DataFrame:
    keys = ["factor", "value"]
    rest = [a.conditions[a.conditions["factor"] != "subject"].set_index(keys) for a in analyses]
    shown = {a.method: part["accuracy"].map(percent) for a, part in zip(analyses, rest, strict=True)}
    table = pd.DataFrame(shown).reindex(rest[0].index)
    return table.assign(captures=rest[0]["captures"].astype(str)).reset_index()


def _worst_faults(a: Analysis) -> pd.DataFrame:
    worst = a.margins.sort_values("loss", ascending=False).head(TOP)
    by = a.curves.pivot(index="fault", columns="severity", values="accuracy")
    failing = a.slices[(a.slices["kind"] == "fault") & a.slices["failing"]]
    lowest = failing.groupby("fault")["severity"].min()
    rows = [
        {
            "system": a.method,
            "fault": r.fault,
            **{str(s): percent(by.loc[r.fault, s]) for s in by.columns},
            "loss": f"{100 * r.loss:.1f}",
            "fails from": str(lowest.get(r.fault, "-")),
            "half of the margin is lost at": r.where,
        }
        for r in worst.itertuples()
    ]
    return pd.DataFrame(rows)


def _half_table(analyses: list[Analysis]) -> pd.DataFrame:
    top = max(int(a.curves["severity"].max()) for a in analyses)
    shown = {a.method: a.margins.set_index("fault")["half_margin"] for a in analyses}
    table = pd.DataFrame(shown).reindex(analyses[0].margins["fault"])
    text = table.map(lambda v: "no margin" if pd.isna(v) else f">{top}" if np.isinf(v) else f"{v:.1f}")
    curve = analyses[0].curves
    unit = curve["amount"].str.partition(" ")
    amounts = unit[0].groupby(curve["fault"]).agg(", ".join) + " " + unit[2].groupby(curve["fault"]).first()
    return text.assign(**{"severities 1 to 5": amounts}).rename_axis("fault").reset_index()


def _tests_words(slices: pd.DataFrame, mask: pd.Series) -> str:
    """How many slices were tested and failed, and what the number of subjects cannot show."""
    tested, failing = slices[mask & slices["tested"]], slices[mask & slices["failing"]]
    words = [
        f"{len(failing)} of {len(tested)} tested groups of captures have an accuracy significantly below that of the "
        f"system (Benjamini-Hochberg, corrected p <= {ALPHA})."
    ]
    if untested := int((mask & ~slices["tested"]).sum()):
        words.append(f"{untested} more have too few captures or subjects for a significant result.")
    several = tested[tested["subjects"] > 1]
    if len(several):
        floor, count = several["floor"].min(), families(tested).value_counts()
        needed = {name: int(np.ceil(round(len(FAMILIES) * n * floor / ALPHA, 6))) for name, n in count.items()}
        those = " or ".join(f"{max(n, 1)} {name.replace('slices', 'groups')}" for name, n in needed.items())
        words.append(
            f"With {several['subjects'].max()} subjects, the p of a group of several subjects is at least {floor:.2g}. "
            f"After correction, such a group can fail only if at least {those} have this p."
        )
    return " ".join(words)


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


def _slice_table(a: Analysis, mask: pd.Series) -> pd.DataFrame:
    """The worst failing slices; of a fault, only the lowest severity at which each fails."""
    failing = a.slices[mask & a.slices["failing"]]
    if (failing["fault"] != "").any():
        failing = failing.assign(bare=_bare(failing)).sort_values("severity").drop_duplicates(["bare", "fault"])
        failing = failing.sort_values(["severity", "gap"], ascending=[True, False])
    else:
        failing = failing.sort_values("gap", ascending=False)
    rows = [
        {
            "group": r.slice,
            "right": f"{r.right} of {r.captures}",
            "subjects": str(r.subjects),
            "accuracy": percent(r.accuracy),
            "below system by": f"{100 * r.gap:.1f}",
            "p": f"{r.p:.2g}",
            "corrected p": f"{r.p_corrected:.2g}",
        }
        for r in failing.head(TOP).itertuples()
    ]
    return pd.DataFrame(rows)


def _rank_table(analyses: list[Analysis]) -> pd.DataFrame:
    table = ranks(analyses)
    text = table.drop(columns=["fault", "kendall_tau"]).map(lambda v: "-" if pd.isna(v) else f"{v:g}")
    text.insert(0, "fault", table["fault"].replace(CLEAN, "clean"))
    return text.assign(**{"Kendall's tau": [number(v, 2) for v in table["kendall_tau"]]})


def _learning_table(analyses: list[Analysis]) -> pd.DataFrame:
    shown = {
        a.method: {
            f"{r.train_subjects:g}": bounded(100 * r.accuracy, 100 * r.low, 100 * r.high)
            for r in a.learning.itertuples()
        }
        for a in analyses
    }
    return pd.DataFrame(shown).fillna("-").rename_axis("training subjects").reset_index()
