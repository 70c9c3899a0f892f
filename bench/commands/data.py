"""The command ``bench data``: corpora listed, imported, verified and exported."""

from __future__ import annotations

import sys
from pathlib import Path

from bench.corpora.cost import write
from bench.corpora.library import import_corpus, open_corpus, overview, verify
from bench.errors import InputError
from bench.plan.cells import corpus_variants
from bench.scratch import home


def data(arguments: list[str]) -> int:
    """List what is here, import a corpus, verify or export one.

    Raises:
        InputError: something in the arguments or the files cannot be used.
    """
    match arguments:
        case []:
            return show()
        case ["import", kind, source, *options]:
            return read(kind, Path(source), _options(options))
        case ["verify", name]:
            return check(name)
        case ["export", name, target, *options]:
            return export(name, Path(target), _options(options))
    raise InputError(f"bench data {' '.join(arguments)}: not understood; see bench data --help")


def _options(arguments: list[str]) -> dict[str, str]:
    options = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if not equals or not key or not value:
            raise InputError(f"{argument!r} is not key=value; see bench data --help")
        if key in options:
            raise InputError(f"{key}= is given twice; give it once")
        options[key] = value
    return options


def show() -> int:
    """Print every corpus with counts, digest, source and licence."""
    print(f"Corpora in {home()}\n")
    print("synth\n  generated on demand, any number of subjects and repetitions; synthetic, says nothing about people")
    for row in overview():
        if "damaged" in row:
            print(f"{row['data']}\n  {row['damaged']}")
            continue
        print(
            f"{row['data']}\n  {row['captures']} captures, {row['subjects']} subjects, {row['gestures']} gestures, "
            f"{row['frames']} frames of {row['grid']} at {row['rate_hz']:g} Hz\n  columns: {row['columns']}\n"
            f"  digest:  {row['digest']}\n  source:  {row['source']}\n  licence: {row['licence']}"
        )
    return 0


def read(kind: str, source: Path, options: dict[str, str]) -> int:
    """Import a corpus, with a line for every warning and one for what was found."""
    corpus = import_corpus(kind, source, options)
    for line in corpus.info["warnings"]:
        print(f"warning: {line}", file=sys.stderr)
    print(
        f"{corpus.name}: {len(corpus)} captures, {len(set(corpus.subjects))} subjects, "
        f"{len(set(corpus.gestures))} gestures, {len(corpus.frames)} frames of {corpus.grid[0]}x{corpus.grid[1]} "
        f"at {corpus.rate_hz:g} Hz, digest {corpus.digest[:16]}"
    )
    return 0


def check(name: str) -> int:
    """Print a line for every file of a stored corpus, read anew, and whether it is what was stored."""
    files = verify(name)
    width = max(map(len, files), default=0)
    for file, wrong in files.items():
        told = f"damaged: {wrong.removeprefix(f'{file} ')}" if wrong else "as it was stored"
        print(f"{file:{width}}  {told}")
    if any(files.values()):
        print(f"{name}: damaged; " + ("generated again when it is used" if name == "synth" else "import it again"))
        return 1
    print(f"{name}: {'as it was stored' if files else 'nothing is stored'}")
    return 0


def export(name: str, target: Path, options: dict[str, str]) -> int:
    """Write a corpus in the format of CoST.csv."""
    if (form := options.pop("format", "cost")) != "cost":
        raise InputError(f"format={form}: only format=cost can be written")
    variants = corpus_variants({f"data.{k}": v for k, v in options.items()}, name, [name])
    if len(variants) > 1:
        raise InputError("bench data export writes one corpus; give one value of each parameter")
    corpus = open_corpus(name, variants[0])
    write(corpus, target)
    kind = "synthetic " if corpus.synthetic else ""
    print(f"{target}: {len(corpus)} {kind}captures, {len(corpus.frames)} rows, digest {corpus.digest[:16]}")
    return 0
