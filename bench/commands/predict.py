"""The command ``bench predict``: classify the captures of a file with a saved system."""

from __future__ import annotations

from pathlib import Path

from bench.commands.printing import print_next_commands, refuse_unwritable
from bench.corpora.corpus import Corpus
from bench.corpora.read.table import read_unlabelled
from bench.errors import InputError
from bench.grammar.options import (
    RECORDED,
    key_options,
    next_of_packages,
    parse_words,
    typed_settings,
)
from bench.ground.progress import warn
from bench.ground.scratch import write_then_rename
from bench.ground.typed import Values, quote_value
from bench.running.saved import Recogniser, load_recogniser
from bench.values.table import write_sheet


def command(arguments: list[str]) -> int:
    """Classify the captures of a file; print or write a row for each."""
    words, values = parse_words(arguments, key_options("predict"), 2)
    model, recogniser, corpus = load_model_and_captures("predict", words, values)
    table = recogniser.label(corpus)
    table.insert(0, "capture", corpus.captures["capture"])
    if unlike := int(table["unlike"].sum()):
        warn(
            f"warning: {unlike} of {len(table)} captures look unlike all training captures, so "
            "their labels may mean nothing; compare the range of readings, the readings at rest, "
            "and the order of taxels"
        )
    if "out" not in values:
        print(table.to_csv(index=False, float_format="%.6g"), end="")
        return 0
    out = Path(values["out"])
    with refuse_unwritable(out), write_then_rename(out) as unfinished:
        write_sheet(table, unfinished, "%.6g")
    counts = ", ".join(f"{count} {label}" for label, count in table["label"].value_counts().items())
    print(f"{out}: {len(table)} captures classified: {counts}")
    print_next_commands(*next_of_packages("predict", quote_value(model), recogniser)[0])
    return 0


def load_model_and_captures(
    command: str, words: list[str], values: Values
) -> tuple[str, Recogniser, Corpus]:
    """Load the model and the captures that the words of a command name.

    Returns:
        The name of the model, the model, and the captures.
    """
    if len(words) < 2:
        raise InputError(
            f"give a model and a file: bench {command} MODEL FILE; see bench {command} --help"
        )
    model, file = words
    settings = typed_settings(command, values)
    rate_hz, recogniser = settings["rate_hz"], load_recogniser(model)
    if settings["skin"] == RECORDED:
        return model, recogniser, _read_recorded(model, recogniser, Path(file))
    if rate_hz is not None:
        recogniser.check_rate(rate_hz)
    layout = recogniser.rate_hz, recogniser.grid, recogniser.full_scale
    return model, recogniser, read_unlabelled(Path(file), *layout)


def _read_recorded(model: str, recogniser: Recogniser, file: Path) -> Corpus:
    """Read captures of the recorded skin, and convert them to the design of a model."""
    if recogniser.design is None:
        raise InputError(f"skin={RECORDED}: {model} has no designed skin; leave skin= out")
    recorded = recogniser.skin["recorded"]
    layout = recorded["rate_hz"], tuple(recorded["grid"]), recogniser.full_scale
    return recogniser.design.convert(read_unlabelled(file, *layout))
