"""A group of runs, on the same captures under the same protocol: its statistics, subjects and details."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from bench import few as fewest
from bench import scores
from bench.comparable import facts_of, seed_number
from bench.outcomes import statistics
from bench.outcomes.runs import by_subject
from bench.reports import details, paired_statistics
from bench.reports.bootstrap import recall_interval
from bench.reports.figures import Picture, save
from bench.result import Result
from bench.table import Table

GROUPS = 3  # captures-and-protocol groups that get a verdict, statistics and figures
SYSTEMS = 2  # systems of a group whose predictions are read and drawn


@dataclass(frozen=True)
class Group:
    """The contents of a group in the report.

    Attributes:
        subjects: accuracy in percent [systems, subjects], best first; empty without complete runs.
        against: the system that others are compared with, if that was asked for; else empty.
        mixed: True if a fold has captures of one subject on both sides.
        rows: the statistics, a row per system.
        pairs: tests of all pairs of the most accurate systems.
        limits: limits of the conclusions, in sentences.
        compared: the statistics as text.
        pictures: figures by kind: subjects, and those of `detail_figures`.
        labels_only: systems whose predictions would be drawn, but hold no probabilities.
    """

    subjects: pd.DataFrame
    mixed: bool = False
    against: str = ""
    rows: pd.DataFrame = field(default_factory=pd.DataFrame)
    pairs: pd.DataFrame = field(default_factory=pd.DataFrame)
    limits: list[str] = field(default_factory=list)
    compared: Table | None = None
    pictures: dict[str, Picture] = field(default_factory=dict)
    labels_only: list[str] = field(default_factory=list)

    @property
    def base(self) -> str:
        """The system that the others are compared with."""
        return statistics.base_of(self.subjects, self.against)

    @property
    def few(self) -> bool:
        """True if there are too few subjects for a p value."""
        return self.subjects.shape[1] < fewest.TEST


def largest_groups(groups: Mapping[str, Sequence[Result]]) -> tuple[dict[str, Sequence[Result]], list[str]]:
    """Results by group, and the names of groups beyond `GROUPS`.

    People stand before generated captures, protocols that say something of new persons before those that mix subjects,
    then the groups with most subjects, then those with most systems.
    """

    def order(name: str) -> tuple:
        results = groups[name]
        mixed = any(facts_of(r).mixes_subjects for r in results)
        synthetic = max(r["synthetic"] for r in results)
        subjects = max(r.get("subjects", 0) for r in results)
        return synthetic, mixed, -subjects, -len({r.system for r in results}), name

    names = sorted(groups, key=order)
    return {name: groups[name] for name in names[:GROUPS]}, names[GROUPS:]


def group_of(group: str, results: Sequence[Result], folder: Path, name: str, against: str = "") -> Group:
    """Statistics and figures of the runs of one group.

    Args:
        group: captures and protocol in words.
        results: results of the group.
        folder: destination folder of figures.
        name: prefix of file names.
        against: the system to compare with; empty for the best one.
    """
    results = [r for r in results if r.alone]
    subjects, seeds = by_subject(results)
    if not len(subjects):
        return Group(subjects)
    first = next(r for r in results if r.complete)
    facts = facts_of(first)
    kept = statistics.kept_of(subjects, against)
    by_fold = fold_table(results, kept, facts.test_over_train)
    rows = statistics.against_best(kept, by_fold, facts.test_over_train, against)
    rows = rows.assign(seeds=rows["system"].map(seeds))
    pairs = statistics.pairs(kept.iloc[: statistics.PAIRED])
    if len(kept) > 2 and subjects.shape[1] > 1:
        ranks, p = statistics.friedman(kept)
        rows = rows.assign(mean_rank=rows["system"].map(ranks), friedman_p=p)
    figures, labels_only = detail_figures(results, subjects.index, group)
    figures["subjects"] = paired_statistics.strip_plot(subjects, group)
    return Group(
        subjects,
        facts.mixes_subjects,
        against,
        rows,
        pairs,
        statistics.warnings(
            subjects.shape[1], len(kept), int(first["folds"]), facts.mixes_subjects, against not in kept.index
        ),
        paired_statistics.statistics_table(rows, first["data"]),
        {kind: save(drawn, folder, f"{name}-{kind}", group, caption) for kind, (drawn, caption) in figures.items()},
        labels_only,
    )


def fold_table(results: Sequence[Result], kept: pd.DataFrame, ratio: float | None) -> pd.DataFrame | None:
    """Accuracy in percent [systems, folds], means over seeds; None where folds are subjects or share nothing."""
    complete = [r for r in results if r.complete and r.system in kept.index]
    if ratio is None or set(fold_accuracy(complete[0])) == set(kept.columns):
        return None
    table = pd.DataFrame([fold_accuracy(r) for r in complete], index=[r.system for r in complete])
    return table.groupby(level=0).mean().reindex(kept.index)


def fold_accuracy(result: Result) -> dict[str, float]:
    """Accuracy of the captures of each fold, in percent."""
    labelled = scores.captures(result.tables["predictions"])
    hit = labelled["true"] == labelled["predicted"]
    return (100 * hit.groupby(labelled["fold"], sort=False).mean()).to_dict()


def detail_figures(
    results: Sequence[Result], systems: pd.Index, group: str
) -> tuple[dict[str, tuple[Figure, str]], list[str]]:
    """Figures that need predictions, of the most accurate systems, one seed each, not the luckiest.

    Args:
        results: results of one group.
        systems: their names, best first.
        group: description of the group.

    Returns:
        Figures with captions, by kind; and the systems that give labels only, so that nothing can be calibrated.
    """
    lowest: dict[str, Result] = {}
    for r in sorted((r for r in results if r.complete), key=lambda r: seed_number(r["seed"])):
        lowest.setdefault(r.system, r)
    figures: dict[str, tuple[Figure, str]] = {}
    recalls, reliability = {}, {}
    for system in systems[:SYSTEMS]:
        if (table := lowest[system].tables.get("predictions")) is None:
            continue
        labelled, classes = scores.captures(table), scores.classes_of(table)
        if not recalls:
            counts = scores.confusion(labelled, classes)
            figures["confusion"] = details.confusion_figure(counts, system, group)
        recalls[system] = recall_interval(labelled, classes)
        reliability[system] = details.calibration(table)
    if recalls:
        figures["gestures"] = details.gesture_figure(recalls, group)
    if calibrated := {s: table for s, table in reliability.items() if table}:
        figures["calibration"] = details.calibration_figure(calibrated, group)
    return figures, [system for system in reliability if system not in calibrated]


def slug(text: str, most: int = 48) -> str:
    """Words for the name of a file."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:most].strip("-")
