"""The captures of stored runs: whether the corpus was imported again since, and equal subsets."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from bench.corpora.library import captures_digest, import_digests, open_corpus
from bench.errors import InputError
from bench.ground.registry import parameter_defaults
from bench.ground.typed import parse_value
from bench.values.result import CAPTURES_TAG, IMPORTS_TAG, SINCE_TAG, Result

Key = tuple[str, str, str]  # corpus, its digest, digest of the chosen captures


def mark_captures(results: Sequence[Result]) -> None:
    """Mark results on earlier captures of their corpus, and give equal subsets one name.

    The name is that of all captures, or the shortest condition. A bundle keeps the marks.
    """
    digests = {data: import_digests(data) for data in {str(r["data"]) for r in results}}
    names: dict[Key, str] = {}
    for r in results:
        now, own = digests[str(r["data"])], r.get(IMPORTS_TAG)
        r.attributes.setdefault(SINCE_TAG, now if now and own and own != now else "")
        if key := _captures_key(r):
            other = names.setdefault(key, str(r["subset"]))
            names[key] = min(other, str(r["subset"]), key=lambda s: (s != "all", len(s), s))
    for r in results:
        if key := _captures_key(r):
            r.attributes["subset"] = names[key]


def _captures_key(run: Mapping[str, Any]) -> Key | None:
    """Identity of the captures of a run; None for a run that has not stored it."""
    chosen = run.get(CAPTURES_TAG)
    return (str(run["data"]), str(run["corpus_digest"]), str(chosen)) if chosen else None


def stale_sentences(results: Sequence[Result]) -> list[str]:
    """A sentence for each corpus that was imported again since some of the runs were made."""
    sentences = []
    stale = [r for r in results if r.is_stale]
    for data in dict.fromkeys(str(r["data"]) for r in stale):
        on_data = [r for r in results if r["data"] == data]
        earlier = [r for r in stale if r["data"] == data]
        runs = f"{len(earlier)} of {len(on_data)} runs are"
        if len(earlier) == len(on_data):
            runs = "these runs are"
        sentences.append(
            f"The corpus {data} was imported again since (digest {earlier[0][SINCE_TAG]:.16}): "
            f"{runs} on the earlier captures; run them again."
        )
    return sentences


def runs_on_subsets(runs: Sequence[Any], conditions: Collection[str]) -> list[Any]:
    """The runs on captures that one of the conditions selects, however it is written."""
    keys: set[Key | None] = set()
    settings: dict[tuple, list[Any]] = {}
    for run in runs:
        settings.setdefault((run["data"], run.get("corpus_digest")), []).append(run)
    for members in settings.values():
        for condition in conditions:
            same = [r for r in members if condition in (r["subset"], r.get("where"))]
            keys |= {_captures_key(r) for r in same}
            if not same and members[0].get(CAPTURES_TAG):
                keys.add(_select_key(members[0], condition))
    return [r for r in runs if r["subset"] in conditions or _captures_key(r) in keys - {None}]


def _select_key(run: Mapping[str, Any], condition: str) -> Key | None:
    """Identity of the captures that a condition selects in the corpus of a run, as it is now."""
    data = str(run["data"])
    arguments = json.loads(run.get("touchbench.arguments") or "{}")
    parameters: dict[str, Any] = {}
    if data == "synth":
        from bench.corpora.synth import generate  # which imports scipy.signal

        for key, default in parameter_defaults(generate).items():
            typed = arguments.get(f"data.{key}")
            parameters[key] = default if typed is None else parse_value(key, typed, default)
    try:
        corpus = open_corpus(data, parameters)
        corpus = corpus if condition == "all" else corpus.select(condition)
    except InputError:  # it is not imported, or has no such captures
        return None
    return data, corpus.digest, captures_digest(corpus)
