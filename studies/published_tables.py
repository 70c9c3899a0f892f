"""Published numbers recomputed from the papers' own tables, which lie in the folder ``published``.

    python studies/published_tables.py > docs/notes/recomputed.md

``albawi2018_table3.csv`` holds counts of windows, rows and columns in the order and under the names of the print.
``jung2017_table8.csv`` holds counts of captures, columns are the actual classes; ``jung2017_table7.csv`` the share of
correct captures of each subject. ``hughes2017_haart.csv`` (Tables II to IV) and ``hughes2017_cost.csv`` (V to VII)
hold percent of each actual class.
"""

from __future__ import annotations

import itertools
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd

from bench.measures import Measure, known, text
from bench.outcomes import statistics
from bench.reports.comparison import published
from bench.reports.paired_statistics import statistics_table
from bench.reports.papers import NAMES
from bench.table import Table, rows_of

# Test captures of the 2015 challenge by class: HAART's from the release, CoST's 119 squeezes and 120 of all others.
HAART_TEST = {"constant": 35}
HAART_WINDOWS = 46  # of 27 frames every 9 in 432
COST_TEST = {"squeeze": 119}
TABLES = {  # of Hughes et al. 2017: corpus, row of published.csv that it must agree with, what is counted
    "II": ("haart", "hughes2017-haart-cnn", "windows"),
    "III": ("haart", "hughes2017-haart-cnn-rnn", "captures"),
    "IV": ("haart", "hughes2017-haart-ae-rnn", "captures"),
    "V": ("cost", "hughes2017-cost-cnn", "windows"),
    "VI": ("cost", "hughes2017-cost-cnn-rnn", "parts of captures"),
    "VII": ("cost", "hughes2017-cost-ae-rnn", "parts of captures"),
}
FOLDER = Path(__file__).with_name("published")
WIDTH = 150  # characters of a line of the page


def table(name: str) -> pd.DataFrame:
    """Read one of the CSV files, with its first column as index."""
    return pd.read_csv(FOLDER / f"{name}.csv", index_col=0)


def albawi_counts() -> pd.DataFrame:
    """Windows [actual, predicted] of Albawi et al. 2018, Table 3, labelled as printed."""
    return table("albawi2018_table3")


def jung_counts() -> pd.DataFrame:
    """Captures [actual, predicted] of Jung et al. 2017, Table 8 (SVM with RBF kernel)."""
    return table("jung2017_table8").T


def subjects_of_jung() -> pd.DataFrame:
    """Accuracy in percent [classifiers, subjects] of Jung et al. 2017, Table 7."""
    return 100 * table("jung2017_table7").T


def hughes_percent(number: str) -> pd.DataFrame:
    """Percent of each actual class [actual, predicted] of a table of Hughes et al. 2017, ``II`` to ``VII``."""
    return table(f"hughes2017_{TABLES[number][0]}").loc[number].set_index("actual")


def hughes_counts(number: str) -> tuple[pd.DataFrame, np.ndarray] | None:
    """The counts behind a table of percentages; None for Table V, whose windows by class are unpublished.

    HAART's test captures by class are known. The rows of VI and VII count parts of captures, so that a row's total
    is the smallest one that gives its percentages (`implied_counts`).

    Returns:
        Counts [actual, predicted], and the totals of the rows, which are higher where the print has lost some.
    """
    percent = hughes_percent(number)
    if number == "V":
        return None
    if TABLES[number][0] == "haart":
        totals = np.array([HAART_TEST.get(c, 36) for c in percent.index]) * (HAART_WINDOWS if number == "II" else 1)
        counts = (percent.T * totals / 100).T
        return counts if number == "II" else counts.round(), totals
    rows = [implied_counts(row.to_numpy(), COST_TEST.get(name, 120)) for name, row in percent.iterrows()]
    return pd.DataFrame([r for r, _ in rows], percent.index, percent.columns), np.array([n for _, n in rows])


def implied_counts(percent: np.ndarray, least: int) -> tuple[np.ndarray, int]:
    """Whole numbers behind printed percentages, and their total.

    The smallest total of one to three parts a capture whose counts give every percentage within rounding and add up
    to it; if there is none, one unit of the last digit and one count are granted to slips of the print. A row that
    adds up to less than 99 % has lost counts, which the total keeps.

    Args:
        percent: one row with one decimal place, [classes].
        least: captures of the class. Parts are two seconds or longer and the longest gesture, massage, takes 3.5 s
            on average, so that three times as many parts are more than there can be.

    Raises:
        ValueError: no such total gives the row.
    """
    for tolerance, slack in ((0.0501, 0), (0.1001, 1)):
        for total in range(least, 3 * least):
            counts = np.round(percent * total / 100)
            there = total if percent.sum() > 99 else round(percent.sum() * total / 100)
            if np.abs(100 * counts / total - percent).max() <= tolerance and abs(counts.sum() - there) <= slack:
                return counts, total
    raise ValueError(f"no total from {least} to {3 * least - 1} gives {percent}")


def measures(counts: pd.DataFrame, totals: np.ndarray | None = None) -> dict[str, float]:
    """Pooled accuracy, macro recall and macro precision in percent, and how many there were and were right.

    Args:
        counts: [actual, predicted].
        totals: totals of the rows, if they exceed the counts.
    """
    values = counts.to_numpy(dtype=float)
    right = values.diagonal()
    totals = values.sum(axis=1) if totals is None else totals
    return {
        "right": right.sum(),
        "of": totals.sum(),
        "pooled": 100 * right.sum() / totals.sum(),
        "macro_recall": 100 * (right / totals).mean(),
        "macro_precision": 100 * (right / values.sum(axis=0)).mean(),
    }


def recomputed(papers: pd.DataFrame) -> pd.DataFrame:
    """The confusion tables of the papers, a row each: the claimed accuracy, and the recomputed one.

    ``agrees`` says whether the claim is the pooled accuracy to half a unit of the claim's last digit, with a tenth of
    a percent for tables that are themselves printed in percent.

    Args:
        papers: `bench.reports.comparison.published`.
    """
    claims = papers.set_index("id")["accuracy"]
    rows = [
        ("Albawi et al. 2018, Table 3", "windows", claims["albawi2018-headline"], measures(albawi_counts()), 0.05),
        ("Jung et al. 2017, Table 8", "captures", claims["jung2017-svm-rbf-all"], measures(jung_counts()), 0.5),
    ]
    for numeral, (data, claim, unit) in TABLES.items():
        counts = hughes_counts(numeral)
        measured = {"macro_recall": hughes_percent(numeral).to_numpy().diagonal().mean()}
        measured = dict.fromkeys(("right", "of", "pooled"), np.nan) | measured if counts is None else measures(*counts)
        name = f"Hughes et al. 2017, Table {numeral} ({NAMES[data]})"
        rows.append((name, unit, claims[claim], measured, 0.105))
    tables = pd.DataFrame([{"source": s, "unit": u, "claimed": c, **m} for s, u, c, m, _ in rows])
    off = (tables["pooled"] - tables["claimed"]).abs() - [tolerance for *_, tolerance in rows]
    return tables.assign(agrees=np.select([off.isna(), off <= 0], ["-", "yes"], "no"))


def swaps(albawi: pd.DataFrame, jung: pd.DataFrame) -> pd.DataFrame:
    """The similarity of two confusion tables, as printed and after exchanging two labels of the first.

    Alike is the correlation, over pairs of classes, of the share of each class that is taken for the other, added in
    both directions.

    Returns:
        ``first``, ``second`` (empty as printed) and ``correlation``, the highest first.
    """
    names = list(jung.columns)
    other = _confusions(jung.loc[names, names].to_numpy(dtype=float))
    rows = []
    for pair in [(), *itertools.combinations(names, 2)]:
        order = [dict([pair, pair[::-1]] if pair else []).get(n, n) for n in names]
        exchanged = _confusions(albawi.loc[order, order].to_numpy(dtype=float))
        rows.append([*(pair or ("", "")), np.corrcoef(exchanged, other)[0, 1]])
    return pd.DataFrame(rows, columns=["first", "second", "correlation"]).sort_values("correlation", ascending=False)


def _confusions(counts: np.ndarray) -> np.ndarray:
    share = counts / counts.sum(axis=1, keepdims=True)
    return (share + share.T)[np.triu_indices(len(share), 1)]


COLUMNS = (  # of `recomputed`
    text("source", "table"),
    text("unit"),
    Measure("claimed", "claimed %", form="g"),
    text("right", "correct", lambda r: f"{r['right']:.0f} of {r['of']:.0f}" if known(r["of"]) else "not printed"),
    Measure("pooled", "pooled accuracy %", form=".2f"),
    Measure("macro_recall", "macro recall %", form=".2f"),
    Measure("macro_precision", "macro precision %", form=".2f"),
    text("agrees", "claim is the pooled accuracy"),
)


def page() -> str:
    """The page of the documentation, with all numbers computed."""
    tables = recomputed(published())
    albawi = tables.iloc[0]
    exchanged = swaps(albawi_counts(), jung_counts())
    best, printed = exchanged.iloc[0], exchanged[exchanged["first"] == ""].iloc[0]
    subjects = subjects_of_jung()
    subjects = subjects.loc[subjects.mean(axis=1).sort_values(ascending=False).index]
    ranks, p = statistics.friedman(subjects)
    off = tables[(tables["agrees"] == "no") & tables["source"].str.startswith("Hughes")]
    parts = [
        "# Published numbers, recomputed",
        "Papers print confusion tables and accuracies. This page computes the accuracies again from the tables. "
        "`python studies/published_tables.py` makes it; the tables are in `studies/published`.",
        "## Confusion tables",
        f"The {albawi.claimed:g} % of Albawi et al. 2018 is a macro precision ({albawi.macro_precision:.2f} %): the "
        "mean over classes of the share of correct predictions of a class. Of all windows, "
        f"{albawi.right:.0f} of {albawi.of:.0f} are correctly classified, which is a pooled accuracy of "
        f"{albawi.pooled:.2f} %.",
        f"In the same table, the labels {best['first']} and {best.second} are exchanged. The correlation of its "
        f"confusions with Jung et al. 2017, Table 8, is {printed.correlation:.2f} as printed. With these two labels "
        f"exchanged, it is {best.correlation:.2f}, the highest of all {len(exchanged) - 1} exchanges of two labels. "
        "The codes of CoST are 11 squeeze and 12 stroke.",
        *(
            f"{r.source} gives {r.right:.0f} of {r.of:.0f} {r.unit}, {r.pooled:.1f} %; Table I of the same paper gives "
            f"{r.claimed:g} %."
            for r in off.itertuples()
        ),
        "The totals for Hughes et al. 2017, Tables VI and VII, are the smallest that give the printed percentages. The "
        "windows per class in Table V are unknown, so only its macro recall can be computed.",
        Table(COLUMNS, rows_of(tables)),
        "## Classifiers, by subject",
        f"Jung et al. 2017 print the accuracy of each of {subjects.shape[1]} subjects (Table 7). Friedman's test over "
        f"their {len(subjects)} classifiers gives p = {p:.1g}. Mean ranks: "
        + ", ".join(f"{name} {rank:.2f}" for name, rank in ranks.items())
        + ".",
        "Each classifier against the most accurate one, paired over subjects, as in "
        "[the report](../report.md#statistics):",
        statistics_table(statistics.against_best(subjects)),
    ]
    return "\n\n".join(
        _markdown(part) if isinstance(part, Table) else textwrap.fill(part, WIDTH, break_on_hyphens=False)
        for part in parts
    )


def _markdown(table: Table) -> str:
    """A table in Markdown."""
    rows = [table.headings, ["---"] * len(table.headings), *([*row.values()] for row in table.texts)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    print(page())
