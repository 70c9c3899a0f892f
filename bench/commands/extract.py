"""The command ``bench extract``: one table of features with the labels of each capture."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from bench import contract
from bench.arguments import parse, settings
from bench.commands.printing import then, unwritable
from bench.corpora.recordings import as_touches, is_recorded
from bench.errors import InputError
from bench.options import keys
from bench.plan.cells import cells
from bench.plan.plan import captures_of
from bench.scratch import replacing
from bench.words import DEFAULTS, typed


def extract(arguments: list[str]) -> int:
    """Write the features of all captures as parquet or CSV.

    Raises:
        InputError: something in the arguments cannot be used, or the file cannot be written.
    """
    values = parse(arguments, keys("extract"))
    given = settings("extract", values)
    out = Path(given["out"])
    if out.suffix not in (".parquet", ".csv"):
        raise InputError(f"out={out.name}: give a file name that ends in .parquet or .csv")
    cell, *more = cells({k: v for k, v in values.items() if k not in given} | {"model": DEFAULTS["model"]})
    if more:
        raise InputError("bench extract writes one table; give one value of each key")
    corpus = captures_of(cell.data, cell.data_parameters, cell.where, cell.target)
    (features,) = cell.feature_sets().values()
    contract.check(features)
    columns = features.fit(corpus, corpus.gestures).transform(corpus)
    if both := sorted(set(corpus.captures.columns) & set(columns.columns)):
        raise InputError(f"{corpus.name} has a column {both[0]!r}, which is also a feature; rename it and import again")
    if is_recorded(corpus):
        print(as_touches(corpus), file=sys.stderr)
    table = pd.concat([corpus.captures, columns], axis=1)
    with unwritable(out), replacing(out) as beside:
        table.to_parquet(beside, index=False) if out.suffix == ".parquet" else table.to_csv(beside, index=False)
    kind = "synthetic " if corpus.synthetic else ""
    print(f"{out}: {len(columns)} {kind}captures, {columns.shape[1]} features")
    if contract.learns(features):
        print("these features are fitted to all these captures; do not test on any of them")
    shared = {k: v for k, v in cell.arguments().items() if k.split(".")[0] in ("data", "where", "features", "seed")}
    then(typed("run", shared | {"model": "bayes,lda,svm,rf"}))
    return 0
