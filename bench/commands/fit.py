"""The commands ``bench fit``, ``bench predict`` and ``bench adapt``: a system that is shipped, asked, and adapted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bench.arguments import Values, number, options_of, parse, quoted
from bench.commands.printing import then
from bench.corpora.read.table import read_unlabelled
from bench.errors import InputError
from bench.outcomes.stopping import NO_SAVING
from bench.plan.cells import Cell, cells
from bench.scratch import new_folder, replacing
from reports.spreadsheet import write_sheet

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.work.fit import Fitted
    from bench.work.saved import Recogniser

KEYS = {"data", "where", "target", "features", "model", "seed", "stopping", "out"}
OPTIONS = ("out", "rate_hz")  # of predict, and of adapt


def fit(arguments: list[str]) -> int:
    """Train one system on all captures and save it.

    Raises:
        InputError: something in the arguments or the data cannot be used.
    """
    values = parse(arguments, KEYS)
    found, out = trained(values)
    print(found)
    if out is not None:
        print(out)
    stopping = found.recogniser.stopping
    if stopping is not None and not stopping.saves:
        print(f"{NO_SAVING}: the model decides on whole captures")
    place = quoted(found.uri if out is None else str(out))
    then(f"bench predict {place} new.csv", f"bench export {place} out=in_c")
    return 0


def trained(values: Values) -> tuple[Fitted, Path | None]:
    """The system of some values, fitted and saved; and the folder that was asked for.

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    from bench.work.fit import fit

    rest = {k: v for k, v in values.items() if k not in ("out", "stopping")}
    given = values.get("stopping", "yes")
    stopping = {True: "yes", False: "no"}[given] if isinstance(given, bool) else str(given)
    if stopping not in ("yes", "no"):
        raise InputError(f"stopping={stopping}: give yes or no")
    out = Path(str(values["out"])) if "out" in values else None
    return fit(only_one(cells(rest)), out, stopping == "yes"), out


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
    recogniser, corpus, values = _read("predict", arguments, OPTIONS)
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
    counts = ", ".join(f"{count} {label}" for label, count in table["label"].value_counts().items())
    print(f"{values['out']}: {len(table)} captures labelled: {counts}")
    then(f"sensor | bench stream source=- model={quoted(arguments[0])}")
    return 0


def adapt(arguments: list[str]) -> int:
    """Adapt a saved system to the captures of one person in a file, and save it.

    Raises:
        InputError: something in the arguments or the file cannot be used, or the system cannot adapt.
    """
    from bench.work.fit import save_adapted

    recogniser, corpus, values = _read("adapt", arguments, (*OPTIONS, "labels"))
    if "out" not in values:
        raise InputError("bench adapt needs out=, the folder of the adapted system")
    out = new_folder(Path(values["out"]))
    if (labels := values.get("labels", "yes")) not in ("yes", "no"):
        raise InputError(f"labels={labels}: give yes or no")
    if len(people := set(corpus.captures.get("subject", []))) > 1:
        raise InputError(
            f"{arguments[1]}: captures of {len(people)} subjects; a system adapts to one, so give theirs alone"
        )
    known = corpus.captures.get("gesture") if labels == "yes" else None
    seconds = save_adapted(arguments[0], recogniser, corpus, None if known is None else known.to_numpy(), out)
    said = "without labels" if known is None else "with labels"
    print(f"{out}: adapted to {len(corpus)} captures {said} in {seconds:.2f} s")
    then(f"bench predict {quoted(str(out))} new.csv")
    return 0


def _read(command: str, arguments: list[str], known: tuple[str, ...]) -> tuple[Recogniser, Corpus, dict[str, str]]:
    """The model and the captures that a command names, and its options.

    Raises:
        InputError: something in the arguments or the file cannot be used.
    """
    match arguments:
        case [model, path, *options] if path.partition("=")[0] not in known or Path(path).is_file():
            pass
        case _:
            raise InputError(f"give a model and a file: bench {command} MODEL FILE; see bench {command} --help")
    values = options_of(options, known)
    from bench.work.saved import load

    rate = number("rate_hz", values["rate_hz"]) if "rate_hz" in values else None
    recogniser = load(model)
    if rate is not None:
        recogniser.check_rate(rate)
    corpus = read_unlabelled(Path(path), recogniser.rate_hz, recogniser.grid, recogniser.full_scale)
    return recogniser, corpus, values
