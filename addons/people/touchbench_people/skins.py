"""Captures of two skins as one corpus, on the classes that both have."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.corpora import joined
from bench.corpora.corpus import Corpus
from bench.corpora.spellings import unify_spellings
from bench.errors import InputError

TARGET_SKIN, SOURCE_SKIN = "own", "source"  # values of the column ``skin``


def join_skins(target: Corpus, source: Corpus, names: dict[str, str]) -> Corpus:
    """Join the captures of two skins, of the classes that both have.

    Both are converted to the lower rate and, for rows and columns, to the fewer taxels; the full
    scale is that of the target. Frames that need no conversion do not change. Classes that differ
    only in spelling are one.

    Args:
        target: captures to test.
        source: captures of the other skin.
        names: names in ``target`` of classes of ``source``, if they differ.

    Returns:
        A corpus in memory, float32, whose column ``skin`` tells the skins apart. Subjects of the
        other skin are other people, whatever their names are.

    Raises:
        InputError: a class does not exist, fewer than two are shared, or both have the same
            captures.
    """
    for old, new in names.items():
        for name, corpus in ((old, source), (new, target)):
            if name not in set(corpus.gestures):
                raise InputError(
                    f"protocol.classes={old}:{new}: {corpus.name} has no {name!r}; it has "
                    f"{joined.class_names(corpus)}"
                )
    joined.refuse_same_recordings(target, source, "protocol=transfer")
    renamed = np.array([names.get(name, name) for name in source.gestures], dtype=object)
    _, spellings = unify_spellings([set(target.gestures), set(renamed)])
    renamed = np.array([spellings.get(name, name) for name in renamed], dtype=object)
    classes = sorted(set(target.gestures) & set(renamed))
    if len(classes) < 2:
        raise InputError(
            f"protocol=transfer: {target.name} and {source.name} share {len(classes)} classes; "
            f"name more with protocol.classes=, which maps those of {source.name} "
            f"({joined.class_names(source)}) to those of {target.name} "
            f"({joined.class_names(target)})"
        )
    shared = np.flatnonzero(np.isin(renamed, classes))
    target, source = target[np.flatnonzero(np.isin(target.gestures, classes))], source[shared]
    subject = "other " + source.captures["subject"].astype(str)
    rows = source.captures.reindex(columns=list(target.captures), fill_value="")
    rows = rows.assign(subject=subject, gesture=renamed[shared], skin=SOURCE_SKIN)
    captures = pd.concat([target.captures.assign(skin=TARGET_SKIN), rows], ignore_index=True)
    frames, fields = joined.convert_to_common((target, source))
    info = joined.joint_info((target, source))
    info |= {"format": "transfer", "source_name": source.name}
    info["warnings"] = [
        *(f"class {name!r} of {source.name} is read as {new!r}" for name, new in spellings.items()),
        *info["warnings"],
    ]
    return Corpus.from_captures(
        frames, captures.astype("str"), name=target.name, info=info, **fields
    )
