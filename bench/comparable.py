"""Comparability of two runs, in tags and in words, and the protocol facts that statistics need."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

BATCH, CONDITIONS = "touchbench.depends_on_batch", "touchbench.conditions"  # tags of a run
MARK = "\N{DAGGER}"  # behind the name of a system whose predictions depend on the batch
MARKED = f"{MARK} predictions depend on other test captures; not compared with other systems"
MIXED_MARK = "\N{DOUBLE DAGGER}"  # behind a protocol that mixes subjects
MIXED = "Training and test captures come from the same subjects: expect lower accuracy for a new person."
DESIGNED = (
    "The systems reflex, touchnet and rocket and the features touch were designed on seven of HAART's ten people, the "
    "training subjects of its challenge split. LOSO tests on these seven, too."
)
MAYBE_TWICE = "Whether a person is in more than one of the joined corpora is unknown; each counts as another."
Row = Mapping[str, Any]  # of a run: tags and parameters, which are text, and metrics; nan for what it has not
COMPARABLE = ("data", "corpus_digest", "subset", "target", "protocol_label")  # tags, with the digest of the parameters
SAME_SYSTEM = ("protocol", "system", "seed")  # besides, what makes two runs repetitions of one


def notes_on(system: str, data: str) -> list[str]:
    """The footnotes of a system that a table names."""
    ours = re.search(r"(?<![\w.])(reflex|rocket|touch|touchnet)(?![\w.])", system) is not None
    designed = ours and any(part.split("-")[0] == "haart" for part in data.split("+"))
    return [DESIGNED] * designed + [MAYBE_TWICE] * ("+" in data) + [MARKED] * system.endswith(MARK)


def comparable(run: Row) -> tuple[str, ...]:
    """Tags that must agree for two runs to be compared: captures and protocol."""
    return alike(run, ())


def alike(run: Row, names: Iterable[str]) -> tuple[str, ...]:
    """The same, with further parameters that must agree, such as the way of replay."""
    return tuple(str(run.get(name, "")) for name in (*COMPARABLE, *names))


def shared(run: Row, same: Mapping[str, tuple[str, str]]) -> list[str]:
    """Further parameters that must agree, in words; those with their usual value are left out."""
    values = {name: str(run.get(name, "")) for name in same}
    return [words.format(values[name]) for name, (words, usual) in same.items() if values[name] not in ("", usual)]


def context_of(tags: Row) -> tuple[str, str, str]:
    """The same in words: data, subset with the target, protocol."""
    data = str(tags["data"]) + (" (synthetic)" if tags["synthetic"] == "true" else "")
    target = f", {tags['target']}" if tags["target"] != "gesture" else ""
    return data, str(tags["subset"]) + target, str(tags["protocol_label"])


def depends_on_batch(tags: Row) -> bool:
    """Return True if predictions of a capture changed with the other captures in the batch."""
    return tags.get(BATCH) == "true"


def system_of(tags: Row) -> str:
    """The system as tables name it: with the conditions that it uses, and a mark if it depends on the batch."""
    conditions = tags.get(CONDITIONS)
    uses = f" (uses {conditions.replace(',', ', ')})" if isinstance(conditions, str) and conditions else ""
    return str(tags["system"]) + uses + (f" {MARK}" if depends_on_batch(tags) else "")


def method_of(tags: Row) -> str:
    """System, and its seed where that is not the usual one."""
    return system_of(tags) + (f", seed {tags['seed']}" if tags["seed"] not in ("0", "none") else "")


def seed_number(seed: str) -> int:
    """A tracked seed as a number to sort by, 0 for a system that has none."""
    return int(seed) if seed.lstrip("-").isdecimal() else 0


class Facts(NamedTuple):
    """Properties of a protocol that statistics need."""

    mixes_subjects: bool  # a fold has captures of one subject on both sides
    test_over_train: float | None  # tested by training captures, None if folds share no training captures
    official_split: bool | None  # the folds are the published ones; None if none were published


def facts_of(run: Row) -> Facts:
    """The facts of a run as they were tracked."""
    ratio = run["test_over_train"]
    official = {"true": True, "false": False}.get(run["official_split"])
    return Facts(run["mixes_subjects"] == "true", float(ratio) if ratio else None, official)


def several(number: int, noun: str) -> str:
    """A number with its noun, in the plural unless it is 1."""
    return f"{number} {noun}{'s' if number != 1 else ''}"
