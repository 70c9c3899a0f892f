"""The report as a whole: ``bench report`` rebuilds it from MLflow and the files beside this one."""

from __future__ import annotations

import os
import re
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.outcomes import scores, statistics
from bench.outcomes.comparable import COMPARABLE, facts_of, seed_number
from bench.outcomes.runs import NothingTracked, by_subject, predictions, tracked, with_groups
from bench.outcomes.store import Store
from bench.scratch import owner, sweep
from reports import behaviour, curves, details, ranks, recomputed, speed
from reports.comparison import comparison, published, shown
from reports.figures import Picture
from reports.latex import latex
from reports.layout import Block, Chart, Heading, Table, Text, footnotes, markdown, page
from reports.newcomers import newcomer_blocks
from reports.provenance import provenance, software
from reports.sheet import write_sheet
from reports.verdicts import against

GROUPS = 3  # captures-and-protocol groups that get statistics and figures
SYSTEMS = 2  # systems of a group whose predictions are read and drawn
ROWS = 300  # of a table on the page; the CSV files hold all


def write_report(store: Store, folder: Path) -> list[Path]:
    """Write ``index.html``, ``comparison.md``, ``comparison.tex``, a CSV file for each table, figures as PNG and SVG.

    Args:
        store: where the runs are.
        folder: where they go; it is created.

    Returns:
        The files written.

    Raises:
        InputError: the store holds no scored run, or the folder cannot be written.
    """
    runs, papers = with_groups(tracked(store)), published()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder, ".")
        with tempfile.TemporaryDirectory(prefix=f".{owner()}", dir=folder) as beside:
            written = _write(store, Path(beside), runs, papers)
            (folder / "figures").mkdir(exist_ok=True)
            for name in written:  # a report that is stopped while it is made leaves the earlier one as it was
                os.replace(Path(beside) / name, folder / name)
        for old in (folder / "figures").glob("[0-9]*-*.[ps][nv]g"):
            if old.relative_to(folder) not in written:  # of an earlier report
                old.unlink()
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e.strerror}); choose another out=") from e
    return [folder / name for name in written]


def _write(store: Store, folder: Path, runs: pd.DataFrame, papers: pd.DataFrame) -> list[Path]:
    """Write a report into an empty folder; its files, the page last, relative to the folder."""
    (folder / "figures").mkdir()
    blocks, tables = assemble(store, runs, papers, folder / "figures")
    for name, table in tables.items():
        write_sheet(table, folder / f"{name}.csv")
    (folder / "comparison.md").write_text(markdown(blocks, folder), encoding="utf-8")
    (folder / "comparison.tex").write_text(latex(tables["comparison"]), encoding="utf-8")
    (folder / "index.html").write_text(page(blocks, blocks[0].text), encoding="utf-8")
    pictures = sorted(path.relative_to(folder) for b in blocks if isinstance(b, Picture) for path in b.paths)
    return [
        *pictures,
        *(Path(f"{name}.csv") for name in tables),
        Path("comparison.md"),
        Path("comparison.tex"),
        Path("index.html"),
    ]


def assemble(
    store: Store, runs: pd.DataFrame, papers: pd.DataFrame, folder: Path
) -> tuple[list[Block], dict[str, pd.DataFrame]]:
    """All blocks of the report in order, and the tables that go into CSV files; figures are drawn into ``folder``."""
    beside = against(papers, runs, store)
    table = comparison(runs, papers)
    everything = [runs]
    for kind in ("stress", "stream", "chip"):
        with suppress(NothingTracked):
            everything.append(with_groups(tracked(store, kind)))
    from_runs = provenance(pd.concat(everything, ignore_index=True))
    tables = {"comparison": table, "published": beside, "recomputed": recomputed.recomputed(papers)}
    blocks: list[Block] = [Heading("Recognisers of social touch: published and repeated", 1), *opening(runs)]
    blocks += [Heading("Every published system"), *published_blocks(beside)]
    blocks += [Heading("Published numbers, recomputed"), *recomputed_blocks(papers)]
    blocks += [Heading("All runs"), *run_blocks(table)]
    groups, left_out = largest_groups(runs)
    each = {group: group_blocks(store, part, papers, folder, i) for i, (group, part) in enumerate(groups.items(), 1)}
    clouds = {group: points for group, (_, _, points) in each.items() if len(points)}
    if clouds:
        blocks += [Heading("Accuracy and cost"), Text(SPEED), Chart(speed.chart_data(clouds))]
    if left_out:
        said = (
            f"The {GROUPS} largest groups of runs have statistics and figures; these have none: {'; '.join(left_out)}."
        )
        blocks.append(Text(said))
    for group, (own, _, _) in each.items():
        blocks += [Heading(group[0].upper() + group[1:]), *own]
    for title, found in {
        "Stress": behaviour.stress_blocks(store, folder),
        "Stream": behaviour.stream_blocks(store, folder),
        "A new person": newcomer_blocks(store, runs, folder),
    }.items():
        blocks += [Heading(title), *found] if found else []
    blocks += [Heading("Provenance"), *provenance_blocks(runs, from_runs)]
    tables["statistics"] = pd.concat([found.assign(group=g) for g, (_, found, _) in each.items()], ignore_index=True)
    return blocks, tables | {"provenance": from_runs}


SPEED = (
    "Accuracy is the mean over subjects, with its 95 % t-interval; seeds of a system are averaged. Times depend on the "
    "machine that is named under provenance. The same charts stand as figures below each group."
)


def opening(runs: pd.DataFrame) -> list[Block]:
    """What the report is about, and what must be known before any number is read."""
    people = runs[runs["synthetic"] != "true"]
    corpora = ", ".join(sorted(set(runs["data"] + np.where(runs["synthetic"] == "true", " (synthetic)", ""))))
    blocks: list[Block] = [
        Text(
            f"{len(runs)} tracked runs of {runs['system'].nunique()} systems on {corpora}. Numbers are compared only "
            "where data, subset, protocol and unit agree. Every interval is over subjects: people differ more than "
            "captures of one person do."
        )
    ]
    if len(people) < len(runs):
        blocks.append(
            Text(
                "Rows and figures marked (synthetic) come from generated captures and say nothing about people.",
                warning=True,
            )
        )
    if len(failed := runs[runs["folds_failed"] > 0]):
        systems = ", ".join(sorted(set(failed["system"])))
        blocks.append(
            Text(f"Runs with failed folds are scored on the others and compared with nothing: {systems}.", warning=True)
        )
    return blocks


def published_blocks(beside: pd.DataFrame) -> list[Block]:
    """The comparison table of the CNN85 paper, corrected and completed."""
    frame = pd.DataFrame(
        {
            "system": beside["reference"],
            "data": beside["data"],
            "subset": beside["subset"],
            "protocol": beside["protocol"],
            "unit": beside["unit"],
            "features": [_sized(r.features, r.n_features) for r in beside.itertuples()],
            "classifier": beside["classifier"],
            "published % ± SD": [_sd(r.published, r.published_sd) for r in beside.itertuples()],
            "CNN85's Table 4": [_sd(r.table4, r.table4_sd) for r in beside.itertuples()],
            "ours % [95 %]": [_bounded(r.ours, r.low, r.high) for r in beside.itertuples()],
            "SD": beside["ours_sd"].map(_one),
            "subjects": beside["subjects"].map(_count),
            "seed": beside["seed"],
            "difference": beside["difference"].map(_signed),
            "verdict": [_verdict(r) for r in beside.itertuples()],
        }
    )
    marks, notes = footnotes([n.split("\n") if n else [] for n in beside["note"]])
    caption = (
        "Every published number on CoST and HAART, and ours under the same protocol and in the same unit, one row a "
        "seed. SD and interval are over subjects."
    )
    few = int((beside["subjects"] < statistics.FEW_SUBJECTS).sum())
    return [
        Text(
            "The verdict compares the printed number with the 95 % interval of ours: within interval, above (ours "
            "is, with its whole interval) or below. Not run: nothing tracked stands beside it; data not here: "
            "nothing is tracked on this corpus. The column CNN85's Table 4 holds what Albawi et al. 2018 print for "
            "it, always under 31 subjects and 14 gestures; the footnotes say where subset, protocol or unit are "
            "others."
        ),
        *(
            [
                Text(
                    f"{few} verdicts rest on fewer than {statistics.FEW_SUBJECTS} subjects (the challenge's test part "
                    "of HAART has 3): such an interval is hardly worth anything.",
                    warning=True,
                )
            ]
            if few
            else []
        ),
        Table(frame, caption, marks, notes),
    ]


def _verdict(row: object) -> str:
    few = row.subjects < statistics.FEW_SUBJECTS  # False where ours is missing
    return f"{row.verdict}, {row.subjects:.0f} subject{'s' * (row.subjects != 1)} only" if few else row.verdict


def recomputed_blocks(papers: pd.DataFrame) -> list[Block]:
    """What the papers' own tables say."""
    found = recomputed.recomputed(papers)
    frame = pd.DataFrame(
        {
            "table": found["source"],
            "unit": found["unit"],
            "claimed %": found["claimed"].map("{:g}".format),
            "correct": [f"{_count(r.right)} of {_count(r.of)}" for r in found.itertuples()],
            "pooled accuracy %": found["pooled"].map(_two),
            "macro recall %": found["macro_recall"].map(_two),
            "macro precision %": found["macro_precision"].map(_two),
            "claim is the pooled accuracy": found["agrees"],
        }
    )
    subjects = recomputed.subjects_of_jung()
    subjects = subjects.loc[subjects.mean(axis=1).sort_values(ascending=False).index]
    tested = statistics.friedman(subjects)
    rows = statistics.against_best(subjects, test_over_train=1 / (subjects.shape[1] - 1))
    return [
        *(Text(sentence) for sentence in recomputed.findings(papers)),
        Table(frame, "Confusion tables of the papers, and what they give."),
        Text(
            f"Jung et al. 2017 print the accuracy of each of {subjects.shape[1]} subjects (Table 7). Friedman's test "
            f"over their five classifiers: p = {tested.p:.1g}; mean ranks that differ by less than "
            f"{tested.critical:.2f} are not "
            f"told apart: " + ", ".join(f"{name} {rank:.2f}" for name, rank in tested.mean.items()) + "."
        ),
        Table(
            statistics_table(rows), "Jung et al. 2017, Table 7: each classifier against the best one, over subjects."
        ),
    ]


def run_blocks(table: pd.DataFrame) -> list[Block]:
    """Every tracked run and unit, as far as the page has room."""
    caption = (
        "Accuracy is pooled over the tested captures (or windows), its interval a bootstrap over subjects. Fit is "
        "the mean of a fold without feature extraction; predict is one whole capture from raw frames to label on "
        "one thread, feature extraction included; decision is the median touch that must be observed plus computing "
        "time. n is the number of tested subjects."
    )
    kept = table
    if len(table) > ROWS:
        each = max(1, ROWS // table["group"].nunique())
        kept = table.groupby("group", sort=False).head(each)
        caption += f" The first {each} rows of each group; all {len(table)} are in comparison.csv."
    few = sorted(set(table.loc[table["subjects"] < statistics.FEW_SUBJECTS, "group"]))
    warning = f"Fewer than {statistics.FEW_SUBJECTS} test subjects, so that intervals are hardly worth anything: "
    return [*([Text(warning + "; ".join(few) + ".", warning=True)] if few else []), Table(shown(kept), caption)]


def largest_groups(runs: pd.DataFrame) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Runs by group, people first, then by subjects and systems; and the names of groups beyond `GROUPS`."""
    size = runs.groupby("group").agg(
        synthetic=("synthetic", "max"), subjects=("subjects", "max"), systems=("system", "nunique")
    )
    order = size.sort_values(["synthetic", "subjects", "systems"], ascending=[True, False, False], kind="stable").index
    return {g: runs[runs["group"] == g] for g in order[:GROUPS]}, list(order[GROUPS:])


def group_blocks(
    store: Store, runs: pd.DataFrame, papers: pd.DataFrame, folder: Path, number: int
) -> tuple[list[Block], pd.DataFrame, pd.DataFrame]:
    """Statistics and figures of the runs on the same captures under the same protocol.

    Returns:
        The blocks, the statistics, and the points of the speed chart.
    """
    group = runs["group"].iloc[0]
    subjects, seeds = by_subject(store, runs)
    if not len(subjects):
        return (
            [Text("No run is complete, so that nothing can be compared.", warning=True)],
            pd.DataFrame(),
            pd.DataFrame(),
        )
    first = runs[runs["status"] == "FINISHED"].iloc[0].to_dict()
    kept = subjects.iloc[: statistics.RANKED]
    facts = facts_of(first)
    ratio = facts.test_over_train
    rows = statistics.against_best(kept, fold_table(store, runs, kept, ratio), ratio)
    rows = rows.assign(seeds=rows["system"].map(seeds))
    said = statistics.warnings(subjects.shape[1], len(kept), int(first["folds"]), facts.mixes_subjects)
    blocks: list[Block] = [
        Text(line, warning=i == 0 and subjects.shape[1] < statistics.FEW_SUBJECTS) for i, line in enumerate(said)
    ]
    caption = f"{group}: every system against the best one, paired over {subjects.shape[1]} subjects. " + STATISTICS
    if len(subjects) > len(kept):
        caption += f" The {len(kept)} most accurate of {len(subjects)} systems."
    blocks.append(Table(statistics_table(rows), caption))
    name = f"{number}-{slug(group)}"
    if len(kept) > 2 and subjects.shape[1] > 1:
        tested = statistics.friedman(kept)
        blocks.append(ranks.difference_diagram(tested, group, folder, f"{name}-ranks", len(subjects) - len(kept)))
        rows = rows.assign(mean_rank=rows["system"].map(tested.mean), friedman_p=tested.p)
    blocks.append(ranks.strip_plot(subjects, group, folder, f"{name}-subjects"))
    points = speed.points(runs, subjects, papers)
    if len(chips := on_chip(store, runs)):
        found = speed.chip_points(chips, lambda runs: by_subject(store, runs)[0])
        points = pd.concat([points, found]).sort_values("accuracy", ascending=False, ignore_index=True)
    blocks.append(speed.speed_chart(points, group, folder, f"{name}-speed"))
    blocks += detail_figures(store, runs, subjects, group, folder, name)
    return blocks, rows, points


def on_chip(store: Store, group: pd.DataFrame) -> pd.DataFrame:
    """Runs of systems as C on the captures and under the protocol of a group; none where nothing was exported."""
    try:
        runs = tracked(store, "chip")
    except NothingTracked:
        return pd.DataFrame()
    return runs.merge(group[[*COMPARABLE]].drop_duplicates(), on=[*COMPARABLE])


STATISTICS = (
    "Difference is in points with its 95 % t-interval; corrected is the same with Nadeau and Bengio's variance, "
    "which allows for training captures that folds share (- where there is one fold); p is Wilcoxon's signed rank "
    "test, Holm's correction is for all systems of the table; dz is Cohen's effect size of paired differences with "
    "its 95 % interval, r the matched-pairs rank-biserial correlation. Seeds are averaged within subjects."
)


def fold_table(store: Store, runs: pd.DataFrame, kept: pd.DataFrame, ratio: float | None) -> pd.DataFrame | None:
    """Accuracy in percent [systems, folds], means over seeds; None where folds are subjects or share nothing."""
    complete = runs[(runs["status"] == "FINISHED") & runs["system"].isin(kept.index)]
    if ratio is None or set(store.fold_accuracy(complete["run_id"].iloc[0])) == set(kept.columns):
        return None
    rows = [store.fold_accuracy(run_id) for run_id in complete["run_id"]]
    table = pd.DataFrame(rows, index=complete["system"].to_numpy())
    return table.groupby(level=0).mean().loc[kept.index]


def statistics_table(rows: pd.DataFrame) -> pd.DataFrame:
    """`reports.statistics.against_best` as text."""
    frame = {
        "system": rows["system"],
        "mean over subjects %": rows["accuracy"].map(_one),
        "difference": [_bounded(r.difference, r.low, r.high, sign=True) for r in rows.itertuples()],
        "corrected": [_range(r.nb_low, r.nb_high) for r in rows.itertuples()],
        "p corrected": rows["nb_p"].map(_p),
        "p Wilcoxon": rows["p"].map(_p),
        "p Holm": rows["p_holm"].map(_p),
        "dz": [_bounded(r.dz, r.dz_low, r.dz_high, sign=True, digits=2) for r in rows.itertuples()],
        "r": rows["rank_biserial"].map(lambda v: "-" if np.isnan(v) else f"{v:+.2f}"),
    }
    if "seeds" in rows:
        frame["seeds"] = rows["seeds"]
    return pd.DataFrame(frame)


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


def provenance_blocks(runs: pd.DataFrame, table: pd.DataFrame) -> list[Block]:
    """Corpora, versions, and the command of every run."""
    kept = table.iloc[:ROWS]
    caption = "The command that rebuilds each row, and what it ran on."
    if len(table) > len(kept):
        caption += f" The first {len(kept)} of {len(table)}; all are in provenance.csv."
    corpora = runs.groupby(["data", "synthetic", "corpus_digest"], sort=True).size().reset_index(name="runs")
    corpora["data"] += np.where(corpora.pop("synthetic") == "true", " (synthetic)", "")
    return [
        Text("This report is made by bench report from the MLflow store and the files in reports/ alone."),
        Table(corpora.astype(str), "Corpora by content."),
        Table(software(runs).astype(str), "Versions that runs were made with."),
        Table(kept.astype(str), caption, code=("command",)),
    ]


def slug(text: str, most: int = 48) -> str:
    """Words for the name of a file."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:most].strip("-")


def _sized(features: object, n: float) -> str:
    words = features if isinstance(features, str) else "-"
    return words if pd.isna(n) else f"{words} ({n:.0f})"


def _sd(value: float, sd: float) -> str:
    return "-" if pd.isna(value) else f"{value:g}" + ("" if pd.isna(sd) else f" ± {sd:g}")


def _one(value: float) -> str:
    return "-" if pd.isna(value) else f"{value:.1f}"


def _two(value: float) -> str:
    return "-" if pd.isna(value) else f"{value:.2f}"


def _count(value: float) -> str:
    return "-" if pd.isna(value) else f"{value:.0f}"


def _signed(value: float) -> str:
    return "-" if pd.isna(value) else f"{value:+.1f}"


def _p(value: float) -> str:
    return "-" if pd.isna(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def _range(low: float, high: float) -> str:
    return "-" if pd.isna(low) else f"[{low:+.1f}, {high:+.1f}]"


def _bounded(value: float, low: float, high: float, sign: bool = False, digits: int = 1) -> str:
    form = f"{'+' if sign else ''}.{digits}f"
    return "-" if pd.isna(value) else f"{value:{form}}" + ("" if pd.isna(low) else f" [{low:{form}}, {high:{form}}]")
