"""The name under which a search, or the training of a network, is kept: a hash of everything that it depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from functools import partial

import numpy as np

from bench.corpora.corpus import Corpus
from bench.source import source_digest, versions


def study_name(what: dict[str, object], X: Corpus, y: np.ndarray) -> str:
    """Hash of the captures with their steps, the labels, the search space and library versions."""
    code = source_digest(*(part for step in X.steps for part in step.code())) if X.steps else ""
    parts = {
        "captures": [X.digest, hashlib.sha256(X.index.tobytes()).hexdigest()],
        "steps": [repr(X.steps), code, X.piece.tolist()],
        "labels": hashlib.sha256("\n".join(map(str, y)).encode()).hexdigest(),
        "what": what,
        "versions": versions(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:32]


def identity(part: Callable) -> list:
    """Name and source of a factory or class; of a partial one also its arguments."""
    if isinstance(part, partial):
        return [*identity(part.func), repr((part.args, sorted(part.keywords.items())))]
    return [part.__module__, part.__qualname__, source_digest(part)]
