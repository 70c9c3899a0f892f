"""Captures of a build: loaded from the keys of the command, checked, and warnings about them."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

import bench
from bench.corpora.corpus import Corpus
from bench.corpora.doubts import doubt_spellings, find_doubts
from bench.corpora.sensor import find_session_column
from bench.corpora.survey import Survey
from bench.errors import InputError
from touchbench_streams.recent import find_saturated

MAX_SATURATED = 0.25  # share of saturated frames, above which readings tell too little of touch
WARN_SATURATED = 0.01  # above which a certificate names it


def data_arguments(values: Mapping[str, str]) -> dict[str, str]:
    """The keys that name captures: ``data``, its parameters, ``where``, and a designed skin."""
    named = {key: key.partition(".")[0] for key in values}
    return {key: values[key] for key in values if named[key] in ("data", "where", "skin")}


def load_corpus(arguments: Mapping[str, str]) -> Corpus:
    """Load the captures that `data_arguments` name."""
    return bench.corpus(**{key.replace("data.", ""): arguments[key] for key in arguments})


def load_training_captures(on: Mapping[str, str]) -> Corpus:
    """Load the captures to learn from; raise an InputError if they cannot teach a recogniser."""
    corpus = load_corpus(on)
    problems = doubt_spellings(corpus)
    if (people := len(set(corpus.subjects))) < 2:
        problems.append(
            f"{people} subject; record two at least, as each is left out of training in turn"
        )
    if len(names := sorted(set(corpus.gestures))) < 2:
        problems.append(
            f"the only gesture is {names[0]}; record another one, or captures without touch"
        )
    if (share := _saturated_share(corpus)) > MAX_SATURATED:
        problems.append(
            f"the sensor saturates: in {100 * share:.0f} % of frames, a tenth of the taxels is at "
            f"{corpus.full_scale:g}; lower its gain and record again, or correct full_scale="
        )
    if problems:
        raise InputError(f"data={corpus.name}: {problems[0]}")
    return corpus


def find_two_sessions(corpus: Corpus) -> tuple[str, list[object]]:
    """Return the condition that names two sessions, and its values; "" and none without two."""
    column = find_session_column(corpus)
    values = corpus.captures[column].dropna().unique().tolist() if column else []
    return (column, values) if len(values) == 2 else ("", [])


def _saturated_share(corpus: Corpus) -> float:
    saturated = [int(find_saturated(frames, corpus.full_scale).sum()) for frames in corpus]
    return sum(saturated) / int(corpus.lengths.sum())


def data_warnings(corpus: Corpus) -> list[str]:
    """Warnings of ``bench data show`` that could spoil the result."""
    survey = Survey(corpus)
    lines = [*find_doubts(corpus), *map(str, corpus.info.get("warnings", []))]
    lines += [text for text in map(str, survey.seams) if "cut" in text]
    if len(survey.odd_taxels):
        lines.append(". ".join(map(str.strip, survey.taxel_lines()[:2])))  # with an example
    lines += survey.repeat_warnings()
    missing = pd.crosstab(corpus.subjects.astype(str), corpus.gestures.astype(str)) == 0
    for subject, gesture in missing.stack()[lambda cells: cells].index[:3]:
        lines.append(f"subject {subject} has no capture of {gesture}")
    if (share := _saturated_share(corpus)) > WARN_SATURATED:
        lines.append(f"{100 * share:.0f} % of frames have a tenth of the taxels at full scale")
    return list(dict.fromkeys(lines))
