"""A plan's run in the store, resumed if it exists.

A finished fold is one file of the run, ``folds/N.zip`` by its place in the protocol, and its scores are numbers of the
run at this step. A file that was cut off while it was written is no zip file, so that a fold is whole or
missing. When all folds are done, their tables become those of the run, and their files go. A fold that fails leaves
``folds/N.txt``.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import zlib
from dataclasses import dataclass, field, fields, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import BadZipFile, ZipFile

import numpy as np
import pandas as pd

from bench import contract
from bench.errors import InputError
from bench.ground.machine import Machine
from bench.ground.source import git_revision, versions
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan
from bench.running.evaluation import run_of
from bench.running.results import FoldResult, costs
from bench.store.client import OF_FOLDS, Store, about_of
from bench.store.tables import FOR_PEOPLE, file_of, read_table, uniform, write_table
from bench.values.result import FAILED, Failure, Result

if TYPE_CHECKING:
    from mlflow.entities import Run, RunInfo

TABLES = (
    "predictions",
    "trials",
    "tables",
)  # fields of a fold that are stored as tables; the others as text
FOLDS = "folds"  # folder of a run with its folds, until they are its tables
GRIDS = "touchbench.grids"  # tag: digests of the files of grids that name the run; its key does not cover them


def tags_of(plan: Plan) -> dict[str, str]:
    """Tags that identify a run's data and system in tables."""
    cell, corpus = plan.cell, plan.corpus
    conditions = ",".join(contract.conditions(cell.untrained))
    given = {
        "touchbench.conditions": conditions,
        "touchbench.changes": str(corpus.info.get("changes", "")),
    }
    return {name: text for name, text in given.items() if text} | {
        "data": cell.data,
        "synthetic": str(corpus.synthetic).lower(),
        "subset": cell.where or "all",
        "target": cell.target,
        "features": ", ".join(cell.feature_sets()) or "raw frames",
        "model": str(cell.model),
        "system": cell.system(),
        "seed": "none" if cell.seed is None else str(cell.seed),
    }


def params_of(plan: Plan) -> dict[str, str]:
    """Every parameter that a run depends on, and the versions; of the protocol, if there is one."""
    cell = plan.cell
    params: dict[str, object] = {
        "data": cell.data,
        "where": cell.where or "all",
        "target": cell.target,
    }
    params |= {"corpus_digest": plan.corpus.digest} | {
        f"data.{k}": v for k, v in cell.data_parameters.items()
    }
    for name, part in (("features", cell.features), ("model", cell.model)):
        if part:
            params |= {name: part.name} | {f"{name}.{k}": v for k, v in part.parameters.items()}
        if part and part.module:
            content = Path(part.name.rpartition(":")[0]).read_bytes()
            params[f"{name}_file"] = hashlib.sha256(content).hexdigest()
    params |= {f"tuning.{k}": v for k, v in (cell.tuning or {}).items()}
    params |= {"threads": plan.threads, "git": git_revision()}
    params |= {f"version.{k}": v for k, v in versions(cell.model.packages()).items()}
    if plan.folds:
        split = cell.protocol.parameters | cell.protocol.changed()
        params |= {"protocol": cell.protocol.name} | {f"protocol.{k}": v for k, v in split.items()}
    for one in cell.producers:
        params |= one.params()
    return {name: str(value) for name, value in params.items()}


@dataclass(eq=False)
class TrackedRun:
    """The run of a plan in the store."""

    store: Store
    plan: Plan
    made: RunInfo  # what the store knows of the run
    params: dict[str, str]
    tags: dict[str, str]
    done: dict[str, FoldResult] = field(
        default_factory=dict
    )  # finished folds by name, as they were stored
    errors: dict[str, Failure] = field(
        default_factory=dict
    )  # by fold that failed, or circumstances in it, in words
    reasons: dict[str, str] = field(default_factory=dict)  # the same by fold name, in a line

    @property
    def missing(self) -> list[Fold]:
        """Folds that were neither stored before nor done by now, in the order of the protocol."""
        return [
            fold
            for fold in self.plan.folds
            if fold.name not in self.done and fold.name not in self.errors
        ]

    def add(self, result: FoldResult) -> None:
        """Store one fold, whole or not at all."""
        if result.machine and "cpu" not in self.params:
            self.params |= result.machine._asdict()
            self.store.log(self.made.run_id, params=result.machine._asdict())
        place = [fold.name for fold in self.plan.folds].index(result.name)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{place}.txt"
            if result.error or result.failed:
                path.write_text(result.error or "\n".join(result.failed.values()), encoding="utf-8")
                self.store.keep(self.made.artifact_uri, path, FOLDS)
                name = ", ".join([result.name, *(f"{key}=" for key in result.failed)])
                self.reasons[result.name] = result.reason
                where = self.store.where(self.made.artifact_uri, f"{FOLDS}/{path.name}")
                self.errors[name] = Failure(result.reason, where)
            if result.error:
                return
            result = _uniform(result)
            _write(result, path.with_suffix(".zip"))
            scored = set(result.scored) - set(costs([result]))
            numbers = {
                OF_FOLDS + name: result.scored[name] for name in result.scored if name in scored
            }
            self.store.log(self.made.run_id, numbers, step=place)
            self.store.keep(self.made.artifact_uri, path.with_suffix(".zip"), FOLDS)
        self.done[result.name] = result

    def close(self) -> Result:
        """Measure the run from its folds, and end it; the result reads its tables from the store."""
        run_id, artifacts, folds = self.made.run_id, self.made.artifact_uri, self.plan.folds
        results = [self.done[fold.name] for fold in folds if fold.name in self.done]
        self.tags |= _batch_effects(results) | self._machines()
        if failed := dict.fromkeys(key for r in results for key in r.failed):
            self.tags[FAILED] = ", ".join(failed)
        status = "FINISHED" if len(results) == len(folds) else "FAILED"
        about = about_of(self.made, self.params, self.tags) | {"status": status}
        result = run_of(self.plan, about, results) if results else Result(about, {}, {})
        added = {name: text for name, text in result.about.items() if name not in about}
        tables = dict(result.tables) | _choices(results) | {FOLDS: self._table()}
        numbers = result.metrics | {
            "folds": len(results),
            "folds_failed": len(folds) - len(results),
        }
        self.store.log(run_id, numbers, tags=added | self.tags)
        with tempfile.TemporaryDirectory() as folder:
            for name, table in tables.items():
                write_table(table, Path(folder) / file_of(name))
                if name in FOR_PEOPLE:
                    table.to_csv(Path(folder) / f"{name}.csv", index=False)
            self.store.keep(artifacts, Path(folder))
        self.store.mark(run_id, status)
        if status == "FINISHED" and not failed:
            self.store.drop(artifacts, FOLDS)
        return Result(
            result.about,
            numbers,
            self.store.tables(run_id, artifacts, result.system, [*tables]),
            self.errors,
        )

    def _machines(self) -> dict[str, str]:
        """Tags that say so where the folds are of several machines; they hide the parameters of these names."""
        several = {result.machine for result in self.done.values() if result.machine}
        if all(machine._asdict().items() <= self.params.items() for machine in several):
            return {}
        return {
            name: "; ".join(sorted({getattr(m, name) for m in several})) for name in Machine._fields
        }

    def _table(self) -> pd.DataFrame:
        """A row for each fold: whether it went well, its seconds and numbers, its machine, or why it failed."""
        rows: list[dict[str, object]] = []
        for fold in self.plan.folds:
            well = fold.name in self.done and fold.name not in self.reasons
            row: dict[str, object] = {"fold": fold.name, "status": "FINISHED" if well else "FAILED"}
            if result := self.done.get(fold.name):
                row |= {"seconds": result.seconds} | result.scored
                row |= result.machine._asdict() if result.machine else {}
            rows.append(row | {"error": self.reasons.get(fold.name, "")})
        return uniform(pd.DataFrame(rows))


def is_whole(run: Run) -> bool:
    """Whether a run is stored with all that was asked of it."""
    return run.info.status == "FINISHED" and not run.data.tags.get(FAILED)


def finished(store: Store, run: Run) -> dict[str, FoldResult]:
    """The finished folds of a run that is not whole, by name."""
    run_id, artifacts, done = run.info.run_id, run.info.artifact_uri, {}
    for name in store.names(run_id, artifacts, FOLDS):
        path = store.path(run_id, artifacts, f"{FOLDS}/{name}")
        result = _read(path) if path and path.suffix == ".zip" else None
        if result and not result.failed:
            done[result.name] = result
    return done


def whole(store: Store, run: Run, grid: str = "") -> Result:
    """The result of a run that is stored whole."""
    if grid:
        store.log(run.info.run_id, tags=_grids(run, grid))
    return store.result(run)


def tracked(store: Store, plan: Plan, run: Run | None, grid: str = "") -> TrackedRun:
    """The run of a plan with the folds that it has, which goes on from there; a new one if there is none."""
    cell = plan.cell
    tags = (
        tags_of(plan) | plan.facts | {"protocol": str(cell.protocol), "protocol_label": plan.label}
    )
    tags |= {
        "touchbench.kind": cell.kind,
        "touchbench.cell": plan.key,
        "touchbench.command": cell.command,
    }
    if not cell.objects:  # an object cannot be typed
        tags["touchbench.arguments"] = json.dumps(cell.arguments())
    tags |= _grids(run, grid) if grid else {}
    if run and not run.data.params:
        store.delete(run.info.run_id)  # cut off while it was made
        run = None
    if run is None:
        params = params_of(plan)
        made = store.create(_name(cell), {"mlflow.source.name": "bench"} | tags, params).info
        return TrackedRun(store, plan, made, params, tags)
    tags |= {FAILED: ""} if FAILED in run.data.tags else {}
    store.mark(run.info.run_id, "RUNNING")
    return TrackedRun(store, plan, run.info, dict(run.data.params), tags, finished(store, run))


def _grids(run: Run | None, grid: str) -> dict[str, str]:
    """The tag with the digests of the files that name a run, one of which is new."""
    known = run.data.tags.get(GRIDS, "").split(", ") if run else []
    return {GRIDS: ", ".join(dict.fromkeys([*filter(None, known), grid]))}


def _name(cell: Cell) -> str:
    """What a run is called on MLflow's page: its command and title, and what else may tell it from its neighbours."""
    words = [
        f"{cell.command} {cell.title()}",
        cell.where,
        cell.target if cell.target != "gesture" else "",
    ]
    words += [f"{key}={value}" for one in cell.producers for key, value in one.arguments().items()]
    return " | ".join(filter(None, [*words, "" if cell.seed is None else f"seed {cell.seed}"]))


def _uniform(result: FoldResult) -> FoldResult:
    """A fold as it is read back."""
    return replace(
        result,
        predictions=uniform(result.table),
        tables={name: uniform(table) for name, table in result.tables.items()},
        trials=None if result.trials is None else uniform(result.trials),
        chosen={str(name): _plain(value) for name, value in result.chosen.items()},
    )


def _write(result: FoldResult, path: Path) -> None:
    """Write a finished fold as a file."""
    about = {
        each.name: getattr(result, each.name) for each in fields(result) if each.name not in TABLES
    }
    tables = {"predictions": result.table} | {
        f"tables/{name}": table for name, table in result.tables.items()
    }
    if result.trials is not None:  # a system may tell what it chose and not among what
        tables["trials"] = result.trials
    with ZipFile(path, "w") as file:
        file.writestr("fold.json", json.dumps(about | {"tables": [*tables]}, default=_plain))
        for name, table in tables.items():
            write_table(table, buffer := BytesIO())
            file.writestr(file_of(name), buffer.getvalue())


def _read(path: Path) -> FoldResult | None:
    """A finished fold; None of a file that was cut off or is damaged."""
    try:
        with ZipFile(path) as file:
            about = json.loads(file.read("fold.json"))
            read = {
                name: read_table(BytesIO(file.read(file_of(name))), name)
                for name in about["tables"]
            }
            about["machine"] = Machine(*about["machine"]) if about["machine"] else None
    except (BadZipFile, zlib.error, KeyError, ValueError, OSError, InputError):
        return None
    about |= {name: read.pop(name, None) for name in ("predictions", "trials")}
    return FoldResult(
        **about | {"tables": {name.removeprefix("tables/"): table for name, table in read.items()}}
    )


def _plain(value: object) -> object:
    """A value as JSON gives it back: a text, a number, a truth or None; anything else as it is printed."""
    if isinstance(value, np.generic):
        value = value.item()
    return value if value is None or type(value) in (str, int, float, bool) else str(value)


def _batch_effects(results: list[FoldResult]) -> dict[str, str]:
    """Tags that say whether predictions depend on the captures predicted together, and on which capture it showed."""
    effects = [f"fold {r.name}: {r.batch_effects[0]}" for r in results if r.batch_effects]
    why = {"touchbench.batch_effect": effects[0]} if effects else {}
    return {"touchbench.depends_on_batch": str(bool(effects)).lower()} | why


def _choices(results: list[FoldResult]) -> dict[str, pd.DataFrame]:
    """What was chosen on each training part, and what among, and numbers by epoch, as far as systems tell."""
    tables: dict[str, pd.DataFrame] = {}
    if any(r.chosen for r in results):
        tables["chosen"] = uniform(
            pd.DataFrame([{"fold": r.name} | r.chosen for r in results], dtype=object)
        )
    if trials := [r.trials.assign(fold=r.name) for r in results if r.trials is not None]:
        tables["trials"] = uniform(pd.concat(trials, ignore_index=True))
    if rows := [
        {"fold": r.name, "epoch": i} | row for r in results for i, row in enumerate(r.history, 1)
    ]:
        tables["history"] = pd.DataFrame(rows)
    return tables
