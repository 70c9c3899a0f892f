"""The command ``bench predict``: a saved system labels captures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import (
    SHIP,
    TRUST_NOTE,
    Command,
    Option,
    key_options,
    next_of_packages,
    parse_words,
    typed_settings,
)
from bench.ground.typed import Values, quote_value

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.running.saved import Recogniser

COMMAND = Command(
    SHIP,
    "classify the captures of a file with a saved model",
    "FILE is CSV, parquet or .npz in the format of bench data import table; subject and gesture are optional. "
    "Prints capture, label, confidence, whether the capture is unlike all training captures, and the probability of "
    "each class. MODEL is models:/..., runs:/.../model "
    f"of the store of this folder, or a folder. {TRUST_NOTE}",
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
    from bench.commands.printing import print_next_commands, refuse_unwritable
    from bench.ground.progress import warn
    from bench.ground.scratch import write_then_rename
    from bench.values.table import write_sheet

    words, values = parse_words(arguments, key_options("predict"), 2)
    model, recogniser, corpus = load_model_and_captures("predict", words, values)
    table = recogniser.label_captures(corpus)
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
    with refuse_unwritable(out), write_then_rename(out) as beside:
        write_sheet(table, beside, "%.6g")
    counts = ", ".join(f"{count} {label}" for label, count in table["label"].value_counts().items())
    print(f"{out}: {len(table)} captures classified: {counts}")
    print_next_commands(*next_of_packages("predict", quote_value(model), recogniser)[0])
    return 0


def load_model_and_captures(
    command: str, words: list[str], values: Values
) -> tuple[str, Recogniser, Corpus]:
    """The model that a command names and itself, and the captures of the file."""
    if len(words) < 2:
        raise InputError(
            f"give a model and a file: bench {command} MODEL FILE; see bench {command} --help"
        )
    from bench.corpora.read.table import read_unlabelled
    from bench.running.saved import load_recogniser

    rate = typed_settings(command, values)["rate_hz"]
    recogniser = load_recogniser(words[0])
    if rate is not None:
        recogniser.check_rate(rate)
    corpus = read_unlabelled(
        Path(words[1]), recogniser.rate_hz, recogniser.grid, recogniser.full_scale
    )
    return words[0], recogniser, corpus
