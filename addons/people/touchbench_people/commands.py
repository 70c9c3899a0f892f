"""The command ``bench adapt``: adapt a saved system to one person."""

from __future__ import annotations

import importlib
import time
from copy import copy
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from bench.errors import InputError
from bench.grammar.options import key_options, parse_words, typed_settings
from bench.ground.scratch import check_empty_folder, fill_then_rename
from bench.ground.typed import quote_value
from bench.values.result import format_count
from touchbench_people.adaptation import adapt_system, can_adapt

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.running.saved import Recogniser

MOST_PARTS = 20  # of a person's captures that are left out in turn


def adapt(arguments: list[str]) -> int:
    """Adapt a saved system to captures of one person, and save it; 1 if it gets worse."""
    from bench.commands.predict import load_model_and_captures
    from bench.commands.printing import print_lines, print_next_commands

    words, values = parse_words(arguments, key_options("adapt"), 2)
    source, builder = words[0] if words else "", _builder_of(words)
    if builder:
        words = [builder.model_of_build(Path(source)), *words[1:]]
    model, recogniser, corpus = load_model_and_captures("adapt", words, values)
    if "out" not in values:
        raise InputError("bench adapt needs out=, the folder for the adapted model")
    out = check_empty_folder(Path(values["out"]))
    if len(people := set(corpus.captures.get("subject", []))) > 1:
        raise InputError(
            f"the file has captures of {len(people)} subjects; a model adapts to one, so give "
            "captures of one subject"
        )
    labels = corpus.captures["gesture"].to_numpy() if "gesture" in corpus.captures else None
    check_adaptable(source, recogniser, labels)
    gain = "without labels, nobody knows whether it is better for this person"
    if labels is not None and len(corpus) == 1:
        gain = "of one capture, nobody knows whether it is better for this person"
    elif labels is not None:
        before, after = count_right_left_out(recogniser, corpus, labels)
        gain = f"of {format_count(len(corpus), 'capture')}, each left out, it labels {after} right"
        gain += f", and {source} {before}"
        if after < before and not typed_settings("adapt", values)["anyway"]:
            print_lines(
                f"it gets worse: {gain}, so nothing is written; give more captures of each "
                "gesture, or anyway=yes"
            )
            return 1
        gain += "; no gain is shown" * (after == before)
    personal, seconds = adapt_recogniser(recogniser, corpus, labels)
    if builder:
        builder.write_personal_build(Path(source), out, personal, corpus, gain)
        more = f"make -C {quote_value(str(out))} test"
    else:
        save_adapted(model, personal, corpus, out)
        more = f"bench predict {quote_value(str(out))} new.csv"
    print_lines(f"{out}: adapted in {seconds:.2f} s; {gain}")
    print_next_commands(more)
    return 0


def _builder_of(words: list[str]) -> ModuleType | None:
    """The module of the builder add-on, if the model is a folder of ``bench build``."""
    if not words or not (Path(words[0]) / "certificate.json").is_file():
        return None
    try:
        return importlib.import_module("touchbench_builder.personal")
    except ModuleNotFoundError as e:
        raise InputError(
            f"{words[0]} was written by bench build; to adapt it, install addons/builder"
        ) from e


def check_adaptable(model: str, recogniser: Recogniser, y: np.ndarray | None) -> None:
    """Raise an InputError for a system that cannot adapt, or does not know a class."""
    if hasattr(recogniser, "adapted"):
        raise InputError(
            f"{model} is adapted already; adapt the original model to all captures of the person "
            "at once"
        )
    if not can_adapt(recogniser.estimator):
        raise InputError(
            f"{model} cannot adapt to a person; use reflex, lda, a network or model=adaptable"
        )
    names = set() if y is None else {str(name) for name in y}
    if unknown := sorted(names - set(recogniser.classes)):
        known = ", ".join(recogniser.classes)
        raise InputError(f"gesture {unknown[0]} is not a class of {model}; known: {known}")


def count_right_left_out(recogniser: Recogniser, corpus: Corpus, y: np.ndarray) -> tuple[int, int]:
    """Captures that are labelled right before, and after adapting without them.

    Each of two or more is left out in turn; of more than `MOST_PARTS`, some together.
    """
    before, after = recogniser.label(corpus)["label"].to_numpy() == y, 0
    part = np.arange(len(corpus)) % MOST_PARTS
    for number in np.unique(part):
        rest, left_out = np.flatnonzero(part != number), np.flatnonzero(part == number)
        adapted, _ = adapt_recogniser(recogniser, corpus[rest], y[rest])
        found = adapted.label(corpus[left_out])["label"].to_numpy()
        after += int((found == y[left_out]).sum())
    return int(before.sum()), after


def adapt_recogniser(
    recogniser: Recogniser, corpus: Corpus, y: np.ndarray | None
) -> tuple[Recogniser, float]:
    """Adapt a copy of a saved system to captures of a person; also returns the seconds it took."""
    began = time.perf_counter()
    personal = copy(recogniser)
    personal.adapted = True
    personal.estimator = adapt_system(recogniser.estimator, corpus, y)
    if recogniser.watcher is not None:
        personal.watcher = recogniser.watcher.with_system(
            personal.estimator, adapt_system, corpus, y
        )
    return personal, time.perf_counter() - began


def save_adapted(model: str, personal: Recogniser, corpus: Corpus, out: Path) -> None:
    """Save an adapted system in a new folder.

    Args:
        model: folder or address of the general system.
        personal: the adapted one.
        corpus: captures of the person, one of which is an example.
        out: new or empty folder.
    """
    import mlflow

    from bench.running.fit import EXAMPLE_FRAMES
    from bench.running.saved import copy_own_code, pickle_user_code, save_model, silence_mlflow
    from bench.store.client import use_tracking_uri

    pickle_user_code()
    with copy_own_code() as code, use_tracking_uri(), silence_mlflow():
        requirements = Path(mlflow.pyfunc.get_model_dependencies(model))
        lines = requirements.read_text(encoding="utf-8").splitlines()
        arguments = personal.mlflow_arguments([], corpus[0][:EXAMPLE_FRAMES])
        arguments |= {
            "pip_requirements": [line for line in lines if line.strip()],
            "code_paths": [code],
        }
        with fill_then_rename(out) as beside:
            save_model(beside, arguments)
