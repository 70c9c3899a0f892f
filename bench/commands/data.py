"""The command ``bench data``: corpora listed, imported, looked at, verified and exported."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from bench.corpora.cost import write
from bench.corpora.library import import_corpus, imported, open_corpus, overview, verify
from bench.corpora.survey import Survey, survey
from bench.errors import InputError, nearest
from bench.outcomes.advice import FIRST
from bench.plan.arguments import convert, typed
from bench.plan.cells import corpus_variants
from bench.plan.plan import captures_of
from bench.scratch import home

ACTIONS = ("import", "show", "verify", "export")
OUT = "look"


def data(arguments: list[str]) -> int:
    """List what is here, import a corpus, look at, verify or export one.

    Raises:
        InputError: something in the arguments or the files cannot be used.
    """
    match arguments:
        case []:
            return listed()
        case ["import", kind, source, *options]:
            return read(kind, Path(source), _options(options))
        case ["show", name, *options] if "=" not in name:
            return show(name, _options(options))
        case ["show", *_]:
            raise InputError(f"bench data show: say which corpus, as in bench data show synth; known: {_known()}")
        case ["verify", name]:
            return check(name)
        case ["export", name, target, *options]:
            return export(name, Path(target), _options(options))
        case [name, *_] if name in ("synth", *imported()):
            raise InputError(f"bench data {name}: say what to do with it, such as bench data show {name}")
        case [word, *_] if word not in ACTIONS:
            raise InputError(f"bench data {word}: {nearest(word, ACTIONS)}; see bench data --help")
    raise InputError(f"bench data {' '.join(arguments)}: not understood; see bench data --help")


def _known() -> str:
    return ", ".join(["synth", *imported()])


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


def listed() -> int:
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
    print(f"\nnext: bench data show {(imported() or ['synth'])[0]}")
    return 0


def show(name: str, options: dict[str, str]) -> int:
    """Print what a corpus holds, and draw it."""
    out, where = Path(options.pop("out", OUT)), options.pop("where", "")
    found = looked(name, where, out, options.pop("capture", None), dict(options))
    print(found)
    print(f"\nfigures, an animation and a page that holds them all; open: {(out / 'index.html').resolve().as_uri()}")
    on = {"data": name} | {f"data.{k.removeprefix('data.')}": v for k, v in options.items()}
    if where:
        on["where"] = where
    print(f"next: {typed('run', on | {'protocol': 'loso'} | FIRST)}")
    return 0


def looked(name: str, where: str, out: Path | None, capture: object, parameters: dict[str, object]) -> Survey:
    """A survey of the captures of a corpus, drawn into a folder if one is given.

    Args:
        name: of the corpus.
        where: captures to look at.
        out: folder for the figures, or None.
        capture: the one to animate, by its position in the whole corpus; None for one of each gesture.
        parameters: of ``synth``.

    Raises:
        InputError: the corpus is not here, something in the values cannot be used, or the folder cannot be written.
    """
    from bench.commands.printing import writable
    from reports.look import place, write

    number = None if capture is None else convert("capture", capture, 0)
    corpus = captures_of(name, one_variant(name, parameters), where, "gesture")
    if number is not None:
        place(corpus, number)
    if out is not None:
        writable(out)
    found = survey(corpus)
    if out is not None:
        try:
            write(corpus, found, out, number)
        except (PermissionError, IsADirectoryError) as e:
            raise InputError(f"out={out}: {e.filename} cannot be written ({e.strerror}); choose another folder") from e
    return found


def one_variant(name: str, parameters: dict[str, object]) -> dict[str, object]:
    """Parameters of the generator as they are typed, with or without ``data.``, and its defaults.

    Raises:
        InputError: one that is not known, is given twice, or has several values.
    """
    given: dict[str, object] = {}
    for key, value in parameters.items():
        if (full := f"data.{key.removeprefix('data.')}") in given:
            raise InputError(f"{key}= is given twice; give it once")
        given[full] = value
    variant, *more = corpus_variants(given, name, [name])
    if more:
        raise InputError("one corpus at a time; give one value of each parameter")
    return variant


def read(kind: str, source: Path, options: dict[str, str]) -> int:
    """Import a corpus, with a line for every warning and one for what was found."""
    corpus = import_corpus(kind, source, options)
    for line in corpus.info["warnings"]:
        print(f"warning: {line}", file=sys.stderr)
    print(
        f"{corpus.name}: {len(corpus)} captures, {len(set(corpus.subjects))} subjects, "
        f"{len(set(corpus.gestures))} gestures, {len(corpus.frames)} frames of {corpus.grid[0]}x{corpus.grid[1]} "
        f"at {corpus.rate_hz:g} Hz, digest {corpus.digest[:16]}\nnext: bench data show {corpus.name}"
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
    corpus = open_corpus(name, one_variant(name, dict(options)))
    write(corpus, target)
    kind = "synthetic " if corpus.synthetic else ""
    print(f"{target}: {len(corpus)} {kind}captures, {len(corpus.frames)} rows, digest {corpus.digest[:16]}")
    print(f"next: bench data import cost {shlex.quote(str(target))} name=copy")
    return 0
