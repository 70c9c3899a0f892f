"""The actions of ``bench data``: corpora listed, imported, looked at, verified and exported."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from bench.commands.printing import print_lines, print_next_commands, refuse_unwritable
from bench.corpora.corpus import Corpus
from bench.corpora.library import (
    ASIDE,
    find_corpus_damage,
    first_warnings,
    import_corpus,
    imported_names,
    left_out_message,
    open_corpus,
    open_imported,
)
from bench.corpora.read.cost import write_cost
from bench.corpora.read.table import write_table
from bench.corpora.survey import Survey
from bench.errors import InputError
from bench.ground.scratch import data_folder
from bench.ground.typed import SMALL_SYSTEM
from bench.plan.grid import expand_corpus_parameters
from bench.plan.plan import load_captures
from bench.protocols.captures import CaptureKFold
from bench.values.result import format_count


def list_corpora() -> int:
    """Print every corpus with counts, digest, source and licence."""
    print(f"Corpora in {data_folder()}\n")
    print(
        "synth\n  synthetic: generated on demand, any number of subjects and repetitions; says nothing about people"
    )
    for name in imported_names():
        try:
            corpus = open_imported(name)
        except InputError as e:
            print(f"{name}\n  {e}")
            continue
        columns = ", ".join(str(c) for c in corpus.captures if c not in ("subject", "gesture"))
        print(f"{name}\n  {_sizes(corpus)}\n  columns: {columns}\n  digest:  {corpus.digest[:16]}")
        print(
            f"  source:  {corpus.info.get('source', '')}\n  licence: {corpus.info.get('licence', '')}"
        )
    print()
    print_next_commands(f"bench data show {(imported_names() or ['synth'])[0]}")
    return 0


def _sizes(corpus: Corpus) -> str:
    gestures = corpus.gestures[~np.isin(corpus.gestures, corpus.info.get(ASIDE, []))]
    kind = "synthetic " if corpus.synthetic else ""
    return (
        f"{len(gestures)} {kind}captures, {len(set(corpus.subjects))} subjects, {len(set(gestures))} gestures, "
        f"{len(corpus.frames)} frames of {corpus.grid[0]}x{corpus.grid[1]} at {corpus.rate_hz:g} Hz"
    )


def show_corpus(name: str, values: dict[str, str], given: dict[str, Any]) -> int:
    """Print what a corpus holds, and draw it."""
    out = Path(given["out"])
    parameters = {key: value for key, value in values.items() if key not in given}
    corpus = load_selected_captures(name, parameters, given["where"], given["target"])
    print(survey_captures(corpus, out))
    if name in imported_names() and (line := left_out_message(open_corpus(name, {}))):
        print(f"\n{line}")
    if warnings := [] if name == "synth" else open_imported(name).info["warnings"]:
        print(f"\nWarnings of the import: {len(warnings)}", *warnings, sep="\n  ")
    print(
        f"\nfigures and a page that shows them; open: {Path(out, 'index.html').resolve().as_uri()}"
    )
    if protocol := _protocol(load_selected_captures(name, parameters)):
        print_next_commands(f"bench run data={name} protocol={protocol} {SMALL_SYSTEM}")
    return 0


def _protocol(corpus: Corpus) -> str:
    """A protocol that a corpus has enough captures for; empty if there is none."""
    fewest = int(np.unique(corpus.gestures, return_counts=True)[1].min())
    if len({*corpus.subjects}) > 1:
        return "loso"
    return (
        ""
        if fewest < 2
        else "kfold"
        if fewest >= CaptureKFold().folds
        else f"kfold protocol.folds={fewest}"
    )


def load_selected_captures(
    name: str, parameters: Mapping[str, object], where: str = "", target: str = "gesture"
) -> Corpus:
    """Some captures of a corpus; parameters are those of the generator, with or without ``data.``."""
    dotted: dict[str, object] = {}
    for key, value in parameters.items():
        if (full := f"data.{key.removeprefix('data.')}") in dotted:
            raise InputError(f"{key}= is given twice; give it once")
        dotted[full] = value
    variant, *more = expand_corpus_parameters(dotted, name, [name])
    if more:
        raise InputError("give one value of each parameter; a tuple is one value, a list several")
    return load_captures(name, variant, where, target)


def survey_captures(corpus: Corpus, out: Path | None) -> Survey:
    """Survey captures, and draw them if a folder is given."""
    from bench.reports.corpus_page import write_page as draw

    found = Survey(corpus)
    if out is not None:
        with refuse_unwritable(writable(out)):
            draw(found, out)
    return found


def import_and_print(kind: str, source: Path, values: dict[str, str]) -> int:
    """Import a corpus; print its warnings, the corpus it replaces, and its contents."""
    before = None
    with suppress(InputError):  # nothing is stored, or it is damaged
        before = open_imported(values.get("name", kind))
    corpus = import_corpus(kind, source, values)
    if corpus.info["warnings"]:
        print(
            f"warning: {first_warnings(corpus.info['warnings'], f'bench data show {corpus.name}')}",
            file=sys.stderr,
        )
    if before and before.digest != corpus.digest:
        print(f"{corpus.name}: replaces {len(before)} captures, digest {before.digest[:16]}")
    aside_gestures = corpus.info.get(ASIDE, [])
    print(f"{corpus.name}: {_sizes(corpus)}, digest {corpus.digest[:16]}")
    for gesture in aside_gestures:
        if (aside := corpus.gestures == gesture).any():
            minutes = [
                frames.sum() / corpus.rate_hz / 60
                for frames in (corpus.lengths[aside], corpus.lengths)
            ]
            count = format_count(int(aside.sum()), "capture")
            print(
                f"{gesture}: further {count} without a gesture, {minutes[0]:.3g} of {minutes[1]:.3g} minutes"
            )
    if len(lengths := corpus.lengths[~np.isin(corpus.gestures, aside_gestures)]):
        usual = f"{float(np.median(lengths)) / corpus.rate_hz:.2g} s"
        print(
            f"the median capture lasts {usual}; if that looks wrong, rate_hz and all reported times are wrong"
        )
    print_next_commands(f"bench data show {corpus.name}")
    return 0


def verify_corpus(name: str) -> int:
    """Print a line for every file of a stored corpus, read anew and compared with the stored digest."""
    files = find_corpus_damage(name)
    width = max(map(len, files), default=0)
    for file, damage in files.items():
        state = f"damaged: {damage.removeprefix(f'{file} ')}" if damage else "unchanged"
        print(f"{file:{width}}  {state}")
    if any(files.values()):
        print(
            f"{name}: damaged; "
            + ("its next use repairs it" if name == "synth" else "import it again")
        )
        return 1
    print(f"{name}: {'unchanged' if files else 'nothing is stored'}")
    return 0


def export_corpus(name: str, target: Path, values: dict[str, str]) -> int:
    """Write a corpus in the format of CoST.csv, or as a table."""
    corpus = load_selected_captures(
        name, {key: value for key, value in values.items() if key != "format"}
    )
    cost = (
        values.get(
            "format", "cost" if name == "synth" or corpus.info.get("format") == "cost" else "table"
        )
        == "cost"
    )
    (write_cost if cost else write_table)(corpus, target)
    if line := left_out_message(corpus):
        print_lines(line)
    kind = "synthetic " if corpus.synthetic else ""
    size = f"{len(corpus)} {kind}captures, {len(corpus.frames)} rows"
    print(f"{target}: {size} at {corpus.rate_hz:g} Hz, digest {corpus.digest[:16]}")
    if corpus.synthetic:
        print(
            "the column synthetic marks generated captures; keep it, so that their results are marked as synthetic"
        )
    words = ["cost", str(target), "name=copy"]
    if corpus.info.get("format") != "cost":
        rate, most = (
            repr(float(number)).removesuffix(".0") for number in (corpus.rate_hz, corpus.full_scale)
        )
        grid = "x".join(map(str, corpus.grid))
        words = ["table", *words[1:], f"grid={grid}", f"rate_hz={rate}", f"full_scale={most}"]
    print_next_commands(f"bench data import {shlex.join(words)}")
    return 0
