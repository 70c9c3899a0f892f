"""Figures of designs of the skin: accuracy against a cost, and what each property alone costs."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.reading.designs import HOW, Designs, format_design
from bench.reports.figures import (
    error_bars,
    line_style,
    new_figure,
    save_figure,
    set_log_ticks,
    shorten_names,
)
from bench.values.intervals import mean_and_error

if TYPE_CHECKING:
    from bench.reading.designs import TaxelOrder

ORDER_CAPTION = "Order of the taxels, chosen on a half of the people; bars are standard errors."
CAPTION = "Designs of the skin: a system is trained on each, and tested with it on people left out."
PANEL = 2.6  # inches of a small multiple
CELL = 0.19  # inches of a taxel, at least


def draw_designs(designs: Designs, folder: Path) -> list[Path]:
    """Draw figures into a folder, the second if a property changes alone; return their paths."""
    draw = [_draw_front, *[_draw_properties] * bool(designs.single_changes())]
    return [each(designs, folder) for each in draw]


def draw_orders(orders: Sequence[TaxelOrder], folder: Path) -> Path:
    """Draw maps of the skin with the order of its taxels, and the accuracy on the other people."""
    margins = (0.7, 0.15, 0.65, 0.75)
    rows, cols = orders[0].order.shape
    size = max(9.2, 1.5 + 3 * (0.3 + CELL * cols)), max(3.7, 1.4 + CELL * rows)
    figure, axes = new_figure(size, (1, len(orders) + 1), margins, (0.65, 0.0))
    for i, (ax, each) in enumerate(zip(axes[0], orders, strict=False)):
        shown = np.ma.masked_equal(each.order, 0)
        ax.imshow(shown, cmap="Greys", vmin=-2, vmax=3 * each.order.max(), aspect="equal")
        for place in zip(*np.nonzero(each.order), strict=True):
            ax.text(*place[::-1], each.order[place], ha="center", va="center")
        ax.set_xticks(np.arange(each.order.shape[1] + 1) - 0.5, [])
        ax.set_yticks(np.arange(each.order.shape[0] + 1) - 0.5, [])
        ax.grid(color="0.6")
        people = textwrap.fill(f"{each.verb}, chosen on {', '.join(each.people)}", 30)
        ax.set_title(people)
        style = line_style(i) | {"label": f"people not of map {i + 1}", "capsize": 3}
        pairs = [mean_and_error(shares) for shares in each.accuracy]
        means, errors = np.transpose(pairs)
        axes[0, -1].errorbar(each.wired, means, yerr=errors, **style)
    axes[0, -1].set(xlabel="wired taxels", ylabel="correctly classified captures, %")
    axes[0, -1].xaxis.get_major_locator().set_params(integer=True)
    axes[0, -1].grid(alpha=0.3)
    axes[0, -1].legend(frameon=False)
    return save_figure(figure, folder, "taxels", "", ORDER_CAPTION).path


def _draw_front(designs: Designs, folder: Path) -> Path:
    """Accuracy of all designs against their cost, with the front and the chosen design."""
    data, _, protocol = designs.results[0].context
    title = f"{data}, {protocol}: {designs.results[0].system}"
    figure, axes = new_figure((9.8, 4.4), margins=(0.7, 3.9, 0.6, 0.5), title=title)
    ax, front = axes[0, 0], designs.front
    rows = [designs.row(i) for i in range(len(designs.results))]
    mean, low, high = (
        np.array([r[key] for r in rows]) for key in ("mean", "mean_low", "mean_high")
    )
    amounts, chosen = designs.amounts, designs.chosen
    ax.plot(amounts, mean, "o", color="0.65", markersize=4, label="other designs")
    bars = error_bars(mean, low, high)[:, front]
    look = {"color": "C0", "marker": "o", "capsize": 3, "linewidth": 1}
    label = "front, with 95 % intervals"
    ax.errorbar(amounts[front], mean[front], yerr=bars, label=label, **look)
    ax.plot(amounts[0], mean[0], "s", color="black", label="as recorded")
    nested, _ = designs.new_person()
    place = designs.amounts[designs.choices].mean(), nested.mean()
    ax.plot(*place, "*", color="C3", markersize=13, label="chosen on others for each person")
    ring = {"markersize": 12, "markerfacecolor": "none", "color": "C3"}
    ax.plot(amounts[chosen], mean[chosen], "o", label="chosen on all people", **ring)
    names = shorten_names(format_design(designs.options[i]) for i in front)
    for number, (i, name) in enumerate(zip(front, names, strict=True), 1):
        ax.annotate(str(number), (amounts[i], mean[i]), (4, -12), textcoords="offset points")
        ax.plot([], [], " ", label=f"{number}: {name}")
    if not designs.cost.is_linear:
        ax.set_xscale("log")
        set_log_ticks(ax.xaxis)
    ax.set(xlabel=designs.cost.axis, ylabel="correctly classified captures, %")
    ax.grid(alpha=0.3)
    ax.legend(loc="upper left", bbox_to_anchor=(1.02, 1), frameon=False, handlelength=1.2)
    return save_figure(figure, folder, "front", title, CAPTION).path


def _draw_properties(designs: Designs, folder: Path) -> Path:
    """Points against the recorded skin when one property alone changes, a panel for each."""
    singles = designs.single_changes()
    data, _, protocol = designs.results[0].context
    title = f"{data}, {protocol}: {designs.results[0].system}"
    count = len(singles)
    size, margins = (1.0 + (PANEL + 0.2) * count, 3.6), (0.8, 0.15, 1.0, 0.55)
    figure, axes = new_figure(size, (1, count), margins, (0.2, 0.0), title)
    accuracy, ends = designs.accuracy, [-3.0, 1.0]
    for ax, (name, places) in zip(axes[0], singles.items(), strict=True):
        pairs = [mean_and_error(accuracy[i] - accuracy[0]) for i in places]
        points, errors = np.transpose(pairs)
        ends += [*(points - errors), *(points + errors)]
        shown = ["recorded", *(_format_option(name, designs.options[i]) for i in places)]
        at = np.arange(len(shown))
        ax.errorbar(at, [0, *points], yerr=[0, *errors], marker="o", capsize=3, color="C0")
        ax.axhline(0, color="0.5", linewidth=0.8)
        ax.set_xticks(at, shorten_names(shown, 16), rotation=30, ha="right")
        ax.set(title=name.replace("_hz", ", Hz"), xlim=(-0.4, len(shown) - 0.6))
        ax.grid(alpha=0.3)
    for ax in axes[0]:
        ax.set_ylim(min(ends) - 2, max(ends) + 2)
    axes[0, 0].set_ylabel("points against the recorded skin\n(bars: standard error)")
    for ax in axes[0, 1:]:
        ax.set_yticklabels([])
    return save_figure(figure, folder, "properties", title, CAPTION).path


def _format_option(name: str, options: Mapping[str, object]) -> str:
    """Value of an option of a design, and those that say how it is done."""
    values = [options[key] for key in dict.fromkeys((name, *HOW)) if key in options]
    words = [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
    return ", ".join(words)
