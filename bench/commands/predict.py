"""The command ``bench predict``: a saved system labels captures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import (
    SHIP,
    TRUSTED,
    Command,
    Option,
    following,
    keys,
    parse_words,
    settings,
)
from bench.ground.words import Values, quoted

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.running.saved import Recogniser

COMMAND = Command(
    SHIP,
    "classify the captures of a file with a saved model",
    "FILE is CSV, parquet or .npz in the format of bench data import table; subject and gesture are optional. "
    "Prints capture, label, confidence, whether the capture is unlike all training captures, and the probability of "
    "each class. MODEL is models:/..., runs:/.../model "
    f"of the store of this folder, or a folder. {TRUSTED}",
    "bench predict models:/m-0123456789abcdef new.csv out=labels.csv",
    "MODEL FILE [key=value ...]",
    options=(
        Option(
            "out", "text", "", "CSV file that is safe in spreadsheets; default: print the table"
        ),
        Option("rate_hz", "number", None, "frame rate of FILE in Hz; must equal the model's"),
    ),
)


def command(arguments: list[str]) -> int:
    """Label the captures of a file."""
    from bench.commands.printing import then, unwritable
    from bench.ground.progress import warn
    from bench.ground.scratch import replacing
    from bench.values.table import write_sheet

    words, values = parse_words(arguments, keys("predict"), 2)
    model, recogniser, corpus = read("predict", words, values)
    table = recogniser.label(corpus)
    table.insert(0, "capture", corpus.captures["capture"])
    if strange := int(table["unlike"].sum()):
        warn(
            f"warning: {strange} of {len(table)} captures look unlike all training captures, so their labels may mean "
            "nothing; compare the range of readings, what is read at rest, and the order of taxels"
        )
    if "out" not in values:
        print(table.to_csv(index=False, float_format="%.6g"), end="")
        return 0
    out = Path(values["out"])
    with unwritable(out), replacing(out) as beside:
        write_sheet(table, beside, "%.6g")
    counts = ", ".join(f"{count} {label}" for label, count in table["label"].value_counts().items())
    print(f"{out}: {len(table)} captures classified: {counts}")
    then(*following("predict", quoted(model), recogniser)[0])
    return 0


def read(command: str, words: list[str], values: Values) -> tuple[str, Recogniser, Corpus]:
    """The model that a command names and itself, and the captures of the file."""
    if len(words) < 2:
        raise InputError(
            f"give a model and a file: bench {command} MODEL FILE; see bench {command} --help"
        )
    from bench.corpora.read.table import read_unlabelled
    from bench.running.saved import load

    rate = settings(command, values)["rate_hz"]
    recogniser = load(words[0])
    if rate is not None:
        recogniser.check_rate(rate)
    corpus = read_unlabelled(
        Path(words[1]), recogniser.rate_hz, recogniser.grid, recogniser.full_scale
    )
    return words[0], recogniser, corpus
