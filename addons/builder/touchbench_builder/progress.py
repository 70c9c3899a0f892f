"""What a build prints of its steps."""

from __future__ import annotations

import time

from bench.ground.progress import console, span

STEPS = 6


class Progress:
    """Lines of the steps, with the time left."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.began, self.step = seconds, time.monotonic(), 0

    @property
    def left(self) -> float:
        """Seconds left of those that were given."""
        return self.seconds - (time.monotonic() - self.began)

    def say(self, line: str) -> None:
        """Print a line on the side."""
        console.print(line, markup=False, highlight=False, soft_wrap=True)

    def begin(self, what: str) -> None:
        """Begin the next step."""
        self.step += 1
        self.say(f"step {self.step} of {STEPS}, after {span(self.seconds - self.left)}: {what}")
