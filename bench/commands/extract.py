"""The command ``bench extract``: one table of features with what is known of each capture."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bench import contract
from bench.arguments import parse, typed
from bench.errors import InputError
from bench.plan.cells import cells
from bench.plan.plan import captures_of
from bench.scratch import replacing

KEYS = {"data", "where", "features", "out"}


def extract(arguments: list[str]) -> int:
    """Write the features of all captures as parquet or CSV.

    Raises:
        InputError: something in the arguments cannot be used, or the file cannot be written.
    """
    values = parse(arguments, KEYS)
    if "out" not in values or Path(values["out"]).suffix not in (".parquet", ".csv"):
        raise InputError(f"out={values.get('out', '')}: give a file name that ends in .parquet or .csv")
    out = Path(values.pop("out"))
    asked = cells(values | {"model": "svm"})
    if len(asked) > 1:
        raise InputError("bench extract writes one table; give one value of each key")
    corpus = captures_of(asked[0].data, asked[0].data_parameters, asked[0].where, asked[0].target)
    (features,) = asked[0].feature_sets().values()
    contract.check(features)
    table = features.fit(corpus, corpus.gestures).transform(corpus)
    if both := sorted(set(corpus.captures.columns) & set(table.columns)):
        raise InputError(
            f"{corpus.name} has a column {both[0]!r}, and so have the features; rename it and import again"
        )
    whole = pd.concat([corpus.captures, table], axis=1)
    try:
        with replacing(out) as beside:
            whole.to_parquet(beside, index=False) if out.suffix == ".parquet" else whole.to_csv(beside, index=False)
    except OSError as e:
        raise InputError(f"{out} cannot be written ({e.strerror or e}); choose another out=") from e
    kind = "synthetic " if corpus.synthetic else ""
    print(f"{out}: {len(table)} {kind}captures, {table.shape[1]} features")
    if contract.learns(features):
        print("these features are fitted to all of these captures: whoever is tested on them has been seen")
    on = {k: v for k, v in asked[0].arguments().items() if k.split(".")[0] in ("data", "where", "features", "seed")}
    print(f"next: {typed('run', on | {'model': 'bayes,lda,svm,rf'})}")
    return 0
