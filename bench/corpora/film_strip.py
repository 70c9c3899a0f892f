"""A picture of one capture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def picture(frames: np.ndarray, rate_hz: float, title: str) -> Figure:
    """Mean pressure on the grid, and the pressure summed over the taxels in time."""
    from matplotlib.figure import Figure

    frames = frames.astype(np.float64)
    figure = Figure(figsize=(8, 3), layout="constrained")
    grid, course = figure.subplots(1, 2, width_ratios=(1, 2))
    image = grid.imshow(frames.mean(axis=0), cmap="magma", vmin=0)
    grid.set(title="mean pressure", xticks=[], yticks=[])
    figure.colorbar(image, ax=grid, shrink=0.8, label="sensor value")
    course.plot(np.arange(len(frames)) / rate_hz, frames.sum(axis=(1, 2)), color="tab:blue", linewidth=1)
    course.set(title="pressure summed over the taxels", xlabel="s", ylim=(0, None))
    course.grid(alpha=0.25)
    figure.suptitle(title, fontsize=10)
    return figure
