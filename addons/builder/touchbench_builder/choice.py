"""The systems that are compared, the choice among them, and what a new person may expect of the choice."""

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

from bench.commands import run as commands
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.grammar.options import (
    cost_limits,
    key_options,
    make_executor,
    typed_settings,
    values_from_keywords,
)
from bench.ground.progress import format_estimate, format_seconds
from bench.models.search import portfolio
from bench.plan.grid import make_cells
from bench.plan.plan import captures_of_cell
from bench.reading import choice as rule
from bench.reading.scene import Scene, load_boards
from bench.running.fit import fit
from bench.running.loop import estimate_seconds, find_stored_runs, run_plans
from bench.running.saved import Recogniser, load_recogniser
from bench.store.client import connect
from bench.values.measures import all_costs
from bench.values.scores import label_captures
from touchbench_chip.measure import ROOMY, measure_footprint, measure_watching, missing_programs
from touchbench_chip.tables import check_exportable
from touchbench_chip.write import hash_fixed_code, write_c_sources
from touchbench_streams.teaching import Watching

if TYPE_CHECKING:
    from bench.contract import System
    from bench.running.workers import FoldExecutor
    from bench.plan.cells import Cell
    from bench.plan.plan import Plan
    from bench.values.result import Result
    from touchbench_builder.progress import Progress
    from touchbench_streams.detectors.ticks import TickWatcher

BITS = 8  # of a weight in C; Python rounds to as many where it can
ROUNDED = ("lda", "softmax", "reflex")  # models with model.bits=
REPAIRED = "stuck+dead"
OF_STREAMS = (
    "max_false_alarms",
    "max_latency",
)  # budgets of a scene that the chosen system must meet in recordings
BUILT = "touchbench.built"  # tag of a model: what it was built from
STREAM = "the detector of touches in a stream"
EARLY = "calibration and early decisions"
COSTS = (
    "flash_bytes",
    "ram_bytes",
    "stack_bytes",
    "frame_instructions",
    "most_instructions",
)  # of the linked C
LIMITED = {
    "flash": "flash_bytes",
    "ram": "ram_bytes",
    "cycles": "most_instructions",
}  # of these, by budget
SMALLEST: dict[str, object] = {"model": "tree", "features": "jung28"}
LARGEST: dict[str, object] = {"model": "reflex", "model.bits": BITS}
LARGEST_S = 60.0  # of a fit on one core
FAULTS = (
    "dead_taxels",
    "stuck_taxels",
    "noise",
)  # that the choice is tested under if the scene names none
# Times the processor time of a comparison: that of a fault, of watching recordings in one fold, and of the last fit,
# which also teaches a detector of touches to systems whose C can watch a stream.
FAULTED, WATCHED, LAST, LAST_WATCHING = 2.5, 2.0, 2.0, 6.0


@dataclass(frozen=True)
class Choice:
    """The chosen system."""

    values: dict[str, Any]  # its keys of ``bench run``
    name: str  # in tables
    table: (
        pd.DataFrame
    )  # a row per compared system: system, accuracy in percent, flash and ram in kB, verdict
    nested: (
        pd.DataFrame
    )  # a row per capture, labelled by the system that was chosen without its subject
    left_out: list[str]  # systems that were not compared, with reasons
    runs: list[str]  # ids of the compared runs
    limits: dict[str, float]  # budget of each cost
    run_id: str


def systems(corpus: Corpus) -> list[tuple[dict[str, Any], float]]:
    """Keys of ``bench run`` of systems that have C, and the seconds of a fit on one core, cheap ones first.

    They are the first trials of ``model=auto`` on windows of ``touch``, one for each model and window, behind the
    repair of broken taxels; the smallest system, and the most accurate one of the models with C.
    """
    every = [portfolio.with_defaults(trial) for trial in portfolio.FIRST_TRIALS]
    trials: dict[tuple, dict[str, Any]] = {}
    for trial in [t for t in every if t["window"]] + [
        t | {"window": 1.0} for t in every if not t["window"]
    ]:
        try:
            check_exportable(portfolio.make_system(trial, 0))
        except InputError:
            continue
        if trial["features"] == "touch":
            trials.setdefault((trial["model"], trial["window"]), trial)
    width = len(TouchFeatures().fit(corpus[:1]).names_)
    found: list[tuple[dict[str, Any], float]] = [
        (SMALLEST, portfolio.MIN_FIT_S),
        (LARGEST, LARGEST_S),
    ]
    for (model, window), trial in trials.items():
        values = {
            "model": model,
            "features": "touch",
            "model.window": window,
            "model.repair": REPAIRED,
        }
        values |= {
            f"model.{key.partition('.')[2]}": value for key, value in trial.items() if "." in key
        }
        values |= {"model.bits": BITS} if model in ROUNDED else {}
        found.append(
            (
                values,
                portfolio.expected_fit_seconds(trial, corpus, width, len(set(corpus.gestures))),
            )
        )
    return sorted(found, key=lambda pair: pair[1])


def compared(
    corpus: Corpus,
    on: Mapping[str, Any],
    scene: Scene,
    limits: Mapping[str, float],
    progress: Progress,
) -> Choice:
    """Run the systems on people left out, link each for a Cortex-M4F, and choose within the budgets of the scene.

    ``limits``, budgets of the command line, replace these; ``on`` has the keys of ``bench run`` that name the captures.
    """
    progress.begin_run(f"systems on people left out, within {format_seconds(progress.left)}")
    under = {"under": [*scene.faults]} if scene.faults else {}
    every = [
        pair for pair in systems(corpus) if not (scene_watches(scene) and pair[0] == SMALLEST)
    ]  # its C cannot
    kept: dict[str, tuple[dict[str, Any], Plan]] = {}
    results, left_out, longest, slowest = [], [], 0.0, 0.0
    for number, (values, work) in enumerate(every, 1):
        name, before = shown(values), progress.left
        plan, executor = planned(on | {"protocol": "loso"} | values | under)
        seconds = max(slowest, work * len(plan.folds) / plan.workers)
        need = max(longest, seconds) + sum(afterwards(plan, scene, seconds))
        if results and before < need and find_stored_runs(connect(), [plan])[1]:
            left_out.append(
                f"{name}: with its tests and its last fit, it would take {format_estimate(need)}; raise seconds="
            )
            continue
        progress.say(f"system {number} of {len(every)}: {name}; {format_seconds(before)} left")
        try:
            result = run(plan, executor)
            linked = {} if missing_programs() else _linked(on, values, str(result["run_id"]))
            result.metrics |= {
                all_costs()[cost].source_name: linked[name]
                for cost, name in LIMITED.items()
                if linked
            }
        except InputError as e:
            left_out.append(f"{name}: {e}")
            continue
        results.append(result)
        kept[result.system] = values, plan
        longest = max(longest, before - progress.left)  # with the start of processes, and linking
        slowest = max(slowest, seconds_of(plan))
    if not results:
        raise InputError(f"no system could be compared: {left_out[0]}")
    if left_out:
        more = f"; {len(left_out) - 1} more in the certificate" * (len(left_out) > 1)
        progress.say(f"{len(results)} of {len(every)} systems compared; not {left_out[0]}{more}")
    progress.begin_run("choice")
    found = _choose(results, scene, limits)
    if found.chosen is None:
        raise InputError(nothing_fits(found))
    name, runs = str(found.system), {r.system: str(r["run_id"]) for r in results}
    table = found.table[["system", "accuracy", "flash", "ram", "verdict"]]
    values, plan = kept[name]
    tests, last = afterwards(plan, scene, seconds_of(plan))
    progress.say(
        f"{name}; {f'{format_estimate(tests)} more for its tests, ' * (tests > 0)}{format_estimate(last)} for its last fit"
    )
    labels = nested(found, results)
    return Choice(
        values, name, table, labels, left_out, [*runs.values()], found.budgets, runs[name]
    )


def shown(values: Mapping[str, Any]) -> str:
    """A system in words."""
    window = f", windows of {values['model.window']:g} s" if "model.window" in values else ""
    return f"{values['model']}{' on ' + str(values['features']) if 'features' in values else ''}{window}"


def planned(values: Mapping[str, Any], command: str = "run") -> tuple[Plan, FoldExecutor]:
    """The plan of a run by the keys of a command, and its workers."""
    typed = values_from_keywords(values, key_options(command, values))
    executor = make_executor(typed)
    (plan,) = commands.plan_grids(command, {"": typed}, executor)
    return plan, executor


def run(plan: Plan, executor: FoldExecutor) -> Result:
    """The run of a plan; stored folds are not repeated."""
    (result,) = run_plans([plan], executor)
    if not result.is_complete:
        raise InputError(f"{len(result.errors)} of {len(plan.folds)} folds failed")
    return result


def seconds_of(plan: Plan) -> float:
    """Seconds that a stored run took, or would have taken at once."""
    return estimate_seconds(connect(), [(plan, len(plan.folds))])[0] or 0.0


def afterwards(plan: Plan, scene: Scene, seconds: float) -> tuple[float, float]:
    """Seconds of what follows if a system is chosen: tests that its comparison lacks, and its last fit.

    The last fit has one process; the comparison took so many seconds with all workers.
    """
    plain = seconds / (1 + FAULTED * len(scene.faults)) if scene.faults else seconds
    tests = WATCHED * len(plan.folds) * scene_watches(scene) + FAULTED * len(FAULTS) * (
        not scene.faults
    )
    last = LAST_WATCHING if check_exportable(plan.cell.untrained_system) else LAST
    return tests * plain, last * plain * plan.workers


def scene_watches(scene: Scene) -> bool:
    """Whether a scene has budgets of streams."""
    return not {*OF_STREAMS}.isdisjoint(scene.values)


class Beside(Watching):
    """Learns to watch, beside a system that learns from captures of gestures alone, as in the comparison."""

    def __init__(self, cell: Cell) -> None:
        super().__init__({})
        self.captures, self.recordings = captures_of_cell, Watching.captures(cell)

    def learned(
        self, make_system: Callable[[], System], system: System, captures: Corpus
    ) -> TickWatcher:
        """Learn from recordings, where there are some."""
        return super().learned(make_system, system, self.recordings)


def fitted(
    on: Mapping[str, Any],
    values: Mapping[str, Any],
    key: str,
    stopping: bool = True,
    watch: bool = True,
) -> tuple[str, Recogniser]:
    """The id of the run of a model that was trained on all captures, and the model; trained if it is not stored."""
    store = connect(writes=True)
    for stored in store.search_runs(f"tags.`{BUILT}` = '{key}'"):
        return stored.info.run_id, load_recogniser(f"runs:/{stored.info.run_id}/model")
    (cell,) = make_cells({k: v for k, v in on.items() if k != "jobs"} | dict(values))
    made = fit(
        cell,
        stopping=stopping,
        learner=Beside(cell) if watch and check_exportable(cell.untrained_system) else None,
    )
    store.log_values(made.run_id, tags={BUILT: key})
    return made.run_id, made.recogniser


def key_of(*parts: object) -> str:
    """A short digest."""
    return hashlib.sha256(json.dumps([str(part) for part in parts]).encode()).hexdigest()[:20]


def _linked(on: Mapping[str, Any], values: Mapping[str, Any], run_id: str) -> dict[str, float]:
    """Bytes and instructions of a system in C on a Cortex-M4F, trained on all captures; stored with this model."""
    store, key = connect(writes=True), _key_of_linked(run_id)
    numbers = next(
        (model.data.metrics for model in store.search_runs(f"tags.`{BUILT}` = '{key}'")), {}
    )
    if not {*COSTS} <= {name.removeprefix("linked_") for name in numbers}:
        found, recogniser = fitted(on, values, key, stopping=False, watch=False)
        numbers = {f"linked_{name}": value for name, value in on_chip(recogniser).items()}
        store.log_values(found, numbers)
    return {name: numbers[f"linked_{name}"] for name in COSTS}


def _key_of_linked(run_id: str) -> str:
    return key_of("linked", run_id, hash_fixed_code())


def on_chip(recogniser: Recogniser) -> dict[str, float]:
    """`COSTS` of a model in C on a Cortex-M4F. A model that watches a stream costs what `touch_watch` costs."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in write_c_sources(recogniser, BITS, "a system of bench build").items():
            (folder / file).write_text(text, encoding="utf-8")
        watches = "#define TOUCH_WATCH 1" in (folder / "touch.h").read_text(encoding="utf-8")
        try:
            numbers = measure_watching(folder) if watches else measure_footprint(folder, *ROOMY)
        except ValueError as e:  # such as a program that does not fit into the emulated chip
            raise InputError(str(e)) from e
    return {name: numbers[f"chip_{'watch_' * watches}{name}"] for name in COSTS}


def trained(
    on: Mapping[str, Any], choice: Choice, scene: Scene
) -> tuple[str, Recogniser, dict[str, float] | None, str]:
    """The chosen system, trained on all captures: with all that a model can learn and the budgets allow.

    Id of its run, the model, its `COSTS` (None if they cannot be measured), and what the budgets left out, in words.
    """
    run_id, recogniser = fitted(on, choice.values, key_of(choice.run_id, "built"))
    if missing_programs():
        return run_id, recogniser, None, ""
    watches = recogniser.watcher is not None
    less = [] if scene_watches(scene) else [(False, True)] * watches + [(False, False)]
    for watch, stopping in [(watches, True), *less]:
        recogniser.watcher = recogniser.watcher if watch else None
        recogniser.stopping = recogniser.stopping if stopping else None
        amounts = on_chip(recogniser)
        if any(
            amounts[name] > 1000 * choice.limits.get(cost, np.inf) for cost, name in LIMITED.items()
        ):
            continue
        without = [STREAM] * (watches and not watch) + [EARLY] * (not stopping)
        if without:  # a model that is stored as it is written
            key = (
                key_of(choice.run_id, "built", STREAM)
                if stopping
                else _key_of_linked(choice.run_id)
            )
            run_id, recogniser = fitted(on, choice.values, key, stopping=stopping, watch=False)
        return run_id, recogniser, amounts, ", ".join(without)
    what = (
        "with the detector that the scene needs"
        if scene_watches(scene)
        else "trained on all captures"
    )
    kilobytes = f"{amounts['flash_bytes'] / 1000:.1f} kB of flash and {amounts['ram_bytes'] / 1000:.1f} kB of RAM"
    raise InputError(
        f"{choice.name} fits, but {what} it takes {kilobytes}; take a larger board or raise its budgets"
    )


def _choose(results: list[Result], scene: Scene, limits: Mapping[str, float]) -> rule.Choice:
    """What ``bench choose`` finds among some results."""
    given = typed_settings(
        "choose", {k: v for k, v in scene.values.items() if k not in ("clock", "unit", *OF_STREAMS)}
    )
    budgets = cost_limits(given) | dict(limits)
    return rule.choose_from_runs(
        results, {}, given["by"], budgets, scene=scene, margin=given["margin"]
    )


def nested(found: rule.Choice, results: list[Result]) -> pd.DataFrame:
    """Labels of each subject's captures by the system that the other subjects alone would have chosen."""
    labels = {r.system: label_captures(r.tables["predictions"]) for r in results}
    among, parts = found.candidates, []
    for subject, other in zip(among.subjects, found.choices_without_each(), strict=True):
        name = "" if other is None else str(among.table.loc[other, "system"])
        mine = labels[name or str(found.system)]
        mine = mine[mine["subject"].astype(str) == str(subject)]
        parts.append(mine[["subject", "true", "predicted"]].assign(system=name))
    return pd.concat(parts, ignore_index=True)


def nothing_fits(choice: rule.Choice) -> str:
    """Why no system fits, in the sentences of ``bench choose``, and what would help."""
    lines = choice.why_nothing_fits()
    if (missing := missing_programs()) and any(limit["unknown"] for limit in choice.limits):
        lines.append(f"Install {', '.join(missing)}, which measure C.")
    sizes = choice.table[["flash", "ram"]]
    holding = [
        (board.flash_kb, name)
        for name, board in load_boards().items()
        if (sizes <= [board.flash_kb, board.ram_kb]).all(axis=1).any()
    ]
    if holding and any(limit["over"] and limit["cost"].key in sizes for limit in choice.limits):
        lines.append(f"The smallest board that holds one of them is {min(holding)[1]}.")
    return " ".join(lines).removesuffix(".")
