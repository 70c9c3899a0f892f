"""Recordings that are imported, and generated ones."""

from __future__ import annotations

from typing import Any

from bench.corpora import synth
from bench.corpora.corpus import Corpus
from bench.corpora.library import generated, imported, stored_value
from bench.corpora.where import chosen
from bench.errors import InputError
from touchbench_streams import synth_recordings
from touchbench_streams.recordings import captures_in, is_recorded


def holds_recordings(name: str) -> bool:
    """Return True for imported recordings."""
    return name in imported() and is_recorded(stored_value(name))


def whole(data: str, parameters: dict[str, Any] | None = None, where: str = "") -> Corpus:
    """All captures of recordings: touches, background and doubtful stretches.

    Args:
        data: name of imported recordings, or ``synth`` for generated ones.
        parameters: parameters of ``synth``.
        where: a condition on the columns of recordings.

    Raises:
        InputError: they cannot be opened or chosen.
    """
    if data == "synth":
        made = lambda **values: captures_in(synth_recordings.generate(**values))  # noqa: E731
        captures = generated(made, parameters or {}, synth, synth_recordings)
    else:
        captures = stored_value(data)
    if not is_recorded(captures):
        raise InputError(f"{data} holds captures, not recordings; use bench run data={data}")
    return captures[chosen(where, captures.captures.drop(columns="gesture"), captures.name)] if where else captures
