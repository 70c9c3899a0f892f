"""What the runs show, in one or two sentences each: early decisions, faults, people, statistics."""

from __future__ import annotations

from collections import Counter

import numpy as np

from bench.comparable import several
from bench.measures import Measure
from bench.outcomes import statistics
from bench.outcomes.stopping import NO_SAVING, saves
from bench.result import Result
from reports.fault_curves import context_words, under
from reports.new_person import WITHOUT, Curves
from reports.numbers import listed
from reports.run_groups import Group

EARLY, FAULTS, PEOPLE, STATISTICS = "Early decisions", "Faults", "People", "Statistics"


def briefs(
    streams: dict[str, list[Result]], stresses: dict[str, list[Result]], groups: dict[str, Group], curves: list[Curves]
) -> list[tuple[str, str]]:
    """Topics and sentences, if there are any; a topic is the heading of its details.

    Args:
        streams: `reports.fault_curves.contexts` of ``bench stream``.
        stresses: the same of ``bench stress``.
        groups: groups by name.
        curves: `reports.new_person.curves_of`.
    """
    differ = " ".join(f"On {name}: {told_apart(g)}" for name, g in groups.items() if len(g.subjects))
    sentences = [(EARLY, early(streams)), (FAULTS, faults(stresses))]
    sentences += [(PEOPLE, f"{people(groups)} {shots(curves)}".strip()), (STATISTICS, differ)]
    return [(topic, text) for topic, text in sentences if text]


def early(contexts: dict[str, list[Result]]) -> str:
    """A sentence on the best replayed system with early decisions, on the first of all comparable captures."""
    for runs in contexts.values():
        runs = [r for r in runs if r.alone and np.isfinite(r.get("adaptive_accuracy", np.nan))]
        if not runs:
            continue
        best = max(runs, key=lambda r: r["adaptive_accuracy"])
        whole = (
            f"On {context_words(best)}, {best.method} correctly classifies {100 * best['accuracy']:.1f} % of whole "
            "captures"
        )
        if not saves(best):
            return f"{whole}; {NO_SAVING}."
        return (
            f"{whole}. With adaptive stopping, it correctly classifies {100 * best['adaptive_accuracy']:.1f} % after "
            f"{best['adaptive_ms']:.0f} ms of touch on average."
        )
    return ""


def faults(contexts: dict[str, list[Result]]) -> str:
    """A sentence on the most robust system under faults, on the first of all comparable captures."""
    for runs in contexts.values():
        losses = {r.method: under(r, "loss.") for r in runs if r.alone}
        sets = Counter(frozenset(loss) for loss in losses.values() if loss)
        if not sets:
            continue
        tested = max(sets, key=lambda each: (sets[each], len(each)))  # by most systems
        means = {m: 100 * np.mean([*loss.values()]) for m, loss in losses.items() if set(loss) == tested}
        least, most = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        worst = max(losses[least], key=losses[least].__getitem__)
        others = f" Of {len(means)} systems, {most} loses most: {means[most]:.1f} points." if len(means) > 1 else ""
        return (
            f"On {context_words(runs[0])}, {least} loses {means[least]:.1f} points of accuracy, mean over "
            f"{several(len(tested), 'fault')} at five severities.{others} The worst fault for {least} is "
            f"{worst.replace('_', ' ')}, with a loss of {100 * losses[least][worst]:.1f} points."
        )
    return ""


def people(groups: dict[str, Group]) -> str:
    """A sentence on the spread over people of the best system of the first group with several people."""
    for name, group in groups.items():
        if len(group.subjects) and group.subjects.shape[1] > 1:
            best = group.subjects.iloc[0]
            return (
                f"On {name}, the accuracy of the best system, {best.name}, ranges from {best.min():.1f} % (subject "
                f"{best.idxmin()}) to {best.max():.1f} % (subject {best.idxmax()})."
            )
    return ""


def shots(curves: list[Curves]) -> str:
    """A sentence on the gain of the most accurate system from captures of a new person."""
    for context, by_system in curves:
        system, curve = next(iter(by_system.items()))
        row = curve[curve["known"] != WITHOUT].iloc[-1]
        if np.isfinite(row.get("gain", np.nan)):
            gain = Measure("gain", form="+.1f", ends="gain").of(row)
            return (
                f"On {context}: {row['known']} labelled captures of each class change the accuracy of {system} by "
                f"{gain} points."
            )
    return ""


def told_apart(group: Group) -> str:
    """The systems of a group that differ from the best one, and the others, by the p Holm of its table."""
    subjects = group.subjects.iloc[: statistics.RANKED]
    best, (systems, n) = subjects.index[0], subjects.shape
    if systems == 1:
        return f"{best} is the only system, so there is no comparison."
    if n < statistics.FEW_SUBJECTS:
        return f"{n} subject{'s are' if n != 1 else ' is'} too few to compare {systems} systems."
    rows = statistics.against_best(subjects).iloc[1:]
    beaten = rows["p_holm"] < 0.05
    behind, level = [*rows.loc[beaten, "system"]], [*rows.loc[~beaten, "system"]]
    parts = [f"{best} is significantly more accurate than {listed(behind)}"] if behind else []
    parts += [f"{best} does not differ significantly from {listed(level)}"] if level else []
    test = f"(paired Wilcoxon tests against the best system, Holm's correction, {n} subjects, 5 % level)"
    few = " With so few subjects, no difference can be significant." * (statistics.least_p(n, systems - 1) > 0.05)
    mixed = " Training and test captures come from the same subjects: expect lower accuracy for a new person."
    mixed *= group.mixed
    return f"{'; '.join(parts)} {test}.{few}{mixed}"
