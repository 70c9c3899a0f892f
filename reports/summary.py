"""The report on one group of comparable runs: tests, choice, tables and sentences."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bench.corpora.fault_names import FAULT_NAMES
from bench.errors import InputError
from bench.ground.registry import registered_parts, views_of_circumstances
from bench.ground.typed import format_command
from bench.reading import statistics
from bench.reading.candidates import find_candidates
from bench.reading.choice import Choice, candidate_name, choose_candidate
from bench.reading.frame import accuracy_by_subject
from bench.reports.comparison import protocol_precedence
from bench.reports.figures import Picture
from bench.values import few
from bench.values.intervals import mean_interval
from bench.values.measures import (
    Measure,
    all_costs,
    costs_of_run_kind,
    format_p_value,
    format_three_digits,
    text_measure,
    value_or_none,
)
from bench.values.result import ALSO_MARK, COMPARISON_TAGS, MIXED_NOTE, Result, footnotes_of_system
from bench.values.scores import label_captures
from bench.values.sentences import render_sentences
from bench.values.table import Table, rows_of_frame

GROUPS = 3  # groups that the page shows
BY = "flash"  # the cost to minimise, as bench choose does by default
COSTS = 3  # of the answer and of the table; the chart has all
# Behind the rank of a system that the test cannot separate from the first.
INSEPARABLE = "\N{ALMOST EQUAL TO}"
SENTENCES = 2  # of the answer; the others are closed
STATISTICS = (  # columns of `bench.reading.statistics.compare_with_base`
    text_measure("system"),
    Measure("accuracy", "mean over subjects %"),
    Measure("difference", form="+.1f", ends="difference"),
    Measure("p", "p Wilcoxon", form=format_p_value),
    Measure("p_holm", "p Holm", form=format_p_value),
    Measure("seeds", form=".0f", spare=1),
)


@dataclass
class Summary:
    """A group of comparable runs in the report.

    Attributes:
        name: captures and protocol in words.
        results: its runs.
        subjects: accuracy in percent [systems, subjects], best first; empty without complete runs.
        rows: statistics of each system against the compared one.
        against: system to compare with; empty for the best one.
        lines: the verdict, its reasons, and all other sentences on the choice.
        command: ``bench choose`` with the same verdict; may be empty.
        choice: None if nothing can be chosen.
        label: label of its tab.
        key: the same in an address.
        page_data: numbers for the script of the page (`bench.reports.live`).
        charts: for each cost its name (``label``) and ``picture``.
        pictures: figures by kind.
    """

    name: str
    results: Sequence[Result]
    subjects: pd.DataFrame
    rows: pd.DataFrame
    against: str = ""
    lines: Sequence[str] = ()
    command: str = ""
    choice: Choice | None = None
    label: str = ""
    key: str = ""
    page_data: str = ""
    charts: list[dict[str, Any]] = field(default_factory=list)
    pictures: Mapping[str, Picture] = field(default_factory=dict)

    @property
    def data(self) -> str:
        """Name of the corpus, for footnotes."""
        return str(self.results[0]["data"])

    @property
    def mixes_subjects(self) -> bool:
        """True if a fold has captures of one subject on both sides."""
        return any(r.mixes_subjects for r in self.results)

    @property
    def arguments(self) -> str:
        """Arguments of the run of the chosen system; empty if it was not typed."""
        if self.choice is None or self.choice.chosen is None:
            return ""
        return str(self.choice.table.loc[self.choice.chosen, "arguments"])

    @property
    def about(self) -> str:
        """Whether the tested people are new."""
        return "tests people of the training set" if self.mixes_subjects else "tests new people"

    @property
    def base(self) -> str:
        """The system that the others are compared with."""
        return statistics.base_system(self.subjects, self.against)

    @property
    def few(self) -> bool:
        """True if there are too few subjects for a p value."""
        return self.subjects.shape[1] < few.FEWEST_FOR_TEST

    @cached_property
    def pairs(self) -> pd.DataFrame:
        """Tests of all pairs of the most accurate systems."""
        compared = self.subjects
        if len(compared):
            compared = statistics.compared_systems(compared, self.against)
        return statistics.paired_tests(compared.iloc[: statistics.PAIRED])

    @property
    def limits(self) -> list[str]:
        """Limits of the conclusions, in sentences."""
        folds = next(int(r["folds"]) for r in self.results if r.is_complete and r.predicts_alone)
        best_is_base = self.against not in {*self.rows["system"]}
        return statistics.limits_of_conclusions(
            self.subjects.shape[1], len(self.rows), folds, self.mixes_subjects, best_is_base
        )

    @property
    def statistics_table(self) -> Table | None:
        """Every system against the best one, or another one; None without complete runs."""
        if not len(self.rows):
            return None
        rows = self.rows.rename(columns={"low": "difference_low", "high": "difference_high"})
        footnotes = [footnotes_of_system(system, self.data) for system in rows["system"]]
        return Table(STATISTICS, rows_of_frame(rows), remarks=footnotes)

    @cached_property
    def costs(self) -> list[str]:
        """Costs that some candidate has, or that have a budget."""
        if self.choice is None:
            return []
        table, costs, known = self.choice.table, costs_of_run_kind(""), {*self.choice.budgets}
        for name, cost in costs.items():
            if name in self.choice.candidates.hidden_costs:
                continue
            if (table[name].notna() if cost.is_linear else table[name] > 0).any():
                known.add(name)
        if table["worst_tenth"].equals(table["worst_person"]):  # of ten people or fewer
            known -= {"worst_tenth"} - {*self.choice.budgets}
        return [name for name in costs if name in known]

    @property
    def leading_costs(self) -> list[str]:
        """The costs of the answer and of the table: those with a budget, then the first ones."""
        budgets = self.choice.budgets if self.choice is not None else ()
        return sorted(self.costs, key=lambda name: name not in budgets)[:COSTS]

    @property
    def chosen(self) -> dict[str, str]:
        """The chosen system: ``name``, ``accuracy``, ``interval``, ``costs``; empty without any."""
        if self.choice is None or self.choice.chosen is None:
            return {}
        row = self.choice.table.loc[self.choice.chosen]
        people = self.choice.candidates.subjects.loc[self.choice.chosen].to_numpy(float)
        low, high = np.clip(mean_interval(people), 0, 100)
        interval = f"95 % CI {low:.1f} to {high:.1f}, {len(people)} subjects"
        costs = []
        for name in self.leading_costs:
            if value_or_none(row[name]) is not None:
                cost = all_costs()[name]
                costs.append(f"{cost.format_amount(row[name])} {cost.phrase}")
        return {
            "name": candidate_name(row),
            "accuracy": f"{row['accuracy']:.1f} %",
            "interval": few.too_few_sentence(len(people)) if np.isnan(low) else interval,
            "costs": ", ".join(costs),
        }

    @property
    def sentences(self) -> list[str]:
        """The reason of the choice."""
        lines = [*self.lines[1 : 1 + SENTENCES]]
        mixed = MIXED_NOTE in self.lines and MIXED_NOTE not in lines
        return lines + [MIXED_NOTE] * mixed

    @property
    def more(self) -> list[str]:
        """All other sentences on the choice."""
        return [line for line in self.lines[1:] if line not in self.sentences]

    @cached_property
    def table(self) -> Table | None:
        """The systems on whole captures, and the chosen candidate, most accurate first.

        ``rank`` has the places that a system may have by the test, ``difference`` is the accuracy
        minus that of the compared system, in points, and ``test`` is p Holm, n.s., or the reason
        why there is none.
        """
        if self.choice is None or not len(self.subjects):
            return None
        table, chosen = self.choice.table, self.choice.chosen
        table = table[(table["unit"] == "capture") | (table.index == chosen)]
        if not len(table):
            return None
        table = table.sort_values("accuracy", ascending=False, kind="stable")
        people = self.choice.candidates.subjects.loc[table.index].to_numpy(float)
        base_accuracy, ranks = self.subjects.loc[self.base].mean(), self._rank_words()
        rows = []
        for i, row, scores in zip(table.index, rows_of_frame(table), people, strict=True):
            system, name = row["system"], candidate_name(row)
            tested = row["unit"] == "capture" and not row["mark"]
            low, high = np.clip(mean_interval(scores), 0, 100)
            is_base = tested and system == self.base
            row |= {
                "id": i,
                "name": name,
                "accuracy_low": low,
                "accuracy_high": high,
                "tested": tested,
                "shown": name + " (chosen)" * (i == chosen),
                "rank": ranks.get(system, "not tested") if tested else "not tested",
                "difference": np.nan if is_base else row["accuracy"] - base_accuracy,
                "test": self._test_words(system) if tested else "not tested",
            }
            rows.append(row)
        columns = [
            text_measure("system", source="shown"),
            text_measure("rank"),
            Measure("accuracy", "accuracy % [95 %]", ends="accuracy"),
            Measure("difference", form="+.1f"),
            text_measure("test"),
            *map(cost_column, self.leading_costs),
        ]
        bold = np.flatnonzero(table.index == chosen).tolist()
        footnotes = [footnotes_of_system(str(row["system"]), self.data) for row in rows]
        return Table(columns, rows, bold=bold, remarks=footnotes)

    def _rank_words(self) -> dict[str, str]:
        """The places of each tested system, marked if it is inseparable from the first."""
        places = statistics.rank_ranges(statistics.compared_systems(self.subjects, self.against))
        several_first = bool((places["best"] == 1).sum() > 1)
        words = {}
        for row in places.itertuples():
            place = f"{row.best}" if row.best == row.worst else f"{row.best}-{row.worst}"
            words[row.Index] = place + f" {INSEPARABLE}" * (several_first and row.best == 1)
        return words

    def _test_words(self, system: str) -> str:
        """Corrected p of a system against the compared one, n.s., or the reason for no test."""
        if system == self.base:
            return "reference"
        if self.few:
            return "too few subjects"
        p_values = dict(zip(self.rows["system"], self.rows["p_holm"], strict=True))
        p = value_or_none(p_values.get(system))
        if p is None:
            return "not tested"
        return "n.s." if p >= 0.05 else format_p_value(p)

    @property
    def people(self) -> str:
        """A sentence on the spread of the best system over several people."""
        if not len(self.subjects) or self.subjects.shape[1] < 2:
            return ""
        best = self.subjects.iloc[0]
        values = {"name": self.name, "best": best}
        return render_sentences("bench.reports", "sentences", "people", **values)[0]


def cost_column(name: str) -> Measure:
    """The column of a cost."""
    cost = all_costs()[name]
    heading = cost.heading or f"{cost.title} {cost.unit}".strip()
    return Measure(name, heading, form=format_three_digits)


def model_family(model: str) -> str:
    """``networks``, ``features`` (classifiers on features), or ``own`` for other models."""
    place = registered_parts("models").get(model, "")
    if not place.startswith("bench.models."):
        return "own"
    return "networks" if ".nets." in place else "features"


def split_largest_groups(
    groups: Mapping[str, Sequence[Result]],
) -> tuple[dict[str, Sequence[Result]], list[str]]:
    """Results by group, and the names of groups beyond `GROUPS`.

    Corpora as imported now precede earlier captures, people precede generated captures, protocols
    and others as `protocol_precedence` says; then come the groups with most systems.
    """

    def precedence(name: str) -> tuple:
        results = groups[name]
        synthetic, stale = max(r["synthetic"] for r in results), any(r.is_stale for r in results)
        systems = len({r.system for r in results})
        return stale, synthetic, *protocol_precedence(results), -systems, name

    ordered = sorted(groups, key=precedence)
    return {name: groups[name] for name in ordered[:GROUPS]}, ordered[GROUPS:]


def tab_labels(groups: Mapping[str, Sequence[Result]]) -> list[str]:
    """The names of tabs: protocols, if these tell the groups apart; else the groups."""
    contexts = [results[0].context for results in groups.values()]
    captures, protocols = {context[:2] for context in contexts}, [each[2] for each in contexts]
    unique = len({*protocols}) == len(protocols)
    return protocols if len(captures) == 1 and unique else [*groups]


def summarise_group(
    name: str,
    results: Sequence[Result],
    all_results: Sequence[Result],
    budgets: Mapping[str, float],
    against: str = "",
) -> Summary:
    """Tests and choice of a group, without figures."""
    first, (subjects, rows) = results[0], compare_systems(results, against)
    summary = Summary(name, results, subjects, rows, against)
    lossy = [v for v in views_of_circumstances() if any(cost.is_fault_loss for cost in v.costs)]
    with_losses = any(all_costs()[cost].is_fault_loss for cost in budgets)
    with_losses = with_losses or any(v.applies_to(r) for r in all_results for v in lossy)
    try:
        candidates = find_candidates(
            all_results,
            {key: [first[key]] for key in COMPARISON_TAGS},
            latest_ms=budgets.get("decision"),
            faults=FAULT_NAMES if with_losses else (),
        )
    except InputError as e:
        summary.lines = [f"Nothing can be chosen here: {e}."]
        return summary
    summary.choice = choice = choose_candidate(candidates, BY, dict(budgets))
    lines = [*choice.reason_sentences(), *choice.expectation_sentences(), *candidates.notes]
    systems = candidates.table["system"].unique()
    if len(systems) == 1:
        alone = f"Only {systems[0]} has a run here, so there is no other system to compare."
        lines.insert(1, alone)
    lines[1:1] = added_people_sentences(subjects)
    notes = [note for system in systems for note in footnotes_of_system(system, first["data"])]
    summary.lines = [*lines, *dict.fromkeys(notes)]
    if command := _choose_command(candidates.table, first, all_results):
        limits = [all_costs()[cost].format_budget(value) for cost, value in budgets.items()]
        summary.command = " ".join([command, *limits])
    return summary


def added_people_sentences(subjects: pd.DataFrame) -> list[str]:
    """What the people of other corpora in training change, for each system with a plain run.

    Args:
        subjects: accuracy in percent [systems, subjects].
    """
    sentences = []
    for system in subjects.index:
        plain, mark, also = system.partition(ALSO_MARK)
        plain = plain.rstrip()
        if mark and plain in subjects.index:
            test = statistics.paired_test(subjects.loc[system], subjects.loc[plain])
            values = {"plain": plain, "also": also, "people": subjects.shape[1]} | test
            sentences += render_sentences("bench.reports", "sentences", "added", **values)
    return sentences


def _choose_command(table: pd.DataFrame, first: Result, results: Sequence[Result]) -> str:
    """The command that chooses in a group; empty if its words would mean other runs, too."""
    # Of the first candidate whose run was typed; those made from Python with objects have none.
    arguments = next((json.loads(text) for text in table["arguments"] if text), {})
    if not arguments:
        return ""
    protocol = {k: v for k, v in arguments.items() if k.split(".")[0] == "protocol"}
    names = ["data", "subset", "target", "protocol_name", *(k for k in protocol if "." in k)]
    selected = [r for r in results if all(r.get(name) == first.get(name) for name in names)]
    tags = (*COMPARISON_TAGS, "protocol")
    if len({tuple(str(r.get(name)) for name in tags) for r in selected}) > 1:
        return ""
    words = {"data": arguments["data"], "where": first["subset"]}
    words |= {"target": first["target"]} if first["target"] != "gesture" else {}
    return format_command("choose", words | protocol)


def compare_systems(
    results: Sequence[Result], against: str = ""
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Accuracy in percent [systems, subjects], best first, and the statistics of each system.

    Both are empty without a complete run.
    """
    results = [r for r in results if r.predicts_alone]
    subjects, seeds = accuracy_by_subject(results)
    if not len(subjects):
        return subjects, pd.DataFrame()
    compared = statistics.compared_systems(subjects, against)
    complete = [r for r in results if r.is_complete and r.system in compared.index]
    stored_ratio = next(r for r in results if r.is_complete)["test_over_train"]
    ratio = (
        float(stored_ratio) if stored_ratio else None
    )  # None if folds share no training captures
    by_fold = None
    if ratio is not None and {*accuracy_by_fold(complete[0])} != {*compared.columns}:
        folds = pd.DataFrame(map(accuracy_by_fold, complete), index=[r.system for r in complete])
        by_fold = folds.groupby(level=0).mean().reindex(compared.index)
    rows = statistics.compare_with_base(compared, by_fold, ratio, against)
    rows = rows.assign(seeds=rows["system"].map(seeds))
    if len(compared) > 2 and subjects.shape[1] > 1:
        ranks, p = statistics.friedman(compared)
        rows = rows.assign(mean_rank=rows["system"].map(ranks), friedman_p=p)
    return subjects, rows


def accuracy_by_fold(result: Result) -> dict[str, float]:
    """Accuracy of the captures of each fold, in percent."""
    labelled = label_captures(result.tables["predictions"])
    correct = labelled["true"] == labelled["predicted"]
    return (100 * correct.groupby(labelled["fold"], sort=False).mean()).to_dict()
