"""The command ``bench adapt``: a saved system for one person."""

from __future__ import annotations

import time
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.errors import InputError
from bench.grammar.options import keys, parse_words
from bench.ground.scratch import made_whole, new_folder
from bench.ground.words import quoted
from touchbench_people.adaptation import adapted, adapts

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.running.saved import Recogniser


def adapt(arguments: list[str]) -> int:
    """Adapt a saved system to the captures of one person in a file, and save it."""
    from bench.commands.predict import read
    from bench.commands.printing import then

    words, values = parse_words(arguments, keys("adapt"), 2)
    model, recogniser, corpus = read("adapt", words, values)
    if "out" not in values:
        raise InputError("bench adapt needs out=, the folder for the adapted model")
    out = new_folder(Path(values["out"]))
    if len(people := set(corpus.captures.get("subject", []))) > 1:
        raise InputError(
            f"the file has captures of {len(people)} subjects; a model adapts to one, so give captures of one subject"
        )
    labels = corpus.captures["gesture"].to_numpy() if "gesture" in corpus.captures else None
    seconds = save_adapted(model, recogniser, corpus, labels, out)
    how = "without labels" if labels is None else "with labels"
    print(f"{out}: adapted to {len(corpus)} captures {how} in {seconds:.2f} s")
    then(f"bench predict {quoted(str(out))} new.csv")
    return 0


def save_adapted(
    model: str, recogniser: Recogniser, corpus: Corpus, y: np.ndarray | None, out: Path
) -> float:
    """Adapt a saved system to one person, save it as a folder, and return the seconds of adapting.

    Args:
        model: folder of the saved system.
        recogniser: saved system in that folder.
        corpus: some captures of the person.
        y: their class names; None without labels.
        out: a folder that is new or empty.

    Raises:
        InputError: the system cannot adapt, a class is none of its own, or the folder cannot be written.
    """
    import mlflow

    from bench.running.fit import EXAMPLE_FRAMES
    from bench.running.saved import by_value, own_code, quiet

    if hasattr(recogniser, "adapted"):
        raise InputError(
            f"{model} is adapted already; adapt the original model to all captures of the person at once"
        )
    if not adapts(recogniser.estimator):
        raise InputError(
            f"{model} cannot adapt to a person; use reflex, lda, a network or model=adaptable"
        )
    if (
        unknown := sorted({str(name) for name in y} - set(recogniser.classes))
        if y is not None
        else []
    ):
        raise InputError(
            f"gesture {unknown[0]} is not a class of {model}; known: {', '.join(recogniser.classes)}"
        )
    began = time.perf_counter()
    personal = copy(recogniser)
    personal.adapted = True
    personal.estimator = adapted(recogniser.estimator, corpus, y)
    if recogniser.watcher is not None:
        personal.watcher = recogniser.watcher.changed(personal.estimator, adapted, corpus, y)
    seconds = time.perf_counter() - began
    by_value()
    with own_code() as code, quiet():
        needed = (
            Path(mlflow.pyfunc.get_model_dependencies(model))
            .read_text(encoding="utf-8")
            .splitlines()
        )
        arguments = personal.model([], corpus[0][:EXAMPLE_FRAMES])
        arguments |= {
            "pip_requirements": [line for line in needed if line.strip()],
            "code_paths": [code],
        }
        with made_whole(out) as beside:
            mlflow.pyfunc.save_model(str(beside), **arguments)
    return seconds
