"""What one capture looks like."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bench.corpora.corpus import Corpus

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def picture(corpus: Corpus, capture: int) -> Figure:
    """Mean pressure on the grid, and the pressure summed over the taxels in time.

    Args:
        corpus: of the capture.
        capture: its position.
    """
    from matplotlib.figure import Figure

    frames = corpus[capture].astype(np.float64)
    about = corpus.captures.iloc[capture]
    figure = Figure(figsize=(8, 3), layout="constrained")
    grid, course = figure.subplots(1, 2, width_ratios=(1, 2))
    image = grid.imshow(frames.mean(axis=0), cmap="magma", vmin=0)
    grid.set(title="mean pressure", xticks=[], yticks=[])
    figure.colorbar(image, ax=grid, shrink=0.8, label="sensor value")
    course.plot(np.arange(len(frames)) / corpus.rate_hz, frames.sum(axis=(1, 2)), color="tab:blue", linewidth=1)
    course.set(title="pressure summed over the taxels", xlabel="s", ylim=(0, None))
    course.grid(alpha=0.25)
    words = ", ".join(f"{name} {about[name]}" for name in ("subject", "gesture") if name in about)
    kind = " (synthetic)" if corpus.synthetic else ""
    figure.suptitle(f"{corpus.name}{kind}, capture {capture}: {words}", fontsize=10)
    return figure
