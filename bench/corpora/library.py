"""Imported corpora in the user's data folder, and the generated one.

``corpora/<name>/<digest>`` holds the corpus, ``corpora/<name>/current`` says which digest is meant. Both are written
beside their names and renamed, so a kill leaves the old corpus or the new one.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from filelock import FileLock, Timeout

from bench.corpora.corpus import Corpus
from bench.corpora.folder import content_digest, home, open_folder, write_folder
from bench.errors import InputError, nearest
from bench.registry import load


def import_corpus(kind: str, source: Path, options: dict[str, str]) -> Corpus:
    """Read a file of a known format and store it.

    Args:
        kind: name of a reader, such as ``cost``.
        source: file or folder to read.
        options: parameters of the reader as text; ``name`` is the name to store under.

    Raises:
        InputError: an unknown format or option, a file that the reader refuses, another import of the same name under
            way, or a data folder that cannot be written. What was stored before stays.
    """
    reader = load("corpora", kind)
    arguments = _reader_arguments(kind, reader, dict(options))
    name = options.get("name", kind)
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise InputError(f"name={name}: use letters, digits, - and _")
    if name == "synth":
        raise InputError("name=synth is the generated corpus; choose another name")
    folder = home() / "corpora" / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder.parent / f".{name}.lock", timeout=0):
            corpus = reader(source, **arguments)
            corpus = Corpus(**{**vars(corpus), "name": name, "info": corpus.info | {"format": kind}})
            digest = content_digest(corpus)[:16]
            write_folder(corpus, folder / digest)
            beside = folder / ".current"
            beside.write_text(digest)
            beside.replace(folder / "current")
            for old in folder.iterdir():
                if old.is_dir() and old.name != digest:
                    shutil.rmtree(old, ignore_errors=True)
    except Timeout as e:
        raise InputError(f"another import of name={name} is under way; wait for it or choose another name=") from e
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e}); set TOUCHBENCH_HOME to a folder that can") from e
    finally:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
    return open_folder(folder / digest)


def open_corpus(name: str, parameters: dict[str, object]) -> Corpus:
    """Open an imported corpus, or generate and open the synthetic one.

    Raises:
        InputError: there is no such corpus.
    """
    if name == "synth":
        return _synthetic(parameters)
    pointer = home() / "corpora" / name / "current"
    if not pointer.is_file():
        raise InputError(
            f"data={name}: not imported; {nearest(name, ['synth', *imported()])}. Import it with: bench data import ..."
        )
    return open_folder(pointer.parent / pointer.read_text().strip())


def imported() -> list[str]:
    """Names of the corpora that are stored."""
    return sorted(p.parent.name for p in (home() / "corpora").glob("*/current"))


def overview() -> list[dict[str, object]]:
    """What is here: figures of each imported corpus."""
    rows = []
    for name in imported():
        corpus = open_corpus(name, {})
        rows.append(
            {
                "data": name,
                "captures": len(corpus),
                "subjects": len(set(corpus.subjects)),
                "gestures": len(set(corpus.gestures)),
                "frames": len(corpus.frames),
                "grid": "x".join(map(str, corpus.grid)),
                "rate_hz": corpus.rate_hz,
                "columns": ", ".join(c for c in corpus.captures if c not in ("subject", "gesture")),
                "digest": corpus.digest[:16],
                "source": corpus.info.get("source", ""),
                "licence": corpus.info.get("licence", ""),
            }
        )
    return rows


def _reader_arguments(kind: str, reader: Callable, options: dict[str, str]) -> dict[str, object]:
    """Options as the types that the reader's signature names."""
    taken = dict(list(inspect.signature(reader, eval_str=True).parameters.items())[1:])
    arguments: dict[str, object] = {}
    for key, text in options.items():
        if key == "name":
            continue
        if key not in taken:
            raise InputError(f"format {kind} has no option {key!r}; {nearest(key, {'name', *taken})}")
        try:
            arguments[key] = float(text) if taken[key].annotation is float else text
        except ValueError as e:
            raise InputError(f"{key}={text}: give a number") from e
    missing = [k for k, p in taken.items() if p.default is inspect.Parameter.empty and k not in arguments]
    if missing:
        raise InputError(f"format {kind} also needs {', '.join(f'{k}=' for k in missing)}")
    return arguments


def _synthetic(parameters: dict[str, object]) -> Corpus:
    from bench.corpora import synth

    code = Path(synth.__file__).read_bytes()
    key = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode() + code).hexdigest()[:16]
    folder = home() / "corpora" / "synth" / key
    if not folder.exists():
        try:
            write_folder(synth.generate(**parameters), folder)
        except OSError as e:
            raise InputError(f"{folder} cannot be written ({e}); set TOUCHBENCH_HOME to a folder that can") from e
    return open_folder(folder)
