"""The commands ``bench fit`` and ``bench predict``: the system that is shipped, and labels from it."""

from __future__ import annotations

from pathlib import Path

from bench.corpora.table import read_unlabelled
from bench.errors import InputError, nearest
from bench.plan.arguments import number, parse
from bench.plan.cells import Cell, cells
from bench.scratch import replacing
from reports.sheet import write_sheet

KEYS = {"data", "where", "target", "features", "model", "seed", "out"}
OPTIONS = ("out", "rate_hz")  # of predict


def fit(arguments: list[str]) -> int:
    """Train one system on all captures and save it.

    Raises:
        InputError: something in the arguments or the data cannot be used.
    """
    values = parse(arguments, KEYS)
    out = Path(values.pop("out")) if "out" in values else None
    cell = only_one(cells(values))
    from bench.work.fit import fit as train

    print(train(cell, out))
    if out is not None:
        print(out)
    return 0


def only_one(asked: list[Cell]) -> Cell:
    """The one cell that there must be.

    Raises:
        InputError: there are several.
    """
    if len(asked) > 1:
        raise InputError("bench fit saves one system; give one value of each key")
    return asked[0]


def predict(arguments: list[str]) -> int:
    """Label the captures of a file.

    Raises:
        InputError: something in the arguments or the file cannot be used.
    """
    match arguments:
        case [model, path, *options] if path.partition("=")[0] not in OPTIONS or Path(path).is_file():
            pass
        case _:
            raise InputError("give a model and a file: bench predict MODEL FILE; see bench predict --help")
    values = {}
    for option in options:
        name, _, value = option.partition("=")
        if name not in OPTIONS or not value:
            raise InputError(f"{option!r}: no such option; {nearest(name, OPTIONS)}")
        if name in values:
            raise InputError(f"{name}= is given twice; give it once")
        values[name] = value
    from bench.work.saved import load

    rate = number("rate_hz", values["rate_hz"]) if "rate_hz" in values else None
    recogniser = load(model)
    if rate is not None:
        recogniser.check_rate(rate)
    corpus = read_unlabelled(Path(path), recogniser.rate_hz, recogniser.grid, recogniser.full_scale)
    table = recogniser.label(corpus)
    table.insert(0, "capture", corpus.captures["capture"])
    if "out" not in values:
        print(table.to_csv(index=False, float_format="%.6g"), end="")
        return 0
    try:
        with replacing(Path(values["out"])) as beside:
            write_sheet(table, beside, "%.6g")
    except OSError as e:
        raise InputError(f"out={values['out']}: cannot be written ({e.strerror or e}); choose another file") from e
    print(f"{values['out']}: {len(table)} captures labelled")
    return 0
