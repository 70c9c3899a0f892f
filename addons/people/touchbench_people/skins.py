"""Captures of two skins as one corpus, on the classes that both have."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpora import joined as several
from bench.corpora.corpus import Corpus
from bench.errors import InputError

OWN, SOURCE = "own", "source"  # what the column ``skin`` says


def joined(target: Corpus, source: Corpus, names: dict[str, str]) -> Corpus:
    """Captures of two skins, one behind the other; only classes that both skins have.

    Both are brought to the lower of their rates, and each way to the fewer of their taxels; the full scale is that of
    the first. What is the same already stays as it is.

    Args:
        target: captures.
        source: captures of the other skin.
        names: names in ``target`` of classes of ``source``, where they differ.

    Returns:
        A corpus in memory, float32, whose column ``skin`` says which is which. People of the other skin are others,
        whatever they are called.

    Raises:
        InputError: a class that is not there is given a name, less than two are left, or a capture is in both.
    """
    for old, new in names.items():
        for name, corpus in ((old, source), (new, target)):
            if name not in set(corpus.gestures):
                raise InputError(
                    f"protocol.classes={old}:{new}: {corpus.name} has no {name!r}; it has {several.classes_of(corpus)}"
                )
    several.refuse_the_same(target, source, "protocol=transfer")
    renamed = np.array([names.get(name, name) for name in source.gestures], dtype=object)
    classes = sorted(set(target.gestures) & set(renamed))
    if len(classes) < 2:
        raise InputError(
            f"protocol=transfer: {target.name} and {source.name} share {len(classes)} classes; name more with "
            f"protocol.classes=, which maps those of {source.name} ({several.classes_of(source)}) to those of "
            f"{target.name} ({several.classes_of(target)})"
        )
    kept = np.flatnonzero(np.isin(renamed, classes))
    target, source = target[np.flatnonzero(np.isin(target.gestures, classes))], source[kept]
    columns = list(target.captures)
    rows = source.captures.reindex(columns=columns, fill_value="").assign(
        subject="other " + source.captures["subject"].astype(str),
        gesture=renamed[kept],
        skin=SOURCE,
    )
    captures = pd.concat([target.captures.assign(skin=OWN), rows], ignore_index=True)
    frames, fields = several.common((target, source))
    info = several.origin_of((target, source)) | {"format": "transfer", "source_name": source.name}
    return Corpus.from_captures(
        frames, captures.astype("str"), name=target.name, info=info, **fields
    )
