"""``bench build check``: compare the C, on captures of other people, with its certificate."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from scipy.special import bdtrc

from bench.corpora.corpus import Corpus
from bench.corpora.doubts import doubt_spellings
from bench.corpora.duplicates import capture_digests, describe_capture
from bench.corpora.spellings import known_spelling
from bench.errors import InputError
from bench.ground.digests import read_json_with_digest
from bench.values import few
from bench.values.result import format_count
from touchbench_builder.bounds import ALPHA
from touchbench_builder.captures import data_arguments, load_corpus
from touchbench_builder.folder import CERTIFICATE, label_with_c

# Share of captures of new people that may look unlike training; it is 0.1 to 1.6 % with 5 people.
MAX_UNLIKE = 0.05


def check_build(words: list[str], values: Mapping[str, Any]) -> int:
    """Compare the accuracy of the C on other people's captures with the certificate; 1 if worse."""
    from bench.commands.printing import print_lines
    from touchbench_builder.bounds import compare_with_certificate

    if len(words) != 1 or "data" not in values:
        raise InputError(
            "bench build check needs a folder and data=: bench build check robot data=newpeople"
        )
    folder = Path(words[0])
    if not (folder / CERTIFICATE).is_file():
        raise InputError(
            f"{folder}: no {CERTIFICATE} is here; give the folder that bench build wrote"
        )
    facts = _load_certificate(folder / CERTIFICATE)
    known = pd.DataFrame(facts["expected"]["people"].values(), columns=["right", "total"])
    if len(known) < few.FEWEST_FOR_INTERVAL:
        raise InputError(
            f"{folder} was built on {format_count(len(known), 'subject')}, too few for a bound "
            f"that could be tested; build it on {few.FEWEST_FOR_INTERVAL} or more"
        )
    arguments = data_arguments(values)
    if unused := sorted(values.keys() - arguments.keys()):
        raise InputError(f"bench build check takes data= and where=; leave {unused[0]}= out")
    corpus = load_corpus(arguments)
    _check_captures(corpus, facts)
    labels, unlike = label_with_c(
        folder, facts["data"]["gestures"], corpus, facts["system"]["prefix"]
    )
    right = pd.Series(labels == corpus.gestures.astype(str))
    counts = right.groupby(corpus.subjects.astype(str)).agg(right="sum", total="size")
    agreement = compare_with_certificate(
        *(known["right"].to_numpy(), known["total"].to_numpy()),
        *(counts["right"].to_numpy(), counts["total"].to_numpy()),
    )
    mean = 100 * float((counts["right"] / counts["total"]).mean())
    captures, people = format_count(len(corpus), "capture"), format_count(len(counts), "subject")
    verdict = "agrees with" if agreement.agrees else "contradicts"
    print_lines(
        f"{corpus.name}: {captures} of {people} in C: {mean:.1f} % correct, mean over people; the "
        f"certificate expects {100 * facts['expected']['mean']:.1f} %",
        f"the accuracy {verdict} the certificate (one-sided test, p = {agreement.p:.3g}; power "
        f"{100 * agreement.power:.0f} %)",
    )
    is_other_sensor = bdtrc(int(unlike.sum()) - 1, len(corpus), MAX_UNLIKE) < ALPHA
    if is_other_sensor:
        print_lines(
            f"{int(unlike.sum())} of {captures} look unlike all captures of the build, which "
            "contradicts the certificate; compare the range of readings, readings at rest, and the "
            "orientation of the sensor"
        )
    return 0 if agreement.agrees and not is_other_sensor else 1


def _load_certificate(file: Path) -> dict[str, Any]:
    """Load the content of ``certificate.json``."""
    try:
        facts = read_json_with_digest(file)
        if facts["certificate"] != 1:
            raise ValueError("another version wrote it")
        return facts
    except (OSError, ValueError, KeyError) as e:
        raise InputError(f"{file}: no certificate of bench build ({e}); build it again") from e


def _check_captures(corpus: Corpus, facts: Mapping[str, Any]) -> None:
    """Raise an InputError for another sensor, other gestures, or people of the build."""
    data, values = facts["data"], {"grid": list(corpus.grid)}
    values |= {name: float(getattr(corpus, name)) for name in ("rate_hz", "full_scale")}
    for name, value in values.items():
        if value != data[name]:
            raise InputError(
                f"data={corpus.name}: {name} is {value}, the C was built for {data[name]}; use its "
                "sensor"
            )
    if others := sorted({*corpus.gestures.astype(str)} - {*data["gestures"]}):
        spelling = known_spelling(others[0], data["gestures"])
        advice = f"correct it to {spelling}, or " if spelling else ""
        raise InputError(
            f"data={corpus.name}: the C does not know {others[0]}; {advice}leave it out with where="
        )
    if problems := doubt_spellings(corpus):
        raise InputError(f"data={corpus.name}: {problems[0]}")
    people = sorted({*corpus.subjects.astype(str)})
    known = data["subjects"]
    same = [name for name in people if name in known or known_spelling(name, known)]
    if corpus.name == data["corpus"] and same:
        raise InputError(
            f"data={corpus.name}: subject {same[0]} was recorded for the build; give people who "
            "were not"
        )
    seen = {*data["captures_seen"].split()}
    if shared := [i for i, digest in enumerate(capture_digests(corpus)) if digest in seen]:
        is_whole = len(shared) == len(corpus)
        advice = "give people who were not recorded for the build"
        counts = f"{len(shared)} of {format_count(len(corpus), 'capture')}"
        raise InputError(
            f"data={corpus.name}: {corpus.name} has {'the ' * is_whole}recordings of the build "
            f"(digest {data['digest'][:16]}): {counts}, such as "
            f"{describe_capture(corpus, shared[0])}; "
            f"{'' if is_whole else 'leave these people out with where=, or '}{advice}"
        )
