"""What more seconds of search buy, and the fronts of one search: `auto`, stopped at every moment.

``python -m reports.anytime budget=60`` searches in each outer training part, then fits what the search would have ended
with after 1, 2, 5, ... seconds, and asks the people who were left out. It writes a table and a figure, and the trials
of all folds with their fronts of accuracy (of left-out training subjects) against each cost. ``data=``, ``protocol=``,
``model.*`` (of `auto`), ``jobs=`` and ``out=`` change what is run, and where it goes.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from bench.commands.printing import console, writable
from bench.errors import InputError
from bench.plan.arguments import KEYS, jobs_of, parse
from bench.plan.cells import cells
from bench.plan.plan import Plan, planned
from bench.work.fold import computing
from models.auto import Auto
from models.trials import COSTS, named
from reports.figures import Picture, new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from bench.corpora.corpus import Corpus

MOMENTS = np.outer(10.0 ** np.arange(-1, 5), [1, 2, 5]).ravel()  # seconds
SHOWN = {"flash_bytes": "flash, kB, 32 bits", "ram_bytes": "memory of a decision, kB", "predict_ms": "ms of a decision"}
SCALE = {"flash_bytes": 1e-3, "ram_bytes": 1e-3, "predict_ms": 1.0}


def main(arguments: list[str]) -> int:
    """Search, stop at every moment, write tables and figure."""
    values = parse(arguments, KEYS - {"cluster"} | {"budget", "out"})
    out = writable(Path(values.pop("out", "anytime")))
    if values.get("model", "auto") != "auto":
        raise InputError(f"model={values['model']}: only auto can be stopped at any time; leave it out")
    values |= {"model": "auto", "model.budget": values.pop("budget", values.get("model.budget", "60"))}
    (plan, *more) = planned(cells({"data": "haart", "protocol": "loso"} | values), jobs_of(values))
    if more:
        raise InputError("give one of each, no lists")
    parts = Parallel(plan.workers)(delayed(stopped)(plan, number) for number in range(len(plan.folds)))
    scores = pd.concat([score for score, _ in parts], ignore_index=True)
    trials = pd.concat([table for _, table in parts], ignore_index=True)
    scores.to_csv(out / "anytime.csv", index=False)
    trials.to_csv(out / "trials.csv", index=False)
    curve = curve_of(scores)
    corpus = plan.corpus
    kind = " (synthetic)" if corpus.synthetic else ""
    context = f"{corpus.name}{kind}, {len(corpus)} captures, {plan.label}, mean over people"
    words = f"{context}\n\n{markdown(curve)}\n\nfronts of the first fold, judged by training subjects\n\n"
    words += fronts(parts[0][1])
    (out / "anytime.md").write_text(words + "\n", encoding="utf-8")
    drawn(curve, trials, context, out)
    console.print(words, markup=False, soft_wrap=True)
    return 0


def stopped(plan: Plan, number: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Accuracy of each test subject by seconds of search in one outer fold; and the trials."""
    fold, corpus = plan.folds[number], plan.corpus
    train, test = corpus[fold.train], corpus[fold.test]
    with computing(plan.threads):
        auto = plan.cell.estimator()
        assert isinstance(auto, Auto)
        auto.fit(train, train.gestures)
        ends = np.cumsum([tried.seconds for tried in auto.tried_])
        rows, known = [], {}
        for seconds in [*MOMENTS[MOMENTS < ends[-1]], float(ends[-1])]:
            done = int((ends <= seconds).sum())
            if done not in known:
                known[done] = right(auto, float(seconds), train, test)
            hit = known[done]
            who = test.subjects.astype(str)
            rows += [(fold.name, s, seconds, hit[who == s].mean()) for s in np.unique(who)]
    table = auto.trials_.assign(trial=[named(t.trial) for t in auto.tried_], fold=fold.name)
    return pd.DataFrame(rows, columns=["fold", "subject", "seconds", "accuracy"]), table


def right(auto: Auto, seconds: float, train: Corpus, test: Corpus) -> np.ndarray:
    """Which test captures are right after some seconds [captures]; not a number where nothing is in the limits yet."""
    try:
        return (auto.after(seconds, train, train.gestures).predict(test) == test.gestures).astype(float)
    except InputError:
        return np.full(len(test), np.nan)


def curve_of(scores: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard error over people, and mean of what is lost to the end, by seconds.

    A fold that had ended before stays where it was; moments at which one has nothing yet are left out.
    """
    wide = scores.pivot_table(index="seconds", columns=["fold", "subject"], values="accuracy").ffill()
    wide = wide[wide.notna().all(axis=1)]
    lost = wide.iloc[-1] - wide
    error = wide.std(axis=1, ddof=1).fillna(0) / np.sqrt(wide.shape[1])
    return pd.DataFrame({"accuracy": wide.mean(axis=1), "error": error, "lost": lost.mean(axis=1)}).reset_index()


def near(curve: pd.DataFrame) -> float:
    """Seconds from which on no more is lost than a standard error of the accuracy at the end."""
    far = curve["lost"] > curve["error"].iloc[-1]
    return float(curve["seconds"][~far[::-1].cummax()[::-1]].iloc[0])


def markdown(curve: pd.DataFrame) -> str:
    """The curve as a table, in percent."""
    rounds = curve[curve["seconds"].isin(MOMENTS) | (curve.index == len(curve) - 1)]
    lines = ["| seconds of search | accuracy of new people | standard error |", "|---|---|---|"]
    lines += [f"| {s:.3g} | {100 * a:.1f} | {100 * e:.1f} |" for s, a, e, _ in rounds.itertuples(index=False)]
    return "\n".join(lines) + f"\n\nwithin one standard error of the end from {near(curve):.3g} s on"


def fronts(trials: pd.DataFrame) -> str:
    """What no other trial beats in accuracy and a cost, one table per cost."""
    lines = []
    for cost, name in COSTS.items():
        best = trials[trials[f"front_{cost}"]].sort_values(name).drop_duplicates(["accuracy", name])
        lines += [f"| {SHOWN[name]} | accuracy | |", "|---|---|---|"]
        told = zip(best[name] * SCALE[name], best["accuracy"], best["trial"], strict=True)
        lines += [f"| {value:.3g} | {100 * accuracy:.1f} | {trial} |" for value, accuracy, trial in told]
        lines += [""]
    return "\n".join(lines)


def drawn(curve: pd.DataFrame, trials: pd.DataFrame, context: str, out: Path) -> Picture:
    """Accuracy of new people against seconds; and trials of all folds with the front against each cost."""
    figure, axes = new_figure((13, 3.6), (1, 4), (0.7, 0.2, 0.6, 0.35), (0.5, 0.9))
    first = axes[0][0]
    low, high = (100 * (curve["accuracy"] + side * curve["error"]) for side in (-1, 1))
    first.fill_between(curve["seconds"], low, high, color="tab:red", alpha=0.2, lw=0)
    first.plot(curve["seconds"], 100 * curve["accuracy"], color="tab:red")
    first.axvline(near(curve), color="0.6", lw=1, ls=":")
    first.set_xscale("log")
    first.set_xlabel("seconds of search")
    first.set_ylabel("accuracy, %")
    first.set_title("new people", fontsize=9)
    for axis, name in zip(axes[0][1:], SHOWN, strict=True):
        scattered(axis, trials, name)
    caption = f"{context}; band: a standard error over people; dotted: from here on within one of the end"
    return save(figure, out, "anytime", "anytime", context, caption)


def scattered(axis: Axes, trials: pd.DataFrame, name: str) -> None:
    """Trials that were judged to the end, by model; those on the front of their fold are filled."""
    from matplotlib.ticker import NullFormatter

    complete = trials[trials["state"] == "complete"]
    cost = {column: cost for cost, column in COSTS.items()}[name]
    for number, (model, rows) in enumerate(complete.groupby("model")):
        colour = f"C{number}"
        best = rows[f"front_{cost}"].astype(bool)
        for part, face in ((rows[~best], "none"), (rows[best], colour)):
            axis.scatter(SCALE[name] * part[name], 100 * part["accuracy"], s=14, ec=colour, fc=face, lw=0.8)
        axis.scatter([], [], s=14, c=colour, label=model)
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel(SHOWN[name])
    axis.set_title("left-out training people; filled: on a front", fontsize=9)
    axis.legend(fontsize=7, frameon=False)


if __name__ == "__main__":
    try:
        raise SystemExit(main(sys.argv[1:]))
    except InputError as error:
        console.print(str(error), style="red", markup=False)
        raise SystemExit(2) from error
