"""The actions of ``bench data``: corpora listed, imported, looked at, verified and exported."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np

from bench.commands.printing import output, say, then, unwritable, writable
from bench.corpora.corpus import Corpus
from bench.corpora.library import import_corpus, imported, open_corpus, overview, stored_value, verify
from bench.corpora.read.cost import write
from bench.corpora.read.limits import briefly
from bench.corpora.recordings import Recordings, as_touches, is_recorded, parts_of
from bench.corpora.streams import PRESSURES, StreamSurvey, survey_recordings
from bench.corpora.survey import Survey, survey
from bench.errors import InputError
from bench.measures import Measure, text
from bench.plan.cells import corpus_variants
from bench.plan.plan import captures_of
from bench.scratch import home
from bench.table import Table, rows_of
from bench.words import DEFAULTS, SMALL

EVENTS = (  # columns of the events of recordings
    text("gesture"),
    Measure("events", form=".0f"),
    Measure("subjects", form=".0f"),
    Measure("shortest", "shortest s", form=".2f"),
    Measure("median", "median s", form=".2f"),
    Measure("longest", "longest s", form=".2f"),
)
NUMBERS = {  # columns of recordings
    "minutes": Measure("minutes", form=".2f"),
    "background": Measure("background", form=".2f"),
    "doubtful": Measure("doubtful", form=".2f"),
    "events": Measure("events", form=".0f"),
    "idle": Measure("idle", form=".3g"),
    "touch": Measure("touch", form=".3g"),
    "above": Measure("above", "above %", form=".1f"),
}
STRETCHES = (  # columns of background with the pressure of touches
    text("subject"),
    text("recording"),
    Measure("start", "from s", form=".2f"),
    Measure("end", "to s", form=".2f"),
    Measure("pressure", form=".3g"),
    Measure("touch", form=".3g"),
)
LISTED = 12  # stretches that are printed


def listed() -> int:
    """Print every corpus with counts, digest, source and licence."""
    print(f"Corpora in {home()}\n")
    print("synth\n  synthetic: generated on demand, any number of subjects and repetitions; says nothing about people")
    for row in overview():
        if "damaged" in row:
            print(f"{row['data']}\n  {row['damaged']}")
            continue
        kind = "synthetic " if row["synthetic"] else ""
        unit, events = ("captures", "") if row["events"] is None else ("recordings", f"{row['events']} events, ")
        print(
            f"{row['data']}\n  {row['captures']} {kind}{unit}, {row['subjects']} subjects, {events}"
            f"{row['gestures']} gestures, {row['frames']} frames of {row['grid']} at {row['rate_hz']:g} Hz\n"
            f"  columns: {row['columns']}\n"
            f"  digest:  {row['digest']}\n  source:  {row['source']}\n  licence: {row['licence']}"
        )
    print()
    then(f"bench data show {(imported() or ['synth'])[0]}")
    return 0


def show(name: str, values: dict[str, str], given: dict[str, Any]) -> int:
    """Print what a corpus or recordings hold, and draw them."""
    where, target, out = given["where"], given["target"], given["out"]
    parameters: dict[str, object] = {key: value for key, value in values.items() if key not in given}
    found = looked(name, where, target, Path(out), parameters)
    if isinstance(found, StreamSurvey):
        print_recordings(found, name)
    else:
        print(found)
    if warnings := [] if name == "synth" else _corpus(stored_value(name)).info["warnings"]:
        print(f"\nWarnings of the import: {len(warnings)}", *warnings, sep="\n  ")
    print(f"\nfigures and a page that shows them; open: {Path(out, 'index.html').resolve().as_uri()}")
    of_recordings = isinstance(found, StreamSurvey)
    then(f"bench watch data={name}" if of_recordings else f"bench run data={name} protocol=loso {SMALL}")
    return 0


def print_recordings(found: StreamSurvey, name: str) -> None:
    """Print the recordings, the events of each gesture, gaps, background like touches, and odd taxels."""
    out = output()
    table = found.recordings if found.recordings["doubtful"].any() else found.recordings.drop(columns="doubtful")
    conditions = [name for name in table if name not in ("subject", "recording", *NUMBERS)]
    columns = [
        NUMBERS[str(name)]
        if name in NUMBERS
        else text(str(name), spare=len(conditions) - conditions.index(name) if name in conditions else 0)
        for name in table
    ]
    synthetic = "synthetic " if found.captures.synthetic else ""
    title = f"{name}: {len(table)} {synthetic}recordings; {PRESSURES}"
    Table(columns, rows_of(table), title).print(out)
    if len(found.events):
        Table(EVENTS, rows_of(found.events), "Events").print(out)
    say(found.gap_line())
    if len(found.stretches):
        Table(STRETCHES, rows_of(found.stretches.head(LISTED)), found.stretch_line()).print(out)
        if len(found.stretches) > LISTED:
            say(f"the longest {LISTED}; the page shows more")
    else:
        say(found.stretch_line())
    say(*found.taxel_lines())


def looked(
    name: str, where: str, target: str, out: Path | None, parameters: dict[str, object]
) -> Survey | StreamSurvey:
    """Survey the captures of a corpus, or recordings, and draw them if a folder is given."""
    from bench.reports.corpus_page import write as draw

    variant = one_variant(name, parameters)
    value = stored_value(name) if name in imported() else None
    streams = None
    if isinstance(value, Recordings):
        if target != DEFAULTS["target"]:
            raise InputError(f"target={target}: {name} holds recordings, whose labels are gestures; leave it out")
        corpus, value = parts_of(value, where), value[value.chosen(where)] if where else value
        streams = survey_recordings(value, corpus)
        result, recordings = streams.captures, (value, streams)
    else:
        corpus, recordings = captures_of(name, variant, where, target), None
        result = survey(corpus)
    if out is not None:
        with unwritable(writable(out)):
            draw(corpus, result, out, recordings)
    return streams or result


def one_variant(name: str, parameters: dict[str, object]) -> dict[str, object]:
    """Parameters of the generator as they are typed, with or without ``data.``, and its defaults."""
    dotted: dict[str, object] = {}
    for key, value in parameters.items():
        if (full := f"data.{key.removeprefix('data.')}") in dotted:
            raise InputError(f"{key}= is given twice; give it once")
        dotted[full] = value
    variant, *more = corpus_variants(dotted, name, [name])
    if more:
        raise InputError("bench data takes one corpus at a time; give one value of each parameter")
    return variant


def read(kind: str, source: Path, values: dict[str, str]) -> int:
    """Import a corpus; print its warnings, the corpus it replaces, and its contents."""
    before = _stored(values.get("name", kind))
    value = import_corpus(kind, source, values)
    corpus = _corpus(value)
    if corpus.info["warnings"]:
        print(f"warning: {briefly(corpus.info['warnings'], f'bench data show {corpus.name}')}", file=sys.stderr)
    if before and _corpus(before).digest != corpus.digest:
        print(f"{corpus.name}: replaces {len(before)} {_unit(before)}, digest {_corpus(before).digest[:16]}")
    if isinstance(value, Recordings):
        events, background = value.events, value.background_frames().sum()
        gestures, lengths = events["gesture"].to_numpy(), (events["end"] - events["start"]).to_numpy()
        minutes = f"{background / corpus.rate_hz / 60:.3g} of {len(corpus.frames) / corpus.rate_hz / 60:.3g} minutes"
        doubt = int((value.doubtful["end"] - value.doubtful["start"]).sum()) / corpus.rate_hz / 60
        more = f"{len(events)} events, {minutes} are background, " + f"{doubt:.3g} are doubtful, " * bool(doubt)
    else:
        gestures, lengths, more = corpus.gestures, corpus.lengths, ""
    print(
        f"{corpus.name}: {len(corpus)} {'synthetic ' if corpus.synthetic else ''}{_unit(value)}, "
        f"{len(set(corpus.subjects))} subjects, {more}{len(set(gestures))} gestures, {len(corpus.frames)} frames of "
        f"{corpus.grid[0]}x{corpus.grid[1]} at {corpus.rate_hz:g} Hz, digest {corpus.digest[:16]}"
    )
    if len(lengths):
        usual = f"{float(np.median(lengths)) / corpus.rate_hz:.2g} s"
        what = "event" if isinstance(value, Recordings) else "capture"
        print(f"the median {what} lasts {usual}; if that looks wrong, rate_hz and all reported times are wrong")
    then(f"bench data show {corpus.name}")
    return 0


def _stored(name: str) -> Corpus | Recordings | None:
    """What is stored under a name, if it can be read."""
    try:
        return stored_value(name) if name in imported() else None
    except InputError:
        return None


def _corpus(value: Corpus | Recordings) -> Corpus:
    return value.corpus if isinstance(value, Recordings) else value


def _unit(value: Corpus | Recordings) -> str:
    return "recordings" if isinstance(value, Recordings) else "captures"


def check(name: str) -> int:
    """Print a line for every file of a stored corpus, read anew and compared with the stored digest."""
    files = verify(name)
    width = max(map(len, files), default=0)
    for file, damage in files.items():
        state = f"damaged: {damage.removeprefix(f'{file} ')}" if damage else "unchanged"
        print(f"{file:{width}}  {state}")
    if any(files.values()):
        print(f"{name}: damaged; " + ("its next use repairs it" if name == "synth" else "import it again"))
        return 1
    print(f"{name}: {'unchanged' if files else 'nothing is stored'}")
    return 0


def export(name: str, target: Path, values: dict[str, str]) -> int:
    """Write a corpus in the format of CoST.csv."""
    corpus = open_corpus(name, one_variant(name, {key: value for key, value in values.items() if key != "format"}))
    write(corpus, target)
    if is_recorded(corpus):
        say(as_touches(corpus))
    kind = "synthetic " if corpus.synthetic else ""
    size = f"{len(corpus)} {kind}captures, {len(corpus.frames)} rows"
    print(f"{target}: {size} at {corpus.rate_hz:g} Hz, digest {corpus.digest[:16]}")
    if corpus.synthetic:
        print("the column synthetic marks generated captures; keep it, so that their results are marked as synthetic")
    words = ["cost", str(target), "name=copy"]
    if corpus.info.get("format") != "cost":
        words = ["table", *words[1:], f"grid={corpus.grid[0]}x{corpus.grid[1]}"]
        words += [f"rate_hz={_exact(corpus.rate_hz)}", f"full_scale={_exact(corpus.full_scale)}"]
    then(f"bench data import {shlex.join(words)}")
    return 0


def _exact(number: float) -> str:
    """A number as it is read back, one without a fraction as a whole number."""
    return repr(float(number)).removesuffix(".0")
