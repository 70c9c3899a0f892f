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
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile, ZipFile

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.machine import Machine
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan
from bench.result import FAILED, Failure, Result
from bench.source import git_revision, versions
from bench.store import OF_FOLDS, PARTS, Store
from bench.tables import FOR_PEOPLE, file_of, read_table, uniform, write_table
from bench.work.evaluation import run_of
from bench.work.results import FoldResult, costs

if TYPE_CHECKING:
    from mlflow.entities import Run

PLAIN = (
    "name",
    "metrics",
    "predict_ms",
    "decide_ms",
    "history",
    "chosen",
    "batch_effects",
    "failed",
    "times",
    "scored",
)
FOLDS = "folds"  # folder of a run with its folds, until they are its tables


def key_of(plan: Plan) -> str:
    """Key of a run: everything that its stored numbers depend on (docs/notes/decisions.md, identity)."""
    return hashlib.sha256(json.dumps(plan.identity(), sort_keys=True, default=str).encode()).hexdigest()[:20]


def tags_of(cell: Cell, corpus: Corpus) -> dict[str, str]:
    """Tags that identify a run's data and system in tables."""
    conditions = ",".join(contract.conditions(cell.untrained))
    given = {"touchbench.conditions": conditions, "touchbench.changes": str(corpus.info.get("changes", ""))}
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


def params_of(cell: Cell, corpus: Corpus, threads: int) -> dict[str, object]:
    """Every parameter that a run depends on, and the versions."""
    params: dict[str, object] = {"data": cell.data, "where": cell.where or "all", "target": cell.target}
    params |= {"corpus_digest": corpus.digest} | {f"data.{k}": v for k, v in cell.data_parameters.items()}
    for name, part in (("features", cell.features), ("model", cell.model)):
        if part:
            params |= {name: part.name} | {f"{name}.{k}": v for k, v in part.parameters.items()}
        if part and part.module:
            content = Path(part.name.rpartition(":")[0]).read_bytes()
            params[f"{name}_file"] = hashlib.sha256(content).hexdigest()
    params |= {f"tuning.{k}": v for k, v in (cell.tuning or {}).items()}
    params |= {"threads": threads, "git": git_revision()}
    return params | {f"version.{k}": v for k, v in versions(cell.packages()).items()}


def log_captures(store: Store, run_id: str, cell: Cell, corpus: Corpus, context: str) -> None:
    """The captures that a run saw."""
    frames, source = int(corpus.lengths.sum()), corpus.info.get("source", "")
    store.log_captures(run_id, cell.data, corpus.digest, source, len(corpus), frames, context)


@dataclass(eq=False)
class TrackedRun:
    """The run of a plan in the store.

    Attributes:
        store: store of the run.
        plan: plan of the run.
        run_id: id of the run.
        artifacts: address of its artifacts.
        started: when it was made.
        params: parameters of the run.
        tags: tags of the run.
        whole: the result of a run that an earlier command finished.
        machine: machine of its first fold, named by the run as a whole; None before that.
        done: finished folds by name, as they were stored.
        machines: machine of each finished fold, by fold name.
        errors: failure of each fold that failed, as a whole or in a circumstance, by both in words.
        reasons: the same by fold name, in a line.
    """

    store: Store
    plan: Plan
    run_id: str
    artifacts: str
    started: int
    params: dict[str, str]
    tags: dict[str, str]
    whole: Result | None = None
    machine: Machine | None = None
    done: dict[str, FoldResult] = field(default_factory=dict)
    machines: dict[str, Machine] = field(default_factory=dict)
    errors: dict[str, Failure] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)

    @property
    def missing(self) -> list[Fold]:
        """Folds that were neither stored before nor done by now, in the order of the protocol."""
        if self.whole:
            return []
        return [fold for fold in self.plan.folds if fold.name not in self.done and fold.name not in self.errors]

    @property
    def stored(self) -> int:
        """The number of finished folds."""
        return len(self.plan.folds) if self.whole else len(self.done)

    def add(self, result: FoldResult, machine: Machine | None) -> None:
        """Store one fold, whole or not at all.

        Args:
            result: result of the fold.
            machine: machine that did it, None if it did not finish.
        """
        if machine and self.machine is None:
            self.machine = machine
            self.params |= machine._asdict()
            self.store.log(self.run_id, params=machine._asdict())
        place = [fold.name for fold in self.plan.folds].index(result.name)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{place}.txt"
            if result.error or result.failed:
                path.write_text(result.error or "\n".join(result.failed.values()), encoding="utf-8")
                self.store.keep(self.run_id, path, FOLDS)
                name = ", ".join([result.name, *(f"{key}=" for key in result.failed)])
                self.reasons[result.name] = result.reason
                self.errors[name] = Failure(result.reason, self.store.where(self.artifacts, f"{FOLDS}/{path.name}"))
            if result.error:
                return
            result = _uniform(result)
            _write(result, machine, path.with_suffix(".zip"))
            scored = set(result.scored) - set(costs([result]))
            numbers = {OF_FOLDS + name: result.scored[name] for name in result.scored if name in scored}
            self.store.log(self.run_id, numbers, step=place)
            self.store.keep(self.run_id, path.with_suffix(".zip"), FOLDS)
        self.done[result.name] = result
        if machine:
            self.machines[result.name] = machine

    def results(self) -> list[FoldResult]:
        """The finished folds in the order of the protocol."""
        return [self.done[fold.name] for fold in self.plan.folds if fold.name in self.done]

    def close(self) -> Result:
        """Measure the run from its folds, and end it; the result reads its tables from the store."""
        if self.whole:
            return self.whole
        results, folds = self.results(), len(self.plan.folds)
        self.tags |= _batch_effects(results)
        if failed := dict.fromkeys(key for r in results for key in r.failed):
            self.tags[FAILED] = ", ".join(failed)
        status = "FINISHED" if len(results) == folds else "FAILED"
        about = self._about(status)
        result = run_of(self.plan, about, results) if results else Result(about, {}, {})
        added = {name: text for name, text in result.about.items() if name not in about}
        tables = {name: result.tables[name] for name in result.tables} | _choices(results) | {FOLDS: self._table()}
        numbers = result.metrics | {"folds": len(results), "folds_failed": folds - len(results)}
        self.store.log(self.run_id, numbers, tags=added | self.tags | self._machines())
        with tempfile.TemporaryDirectory() as folder:
            for name, table in tables.items():
                write_table(table, Path(folder) / file_of(name))
                if name in FOR_PEOPLE:
                    table.to_csv(Path(folder) / f"{name}.csv", index=False)
            self.store.keep(self.run_id, Path(folder))
        self.store.end(self.run_id, status)
        if status == "FINISHED" and not failed:
            self.store.drop(self.artifacts, FOLDS)
        lazy = self.store.tables(self.run_id, self.artifacts, result.system, [*tables])
        return Result(result.about, numbers, lazy, self.errors)

    def interrupt(self) -> None:
        """Mark the run as killed; stored folds stay and are found again."""
        self.store.end(self.run_id, "KILLED")

    def _about(self, status: str) -> dict[str, Any]:
        """What a result of the run is of, as the store has it."""
        about = self.params | self.tags | self._machines()
        about |= {f"{part}_name": self.params.get(part, "") for part in PARTS}
        return about | {"run_id": self.run_id, "status": status, "started": self.started, "artifacts": self.artifacts}

    def _machines(self) -> dict[str, str]:
        """Tags that say so where the folds are of several machines; they hide the parameters of these names."""
        several = {*self.machines.values()}
        if self.machine is None or several <= {self.machine}:
            return {}
        return {name: "; ".join(sorted({getattr(m, name) for m in several})) for name in Machine._fields}

    def _table(self) -> pd.DataFrame:
        """A row for each fold: whether it went well, its seconds and numbers, its machine, or why it failed."""
        rows: list[dict[str, object]] = []
        for fold in self.plan.folds:
            well = fold.name in self.done and fold.name not in self.reasons
            row: dict[str, object] = {"fold": fold.name, "status": "FINISHED" if well else "FAILED"}
            if result := self.done.get(fold.name):
                row |= {"seconds": result.seconds} | result.scored
                row |= self.machines[fold.name]._asdict() if fold.name in self.machines else {}
            rows.append(row | {"error": self.reasons.get(fold.name, "")})
        return uniform(pd.DataFrame(rows))


def tracked(store: Store, plan: Plan, key: str) -> TrackedRun:
    """The run of a key with the folds that it has, which goes on from there; a new one if there is none.

    Args:
        store: store of the run.
        plan: plan of the run.
        key: its `key_of`.
    """
    cell = plan.cell
    tags = tags_of(cell, plan.corpus) | plan.facts
    tags |= {"protocol": str(cell.protocol), "protocol_label": plan.label}
    tags |= {"touchbench.kind": cell.kind, "touchbench.cell": key}
    tags |= {"touchbench.command": cell.command}
    if not cell.has_objects:  # an object cannot be typed
        tags["touchbench.arguments"] = json.dumps(cell.arguments())
    run = store.find(key, cell.kind)
    if run and not (run.inputs and run.inputs.dataset_inputs):
        store.delete(run.info.run_id)  # cut off while it was made
        run = None
    params = dict(run.data.params) if run else _params(plan)
    made = run or _created(store, plan, tags, params)
    found = TrackedRun(store, plan, made.info.run_id, made.info.artifact_uri, made.info.start_time, params, tags)
    if "cpu" in params:
        found.machine = Machine(params["cpu"], params.get("simd", ""))
    files = store.names(found.run_id, found.artifacts, FOLDS) if run else []
    if run and run.info.status == "FINISHED" and not run.data.tags.get(FAILED):
        found.whole = store.result(run)
        if files:  # its command was cut off at the very end
            store.drop(found.artifacts, FOLDS)
        return found
    if run:
        tags |= {FAILED: ""} if FAILED in run.data.tags else {}
        for name in files:
            path = store.path(found.run_id, found.artifacts, f"{FOLDS}/{name}")
            result, machine = _read(path) if path and path.suffix == ".zip" else (None, None)
            if result and not result.failed:
                found.done[result.name] = result
                found.machines |= {result.name: machine} if machine else {}
    if found.missing:
        store.begin(found.run_id)
    return found


def _params(plan: Plan) -> dict[str, str]:
    """Parameters of a new run."""
    protocol = plan.cell.protocol
    params = params_of(plan.cell, plan.corpus, plan.threads) | {"protocol": protocol.name}
    params |= {f"protocol.{k}": v for k, v in (protocol.parameters | protocol.changed()).items()}
    for one in plan.cell.producers:
        params |= one.params()
    return {name: str(value) for name, value in params.items()}


def _created(store: Store, plan: Plan, tags: dict[str, str], params: dict[str, str]) -> Run:
    """A new run; its captures come last, and tell that it has all the rest."""
    cell, corpus = plan.cell, plan.corpus
    kind = "synthetic " if corpus.synthetic else ""
    note = (
        f"{cell.system()} on {kind}corpus {cell.data} ({len(corpus)} captures, {len(set(corpus.subjects))} subjects"
        f"{', ' + cell.where if cell.where else ''}), {plan.label}"
    )
    about = {"mlflow.note.content": note, "mlflow.source.name": "bench"}
    run = store.create(f"{cell.command} {cell.title()}", about | tags, params)
    log_captures(store, run.info.run_id, cell, corpus, "evaluation")
    return run


def _uniform(result: FoldResult) -> FoldResult:
    """A fold as it is read back."""
    return replace(
        result,
        predictions=uniform(result.table),
        tables={name: uniform(table) for name, table in result.tables.items()},
        trials=None if result.trials is None else uniform(result.trials),
        chosen={str(name): _plain(value) for name, value in result.chosen.items()},
    )


def _write(result: FoldResult, machine: Machine | None, path: Path) -> None:
    """Write a finished fold as a file."""
    about = {name: getattr(result, name) for name in (*PLAIN, "seconds")}
    about |= {"machine": machine, "tables": [*result.tables]}
    tables = {"predictions": result.table} | {f"tables/{name}": table for name, table in result.tables.items()}
    if result.trials is not None:  # a system may tell what it chose and not among what
        tables["trials"] = result.trials
    with ZipFile(path, "w") as file:
        file.writestr("fold.json", json.dumps(about, default=_plain))
        for name, table in tables.items():
            write_table(table, buffer := BytesIO())
            file.writestr(file_of(name), buffer.getvalue())


def _read(path: Path) -> tuple[FoldResult | None, Machine | None]:
    """A finished fold and its machine; None of a file that was cut off or is damaged."""

    def table(name: str) -> pd.DataFrame:
        return read_table(BytesIO(file.read(file_of(name))), name)

    try:
        with ZipFile(path) as file:
            about = json.loads(file.read("fold.json"))
            machine, names = about.pop("machine"), about.pop("tables")
            trials = table("trials") if file_of("trials") in file.namelist() else None
            result = FoldResult(
                **about,
                predictions=table("predictions"),
                trials=trials,
                tables={name: table(f"tables/{name}") for name in names},
            )
            return result, Machine(*machine) if machine else None
    except (BadZipFile, zlib.error, KeyError, ValueError, OSError, InputError):
        return None, None


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
        tables["chosen"] = uniform(pd.DataFrame([{"fold": r.name} | r.chosen for r in results], dtype=object))
    if trials := [r.trials.assign(fold=r.name) for r in results if r.trials is not None]:
        tables["trials"] = uniform(pd.concat(trials, ignore_index=True))
    if rows := [{"fold": r.name, "epoch": i} | row for r in results for i, row in enumerate(r.history, 1)]:
        tables["history"] = pd.DataFrame(rows)
    return tables
