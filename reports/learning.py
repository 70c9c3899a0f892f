"""Learning curves: accuracy on new people against the people and captures that a system learns from.

``python -m reports.learning model=lda features=touch model.window=1.0 people=2,4,8`` refits a system in every fold to
so many training people (nested, the same ones for every system) and to shares of their captures (``share=0.25,0.5``,
evenly of people and gestures), and writes a table and a figure with the law err(n) = a + b n^-c fitted to the curve and
carried on to ``until=`` people. Other keys are those of ``bench run``, and a plus begins another system with ``model``
and ``features`` of its own: ``model=lda features=touch + model=zhou2016_3dcnn model.epochs=15``. Of several systems it
says from how many people on one would be better than the best one now.

The law is fitted by least squares with a and b from 0 to 1 and c from 0 to 2; its interval is that of curves through
people drawn with replacement. Three or four points do not tell a law from its neighbours: what is carried on is a
guess with a wide interval, which is what it is drawn for.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

from bench.commands.printing import console, writable
from bench.commands.run import KEYS
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.outcomes.comparable import context_of
from bench.outcomes.results import Findings, FoldResult, table_of
from bench.outcomes.scores import subject_interval
from bench.plan.arguments import backend_of, convert, items, parse
from bench.plan.cells import Cell, cells
from bench.plan.plan import Fold, Plan
from bench.work.experiment import Experiment
from bench.work.fold import computing
from bench.work.loop import Outcome, execute, prepared
from bench.work.stress import labelled, subset
from models import contract
from reports.figures import MARKERS, Picture, new_figure, save

DRAWS = 500  # of people, for the interval of a law
COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown", "tab:pink", "tab:olive")


@dataclass(frozen=True)
class Learning(Experiment):
    """Accuracy when a system learns from fewer people, or from a share of their captures.

    Attributes:
        people: numbers of training people, besides all of them.
        shares: of the captures of each training person and gesture, besides all of them.
    """

    kind: ClassVar[str] = "learning"
    fold_kind: ClassVar[str] = "learning_fold"
    heading: ClassVar[str] = "Accuracy in percent by training people and share of their captures"
    columns: ClassVar[frozenset[str]] = frozenset({"people", "share", "trained"})

    people: tuple[int, ...] = ()
    shares: tuple[float, ...] = ()

    def refuse(self, plan: Plan) -> None:
        """Refuse more people than a fold has, and what the system cannot learn from.

        Raises:
            InputError: one of them.
        """
        for fold in plan.folds:
            there = len(set(plan.corpus.subjects[fold.train]))
            for count in self.people:
                if count >= there:
                    raise InputError(f"people={count}: fold {fold.name} has {there} for training; give fewer than that")
            for part, *_ in self.parts(plan.cell, plan.corpus, fold):
                contract.check_training(plan.cell.estimator(), plan.corpus[part], plan.corpus.gestures[part])

    def parts(self, cell: Cell, corpus: Corpus, fold: Fold) -> list[tuple[np.ndarray, int, float]]:
        """Positions of the captures that are learnt from, number of people, share of their captures."""
        whole = len(set(corpus.subjects[fold.train]))
        few = [(subset(corpus, fold.train, fold.test, n, cell.seed or 0), n, 1.0) for n in self.people]
        return [
            *few,
            *((some(corpus, fold.train, share), whole, share) for share in self.shares),
            (fold.train, whole, 1.0),
        ]

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Fit to each part of the training captures and label the test captures."""
        tables = []
        with computing(threads):
            for part, people, share in self.parts(cell, corpus, fold):
                estimator = cell.estimator().fit(corpus[part], corpus.gestures[part])
                about = {"people": people, "share": share, "trained": len(part)}
                tables.append(labelled(estimator, corpus, fold.name, fold.test, about))
        return FoldResult(fold.name, pd.concat(tables, ignore_index=True), {})

    def findings(self, plan: Plan, tags: dict[str, str], results: list[FoldResult]) -> Findings:
        """The points of the curve, and accuracy with all that there is."""
        table = table_of(results)
        points = curve(table)
        last = points.iloc[-1]
        return Findings(
            {"accuracy": last["accuracy"]}, {"predictions.parquet": table, "curve.csv": points}, analysis=table
        )

    def row(self, metrics: dict[str, float]) -> dict[str, str]:
        """Accuracy with all that there is."""
        return {"all": f"{100 * metrics['accuracy']:.1f}" if metrics else "-"}


def some(corpus: Corpus, train: np.ndarray, share: float) -> np.ndarray:
    """The first captures of each training person and gesture in an order that is drawn once, at least one of each."""
    order = np.random.default_rng(0).permutation(len(corpus))[train]
    about = pd.DataFrame({"subject": corpus.subjects[train], "gesture": corpus.gestures[train], "order": order})
    each = about.groupby(["subject", "gesture"])["order"]
    kept = each.rank(method="first") <= np.maximum(np.ceil(share * each.transform("size")), 1)
    return train[kept.to_numpy()]


def curve(table: pd.DataFrame) -> pd.DataFrame:
    """Accuracy by training people and share of captures, with its interval over the tested people; all is the last."""
    rows = []
    most = table.groupby("fold")["people"].transform("max")
    people = table["people"].where(table["people"] < most, np.round(most.mean(), 1))
    for (share, number), part in table.groupby([table["share"], people]):
        low, high = subject_interval(part)
        hit = float((part["true"] == part["predicted"]).mean())
        rows.append([number, share, part["trained"].mean(), hit, low, high])
    return pd.DataFrame(rows, columns=["people", "share", "captures", "accuracy", "low", "high"])


def law(counts: np.ndarray, errors: np.ndarray) -> tuple[float, float, float]:
    """a, b and c of a + b n^-c, all from 0, a and b at most 1, c at most 2, by least squares.

    Args:
        counts: of people, at least three different ones.
        errors: shares of wrong labels.
    """
    best = (np.inf, 0.0, 0.0, 0.0)
    for c in np.linspace(0.02, 2, 100):  # for each exponent the rest is linear, with two bounds
        falls = counts**-c
        for columns in ((0, 1), (0,), (1,)):
            given = np.column_stack([np.ones_like(falls), falls])[:, columns]
            found, *_ = np.linalg.lstsq(given, errors, rcond=None)
            found = found.clip(0, 1)
            missed = float(((given @ found - errors) ** 2).sum())
            if missed < best[0] - 1e-15:
                a, b = (float(found[columns.index(i)]) if i in columns else 0.0 for i in (0, 1))
                best = missed, a, b, float(c)
    return best[1:]


def carried_on(table: pd.DataFrame, counts: np.ndarray, draws: int = DRAWS) -> np.ndarray:
    """Accuracy that the law expects with so many people: of the curve, and of curves through drawn people.

    Args:
        table: rows of `Learning` with all captures.
        counts: of people [counts].
        draws: of tested people, with replacement.

    Returns:
        float64 [1 + draws, counts].
    """
    hits = (table["true"] == table["predicted"]).groupby([table["subject"], table["people"]]).agg(["sum", "size"])
    right, size = (hits[name].unstack("people").fillna(0).to_numpy(float) for name in ("sum", "size"))
    numbers = np.sort(table["people"].unique()).astype(float)
    rng = np.random.default_rng(0)
    drawn = np.vstack([np.arange(len(right)), rng.integers(0, len(right), (draws, len(right)))])
    found = []
    for rows in drawn:
        there = size[rows].sum(axis=0) > 0
        a, b, c = law(numbers[there], 1 - right[rows][:, there].sum(axis=0) / size[rows][:, there].sum(axis=0))
        found.append(1 - a - b * counts**-c)
    return np.array(found)


def overtaken(deep: np.ndarray, other: np.ndarray, counts: np.ndarray) -> tuple[float, float]:
    """From how many people on one curve is above another: of the curves, and the share of the drawn ones that ever are.

    Args:
        deep: `carried_on` of one system [1 + draws, counts].
        other: of another, the same draws.
        counts: of people, rising.
    """
    above = deep > other
    below = np.flatnonzero(~above[0])
    first = counts[below[-1] + 1 if len(below) else 0] if above[0, -1] else np.inf  # from there on to the end
    return float(first), float(above[1:, -1].mean())


def main(arguments: list[str]) -> int:
    """Run the curves, print their table and write it and the figure."""
    first, *others = split_at(arguments, "+")
    values = parse(first, KEYS | {"people", "share", "until", "out"})
    more = [parse(words, {"model", "features"}) for words in others]
    if more and not all("model" in words for words in (values, *more)):
        raise InputError("+ stands between systems: give model= before and behind it")
    own = {"people", "share", "until", "out"}
    people = tuple(sorted({convert("people", text, 4) for text in items("people", values.get("people", "2,4,8"))}))
    shares = (
        tuple(sorted({convert("share", text, 0.5) for text in items("share", values["share"])}))
        if ("share" in values)
        else ()
    )
    if min(people) < 1 or not all(0 < share < 1 for share in shares):
        raise InputError("people= needs whole numbers from 1 on, share= numbers above 0 and below 1")
    until = convert("until", values.get("until", "300"), 300)
    out = writable(Path(values.get("out", "learning")))
    shared = {k: v for k, v in values.items() if k.split(".")[0] not in {"model", "features"}}
    asked = [
        cell
        for words in (values, *(shared | other for other in more))
        for cell in cells({k: v for k, v in words.items() if k not in own})
    ]
    refuse_alike(asked)
    backend = backend_of(values)
    outcomes = [o for o in execute(prepared(asked, [Learning(people, shares)], backend.jobs), backend) if o.findings]
    if not outcomes:
        return 1
    table, picture = told(outcomes, until, out)
    table.to_csv(out / "learning.csv", index=False)
    console.print(f"{picture.group}; accuracy of captures", markup=False, soft_wrap=True)
    console.print(table.to_string(index=False), markup=False, soft_wrap=True)
    console.print(str(picture.paths[0]), markup=False, soft_wrap=True)
    return 0


def split_at(words: list[str], mark: str) -> list[list[str]]:
    """The words between marks, parts without any included."""
    ends = [i for i, word in enumerate(words) if word == mark]
    return [words[i + 1 : j] for i, j in zip([-1, *ends], [*ends, len(words)], strict=True)]


def refuse_alike(asked: list[Cell]) -> None:
    """Refuse systems that a figure could not tell apart, or not compare.

    Raises:
        InputError: two have the same name, such as those of several seeds, or not all have the same captures.
    """
    names = [cell.system() for cell in asked]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice:
        raise InputError(f"two curves would be called {twice}; give each system once, and one seed")
    captures = {f"data={cell.data} protocol={cell.protocol}" for cell in asked}
    if len(captures) > 1:
        raise InputError(f"give one corpus and one protocol, not {' and '.join(sorted(captures))}")


def told(outcomes: list[Outcome], until: int, out: Path) -> tuple[pd.DataFrame, Picture]:
    """The points and what the laws expect, as a table and a figure.

    In a row ``above``, ``people`` is from how many on the law puts a system above the best one, and ``share`` in what
    share of the drawn people it does so with ``until`` people.

    Raises:
        InputError: runs that cannot be compared are among them.
    """
    contexts = {", ".join(context_of(outcome.tags)) for outcome in outcomes}
    if len(contexts) > 1:
        raise InputError(f"give one corpus and one protocol, not {'; '.join(sorted(contexts))}")
    (context,) = contexts
    most = max(int(outcome.findings.analysis["people"].max()) for outcome in outcomes)
    best = max(outcomes, key=lambda outcome: outcome.metrics["accuracy"])
    ahead = np.unique(np.geomspace(2, max(until, most), 60).round(1))
    against = carried_on(_whole(best), ahead)
    figure, axes = new_figure((10.0, 4.6), margins=(0.7, 4.2, 0.6, 0.3))
    axis, rows = axes[0][0], []
    for place, outcome in enumerate(outcomes):
        name, points = outcome.plan.cell.system(), curve(outcome.findings.analysis)
        expected = carried_on(_whole(outcome), ahead)
        low, high = np.quantile(expected[1:], [0.025, 0.975], axis=0)
        colour = COLOURS[place % len(COLOURS)]
        full = points[points["share"] == 1.0]
        axis.plot(full["people"], 100 * full["accuracy"], MARKERS[place % len(MARKERS)], color=colour, label=name)
        axis.plot(ahead, 100 * expected[0], color=colour, linewidth=1)
        axis.fill_between(ahead, 100 * low, 100 * high, color=colour, alpha=0.12, linewidth=0)
        for row in points.to_dict("records"):
            rows.append({"system": name, "kind": "measured"} | row)
        for number in (n for n in (20, 50, 100, 300, 1000) if most < n <= until):
            at = int(np.argmin(np.abs(ahead - number)))
            rows.append(
                {"system": name, "kind": "expected", "people": number, "share": 1.0}
                | {"accuracy": expected[0, at], "low": low[at], "high": high[at]}
            )
        if outcome is not best:
            number, share = overtaken(expected, against, ahead)
            rows.append({"system": name, "kind": f"above {best.plan.cell.system()}", "people": number, "share": share})
    axis.set_xscale("log")
    axis.axvline(most, color="0.6", linewidth=0.8, linestyle=":")
    axis.set_xlabel("people that it learns from; dotted: as many as there are, beyond it a guess")
    axis.set_ylabel("accuracy on new people, %")
    axis.legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    caption = f"{context}: accuracy against training people, with the law a + b n^-c and its 95 % interval over people."
    return pd.DataFrame(rows), save(figure, out, "learning", "learning", context, caption)


def _whole(outcome: Outcome) -> pd.DataFrame:
    """Rows of a curve over people, with all their captures."""
    table = outcome.findings.analysis
    return table[table["share"] == 1.0]


if __name__ == "__main__":
    from reports.learning import main  # so that workers know its classes by the name of the module

    try:
        raise SystemExit(main(sys.argv[1:]))
    except InputError as error:
        console.print(str(error), style="red", markup=False)
        raise SystemExit(2) from error
