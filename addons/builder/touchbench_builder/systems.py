"""Systems of a build: compared on people left out, chosen, and trained on all captures."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.commands import run as commands
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.features.touch_profiles import TouchProfiles
from bench.grammar.options import (
    cost_limits,
    key_options,
    make_executor,
    typed_settings,
    values_from_keywords,
)
from bench.ground.machine import BUSY_SLOWDOWN
from bench.ground.progress import format_estimate, format_seconds
from bench.models.search import portfolio
from bench.plan.grid import make_cells
from bench.plan.plan import captures_of_cell
from bench.reading import choice as rule
from bench.reading.scene import Scene, load_boards
from bench.running.fit import fit
from bench.running.loop import Interrupted, estimate_seconds, find_stored_runs, run_plans
from bench.running.saved import Recogniser, load_recogniser
from bench.store.client import connect
from bench.values.measures import all_costs
from bench.values.scores import label_captures
from touchbench_builder.deadline import LimitedExecutor, OutOfTime
from touchbench_builder.slices import most_instructions, needed_ram, spread_work
from touchbench_builder.stream import select_people
from touchbench_chip.measure import ROOMY, measure_footprint, measure_watching, missing_programs
from touchbench_chip.tables import check_exportable
from touchbench_chip.write import hash_fixed_code, write_c_sources
from touchbench_streams.recordings import drop_doubtful
from touchbench_streams.study import Continuous
from touchbench_streams.teaching import Watching

if TYPE_CHECKING:
    from bench.contract import System
    from bench.plan.cells import Cell
    from bench.plan.plan import Plan
    from bench.reading.scene import Board
    from bench.running.workers import FoldExecutor
    from bench.values.result import Result
    from touchbench_builder.progress import Progress
    from touchbench_builder.stream import WatchedPeople
    from touchbench_streams.detectors.ticks import TickWatcher

BITS = 8  # of a weight in C; Python rounds to the same if it can
STREAM_BUDGETS = ("max_false_alarms", "max_latency")  # of a scene, for recordings
BUILT_TAG = "touchbench.built"  # tag of a model: hash of what it was built from
EARLY = "calibration and early decisions"
WATCH = "watch"  # the command of runs on streams
COUNTED = ("flash_bytes", "ram_bytes", "stack_bytes", "frame_instructions", "most_instructions")
CHIP_COSTS = (*COUNTED, "table_bytes", "frame_bytes", "delay_s")
CHIP_COST_OF = {"flash": "flash_bytes", "ram": "needed_ram_bytes", "cycles": "most_instructions"}
ROUNDED_MODELS = ("lda", "softmax", "reflex")  # those with model.bits=
REPAIR = "stuck+dead"
SMALLEST_SYSTEM: dict[str, object] = {"model": "tree", "features": "jung28"}
LARGEST_SYSTEM: dict[str, object] = {"model": "reflex", "model.bits": BITS}
LARGEST_S = 60.0  # of a fit on one core
# It loses least under noise for its cost: docs/faults.md.
STEADY_TRIAL = {"model": "lda", "features": "touch_profiles", "window": 1.0, "faults": "noise"}
DEFAULT_FAULTS = tuple(  # if the scene names none
    "noise offset_drift gain_drift lower_rate dead_taxels stuck_taxels".split()
)
# As multiples of the processor time of a comparison on captures: a fault, and the last fit.
FAULT_TIME, LAST_FIT_TIME = 2.5, 2.0
# The same of a comparison on streams: all faults with it, captures, and in folds, the last fit.
STREAM_FAULTS_TIME, CAPTURES_TIME, LAST_WATCHING_FITS = 1.4, 0.4, 2.0


@dataclass(frozen=True)
class ChosenSystem:
    """The chosen system.

    Attributes:
        values: its keys of ``bench run``.
        name: its name in tables.
        table: a row per compared system: system, accuracy in percent, flash and ram in kB, verdict.
        systems: the system that is chosen without each person, "" where none is.
        captures: a row per capture, labelled by the system that is chosen without its subject.
        watched: touches and reports of each person by that system; None without streams.
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
    watched: WatchedPeople | None
    left_out: list[str]
    runs: list[str]
    limits: dict[str, float]
    frame_limit: float
    board: Board | None
    run_id: str


def candidate_systems(corpus: Corpus) -> list[tuple[dict[str, Any], float]]:
    """Systems that have C, as keys of ``bench run``, with the seconds of a fit on one core.

    They are the first trials of ``model=auto`` on windows of ``touch``, one for each model and
    window, and one that loses little under noise, after the repair of broken taxels; the smallest
    system; and the most accurate model with C. The cheapest is first.
    """
    feature_sets = {"touch": TouchFeatures(), "touch_profiles": TouchProfiles()}
    widths = {name: len(each.fit(corpus[:1]).names_) for name, each in feature_sets.items()}
    classes = len(set(corpus.gestures))
    systems = [(SMALLEST_SYSTEM, portfolio.MIN_FIT_S), (LARGEST_SYSTEM, LARGEST_S)]
    for trial in [*_exportable_trials(), portfolio.with_defaults(STEADY_TRIAL)]:
        values = {name: trial[name] for name in ("model", "features")}
        values |= {"model.window": trial["window"], "model.repair": REPAIR}
        if trial["faults"]:
            values["model.faults"] = trial["faults"]
        values |= {f"model.{key.partition('.')[2]}": trial[key] for key in trial if "." in key}
        if trial["model"] in ROUNDED_MODELS:
            values["model.bits"] = BITS
        seconds = portfolio.expected_fit_seconds(trial, corpus, widths[trial["features"]], classes)
        systems.append((values, seconds))
    return sorted(systems, key=lambda pair: pair[1])


def _exportable_trials() -> Iterator[dict[str, Any]]:
    """Yield the first trial of each model and window on ``touch`` that can be written as C."""
    trials = [portfolio.with_defaults(trial) for trial in portfolio.FIRST_TRIALS]
    trials.sort(key=lambda trial: not trial["window"])
    yielded = set()
    for trial in trials:
        trial |= {"window": trial["window"] or 1.0}
        key = trial["model"], trial["window"]
        if trial["features"] == "touch" and key not in yielded:
            with suppress(InputError):  # it has no C
                check_exportable(portfolio.make_system(trial, 0))
                yielded.add(key)
                yield trial


def compare_systems(
    corpus: Corpus,
    on: Mapping[str, Any],
    scene: Scene,
    limits: Mapping[str, float],
    progress: Progress,
    watches: bool,
) -> ChosenSystem:
    """Run systems on people left out, link each for a Cortex-M4F, and choose within the budgets.

    Args:
        corpus: captures.
        on: keys of ``bench run`` that name them.
        scene: needs of the robot, with budgets.
        limits: budgets of the command line, which replace those of the scene.
        progress: progress of the build.
        watches: choose by labels of touches in streams, else by those of captures.

    Raises:
        InputError: no system could be compared, or none is within the budgets.
    """
    left = progress.seconds_left
    progress.start_step(f"systems on people left out, within {format_seconds(left)}")
    systems = candidate_systems(corpus)
    if watches:  # the C of the smallest cannot watch
        systems = [pair for pair in systems if pair[0] != SMALLEST_SYSTEM]
    faults = {"under": [*scene.faults]} if scene.faults else {}
    plans: dict[str, tuple[dict[str, Any], Plan]] = {}
    results, damaged, left_out = [], [], []
    settings, budgets = _read_budgets(scene, limits, watches)
    budget = 1000 * budgets.get("cycles", np.inf)
    frame_limit = most_instructions(scene.board, corpus.rate_hz, budget)
    longest = slowest = reserve = 0.0
    slowdown, was_stopped = 1.0, False
    for number, (values, fit_seconds) in enumerate(systems, 1):
        title, left = system_title(values), progress.seconds_left
        keys = on | {"protocol": "loso"} | values
        pairs = [make_plan(keys, WATCH)] if watches else []
        pairs += [make_plan(keys | faults)] if faults or not watches else []
        plan = pairs[0][0]
        seconds = max(slowest, fit_seconds * len(plan.folds) / plan.workers)
        needed = max(longest, seconds) + sum(later_seconds(scene, plan, seconds))
        first = seconds * plan.workers / len(plan.folds)  # until it is known better
        is_tried = not was_stopped and left >= first + reserve
        is_new = bool(results) and bool(find_stored_runs(connect(), [plan])[1])
        if is_new and left < needed and not is_tried:
            estimate = f"with its tests and its last fit, it would take {format_estimate(needed)}"
            left_out.append(f"{title}: {estimate}; raise seconds=")
            continue
        if is_new:
            later = partial(later_seconds, scene)
            pairs[0] = plan, LimitedExecutor(pairs[0][1], progress, later)
        progress.print_line(
            f"system {number} of {len(systems)}: {title}; {format_seconds(left)} left"
        )
        try:
            result, *others = [run_plan(*pair) for pair in pairs]
            if watches and not result.metrics["touches_found"]:
                raise InputError("it found no touch in any stream")
            if not missing_programs():
                costs = linked_costs(on, values, str(result["run_id"]), watches, frame_limit)
                costs["needed_ram_bytes"] = needed_ram(costs, scene.board)
                result.metrics |= _delay_latencies(result.metrics, costs["delay_s"])
                sources = {all_costs()[key].source_name: CHIP_COST_OF[key] for key in CHIP_COST_OF}
                result.metrics |= {source: costs[name] for source, name in sources.items()}
        except Interrupted as e:
            if not isinstance(e.__cause__, OutOfTime):
                raise
            left_out.append(f"{title}: {e.__cause__}; raise seconds=")
            was_stopped, slowest = True, max(slowest, e.__cause__.seconds)
            continue
        except InputError as e:
            left_out.append(f"{title}: {e}")
            continue
        results.append(result)
        damaged += others
        plans[result.system] = values, plan
        longest = max(longest, left - progress.seconds_left)  # starts of processes and linking too
        slowest = max(slowest, comparison_seconds(plan))
        reserve = sum(later_seconds(scene, plan, slowest))
        slowdown = max(slowdown, result.metrics.get("slowdown", 1.0))
    if not results:
        raise InputError(f"no system could be compared: {left_out[0]}")
    if left_out:
        more = f"; {len(left_out) - 1} more in the certificate" * (len(left_out) > 1)
        compared = f"{len(results)} of {len(systems)} systems compared"
        progress.print_line(f"{compared}; not {left_out[0]}{more}")
    if slowdown > BUSY_SLOWDOWN:
        progress.print_line(
            f"other programs use the processors: all took up to {slowdown:.1f} times as long as on "
            "a quiet machine"
        )
    progress.start_step("choice")
    choice = rule.choose_from_runs(
        results + damaged,
        {},
        settings["by"],
        budgets,
        scene=scene,
        margin=settings["margin"],
        run_kind=WATCH if watches else "",
    )
    if choice.chosen is None:
        raise InputError(nothing_fits_message(choice))
    name, runs = str(choice.system), {r.system: str(r["run_id"]) for r in results}
    values, plan = plans[name]
    tests, last = later_seconds(scene, plan, comparison_seconds(plan))
    more = f"{format_estimate(tests)} more for its tests, " * (tests > 0)
    progress.print_line(f"{name}; {more}{format_estimate(last)} for its last fit")
    table = choice.table[["system", "accuracy", "flash", "ram", "verdict"]]
    systems_of_people = systems_without_each(choice)
    deciding = {person: system or name for person, system in systems_of_people.items()}
    watched, on_captures = None, results
    if watches:
        watched = select_people(results, deciding)
        keys = [on | {"protocol": "loso"} | plans[each][0] for each in {*deciding.values()}]
        on_captures = [run_plan(*make_plan(each)) for each in keys]
    captures = nested_labels(on_captures, deciding)
    run_ids = [*runs.values()]
    return ChosenSystem(
        values,
        name,
        table,
        systems_of_people,
        captures,
        watched,
        left_out,
        run_ids,
        choice.budgets,
        frame_limit,
        scene.board,
        runs[name],
    )


def system_title(values: Mapping[str, Any]) -> str:
    """Name a system in words."""
    features = f" on {values['features']}" if "features" in values else ""
    window = f", windows of {values['model.window']:g} s" if "model.window" in values else ""
    return f"{values['model']}{features}{window}"


def make_plan(values: Mapping[str, Any], command: str = "run") -> tuple[Plan, FoldExecutor]:
    """Make the plan of a run from the keys of a command, and its executor."""
    typed = values_from_keywords(values, key_options(command, values))
    executor = make_executor(typed)
    (plan,) = commands.plan_grids(command, {"": typed}, executor)
    return plan, executor


def run_plan(plan: Plan, executor: FoldExecutor) -> Result:
    """Run a plan; stored folds are not repeated."""
    (result,) = run_plans([plan], executor)
    if not result.is_complete:
        raise InputError(f"{len(result.errors)} of {len(plan.folds)} folds failed")
    return result


def comparison_seconds(plan: Plan) -> float:
    """Seconds that a stored run took, or would take without interruption."""
    return estimate_seconds(connect(), [(plan, len(plan.folds))])[0] or 0.0


def later_seconds(scene: Scene, plan: Plan, seconds: float) -> tuple[float, float]:
    """Seconds of the remaining tests of a chosen system, and of its last fit.

    Args:
        scene: needs of the robot.
        plan: plan of the comparison.
        seconds: seconds of the comparison, with all workers; the last fit has one process.
    """
    if plan.cell.run_kind is not None:
        tests = STREAM_FAULTS_TIME + CAPTURES_TIME
        return tests * seconds, LAST_WATCHING_FITS * seconds * plan.workers / len(plan.folds)
    clean = seconds / (1 + FAULT_TIME * len(scene.faults))
    tests = 0 if scene.faults else FAULT_TIME * len(DEFAULT_FAULTS)
    return tests * clean, LAST_FIT_TIME * clean * plan.workers


def _delay_latencies(metrics: Mapping[str, float], delay_s: float) -> dict[str, float]:
    """Latencies of a run in Python as they are in C, whose news come later."""
    names = [name for name in metrics if name.startswith("latency_s")]
    return {name: metrics[name] + delay_s for name in names}


def _read_budgets(
    scene: Scene, limits: Mapping[str, float], watches: bool
) -> tuple[dict[str, Any], dict[str, float]]:
    """Settings of ``bench choose`` in a scene, and budgets of those that a build measures."""
    unused = ("clock", "unit", *(() if watches else STREAM_BUDGETS))
    settings = typed_settings(
        "choose", {key: value for key, value in scene.values.items() if key not in unused}
    )
    return settings, cost_limits(settings) | dict(limits)


def systems_without_each(choice: rule.Choice) -> dict[str, str]:
    """The system that is chosen without each person, "" where none is."""
    candidates = choice.candidates
    rows = zip(candidates.subjects, choice.choices_without_each(), strict=True)
    return {
        str(subject): "" if row is None else str(candidates.table.loc[row, "system"])
        for subject, row in rows
    }


def nested_labels(results: list[Result], systems: Mapping[str, str]) -> pd.DataFrame:
    """Labels of each person's captures by the system that the other people alone choose.

    Args:
        results: runs on captures.
        systems: the system of each person.
    """
    labels = {r.system: label_captures(r.tables["predictions"]) for r in results}
    parts = []
    for subject, system in systems.items():
        part = labels[system]
        parts.append(part[part["subject"].astype(str) == subject])
    return pd.concat(parts, ignore_index=True)[["subject", "true", "predicted"]]


def nothing_fits_message(choice: rule.Choice) -> str:
    """Reason why no system fits, in the sentences of ``bench choose``, and what would help."""
    lines = choice.why_nothing_fits()
    if (missing := missing_programs()) and any(limit["unknown"] for limit in choice.limits):
        lines.append(f"Install {', '.join(missing)}, which measure C.")
    sizes = choice.table[["flash", "ram"]]
    boards = []
    for name, board in load_boards().items():
        if (sizes <= board.free_kb).all(axis=1).any():
            boards.append((board.flash_kb, name))
    if boards and any(limit["over"] and limit["cost"].key in sizes for limit in choice.limits):
        lines.append(f"The smallest board that holds one of them is {min(boards)[1]}.")
    return " ".join(lines).removesuffix(".")


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
        """Learn from recordings, if there are some."""
        return super().learn_watcher(make_system, system, self.recordings)


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
    if _fits_budgets(costs, choice):
        return run_id, recogniser, costs, ""
    key = _linked_key(choice.run_id)
    stored = fit_or_load(on, choice.values, key, stopping=False, watch=watches)
    costs = _measure_for_board(stored[1], choice)
    if _fits_budgets(costs, choice):
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


def _fits_budgets(costs: Mapping[str, float], choice: ChosenSystem) -> bool:
    limits = {name: choice.limits.get(cost, np.inf) for cost, name in CHIP_COST_OF.items()}
    return all(costs[name] <= 1000 * limit for name, limit in limits.items())
