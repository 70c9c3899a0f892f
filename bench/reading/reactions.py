"""Reactions of a robot to gestures, costs of mistakes, and the scores computed from them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bench.corpora.fault_names import NO_FAULT
from bench.errors import InputError, suggest_names
from bench.values.candidate import EARLY, Candidate
from bench.values.intervals import TOLERANCE
from bench.values.result import Result
from bench.values.scores import PREFIX, classes_of
from bench.values.stability import clean_labels
from bench.values.stopping import standing_decisions

WINDOW_COSTS = {"predict": "decide_ms_p50", "decision": "observed_ms"}  # stored names of windows
NOTHING = "nothing"  # the reaction of a robot that does nothing


@dataclass(frozen=True)
class Reactions:
    """Groups of gestures to which a robot reacts alike; by default each is its own reaction.

    The robot takes the reaction with the lowest expected cost. The probability of a reaction is the
    sum over its gestures. With the default costs, it therefore takes the most probable reaction.
    Where a system abstains, it does nothing.

    Args:
        groups: gestures of each reaction; to those of ``nothing`` it does not react.
        ignored: gestures of no group belong to ``nothing``; else each is its own reaction.
        costs: cost of taking one reaction (outer key) for another (inner key), if it is not 1.
        silence: cost of doing nothing where a reaction was meant.
    """

    groups: Mapping[str, Sequence[str]] = field(default_factory=dict)
    ignored: bool = False
    costs: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    silence: float = 1.0

    @property
    def is_default(self) -> bool:
        """True if the score is the accuracy of gestures."""
        return not (self.groups or self.ignored or self.costs) and self.silence == 1

    @property
    def is_weighted(self) -> bool:
        """True if some mistakes cost more or less than others."""
        return bool(self.costs) or self.silence != 1

    def reaction_by_gesture(self, gestures: Collection[str]) -> dict[str, str]:
        """The reaction to each gesture; an `InputError` if a group or cost has another name."""
        gestures = {*gestures}
        meant = {gesture: name for name, members in self.groups.items() for gesture in members}
        for name, members in self.groups.items():
            check_known(f"[reactions] {name}", "gesture", members, gestures)
        for name in () if self.is_default else (*self.groups, NOTHING):
            if name in gestures and name not in meant and not self.ignored:
                raise InputError(
                    f"[reactions] {name}: this is also a gesture that is not listed; list it or "
                    f"rename {name}"
                )
        reactions = {g: meant.get(g, NOTHING if self.ignored else g) for g in sorted(gestures)}
        for true, row in self.costs.items():
            check_known(f"[costs] {true}", "reaction", (true, *row), {*reactions.values(), NOTHING})
        return reactions

    def cost_table(self, gestures: Collection[str]) -> pd.DataFrame:
        """Cost of each reaction taken (column) for each one meant (row); ``nothing`` is last."""
        reactions = self.reaction_by_gesture(gestures).values()
        names = [*dict.fromkeys(name for name in reactions if name != NOTHING), NOTHING]
        table = pd.DataFrame(1.0, index=names, columns=names)
        table[NOTHING] = self.silence
        for true, row in self.costs.items():
            for taken, cost in row.items():
                table.loc[true, taken] = cost
        return table.mask(np.eye(len(names), dtype=bool), 0.0)

    def cheapest_reactions(self, probabilities: pd.DataFrame) -> np.ndarray:
        """The reactions with the lowest expected cost [decisions]; the first of equal ones."""
        table = self.cost_table(probabilities.columns)
        reactions = pd.Series(self.reaction_by_gesture(probabilities.columns))
        names = reactions[[*probabilities.columns]].to_numpy()
        member = (names[:, None] == table.index.to_numpy()).astype(float)
        expected = (probabilities.to_numpy(dtype=float) @ member) @ table.to_numpy()
        cheapest = expected.round(12).argmin(axis=1)  # equal sums differ by rounding
        taken = table.columns.to_numpy(object)[cheapest]
        return np.where(probabilities.to_numpy().any(axis=1), taken, NOTHING)

    def mistake_costs(self, labels: pd.DataFrame) -> np.ndarray:
        """The cost of each label, 0 for the right reaction, float [rows]."""
        gestures = {*labels["true"]}.union(*self.groups.values())
        table, reactions = self.cost_table(gestures), self.reaction_by_gesture(gestures)
        true = labels["true"].astype(object).map(reactions)
        if "taken" in labels:
            taken = labels["taken"]
        else:
            taken = labels["predicted"].astype(object).map(reactions)
        row, column = (
            table.index.get_indexer(pd.Index(each.fillna(NOTHING))) for each in (true, taken)
        )
        return table.to_numpy()[row, column]

    def score_by_subject(self, labels: pd.DataFrame) -> pd.Series:
        """The score of each subject, 100 less 100 times the mean cost; by default its accuracy."""
        costs = pd.Series(self.mistake_costs(labels), labels.index)
        means = costs.groupby(labels["subject"].astype(str)).mean()
        return (100 * (1 - means)).rename_axis("subject")


def check_known(where: str, noun: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse a name that is not known, as an error in a line or section of a scene."""
    for name in names:
        if name not in known:
            raise InputError(f"{where}: there is no {noun} {name}; {suggest_names(name, known)}")


def react_to_captures(predictions: pd.DataFrame, reactions: Reactions) -> pd.DataFrame:
    """``subject``, ``true`` and the reaction ``taken`` of each capture, by mean probability."""
    captures = predictions.groupby(["fold", "capture"], sort=False)
    mean = captures[[PREFIX + c for c in classes_of(predictions)]].mean()
    table = captures[["subject", "true"]].first().join(mean)
    return react_to_decisions(table, reactions).reset_index()


def react_to_decisions(predictions: pd.DataFrame, reactions: Reactions) -> pd.DataFrame:
    """The same for each row of the table: each window, or each capture at an instant."""
    classes = classes_of(predictions)
    probabilities = predictions[[PREFIX + c for c in classes]].set_axis(classes, axis=1)
    taken = reactions.cheapest_reactions(probabilities)
    return predictions[["subject", "true"]].assign(taken=taken)


def clean_candidate(result: Result, reactions: Reactions, windows: bool) -> Candidate:
    """The system in Python on whole captures, or on single windows."""
    if windows:
        decisions = react_to_decisions(result.tables["predictions"], reactions)
        return Candidate("window", reactions.score_by_subject(decisions), WINDOW_COSTS)
    # The accuracy that the run stored is the same: reading predictions of 1000 runs takes a minute.
    stored = result.accuracy_by_subject if reactions.is_default else {}
    scores: Mapping[str, float] | pd.Series = stored
    if not stored:
        scores = reactions.score_by_subject(
            react_to_captures(result.tables["predictions"], reactions)
        )
    return Candidate("capture", scores, whole=True)


def early_candidates(
    result: Result, reactions: Reactions, latest_ms: float | None
) -> Iterator[Candidate]:
    """A replayed system after the last time that is soon enough.

    If no time is soon enough, the earliest one is taken. With ``latest_ms`` of ``inf``, each time
    is a candidate; with None, none is.
    """
    if latest_ms is None:
        return
    table, instants = result.tables["replay"], result.tables["instants"]["ms"].tolist()
    times = [*zip(instants, np.sort(table["instant"].unique()), strict=True)]  # ms, frames
    if np.isfinite(latest_ms):
        soon = [time for time in times if time[0] <= latest_ms * (1 + TOLERANCE)]
        times = soon[-1:] or times[:1]
    hop = result["stream.hop_ms"]
    apart = () if hop in (None, "None") else (f"every {hop} ms",)
    for ms, frames in times:
        decisions = react_to_decisions(standing_decisions(table, frames), reactions)
        stored, costs = {"predict": "replay_ms_p50"}, {"decision": ms}
        scores = reactions.score_by_subject(decisions)
        yield Candidate(f"first {ms:.0f} ms", scores, stored, costs, apart, mark=EARLY)


def fault_levels(faults: Sequence[str], severity: int) -> list[tuple[str, int]]:
    """Each fault at each severity up to this one."""
    return [(name, level) for name in faults for level in range(1, severity + 1)]


def points_lost(
    results: Sequence[Result],
    faults: Sequence[str],
    severity: int,
    reactions: Reactions,
    key: str,
) -> pd.DataFrame | None:
    """Points lost [fault_levels, subjects] in some runs of one system; None if they lack a fault.

    These runs store labels, so the reaction is that to the most probable gesture, also of clean
    captures. ``key`` is that of the circumstance of faults.
    """
    tested = {r: {*str(r.get("faults", "")).split(", ")} & {*faults} for r in results}
    if {*faults} != {name for names in tested.values() for name in names}:
        return None  # without reading any table
    cases = fault_levels(faults, severity)
    lost: dict[tuple[str, int], pd.Series] = {}
    for result in sorted((r for r in results if tested[r]), key=lambda r: r["started"]):
        table = result.tables["labels"]
        faulty = table[(table["circumstance"] == key) & table["case"].isin(faults)]
        faulty = faulty[faulty["level"] <= severity]
        rows = pd.concat([clean_labels(table), faulty], ignore_index=True)
        keys = [rows["case"], rows["level"], rows["subject"].astype(str)]
        mean = 100 * pd.Series(reactions.mistake_costs(rows)).groupby(keys).mean().unstack()
        for case in {*mean.index} & {*cases}:
            lost[case] = mean.loc[case] - mean.loc[(NO_FAULT, 0)]
    if not {*cases} <= {*lost}:
        return None
    return pd.DataFrame({case: lost[case] for case in cases}).T
