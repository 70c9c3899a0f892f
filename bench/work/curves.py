"""Accuracy in each case of a circumstance. Every function is pure.

The table ``labels`` of a run has a row per tested capture and case: ``fold``, ``capture``, ``length`` (frames, as it
is), ``circumstance`` (its key; empty for the captures as they are), ``case`` (such as the name of a fault), ``level``
(how much of it), ``amount`` (that in words), ``train_subjects`` (how many subjects the system was fitted on), ``true``,
``predicted``, ``p_true`` (probability of the true class), and the columns of the corpus's captures (``subject`` and
conditions).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from bench import scores

if TYPE_CHECKING:
    from bench.result import Result

COLUMNS = frozenset(
    {"length", "circumstance", "case", "level", "amount", "train_subjects", "predicted", "p_true", "hit"}
)
CAPTURE = ["fold", "capture"]


def unharmed(labels: pd.DataFrame) -> pd.DataFrame:
    """The captures as they are, labelled by the systems that were fitted on all training subjects of their fold."""
    return labels[labels["circumstance"] == ""].reset_index(drop=True)


def clean_accuracy(result: Result) -> float:
    """Accuracy of the captures as they are, mean over subjects."""
    return result.metrics["accuracy"]


def curve(labels: pd.DataFrame, key: str) -> pd.DataFrame:
    """Accuracy by case and level of a circumstance, a row each.

    Columns: ``case``, ``level``, ``amount``, ``captures``, ``subjects``, ``accuracy`` (mean over subjects) with its
    95 % t-interval (``low``, ``high``) and SD (``subject_sd``), ``loss`` (clean accuracy minus this), and how many
    captures went from a right label to a wrong one (``broken``) and back (``mended``). Where a system abstains in a
    case, ``abstained`` is the share of the captures on which it does.
    """
    hits = labels.assign(hit=labels["true"] == labels["predicted"])
    clean = unharmed(hits).set_index(CAPTURE)["hit"]
    rows = []
    for (case, level), part in hits[hits["circumstance"] == key].groupby(["case", "level"], sort=False):
        before = clean.loc[pd.MultiIndex.from_frame(part[CAPTURE])].to_numpy()
        now = part["hit"].to_numpy()
        scored = scores.over_people(part)
        usual = pd.Series(before).groupby(part["subject"].to_numpy()).mean().mean()
        about = {"case": case, "level": level, "amount": part["amount"].iloc[0]}
        about |= {"captures": len(part), "subjects": part["subject"].nunique()}
        changed = {"broken": int((before & ~now).sum()), "mended": int((~before & now).sum())}
        shares = {"loss": usual - scored["accuracy"], "abstained": (part["predicted"] == scores.ABSTAINED).mean()}
        rows.append(about | scored | shares | changed)
    names = ["case", "level", "amount", "captures", "subjects", "accuracy", "low", "high", "subject_sd"]
    table = pd.DataFrame(rows, columns=[*names, "loss", "broken", "mended", "abstained"])
    return table if table["abstained"].any() else table.drop(columns="abstained")


def loss(table: pd.DataFrame) -> dict[str, float]:
    """Mean loss over the levels of each case."""
    return {str(case): float(part.mean()) for case, part in table.groupby("case", sort=False)["loss"]}


def joined(results: Sequence[Result], name: str, make: Callable[[Result], pd.DataFrame] | None = None) -> pd.DataFrame:
    """A table of the results that have it, below each other, with data, subset, protocol, system and seed."""
    parts = []
    for r in results:
        about = dict(zip(("data", "subset", "protocol"), r.context, strict=True)) | {
            "system": r.system,
            "seed": r["seed"],
        }
        if (table := make(r) if make else r.tables.get(name)) is None:
            continue
        parts.append(table.assign(**about)[[*about, *table.columns]])
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
