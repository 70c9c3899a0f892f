"""What was found, in a sentence each: early decisions, faults, people, statistics."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pandas as pd

from bench.outcomes import statistics
from bench.outcomes.comparable import depends_on_batch, method_of
from bench.outcomes.stopping import NO_SAVING, SHOWN_MS, saves
from bench.outcomes.store import Store
from reports.fault_curves import context_words, contexts, under
from reports.new_person import WITHOUT, Curves
from reports.numbers import listed
from reports.run_groups import Group

EARLY, FAULTS, PEOPLE, STATISTICS = "Early decisions", "Faults", "People", "Statistics"


def briefs(store: Store, groups: dict[str, Group], curves: list[Curves]) -> list[tuple[str, str]]:
    """Topics and sentences, as far as there is something to say; a topic is the heading under which there is more.

    Args:
        store: where the runs are.
        groups: by their words.
        curves: `reports.new_person.curves_of`.
    """
    found = [(EARLY, early(store)), (FAULTS, faults(store)), (PEOPLE, people(groups, curves))]
    found.append((STATISTICS, " ".join(f"On {name}: {told_apart(g)}" for name, g in groups.items() if len(g.subjects))))
    return [(topic, text) for topic, text in found if text]


def early(store: Store) -> str:
    """What replayed systems get when they need not see the whole capture, on the first of all comparable captures."""
    for replays in contexts(store, "stream").values():
        if not (runs := [run for run in replays if not depends_on_batch(run.data.tags)]):
            continue
        best = max(runs, key=lambda r: r.data.metrics.get("adaptive_accuracy", -1))
        measured = best.data.metrics
        if "adaptive_accuracy" not in measured:
            continue
        early, whole = (100 * measured[name] for name in ("adaptive_accuracy", "accuracy"))
        said = f"On {context_words(best)}, {method_of(best.data.tags)} labels "
        if saves(measured):
            said += (
                f"{early:.1f} % of captures correctly when it decides as soon as waiting gains too little, after "
                f"{measured['adaptive_ms']:.0f} ms of touch on average, and {whole:.1f} % of whole captures."
            )
        else:
            said += f"{whole:.1f} % of whole captures correctly; {NO_SAVING}."
        half = f"accuracy_at_{SHOWN_MS[1]}_ms"
        soon = [r for r in runs if half in r.data.metrics]
        if soon:
            first = max(soon, key=lambda r: r.data.metrics[half])
            who = "It" if first is best else method_of(first.data.tags)
            most = f"{100 * first.data.metrics[half]:.1f} % after {SHOWN_MS[1]} ms"
            said += f" {who} gets {most}{', most of all' if len(soon) > 1 else ''}."
        return said
    return ""


def faults(store: Store) -> str:
    """Who loses least under faults, and to which it loses most, on the first of all comparable captures."""
    for runs in contexts(store, "stress").values():
        losses = {method_of(r.data.tags): under(r, "loss.") for r in runs if not depends_on_batch(r.data.tags)}
        if not losses:
            continue
        sets = Counter(frozenset(loss) for loss in losses.values() if loss)
        if not sets:
            continue
        met = max(sets, key=lambda each: (sets[each], len(each)))  # most systems met these
        means = {m: 100 * np.mean([*loss.values()]) for m, loss in losses.items() if set(loss) == met}
        least, most = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        worst = max(losses[least], key=losses[least].__getitem__)
        met_said = f"{len(met)} fault{'s' * (len(met) != 1)}"
        least_said = f"{least} loses {means[least]:.1f} points"
        said = f"On {context_words(runs[0])}, {least_said} of accuracy, mean over {met_said} at five severities"
        if len(means) > 1:
            said += f", the least of {len(means)} systems (the most: {most}, {means[most]:.1f})"
        return f"{said}; most under {worst.replace('_', ' ')}, {100 * losses[least][worst]:.1f} points."
    return ""


def people(groups: dict[str, Group], curves: list[Curves]) -> str:
    """How far people differ with the most accurate system, and what captures of a new person are worth."""
    said = []
    for name, group in groups.items():
        if len(group.subjects) and group.subjects.shape[1] > 1:
            own = group.subjects.iloc[0]
            said.append(
                f"On {name}, {own.name}, the most accurate, labels between {own.min():.1f} % (subject {own.idxmin()}) "
                f"and {own.max():.1f} % (subject {own.idxmax()}) of a person's captures correctly."
            )
            break
    for context, found in curves:
        system, curve = next(iter(found.items()))
        shots = curve[curve["known"] != WITHOUT]
        if "gain" in shots and np.isfinite(shots["gain"].iloc[-1]):
            row = shots.iloc[-1]
            said.append(
                f"On {context}: {row['known']} known captures of each class change the accuracy of {system} by "
                f"{row['gain']:+.1f} points [{row['gain_low']:+.1f}, {row['gain_high']:+.1f}]."
            )
            break
    return " ".join(said)


def told_apart(group: Group) -> str:
    """Which systems of a group differ from the best one and which do not, by the p Holm of its table."""
    subjects = group.subjects.iloc[: statistics.RANKED]
    systems, n = subjects.shape
    if systems == 1:
        return f"{subjects.index[0]} has nothing to be compared with."
    if n < statistics.FEW_SUBJECTS:
        return f"{n} subject{'s are' if n != 1 else ' is'} too few to tell {systems} systems apart."
    return _against_best(subjects) + (
        " Captures of one subject are on both sides, so that nothing holds for a new person." * group.mixed
    )


def _against_best(subjects: pd.DataFrame) -> str:
    """The systems that the best one beats, and those that cannot be told apart from it."""
    rows = statistics.against_best(subjects).iloc[1:]
    best = subjects.index[0]
    behind, level = ([*rows.loc[beaten, "system"]] for beaten in (rows["p_holm"] < 0.05, ~(rows["p_holm"] < 0.05)))
    test = f"(paired Wilcoxon tests against the best, Holm's correction, over {subjects.shape[1]} subjects, 5 %)"
    if len(level) > 1 and not behind:
        return f"None of the other {len(level)} systems can be told apart from {best} {test}."
    parts = [f"{best} beats {listed(behind)}"] if behind else []
    parts += [f"{listed(level)} cannot be told apart from {best}"] if level else []
    return f"{'; '.join(parts)} {test}."
