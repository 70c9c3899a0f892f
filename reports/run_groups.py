"""One group of runs, on the same captures under the same protocol: its statistics, subjects, costs and details."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from bench.outcomes import scores, statistics
from bench.outcomes.comparable import COMPARABLE, facts_of, seed_number
from bench.outcomes.runs import by_subject, independent, predictions, rows_of
from bench.outcomes.store import Store
from reports import curves, details, ranks, speed
from reports.figures import Picture
from reports.layout import Block, Text
from reports.reference_rows import systems_by_subject

GROUPS = 3  # captures-and-protocol groups that get a verdict, statistics and figures
SYSTEMS = 2  # systems of a group whose predictions are read and drawn


@dataclass(frozen=True)
class Group:
    """What the report shows of a group.

    Attributes:
        subjects: accuracy in percent [systems, subjects], best first, reference results among them; empty where no run
            is complete.
        mixed: whether captures of one subject are on both sides of a fold.
        rows: the statistics, a row per system.
        pairs: those of every pair of the most accurate systems.
        compared: blocks with the statistics.
        people: the picture of the subjects.
        speed: the pictures of accuracy against costs.
        details: gestures, confusions, probabilities, training.
    """

    subjects: pd.DataFrame
    mixed: bool = False
    rows: pd.DataFrame = field(default_factory=pd.DataFrame)
    pairs: pd.DataFrame = field(default_factory=pd.DataFrame)
    compared: list[Block] = field(default_factory=list)
    people: list[Block] = field(default_factory=list)
    speed: list[Picture] = field(default_factory=list)
    details: list[Block] = field(default_factory=list)


def largest_groups(runs: pd.DataFrame) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Runs by group, and the names of groups beyond `GROUPS`.

    People stand before generated captures, protocols that say something of new persons before those that mix subjects,
    then the groups with most subjects, then those with most systems.
    """
    mixed = pd.Series([facts_of(run).mixes_subjects for run in rows_of(runs)], runs.index)
    size = (
        runs.assign(mixed=mixed)
        .groupby("group")
        .agg(
            synthetic=("synthetic", "max"),
            mixed=("mixed", "max"),
            subjects=("subjects", "max"),
            systems=("system", "nunique"),
        )
    )
    order = size.sort_values([*size], ascending=[True, True, False, False], kind="stable").index
    return {g: runs[runs["group"] == g] for g in order[:GROUPS]}, list(order[GROUPS:])


def group_of(
    store: Store, runs: pd.DataFrame, chips: pd.DataFrame | None, papers: pd.DataFrame, folder: Path, number: int
) -> Group:
    """Statistics and figures of the runs of one group.

    Args:
        store: where they are.
        runs: of the group, as `bench.outcomes.runs.with_groups` makes them.
        chips: all runs of ``bench chip``, None where there is none.
        papers: `reports.comparison.published`.
        folder: where figures go.
        number: of the group, in the names of files.
    """
    group = runs["group"].iloc[0]
    subjects, seeds, references = systems_by_subject(store, runs)
    if not len(subjects):
        return Group(subjects, compared=[Text("There is no complete run to compare.", warning=True)])
    runs = independent(runs)
    first = runs[runs["status"] == "FINISHED"].iloc[0].to_dict()
    own = subjects.drop(index=[*references])
    kept = subjects.iloc[: statistics.RANKED]
    facts = facts_of(first)
    ratio = facts.test_over_train
    rows = statistics.against_best(kept, fold_table(store, runs, kept, ratio), ratio)
    rows = rows.assign(seeds=rows["system"].map(seeds))
    said = statistics.warnings(subjects.shape[1], len(kept), int(first["folds"]), facts.mixes_subjects)
    compared: list[Block] = [
        Text(line, warning=i == 0 and subjects.shape[1] < statistics.FEW_SUBJECTS) for i, line in enumerate(said)
    ]
    caption = f"{group}: every system against the best one, paired over {subjects.shape[1]} subjects. "
    caption += ranks.STATISTICS
    if len(subjects) > len(kept):
        caption += f" The {len(kept)} most accurate of {len(subjects)} systems."
    compared.append(ranks.statistics_table(rows, caption, first["data"]))
    name = f"{number}-{slug(group)}"
    pairs = statistics.pairs(kept.iloc[: statistics.PAIRED])
    if len(kept) > 2 and subjects.shape[1] > 1:
        compared.append(ranks.matrix(kept.iloc[: statistics.PAIRED], pairs, group))
        tested = statistics.friedman(kept)
        compared.append(ranks.difference_diagram(tested, group, folder, f"{name}-ranks", len(subjects) - len(kept)))
        rows = rows.assign(mean_rank=rows["system"].map(tested.mean), friedman_p=tested.p)
    points = speed.points(runs, own, papers)
    if chips is not None and len(on_chip := chips.merge(runs[[*COMPARABLE]].drop_duplicates(), on=[*COMPARABLE])):
        found = speed.chip_points(on_chip, lambda runs: by_subject(store, runs)[0])
        points = pd.concat([points, found]).sort_values("accuracy", ascending=False, ignore_index=True)
    return Group(
        subjects,
        facts.mixes_subjects,
        rows,
        pairs,
        compared,
        [ranks.strip_plot(subjects, group, folder, f"{name}-subjects")],
        [speed.speed_chart(points, group, folder, f"{name}-speed")],
        detail_figures(store, runs, own, group, folder, name),
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
    store: Store, runs: pd.DataFrame, subjects: pd.DataFrame, group: str, folder: Path, name: str
) -> list[Block]:
    """Figures that need predictions or histories, of the most accurate systems, one seed each, not the luckiest."""
    complete = (
        runs[runs["status"] == "FINISHED"]
        .sort_values("seed", key=lambda c: c.map(seed_number))
        .drop_duplicates("system")
        .set_index("system")
    )
    chosen = {s: complete.loc[s].to_dict() | {"system": s} for s in subjects.index}
    read = {}
    for system in [*chosen][:SYSTEMS]:
        if (found := predictions(store, chosen[system])) is not None:
            read[system] = found
    blocks: list[Block] = []
    recalls, reliability = {}, {}
    for i, (system, table) in enumerate(read.items(), 1):
        labelled, classes = scores.captures(table), scores.classes_of(table)
        if i == 1:
            counts = scores.confusion(labelled, classes)
            blocks.append(details.confusion_figure(counts, system, group, folder, f"{name}-confusion"))
        recalls[system] = details.recall_interval(labelled, classes)
        reliability[system] = details.calibration(table)
    if recalls:
        blocks.insert(0, details.gesture_figure(recalls, group, folder, f"{name}-gestures"))
        with_ = {s: found for s, found in reliability.items() if found}
        without = [s for s in reliability if s not in with_]
        if with_:
            blocks.append(details.calibration_figure(with_, without, group, folder, f"{name}-calibration"))
        else:
            blocks.append(Text(f"Labels only, no probabilities to calibrate: {', '.join(without)}."))
        words = f"Drawn are the {len(read)} most accurate systems, of each the run with the lowest seed"
        blocks.insert(0, Text(f"{words}; confusions are those of the first."))
    found = {}
    networks = [run for run in chosen.values() if run["features"] == "raw frames"]
    for run in networks[: 5 * SYSTEMS]:  # not all that read raw frames are trained in epochs
        if len(found) < SYSTEMS and (history := curves.histories(store, run)):
            found[run["system"]] = history
    if found:
        blocks.append(curves.training_figure(found, group, folder, f"{name}-training"))
    if by_length := curves.lengths(store, runs):
        blocks.append(curves.length_figure(by_length, group, folder, f"{name}-lengths"))
    return blocks


def slug(text: str, most: int = 48) -> str:
    """Words for the name of a file."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:most].strip("-")
