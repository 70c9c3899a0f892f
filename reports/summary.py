"""What the runs show, in one or two sentences each: early decisions, faults, people, statistics."""

from __future__ import annotations

from collections.abc import Sequence

from bench import few
from bench.outcomes import statistics
from bench.reports.numbers import listed
from bench.reports.run_groups import Group
from bench.sentences import sentences

PEOPLE, STATISTICS = "People", "Statistics"


def briefs(shown: Sequence[tuple[str, str]], groups: dict[str, Group]) -> list[tuple[str, str]]:
    """Topics and sentences, if there are any; a topic is the heading of its details.

    Args:
        shown: those of kinds of run and circumstances (`bench.reports.sections.briefs`).
        groups: groups by name.
    """
    differ = " ".join(f"On {name}: {told_apart(g)}" for name, g in groups.items() if len(g.subjects))
    topics = {topic: text for topic, text in shown if topic != PEOPLE}
    persons = " ".join(filter(None, [people(groups), *(text for topic, text in shown if topic == PEOPLE)]))
    return [(topic, text) for topic, text in (topics | {PEOPLE: persons, STATISTICS: differ}).items() if text]


def people(groups: dict[str, Group]) -> str:
    """A sentence on the spread over people of the best system of the first group with several people."""
    for name, group in groups.items():
        if len(group.subjects) and group.subjects.shape[1] > 1:
            best = group.subjects.iloc[0]
            return sentences("bench.reports", "sentences", "people", name=name, best=best)[0]
    return ""


def told_apart(group: Group) -> str:
    """The systems of a group that differ from the compared one, and the others, by the p Holm of its table."""
    subjects = statistics.kept_of(group.subjects, group.against)
    base, (systems, n) = group.base, subjects.shape
    parts, scarce = [], False
    if systems > 1 and not few.too_few(n):
        rows = statistics.against_best(subjects, against=base).set_index("system").drop(base)
        differs, below = rows["p_holm"] < 0.05, rows["difference"] < 0
        words = {"is significantly more accurate than": differs & below}
        words |= {"is significantly less accurate than": differs & ~below}
        words |= {"does not differ significantly from": ~differs}
        parts = [(verb, listed([*rows.index[those]])) for verb, those in words.items() if those.any()]
        scarce = statistics.least_p(n, systems - 1) > 0.05
    return sentences(
        "bench.reports",
        "sentences",
        "told_apart",
        base=base,
        systems=systems,
        few=few.too_few(n),
        parts=parts,
        chosen=base != subjects.index[0],
        people=n,
        scarce=scarce,
        mixed=group.mixed,
    )[0]
