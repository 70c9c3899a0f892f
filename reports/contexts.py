"""Comparable results in words, for the page: the newest of each system, the largest groups first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench import few
from bench.comparable import Row, alike, context_of, seed_number, shared
from bench.result import Result
from bench.work.curves import clean_accuracy

CONTEXTS = 3  # captures-and-protocol groups that are drawn
METHODS = 10  # of a context


def contexts(
    results: Sequence[Result],
    same: Mapping[str, tuple[str, str]] | None = None,
    score: str = "",
    more: str = "",
) -> list[tuple[str, list[Result]]]:
    """Complete results by comparability: for each system, the newest of its lowest seed.

    Args:
        results: results that have one circumstance, or are of one kind of run.
        same: parameters that comparable results share, besides captures and protocol (`bench.comparable.shared`).
        score: number by which systems are ordered; empty for the accuracy of the captures as they are.
        more: beginning of the names of numbers of which a result with more stands before a newer one with fewer.

    Returns:
        At most `CONTEXTS` groups with their words, people first and the largest first, each with its `METHODS` most
        accurate systems. Two groups may have the same words.
    """
    complete = [r for r in results if r.complete][::-1]  # the newest first
    groups: dict[tuple, dict[str, Result]] = {}
    several: set[tuple] = set()  # groups that have runs of a system with other seeds
    counted = lambda r: sum(name.startswith(more) for name in r.metrics) if more else 0  # noqa: E731
    for r in sorted(complete, key=lambda r: (seed_number(r["seed"]), -counted(r))):
        key = alike(r, same or ())
        if groups.setdefault(key, {}).setdefault(r["system"], r)["seed"] != r["seed"]:
            several.add(key)
    ordered = sorted(groups.items(), key=lambda g: (next(iter(g[1].values()))["synthetic"], -len(g[1])))
    named = []
    for key, members in ordered[:CONTEXTS]:
        best = sorted(members.values(), key=lambda r: -(r[score] if score else clean_accuracy(r)))[:METHODS]
        left = len(members) - len(best)
        words = context_words(best[0], same) + (f", {left} less accurate systems left out" if left else "")
        named.append((words + (", only the lowest seed of each system" if key in several else ""), best))
    return named


def scarce(results: Sequence[Result]) -> list[str]:
    """A sentence for each number of subjects of some results that is too small for an interval."""
    people = sorted({int(r["subjects"]) for r in results if r.get("subjects", few.INTERVAL) < few.INTERVAL})
    return [f"{few.too_few(n)}." for n in people]


def context_words(run: Row, same: Mapping[str, tuple[str, str]] | None = None) -> str:
    """Corpus and protocol of a run in words, and the shared parameters that differ from their usual values."""
    return ", ".join([*context_of(run), *shared(run, same or {})])
