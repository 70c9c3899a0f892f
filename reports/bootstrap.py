"""95 % bootstrap intervals over subjects of class scores: recall of each, macro precision and macro recall."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench import few, resampling, scores


def drawn_confusions(labelled: pd.DataFrame, classes: list[str], draws: int, seed: int) -> np.ndarray:
    """Confusions of subjects drawn with replacement, [draws, true, predicted].

    Args:
        labelled: decisions with ``subject``, ``true`` and ``predicted``.
        classes: their names.
        draws: draws of the bootstrap, whole subjects each.
        seed: random seed of the draws.
    """
    counts = np.array([scores.confusion(part, classes) for _, part in labelled.groupby("subject", sort=True)])
    return np.einsum("ds,sij->dij", resampling.weights([len(counts)], draws, seed)[0], counts)


def macro_interval(
    labelled: pd.DataFrame, classes: list[str], metric: str, draws: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Interval of ``macro_precision`` or ``macro_recall``; a class without a case counts 0, as in the score itself.

    The other arguments are those of `drawn_confusions`.

    Returns:
        NaN, NaN for fewer than `bench.few.INTERVAL` subjects.
    """
    if labelled["subject"].nunique() < few.INTERVAL:
        return np.nan, np.nan
    pooled = drawn_confusions(labelled, classes, draws, seed)
    right, totals = np.einsum("dii->di", pooled), pooled.sum(axis=1 if metric == "macro_precision" else 2)
    low, high = resampling.interval((right / np.maximum(totals, 1)).mean(axis=1))
    return float(low), float(high)


def recall_interval(labelled: pd.DataFrame, classes: list[str], draws: int = 2000, seed: int = 0) -> pd.DataFrame:
    """Percent of each class that is labelled correctly, with its interval; arguments as of `drawn_confusions`.

    Returns:
        ``recall``, ``low``, ``high`` by class; NaN where there is no capture, no interval of too few subjects.
    """
    counts = scores.confusion(labelled, classes).to_numpy()
    table = pd.DataFrame({"recall": _recalls(counts), "low": np.nan, "high": np.nan}, index=classes)
    if labelled["subject"].nunique() >= few.INTERVAL:
        shares = _recalls(drawn_confusions(labelled, classes, draws, seed))
        for i, drawn in enumerate(shares.T):
            seen = drawn[np.isfinite(drawn)]  # a class that nobody drawn has shown
            if len(seen):
                table.iloc[i, 1:] = resampling.interval(seen)
    return table


def _recalls(confusions: np.ndarray) -> np.ndarray:
    """Percent of each class, [..., classes]."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return 100 * np.einsum("...ii->...i", confusions) / confusions.sum(axis=-1)
