"""What the person sees: the prompt, the map of pressure, the state of the sensor; and keys."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text


def draw_screen(
    prompt: str,
    seconds_left: float,
    seconds: float,
    is_go: bool,
    facts: dict[str, str],
    picture: Text,
    warnings: list[str],
) -> Group:
    """The whole screen."""
    done = 1.0 if not seconds else 1 - min(1.0, seconds_left / seconds)
    bar = "█" * round(30 * done) + "░" * (30 - round(30 * done))
    style = "bold green" if is_go else "bold yellow"
    head = Text(prompt, style=style)
    head.append(f"\n{bar} {seconds_left:.0f} s", style="not bold")
    state = Table.grid(padding=(0, 2))
    for name, value in facts.items():
        state.add_row(name, value)
    body = Table.grid(padding=(0, 3))
    body.add_row(picture, state)
    lines = [Text(line, style="yellow") for line in warnings]
    keys = Text("space pause · r repeat the last one · q stop", style="dim")
    return Group(Panel(head), body, *lines, keys)


class Screen:
    """A live screen in a terminal; plain lines for prompts elsewhere."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.live = Live(console=console, refresh_per_second=12, transient=True)

    @contextmanager
    def open(self) -> Iterator[Screen]:
        """Show the screen while the context lasts."""
        if not self.console.is_terminal:
            yield self
            return
        with self.live:
            yield self

    def show(self, group: Group) -> None:
        """Show another state."""
        if self.console.is_terminal:
            self.live.update(group)

    def say(self, line: str) -> None:
        """Print a line that stays."""
        self.console.print(line, markup=False, highlight=False, soft_wrap=True)


class Keys:
    """Keys of the terminal, read one by one; none where there is no terminal."""

    def __init__(self) -> None:
        self.descriptor: int | None = None

    @contextmanager
    def open(self) -> Iterator[Keys]:
        """Read keys without waiting for the end of a line, while the context lasts."""
        try:
            import termios
            import tty

            own = sys.stdin is not None and sys.stdin.isatty()
            self.descriptor = sys.stdin.fileno() if own else os.open("/dev/tty", os.O_RDONLY)
            before = termios.tcgetattr(self.descriptor)
        except (ImportError, OSError, ValueError):  # Windows, or no terminal
            self.descriptor = None
            yield self
            return
        try:
            tty.setcbreak(self.descriptor)
            yield self
        finally:
            with suppress(OSError):
                termios.tcsetattr(self.descriptor, termios.TCSADRAIN, before)

    def take(self) -> str:
        """A key that was pressed since the last call, or ""."""
        import select

        if self.descriptor is None or not select.select([self.descriptor], [], [], 0)[0]:
            return ""
        return os.read(self.descriptor, 1).decode(errors="replace").lower()
