"""Systems of a build: compared on people left out, and chosen within the budgets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.commands import run as commands
from bench.corpora.corpus import Corpus
from bench.corpora.faults import parse_fault_names, usual_faults
from bench.errors import InputError
from bench.grammar.options import (
    cost_limits,
    key_options,
    make_executor,
    typed_settings,
    values_from_keywords,
)
from bench.ground.machine import BUSY_SLOWDOWN
from bench.ground.progress import format_estimate, format_seconds
from bench.reading import choice as rule
from bench.reading.scene import Scene, load_boards
from bench.running.loop import Interrupted, estimate_seconds, find_stored_runs, run_plans
from bench.store.client import connect
from bench.values.measures import all_costs
from bench.values.scores import label_captures
from touchbench_builder.candidates import (
    LARGEST_SYSTEM,
    SMALLEST_SYSTEM,
    TRAINED_FAULTS,
    candidate_systems,
    system_title,
    train_against,
)
from touchbench_builder.captures import find_two_sessions
from touchbench_builder.deadline import LimitedExecutor, OutOfTime
from touchbench_builder.fitting import CHIP_COST_OF, ChosenSystem, fits_budgets, linked_costs
from touchbench_builder.slices import most_instructions, needed_ram
from touchbench_builder.stream import select_people
from touchbench_chip.measure import missing_programs

if TYPE_CHECKING:
    from bench.plan.plan import Plan
    from bench.running.workers import FoldExecutor
    from bench.values.result import Result
    from touchbench_builder.progress import Progress

STREAM_BUDGETS = ("max_false_alarms", "max_latency")  # of a scene, for recordings
WATCH = "watch"  # the command of runs on streams
DEFAULT_FAULTS = tuple(  # if the scene names none
    "noise offset_drift drift gain_drift lower_rate doubled_frames dropped_frames time_jitter "
    "dead_taxels stuck_taxels".split()
)
MAX_CLEAN_LOSS = 1.0  # points without faults that training against faults may cost
# As multiples of the processor time of a comparison on captures: a fault, and the last fit.
FAULT_TIME, LAST_FIT_TIME = 2.5, 2.0
# The same of a comparison on streams that learns its detectors: all faults, captures, two
# sessions; and the last fit, in folds, whose detector is there.
STREAM_FAULTS_TIME, CAPTURES_TIME, SESSIONS_TIME, LAST_WATCHING_FITS = 1.25, 0.05, 2.0, 0.6
HARDENING_TIME = 0.5  # of a system that is trained against faults, whose detectors are there
WRITING_S = 16.0  # of the folder: its C labels all captures and passes its test


class Comparison:
    """Systems that run on people left out, one after the other, as long as time allows.

    The first one is run in any case.

    Args:
        corpus: captures.
        on: keys of ``bench run`` that name them.
        scene: needs of the robot.
        progress: progress of the build.
        watches: run on touches in streams, else on captures.
        frame_limit: most instructions of a frame.

    Attributes:
        results: a run of each system.
        damaged: its runs on captures under the faults of the scene.
        plans: its keys and plan, by its name.
        costs: its `CHIP_COSTS`, by its name.
        left_out: systems that were not compared, with reasons.
    """

    def __init__(
        self,
        corpus: Corpus,
        on: Mapping[str, Any],
        scene: Scene,
        progress: Progress,
        watches: bool,
        frame_limit: float,
    ) -> None:
        self.on, self.scene, self.progress = on, scene, progress
        self.has_sessions = bool(find_two_sessions(corpus)[0])
        self.watches, self.frame_limit = watches, frame_limit
        self.results: list[Result] = []
        self.damaged: list[Result] = []
        self.plans: dict[str, tuple[dict[str, Any], Plan]] = {}
        self.costs: dict[str, dict[str, float]] = {}
        self.left_out: list[str] = []
        self.longest = self.slowest = self.linking = 0.0  # seconds
        self.slowdown, self.was_stopped = 1.0, False
        self.hardens = False  # whether the choice will be trained against faults

    def run_system(self, values: dict[str, Any], fit_seconds: float, place: str) -> Result | None:
        """Run a system and link its C; None if it cannot be run, or would be late.

        Args:
            values: its keys.
            fit_seconds: expected seconds of a fit on one core.
            place: place of the system among all, in words.
        """
        title, left = system_title(values), self.progress.seconds_left
        keys = self.on | {"protocol": "loso"} | values
        faults = {"under": [*self.scene.faults]} if self.scene.faults else {}
        pairs = [make_plan(keys, WATCH)] if self.watches else []
        pairs += [make_plan(keys | faults)] if faults or not self.watches else []
        plan = pairs[0][0]
        is_new = bool(self.results) and bool(find_stored_runs(connect(), [plan])[1])
        if is_new and (late := self._why_late(plan, fit_seconds)):
            self.left_out.append(f"{title}: {late}; raise seconds=")
            return None
        if is_new:
            pairs[0] = plan, LimitedExecutor(pairs[0][1], self.progress, self.seconds_after)
        self.progress.print_line(f"{place}: {title}; {format_seconds(left)} left")
        try:
            result, *others = [run_plan(*pair) for pair in pairs]
            if self.watches and not result.metrics["touches_found"]:
                raise InputError("it found no touch in any stream")
            before = self.progress.seconds_left
            if not missing_programs():
                self._link(result, values)
        except Interrupted as e:
            if not isinstance(e.__cause__, OutOfTime):
                raise
            self.left_out.append(f"{title}: {e.__cause__}; raise seconds=")
            self.was_stopped, self.slowest = True, max(self.slowest, e.__cause__.seconds)
            return None
        except InputError as e:
            self.left_out.append(f"{title}: {e}")
            return None
        self.results.append(result)
        self.damaged += others
        self.plans[result.system] = values, plan
        self.linking = max(self.linking, before - self.progress.seconds_left)
        self.longest = max(self.longest, left - self.progress.seconds_left)
        self.slowest = max(self.slowest, comparison_seconds(plan))
        self.slowdown = max(self.slowdown, result.metrics.get("slowdown", 1.0))
        return result

    def _why_late(self, plan: Plan, fit_seconds: float) -> str:
        """Reason not to run another system; "" if it could be in time, as its folds will show."""
        left = self.progress.seconds_left
        seconds = max(self.slowest, fit_seconds * len(plan.folds) / plan.workers)
        needed = max(self.longest, seconds) + sum(self.seconds_after(plan, seconds))
        first = seconds * plan.workers / len(plan.folds)  # until it is known better
        reserve = sum(self.seconds_after(plan, self.slowest))
        if left >= needed or (not self.was_stopped and left >= first + reserve):
            return ""
        return f"with its tests and its last fit, it would take {format_estimate(needed)}"

    def seconds_after(self, plan: Plan, seconds: float) -> tuple[float, ...]:
        """Seconds of all that comes after a comparison: linking, training against faults, rest."""
        slowest = max(self.slowest, seconds)
        hardening = HARDENING_TIME * slowest * self.hardens
        return (self.linking, hardening, *self.later_seconds(plan, slowest))

    def later_seconds(self, plan: Plan, seconds: float) -> tuple[float, float]:
        """Seconds of the remaining tests of a chosen system, and of its last fit and its folder.

        Args:
            plan: plan of the comparison.
            seconds: seconds of the comparison, with all workers; the last fit has one process.
        """
        sessions = SESSIONS_TIME * self.has_sessions
        if self.watches:
            tests = STREAM_FAULTS_TIME + CAPTURES_TIME + sessions
            last = LAST_WATCHING_FITS * seconds * plan.workers / len(plan.folds)
            return tests * seconds, last + WRITING_S
        faults = self.scene.faults
        clean = seconds / (1 + FAULT_TIME * len(faults))
        tests = sessions + (0 if faults else FAULT_TIME * len(DEFAULT_FAULTS))
        return tests * clean, LAST_FIT_TIME * clean * plan.workers + WRITING_S

    def _link(self, result: Result, values: Mapping[str, Any]) -> None:
        """Measure a system in C, and add its costs to the numbers of its run."""
        run_id = str(result["run_id"])
        costs = linked_costs(self.on, values, run_id, self.watches, self.frame_limit)
        costs["needed_ram_bytes"] = needed_ram(costs, self.scene.board)
        result.metrics |= _delay_latencies(result.metrics, costs["delay_s"])
        sources = {all_costs()[key].source_name: CHIP_COST_OF[key] for key in CHIP_COST_OF}
        result.metrics |= {source: costs[name] for source, name in sources.items()}
        self.costs[result.system] = costs

    def print_summary(self, count: int) -> None:
        """Print how many of all systems were compared, why not the others, and a busy machine."""
        if self.left_out:
            more = f"; {len(self.left_out) - 1} more in the certificate" * (len(self.left_out) > 1)
            compared = f"{len(self.results)} of {count} systems compared"
            self.progress.print_line(f"{compared}; not {self.left_out[0]}{more}")
        if self.slowdown > BUSY_SLOWDOWN:
            self.progress.print_line(
                f"other programs use the processors: all took up to {self.slowdown:.1f} times as "
                "long as on a quiet machine"
            )


def compare_systems(
    corpus: Corpus,
    on: Mapping[str, Any],
    scene: Scene,
    limits: Mapping[str, float],
    progress: Progress,
    watches: bool,
    faults: tuple[str, ...] | None = None,
) -> ChosenSystem:
    """Run systems on people left out, link each for a Cortex-M4F, and choose within the budgets.

    Args:
        corpus: captures.
        on: keys of ``bench run`` that name them.
        scene: needs of the robot, with budgets.
        limits: budgets of the command line, which replace those of the scene.
        progress: progress of the build.
        watches: choose by labels of touches in streams, else by those of captures.
        faults: to train against; None: those of `TRAINED_FAULTS`, if it costs little.

    Raises:
        InputError: no system could be compared, or none is within the budgets.
    """
    left = progress.seconds_left
    progress.start_step(f"systems on people left out, within {format_seconds(left)}")
    systems = candidate_systems(corpus, faults)
    if watches:  # the C of the smallest cannot watch
        systems = [pair for pair in systems if pair[0]["model"] != SMALLEST_SYSTEM["model"]]
    settings, budgets = _read_budgets(scene, limits, watches)
    budget = 1000 * budgets.get("cycles", np.inf)
    frame_limit = most_instructions(scene.board, corpus.rate_hz, budget)
    comparison = Comparison(corpus, on, scene, progress, watches, frame_limit)
    comparison.hardens = faults is None and watches
    for number, (values, fit_seconds) in enumerate(systems, 1):
        comparison.run_system(values, fit_seconds, f"system {number} of {len(systems)}")
    if not comparison.results:
        raise InputError(f"no system could be compared: {comparison.left_out[0]}")
    comparison.print_summary(len(systems))
    progress.start_step("choice")
    choice = rule.choose_from_runs(
        comparison.results + comparison.damaged,
        {},
        settings["by"],
        budgets,
        scene=scene,
        margin=settings["margin"],
        run_kind=WATCH if watches else "",
    )
    if choice.chosen is None:
        raise InputError(nothing_fits_message(choice))
    name = str(choice.system)
    systems_of_people = systems_without_each(choice)
    deciding = {person: system or name for person, system in systems_of_people.items()}
    table = choice.table[["system", "accuracy", "flash", "ram", "verdict"]]
    if faults is None:
        fit_seconds = next(each for values, each in systems if values == comparison.plans[name][0])
        rows, name, deciding = _harden(comparison, name, deciding, choice.budgets, fit_seconds)
        table = pd.concat([table, pd.DataFrame(rows)], ignore_index=True)
        hardened = {person for person in deciding if systems_of_people[person]}
        systems_of_people |= {person: deciding[person] for person in hardened}
    values, plan = comparison.plans[name]
    tests, last = comparison.later_seconds(plan, comparison.slowest)
    more = f"{format_estimate(tests)} more for its tests, " * (tests > 0)
    late = tests + last - progress.seconds_left
    more_than = f"; {format_estimate(late)} more than seconds= has left" * (late > 1)
    progress.print_line(f"{name}; {more}{format_estimate(last)} for its last fit{more_than}")
    watched, on_captures = None, comparison.results
    if watches:
        watched = select_people(comparison.results, deciding)
        keys = [on | {"protocol": "loso"} | comparison.plans[n][0] for n in {*deciding.values()}]
        on_captures = [run_plan(*make_plan(each)) for each in keys]
    run_ids = {r.system: str(r["run_id"]) for r in comparison.results}
    return ChosenSystem(
        values=values,
        name=name,
        table=table,
        systems=systems_of_people,
        captures=nested_labels(on_captures, deciding),
        watched=watched,
        left_out=comparison.left_out,
        runs=[*run_ids.values()],
        limits=choice.budgets,
        frame_limit=frame_limit,
        board=scene.board,
        run_id=run_ids[name],
    )


def _harden(
    comparison: Comparison,
    name: str,
    deciding: dict[str, str],
    budgets: Mapping[str, float],
    fit_seconds: float,
) -> tuple[list[dict[str, Any]], str, dict[str, str]]:
    """Replace a system by itself trained against faults, where that costs little without them.

    Whether it costs little is decided for each person by the others, and at last by all.

    Returns:
        Rows of `ChosenSystem.table`, the chosen system, and the system that decides on each person.
    """
    values = comparison.plans[name][0]
    comparison.hardens = comparison.was_stopped = False  # its own folds tell whether it is late
    if "model.faults" in values or values["model"] == LARGEST_SYSTEM["model"]:  # it has learned
        return [], name, deciding
    result = comparison.run_system(
        values | train_against(TRAINED_FAULTS), fit_seconds, "trained against faults"
    )
    if result is None:
        comparison.progress.print_line(f"not {comparison.left_out[-1]}")
        return [], name, deciding
    costs = comparison.costs.get(result.system, {})
    fits = not costs or fits_budgets(costs, budgets)
    losses = clean_losses(next(r for r in comparison.results if r.system == name), result)
    for person, system in deciding.items():
        if fits and system == name and losses.drop(person).mean() < MAX_CLEAN_LOSS:
            deciding[person] = result.system
    is_hard = fits and losses.mean() < MAX_CLEAN_LOSS
    verdict = f"{'' if is_hard else 'not '}chosen: {losses.mean():.1f} points lost without faults"
    verdict += "" if fits else ", and over a budget"
    comparison.progress.print_line(f"{result.system}, {verdict}")
    row = {"system": result.system, "verdict": verdict}
    row["accuracy"] = 100 * float((count_right(result).eval("right / total")).mean())
    if costs:
        row |= {cost: costs[CHIP_COST_OF[cost]] / 1000 for cost in ("flash", "ram")}
    return [row], result.system if is_hard else name, deciding


def parse_trained_faults(typed: str) -> tuple[str, ...] | None:
    """Faults of ``faults=``: () for none, and None if the build decides."""
    if typed in ("none", "auto"):
        return () if typed == "none" else None
    return parse_fault_names("faults", typed.replace(",", "+").split("+"), usual_faults())


def clean_losses(plain: Result, hardened: Result) -> pd.Series:
    """Points that each person loses by training against faults."""
    shares = [count_right(each) for each in (plain, hardened)]
    before, after = (100 * table["right"] / table["total"] for table in shares)
    return before - after


def count_right(result: Result) -> pd.DataFrame:
    """Right labels, and all, of each person: right, total."""
    if "touches" in result.tables:
        table = result.tables["touches"].rename(columns={"end_correct": "right"})
    else:
        table = label_captures(result.tables["predictions"])
        table = table.assign(right=table["true"].astype(str) == table["predicted"].astype(str))
    people = table["subject"].astype(str)
    return table.groupby(people)["right"].agg(right="sum", total="size")


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
