"""The chosen system of a build; models trained on all captures, and measured as linked C."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.skin import design_of
from bench.errors import InputError
from bench.plan.grid import make_cells
from bench.plan.plan import captures_of_cell
from bench.running.fit import fit
from bench.running.saved import Recogniser, load_recogniser
from bench.store.client import connect
from touchbench_builder.candidates import BITS
from touchbench_builder.slices import needed_ram, spread_work
from touchbench_chip.measure import ROOMY, measure_footprint, measure_watching, missing_programs
from touchbench_chip.write import hash_fixed_code, write_c_sources
from touchbench_streams.recordings import drop_doubtful
from touchbench_streams.study import Continuous
from touchbench_streams.teaching import Watching

if TYPE_CHECKING:
    from bench.contract import System
    from bench.plan.cells import Cell
    from bench.reading.scene import Board
    from touchbench_streams.detectors.ticks import TickWatcher

BUILT_TAG = "touchbench.built"  # tag of a model: hash of what it was built from
EARLY = "calibration and early decisions"
COUNTED = ("flash_bytes", "ram_bytes", "stack_bytes", "frame_instructions", "most_instructions")
CHIP_COSTS = (*COUNTED, "table_bytes", "frame_bytes", "delay_s")
CHIP_COST_OF = {"flash": "flash_bytes", "ram": "needed_ram_bytes", "cycles": "most_instructions"}


@dataclass(frozen=True)
class ChosenSystem:
    """The chosen system.

    Attributes:
        values: its keys of ``bench run``.
        name: its name in tables.
        table: a row per compared system: system, accuracy in percent, flash and ram in kB, verdict.
        systems: the system that is chosen without each person, "" where none is.
        captures: a row per capture, labelled by the system that is chosen without its subject.
        watched: the same of streams, as `touchbench_builder.stream.select_people`; None without.
        left_out: systems that were not compared, with reasons.
        runs: ids of the compared runs.
        limits: budget of each cost.
        frame_limit: most instructions of a frame, as of `most_instructions`.
        board: the robot's board.
        run_id: id of its run.
    """

    values: dict[str, Any]
    name: str
    table: pd.DataFrame
    systems: dict[str, str]
    captures: pd.DataFrame
    watched: pd.DataFrame | None
    left_out: list[str]
    runs: list[str]
    limits: dict[str, float]
    frame_limit: float
    board: Board | None
    run_id: str


class GesturesAndStream(Watching):
    """Learn to watch from recordings; the system learns from captures of gestures only.

    The systems of the comparison learn from the same captures.
    """

    load_captures = staticmethod(captures_of_cell)

    def __init__(self, cell: Cell) -> None:
        super().__init__({})
        opened = Continuous().open_captures(cell)  # what bench watch learns from
        self.recordings = captures_of_cell(cell) if opened is None else drop_doubtful(opened)

    def learn_watcher(
        self, make_system: Callable[[], System], system: System, captures: Corpus
    ) -> TickWatcher:
        """Learn from recordings, if there are some; with the range that a design has learned."""
        design = design_of(captures.info)
        recordings = design.encode(self.recordings) if design else self.recordings
        return super().learn_watcher(make_system, system, recordings)


def fit_or_load(
    on: Mapping[str, Any],
    values: Mapping[str, Any],
    key: str,
    stopping: bool = True,
    watch: bool = True,
) -> tuple[str, Recogniser]:
    """Train a model on all captures, or load the stored one; returns the id of its run, and it."""
    store = connect(writes=True)
    for stored in store.search_runs(f"tags.`{BUILT_TAG}` = '{key}'"):
        return stored.info.run_id, load_recogniser(f"runs:/{stored.info.run_id}/model")
    (cell,) = make_cells({k: v for k, v in on.items() if k != "jobs"} | dict(values))
    learner = GesturesAndStream(cell) if watch else None
    fitted = fit(cell, stopping=stopping, learner=learner)
    if watch and fitted.recogniser.watcher is None:
        raise InputError("it learned no detector from all captures; watch=no builds without one")
    store.log_values(fitted.run_id, tags={BUILT_TAG: key})
    return fitted.run_id, fitted.recogniser


def build_key(*parts: object) -> str:
    """Short hash of what a model is built from."""
    return hashlib.sha256(json.dumps([str(part) for part in parts]).encode()).hexdigest()[:20]


def linked_costs(
    on: Mapping[str, Any], values: Mapping[str, Any], run_id: str, watches: bool, frame_limit: float
) -> dict[str, float]:
    """`CHIP_COSTS` of a system in C, trained on all captures; stored with the model."""
    store, key = connect(writes=True), _linked_key(run_id)
    names = {name: f"linked_{frame_limit:.0f}_{name}" for name in CHIP_COSTS}
    for model in store.search_runs(f"tags.`{BUILT_TAG}` = '{key}'"):
        if all(name in model.data.metrics for name in names.values()):
            return {name: model.data.metrics[stored] for name, stored in names.items()}
    model_id, recogniser = fit_or_load(on, values, key, stopping=False, watch=watches)
    costs = spread_work(recogniser, frame_limit, measure_on_chip)
    store.log_values(model_id, {names[name]: value for name, value in costs.items()})
    return costs


def _linked_key(run_id: str) -> str:
    return build_key("linked", run_id, hash_fixed_code(), Watching.hash_c_code())


def measure_on_chip(recogniser: Recogniser) -> dict[str, float]:
    """Measure `CHIP_COSTS` of a model as linked C; a model that watches costs ``touch_watch``."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in write_c_sources(recogniser, BITS, "a system of bench build").items():
            (folder / file).write_text(text, encoding="utf-8")
        watches = "#define TOUCH_WATCH 1" in (folder / "touch.h").read_text(encoding="utf-8")
        try:
            numbers = measure_watching(folder) if watches else measure_footprint(folder, *ROOMY)
        except ValueError as e:  # such as a program too large for the emulated chip
            raise InputError(str(e)) from e
    costs = {name: numbers[f"chip_{'watch_' * watches}{name}"] for name in COUNTED}
    # Of a system that watches, tables are not counted alone.
    costs["table_bytes"] = numbers.get("chip_table_bytes", costs["flash_bytes"])
    costs["frame_bytes"] = 4.0 * recogniser.grid[0] * recogniser.grid[1]
    delay = recogniser.watcher.delay if watches else 0
    return costs | {"delay_s": delay / recogniser.rate_hz}


def train_chosen(
    on: Mapping[str, Any], choice: ChosenSystem
) -> tuple[str, Recogniser, dict[str, float] | None, str]:
    """Train the chosen system on all captures, with as many abilities as the budgets allow.

    Returns:
        Id of its run, the model, its `CHIP_COSTS` (None if they cannot be measured), and the
        abilities that the budgets exclude, in words.
    """
    watches = choice.watched is not None
    key = build_key(choice.run_id, "built")
    run_id, recogniser = fit_or_load(on, choice.values, key, watch=watches)
    if missing_programs():
        return run_id, recogniser, None, ""
    costs = _measure_for_board(recogniser, choice)
    if fits_budgets(costs, choice.limits):
        return run_id, recogniser, costs, ""
    key = _linked_key(choice.run_id)
    stored = fit_or_load(on, choice.values, key, stopping=False, watch=watches)
    costs = _measure_for_board(stored[1], choice)
    if fits_budgets(costs, choice.limits):
        return *stored, costs, EARLY
    kilobytes = [f"{costs[name] / 1000:.1f} kB" for name in ("flash_bytes", "needed_ram_bytes")]
    raise InputError(
        f"{choice.name} fits, but trained on all captures it takes {kilobytes[0]} of flash and "
        f"{kilobytes[1]} of RAM; take a larger board or raise its budgets"
    )


def _measure_for_board(recogniser: Recogniser, choice: ChosenSystem) -> dict[str, float]:
    """Costs in as many slices as the board needs, and the RAM that the C needs there."""
    costs = spread_work(recogniser, choice.frame_limit, measure_on_chip)
    return {**costs, "needed_ram_bytes": needed_ram(costs, choice.board)}


def fits_budgets(costs: Mapping[str, float], budgets: Mapping[str, float]) -> bool:
    """Return True if measured costs are within the budgets."""
    limits = {name: budgets.get(cost, np.inf) for cost, name in CHIP_COST_OF.items()}
    return all(costs[name] <= 1000 * limit for name, limit in limits.items())
