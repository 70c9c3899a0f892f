"""Imported corpora in the user's data folder, and the generated one.

``corpora/<name>/<digest>`` holds the corpus, ``corpora/<name>/current`` says which digest is meant. Both are written
beside their names and renamed, so a kill leaves the old corpus or the new one.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
from filelock import FileLock, Timeout

from bench.corpora.corpus import Corpus
from bench.corpora.folder import (
    Damaged,
    content_digest,
    find_damage,
    open_folder,
    small_file,
    write_folder,
)
from bench.errors import InputError, one_line, suggest_names
from bench.ground.registry import load_part
from bench.ground.scratch import data_folder, remove_path, write_then_rename

ASIDE = "aside"  # in the corpus's info: classes of captures without a gesture, which runs on captures leave out
UNTAUGHT = "untaught"  # classes that teach nothing, and so may be tested without training
NAME = "[A-Za-z0-9][A-Za-z0-9_-]{0,99}"


def import_corpus(kind: str, source: Path, options: dict[str, str]) -> Corpus:
    """Read a file of a known format and store it under the option ``name``; if that fails, what was stored stays.

    Options are those of the reader, as text, and changes of captures (`bench.corpora.cuts.OPTIONS`).
    """
    from bench.corpora import cuts
    from bench.corpora.doubts import find_doubts
    from bench.corpora.survey import Survey

    reader = load_part("corpora", kind)
    changes = {key: options[key] for key in cuts.OPTIONS if key in options}
    rest = {key: text for key, text in options.items() if key not in changes}
    arguments = _arguments(kind, reader, rest, source)
    aligned = changes.get("align", "no") not in ("no", "false")
    name = options.get("name", f"{kind}-aligned" if aligned else kind)
    if not re.fullmatch(NAME, name):
        raise InputError(f"name={name[:60]}: use letters, digits, - and _, at most 100")
    if name == "synth":
        raise InputError("name=synth is the generated corpus; choose another name")
    folder = data_folder() / "corpora" / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder.parent / f".{name}.lock", timeout=0):
            try:
                corpus = reader(source, **arguments)
            except OSError as e:  # none of the data folder
                raise InputError(
                    f"{one_line(source, 160)}: cannot be read ({e.strerror or e}); check the path"
                ) from e
            if changes and corpus.info.get(ASIDE):
                raise InputError(f"{next(iter(changes))}=: {kind} is imported whole; leave it out")
            if changes:
                unchanged = content_digest(corpus)
                corpus = cuts.apply_changes(corpus, kind, changes)
                corpus = corpus.with_fields(info=corpus.info | {"unchanged": unchanged})
            touches = corpus[np.flatnonzero(~np.isin(corpus.gestures, corpus.info.get(ASIDE, [])))]
            warnings = [
                *Survey(corpus).repeat_warnings(),
                *find_doubts(touches),
                *corpus.info.get("warnings", []),
            ]
            corpus = corpus.with_fields(
                name=name, info=corpus.info | {"format": kind, "warnings": warnings}
            )
            digest = content_digest(corpus)
            stored = folder / digest[:16]
            write_folder(corpus, stored, digest)
            pointer = folder / "current"
            if os.path.lexists(pointer) and (pointer.is_symlink() or not pointer.is_file()):
                remove_path(pointer)
            with write_then_rename(pointer) as beside:
                beside.write_text(stored.name)
            for old in folder.iterdir():  # nobody else writes here, the lock is ours
                if old not in (pointer, stored):
                    remove_path(old)
    except Timeout as e:
        raise InputError(
            f"another import of name={name} is under way; wait for it or choose another name="
        ) from e
    except OSError as e:
        raise _unwritable(folder, e) from e
    finally:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
    return open_folder(stored)


def _unwritable(folder: Path, error: OSError) -> InputError:
    reason = one_line(error.strerror or error)
    return InputError(
        f"{one_line(folder, 150)} cannot be written ({reason}); set TOUCHBENCH_HOME to a folder that can"
    )


def open_corpus(name: str, parameters: dict[str, object]) -> Corpus:
    """Open an imported corpus, several joined by ``+``, or the generated one with its parameters.

    Captures without a gesture are left out.
    """
    if "+" in name:
        return _together(name)
    if name == "synth":
        from bench.corpora import synth

        return make_once("synth", parameters, lambda: synth.generate(**parameters), synth)
    return captures_with_gesture(open_imported(name))


def captures_with_gesture(corpus: Corpus) -> Corpus:
    """The captures with a gesture, of all that a format has stored."""
    if not (aside := corpus.info.get(ASIDE)):
        return corpus
    captures = corpus[~np.isin(corpus.gestures, aside)]
    if not len(captures):
        raise InputError(
            f"data={corpus.name}: all captures are {' or '.join(aside)}; label some with a gesture"
        )
    return captures


def left_out_message(corpus: Corpus) -> str:
    """A line on what `captures_with_gesture` has left out; empty for nothing."""
    if not (aside := corpus.info.get(ASIDE)):
        return ""
    return f"{corpus.name}: its {len(corpus)} captures with a gesture are used; {' and '.join(aside)} are left out"


def open_imported(name: str) -> Corpus:
    """Open all that is imported under a name, also captures without a gesture."""
    try:
        folder = _folder(name)
        corpus = open_folder(folder, folder.name)
        if corpus.name != name:
            raise Damaged(f"it is {corpus.name[:40]}")
    except Damaged as e:
        folder = data_folder() / "corpora" / name
        raise InputError(
            f"{one_line(folder, 150)} was changed or damaged ({e}); import it again"
        ) from e
    return corpus


def _folder(name: str) -> Path:
    """The folder of an imported corpus, which its file ``current`` names."""
    pointer = data_folder() / "corpora" / name / "current"
    if not re.fullmatch(NAME, name) or not os.path.lexists(pointer):
        names = one_line(suggest_names(name[:60], ["synth", *imported_names()]), 150)
        raise InputError(
            f"data={name[:60]}: not imported; {names}. Import it with: bench data import ..."
        )
    digest = small_file(pointer, most=100).decode(errors="replace").strip()
    if not re.fullmatch("[0-9a-f]{16}", digest):
        raise Damaged("current names no corpus")
    return pointer.parent / digest


def find_corpus_damage(name: str) -> dict[str, str]:
    """Every file of an imported corpus, or of all generated ones, with its defect, ``""`` for none."""
    if "+" in name:
        raise InputError(f"bench data verify {name[:100]}: give one corpus at a time")
    if name == "synth":
        folders = sorted(
            f for f in (data_folder() / "corpora" / "synth").glob("[0-9a-f]*") if f.is_dir()
        )
        return {
            f"{f.name}/{file}": wrong
            for f in folders
            for file, wrong in find_damage(f, f.name).items()
        }
    try:
        folder = _folder(name)
    except Damaged as e:
        return {"current": str(e)}
    wrong = {"current": "", **find_damage(folder, folder.name)}
    if not any(wrong.values()):
        try:
            open_imported(name)
        except InputError as e:
            wrong["corpus.json"] = str(e)
    return wrong


def imported_names() -> list[str]:
    """Names of the corpora that are stored."""
    pointers = (data_folder() / "corpora").glob(
        "*/current"
    )  # a dangling link is one to some versions of Python
    return sorted(
        p.parent.name for p in pointers if p.exists() and re.fullmatch(NAME, p.parent.name)
    )


def _arguments(
    kind: str, reader: Callable, options: dict[str, str], source: Path
) -> dict[str, object]:
    """Options as the types that the reader's signature names."""
    taken = dict(list(inspect.signature(reader, eval_str=True).parameters.items())[1:])
    arguments: dict[str, object] = {}
    for key, text in options.items():
        if key == "name":
            continue
        if key not in taken:
            from bench.corpora.cuts import OPTIONS

            raise InputError(
                f"format {kind} has no option {key!r}; {suggest_names(key, {'name', *OPTIONS, *taken})}"
            )
        try:
            arguments[key] = float(text) if taken[key].annotation is float else text
        except ValueError as e:
            raise InputError(f"{key}={text}: give a number") from e
    missing = [
        k for k, p in taken.items() if p.default is inspect.Parameter.empty and k not in arguments
    ]
    if missing:
        if not os.path.lexists(source):  # what is asked for would not help
            raise InputError(
                f"{one_line(source, 160)}: there is no such file; give the path of a file"
            )
        raise InputError(f"format {kind} also needs {', '.join(f'{k}=' for k in missing)}")
    return arguments


def make_once(kind: str, about: object, make: Callable[[], Corpus], *code: ModuleType) -> Corpus:
    """A corpus of a kind that modules make out of ``about`` (JSON); made and stored if missing or damaged."""
    source = b"".join(Path(str(module.__file__)).read_bytes() for module in code)
    key = hashlib.sha256(json.dumps(about, sort_keys=True).encode() + source).hexdigest()[:16]
    folder = data_folder() / "corpora" / kind / key
    try:
        return open_folder(folder, folder.name)
    except InputError:
        corpus = make()
    try:
        write_folder(corpus, folder)
    except OSError as e:
        raise _unwritable(folder, e) from e
    return open_folder(folder, folder.name)


def _together(name: str) -> Corpus:
    """Several corpora as one."""
    from bench.corpora import joined

    names = name.split("+")
    if len(set(names)) < len(names) or {"", "synth"} & {*names}:
        raise InputError(f"data={name[:100]}: join the names of imported corpora by +, each once")
    corpora = [open_imported(each) for each in names]
    if partly := [corpus.name for corpus in corpora if corpus.info.get(ASIDE)]:
        raise InputError(
            f"data={name[:100]}: {partly[0]} has captures without a gesture; give it alone"
        )
    return make_once(
        ".joined",
        [[c.digest, c.name] for c in corpora],
        lambda: joined.join_corpora(corpora),
        joined,
    )


def first_warnings(warnings: list[str], rest: str) -> str:
    """Warnings of an import in one line: the first three, and the command that prints all."""
    text = "; ".join(warnings[:3])
    return text if len(warnings) <= 3 else f"{len(warnings)} of them: {text}; for all: {rest}"
