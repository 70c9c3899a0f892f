"""Reactions of a robot to gestures, costs of mistakes, and the scores that a choice takes from them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bench.errors import InputError, nearest
from bench.ground.words import CLEAN
from bench.values.candidate import EARLY, Candidate, Losses, Wish
from bench.values.intervals import TOLERANCE
from bench.values.result import Result
from bench.values.scores import PREFIX, classes_of
from bench.values.stability import unharmed
from bench.values.stopping import standing

WINDOW = {
    "predict": "decide_ms_p50",
    "decision": "observed_ms",
}  # what the costs of single windows read
NOTHING = "nothing"  # the reaction of a robot that does nothing


@dataclass(frozen=True)
class Reactions:
    """Groups of gestures to which a robot reacts alike; by default every gesture is a reaction of its own.

    The robot takes the reaction with the lowest expected cost. The probability of a reaction is the sum over its
    gestures. With the default costs, it therefore takes the most probable reaction. Where a system abstains, it does
    nothing.
    """

    groups: Mapping[str, Sequence[str]] = field(
        default_factory=dict
    )  # of gestures; to ``nothing`` it does not react
    ignored: bool = False  # whether gestures of no group belong to ``nothing``, and not each to a reaction of its own
    costs: Mapping[str, Mapping[str, float]] = field(
        default_factory=dict
    )  # of the first for the second, if not 1
    silence: float = 1.0  # cost of doing nothing where a reaction was meant

    @property
    def plain(self) -> bool:
        """True if the score is the accuracy of gestures."""
        return not (self.groups or self.ignored or self.costs) and self.silence == 1

    @property
    def weighted(self) -> bool:
        """True if some mistakes cost more or less than others."""
        return bool(self.costs) or self.silence != 1

    def of(self, gestures: Collection[str]) -> dict[str, str]:
        """The reaction to each gesture."""
        gestures = {*gestures}
        meant = {gesture: name for name, members in self.groups.items() for gesture in members}
        for gesture, name in meant.items():
            if gesture not in gestures:
                raise InputError(
                    f"[reactions] {name}: there is no gesture {gesture}; {nearest(gesture, gestures)}"
                )
        for name in () if self.plain else (*self.groups, NOTHING):
            if name in gestures and name not in meant and not self.ignored:
                raise InputError(
                    f"[reactions] {name}: this is also a gesture that is not listed; list it or rename {name}"
                )
        reactions = {g: meant.get(g, NOTHING if self.ignored else g) for g in sorted(gestures)}
        known = {*reactions.values(), NOTHING}
        for true, row in self.costs.items():
            for name in (true, *row):
                if name not in known:
                    raise InputError(
                        f"[costs] {true}: there is no reaction {name}; {nearest(name, known)}"
                    )
        return reactions

    def cost_table(self, gestures: Collection[str]) -> pd.DataFrame:
        """Cost of each reaction that is taken (column) for each that was meant (row); ``nothing`` is the last."""
        names = [*dict.fromkeys(r for r in self.of(gestures).values() if r != NOTHING), NOTHING]
        table = pd.DataFrame(1.0, index=names, columns=names)
        table[NOTHING] = self.silence
        for true, row in self.costs.items():
            for taken, cost in row.items():
                table.loc[true, taken] = cost
        return table.mask(np.eye(len(names), dtype=bool), 0.0)

    def decided(self, probabilities: pd.DataFrame) -> np.ndarray:
        """The reactions with the lowest expected cost [decisions]; equal ones go to the first."""
        table, reactions = self.cost_table(probabilities.columns), self.of(probabilities.columns)
        member = np.array(
            [[reactions[str(g)] == name for name in table.index] for g in probabilities],
            dtype=float,
        )
        expected = (probabilities.to_numpy(dtype=float) @ member) @ table.to_numpy()
        taken = table.columns.to_numpy(object)[
            expected.round(12).argmin(axis=1)
        ]  # equal sums differ by rounding
        return np.where(probabilities.to_numpy().any(axis=1), taken, NOTHING)

    def mistakes(self, labelled: pd.DataFrame) -> np.ndarray:
        """The cost of each label, 0 for the right reaction, float [rows]."""
        every = {*labelled["true"], *(g for members in self.groups.values() for g in members)}
        table, reactions = self.cost_table(every), self.of(every)
        true = labelled["true"].astype(object).map(reactions)
        taken = (
            labelled["taken"]
            if "taken" in labelled
            else labelled["predicted"].astype(object).map(reactions)
        )
        row, column = (
            table.index.get_indexer(pd.Index(each.fillna(NOTHING))) for each in (true, taken)
        )
        return table.to_numpy()[row, column]

    def scores(self, labelled: pd.DataFrame) -> pd.Series:
        """The score of each subject: 100 less 100 times the mean cost of a label; with default costs its accuracy."""
        costs = pd.Series(self.mistakes(labelled), labelled.index)
        return (100 * (1 - costs.groupby(labelled["subject"].astype(str)).mean())).rename_axis(
            "subject"
        )


def by_capture(predictions: pd.DataFrame, reactions: Reactions) -> pd.DataFrame:
    """``subject``, ``true`` and the reaction ``taken`` for each tested capture, by mean probability."""
    captures = predictions.groupby(["fold", "capture"], sort=False)
    mean = captures[[PREFIX + c for c in classes_of(predictions)]].mean()
    return by_decision(captures[["subject", "true"]].first().join(mean), reactions).reset_index()


def by_decision(predictions: pd.DataFrame, reactions: Reactions) -> pd.DataFrame:
    """The same for each row of the table: each window, or each capture at an instant."""
    classes = classes_of(predictions)
    proba = predictions[[PREFIX + c for c in classes]].set_axis(classes, axis=1)
    return predictions[["subject", "true"]].assign(taken=reactions.decided(proba))


def plain_candidates(result: Result, wish: Wish) -> Candidate:
    """The system in Python on whole captures, or on windows if these are wished."""
    reactions = wish.reactions
    if wish.windows:
        return Candidate(
            "window", reactions.scores(by_decision(result.tables["predictions"], reactions)), WINDOW
        )
    # What the run stored is the same and quick: reading the predictions of 1000 runs takes a minute.
    stored = result.people if reactions.plain else {}
    scores = stored or reactions.scores(by_capture(result.tables["predictions"], reactions))
    return Candidate("capture", scores, whole=True)


def early_candidates(result: Result, wish: Wish) -> Iterator[Candidate]:
    """A replayed system after the last time that is soon enough, or after each; none where no time was asked for."""
    if wish.most is None:
        return
    table, instants = result.tables["replay"], result.tables["instants"]["ms"].tolist()
    decided = [*zip(instants, np.sort(table["instant"].unique()), strict=True)]  # ms, frames
    if np.isfinite(wish.most):  # the last that is soon enough, else the first
        decided = [one for one in decided if one[0] <= wish.most * (1 + TOLERANCE)][-1:] or decided[
            :1
        ]
    apart = (
        ()
        if result["stream.hop_ms"] in (None, "None")
        else (f"every {result['stream.hop_ms']} ms",)
    )
    for ms, frames in decided:
        scores = wish.reactions.scores(by_decision(standing(table, frames), wish.reactions))
        yield Candidate(
            f"first {ms:.0f} ms",
            scores,
            {"predict": "replay_ms_p50"},
            {"decision": ms},
            apart,
            mark=EARLY,
        )


def points_lost(
    results: Sequence[Result], asked: Losses, reactions: Reactions, key: str
) -> pd.DataFrame | None:
    """Points lost [circumstances, subjects] in some runs of one system; None if a fault is not in any of them.

    These runs store labels, so the reaction is that to the most probable gesture, also of clean captures.
    """
    tested = [(r, {*str(r.get("faults", "")).split(", ")} & {*asked.names}) for r in results]
    if {*asked.names} != {name for _, names in tested for name in names}:
        return None  # without reading any table
    lost: dict[tuple[str, int], pd.Series] = {}
    for result in sorted((r for r, names in tested if names), key=lambda r: r["started"]):
        table = result.tables["labels"]
        under = (
            (table["circumstance"] == key)
            & table["case"].isin(asked.names)
            & (table["level"] <= asked.severity)
        )
        rows = pd.concat([unharmed(table), table[under]], ignore_index=True)
        keys = [rows["case"], rows["level"], rows["subject"].astype(str)]
        mean = 100 * pd.Series(reactions.mistakes(rows)).groupby(keys).mean().unstack()
        lost |= {
            case: mean.loc[case] - mean.loc[(CLEAN, 0)]
            for case in {*mean.index} & {*asked.circumstances}
        }
    known = {*asked.circumstances} <= {*lost}
    return pd.DataFrame({case: lost[case] for case in asked.circumstances}).T if known else None
