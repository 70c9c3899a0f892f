"""Results of `tests.reading.results` in a store, as if their commands had made them."""

import tempfile
from pathlib import Path

from bench.store.tables import table_file, write_table
from tests.reading import results
from tests.reading.results import make_predictions, predictions_with_hits

__all__ = ["keep", "make_predictions", "stressed", "tracked_run", "predictions_with_hits"]

PARAMS = ("corpus_digest", "git", "cpu", "threads", "faults")
# Names of parts are parameters, words with their values tags.
PARTS = {"model_name": "model", "protocol_name": "protocol"}
OF_THE_STORE = ("run_id", "started", "status", "features_name")


def keep(store, result):
    """Store a result; the id of its run."""
    names = (k for k in result.attributes if "." in k and not k.startswith("touchbench."))
    params = {*names, *PARAMS} & {*result.attributes}
    tags = {k: v for k, v in result.attributes.items() if k not in {*params, *PARTS, *OF_THE_STORE}}
    info = store.create_run(result["system"], tags).info
    run, parts = info.run_id, {word: result[name] for name, word in PARTS.items()}
    store.log_values(run, result.metrics, {k: result[k] for k in params} | parts)
    with tempfile.TemporaryDirectory() as folder:
        for name in result.tables:
            write_table(result.tables[name], Path(folder) / table_file(name))
        store.log_artifact(info.artifact_uri, Path(folder))
    store.set_status(run, result["status"])
    return run


def tracked_run(store, system, predictions, failed=0, cost=1.0, **about):
    """Store a run of ``bench run``, or of another kind with such predictions."""
    kind = about.pop("touchbench.kind", "cell")
    return keep(store, results.make_run(system, predictions, failed, cost, kind, **about))


def stressed(store, system, accuracy, losses, more=(), **about):
    """Store a run of ``bench stress``."""
    return keep(store, results.make_stress_run(system, accuracy, losses, more, **about))
