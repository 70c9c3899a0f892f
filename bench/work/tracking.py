"""A plan's run in the store, resumed if it exists, with one child for each fold."""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.machine import Machine
from bench.outcomes.runs import ROOMS, stored_tables
from bench.outcomes.store import Store
from bench.plan.cells import Cell
from bench.plan.plan import Fold, Plan
from bench.result import FAILED, Failure, Result, Tables
from bench.source import git_revision, versions
from bench.tables import AGAIN, FOR_PEOPLE, file_of, read_table, uniform, write_table
from bench.work.evaluation import run_of
from bench.work.results import FoldResult

if TYPE_CHECKING:
    from mlflow.entities import Run


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


class TrackedRun:
    """The parent run of a plan.

    Args:
        store: store of the run.
        plan: plan of the run.
        key: its `key_of`.

    Attributes:
        plan: plan of the run.
        key: key that identifies the run.
        run_id: id of the parent run.
        tags: tags of the run.
        params: parameters of the run.
        finished: True if an earlier command finished it.
        done: finished folds by name, as they were stored.
        errors: failure of each failed fold, by fold name.
        machine: machine of its first fold, named by the run as a whole; None before that.
        places: address of the artifacts of each finished fold, by fold name.
        others: machine of each finished fold that was done elsewhere, by fold name.
    """

    def __init__(self, store: Store, plan: Plan, key: str) -> None:
        self.store, self.plan, self.key = store, plan, key
        cell = plan.cell
        self.tags = tags_of(cell, plan.corpus) | plan.facts
        self.tags |= {"protocol": str(cell.protocol), "protocol_label": plan.label}
        self.tags |= {"touchbench.kind": cell.kind, "touchbench.cell": key}
        self.tags |= {"touchbench.command": cell.command}
        if not cell.has_objects:  # an object cannot be typed
            self.tags["touchbench.arguments"] = json.dumps(cell.arguments())
        stored = store.find(key, cell.kind)
        if stored and stored.info.status != "FINISHED" and not (stored.inputs and stored.inputs.dataset_inputs):
            store.delete(stored.info.run_id)  # cut off while it was made
            stored = None
        self.params: dict[str, str] = dict(stored.data.params) if stored else {}
        self.run_id = stored.info.run_id if stored else self._create(key)
        self.started = stored.info.start_time if stored else int(time.time() * 1000)
        self.finished = stored is not None and stored.info.status == "FINISHED"
        if stored and FAILED in stored.data.tags:
            self.tags[FAILED] = ""
        self.machine = Machine(self.params["cpu"], self.params.get("simd", "")) if "cpu" in self.params else None
        self.done: dict[str, FoldResult] = {}
        self.places: dict[str, str] = {}
        self.others: dict[str, Machine] = {}
        self.errors: dict[str, Failure] = {}
        for child in store.folds(self.run_id) if stored else []:
            if child.info.status == "FINISHED":
                result = self._load(child)
                self.done[result.name] = result
                self.places[result.name] = child.info.artifact_uri
                if "cpu" in child.data.params:
                    self.others[result.name] = Machine(child.data.params["cpu"], child.data.params["simd"])
            else:  # failed, or cut off while it was written: it is run again
                store.delete(child.info.run_id)
        vars(self).pop("_predictions", None)  # the folds have them
        self.finished = self.finished and not self.missing
        if not self.finished:
            store.begin(self.run_id)

    @property
    def missing(self) -> list[Fold]:
        """Folds that were neither stored before nor done by now, in the order of the protocol."""
        return [fold for fold in self.plan.folds if fold.name not in self.done and fold.name not in self.errors]

    @property
    def complete(self) -> bool:
        """True if every fold is stored, or has failed."""
        return not self.missing

    def _create(self, key: str) -> str:
        cell, corpus = self.plan.cell, self.plan.corpus
        kind = "synthetic " if corpus.synthetic else ""
        note = (
            f"{cell.system()} on {kind}corpus {cell.data} ({len(corpus)} captures, {len(set(corpus.subjects))} subjects"
            f"{', ' + cell.where if cell.where else ''}), {self.plan.label}"
        )
        tags = {"mlflow.note.content": note, "mlflow.source.name": "bench"}
        run_id = self.store.create(f"{cell.command} {cell.title()}", tags | self.tags)
        params = params_of(cell, corpus, self.plan.threads) | {"protocol": cell.protocol.name}
        params |= {f"protocol.{k}": v for k, v in (cell.protocol.parameters | cell.protocol.changed()).items()}
        for one in cell.producers:
            params |= one.params()
        self.params = {name: str(value) for name, value in params.items()}
        self.store.log(run_id, params=params)
        log_captures(self.store, run_id, cell, corpus, "evaluation")
        return run_id

    def _load(self, child: Run) -> FoldResult:
        folder = self.store.fetched(child.info.run_id, "fold")
        timing = json.loads((folder / "timing.json").read_text())
        fold = child.data.tags["touchbench.fold"]
        this = f"{self.tags['system']} (run {self.run_id}, fold {fold})"
        find = lambda name: folder / name if (folder / name).exists() else None  # noqa: E731
        tables = Tables({}, lambda name: read_table(find, name, this), f"{this} is missing in the store; {AGAIN}")
        return FoldResult(
            fold,
            self._predictions[fold] if find(file_of("predictions")) is None else tables["predictions"],
            {k: v for k, v in child.data.metrics.items() if k in timing["metrics"]},
            timing["predict_ms"],
            timing["decide_ms"],
            chosen=timing["chosen"],
            trials=tables.get("trials"),
            batch_effects=timing["batch_effects"],
            tables={name: tables[name] for name in timing["tables"]},
            times=timing["times"],
        )

    @cached_property
    def _predictions(self) -> dict[str, pd.DataFrame]:
        """Predictions of the folds of a run that was finished: they are stored once, with the run."""
        tables = stored_tables(self.store, self.run_id, self.store.artifacts(self.run_id), self.tags["system"])
        return {str(fold): rows.reset_index(drop=True) for fold, rows in tables["predictions"].groupby("fold")}

    def add(self, result: FoldResult, machine: Machine | None) -> None:
        """Store one fold: its run is there, complete, or it is not there.

        Args:
            result: result of the fold.
            machine: machine that did it, None if it did not finish.
        """
        if machine and self.machine is None:
            self.machine = machine
            self.params |= machine._asdict()
            self.store.log(self.run_id, params=machine._asdict())
        tags = {
            "mlflow.parentRunId": self.run_id,
            "touchbench.kind": self.plan.cell.fold_kind,
            "touchbench.fold": result.name,
        }
        if not result.error:
            result = replace(
                result,
                predictions=uniform(result.table),
                tables={name: uniform(table) for name, table in result.tables.items()},
                trials=None if result.trials is None else uniform(result.trials),
                chosen={str(name): _plain(value) for name, value in result.chosen.items()},
            )
        params: dict[str, object] = machine._asdict() if machine and machine != self.machine else {}
        metrics: dict[str, float] = {}
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            if result.error:
                (folder / "traceback.txt").write_text(result.error)
            else:
                write_table(result.table, folder / file_of("predictions"))
                for name, table in result.tables.items():
                    write_table(table, folder / file_of(name))
                names = ("predict_ms", "decide_ms", "chosen", "batch_effects", "times")
                timing = {name: getattr(result, name) for name in names}
                timing |= {"metrics": list(result.metrics), "tables": list(result.tables)}
                (folder / "timing.json").write_text(json.dumps(timing, default=_plain))
                params |= {f"chosen.{k}": v for k, v in result.chosen.items()}
                metrics = result.scored
                if result.failed:
                    (folder / "traceback.txt").write_text("\n".join(result.failed.values()))
            if result.trials is not None:  # a system may tell what it chose and not among what
                write_table(result.trials, folder / file_of("trials"))
            status = "FAILED" if result.error or result.failed else "FINISHED"
            history = [] if result.error else result.history
            address = self.store.add(result.name, tags, status, folder, "fold", metrics, params, history)
        if result.error or result.failed:
            name = ", ".join([result.name, *(f"{key}=" for key in result.failed)])
            self.errors[name] = Failure(result.reason, self.store.where(address, "fold/traceback.txt"))
        if result.error:
            return
        self.done[result.name] = result
        self.places[result.name] = address
        if machine and machine != self.machine:
            self.others[result.name] = machine

    def _machines(self) -> dict[str, str]:
        """Tags that say so where the folds are of several machines; they hide the parameters of these names."""
        if self.machine is None or not self.others:
            return {}
        several = (
            {self.machine, *self.others.values()} if len(self.others) < len(self.done) else {*self.others.values()}
        )
        return {name: "; ".join(sorted({getattr(m, name) for m in several})) for name in Machine._fields}

    def results(self) -> list[FoldResult]:
        """The finished folds in the order of the protocol."""
        return [self.done[fold.name] for fold in self.plan.folds if fold.name in self.done]

    def close(self) -> Result:
        """Measure the run from its folds, and end it; the result reads its tables from the store."""
        results, folds = self.results(), len(self.plan.folds)
        self.tags |= _batch_effects(results)
        if failed := dict.fromkeys(key for r in results for key in r.failed):
            self.tags[FAILED] = ", ".join(failed)
        about = self._about("FINISHED" if len(results) == folds else "FAILED")
        result = run_of(self.plan, about, results) if results else Result(about, {}, {})
        added = {name: text for name, text in result.about.items() if name not in about}
        counts = {"folds": len(results), "folds_failed": folds - len(results)}
        tables = {name: result.tables[name] for name in result.tables} | _choices(results)
        result = Result(result.about, result.metrics | counts, tables, self.errors)
        if results and not self.finished:  # else nothing was run, and nothing is written
            self.store.log(self.run_id, result.metrics, tags=added | self.tags | self._machines())
            with tempfile.TemporaryDirectory() as folder:
                for name, table in tables.items():
                    write_table(table, Path(folder) / file_of(name))
                    if name in FOR_PEOPLE:
                        table.to_csv(Path(folder) / f"{name}.csv", index=False)
                self.store.keep(self.run_id, Path(folder))
            once = sum(len(r.table) for r in results) == len(tables.get("predictions", ()))
            if once and result["status"] == "FINISHED":
                for address in self.places.values():
                    self.store.drop(address, f"fold/{file_of('predictions')}")
        lazy = stored_tables(self.store, self.run_id, self.store.artifacts(self.run_id), result.system, [*tables])
        if not self.finished:
            self.store.end(self.run_id, result["status"])
        return Result(result.about, result.metrics, lazy, self.errors)

    def _about(self, status: str) -> dict[str, Any]:
        """What a result of the run is of, as the store has it."""
        about = self.params | self.tags | self._machines()
        about |= {f"{part}_name": self.params.get(part, "") for part in ROOMS}
        return about | {"run_id": self.run_id, "status": status, "started": self.started}

    def interrupt(self) -> None:
        """Mark the run as killed; stored folds stay and are found again."""
        self.store.end(self.run_id, "KILLED")


def _plain(value: object) -> object:
    """A value as JSON gives it back: a text, a number, a truth or None; anything else as it is printed."""
    if isinstance(value, np.generic):
        value = value.item()
    return value if value is None or type(value) in (str, int, float, bool) else str(value)


def _batch_effects(results: list[FoldResult]) -> dict[str, str]:
    """Tags that say whether predictions depend on the captures predicted together, and on which capture it showed."""
    effects = [f"fold {r.name}, {r.batch_effects[0]}" for r in results if r.batch_effects]
    why = {"touchbench.batch_effect": effects[0]} if effects else {}
    return {"touchbench.depends_on_batch": str(bool(effects)).lower()} | why


def _choices(results: list[FoldResult]) -> dict[str, pd.DataFrame]:
    """What was chosen on each training part, and what among, as far as systems tell."""
    tables: dict[str, pd.DataFrame] = {}
    if any(r.chosen for r in results):
        tables["chosen"] = uniform(pd.DataFrame([{"fold": r.name} | r.chosen for r in results], dtype=object))
    if trials := [r.trials.assign(fold=r.name) for r in results if r.trials is not None]:
        tables["trials"] = uniform(pd.concat(trials, ignore_index=True))
    return tables
