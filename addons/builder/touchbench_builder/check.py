"""``bench build check``: captures of people who came later, in C, against the certificate."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from scipy.special import bdtrc

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.values import few
from bench.values.result import several
from touchbench_builder.bounds import ALPHA
from touchbench_builder.folder import JSON, labelled

ODD = 0.05  # share of captures of new people that may look unlike training; it is 0.1 to 1.6 % with 5 people or more


def checked(words: list[str], values: Mapping[str, Any]) -> int:
    """Test whether the C classifies other people's captures as well as its certificate says; 1 if it does not."""
    import bench
    from bench.commands.printing import say
    from touchbench_builder.bounds import agrees

    if len(words) != 1 or "data" not in values:
        raise InputError(
            "bench build check needs a folder and data=: bench build check robot data=newpeople"
        )
    folder = Path(words[0])
    if not (folder / JSON).is_file():
        raise InputError(f"{folder}: no {JSON} is here; give the folder that bench build wrote")
    facts = _read(folder / JSON)
    known = pd.DataFrame(facts["expected"]["people"].values(), columns=["right", "total"])
    if len(known) < few.INTERVAL:
        was = f"{folder} was built on {several(len(known), 'subject')}, too few for a bound that could be tested"
        raise InputError(f"{was}; build it on {few.INTERVAL} or more")
    taken = {
        key: value
        for key, value in values.items()
        if key == "where" or key.partition(".")[0] == "data"
    }
    if unused := sorted(values.keys() - taken.keys()):
        raise InputError(f"bench build check takes data= and where=; leave {unused[0]}= out")
    corpus = bench.corpus(**{key.replace("data.", ""): value for key, value in taken.items()})
    _fits(corpus, facts)
    labels, unlike = labelled(folder, facts["data"]["gestures"], corpus)
    right = pd.Series(labels == corpus.gestures.astype(str))
    counts = right.groupby(corpus.subjects.astype(str)).agg(right="sum", total="size")
    found = agrees(
        *(known[c].to_numpy() for c in known), *(counts[c].to_numpy() for c in ("right", "total"))
    )
    mean, people = 100 * float((counts["right"] / counts["total"]).mean()), len(counts)
    say(
        f"{corpus.name}: {several(len(corpus), 'capture')} of {several(people, 'subject')} in C: {mean:.1f} % correct, "
        f"mean over people; the certificate expects {100 * facts['expected']['mean']:.1f} %",
        f"the accuracy {'agrees with' if found.agrees else 'contradicts'} the certificate (one-sided test, "
        f"p = {found.p:.3g}; power {100 * found.power:.0f} %)",
    )
    strange = int(unlike.sum())
    if other_sensor := bdtrc(strange - 1, len(corpus), ODD) < ALPHA:
        say(
            f"{strange} of {several(len(corpus), 'capture')} look unlike all captures of the build, which contradicts "
            "the certificate; compare the range of readings, what is read at rest, and how the sensor is turned"
        )
    return 0 if found.agrees and not other_sensor else 1


def _read(file: Path) -> dict[str, Any]:
    """The content of ``certificate.json``."""
    try:
        facts = json.loads(file.read_text(encoding="utf-8"))
        if facts["certificate"] != 1:
            raise ValueError("another version wrote it")
        return facts
    except (ValueError, KeyError, TypeError) as e:
        raise InputError(f"{file}: no certificate of bench build ({e}); build it again") from e


def _fits(corpus: Corpus, facts: Mapping[str, Any]) -> None:
    """Refuse captures of another sensor, of other gestures, or of people who were recorded for the build."""
    data = facts["data"]
    for name, mine, theirs in (
        ("grid", list(corpus.grid), data["grid"]),
        ("rate_hz", float(corpus.rate_hz), data["rate_hz"]),
        ("full_scale", float(corpus.full_scale), data["full_scale"]),
    ):
        if mine != theirs:
            raise InputError(
                f"data={corpus.name}: {name} is {mine}, the C was built for {theirs}; use its sensor"
            )
    if others := sorted({*corpus.gestures.astype(str)} - {*data["gestures"]}):
        raise InputError(
            f"data={corpus.name}: the C does not know {others[0]}; leave it out with where="
        )
    same = sorted({*corpus.subjects.astype(str)} & {*data["subjects"]})
    if corpus.name == data["corpus"] and same:
        raise InputError(
            f"data={corpus.name}: subject {same[0]} was recorded for the build; give people who were not"
        )
