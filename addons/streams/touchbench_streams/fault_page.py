"""Touches in recordings under faults: tables, and a figure for the page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from bench.measures import Measure, percent, text
from bench.reports.contexts import context_words, contexts, scarce
from bench.reports.figures import DASHES, MARKERS, plain, save
from bench.reports.part import Part
from bench.result import Result
from bench.table import Table, rows_of
from bench.words import CLEAN
from bench.work.curves import joined
from touchbench_streams import others
from touchbench_streams.stress import FAULTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Same = Mapping[str, tuple[str, str]]
ACROSS = 4  # faults beside each other in a figure
MIDDLE = 3  # severity in the table of the page
COLUMNS = (
    text("system"),
    text("case", "fault"),
    text("amount", spare=1),
    percent("touches_found", "found", ends="touches_found"),
    percent("first_correct", "first", ends="first_correct"),
    percent("end_correct", "end", ends="end_correct"),
    Measure("false_alarms_per_hour", "alarms/h", ends="false_alarms_per_hour"),
    Measure("fragments", "reports/touch", form=".2f"),
    percent("refused"),
)
CAPTION = (
    "{}: touches in recordings of test subjects as they are, and under faults that came after training, at severity "
    f"{MIDDLE} of 5. Means over subjects, 95 % intervals; refused are frames in which the detector refuses or many "
    "taxels are at full scale. recordings_under_faults.csv has all severities."
)
DRAWN = "touches found and false alarms per hour under faults that came after training, by severity; 0 is the "
DRAWN += "recording as it is. Means over subjects, without intervals."


def by_detector(result: Result) -> Result:
    """The result under a name that also tells its detector, where the run does."""
    detector = others(result.get("watch.detector"))
    if detector is None:
        return result
    about = {**result.about, "system": f"{result['system']}, detector={detector}"}
    return Result(about, result.metrics, result.tables, result.errors)


def rows_under(result: Result) -> list[dict[str, Any]]:
    """A row for each case of a run, that without a fault first."""
    rows = [dict(row) for row in rows_of(result.tables[FAULTS])]
    for row in rows:
        row["system"] = result.method
        row["case"] = f"{row['fault'].replace('_', ' ')} {row['severity']}" if row["severity"] else CLEAN
    return rows


def under_faults(results: Sequence[Result]) -> list[Result]:
    """The results of runs under faults, with their detectors."""
    return [by_detector(r) for r in results if r.scored and r.get("watch.under")]


def printed_tables(results: Sequence[Result], same: Same) -> Iterator[str | Table]:
    """All cases of each run under faults, and a line about them."""
    for r in (shown := under_faults(results)):
        yield Table(COLUMNS[1:], rows_under(r), f"{r.method}, {context_words(r, same)}, under faults after training")
    if shown:
        yield "refused: percentage of frames that the detector refuses, or with a tenth of the taxels at full scale"


def sheet(results: Sequence[Result]) -> pd.DataFrame:
    """All cases of the runs under faults; empty without one."""
    return joined(under_faults(results), FAULTS)


def fault_parts(results: Sequence[Result], folder: Path, same: Same) -> list[Part]:
    """A figure and a table for each set of comparable runs under faults.

    Args:
        results: results of ``bench watch``.
        folder: destination folder of the figures.
        same: parameters that comparable results share (`bench.comparable.shared`).
    """
    parts = []
    counted = [r for r in under_faults(results) if r.get("background_minutes")]  # else no alarms can be counted
    for i, (context, members) in enumerate(contexts(counted, same, "end_correct"), 1):
        picture = save(fault_figure(members), folder, f"0-watch-faults-{i}", context, f"{context}: {DRAWN}")
        rows = [row for r in members for row in rows_under(r) if row["severity"] in (0, MIDDLE)]
        parts.append(Part(picture, Table(COLUMNS, rows), CAPTION.format(context), scarce(members)))
    return parts


def fault_figure(results: Sequence[Result]) -> Figure:
    """Touches found above false alarms, against severity: a pair of panels for each fault, a line for each system."""
    from matplotlib.figure import Figure

    tables = [r.tables[FAULTS] for r in results]
    faults = dict.fromkeys(fault for table in tables for fault in table["fault"] if fault != CLEAN)
    across, bands = min(ACROSS, len(faults)), -(-len(faults) // ACROSS)
    size = (max(2.7 * across, 7.0), 3.6 * bands + 0.6 + 0.2 * len(results))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(2 * bands, across, squeeze=False, sharey="row", height_ratios=[3, 2] * bands)
    most = max(table["false_alarms_per_hour"].max() for table in tables)
    for i, fault in enumerate(faults):
        found, alarms = axes[2 * (i // across) : 2 * (i // across) + 2, i % across]
        amounts: list[str] = []
        for k, (r, table) in enumerate(zip(results, tables, strict=True)):
            part = table[table["fault"].isin([CLEAN, fault])].sort_values("severity")
            if len(part) == 1:
                continue
            look: dict[str, Any] = {"color": f"C{k % 10}", "marker": MARKERS[k % len(MARKERS)], "markersize": 4}
            look |= {"linestyle": DASHES[k % len(DASHES)], "clip_on": False, "label": plain([r.method])[0]}
            found.plot(part["severity"], 100 * part["touches_found"], **look)
            alarms.plot(part["severity"], part["false_alarms_per_hour"], **look)
            amounts = part["amount"].tolist()
        for ax in (found, alarms):
            ax.set(xlim=(-0.2, len(amounts) - 0.8))
            ax.grid(alpha=0.25)
        found.set(ylim=(0, 100), xticks=range(len(amounts)), xticklabels=[])
        found.set_title(fault.replace("_", " "))
        numbers = [amount.partition(" ")[0] for amount in amounts[1:]]
        alarms.set_xticks(range(len(amounts)), ["0", *numbers])
        alarms.set_yscale("symlog", linthresh=10)
        alarms.set(ylim=(0, 1.2 * max(most, 10)), xlabel=amounts[-1].partition(" ")[2])
        alarms.yaxis.set_major_formatter("{x:g}")
        if i % across == 0:
            found.set_ylabel("found, %")
            alarms.set_ylabel("alarms/h")
    for ax in axes.T.reshape(across, bands, 2)[:, bands - 1][len(faults) - across * (bands - 1) :].flat:
        ax.set_axis_off()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", frameon=False, handlelength=4)
    return figure
