"""Runs in MLflow: a parent run per cell, a child run per fold. Only the main process comes here.

Tags, by which runs are found again: ``touchbench.kind`` (``cell`` or ``fold``, ``stream`` or ``stream_fold``,
``stress`` or ``stress_fold``, ``fit``),
``touchbench.cell`` (the key of the cell), ``touchbench.fold``, and for the tables ``data``, ``synthetic``, ``subset``,
``protocol``, ``protocol_label``, ``features``, ``model``, ``system``, ``seed``.
"""

from __future__ import annotations

import json
import logging
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlparse

import numpy as np
import pandas as pd
from filelock import FileLock, Timeout

from bench import scores
from bench.cells import Cell
from bench.corpus import Corpus, InputError, home
from bench.fold import FoldResult
from bench.machine import cpu_model, simd
from bench.source import git_revision, versions

EXPERIMENT = "touchbench"


def store_uri() -> str:
    """Where runs are kept: ``MLFLOW_TRACKING_URI``, or MLflow's SQLite file in the working folder."""
    return os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{Path.cwd() / 'mlflow.db'}"


def connect() -> object:
    """An `MlflowClient` on the store, which is created if it is not there.

    Raises:
        InputError: the store cannot be written or reached.
    """
    uri = store_uri()
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
    path = Path(urlparse(uri).path.removeprefix("/")) if uri.startswith("sqlite:///") else None
    if path is not None:
        _check_writable(path)
    import mlflow
    from mlflow.exceptions import MlflowException

    # Several processes that create the tables at the same moment break the file for good.
    with FileLock(path.with_name(path.name + ".lock") if path else lock_folder() / "tracking.lock"):
        logging.getLogger("mlflow.store.db").setLevel(logging.WARNING)  # creating its tables is no news
        try:
            mlflow.set_tracking_uri(uri)
            client = mlflow.MlflowClient(uri)
            if client.get_experiment_by_name(EXPERIMENT) is None:
                client.create_experiment(EXPERIMENT)
        except MlflowException as e:
            raise InputError(f"MLflow store {uri} cannot be used: {str(e).splitlines()[0]}") from e
    return client


def _check_writable(path: Path) -> None:
    """SQLite would be tried for minutes before it gave up."""
    try:
        if path.exists():
            with path.open("r+b") as f:
                head = f.read(16)
            if head and head != b"SQLite format 3\0":
                raise InputError(f"{path} is not an MLflow store; move it away or set MLFLOW_TRACKING_URI")
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as e:
        raise InputError(
            f"the MLflow store {path} cannot be written ({e}); change the folder or set MLFLOW_TRACKING_URI"
        ) from e


def find_cell(client: object, key: str, kind: str = "cell") -> object | None:
    """The parent run of a cell, None where there is none."""
    found = runs_of(client, f"tags.`touchbench.cell` = '{key}' and tags.`touchbench.kind` = '{kind}'")
    return found[0] if found else None


def runs_of(client: object, asked: str) -> list:
    """Every run of the experiment that MLflow's filter lets through, newest first; none where nothing was tracked."""
    experiment = client.get_experiment_by_name(EXPERIMENT)
    found, token = [], None
    while experiment:  # MLflow gives them in pages
        page = client.search_runs([experiment.experiment_id], asked, max_results=1000, page_token=token)
        found += page
        if not (token := page.token):
            break
    return found


def folds_of(client: object, run_id: str) -> list:
    """The child runs of a run, newest first."""
    return runs_of(client, f"tags.`mlflow.parentRunId` = '{run_id}'")


class CellRun:
    """The parent run of a cell, found again if it was begun before.

    Other commands that run the folds of a cell have their own kinds of run and their own scores.

    Attributes:
        run_id: of the parent run.
        finished: whether an earlier command finished it.
        done: finished folds by name, as they were stored.
    """

    kind = "cell"
    fold_kind = "fold"
    options: dict[str, object] = {}  # of the command, tracked as parameters

    def __init__(self, client: object, cell: Cell, corpus: Corpus, key: str, label: str, threads: int) -> None:
        self.client = client
        self.experiment = client.get_experiment_by_name(EXPERIMENT).experiment_id
        self.rate_hz = corpus.rate_hz
        self.tags = tags_of(cell, corpus) | {"protocol_label": label}
        found = find_cell(client, key, self.kind)
        self.run_id = found.info.run_id if found else self._create(cell, corpus, key, label, threads)
        self.finished = bool(found) and found.info.status == "FINISHED"
        self.done: dict[str, FoldResult] = {}
        for child in folds_of(client, self.run_id) if found else []:
            if child.info.status == "FINISHED":
                self.done[child.data.tags["touchbench.fold"]] = self._load(child)
            else:  # failed, or cut off while it was written: it is run again
                client.delete_run(child.info.run_id)
        if not self.finished:
            client.update_run(self.run_id, status="RUNNING")

    def _create(self, cell: Cell, corpus: Corpus, key: str, label: str, threads: int) -> str:
        kind = "synthetic " if corpus.synthetic else ""
        title = f"{cell.system()} | {cell.data} | {cell.protocol}"
        about = (
            f"{cell.system()} on {kind}corpus {cell.data} ({len(corpus)} captures, {len(set(corpus.subjects))} subjects"
            f"{', ' + cell.where if cell.where else ''}), {label}"
        )
        tags = {
            "mlflow.runName": title,
            "mlflow.note.content": about,
            "mlflow.source.name": "bench",
            "touchbench.kind": self.kind,
            "touchbench.cell": key,
            "protocol": str(cell.protocol),
        }
        run = self.client.create_run(self.experiment, run_name=title, tags=tags | self.tags)
        protocol = {"protocol": cell.protocol.name}
        protocol |= {f"protocol.{k}": v for k, v in cell.protocol.parameters.items()}
        log_setup(self.client, run.info.run_id, cell, corpus, threads, protocol | self.options, "evaluation")
        return run.info.run_id

    def _load(self, child: object) -> FoldResult:
        folder = Path(self.client.download_artifacts(child.info.run_id, "fold"))
        timing = json.loads((folder / "timing.json").read_text())
        metrics = {k: v for k, v in child.data.metrics.items() if k in timing["metrics"]}
        return FoldResult(
            child.data.tags["touchbench.fold"],
            pd.read_parquet(folder / "predictions.parquet"),
            metrics,
            timing["predict_ms"],
            timing["decide_ms"],
            chosen=timing["chosen"],
            trials=pd.read_csv(folder / "trials.csv") if timing["chosen"] else None,
        )

    def add(self, result: FoldResult) -> None:
        """Store one fold: its run is there, complete, or it is not there."""
        from mlflow.entities import Param

        tags = {
            "mlflow.parentRunId": self.run_id,
            "mlflow.runName": result.name,
            "touchbench.kind": self.fold_kind,
            "touchbench.fold": result.name,
        }
        child = self.client.create_run(self.experiment, run_name=result.name, tags=tags).info.run_id
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) / "fold"
            folder.mkdir()
            if result.error:
                (folder / "traceback.txt").write_text(result.error)
            else:
                result.predictions.to_parquet(folder / "predictions.parquet", index=False)
                timing = {"predict_ms": result.predict_ms, "decide_ms": result.decide_ms, "chosen": result.chosen}
                (folder / "timing.json").write_text(json.dumps(timing | {"metrics": list(result.metrics)}))
                self._log(child, self.fold_metrics(result), result.history)
            if result.chosen:
                result.trials.to_csv(folder / "trials.csv", index=False)
                chosen = [Param(f"chosen.{k}", str(v)) for k, v in result.chosen.items()]
                self.client.log_batch(child, params=chosen)
            self.client.log_artifacts(child, str(folder), "fold")
        self.client.set_terminated(child, "FAILED" if result.error else "FINISHED")
        if not result.error:
            self.done[result.name] = result

    def close(self, order: list[str]) -> dict[str, float]:
        """Score the run from its folds in the order of the protocol and end it.

        Returns:
            The tracked metrics; empty if no fold went well.
        """
        results = [self.done[name] for name in order if name in self.done]
        complete = len(results) == len(order)
        metrics = {}
        if results:
            predictions = pd.concat([r.predictions for r in results], ignore_index=True)
            metrics = self.measure(predictions, results)
            if self.finished:  # nothing was run, nothing is written
                return metrics
            self._log(self.run_id, metrics | {"folds": len(results), "folds_failed": len(order) - len(results)}, [])
            with tempfile.TemporaryDirectory() as folder:
                self.write_tables(predictions, results, Path(folder))
                if any(r.chosen for r in results):
                    _write_choices(results, Path(folder))
                self.client.log_artifacts(self.run_id, folder)
        self.client.set_terminated(self.run_id, "FINISHED" if complete else "FAILED")
        return metrics

    def fold_metrics(self, result: FoldResult) -> dict[str, float]:
        """Scores and costs of one fold."""
        return scores.accuracies(result.predictions) | costs([result])

    def measure(self, predictions: pd.DataFrame, results: list[FoldResult]) -> dict[str, float]:
        """Scores and costs of the whole run."""
        return measure(predictions, results, self.rate_hz)

    def write_tables(self, predictions: pd.DataFrame, results: list[FoldResult], folder: Path) -> None:
        """Write what is kept with the parent run."""
        from reports.details import confusion_figure

        _write_tables(predictions, folder)
        labelled, classes = scores.captures(predictions), scores.classes_of(predictions)
        counts, group = scores.confusion(labelled, classes), ", ".join(context_of(self.tags))
        confusion_figure(counts, method_of(self.tags), group, folder, "confusion")

    def interrupt(self) -> None:
        """Mark the run as killed; what is stored stays and is found again."""
        self.client.set_terminated(self.run_id, "KILLED")

    def _log(self, run_id: str, metrics: dict[str, float], history: list[dict[str, float]]) -> None:
        from mlflow.entities import Metric

        now = int(time.time() * 1000)
        points = [Metric(k, float(v), now, 0) for k, v in metrics.items()]
        points += [Metric(k, float(v), now, step) for step, row in enumerate(history, 1) for k, v in row.items()]
        for i in range(0, len(points), 1000):
            self.client.log_batch(run_id, metrics=points[i : i + 1000])


def tags_of(cell: Cell, corpus: Corpus) -> dict[str, str]:
    """What tables know a run's data and system by."""
    return {
        "data": cell.data,
        "synthetic": str(corpus.synthetic).lower(),
        "subset": cell.where or "all",
        "target": cell.target,
        "features": ", ".join(cell.feature_sets()) or "raw frames",
        "model": str(cell.model),
        "system": cell.system(),
        "seed": str((cell.tuning or cell.model.parameters).get("seed", "none")),
    }


def context_of(tags: dict[str, str]) -> tuple[str, str, str]:
    """What must agree for runs to be compared, in words: data, subset with the target, protocol."""
    data = tags["data"] + (" (synthetic)" if tags["synthetic"] == "true" else "")
    target = f", {tags['target']}" if tags["target"] != "gesture" else ""
    return data, tags["subset"] + target, tags["protocol_label"]


def method_of(tags: dict[str, str]) -> str:
    """System, and its seed where that is not the usual one."""
    return tags["system"] + (f", seed {tags['seed']}" if tags["seed"] not in ("0", "none") else "")


def log_setup(
    client: object,
    run_id: str,
    cell: Cell,
    corpus: Corpus,
    threads: int,
    more: dict[str, object],
    context: str,
) -> None:
    """Log every parameter that a run depends on, and the captures that it saw (``context``: training, evaluation)."""
    from mlflow.entities import Dataset, DatasetInput, InputTag, Param
    from mlflow.exceptions import MlflowException

    params = {"data": cell.data, "where": cell.where or "all", "target": cell.target, "corpus_digest": corpus.digest}
    params |= {f"data.{k}": v for k, v in cell.data_parameters.items()} | more
    for name, part in (("features", cell.features), ("model", cell.model)):
        if part:
            params |= {name: part.name} | {f"{name}.{k}": v for k, v in part.parameters.items()}
    params |= {f"tuning.{k}": v for k, v in (cell.tuning or {}).items()}
    params |= {"threads": threads, "cpu": cpu_model(), "simd": simd(), "git": git_revision()}
    params |= {f"version.{k}": v for k, v in versions(cell.packages()).items()}
    client.log_batch(run_id, params=[Param(k, str(v)) for k, v in params.items()])
    source = json.dumps({"uri": corpus.info.get("source", "")})
    profile = json.dumps({"num_rows": len(corpus), "num_elements": int(corpus.lengths.sum())})
    dataset = Dataset(cell.data, corpus.digest[:36], "local", source, profile=profile)
    inputs = [DatasetInput(dataset, [InputTag("mlflow.data.context", context)])]
    for pause in (0.2, 0.5, 1.0, 2.0, None):
        try:
            client.log_inputs(run_id, inputs)
            break
        except MlflowException:  # another run has made the same dataset at this moment; the next try finds it
            if pause is None:
                raise
            time.sleep(pause)


def measure(predictions: pd.DataFrame, results: list[FoldResult], rate_hz: float) -> dict[str, float]:
    """Scores and costs of a run.

    ``decision_ms`` is the touch that one decision of the system sees (a window, or the whole capture) plus its
    computing time, ``capture_decision_ms`` the same for the label of a whole capture; both are medians.
    """
    found = scores.summary(predictions, rate_hz) | costs(results)
    found["decision_ms"] = found["observed_ms"] + found["decide_ms_p50"]
    found["capture_decision_ms"] = found["capture_ms"] + found["predict_ms_p50"]
    return found


def costs(results: list[FoldResult]) -> dict[str, float]:
    """Seconds are means over folds, milliseconds quantiles over their timed captures, sizes the largest.

    Of the reference workload and of what is told as a multiple of it, the median fold counts.
    """
    metrics = {k: [r.metrics[k] for r in results if k in r.metrics] for k in results[0].metrics}
    kinds = {"seconds": np.mean, "reference_ms": np.median, "predict_relative": np.median}
    found = {k: float(next((f for end, f in kinds.items() if k.endswith(end)), max)(v)) for k, v in metrics.items()}
    predict = np.concatenate([r.predict_ms for r in results])
    decide = np.concatenate([r.decide_ms for r in results])
    found |= {f"predict_ms_p{p}": np.quantile(predict, p / 100) for p in (50, 95, 99)}
    return found | {f"decide_ms_p{p}": np.quantile(decide, p / 100) for p in (50, 95, 99)}


def _write_tables(predictions: pd.DataFrame, folder: Path) -> None:
    classes = scores.classes_of(predictions)
    labelled = scores.captures(predictions)
    predictions.to_parquet(folder / "predictions.parquet", index=False)
    scores.confusion(labelled, classes).to_csv(folder / "confusion.csv")
    scores.per_subject(labelled).to_csv(folder / "per_subject.csv", index=False)
    scores.per_class(labelled, classes).to_csv(folder / "per_class.csv", index=False)


def _write_choices(results: list[FoldResult], folder: Path) -> None:
    """What a search chose in each fold, and every combination it tried there with the front of accuracy and time."""
    pd.DataFrame([{"fold": r.name} | r.chosen for r in results]).to_csv(folder / "chosen.csv", index=False)
    trials = pd.concat([r.trials.assign(fold=r.name) for r in results], ignore_index=True)
    trials.to_csv(folder / "trials.csv", index=False)


@contextmanager
def only_one(key: str) -> Iterator[None]:
    """Hold a cell against a second process that would run the same folds.

    Raises:
        InputError: another process has it.
    """
    try:
        with FileLock(lock_folder() / f"{key}.lock", timeout=0):
            yield
    except Timeout as e:
        raise InputError("another process is running this very cell; wait for it and repeat the command") from e


def lock_folder() -> Path:
    """Where locks lie.

    Raises:
        InputError: the data folder cannot be written.
    """
    folder = home() / "locks"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e}); set TOUCHBENCH_HOME to a folder that can") from e
    return folder
