"""The report on one group of comparable runs: tests, choice, tables and sentences, each computed once."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.ground.registry import circumstance_views, names
from bench.ground.words import typed
from bench.reading import statistics
from bench.reading.candidates import PLAIN, Candidates, candidates
from bench.reading.choice import Choice, decide, expectation, expected, named, reasons
from bench.reading.frame import by_subject
from bench.reading.scene import EVERY
from bench.reports.figures import Picture
from bench.values import few
from bench.values.candidate import Losses, Wish
from bench.values.intervals import interval
from bench.values.measures import Measure, costs, costs_of, known, p_value, text, three
from bench.values.result import COMPARABLE, MIXED, Result, notes_on
from bench.values.scores import captures
from bench.values.sentences import sentences
from bench.values.table import Table, rows_of

GROUPS = 3  # groups that get a verdict, statistics and figures
BY = "flash"  # the cost that is to be low, unless bench choose is told another
COSTS = 3  # of the answer and of the table; the chart has all
FIRST = (
    "\N{ALMOST EQUAL TO}"  # behind the place of a system that the test cannot tell from the first
)
SENTENCES = 2  # of the answer; the others are closed
STATISTICS = (  # columns of `bench.reading.statistics.against_best`
    text("system"),
    Measure("accuracy", "mean over subjects %"),
    Measure("difference", form="+.1f", ends="difference"),
    Measure("p", "p Wilcoxon", form=p_value),
    Measure("p_holm", "p Holm", form=p_value),
    Measure("seeds", form=".0f", spare=1),
)


@dataclass
class Summary:
    """A group of comparable runs in the report; the page fills in ``label`` and what follows it."""

    name: str  # captures and protocol in words
    results: Sequence[Result]
    subjects: (
        pd.DataFrame
    )  # accuracy in percent [systems, subjects], best first; empty without complete runs
    rows: pd.DataFrame  # statistics of each system against the compared one
    against: str = ""  # the system to compare with, if that was asked for
    lines: Sequence[str] = ()  # the verdict, its reasons, and all else that is known of the choice
    command: str = ""  # that gives the same verdict
    choice: Choice | None = None  # None if nothing can be chosen
    among: Candidates | None = None
    budgets: Mapping[str, float] = field(default_factory=dict)
    label: str = ""  # of the group's tab
    key: str = ""  # of the same in an address
    live: str = ""  # what the script of the page needs (`bench.reports.live`)
    charts: list[dict[str, Any]] = field(
        default_factory=list
    )  # ``label``, the name of a cost, and ``picture``
    pictures: Mapping[str, Picture] = field(default_factory=dict)  # by kind

    @property
    def data(self) -> str:
        """Name of the corpus, for footnotes."""
        return str(self.results[0]["data"])

    @property
    def mixed(self) -> bool:
        """True if a fold has captures of one subject on both sides."""
        return any(r.mixed for r in self.results)

    @property
    def arguments(self) -> str:
        """Arguments of the run of the chosen system; empty if it was not typed."""
        if self.choice is None or self.choice.chosen is None:
            return ""
        return str(self.choice.table.loc[self.choice.chosen, "arguments"])

    @property
    def about(self) -> str:
        """Whether the tested people are new."""
        return "tests people of the training set" if self.mixed else "tests new people"

    @property
    def base(self) -> str:
        """The system that the others are compared with."""
        return statistics.base_of(self.subjects, self.against)

    @property
    def few(self) -> bool:
        """True if there are too few subjects for a p value."""
        return self.subjects.shape[1] < few.TEST

    @cached_property
    def pairs(self) -> pd.DataFrame:
        """Tests of all pairs of the most accurate systems."""
        kept = (
            statistics.kept_of(self.subjects, self.against) if len(self.subjects) else self.subjects
        )
        return statistics.pairs(kept.iloc[: statistics.PAIRED])

    @property
    def limits(self) -> list[str]:
        """Limits of the conclusions, in sentences."""
        folds = next(int(r["folds"]) for r in self.results if r.complete and r.alone)
        selected = self.against not in {*self.rows["system"]}
        return statistics.warnings(
            self.subjects.shape[1], len(self.rows), folds, self.mixed, selected
        )

    @property
    def compared(self) -> Table | None:
        """Every system against the best one, or another one."""
        if not len(self.rows):
            return None
        rows = self.rows.rename(columns={"low": "difference_low", "high": "difference_high"})
        return Table(
            STATISTICS,
            rows_of(rows),
            remarks=[notes_on(system, self.data) for system in rows["system"]],
        )

    @cached_property
    def costs(self) -> list[str]:
        """Costs that are known of a candidate, or have a budget; a tenth of ten people is the worst person."""
        if self.choice is None:
            return []
        table, shared = self.choice.table, costs_of("")
        seen = {
            name
            for name in shared
            if (table[name].notna() if shared[name].linear else table[name] > 0).any()
        }
        if table["worst_tenth"].equals(table["worst_person"]):
            seen -= {"worst_tenth"}
        return [name for name in shared if name in seen | {*self.budgets}]

    @property
    def leading(self) -> list[str]:
        """The costs that the answer and the table have: those with a budget, then the first ones."""
        return sorted(self.costs, key=lambda name: name not in self.budgets)[:COSTS]

    @property
    def chosen(self) -> dict[str, str]:
        """The chosen system: ``name``, ``accuracy``, ``interval`` and ``costs``; empty if none is."""
        if self.choice is None or self.choice.chosen is None or self.among is None:
            return {}
        row, people = (t.loc[self.choice.chosen] for t in (self.choice.table, self.among.subjects))
        low, high = np.clip(interval(people.to_numpy(float)), 0, 100)
        n, amounts = len(people), {costs()[name]: row[name] for name in self.leading}
        return {
            "name": named(row),
            "accuracy": f"{row['accuracy']:.1f} %",
            "interval": few.too_few(n)
            if np.isnan(low)
            else f"95 % CI {low:.1f} to {high:.1f}, {n} subjects",
            "costs": ", ".join(
                f"{cost.amount(a)} {cost.words}"
                for cost, a in amounts.items()
                if known(a) is not None
            ),
        }

    @property
    def sentences(self) -> list[str]:
        """The reason of the choice."""
        lines = [*self.lines[1 : 1 + SENTENCES]]
        return [*lines, MIXED] if MIXED in self.lines and MIXED not in lines else lines

    @property
    def more(self) -> list[str]:
        """All that is known of the choice besides."""
        return [line for line in self.lines[1:] if line not in self.sentences]

    @cached_property
    def table(self) -> Table | None:
        """The systems on whole captures, and the chosen candidate, most accurate first; None without candidates.

        ``rank`` has the places that a system may have by the test, ``difference`` is the accuracy less that of the
        compared system, in points, and ``test`` is p Holm, n.s., or the reason why there is none.
        """
        if self.choice is None or self.among is None or not len(self.subjects):
            return None
        table, chosen = self.choice.table, self.choice.chosen
        table = table[(table["unit"] == "capture") | (table.index == chosen)]
        table = table.sort_values("accuracy", ascending=False, kind="stable")
        if not len(table):
            return None
        people, least = (
            self.among.subjects.loc[table.index].to_numpy(float),
            self.subjects.loc[self.base].mean(),
        )
        places = statistics.ranks(statistics.kept_of(self.subjects, self.against))
        ranks = {
            r.Index: f"{r.best}-{r.worst}".removesuffix(f"-{r.best}") for r in places.itertuples()
        }
        alike = [*places.index[places["best"] == 1]]
        rows = []
        for i, row, scores in zip(table.index, rows_of(table), people, strict=True):
            low, high = np.clip(interval(scores), 0, 100)
            plain = row["unit"] == "capture" and not row["mark"]
            row |= {
                "id": i,
                "name": named(row),
                "accuracy_low": low,
                "accuracy_high": high,
                "plain": plain,
            }
            row["shown"] = row["name"] + " (chosen)" * (i == chosen)
            row["rank"] = ranks.get(row["system"], "not tested") if plain else "not tested"
            row["rank"] += f" {FIRST}" * (plain and row["system"] in alike and len(alike) > 1)
            row["difference"] = (
                np.nan if plain and row["system"] == self.base else row["accuracy"] - least
            )
            rows.append(row | {"test": self._test(row["system"]) if plain else "not tested"})
        measures = [
            text("system", read="shown"),
            text("rank"),
            Measure("accuracy", "accuracy % [95 %]", ends="accuracy"),
            Measure("difference", form="+.1f"),
            text("test"),
            *(self.column(name) for name in self.leading),
        ]
        bold = np.flatnonzero(table.index == chosen).tolist()
        remarks = [notes_on(str(row["system"]), self.data) for row in rows]
        return Table(measures, rows, bold=bold, remarks=remarks)

    def column(self, name: str) -> Measure:
        """The column of a cost."""
        return Measure(
            name,
            costs()[name].heading or f"{costs()[name].title} {costs()[name].unit}".strip(),
            form=three,
        )

    def _test(self, system: str) -> str:
        """Corrected p of a system against the compared one, n.s., or the reason why there is none."""
        if system == self.base:
            return "reference"
        if self.few:
            return "too few subjects"
        p = known(dict(zip(self.rows["system"], self.rows["p_holm"], strict=True)).get(system))
        return "not tested" if p is None else "n.s." if p >= 0.05 else p_value(p)

    @property
    def people(self) -> str:
        """A sentence on the spread of the best system over several people."""
        if not len(self.subjects) or self.subjects.shape[1] < 2:
            return ""
        return sentences(
            "bench.reports", "sentences", "people", name=self.name, best=self.subjects.iloc[0]
        )[0]


def family(model: str) -> str:
    """``networks``, ``features`` (classifiers on features), or ``own`` for a model that is none of ours."""
    place = names("models").get(model, "")
    return (
        "own"
        if not place.startswith("bench.models.")
        else "networks"
        if ".nets." in place
        else "features"
    )


def largest_groups(
    groups: Mapping[str, Sequence[Result]],
) -> tuple[dict[str, Sequence[Result]], list[str]]:
    """Results by group, and the names of groups beyond `GROUPS`.

    People stand before generated captures, protocols that say something of new persons before those that mix subjects,
    then the groups with most subjects, then those with most systems.
    """

    def order(name: str) -> tuple:
        results = groups[name]
        mixed = any(r.mixed for r in results)
        synthetic = max(r["synthetic"] for r in results)
        subjects = max(r.get("subjects", 0) for r in results)
        return synthetic, mixed, -subjects, -len({r.system for r in results}), name

    ordered = sorted(groups, key=order)
    return {name: groups[name] for name in ordered[:GROUPS]}, ordered[GROUPS:]


def labels(groups: Mapping[str, Sequence[Result]]) -> list[str]:
    """The names of tabs: protocols, if these tell the groups apart; else the groups."""
    protocols = [results[0].context[2] for results in groups.values()]
    alike = len({results[0].context[:2] for results in groups.values()}) == 1 and len(
        {*protocols}
    ) == len(protocols)
    return protocols if alike else [*groups]


def summary_of(
    name: str,
    results: Sequence[Result],
    every: Sequence[Result],
    budgets: Mapping[str, float],
    against: str = "",
) -> Summary:
    """Tests and choice of a group; figures are not drawn yet."""
    subjects, rows = tested(results, against)
    first = results[0]
    lossy = [c for c in circumstance_views() if any(cost.losses for cost in c.costs)]
    lost = any(c.holds(r) for r in every for c in lossy) or any(
        costs()[cost].losses for cost in budgets
    )
    asked = {key: [first[key]] for key in COMPARABLE}
    try:
        wish = Wish(PLAIN, budgets.get("decision"))
        among = candidates(every, asked, wish, losses=Losses(EVERY) if lost else None)
    except InputError as e:
        return Summary(
            name, results, subjects, rows, against, [f"Nothing can be chosen here: {e}."]
        )
    choice = decide(among.table, among.subjects, BY, dict(budgets), None)
    others = expected(among, choice.chosen, BY, budgets, None)
    lines = reasons(choice, BY, None, among.subjects.shape[1], among.mixed)
    lines += [*expectation(others, among, choice.chosen), *among.notes]
    systems = among.table["system"].unique()
    lines += dict.fromkeys(
        note for system in systems for note in notes_on(str(system), str(first["data"]))
    )
    if len(systems) == 1:
        lines.insert(
            1, f"Only {systems[0]} has a run here, so there is no other system to compare."
        )
    words = _command(among.table, first, every)
    limits = [costs()[cost].argument(value) for cost, value in budgets.items()]
    command = " ".join([words, *limits]) if words else ""
    return Summary(name, results, subjects, rows, against, lines, command, choice, among, budgets)


def _command(table: pd.DataFrame, first: Result, results: Sequence[Result]) -> str:
    """The command that chooses among the candidates of a group; empty where its words mean other runs, too."""
    # Of the first candidate whose run was typed; those made from Python with objects have none.
    arguments = next((json.loads(text) for text in table["arguments"] if text), {})
    protocol = {k: v for k, v in arguments.items() if k.split(".")[0] == "protocol"}
    named_by = ["data", "subset", "target", "protocol_name", *(k for k in protocol if "." in k)]
    same = [r for r in results if all(r.get(name) == first.get(name) for name in named_by)]
    if (
        not arguments
        or len({tuple(str(r.get(name)) for name in (*COMPARABLE, "protocol")) for r in same}) > 1
    ):
        return ""
    target = {"target": first["target"]} if first["target"] != "gesture" else {}
    return typed(
        "choose", {"data": arguments["data"], "where": first["subset"]} | target | protocol
    )


def tested(results: Sequence[Result], against: str = "") -> tuple[pd.DataFrame, pd.DataFrame]:
    """Accuracy in percent [systems, subjects], best first, and the statistics of each system against the compared one.

    Both are empty without a complete run.
    """
    results = [r for r in results if r.alone]
    subjects, seeds = by_subject(results)
    if not len(subjects):
        return subjects, pd.DataFrame()
    kept = statistics.kept_of(subjects, against)
    complete = [r for r in results if r.complete and r.system in kept.index]
    shared, by_fold = next(r for r in results if r.complete)["test_over_train"], None
    ratio = float(shared) if shared else None  # None where folds share no training captures
    if ratio is not None and set(fold_accuracy(complete[0])) != set(
        kept.columns
    ):  # folds that are not subjects
        table = pd.DataFrame(
            [fold_accuracy(r) for r in complete], index=[r.system for r in complete]
        )
        by_fold = table.groupby(level=0).mean().reindex(kept.index)
    rows = statistics.against_best(kept, by_fold, ratio, against)
    rows = rows.assign(seeds=rows["system"].map(seeds))
    if len(kept) > 2 and subjects.shape[1] > 1:
        ranks, p = statistics.friedman(kept)
        rows = rows.assign(mean_rank=rows["system"].map(ranks), friedman_p=p)
    return subjects, rows


def fold_accuracy(result: Result) -> dict[str, float]:
    """Accuracy of the captures of each fold, in percent."""
    labelled = captures(result.tables["predictions"])
    hit = labelled["true"] == labelled["predicted"]
    return (100 * hit.groupby(labelled["fold"], sort=False).mean()).to_dict()
