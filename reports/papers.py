"""What the papers print, beside ours and recomputed from their own tables, as blocks of the report."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.outcomes import statistics
from reports import published_tables as recomputed
from reports.layout import Block, Table, Text, footnotes
from reports.numbers import bounded, count, listed, one, signed, sized, two, with_sd
from reports.ranks import shown_statistics

NAMES = {"cost": "CoST", "haart": "HAART"}
SHARED = ["data", "subset", "protocol", "words"]  # of published numbers that stand together
UNITS = {
    "capture": "captures",
    "subject mean": "captures, mean over subjects",
    "capture vote": "captures, majority vote",
    "window": "windows",
    "window macro precision": "windows, macro precision",
    "window macro recall": "windows, macro recall",
}


def published_blocks(beside: pd.DataFrame) -> list[Block]:
    """The comparison table of the CNN85 paper, corrected and completed.

    On the page, numbers on corpora that nothing is tracked on wait behind a switch.

    Args:
        beside: as `reports.reproduction.against` makes it.
    """
    units = [UNITS.get(r.unit_key, r.unit) for r in beside.itertuples()]
    beside = beside.assign(away=beside["verdict"] == "data not here", words=units)
    together = beside.groupby(["away", *SHARED], sort=False).ngroup()
    order = np.lexsort([together, beside["data"], beside["away"]])  # the last key first
    beside = beside.iloc[order]
    frame = pd.DataFrame(
        {
            "system": [f"{r.reference}: {r.classifier}" for r in beside.itertuples()],
            "published % ± SD": [with_sd(r.published, r.published_sd) for r in beside.itertuples()],
            "ours % [95 %]": [bounded(r.ours, r.low, r.high) for r in beside.itertuples()],
            "verdict": [_verdict(r) for r in beside.itertuples()],
            "difference": beside["difference"].map(signed),
            "our SD": beside["ours_sd"].map(one),
            "subjects": beside["subjects"].map(count),
            "seed": beside["seed"].replace("", "-"),
            "features": [sized(r.features, r.n_features) for r in beside.itertuples()],
            "CNN85's Table 4": [with_sd(r.table4, r.table4_sd) for r in beside.itertuples()],
        }
    )
    marks, notes = footnotes([n.split("\n") if n else [] for n in beside["note"]])
    caption = (
        "Every published number on CoST and HAART, and ours under the same protocol and in the same unit, one row a "
        "seed. SD and interval are over subjects."
    )
    few = int((beside["subjects"] < statistics.FEW_SUBJECTS).sum())
    judged = beside[beside["ours"].notna()]
    counts = judged["verdict"].value_counts()
    said = [f"{n} {verdict}" for verdict, n in counts.items()]
    elsewhere = [NAMES.get(name, name) for name in sorted(set(beside.loc[beside["away"], "data"]))]
    switch = ""
    if elsewhere:
        count_away = int(beside["away"].sum())
        switch = f"Show also the {count_away} published numbers on {listed(elsewhere)}, where nothing is tracked here"
    shipped = (
        "What our own runs said of every capture of HAART, under LOSO and in four more tasks, comes with touchbench: "
        "bench leaderboard makes a page of it, docs/leaderboard.md says what it holds."
    )
    here = "haart" in set(beside.loc[~beside["away"], "data"])
    return [
        Text(
            f"{len(judged)} of our results stand beside a published number: {listed(said)}."
            if len(judged)
            else "None of the tracked runs has a published number beside it."
            + " Most numbers that papers print on HAART are for the split of the 2015 challenge." * here
        ),
        *([Text(shipped)] if here else []),
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
        Table(
            frame,
            caption,
            marks,
            notes,
            groups=[_on(r) for r in beside.itertuples()],
            away=list(beside["away"]),
            switch=switch,
        ),
        Text(
            "The verdict compares the printed number with the 95 % interval of ours: within interval, above (ours "
            "is, with its whole interval) or below. Not run: nothing tracked stands beside it; data not here: "
            "nothing is tracked on this corpus. The column CNN85's Table 4 holds what Albawi et al. 2018 print for "
            "it, always under 31 subjects and 14 gestures; the footnotes say where subset, protocol or unit are "
            "others."
        ),
    ]


def _on(row: object) -> str:
    """Data, subset, protocol and unit of a published number, in words."""
    parts = {"subset": row.subset, "protocol": row.protocol, "unit": row.words}
    told = [f"{name} not published" if text == "unknown" else text for name, text in parts.items()]
    return f"{NAMES.get(row.data, row.data)}: {'; '.join(told)}"


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
            "correct": [
                "not printed" if np.isnan(r.of) else f"{count(r.right)} of {count(r.of)}" for r in found.itertuples()
            ],
            "pooled accuracy %": found["pooled"].map(two),
            "macro recall %": found["macro_recall"].map(two),
            "macro precision %": found["macro_precision"].map(two),
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
            f"{tested.critical:.2f} are not separated by Nemenyi's test, which is more conservative "
            "than the table below: " + ", ".join(f"{name} {rank:.2f}" for name, rank in tested.mean.items()) + "."
        ),
        Table(
            shown_statistics(rows), "Jung et al. 2017, Table 7: each classifier against the best one, over subjects."
        ),
    ]
