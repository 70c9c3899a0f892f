"""Printed progress of a build."""

from __future__ import annotations

import time

from bench.ground.progress import console, format_seconds

STEPS = 6


class Progress:
    """Print the steps of a build, and count the time left."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.began, self.step = seconds, time.monotonic(), 0

    @property
    def seconds_left(self) -> float:
        """Seconds left of the build's time."""
        return self.seconds - (time.monotonic() - self.began)

    def print_line(self, line: str) -> None:
        """Print a line to standard error."""
        console.print(line, markup=False, highlight=False, soft_wrap=True)

    def start_step(self, title: str) -> None:
        """Count and print the next step."""
        self.step += 1
        passed = format_seconds(self.seconds - self.seconds_left)
        self.print_line(f"step {self.step} of {STEPS}, after {passed}: {title}")
