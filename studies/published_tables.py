"""Recompute accuracies from the confusion tables of papers, in the folder ``published``.

    python studies/published_tables.py

``albawi2018_table3.csv`` has counts of windows, in the order and under the names of the print.
``jung2017_table8.csv`` has counts of captures; columns are the actual classes.
``jung2017_table7.csv`` has the share of correct captures of each subject. ``hughes2017_haart.csv``
(Tables II to IV) and ``hughes2017_cost.csv`` (V to VII) have percent of each actual class.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd

from bench.reports.comparison import load_published

# Test captures of the 2015 challenge by class: HAART's from the release, CoST's 119 squeezes and
# 120 of each other gesture.
HAART_TEST = {"constant": 35}
HAART_WINDOWS = 46  # of 27 frames every 9 in 432
COST_TEST = {"squeeze": 119}
TABLES = {  # of Hughes et al. 2017: corpus, row of published.csv that must agree, what is counted
    "II": ("haart", "hughes2017-haart-cnn", "windows"),
    "III": ("haart", "hughes2017-haart-cnn-rnn", "captures"),
    "IV": ("haart", "hughes2017-haart-ae-rnn", "captures"),
    "V": ("cost", "hughes2017-cost-cnn", "windows"),
    "VI": ("cost", "hughes2017-cost-cnn-rnn", "parts of captures"),
    "VII": ("cost", "hughes2017-cost-ae-rnn", "parts of captures"),
}
FOLDER = Path(__file__).with_name("published")


def read_table(name: str) -> pd.DataFrame:
    """Read one of the CSV files, with its first column as index."""
    return pd.read_csv(FOLDER / f"{name}.csv", index_col=0)


def albawi_counts() -> pd.DataFrame:
    """Windows [actual, predicted] of Albawi et al. 2018, Table 3, labelled as printed."""
    return read_table("albawi2018_table3")


def jung_counts() -> pd.DataFrame:
    """Captures [actual, predicted] of Jung et al. 2017, Table 8 (SVM with RBF kernel)."""
    return read_table("jung2017_table8").T


def hughes_percent(number: str) -> pd.DataFrame:
    """Percent of each actual class [actual, predicted] of Hughes et al. 2017, ``II`` to ``VII``."""
    return read_table(f"hughes2017_{TABLES[number][0]}").loc[number].set_index("actual")


def hughes_counts(number: str) -> tuple[pd.DataFrame, np.ndarray] | None:
    """The counts behind a table of percentages; None for Table V.

    The windows by class of Table V are unpublished. HAART's test captures by class are known. The
    rows of VI and VII count parts of captures, so that the total of a row is the smallest one that
    gives its percentages (`implied_counts`).

    Returns:
        Counts [actual, predicted], and the totals of the rows, which are higher where the print
        has lost some.
    """
    percent = hughes_percent(number)
    if number == "V":
        return None
    if TABLES[number][0] == "haart":
        totals = np.array([HAART_TEST.get(name, 36) for name in percent.index])
        totals *= HAART_WINDOWS if number == "II" else 1
        counts = (percent.T * totals / 100).T
        return counts if number == "II" else counts.round(), totals
    rows = {name: row.to_numpy() for name, row in percent.iterrows()}
    pairs = [implied_counts(row, COST_TEST.get(name, 120)) for name, row in rows.items()]
    counts = pd.DataFrame([row for row, _ in pairs], percent.index, percent.columns)
    return counts, np.array([total for _, total in pairs])


def implied_counts(percent: np.ndarray, least: int) -> tuple[np.ndarray, int]:
    """Whole numbers behind printed percentages, and their total.

    The total is the smallest one, of one to three parts a capture, whose counts give every
    percentage within rounding and add up to it. If there is none, the print may be wrong by one
    unit of the last digit and one count. A row that adds up to less than 99 % has lost counts,
    which the total keeps.

    Args:
        percent: one row with one decimal place, [classes].
        least: captures of the class. Parts take two seconds or longer, and the longest gesture,
            massage, 3.5 s on average, so there are fewer than three parts a capture.

    Raises:
        ValueError: no such total gives the row.
    """
    for tolerance, slack in ((0.0501, 0), (0.1001, 1)):
        for total in range(least, 3 * least):
            counts = np.round(percent * total / 100)
            printed = total if percent.sum() > 99 else round(percent.sum() * total / 100)
            error = np.abs(100 * counts / total - percent).max()
            if error <= tolerance and abs(counts.sum() - printed) <= slack:
                return counts, total
    raise ValueError(f"no total from {least} to {3 * least - 1} gives {percent}")


def score_counts(counts: pd.DataFrame, totals: np.ndarray | None = None) -> dict[str, float]:
    """Pooled accuracy, macro recall and macro precision in percent, with the numbers behind them.

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


def recompute_accuracies(papers: pd.DataFrame) -> pd.DataFrame:
    """A row for each confusion table: the claimed accuracy, and the recomputed ones.

    ``agrees`` says whether the claim is the pooled accuracy to half a unit of the claim's last
    digit, with a tenth of a percent for tables that are themselves printed in percent.

    Args:
        papers: `bench.reports.comparison.load_published`.
    """
    claims = papers.set_index("id")["accuracy"]
    albawi, jung = score_counts(albawi_counts()), score_counts(jung_counts())
    rows = [
        ("Albawi et al. 2018, Table 3", "windows", "albawi2018-headline", albawi, 0.05),
        ("Jung et al. 2017, Table 8", "captures", "jung2017-svm-rbf-all", jung, 0.5),
    ]
    for numeral, (data, claim, unit) in TABLES.items():
        counts = hughes_counts(numeral)
        if counts is None:
            scores = dict.fromkeys(("right", "of", "pooled"), np.nan)
            scores["macro_recall"] = hughes_percent(numeral).to_numpy().diagonal().mean()
        else:
            scores = score_counts(*counts)
        name = f"Hughes et al. 2017, Table {numeral} ({'HAART' if data == 'haart' else 'CoST'})"
        rows.append((name, unit, claim, scores, 0.105))
    tables = pd.DataFrame(
        [
            {"source": name, "unit": unit, "claimed": claims[claim], **scores}
            for name, unit, claim, scores, _ in rows
        ]
    )
    excess = (tables["pooled"] - tables["claimed"]).abs() - [tolerance for *_, tolerance in rows]
    return tables.assign(agrees=np.select([excess.isna(), excess <= 0], ["-", "yes"], "no"))


def correlate_exchanges(albawi: pd.DataFrame, jung: pd.DataFrame) -> pd.DataFrame:
    """Correlate two confusion tables, as printed and after exchanging two labels of the first.

    The correlation is that, over pairs of classes, of the share of each class that is classified as
    the other, added in both directions.

    Returns:
        ``first``, ``second`` (empty as printed) and ``correlation``, the highest first.
    """
    names = list(jung.columns)
    other = _confusion_shares(jung.loc[names, names].to_numpy(dtype=float))
    rows = []
    for pair in [(), *itertools.combinations(names, 2)]:
        partners = dict([pair, pair[::-1]]) if pair else {}
        order = [partners.get(name, name) for name in names]
        exchanged = _confusion_shares(albawi.loc[order, order].to_numpy(dtype=float))
        rows.append([*(pair or ("", "")), np.corrcoef(exchanged, other)[0, 1]])
    table = pd.DataFrame(rows, columns=["first", "second", "correlation"])
    return table.sort_values("correlation", ascending=False)


def _confusion_shares(counts: np.ndarray) -> np.ndarray:
    share = counts / counts.sum(axis=1, keepdims=True)
    return (share + share.T)[np.triu_indices(len(share), 1)]


def main() -> None:
    """Print the recomputed accuracies, and the exchange of labels after which two papers agree."""
    print(recompute_accuracies(load_published()).round(2).to_string(index=False))
    exchanged = correlate_exchanges(albawi_counts(), jung_counts())
    print("\nAlbawi et al. 2018 against Jung et al. 2017:")
    print(exchanged.iloc[[0]].round(2).to_string(index=False))
    print(f"as printed: {exchanged.loc[exchanged['first'] == '', 'correlation'].item():.2f}")


if __name__ == "__main__":
    main()
