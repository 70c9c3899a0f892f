"""The command ``bench data``: list, import, show, verify and export corpora."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd

from bench import contract
from bench.commands.declarations import EXPORT_OPTIONS, GET_OPTIONS, SHOW_OPTIONS
from bench.commands.printing import print_lines, print_next_commands, refuse_unwritable
from bench.corpora.corpus import Corpus
from bench.corpora.doubts import doubt_spellings
from bench.corpora.folder import content_digest
from bench.corpora.library import (
    ASIDE,
    find_corpus_damage,
    first_warnings,
    import_corpus,
    imported_names,
    left_out_message,
    name_import,
    open_corpus,
    open_imported,
)
from bench.corpora.read.cost import write_cost
from bench.corpora.read.table import write_table
from bench.corpora.sources import Source
from bench.corpora.survey import Survey
from bench.errors import InputError, suggest_names
from bench.grammar.options import parse_arguments, typed_settings
from bench.ground.progress import warn
from bench.ground.registry import load_part, load_parts, registered_parts
from bench.ground.scratch import data_folder
from bench.ground.typed import DEFAULTS, SMALL_SYSTEM, Values
from bench.plan.grid import expand_corpus_parameters, make_cells, make_skins
from bench.plan.plan import load_captures
from bench.protocols.captures import CaptureKFold
from bench.values.result import format_count

GET_KEYS = [option.key for option in GET_OPTIONS]
ACTIONS = ("get", "import", "show", "verify", "export")


def command(arguments: list[str]) -> int:
    """List the corpora, or download, import, show, verify or export one."""
    match arguments:
        case []:
            return _list_corpora()
        case ["get"]:
            return _list_sources()
        case ["get", name, *rest] if "=" not in name:
            return _get_corpus(name, parse_arguments(rest, None))
        case ["import", kind, file, *rest]:  # the reader knows its options
            return import_and_print(kind, Path(file), parse_arguments(rest, None))
        case ["show", name, *rest] if "=" not in name:
            return _show_corpus(name, parse_arguments(rest, None))
        case ["verify", name]:
            return _verify_corpus(name)
        case ["export", name, file, *rest]:
            return _export_corpus(name, Path(file), parse_arguments(rest, None))
        case ["show", *_]:
            names = ", ".join(["synth", *imported_names()])
            raise InputError(f"bench data show: give the name of a corpus: {names}")
        case [name, *_] if name in ("synth", *imported_names()):
            example = f"bench data show {name}"
            raise InputError(f"bench data {name}: an action is missing; give for example {example}")
        case [word, *_] if word not in ACTIONS:
            advice = suggest_names(word, ACTIONS)
            raise InputError(f"bench data {word}: {advice}; see bench data --help")
    words = " ".join(arguments)
    raise InputError(f"bench data {words}: not an action with its arguments; see bench data --help")


def _list_corpora() -> int:
    """Print every corpus with counts, digest, source and licence."""
    print(
        f"Corpora in {data_folder()}\n\nsynth\n  synthetic: generated on demand, any number of "
        "subjects and repetitions; says nothing about people"
    )
    for name in imported_names():
        try:
            corpus = open_imported(name)
        except InputError as e:
            print(f"{name}\n  {e}")
            continue
        columns = [str(column) for column in corpus.captures]
        conditions = ", ".join(c for c in columns if c not in ("subject", "gesture"))
        print(
            f"{name}\n  {_describe_size(corpus)}\n  columns: {conditions}\n"
            f"  digest:  {corpus.digest[:16]}\n  source:  {corpus.info.get('source', '')}\n"
            f"  licence: {corpus.info.get('licence', '')}"
        )
    print()
    print_next_commands(f"bench data show {[*imported_names(), 'synth'][0]}")
    return 0


def _describe_size(corpus: Corpus) -> str:
    """Numbers of captures, subjects, gestures and frames."""
    gestures = corpus.gestures[~np.isin(corpus.gestures, corpus.info.get(ASIDE, []))]
    kind = "synthetic " if corpus.synthetic else ""
    return (
        f"{len(gestures)} {kind}captures, {len(set(corpus.subjects))} subjects, "
        f"{len(set(gestures))} gestures, {len(corpus.frames)} frames of "
        f"{corpus.grid[0]}x{corpus.grid[1]} at {corpus.rate_hz:g} Hz"
    )


def _show_corpus(name: str, values: dict[str, str]) -> int:
    """Print what a corpus holds, and draw it."""
    settings = typed_settings("data", values, SHOW_OPTIONS)
    out = Path(settings["out"])
    parameters = {key: value for key, value in values.items() if key not in settings}
    corpus = load_selected_captures(name, parameters, settings["where"], settings["target"])
    print(survey_captures(corpus, out))
    if name in imported_names():
        if line := left_out_message(open_corpus(name, {})):
            print(f"\n{line}")
        imported = open_imported(name)  # an earlier version may have had fewer doubts
        if warnings := dict.fromkeys([*doubt_spellings(imported), *imported.info["warnings"]]):
            print(f"\nWarnings of the import: {len(warnings)}", *warnings, sep="\n  ")
    page = Path(out, "index.html").resolve().as_uri()
    print(f"\nfigures and a page that shows them; open: {page}")
    if protocol := _possible_protocol(load_selected_captures(name, parameters)):
        print_next_commands(f"bench run data={name} protocol={protocol} {SMALL_SYSTEM}")
    return 0


def _possible_protocol(corpus: Corpus) -> str:
    """A protocol for which a corpus has enough gestures, subjects or captures, or ""."""
    if len({*corpus.gestures}) < 2:
        return ""
    if len({*corpus.subjects}) > 1:
        return "loso"
    fewest = int(np.unique(corpus.gestures, return_counts=True)[1].min())
    if fewest < 2:
        return ""
    return "kfold" if fewest >= CaptureKFold().folds else f"kfold protocol.folds={fewest}"


def load_selected_captures(
    name: str, parameters: Mapping[str, object], where: str = "", target: str = "gesture"
) -> Corpus:
    """Load the captures of a corpus that satisfy a condition.

    ``parameters`` are those of the generator, with or without ``data.`` before them, and of a
    designed skin (``skin.grid``), which learns ``skin.range=auto`` from these captures.
    """
    dotted: dict[str, object] = {}
    typed = {key.replace("__", "."): value for key, value in parameters.items()}
    of_skin = {key: value for key, value in typed.items() if key.partition(".")[0] == "skin"}
    for key, value in typed.items():
        if key in of_skin:
            continue
        if (full_key := f"data.{key.removeprefix('data.')}") in dotted:
            raise InputError(f"{key}= is given twice; give it once")
        dotted[full_key] = value
    combination, *others = expand_corpus_parameters(dotted, name, [name])
    skin, *other_skins = make_skins(of_skin)
    if others or other_skins:
        raise InputError("give one value of each parameter; a tuple is one value, a list several")
    design = skin.make_object() if skin else None
    corpus = load_captures(name, combination, where, target, design)
    return design.fit_range(corpus, np.arange(len(corpus))) if design else corpus


def survey_captures(corpus: Corpus, out: Path | None) -> Survey:
    """Survey captures, and draw them into a folder if one is given."""
    from bench.reports.corpus_page import write_page

    survey = Survey(corpus)
    if out is not None:
        with refuse_unwritable(out):
            out.mkdir(parents=True, exist_ok=True)
            write_page(survey, out)
    return survey


def _list_sources() -> int:
    """Print what can be downloaded, and what is imported of it."""
    sources = load_parts("sources")
    for name, source in sources.items():
        state = "imported" if name in imported_names() else f"bench data get {name}"
        print(
            f"{name}: {source.contents}\n  {state}\n  size:    {source.size}\n"
            f"  licence: {source.licence}\n  paper:   {source.paper}\n"
            f"  from:    {source.address}\n  page:    {source.page}"
        )
    print()
    missing = [name for name in sources if name not in imported_names()]
    print_next_commands(f"bench data get {missing[-1]}" if missing else "bench data")
    return 0


def _get_corpus(name: str, values: dict[str, str]) -> int:
    """Download, verify and import a published corpus."""
    from bench.corpora import cuts
    from bench.corpora.download import advise_by_hand, download_source

    if name not in (known := registered_parts("sources")):
        raise InputError(f"bench data get {name[:60]}: {suggest_names(name[:60], known)}")
    source: Source = load_part("sources", name)
    keys = typed_settings("data", {k: v for k, v in values.items() if k in GET_KEYS}, GET_OPTIONS)
    options = {key: value for key, value in values.items() if key not in GET_KEYS}
    for key in options:
        if key not in ("name", *cuts.OPTIONS):
            hint = suggest_names(key, {"name", *cuts.OPTIONS, *GET_KEYS})
            raise InputError(f"bench data get has no key {key!r}; {hint}")
    if source.must_accept and not keys["accept"]:
        raise InputError(
            f"{name} has the licence {source.licence} ({source.page}); if you accept it, give "
            "accept=yes"
        )
    print(f"{name}: licence {source.licence}; cite {source.paper}")

    def check_release(corpus: Corpus) -> None:
        differences = list(corpus.info["warnings"])
        if source.digest and not content_digest(corpus).startswith(source.digest):
            differences.append("other readings than the published ones")
        if differences:
            shown = first_warnings(differences, "bench data show")
            raise InputError(f"{source.file} is not the published corpus: {shown}")

    file = download_source(source, name, keys["address"])
    try:
        code = import_and_print(name, file, options, check_release)
    except InputError as e:
        if isinstance(e.__cause__, OSError):  # the disk's fault, or another import is under way
            raise
        file.unlink()
        raise InputError(f"{name}: after the download, {e}; {advise_by_hand(source, name)}") from e
    file.unlink()
    return code


def import_and_print(
    kind: str,
    file: Path,
    values: dict[str, str],
    check: Callable[[Corpus], None] | None = None,
) -> int:
    """Import a corpus; print its warnings, the corpus that it replaces, and its contents."""
    before = None
    with suppress(InputError):  # nothing is stored, or it is damaged
        before = open_imported(name_import(kind, values))
    corpus = import_corpus(kind, file, values, check)
    show = f"bench data show {corpus.name}"
    if warnings := corpus.info["warnings"]:
        print(f"warning: {first_warnings(warnings, show)}", file=sys.stderr)
    if before and before.digest != corpus.digest:
        print(f"{corpus.name}: replaces {len(before)} captures, digest {before.digest[:16]}")
    print(f"{corpus.name}: {_describe_size(corpus)}, digest {corpus.digest[:16]}")
    minutes = corpus.lengths / corpus.rate_hz / 60
    gestures_aside = corpus.info.get(ASIDE, [])
    for gesture in gestures_aside:
        is_gesture = corpus.gestures == gesture
        if is_gesture.any():
            count = format_count(int(is_gesture.sum()), "capture")
            print(
                f"{gesture}: further {count} without a gesture, {minutes[is_gesture].sum():.3g} of "
                f"{minutes.sum():.3g} minutes"
            )
    lengths = corpus.lengths[~np.isin(corpus.gestures, gestures_aside)]
    if len(lengths):
        print(
            f"the median capture lasts {float(np.median(lengths)) / corpus.rate_hz:.2g} s; if that "
            "looks wrong, rate_hz and all reported times are wrong"
        )
    print_next_commands(show)
    return 0


def _verify_corpus(name: str) -> int:
    """Print whether each file of a stored corpus is unchanged; exit code 1 if one is not."""
    files = find_corpus_damage(name)
    width = max(map(len, files), default=0)
    for file, damage in files.items():
        state = f"damaged: {damage.removeprefix(f'{file} ')}" if damage else "unchanged"
        print(f"{file:{width}}  {state}")
    if any(files.values()):
        advice = "its next use repairs it" if name == "synth" else "import it again"
        print(f"{name}: damaged; {advice}")
        return 1
    print(f"{name}: {'unchanged' if files else 'nothing is stored'}")
    return 0


def _export_corpus(name: str, file: Path, values: dict[str, str]) -> int:
    """Write a corpus in the format of CoST.csv, or as a table."""
    if not file.name or (file.exists() and not file.is_file()):  # such as a pipe, which would wait
        raise InputError(f"{file} cannot be written (it is not a plain file); name a file")
    given_format = typed_settings("data", values, EXPORT_OPTIONS)["format"]
    parameters = {key: value for key, value in values.items() if key != "format"}
    corpus = load_selected_captures(name, parameters)
    is_cost = corpus.info.get("format") == "cost"
    if given_format == "cost" or (not given_format and (is_cost or name == "synth")):
        write_cost(corpus, file)
    else:
        write_table(corpus, file)
    if line := left_out_message(corpus):
        print_lines(line)
    kind = "synthetic " if corpus.synthetic else ""
    size = f"{len(corpus)} {kind}captures, {len(corpus.frames)} rows"
    print(f"{file}: {size} at {corpus.rate_hz:g} Hz, digest {corpus.digest[:16]}")
    if corpus.synthetic:
        print(
            "the column synthetic marks generated captures; keep it, so that their results are "
            "marked as synthetic"
        )
    words = ["cost", str(file), "name=copy"]
    if not is_cost:
        layout = {"grid": "x".join(map(str, corpus.grid))}
        for key, number in (("rate_hz", corpus.rate_hz), ("full_scale", corpus.full_scale)):
            layout[key] = repr(float(number)).removesuffix(".0")
        words = ["table", *words[1:], *(f"{key}={value}" for key, value in layout.items())]
    print_next_commands(f"bench data import {shlex.join(words)}")
    return 0


def extract_features(values: Values) -> pd.DataFrame:
    """Extract the features of all captures; beside them their subject, gesture and conditions."""
    cell, *others = make_cells({**values, "model": DEFAULTS["model"]})
    if others:
        raise InputError("bench.extract makes one table; give one value of each key")
    corpus = load_captures(cell.data, cell.data_parameters, cell.where, cell.target)
    (feature_set,) = cell.feature_sets().values()
    contract.check_parameters(feature_set)
    features = feature_set.fit(corpus, corpus.gestures).transform(corpus)
    if both := sorted({*corpus.captures.columns} & {*features.columns}):
        raise InputError(
            f"{corpus.name} has a column {both[0]!r}, also a feature; rename it and import again"
        )
    if line := left_out_message(corpus):
        warn(line)
    return pd.concat([corpus.captures, features], axis=1)
