"""``bench build check``: compare the C, on streams of other people, with its certificate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
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
from touchbench_builder.bounds import ALPHA, compare_with_certificate
from touchbench_builder.captures import data_arguments, load_corpus
from touchbench_builder.certificate import CERTIFICATE_VERSION, format_number
from touchbench_builder.folder import CERTIFICATE, label_with_c, watch_with_c
from touchbench_builder.rates import compare_rates
from touchbench_builder.stream import people_of_reports, recordings_of_people

# Share of captures of new people that may look unlike training; it is 0.1 to 1.6 % with 5 people.
MAX_UNLIKE = 0.05
# Probability that honest people fail the test of each promise; together `ALPHA`. A quarter for each
# would find a loss of ten points half as often as the last label alone does, on which a robot acts.
LEVELS = {"last": 0.8 * ALPHA} | dict.fromkeys(("first", "alarms", "captures"), 0.2 * ALPHA / 3)


@dataclass(frozen=True)
class Promise:
    """A promise of the certificate, as new people find it.

    Attributes:
        sentence: both numbers, in words.
        p: probability of people as bad as these or worse, if the certificate is true.
        level: of the test: a smaller ``p`` contradicts the certificate.
    """

    sentence: str
    p: float
    level: float


def check_build(words: list[str], values: Mapping[str, Any]) -> int:
    """Compare the C, on other people's streams and captures, with the certificate; 1 if worse."""
    from bench.commands.printing import print_lines

    if len(words) != 1 or "data" not in values:
        raise InputError(
            "bench build check needs a folder and data=: bench build check robot data=newpeople"
        )
    folder = Path(words[0])
    if not (folder / CERTIFICATE).is_file():
        raise InputError(
            f"{folder}: no {CERTIFICATE} is here; give the folder that bench build wrote"
        )
    facts = load_certificate(folder / CERTIFICATE)
    known = facts["data"]["people"]
    if known < few.FEWEST_FOR_INTERVAL:
        raise InputError(
            f"{folder} was built on {format_count(known, 'subject')}, too few for a bound "
            f"that could be tested; build it on {few.FEWEST_FOR_INTERVAL} or more"
        )
    arguments = data_arguments(values)
    if unused := sorted(values.keys() - arguments.keys()):
        raise InputError(f"bench build check takes data= and where=; leave {unused[0]}= out")
    corpus = load_corpus(arguments)
    recorded = facts["data"]["recorded"] or {}
    if ([*corpus.grid], corpus.rate_hz) == (recorded.get("grid"), recorded.get("rate_hz")):
        arguments |= facts["data"]["skin"]
        corpus = load_corpus(arguments)
    _check_captures(corpus, facts)
    level, promises = ALPHA, []
    if facts["stream"]:
        level, promises = LEVELS["captures"], _stream_promises(folder, facts, arguments, corpus)
    of_captures, unlike = _captures_promise(folder, facts, corpus, level)
    promises.append(of_captures)
    broken = [promise for promise in promises if promise.p < promise.level]
    for promise in promises:
        print_lines(f"{corpus.name}: {promise.sentence}; fails at p < {promise.level:.2g}")
    verdict = "contradict" if broken else "agree with"
    print_lines(
        f"{format_count(len(set(corpus.subjects)), 'subject')} in C {verdict} the certificate "
        f"({format_count(len(promises), 'one-sided test')}; {100 * ALPHA:g} % of honest people at "
        "most fail)"
    )
    is_other_sensor = bdtrc(unlike - 1, len(corpus), MAX_UNLIKE) < ALPHA
    if is_other_sensor:
        print_lines(
            f"{unlike} of {format_count(len(corpus), 'capture')} look unlike all captures of the "
            "build, which contradicts the certificate; compare the range of readings, readings at "
            "rest, and the orientation of the sensor"
        )
    return 1 if broken or is_other_sensor else 0


def _stream_promises(
    folder: Path, facts: Mapping[str, Any], on: Mapping[str, Any], corpus: Corpus
) -> list[Promise]:
    """First label, last label and false alarms of ``touch_watch`` on streams of new people."""
    recordings, stream = recordings_of_people(on, corpus), facts["stream"]
    reports = watch_with_c(
        folder, facts["data"]["gestures"], recordings.corpus, facts["system"]["prefix"]
    )
    people = people_of_reports(recordings, reports)
    found = people.count_right("found")
    share = 100 * float((found["right"] / found["total"]).mean())
    touches = f"of {len(people.touches)} touches, {share:.1f} % found"
    promises = []
    for name, words in (("first", "first label"), ("last", "last label")):
        counts = people.count_right(name)
        described = f"{touches}, {words} right of"
        promises.append(_share_promise(described, stream[name], counts, LEVELS[name]))
    alarms = people.count_alarms()
    if len(alarms) and stream["alarms"]:
        certified = np.array([*stream["alarms"]["people"].values()])
        counted = alarms["alarms"].to_numpy(), alarms["hours"].to_numpy()
        p = compare_rates(certified[:, 0], certified[:, 1], *counted)
        rate, hours = counted[0].sum() / counted[1].sum(), counted[1].sum()
        promises.append(
            Promise(
                f"{format_number(rate)} false alarms an hour in {60 * hours:.0f} minutes without "
                f"touch; the certificate expects {format_number(stream['alarms']['mean'])} "
                f"(p = {p:.3g})",
                p,
                LEVELS["alarms"],
            )
        )
    return promises


def _captures_promise(
    folder: Path, facts: Mapping[str, Any], corpus: Corpus, level: float
) -> tuple[Promise, int]:
    """Labels of captures, and the number of captures that look unlike training."""
    labels, unlike = label_with_c(
        folder, facts["data"]["gestures"], corpus, facts["system"]["prefix"]
    )
    right = pd.Series(labels == corpus.gestures.astype(str))
    counts = right.groupby(corpus.subjects.astype(str)).agg(right="sum", total="size")
    words = f"{format_count(len(corpus), 'capture')}, correct of"
    return _share_promise(words, facts["captures"], counts, level), int(unlike.sum())


def _share_promise(
    words: str, certified: Mapping[str, Any], counts: pd.DataFrame, level: float
) -> Promise:
    """A share that new people have, tested against that of the certificate."""
    known = pd.DataFrame(certified["people"].values(), columns=["right", "total"])
    agreement = compare_with_certificate(
        *(known["right"].to_numpy(), known["total"].to_numpy()),
        *(counts["right"].to_numpy(), counts["total"].to_numpy()),
        level=level,
    )
    mean = 100 * float((counts["right"] / counts["total"]).mean())
    return Promise(
        f"{words} {mean:.1f} %, mean over people; the certificate expects "
        f"{100 * certified['mean']:.1f} % (p = {agreement.p:.3g}, power "
        f"{100 * agreement.power:.0f} %)",
        agreement.p,
        level,
    )


def load_certificate(file: Path) -> dict[str, Any]:
    """Load the content of ``certificate.json``."""
    try:
        facts = read_json_with_digest(file)
        if facts["certificate"] != CERTIFICATE_VERSION:
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
