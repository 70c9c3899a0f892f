"""Names that may mean the same thing: `1` and `01`, `Tap` and `tap`, `P-1` and `P_1`."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache

SEPARATORS = {"Zs", "Pd", "Pc", "Ps", "Pe", "Pi", "Pf"}  # Unicode categories: blanks, brackets, ...
MARKS = "'\"`.,\\"  # further signs that programs put around names, or between their words
ENCODINGS = ("cp1252", "latin-1", "mac_roman", "cp437", "cp850")  # in which UTF-8 may be misread
LOST = "\ufffd?"  # what stands for a letter that an encoding lacks
LOOKALIKE = str.maketrans("аеорсухіјѕıο", "aeopcyxijsio")  # small Cyrillic, Turkish, Greek letters
NUMBERED = re.compile(r"([^\W\d]*)(\d+)")
# Words before a number that add nothing to it; a single letter is another one.
TITLES = (
    "id no nr number sub subj subject vp part participant person proband user class label gesture"
).split()
MISSING = {"", "nan", "null", "none", "na", "<na>", "n/a"}
NO_TOUCH = set(
    "0 -1 rest resting background idle notouch nocontact nothing nogesture nolabel unlabeled "
    "unlabelled empty".split()
)


@lru_cache(10_000)
def reduce_name(name: str) -> str:
    """What is left of a name without case, accents, separators, quotes and leading zeros.

    Numbers stay apart from one another: `1-2` is not `12`. The sign of a number stays, too.
    """
    text = _restore_encoding(re.sub(r"^[bu](?=['\"])", "", name.strip()))
    text = unicodedata.normalize("NFKD", text).casefold().translate(LOOKALIKE)
    text = "".join(c for c in text if not "\u0300" <= c <= "\u036f")
    text = "".join(str(unicodedata.decimal(c, c)) for c in text)
    text = re.sub(r"(?<=\d)([.,]0+)+(?=\D*$)", "", text)
    sign = re.match(r"\W*?([-\u2212])\d", text)
    spaced = "".join(" " if _is_separator(c) else c for c in text)
    spaced = re.sub(r"(?<!\d) +| +(?!\d)", "", spaced)
    spaced = re.sub(r"\d+", lambda match: match[0].lstrip("0") or "0", spaced)
    return f"-{spaced}" if sign else spaced


def _is_separator(character: str) -> bool:
    return character in MARKS or unicodedata.category(character) in SEPARATORS


def _restore_encoding(text: str) -> str:
    """The text as it was before a program read its UTF-8 in another encoding, or unchanged."""
    if text.isascii():
        return text
    for encoding in ENCODINGS:
        with suppress(UnicodeError):
            return _restore_encoding(text.encode(encoding).decode("utf-8"))
    return text


def may_be_same(one: str, other: str) -> bool:
    """True if two names may mean the same: equal when reduced, or in number alone (`P1`, `1`)."""
    if one == other:
        return True
    first, second = reduce_name(one) or one, reduce_name(other) or other
    if first == second:
        return True
    for lossy, full in ((first, second), (second, first)):
        if len(lossy) > 1 and {*lossy} & {*LOST}:
            pattern = "".join("." if c in LOST else re.escape(c) for c in lossy)
            if re.fullmatch(pattern, full):
                return True
    numbered = NUMBERED.fullmatch(first), NUMBERED.fullmatch(second)
    if None in numbered or numbered[0][2] != numbered[1][2]:
        return False
    short, long = sorted((numbered[0][1], numbered[1][1]), key=len)
    return long.startswith(short) and (long in TITLES or (not short and len(long) == 1))


def find_same_names(names: Collection[str]) -> list[list[str]]:
    """Groups of different names that may mean the same, sorted."""
    buckets: dict[str, set[str]] = {}  # only names of one bucket are compared
    for name in names:
        reduced = reduce_name(name) or name
        match = NUMBERED.fullmatch(reduced)
        buckets.setdefault(match[2] if match else reduced, set()).add(name)
    lossy = {name for name in names if {*name} & {*LOST}}
    groups = []
    pools = [sorted(names)] if lossy else [sorted(bucket) for bucket in buckets.values()]
    for pool in pools:
        while pool:
            first, *pool = pool
            group = [first, *(name for name in pool if may_be_same(first, name))]
            pool = [name for name in pool if name not in group]
            if len(group) > 1:
                groups.append(group)
    return sorted(groups)


def spelling_doubts(column: str, counts: Mapping[str, int]) -> list[str]:
    """A sentence for each group of names of a column that may mean the same, with counts."""
    lines = []
    for group in find_same_names(counts):
        words = [f"{name!r} ({counts[name]}x)" for name in group]
        lines.append(
            f"{column} {' and '.join(words)} may be one, spelt differently; "
            "if so, correct the file, else rename one"
        )
    return lines


def known_spelling(name: str, known: Collection[str]) -> str | None:
    """The known name that an unknown one may mean; None for a known name, or if there is none."""
    if name in known:
        return None
    return next((other for other in sorted(known) if may_be_same(name, other)), None)


def unify_spellings(lists: Sequence[Collection[str]]) -> list[dict[str, str]]:
    """For each list, its names that an earlier list spells otherwise, with the earlier spelling.

    Two names of one list are never unified.
    """
    known: set[str] = set()
    changes: list[dict[str, str]] = []
    for names in lists:
        found = {name: known_spelling(name, known) for name in sorted({*names})}
        spellings = [*found.values()]
        changes.append(
            {
                name: other
                for name, other in found.items()
                if other and other not in names and spellings.count(other) == 1
            }
        )
        known |= {*names} - {*changes[-1]}
    return changes


def find_background_words(labels: Collection[str]) -> set[str]:
    """The labels that stand for no touch.

    Words for a missing label always do, `rest`, `0` and the like only if no label is missing.
    """
    missing = {label for label in labels if reduce_name(label) in MISSING}
    return missing or {label for label in labels if reduce_name(label) in NO_TOUCH}


def background_doubts(counts: Mapping[str, int]) -> list[str]:
    """A sentence for each label that may stand for no touch, with its number of frames."""
    background, lines = find_background_words(counts), []
    for label, count in sorted(counts.items()):
        shown = f"label {label!r} ({count} frames)"
        if label in background:
            if label not in ("", "None", "none"):
                lines.append(f"{shown} is read as background; if it is a gesture, rename it")
        elif reduce_name(label) in NO_TOUCH:
            lines.append(
                f"{shown} is read as a gesture, as others are empty; if it stands for no touch, "
                "leave these labels empty"
            )
    return lines
