"""The systems that are compared, the choice among them, and what a new person may expect of the choice."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.measures import costs
from bench.outcomes.scene import Scene, boards
from bench.progress import console, span
from touchbench_chip.measure import lacking, measured, measured_watching

if TYPE_CHECKING:
    from bench.work.saved import Recogniser
    from touchbench_builder.way import Progress

BITS = 8  # of a weight in C; Python rounds to as many where it can
ROUNDED = ("lda", "softmax", "reflex")  # models with model.bits=
REPAIRED = "stuck+dead"
OF_STREAMS = ("max_false_alarms", "max_latency")  # budgets of a scene that the chosen system must meet in recordings
BUILT = "touchbench.built"  # tag of a model: what it was built from
LINKED = {"flash": "chip_flash_bytes", "ram": "chip_ram_bytes", "cycles": "chip_most_instructions"}
STREAM = "the detector of touches in a stream"
EARLY = f"{STREAM}, calibration and early decisions"
COSTS = ("flash_bytes", "ram_bytes", "stack_bytes", "frame_instructions", "most_instructions")
SMALLEST: dict[str, object] = {"model": "tree", "features": "jung28"}
LARGEST: dict[str, object] = {"model": "reflex", "model.bits": BITS}
LARGEST_S = 60.0  # of a fit on one core


@dataclass(frozen=True)
class Choice:
    """The chosen system.

    Attributes:
        values: its keys of ``bench run``.
        name: its name in tables.
        table: a row per compared system: ``system``, ``accuracy`` in percent, ``flash``, ``ram`` in kB, ``verdict``.
        nested: a row per capture with the label of the system that was chosen without its subject (``system``).
        left_out: systems that were not compared, with reasons.
        runs: ids of the compared runs.
        limits: budget of each cost.
        key: what it depends on.
    """

    values: dict[str, Any]
    name: str
    table: pd.DataFrame
    nested: pd.DataFrame
    left_out: list[str]
    runs: list[str]
    limits: dict[str, float]
    key: str


def systems(corpus: Corpus) -> list[tuple[dict[str, Any], float]]:
    """Keys of ``bench run`` of systems that have C, and the seconds of a fit on one core, cheap ones first.

    They are the first trials of ``model=auto`` on windows of ``touch``, one for each model and window, behind the
    repair of broken taxels; the smallest system, and the most accurate one of the models with C.
    """
    from bench.features.touch import TouchFeatures
    from bench.models.search import portfolio
    from touchbench_chip.tables import check

    trials: dict[tuple[str, object], dict[str, Any]] = {}
    every = [portfolio.complete(trial) for trial in portfolio.FIRST]
    windowed = [t for t in every if t["window"]] + [t | {"window": 1.0} for t in every if not t["window"]]
    for trial in (t for t in windowed if t["features"] == "touch"):
        try:
            check(portfolio.system(trial, 0))
        except InputError:
            continue
        trials.setdefault((str(trial["model"]), trial["window"]), trial)
    width = len(TouchFeatures().fit(corpus[:1]).names_)
    found: list[tuple[dict[str, Any], float]] = [(SMALLEST, portfolio.LEAST_S), (LARGEST, LARGEST_S)]
    for (model, window), trial in trials.items():
        values = {"model": model, "features": "touch", "model.window": window, "model.repair": REPAIRED}
        values |= {f"model.{key.partition('.')[2]}": value for key, value in trial.items() if "." in key}
        values |= {"model.bits": BITS} if model in ROUNDED else {}
        found.append((values, portfolio.work(trial, corpus, width, len(set(corpus.gestures)))))
    return sorted(found, key=lambda pair: pair[1])


def keywords(values: Mapping[str, Any]) -> dict[str, Any]:
    """Keys as arguments of the Python API."""
    return {key.replace(".", "__"): value for key, value in values.items()}


def compared(
    corpus: Corpus, on: Mapping[str, Any], scene: Scene, limits: Mapping[str, float], progress: Progress
) -> Choice:
    """Run the systems on people left out, link each for a Cortex-M4F, and choose.

    Args:
        corpus: captures to learn from.
        on: keys of ``bench run`` that name them.
        scene: needs of the robot.
        limits: budgets of the command line; they replace those of the scene.
        progress: steps and time.
    """
    import bench

    progress.begin(f"systems on people left out, within {span(progress.left)}")
    under = {"under": list(scene.faults.names)} if scene.faults else {}
    folds, longest = len(set(corpus.subjects)), 0.0
    rows, kept, left_out = [], [], []
    streams = bool({*OF_STREAMS} & {*scene.values})
    every = [pair for pair in systems(corpus) if not (streams and pair[0] == SMALLEST)]  # whose C watches no stream
    for number, (values, work) in enumerate(every, 1):
        name, before = shown(values), progress.left
        keyed = keywords(on | {"protocol": "loso"} | values | under)
        if rows and before < longest + work * folds and not _is_stored(keyed):
            left_out.append(f"{name}: it would need more than the {span(before)} that were left")
            continue
        line = f"system {number} of {len(every)}: {name}; {span(before)} left"
        console.print(line, markup=False, highlight=False, soft_wrap=True)
        try:
            run = bench.run(**keyed).iloc[0]
            if not run["complete"]:
                raise InputError("a fold failed")
            size = {} if lacking() else _linked(on, values, str(run["run_id"]))
        except InputError as e:
            left_out.append(f"{name}: {e}")
            continue
        rows.append(run)
        kept.append((values, size))
        longest = max(longest, before - progress.left)
    if not rows:
        raise InputError(f"no system could be compared: {left_out[0]}")
    progress.begin("choice")
    runs = pd.DataFrame(rows).reset_index(drop=True)
    return _chosen(runs, kept, left_out, scene, limits)


def _is_stored(values: Mapping[str, Any]) -> bool:
    """Whether a run is stored, so that it takes no time."""
    from bench.commands.run import planned
    from bench.options import backend_of, keys, values_of
    from bench.store import connect
    from bench.work.tracking import key_of

    typed = values_of(values, keys("run", [key.replace("__", ".") for key in values]))
    (plan,) = planned("run", {"": typed}, backend_of(typed))
    run = connect().find(key_of(plan), plan.cell.kind)
    return run is not None and run.info.status == "FINISHED"


def shown(values: Mapping[str, Any]) -> str:
    """A system in words."""
    window = f", windows of {values['model.window']:g} s" if "model.window" in values else ""
    return f"{values['model']}{' on ' + str(values['features']) if 'features' in values else ''}{window}"


def fitted(on: Mapping[str, Any], values: Mapping[str, Any], key: str, **how: Any) -> tuple[str, Recogniser]:
    """The id of the run of a model that was trained on all captures, and the model; trained if it is not stored."""
    import bench
    from bench.store import connect
    from bench.work.saved import load

    store = connect(writes=True)
    for run in store.runs(f"tags.`{BUILT}` = '{key}'"):
        return run.info.run_id, load(f"runs:/{run.info.run_id}/model")
    made = bench.fit(**keywords({k: v for k, v in on.items() if k != "jobs"} | dict(values) | how))
    store.log(made.run_id, tags={BUILT: key})
    return made.run_id, made.recogniser


def key_of(*parts: object) -> str:
    """A short digest."""
    return hashlib.sha256(json.dumps([str(part) for part in parts]).encode()).hexdigest()[:20]


def _linked(on: Mapping[str, Any], values: Mapping[str, Any], run_id: str) -> dict[str, float]:
    """Bytes and instructions of a system in C on a Cortex-M4F, trained on all captures; stored with this model."""
    from bench.store import connect
    from touchbench_chip.write import digest

    store = connect(writes=True)
    key = key_of("linked", run_id, digest())
    for run in store.runs(f"tags.`{BUILT}` = '{key}'"):
        if set(LINKED.values()) <= run.data.metrics.keys():
            return run.data.metrics
    found, recogniser = fitted(on, values, key, stopping=False, watch=False)
    numbers = on_chip(recogniser)
    store.log(found, numbers)
    return numbers


def on_chip(recogniser: Recogniser) -> dict[str, float]:
    """Bytes and instructions of a model in C on a Cortex-M4F (`touchbench_chip.measure`)."""
    from touchbench_chip.write import files_of

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in files_of(recogniser, BITS, "a system of bench build").items():
            (folder / file).write_text(text, encoding="utf-8")
        watches = "#define TOUCH_WATCH 1" in (folder / "touch.h").read_text(encoding="utf-8")
        try:
            return measured_watching(folder) if watches else measured(folder)
        except ValueError as e:  # such as a program that does not fit into the chip of the Makefile
            raise InputError(str(e)) from e


def trained(on: Mapping[str, Any], choice: Choice) -> tuple[str, Recogniser, dict[str, float] | None, str]:
    """The chosen system, trained on all captures: with all that a model can learn and the budgets allow.

    Returns:
        Id of its run, the model, `COSTS` on a Cortex-M4F (None if they cannot be measured), and what the budgets left
        out, in words.
    """
    for without, how in (("", {}), (STREAM, {"watch": False}), (EARLY, {"watch": False, "stopping": False})):
        run_id, recogniser = fitted(on, choice.values, key_of(choice.key, without), **how)
        if lacking():
            return run_id, recogniser, None, ""
        numbers = on_chip(recogniser)
        prefix = "chip_watch_" if "chip_watch_flash_bytes" in numbers else "chip_"
        costs_of = {name: numbers[f"{prefix}{name}"] for name in COSTS}
        amounts = {"flash": "flash_bytes", "ram": "ram_bytes", "cycles": "most_instructions"}
        if all(costs_of[amounts[k]] <= 1000 * v for k, v in choice.limits.items() if k in amounts):
            return run_id, recogniser, costs_of, without
    raise InputError(f"{choice.name}: within its budgets in the comparison, but not when it is trained; relax them")


def _chosen(runs: pd.DataFrame, kept: list, left_out: list[str], scene: Scene, limits: Mapping[str, float]) -> Choice:
    """The choice of ``bench choose``, with sizes as linked, and its expectation for each person left out."""
    import bench
    from bench.outcomes.candidates import People
    from bench.outcomes.choice import decide
    from bench.scores import captures

    keys = {k: v for k, v in scene.values.items() if k not in ("clock", "unit", *OF_STREAMS)}
    result = _choose(runs, scene, keys, limits)
    among = result.among
    position = {str(name): i for i, name in enumerate(runs["system"])}
    rows = [i for i, row in among.table.iterrows() if row["unit"] == "capture" and row["mark"] == ""]
    order = [position[str(among.table.loc[i, "system"])] for i in rows]
    table = among.table.loc[rows].reset_index(drop=True)
    for cost, metric in LINKED.items():
        sizes = [kept[i][1].get(metric) for i in order]
        if None not in sizes:
            table[cost] = [size / 1000 for size in sizes]
        elif cost in limits and cost == "cycles":
            raise InputError(f"max_cycles= needs {', '.join(lacking())}, to count instructions; install them")
    subjects = among.subjects.loc[rows].reset_index(drop=True)
    people = People(among.people.scores[rows], among.people.losses[rows], among.people.counts[:, rows])
    choice = decide(table, subjects, result.by, result.budgets, result.margin)
    if choice.chosen is None:
        raise InputError(_nothing_fits(table, choice.budgets))
    predictions = bench.predictions(runs)
    labels = [captures(predictions[predictions["run_id"] == runs.loc[i, "run_id"]]) for i in order]
    nested = _nested(result, table, subjects, people, labels, choice.chosen)
    values, best = kept[order[choice.chosen]][0], order[choice.chosen]
    digest = key_of("built", runs.loc[best, "run_id"])
    return Choice(
        dict(values),
        str(table.loc[choice.chosen, "system"]),
        choice.table[["system", "accuracy", "flash", "ram", "verdict"]],
        nested,
        left_out,
        [*map(str, runs["run_id"])],
        result.budgets,
        digest,
    )


def _choose(runs: pd.DataFrame, scene: Scene, keys: Mapping[str, Any], limits: Mapping[str, float]) -> Any:
    """What ``bench choose`` finds among some runs, for a scene that is read already."""
    from bench.options import limits_of, settings
    from bench.outcomes import choice
    from bench.outcomes.runs import asked_of, every_result
    from bench.store import connect

    given = settings("choose", keys)
    asked = asked_of({"run": [*runs["run_id"]]})
    budgets = limits_of(given) | dict(limits)
    found = every_result(connect(), asked)
    return choice.choose(found, asked, given["by"], budgets, scene=scene, margin=given["margin"])


def _nested(
    result: Any,
    table: pd.DataFrame,
    subjects: pd.DataFrame,
    people: Any,
    labels: list[pd.DataFrame],
    chosen: int,
) -> pd.DataFrame:
    """Labels of each subject's captures by the system that the other subjects alone would have chosen."""
    from bench.outcomes.choice import pick

    parts = []
    for number, subject in enumerate(subjects.columns):
        others = people.without(number)
        known = table.assign(**others.costs({result.by, *result.budgets}))
        other = pick(known, others.scores, result.by, result.budgets, result.margin)[0]
        mine = labels[chosen if other is None else other]
        mine = mine[mine["subject"].astype(str) == str(subject)]
        name = "" if other is None else str(table.loc[other, "system"])
        parts.append(mine[["subject", "true", "predicted"]].assign(system=name))
    return pd.concat(parts, ignore_index=True)


def _nothing_fits(table: pd.DataFrame, budgets: list) -> str:
    """Which budget is missed most, by how much, and the next larger board that would do."""

    def missed(limit: Any) -> float:
        amounts = table[limit.cost].dropna()
        if not len(amounts):
            return np.inf
        least = costs()[limit.cost].burden(amounts).min()
        return float(abs(least) / limit.budget if costs()[limit.cost].better == "low" else limit.budget / abs(least))

    limit = max(budgets, key=missed)
    cost = costs()[limit.cost]
    amounts = table[limit.cost].dropna()
    if not len(amounts):
        return f"no system fits: {cost.noun or cost.key} is unknown of all of them; leave its budget out"
    least = amounts.min() if cost.better == "low" else amounts.max()
    words = f"no system fits: {cost.noun or cost.key} is missed most: {cost.amount(float(least))} at best, "
    words += f"the budget is {cost.amount(limit.budget)}"
    if limit.cost in ("flash", "ram"):
        larger = [
            (board.flash_kb, name) for name, board in boards().items() if getattr(board, f"{limit.cost}_kb") >= least
        ]
        words += f"; the next board that holds it is {min(larger)[1]}" if larger else ""
        return f"{words}; take a larger board, or raise max_{limit.cost}="
    return f"{words}; relax it"
