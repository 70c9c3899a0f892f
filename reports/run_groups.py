"""A group of runs, on the same captures under the same protocol: its statistics, subjects and details."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from bench.outcomes import scores, statistics
from bench.comparable import facts_of, seed_number
from bench.outcomes.runs import independent, predictions, rows_of
from bench.outcomes.store import Store
from reports import details, paired_statistics
from reports.bootstrap import recall_interval
from reports.figures import Picture, save
from reports.layout import Table
from reports.numbers import notes_on
from reports.reference_rows import BySubject

GROUPS = 3  # captures-and-protocol groups that get a verdict, statistics and figures
SYSTEMS = 2  # systems of a group whose predictions are read and drawn


@dataclass(frozen=True)
class Group:
    """The contents of a group in the report.

    Attributes:
        subjects: accuracy in percent [systems, subjects], best first, reference results among them; empty without
            complete runs.
        mixed: True if a fold has captures of one subject on both sides.
        rows: the statistics, a row per system.
        pairs: tests of all pairs of the most accurate systems.
        limits: limits of the conclusions, in sentences.
        compared: the statistics as text.
        matrix: pairs as text; None with only two systems, or if no pair can have a corrected p below 0.05.
        pictures: figures by kind: subjects, and those of `detail_figures`.
        labels_only: systems whose predictions would be drawn, but hold no probabilities.
    """

    subjects: pd.DataFrame
    mixed: bool = False
    rows: pd.DataFrame = field(default_factory=pd.DataFrame)
    pairs: pd.DataFrame = field(default_factory=pd.DataFrame)
    limits: list[str] = field(default_factory=list)
    compared: Table | None = None
    matrix: Table | None = None
    pictures: dict[str, Picture] = field(default_factory=dict)
    labels_only: list[str] = field(default_factory=list)

    @property
    def few(self) -> bool:
        """True if there are too few subjects for any conclusion."""
        return self.subjects.shape[1] < statistics.FEW_SUBJECTS


def largest_groups(runs: pd.DataFrame) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Runs by group, and the names of groups beyond `GROUPS`.

    People stand before generated captures, protocols that say something of new persons before those that mix subjects,
    then the groups with most subjects, then those with most systems.
    """
    mixed = [facts_of(run).mixes_subjects for run in rows_of(runs)]
    grouped = runs.assign(mixed=mixed).groupby("group")
    size = grouped.agg({"synthetic": "max", "mixed": "max", "subjects": "max", "system": "nunique"})
    order = size.sort_values([*size], ascending=[True, True, False, False], kind="stable").index
    return {g: runs[runs["group"] == g] for g in order[:GROUPS]}, list(order[GROUPS:])


def group_of(store: Store, runs: pd.DataFrame, compared: BySubject, folder: Path, name: str) -> Group:
    """Statistics and figures of the runs of one group.

    Args:
        store: store of the runs.
        runs: runs of the group, from `bench.outcomes.runs.with_groups`.
        compared: `reports.reference_rows.systems_by_subject` of them.
        folder: destination folder of figures.
        name: prefix of file names.
    """
    group = runs["group"].iloc[0]
    subjects = compared.subjects
    if not len(subjects):
        return Group(subjects)
    runs = independent(runs)
    first = runs[runs["status"] == "FINISHED"].iloc[0].to_dict()
    facts = facts_of(first)
    kept = subjects.iloc[: statistics.RANKED]
    by_fold = fold_table(store, runs, kept, facts.test_over_train)
    rows = statistics.against_best(kept, by_fold, facts.test_over_train)
    rows = rows.assign(seeds=rows["system"].map(compared.seeds))
    shown = paired_statistics.shown_statistics(rows)
    pairs, matrix = statistics.pairs(kept.iloc[: statistics.PAIRED]), None
    if len(kept) > 2 and subjects.shape[1] > 1:
        ranks, p = statistics.friedman(kept)
        rows = rows.assign(mean_rank=rows["system"].map(ranks), friedman_p=p)
        if statistics.least_p(subjects.shape[1], len(pairs)) < 0.05:
            matrix = Table(paired_statistics.matrix([*kept.index[: statistics.PAIRED]], pairs))
    figures, labels_only = detail_figures(store, runs, subjects.index.drop([*compared.references]), group)
    figures["subjects"] = paired_statistics.strip_plot(subjects, group)
    return Group(
        subjects,
        facts.mixes_subjects,
        rows,
        pairs,
        statistics.warnings(subjects.shape[1], len(kept), int(first["folds"]), facts.mixes_subjects),
        Table(shown, [notes_on(system, first["data"]) for system in rows["system"]]),
        matrix,
        {kind: save(drawn, folder, f"{name}-{kind}", group, caption) for kind, (drawn, caption) in figures.items()},
        labels_only,
    )


def fold_table(store: Store, runs: pd.DataFrame, kept: pd.DataFrame, ratio: float | None) -> pd.DataFrame | None:
    """Accuracy in percent [systems, folds], means over seeds; None where folds are subjects or share nothing."""
    complete = runs[(runs["status"] == "FINISHED") & runs["system"].isin(kept.index)]
    if ratio is None or set(store.fold_accuracy(complete["run_id"].iloc[0])) == set(kept.columns):
        return None
    rows = [store.fold_accuracy(run_id) for run_id in complete["run_id"]]
    table = pd.DataFrame(rows, index=complete["system"].to_numpy())
    return table.groupby(level=0).mean().reindex(kept.index)


def detail_figures(
    store: Store, runs: pd.DataFrame, systems: pd.Index, group: str
) -> tuple[dict[str, tuple[Figure, str]], list[str]]:
    """Figures that need predictions, of the most accurate systems, one seed each, not the luckiest.

    Args:
        store: store of the runs.
        runs: runs of one group.
        systems: their names, best first.
        group: description of the group.

    Returns:
        Figures with captions, by kind; and the systems that give labels only, so that nothing can be calibrated.
    """
    complete = runs[runs["status"] == "FINISHED"].sort_values("seed", key=lambda c: c.map(seed_number), kind="stable")
    lowest = complete.drop_duplicates("system").set_index("system", drop=False).loc[systems]
    figures: dict[str, tuple[Figure, str]] = {}
    recalls, reliability = {}, {}
    for run in rows_of(lowest.iloc[:SYSTEMS]):
        if (table := predictions(store, run)) is None:
            continue
        labelled, classes = scores.captures(table), scores.classes_of(table)
        if not recalls:
            counts = scores.confusion(labelled, classes)
            figures["confusion"] = details.confusion_figure(counts, run["system"], group)
        recalls[run["system"]] = recall_interval(labelled, classes)
        reliability[run["system"]] = details.calibration(table)
    if recalls:
        figures["gestures"] = details.gesture_figure(recalls, group)
    if calibrated := {s: table for s, table in reliability.items() if table}:
        figures["calibration"] = details.calibration_figure(calibrated, group)
    return figures, [system for system in reliability if system not in calibrated]


def slug(text: str, most: int = 48) -> str:
    """Words for the name of a file."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:most].strip("-")
