"""The picture of ``bench groups``: gestures merged into groups, and the accuracy with each number of groups."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bench.outcomes.groups import LEVELS, Grouping
from bench.reports.figures import LINE, Picture, bars, new_figure, plain, save, width_of

CAPTION = (
    "Gestures merged into groups; each joint lies at the accuracy with so many groups. Below: the same accuracy with "
    "its 95 % interval over subjects, and the accuracy of always naming the largest group of gestures."
)


def draw(table: pd.DataFrame, folder: Path, title: str) -> Picture:
    """Write ``groups.svg``.

    Args:
        table: result of `bench.outcomes.groups.groupings`.
        folder: destination folder.
        title: captures, protocol and system in words.
    """
    steps: list[Grouping] = [*table["grouping"]]
    gestures = [name for (name,) in steps[0]]
    steps.append((tuple(gestures),))
    at = [*table["accuracy"], 100.0]
    left, height = 0.25 + max(width_of(gestures), width_of(["7 groups"])), 1.5 * LINE * (len(gestures) + 1)
    size = left + 6.2, 2 * height + 1.5
    figure, ((tree,), (course,)) = new_figure(size, (2, 1), (left, 1.5, 0.5, 0.45), (0.7, 0.4), title)
    ends: dict[tuple[str, ...], tuple[float, float]] = {
        (name,): (at[0], float(y)) for y, name in enumerate(_order(steps))
    }
    tree.set_yticks([y for _, y in ends.values()], plain(name for (name,) in ends))
    for before, after, x in zip(steps, steps[1:], at[1:], strict=False):
        (joint,) = set(after) - set(before)
        parts = [ends[group] for group in before if group not in after]
        for end, y in parts:
            tree.plot([end, x], [y, y], color="black", linewidth=1)
        heights = [y for _, y in parts]
        tree.plot([x, x], heights, color="black", linewidth=1)
        ends[joint] = (x, sum(heights) / len(heights))
        tree.plot(*ends[joint], "o", color="white", markeredgecolor="black", markersize=13, zorder=3, clip_on=False)
        tree.text(*ends[joint], len(after), ha="center", va="center_baseline", zorder=4)
    tree.set_ylim(len(gestures) - 0.5, -0.5)
    errors = bars(*(table[name].to_numpy() for name in ("accuracy", "low", "high")))
    course.errorbar(table["accuracy"], table["groups"], xerr=errors, fmt="o", color="C0", capsize=3, markersize=5)
    course.set_yticks(table["groups"], [f"{k} groups" for k in table["groups"]])
    course.set(ylim=(1.5, len(gestures) + 0.5), xlabel="accuracy, % (mean over subjects)")
    lowest = min([*at, *table["low"].dropna(), LEVELS[1]])
    for ax in (tree, course):
        ax.set_xlim(lowest - 0.03 * (100 - lowest), 100 + 0.02 * (100 - lowest))
        ax.tick_params(axis="y", length=0)
        ax.spines[["top", "right", "left"]].set_visible(False)
        for level in LEVELS:
            ax.axvline(level, color="0.6", linestyle=":", linewidth=1, zorder=0)
    for k, largest in zip(table["groups"], table["largest"], strict=True):
        course.annotate(f"largest group {largest:.0f} %", (1.02, k), xycoords=course.get_yaxis_transform(), va="center")
    return save(figure, folder, "groups", title, f"{title}: {CAPTION}")


def _order(steps: list[Grouping]) -> list[str]:
    """The gestures in an order in which no two lines cross: the groups of each step lie side by side."""
    order = [*steps[-1]]
    for step in reversed(steps):
        order = [part for group in order for part in step if set(part) <= set(group)]
    return [name for (name,) in order]
