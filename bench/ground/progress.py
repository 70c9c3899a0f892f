"""Messages beside the results of a command: the console, warnings, durations in words."""

from __future__ import annotations

from rich.console import Console

console = Console(stderr=True)


def warn(line: str) -> None:
    """Print a warning for the user."""
    console.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)


def format_seconds(seconds: float) -> str:
    """Write a duration: 8 s, 3 min 20 s, 2 h 5 min."""
    minutes, rest = divmod(max(0, round(seconds)), 60)
    if not minutes:
        return f"{rest} s"
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def format_estimate(seconds: float) -> str:
    """Write an estimated duration, rounded: about 8 s, about 90 s, about 3 min."""
    if seconds < 100:
        rounded = round(seconds, -1) if seconds > 20 else round(seconds)
        return f"about {max(1, rounded):.0f} s"
    minutes = round(seconds / 60)
    return f"about {minutes} min" if minutes < 100 else f"about {round(minutes / 60)} h"
