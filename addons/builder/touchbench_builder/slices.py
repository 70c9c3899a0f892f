"""What the C has to fit: a board's RAM, and half a period for each frame, in slices of work."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bench.reading.scene import Board
    from bench.running.saved import Recogniser

PERIOD_SHARE = 0.5  # of the time between two frames that the costliest frame may take


def needed_ram(costs: Mapping[str, float], board: Board | None) -> float:
    """Bytes of RAM that the C takes with its stack and a frame, and its tables if they need RAM."""
    tables = costs["table_bytes"] if board is not None and board.tables_in_ram else 0.0
    return sum(costs[name] for name in ("ram_bytes", "stack_bytes", "frame_bytes")) + tables


def most_instructions(board: Board | None, rate_hz: float, budget: float) -> float:
    """Most instructions of a frame: its budget, and what a board executes in half a period.

    It is 0 for a board that computes floats in software, as nobody knows how many it needs there.
    """
    if board is None:
        return budget
    if not board.fpu:
        return 0.0
    return min(budget, PERIOD_SHARE * 1e6 * board.clock_mhz / rate_hz)


def spread_work(
    recogniser: Recogniser, limit: float, measure: Callable[[Recogniser], Mapping[str, float]]
) -> Mapping[str, float]:
    """Set the fewest slices with which no frame costs more than a limit, or all.

    Args:
        recogniser: the model, whose watcher is replaced by one that works in slices.
        limit: most instructions of a frame.
        measure: returns the costs of a model, among them ``most_instructions``.

    Returns:
        The costs in slices.
    """
    watcher, costs = recogniser.watcher, measure(recogniser)
    if watcher is None or costs["most_instructions"] <= limit:
        return costs
    # The frame of the tick has the work of the detector.
    fewest = 1 + costs["most_instructions"] / limit if limit else math.inf
    for slices in range(math.ceil(min(fewest, watcher.count)), watcher.count + 1):
        recogniser.watcher = replace(watcher, slices=slices)
        costs = measure(recogniser)
        if costs["most_instructions"] <= limit:
            break
    return costs
