"""The C of a build, adapted to one person by ``bench adapt``."""

from __future__ import annotations

from pathlib import Path

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.running.saved import Recogniser
from bench.store.client import connect
from bench.values.result import format_count
from touchbench_builder.check import load_certificate
from touchbench_builder.folder import CERTIFICATE, origin_lines, source_texts, write_tested

PAGE = """# A touch recogniser for one person

This is the C of {source}, adapted to {count} of one person: {gain}.

The certificate of {source} is about new people and the C before. It says nothing about this C,
which is for this person alone. Detector and thresholds have not changed. `make test` compares the C
with Python on captures of the person.
"""


def model_of_build(folder: Path) -> str:
    """Address of the model that a build was made from; it must be in the user's store."""
    model = str(load_certificate(folder / CERTIFICATE)["system"]["model"])
    run_id = model.removeprefix("runs:/").partition("/")[0]
    if not connect().search_runs(f"attributes.run_id = '{run_id}'"):
        raise InputError(
            f"{folder}: its model {model} is not in the store of this folder; run bench adapt "
            "where bench build was run, or set MLFLOW_TRACKING_URI to that store"
        )
    return model


def write_personal_build(
    source: Path, out: Path, personal: Recogniser, corpus: Corpus, gain: str
) -> None:
    """Write the C of an adapted model, with the prefix and the examples of a build.

    Args:
        source: folder of the build.
        out: new or empty folder.
        personal: the adapted model.
        corpus: captures of the person.
        gain: what is known of its accuracy for the person.
    """
    facts = load_certificate(source / CERTIFICATE)
    count = format_count(len(corpus), "capture")
    head = [*origin_lines(facts), f"Adapted to {count} of one person: {gain}."]
    # The test has a capture of each label; captures may come without gestures.
    labels = personal.label(corpus)["label"].to_numpy()
    labelled = corpus.with_fields(captures=corpus.captures.assign(gesture=labels))
    texts = source_texts(personal, facts, head, labelled)
    page = PAGE.format(source=source.name, count=count, gain=gain)
    write_tested(out, texts | {"README.md": page})
