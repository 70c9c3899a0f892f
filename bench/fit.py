"""The commands ``bench fit`` and ``bench predict``: the system that is shipped, and labels from it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from threadpoolctl import threadpool_limits

from bench.cells import cells, parse
from bench.corpora.table import read_unlabelled
from bench.corpus import InputError
from bench.fold import FoldResult, fitted, footprint, forget_peak, latency, torch_threads
from bench.registry import nearest
from bench.run import corpus_of, fill_cache
from bench.runner import usable_cores

FIT_KEYS = {"data", "where", "target", "features", "model", "seed", "out"}
EXAMPLE_FRAMES = 3


def fit(arguments: list[str]) -> int:
    """Train one system on all captures and save it.

    Raises:
        InputError: something in the arguments or the data cannot be used.
    """
    values = parse(arguments, FIT_KEYS)
    out = Path(values.pop("out")) if "out" in values else None
    asked = cells(values)
    if len(asked) > 1:
        raise InputError("bench fit saves one system; give one value of each key")
    (cell,) = asked
    if out is not None and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"out={out}: there is something already; name a folder that is new or empty")
    estimator = cell.estimator()
    for part in (estimator, *cell.feature_sets().values()):
        if hasattr(part, "check"):
            part.check()
    corpus = corpus_of(cell)
    if len(set(corpus.gestures)) < 2:
        raise InputError(f"data={cell.data} where={cell.where!r}: only one {corpus.target} is left to learn")
    if hasattr(estimator, "check_training"):
        estimator.check_training(corpus, corpus.gestures)
    from bench.tracking import EXPERIMENT, connect, costs, log_setup, tags_of

    client = connect()
    threads = usable_cores()
    forget_peak()
    fill_cache(cell, corpus)
    with threadpool_limits(threads):
        torch_threads(threads)
        metrics = fitted(estimator, corpus)
    with threadpool_limits(1):
        torch_threads(1)
        spent = latency(estimator, corpus, int(corpus.lengths.max()))[:2]
    metrics = costs([FoldResult("", None, metrics | footprint(estimator, corpus), *spent)])

    import mlflow

    from bench.saved import Recogniser, quiet

    recogniser = Recogniser(estimator, corpus)
    plugins = [part.name for part in (cell.model, cell.features) if part]
    model = recogniser.model(plugins, corpus[0][:EXAMPLE_FRAMES])
    title = f"{cell.system()} | {cell.data} | all captures"
    key = hashlib.sha256(f"{cell.key(corpus, threads)} fit".encode()).hexdigest()[:20]
    tags = tags_of(cell, corpus) | {"touchbench.kind": "fit", "touchbench.cell": key, "mlflow.runName": title}
    experiment = client.get_experiment_by_name(EXPERIMENT).experiment_id
    run_id = client.create_run(experiment, run_name=title, tags=tags).info.run_id
    try:
        log_setup(client, run_id, cell, corpus, threads, {"captures": len(corpus)}, "training")
        for name, value in metrics.items():
            client.log_metric(run_id, name, float(value))
        with quiet():
            with mlflow.start_run(run_id=run_id):
                saved = mlflow.pyfunc.log_model(name="model", **model)
            if out is not None:
                mlflow.pyfunc.save_model(str(out), **model)
    except OSError as e:
        raise InputError(f"the model cannot be written ({e}); choose another folder") from e
    kind = "synthetic " if corpus.synthetic else ""
    print(f"{saved.model_uri}  {cell.system()}, {len(corpus)} {kind}captures of {cell.data}, run runs:/{run_id}/model")
    if out is not None:
        print(out)
    return 0


def predict(arguments: list[str]) -> int:
    """Label the captures of a file.

    Raises:
        InputError: something in the arguments or the file cannot be used.
    """
    match arguments:
        case [model, path, *options] if "=" not in path:
            pass
        case _:
            raise InputError("give a model and a file: bench predict MODEL FILE; see bench predict --help")
    values = {}
    for option in options:
        name, _, value = option.partition("=")
        if name not in ("out", "rate_hz") or not value:
            raise InputError(f"{option!r}: no such option; {nearest(name, ['out', 'rate_hz'])}")
        if name in values:
            raise InputError(f"{name}= is given twice; give it once")
        values[name] = value
    from bench.saved import load
    from bench.stream import number

    rate = number("rate_hz", values["rate_hz"]) if "rate_hz" in values else None
    recogniser = load(model)
    if rate is not None:
        recogniser.check_rate(rate)
    corpus = read_unlabelled(Path(path), recogniser.rate_hz, recogniser.grid, recogniser.full_scale)
    table = recogniser.label(corpus)
    table.insert(0, "capture", corpus.captures["capture"])
    text = table.to_csv(index=False, float_format="%.6g")
    if "out" not in values:
        print(text, end="")
        return 0
    try:
        Path(values["out"]).write_text(text)
    except OSError as e:
        raise InputError(f"out={values['out']}: cannot be written ({e.strerror}); choose another file") from e
    print(f"{values['out']}: {len(table)} captures labelled")
    return 0
