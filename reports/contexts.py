"""Comparable results in words, for the page: the newest of each system, the largest groups first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench import few
from bench.comparable import Row, context_of, seed_number, shared
from bench.outcomes.frame import grouped
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
        accurate systems.
    """
    counted = lambda r: sum(name.startswith(more) for name in r.metrics) if more else 0  # noqa: E731
    complete = [r for r in results if r.complete][::-1]  # the newest first
    groups = []
    for words, runs in grouped(sorted(complete, key=lambda r: (seed_number(r["seed"]), -counted(r))), same).items():
        first: dict[str, Result] = {}
        for r in runs:
            first.setdefault(r["system"], r)
        groups.append((words, [*first.values()], any(first[r["system"]]["seed"] != r["seed"] for r in runs)))
    named = []
    for words, members, several in sorted(groups, key=lambda g: (g[1][0]["synthetic"], -len(g[1])))[:CONTEXTS]:
        best = sorted(members, key=lambda r: -(r[score] if score else clean_accuracy(r)))[:METHODS]
        left = len(members) - len(best)
        told = f", {left} less accurate systems left out" * bool(left)
        named.append((words + told + ", only the lowest seed of each system" * several, best))
    return named


def scarce(results: Sequence[Result]) -> list[str]:
    """A sentence for each number of subjects of some results that is too small for an interval."""
    people = sorted({int(r["subjects"]) for r in results if r.get("subjects", few.INTERVAL) < few.INTERVAL})
    return [f"{few.too_few(n)}." for n in people]


def context_words(run: Row, same: Mapping[str, tuple[str, str]] | None = None) -> str:
    """Corpus and protocol of a run in words, and the shared parameters that differ from their usual values."""
    return ", ".join([*context_of(run), *shared(run, same or {})])
