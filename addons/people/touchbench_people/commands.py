"""The command ``bench adapt``: adapt a saved system to one person."""

from __future__ import annotations

import time
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.errors import InputError
from bench.grammar.options import key_options, parse_words
from bench.ground.scratch import check_empty_folder, fill_then_rename
from bench.ground.typed import quote_value
from touchbench_people.adaptation import adapt_system, can_adapt

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.running.saved import Recogniser


def adapt(arguments: list[str]) -> int:
    """Adapt a saved system to the captures of one person in a file, and save it."""
    from bench.commands.predict import load_model_and_captures
    from bench.commands.printing import print_next_commands

    words, values = parse_words(arguments, key_options("adapt"), 2)
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
    seconds = save_adapted(model, recogniser, corpus, labels, out)
    with_labels = "without labels" if labels is None else "with labels"
    print(f"{out}: adapted to {len(corpus)} captures {with_labels} in {seconds:.2f} s")
    print_next_commands(f"bench predict {quote_value(str(out))} new.csv")
    return 0


def save_adapted(
    model: str, recogniser: Recogniser, corpus: Corpus, y: np.ndarray | None, out: Path
) -> float:
    """Adapt a saved system to one person, save it, and return the seconds of adapting.

    Args:
        model: folder of the saved system.
        recogniser: saved system in that folder.
        corpus: some captures of the person.
        y: their class names; None without labels.
        out: new or empty folder.

    Raises:
        InputError: the system cannot adapt, a class is unknown to it, or the folder cannot be
            written.
    """
    import mlflow

    from bench.running.fit import EXAMPLE_FRAMES
    from bench.running.saved import copy_own_code, pickle_user_code, save_model, silence_mlflow

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
    began = time.perf_counter()
    personal = copy(recogniser)
    personal.adapted = True
    personal.estimator = adapt_system(recogniser.estimator, corpus, y)
    if recogniser.watcher is not None:
        personal.watcher = recogniser.watcher.with_system(
            personal.estimator, adapt_system, corpus, y
        )
    seconds = time.perf_counter() - began
    pickle_user_code()
    with copy_own_code() as code, silence_mlflow():
        requirements = Path(mlflow.pyfunc.get_model_dependencies(model))
        lines = requirements.read_text(encoding="utf-8").splitlines()
        arguments = personal.mlflow_arguments([], corpus[0][:EXAMPLE_FRAMES])
        arguments |= {
            "pip_requirements": [line for line in lines if line.strip()],
            "code_paths": [code],
        }
        with fill_then_rename(out) as beside:
            save_model(beside, arguments)
    return seconds
