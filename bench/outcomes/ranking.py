"""One ranking of systems over several corpora, by their ranks within each person (Demsar 2006).

Corpora differ in gestures, sensors and people, so their accuracies are not on one scale. Ranks within a person are.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from bench import few
from bench.outcomes import statistics
from bench.resampling import interval, weights
from bench.result import Result

COLUMNS = "system mean_rank low high accuracy difference difference_low difference_high p_holm".split()
SAME = ["synthetic", "subset", "target", "protocol"]  # tags that all ranked corpora share


@dataclass(frozen=True)
class Ranking:
    """Systems that have results on all of some corpora.

    Attributes:
        table: a row per system, best first: ``mean_rank`` over all people with its 95 % interval (``low``, ``high``);
            ``accuracy``, mean over all people; ``difference`` from the first row, ``difference_low``,
            ``difference_high`` and ``p_holm`` as of `bench.outcomes.statistics.against_best`, paired over all people;
            ``<corpus>_accuracy`` and ``<corpus>_place`` of each corpus.
        people: number of people by corpus.
        taus: Kendall's tau between the orders of each two corpora by mean accuracy: both names and the number.
        lacking: ranked corpora without results, by system that is left out.
        unranked: corpora left out because too few systems have results on them, too.
    """

    table: pd.DataFrame
    people: dict[str, int]
    taus: list[tuple[str, str, float]]
    lacking: dict[str, list[str]]
    unranked: list[str]


def ranking(results: pd.DataFrame) -> Ranking | None:
    """Rank the systems within each person of all corpora, 1 for the best; equal ones share their mean rank.

    Ranked are the corpora with the most results, systems that have all of them times people. A system without an
    accuracy of each person of a corpus has no result on it.

    Args:
        results: ``data``, ``system``, ``subject`` and ``accuracy`` (percent), a row for each person and system. Each
            corpus has people of its own.

    Returns:
        None unless two systems have results on two corpora.
    """
    from scipy.stats import kendalltau, rankdata

    tables = {
        str(data): part.pivot(index="system", columns="subject", values="accuracy").dropna().round(9)
        for data, part in results.groupby("data", sort=False)
    }
    if not (corpora := _most_results(tables)):
        return None
    shared = sorted(_shared([tables[name] for name in corpora]))
    accuracy = {name: tables[name].loc[shared] for name in corpora}
    ranks = [rankdata(-each, axis=0) for each in accuracy.values()]
    table = pd.DataFrame({"system": shared, "mean_rank": np.hstack(ranks).mean(axis=1)})
    table["low"], table["high"] = _intervals(ranks)
    means = pd.DataFrame({name: each.mean(axis=1).round(9) for name, each in accuracy.items()})
    for name in corpora:
        table[f"{name}_accuracy"] = means[name].to_numpy()
        table[f"{name}_place"] = rankdata(-means[name])
    everyone = pd.concat(accuracy, axis=1)
    table["accuracy"] = everyone.mean(axis=1).to_numpy()
    table = table.sort_values(["mean_rank", "accuracy"], ascending=[True, False], kind="stable", ignore_index=True)
    tests = statistics.against_best(everyone.loc[table["system"]])
    tests = tests.rename(columns={"low": "difference_low", "high": "difference_high"})
    table = table.merge(tests[["system", *COLUMNS[5:]]], on="system")
    taus = [(a, b, float(kendalltau(means[a], means[b]).statistic)) for a, b in combinations(corpora, 2)]
    systems = dict.fromkeys(str(system) for each in tables.values() for system in each.index if system not in shared)
    return Ranking(
        table[[*COLUMNS, *table.columns.drop(COLUMNS)]],
        {name: each.shape[1] for name, each in accuracy.items()},
        taus,
        {system: [name for name in corpora if system not in tables[name].index] for system in systems},
        [name for name in tables if name not in corpora],
    )


def _intervals(ranks: Sequence[np.ndarray]) -> np.ndarray:
    """95 % intervals of mean ranks [2, systems], people drawn with replacement within each corpus."""
    people = [each.shape[1] for each in ranks]
    if min(people) < few.INTERVAL:
        return np.full((2, len(ranks[0])), np.nan)
    sums = [each @ drawn.T for each, drawn in zip(ranks, weights(people), strict=True)]
    return interval(np.sum(sums, axis=0) / sum(people), axis=1)


def _shared(tables: Iterable[pd.DataFrame]) -> set[str]:
    return set.intersection(*({*each.index} for each in tables))


def _most_results(tables: dict[str, pd.DataFrame]) -> tuple[str, ...]:
    """The corpora whose shared systems have the most results, in their order; none without two systems on two.

    Every set of corpora is considered: of those that share the same systems, the largest has the most results.
    """
    shared: dict[frozenset[str], None] = {}
    for table in tables.values():
        own = frozenset(map(str, table.index))
        shared |= dict.fromkeys(systems for systems in (*(own & s for s in shared), own) if len(systems) > 1)
    choices = [(s, tuple(name for name, table in tables.items() if s <= {*table.index})) for s in shared]

    def results(choice: tuple[frozenset[str], tuple[str, ...]]) -> tuple[int, int]:
        systems, names = choice
        return len(systems) * sum(tables[name].shape[1] for name in names), len(names)

    return max((c for c in choices if len(c[1]) > 1), key=results, default=(None, ()))[1]


def distinct(groups: Mapping[str, Sequence[Result]]) -> list[tuple[dict[str, str], dict[str, str]]]:
    """Groups of runs that test different people, each subject once and left out of training, as they may be ranked.

    Generated corpora do not mix with real ones. Corpora that were changed at import do not count, since their people
    are those of another corpus.

    Args:
        groups: results from `bench.outcomes.runs.grouped`.

    Returns:
        For each subset, target and protocol with runs of several corpora: the group of each corpus by its name, and
        why corpora are left out, by name.
    """
    sets: dict[tuple[str, ...], list[tuple[str, Result]]] = {}
    for name, results in groups.items():
        same = [r for r in results if r["protocol_name"] == "loso"]
        if same:
            largest = max(same, key=lambda r: (r.get("subjects", 0), r["started"]))
            sets.setdefault(tuple(str(largest[tag]) for tag in SAME), []).append((name, largest))
    ranked = []
    for _, members in sorted(sets.items()):
        chosen: dict[str, str] = {}
        left_out: dict[str, str] = {}
        digests: dict[str, str] = {}  # corpus by digest
        for name, r in sorted(members, key=lambda m: (m[1].get("subjects", 0), m[1]["started"]), reverse=True):
            data, digest = str(r["data"]), str(r["corpus_digest"])
            if "+" in data:  # between the names of corpora that one run tests together
                left_out[data] = "several corpora joined"
            elif changes := r.get("touchbench.changes"):
                left_out[data] = f"changed at import: {changes}"
            elif digest in digests:
                left_out[data] = f"the same captures as {digests[digest]}"
            elif data in chosen:
                left_out[f"{data}, corpus {digest[:8]}"] = f"another version of {data}"
            else:
                chosen[data], digests[digest] = name, data
        if len(chosen) > 1:
            ranked.append((chosen, left_out))
    return ranked
