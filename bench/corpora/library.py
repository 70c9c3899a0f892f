"""Imported corpora in the user's data folder, and the generated one.

``corpora/<name>/<digest>`` holds a corpus, ``corpora/<name>/current`` the digest that the name
stands for. Both are written under other names and then renamed, so that a kill leaves the old
corpus or the new one.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from bench.corpora.corpus import Corpus
from bench.corpora.folder import (
    DamagedCorpus,
    content_digest,
    damaged_error,
    find_damage,
    open_folder,
    read_small_file,
    write_folder,
)
from bench.errors import InputError, one_line, suggest_names
from bench.ground.closed import refuse_closed
from bench.ground.registry import load_part, registered_parts
from bench.ground.scratch import data_folder, remove_path, write_then_rename

ASIDE = "aside"  # in a corpus's info: classes of captures without a gesture, which runs leave out
UNTAUGHT = "untaught"  # classes that teach nothing, and so may be tested without training
NAME = "[A-Za-z0-9][A-Za-z0-9_-]{0,99}"


def import_corpus(
    kind: str,
    source: Path,
    options: dict[str, str],
    check: Callable[[Corpus], None] | None = None,
) -> Corpus:
    """Read a file and store it under the option ``name``; if that fails, an earlier corpus stays.

    Args:
        kind: format, of `bench.corpora.PARTS` or of an add-on.
        source: file, folder or archive.
        options: ``name``, options of the reader, and changes (`bench.corpora.cuts.OPTIONS`).
        check: refuses what was read, before changes, by an `InputError`.

    Raises:
        InputError: the file or an option does not fit, or the data folder cannot be written.
    """
    from bench.corpora import cuts

    changes = {key: options[key] for key in cuts.OPTIONS if key in options}
    name = name_import(kind, options)
    if not re.fullmatch(NAME, name):
        raise InputError(f"name={name[:60]}: use letters, digits, - and _, at most 100")
    if name == "synth":
        raise InputError("name=synth is the generated corpus; choose another name")
    reader = load_part("corpora", kind)
    arguments = _reader_arguments(kind, reader, options, source)
    with _lock_name(name):
        corpus = _read_and_change(kind, reader, source, arguments, changes, check)
        info = corpus.info | {"format": kind, "warnings": _import_warnings(corpus)}
        return _store(corpus.with_fields(name=name, info=info))


def name_import(kind: str, options: dict[str, str]) -> str:
    """The name under which a file of a format is imported."""
    is_aligned = options.get("align", "no") not in ("no", "false")
    return options.get("name", f"{kind}-aligned" if is_aligned else kind)


@contextmanager
def _lock_name(name: str) -> Iterator[None]:
    """Refuse another import under a name meanwhile."""
    corpora = data_folder() / "corpora"
    path = corpora / f".{name}.lock"
    lock = FileLock(path, timeout=0)
    try:
        corpora.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as e:
        advice = "wait for it or choose another name="
        raise InputError(f"another import of name={name} is under way; {advice}") from e
    except OSError as e:
        place = path if path.exists() else corpora / name  # of another user
        raise _unwritable_error(place, e) from e
    try:
        yield
    finally:
        lock.release()


def _read_and_change(
    kind: str,
    reader: Callable,
    source: Path,
    arguments: dict[str, object],
    changes: dict[str, str],
    check: Callable[[Corpus], None] | None,
) -> Corpus:
    """Read a file, check it, and make the changes of `bench.corpora.cuts.OPTIONS`."""
    from bench.corpora import cuts

    try:
        corpus = reader(source, **arguments)
    except OSError as e:
        raise InputError(
            f"{one_line(source, 160)}: cannot be read ({e.strerror or e}); check the path"
        ) from e
    if check:
        check(corpus)
    if changes:
        if corpus.info.get(ASIDE):
            raise InputError(f"{next(iter(changes))}=: {kind} is imported whole; leave it out")
        unchanged = content_digest(corpus)
        corpus = cuts.apply_changes(corpus, kind, changes)
        corpus = corpus.with_fields(info=corpus.info | {"unchanged": unchanged})
    return corpus


def _reader_arguments(
    kind: str, reader: Callable, options: dict[str, str], source: Path
) -> dict[str, object]:
    """Options of a reader, as the types that its signature names."""
    from bench.corpora.cuts import OPTIONS

    _, *parameters = inspect.signature(reader, eval_str=True).parameters.values()
    types = {parameter.name: parameter.annotation for parameter in parameters}
    arguments: dict[str, object] = {}
    for key, text in options.items():
        if key in ("name", *OPTIONS):
            continue
        if key not in types:
            hint = suggest_names(key, {"name", *OPTIONS, *types})
            raise InputError(f"format {kind} has no option {key!r}; {hint}")
        try:
            arguments[key] = float(text) if types[key] is float else text
        except ValueError as e:
            raise InputError(f"{key}={text}: give a number") from e
    required = [p.name for p in parameters if p.default is inspect.Parameter.empty]
    if missing := [f"{key}=" for key in required if key not in arguments]:
        if not os.path.lexists(source):  # what is asked for would not help
            place = one_line(source, 160)
            raise InputError(f"{place}: there is no such file; give the path of a file")
        raise InputError(f"format {kind} also needs {', '.join(missing)}")
    return arguments


def _import_warnings(corpus: Corpus) -> list[str]:
    """Warnings of a reader, and what looks wrong with its captures."""
    from bench.corpora.doubts import find_doubts
    from bench.corpora.survey import Survey

    touches = corpus[~np.isin(corpus.gestures, corpus.info.get(ASIDE, []))]
    repeats = Survey(corpus).repeat_warnings()
    return [*repeats, *find_doubts(touches), *corpus.info.get("warnings", [])]


def _store(corpus: Corpus) -> Corpus:
    """Store a corpus under its locked name, in place of an earlier one, and map it."""
    digest = content_digest(corpus)
    folder = data_folder() / "corpora" / corpus.name
    pointer, stored = folder / "current", folder / digest[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_folder(corpus, stored, digest)
        if os.path.lexists(pointer) and (pointer.is_symlink() or not pointer.is_file()):
            remove_path(pointer)  # a link's file is not ours
        with write_then_rename(pointer) as beside:
            beside.write_text(stored.name)
        for old in folder.iterdir():  # the name is locked, so nobody else writes here
            if old not in (pointer, stored):
                remove_path(old)
    except OSError as e:
        raise _unwritable_error(folder, e) from e
    return open_folder(stored)


def _unwritable_error(folder: Path, error: OSError) -> InputError:
    reason = one_line(error.strerror or f"no space is left: {error}")  # of numpy's files
    advice = "set TOUCHBENCH_HOME to a folder that can"
    return InputError(f"{one_line(folder, 150)} cannot be written ({reason}); {advice}")


def open_corpus(
    name: str, parameters: Mapping[str, Any], design: Any = None, also: str = ""
) -> Corpus:
    """Open the captures with a gesture of a corpus.

    Args:
        name: an imported corpus, several joined by ``+``, or ``synth``.
        parameters: those of `bench.corpora.synth.generate`.
        design: a skin that measures them (`bench.corpora.skin`); None for the recorded one.
        also: imported corpora, joined by ``+``, whose captures follow for training alone.

    Raises:
        InputError: there is no such corpus, it is damaged, has no capture with a gesture, or is
            opened by the code of a system.
    """
    refuse_closed(name)
    if "+" in name:
        corpus = _open_joined(name)
    elif name == "synth":
        from bench.corpora import synth

        corpus = make_once("synth", parameters, lambda: synth.generate(**parameters), synth)
    else:
        corpus = open_imported(name)
    corpus = _open_added(corpus, also) if also else corpus
    return captures_with_gesture(open_designed(corpus, design) if design else corpus)


def open_designed(
    corpus: Corpus, design: Any, convert: Callable[[Any, Corpus], Corpus] | None = None
) -> Corpus:
    """Open a corpus as a skin of a design measures it; ``convert`` may replace its method."""
    from bench.corpora import joined

    convert = convert or type(design).convert
    code = [sys.modules[part.__module__] for part in (type(design), convert)]
    arguments = [corpus.digest, corpus.name, repr(design)]
    return make_once(".skin", arguments, lambda: convert(design, corpus), *code, joined)


def captures_with_gesture(corpus: Corpus) -> Corpus:
    """Captures of a corpus without those of classes that are no gestures, such as background."""
    if not (aside := corpus.info.get(ASIDE)):
        return corpus
    captures = corpus[~np.isin(corpus.gestures, aside)]
    if not len(captures):
        reason = f"all captures are {' or '.join(aside)}; label some with a gesture"
        raise InputError(f"data={corpus.name}: {reason}")
    return captures


def left_out_message(corpus: Corpus) -> str:
    """Message on captures that `captures_with_gesture` has left out, or ``""``."""
    if not (aside := corpus.info.get(ASIDE)):
        return ""
    used = f"{corpus.name}: its {len(corpus)} captures with a gesture are used"
    return f"{used}; {' and '.join(aside)} are left out"


def open_imported(name: str) -> Corpus:
    """Open all that is imported under a name, also captures without a gesture."""
    refuse_closed(name)
    corpus = open_folder(_imported_folder(name))
    if corpus.name != name:
        folder = data_folder() / "corpora" / name
        raise damaged_error(folder, f"it is a copy of {corpus.name[:40]}")
    return corpus


def _imported_folder(name: str) -> Path:
    """Folder of an imported corpus, which its file ``current`` names."""
    folder = data_folder() / "corpora" / name
    if not re.fullmatch(NAME, name) or not os.path.lexists(folder / "current"):
        names = one_line(suggest_names(name[:60], ["synth", *imported_names()]), 150)
        is_published = name in registered_parts("sources")
        command = f"bench data get {name}" if is_published else "bench data import ..."
        advice = f"Import it with: {command}"
        raise InputError(f"data={name[:60]}: not imported; {names}. {advice}")
    try:
        digest = read_small_file(folder / "current", 100).decode(errors="replace").strip()
    except OSError as e:
        raise damaged_error(folder, "current cannot be read") from e
    if not re.fullmatch("[0-9a-f]{16}", digest):
        raise damaged_error(folder, "current names no corpus")
    return folder / digest


def import_digests(data: str) -> str:
    """Digests of imported corpora, joined by +, as they are now; "" unless all are imported."""
    files = [data_folder() / "corpora" / name / "current" for name in data.split("+")]
    try:
        digests = [read_small_file(file, 100).decode(errors="replace") for file in files]
        return "+".join(digest.strip() for digest in digests)
    except (OSError, ValueError):
        return ""


def captures_digest(corpus: Corpus) -> str:
    """Digest of the positions of captures in their corpus: equal for equal subsets."""
    return hashlib.sha256(corpus.index.tobytes()).hexdigest()


def find_corpus_damage(name: str) -> dict[str, str]:
    """Read all files of an imported corpus, or of all generated ones.

    Returns:
        The defect of each file by name, ``""`` for none.
    """
    if "+" in name:
        raise InputError(f"bench data verify {name[:100]}: give one corpus at a time")
    if name == "synth":
        return _find_generated_damage()
    try:
        folder = _imported_folder(name)
    except DamagedCorpus as e:
        return {"current": e.defect}
    defects = {"current": ""} | find_damage(folder)
    if not any(defects.values()):
        try:
            open_imported(name)
        except DamagedCorpus as e:  # such as a copied folder
            defects["corpus.json"] = e.defect
    return defects


def _find_generated_damage() -> dict[str, str]:
    """The defect of each file of all generated corpora."""
    defects = {}
    for folder in sorted((data_folder() / "corpora" / "synth").glob("[0-9a-f]*")):
        if folder.is_dir():
            for file, defect in find_damage(folder).items():
                defects[f"{folder.name}/{file}"] = defect
    return defects


def imported_names() -> list[str]:
    """Names of the imported corpora, sorted."""
    pointers = (data_folder() / "corpora").glob("*/current")
    names = [pointer.parent.name for pointer in pointers if pointer.exists()]
    return sorted(name for name in names if re.fullmatch(NAME, name))


def make_once(
    kind: str, arguments: object, make: Callable[[], Corpus], *code: ModuleType
) -> Corpus:
    """Open a corpus that code makes; make and store it if it is missing or damaged.

    Args:
        kind: folder of such corpora.
        arguments: JSON values on which the corpus depends.
        make: function that makes it.
        code: modules on which it depends.
    """
    source = b"".join(Path(str(module.__file__)).read_bytes() for module in code)
    key = hashlib.sha256(json.dumps(arguments, sort_keys=True).encode() + source).hexdigest()[:16]
    folder = data_folder() / "corpora" / kind / key
    try:
        return open_folder(folder)
    except InputError:
        corpus = make()
    try:
        write_folder(corpus, folder)
    except OSError as e:
        raise _unwritable_error(folder, e) from e
    return open_folder(folder)


def _open_added(corpus: Corpus, also: str) -> Corpus:
    """A corpus with the captures of others, for training alone."""
    from bench.corpora import joined, spellings

    names = also.split("+")
    if len(set(names)) < len(names) or {"", "synth", *corpus.name.split("+")} & {*names}:
        raise InputError(
            f"also={also[:100]}: give names of other imported corpora than data={corpus.name}, "
            "joined by +, each once"
        )
    others = [captures_with_gesture(open_imported(name)) for name in names]
    key = [[each.digest, each.name] for each in (corpus, *others)]
    code = (joined, spellings)
    return make_once(".also", key, lambda: joined.add_corpora(corpus, others), *code)


def compared_digest(corpus: Corpus) -> str:
    """Digest of the recorded captures that are tested, however they are trained or measured."""
    recorded = corpus.info.get("recorded", {}).get("digest", corpus.digest)
    return corpus.info.get("tested_digest", recorded)


def _open_joined(name: str) -> Corpus:
    """Several corpora as one."""
    from bench.corpora import joined, spellings

    names = name.split("+")
    if len(set(names)) < len(names) or {"", "synth"} & {*names}:
        raise InputError(f"data={name[:100]}: join the names of imported corpora by +, each once")
    corpora = [open_imported(part) for part in names]
    for corpus in corpora:
        if corpus.info.get(ASIDE):
            reason = f"{corpus.name} has captures without a gesture; give it alone"
            raise InputError(f"data={name[:100]}: {reason}")
    identities = [[corpus.digest, corpus.name] for corpus in corpora]
    return make_once(".joined", identities, lambda: joined.join_corpora(corpora), joined, spellings)


def first_warnings(warnings: list[str], command: str) -> str:
    """The first three warnings of an import in one line, and the command that prints all."""
    text = "; ".join(warnings[:3])
    return text if len(warnings) <= 3 else f"{len(warnings)} of them: {text}; for all: {command}"
