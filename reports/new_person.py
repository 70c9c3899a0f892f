"""What some captures of a new person are worth: accuracy against shots, from runs of ``protocol=personal``."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd

from bench.outcomes.comparable import Row, context_of
from bench.outcomes.runs import rows_of, subject_accuracy
from bench.outcomes.statistics import interval
from bench.outcomes.store import Store
from reports.figures import MARKERS, new_figure, save
from reports.layout import Block, Table

WITHOUT = "no labels"  # where half of the person's captures are known without them
SAME = ("data", "corpus_digest", "subset", "target", "protocol_name", "protocol.source", "protocol.classes")
DRAWN = ["protocol.draws", "protocol.weight"]  # which matter where there are shots
SHOWN = 5  # systems of a figure


Curves = tuple[str, dict[str, pd.DataFrame]]  # a set of comparable runs in words, and the curve of each system


def curves_of(store: Store, runs: pd.DataFrame) -> list[Curves]:
    """The curves of systems that have at least two calibrations, for each set of comparable runs; the best first.

    Args:
        store: where the runs are.
        runs: as `bench.outcomes.runs.tracked` gives them.
    """
    personal = runs[runs["protocol_name"].isin(["personal", "transfer"]) & (runs["status"] == "FINISHED")]
    sets = []
    for part in comparable(personal) if len(personal) else []:
        first = rows_of(part)[-1]
        data, subset, *_ = context_of({str(k): str(v) for k, v in first.items()})
        skin = f" on another skin than {first['protocol.source']}" if first["protocol_name"] == "transfer" else ""
        draws = f", {first['protocol.draws']} draws" if first["protocol.shots"] != "0" else ""
        context = f"{data}{'' if subset == 'all' else f', {subset}'}, a new person{skin}{draws}"
        found = {system: curve_of(store, rows) for system, rows in part.groupby("system", sort=False)}
        best = sorted((system for system in found if len(found[system]) > 1), key=lambda s: -found[s]["accuracy"].max())
        if best:
            sets.append((context, {system: found[system] for system in best}))
    return sets


def newcomer_blocks(sets: list[Curves], folder: Path) -> list[Block]:
    """A figure and a table for each set of curves.

    Args:
        sets: of `curves_of`.
        folder: where figures go.
    """
    blocks: list[Block] = []
    for number, (context, found) in enumerate(sets, 1):
        caption = "Accuracy of people who were in no training part, mean and 95 % interval over them, against captures "
        caption += f"of each class that are known of the person ({WITHOUT}: half of their captures, without labels)."
        left = f" {len(found) - SHOWN} less accurate systems left out." if len(found) > SHOWN else ""
        few = dict([*found.items()][:SHOWN])
        blocks.append(drawn(few, context, caption + left, folder, number))
        blocks.append(Table(table_of(found), f"{context}: {TOLD}"))
    return blocks


def comparable(runs: pd.DataFrame) -> list[pd.DataFrame]:
    """Runs on the same captures whose shots are drawn alike, each with those that have no shots, which come first."""
    found = []
    same = [column for column in (*SAME, "protocol.seed") if column in runs]
    for _, part in runs.groupby(same, sort=False, dropna=False):
        shots = part["protocol.shots"] != "0"
        drawn = [rows for _, rows in part[shots].groupby(DRAWN, sort=False)]
        found += [pd.concat([part[~shots], rows]) for rows in drawn] or [part]
    return found


TOLD = (
    "accuracy in percent, mean over people; paired gain over knowing nothing; who gets worse, and by how many points; "
    "`enough`: the fewest shots from which no more is lost than a standard error of the paired difference to the best."
)


def curve_of(store: Store, runs: pd.DataFrame) -> pd.DataFrame:
    """A row per calibration of a system, seeds averaged: accuracies of people, gains, who loses.

    Args:
        store: where the runs are.
        runs: of one system.
    """
    people: dict[str, pd.Series] = {}
    for known, rows in runs.groupby(runs.apply(known_of, axis=1), sort=False):
        newest = rows.drop_duplicates("seed", keep="last")
        found = [pd.Series(subject_accuracy(store, row)) for row in rows_of(newest)]
        if any(map(len, found)):  # else its table is gone from the store
            people[str(known)] = pd.concat(found, axis=1).mean(axis=1)
    wide = pd.DataFrame(people).dropna()
    if wide.empty:
        return pd.DataFrame()
    order = sorted(wide, key=lambda known: 0.5 if known == WITHOUT else float(known))
    nothing = wide["0"] if "0" in wide else None
    rows = []
    for known in order:
        low, high = interval(wide[known].to_numpy())
        row: Row = {"known": known, "accuracy": wide[known].mean(), "low": low, "high": high}
        if nothing is not None and known != "0":
            gain = wide[known] - nothing
            low, high = interval(gain.to_numpy())
            worse = gain[gain < 0].sort_values()
            row |= {"gain": gain.mean(), "gain_low": low, "gain_high": high}
            row |= {"worse": ", ".join(f"{who} ({points:.1f})" for who, points in worse.items())}
        rows.append(row)
    curve = pd.DataFrame(rows)
    curve.attrs["enough"] = enough(wide[[k for k in order if k != WITHOUT]])
    return curve


def known_of(run: pd.Series) -> str:
    """What is known of the person in a run: a number of shots, or captures without labels."""
    return WITHOUT if run["protocol.unlabelled"] == "True" else str(int(run["protocol.shots"]))


def enough(people: pd.DataFrame) -> str:
    """The fewest shots whose mean loss to the best is within its standard error over people [people, shots].

    Nothing where no number of shots was run.
    """
    if people.empty:
        return ""
    best = people.mean().idxmax()
    for known in people:
        lost = people[best] - people[known]
        if lost.mean() <= lost.std(ddof=1) / np.sqrt(len(lost)):
            return str(known)
    return str(best)


def table_of(found: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """All curves, a row per system and calibration."""
    rows = []
    for system, curve in found.items():
        for row in rows_of(curve):
            said = {"system": system, "known": row["known"]}
            said["accuracy"] = f"{row['accuracy']:.1f} ({row['low']:.1f} - {row['high']:.1f})"
            gain = row.get("gain", np.nan)
            some = isinstance(gain, float) and np.isfinite(gain)
            said["gain"] = f"{gain:+.1f} ({row['gain_low']:+.1f} to {row['gain_high']:+.1f})" if some else "-"
            said["worse"] = str(row["worse"] or "nobody") if some else "-"
            said["enough"] = curve.attrs["enough"] if row["known"] == curve["known"].iloc[0] else ""
            rows.append(said)
    return pd.DataFrame(rows)


def drawn(found: dict[str, pd.DataFrame], context: str, caption: str, folder: Path, number: int) -> Block:
    """Accuracy against what is known, a line per system."""
    known = {k for curve in found.values() for k in curve["known"]}
    ticks = sorted(known, key=lambda k: 0.5 if k == WITHOUT else float(k))
    figure, axes = new_figure((8.5, 4.2), margins=(0.7, 2.6, 0.6, 0.65))
    axis = axes[0][0]
    for i, (system, curve) in enumerate(found.items()):
        place = np.array([ticks.index(k) for k in curve["known"]]) + 0.06 * (i - (len(found) - 1) / 2)
        labelled = (curve["known"] != WITHOUT).to_numpy()
        colour = f"C{i}"
        low, high = curve["accuracy"] - curve["low"], curve["high"] - curve["accuracy"]
        axis.errorbar(place, curve["accuracy"], yerr=[low, high], fmt="none", ecolor=colour, elinewidth=1, alpha=0.5)
        axis.plot(
            place[labelled], curve["accuracy"][labelled], color=colour, marker=MARKERS[i], ms=5, label=fill(system, 34)
        )
        axis.plot(place[~labelled], curve["accuracy"][~labelled], color=colour, marker=MARKERS[i], ms=5, mfc="w", ls="")
    axis.set_xticks(range(len(ticks)), ticks)
    axis.set_xlabel("captures of each class that are known of the person")
    axis.set_ylabel("accuracy, %")
    axis.set_title(fill(context, 72))
    axis.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.01, 1))
    return save(figure, folder, f"0-newcomer-{number}", "newcomer", context, caption)
