"""What a recogniser sees and says, on one screen: ``bench live show=yes``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rich.console import Group
from rich.live import Live
from rich.text import Text

from bench.ground.progress import console

SHADES = ("#1a1a2e", "#2d3561", "#3f4f9b", "#5b74c4", "#7fa7d9", "#b5d3e7", "#f2e8b8", "#ffb347")
DARKER = 0.5  # power of the reading: most touch lies in the lowest tenth of the range


class View:
    """The map of pressure and the last label; nothing where there is no terminal."""

    def __init__(self, grid: tuple[int, int], full_scale: float) -> None:
        self.grid, self.full_scale = grid, full_scale
        self.values = np.zeros(grid)
        self.words = Text("no touch", style="dim")
        self.live = Live(get_renderable=self._draw, console=console, refresh_per_second=12)

    @contextmanager
    def open(self, is_shown: bool) -> Iterator[View]:
        """Show the screen while the context lasts."""
        if not is_shown or not console.is_terminal:
            yield self
            return
        with self.live:
            yield self

    def tell(self, label: str, confidence: float, is_touched: bool) -> None:
        """Show a label."""
        name = label or "unknown"
        style = "bold green" if is_touched else "dim"
        self.words = Text(f"{name}, confidence {confidence:.2f}", style=style)

    def _draw(self) -> Group:
        return Group(self.words, draw_map(self.values, self.grid, self.full_scale))


def draw_map(values: np.ndarray, grid: tuple[int, int], full_scale: float) -> Text:
    """The map of pressure, two characters for each taxel."""
    shares = (np.clip(values, 0, full_scale) / full_scale) ** DARKER
    levels = np.minimum((shares * len(SHADES)).astype(int), len(SHADES) - 1).reshape(grid)
    text = Text()
    for row in levels.tolist():
        for level in row:
            text.append("  ", style=f"on {SHADES[level]}")
        text.append("\n")
    return text
