"""Draws the pictures of the documentation from data, into ``docs/pictures`` and ``docs/speed.png``.

    python docs/tools/pictures.py concepts    # generated captures and five quick systems, in a store of its own
    python docs/tools/pictures.py speed       # the README's chart, from the HAART runs of the store in use

The results are committed; draw them again after a change of what they show, and look at them.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np

DOCS = Path(__file__).parent.parent
sys.path.insert(0, str(DOCS.parent))

import bench  # noqa: E402
from bench.measures import costs  # noqa: E402
from bench.outcomes import statistics  # noqa: E402
from bench.outcomes.runs import by_subject, every_result, grouped, stored  # noqa: E402
from bench.outcomes.store import connect  # noqa: E402
from bench.registry import load  # noqa: E402
from bench.reports import candidates, figures, speed  # noqa: E402
from bench.reports.comparison import published  # noqa: E402
from bench.result import Result  # noqa: E402

SMALL = {"data__subjects": 6, "data__variants": ("normal",), "data__repetitions": 2}
BLUE, RED, GREY = "#1f77b4", "#c23b22", "0.75"


def capture(folder: Path) -> None:
    """One capture as frames: a film strip above the summed pressure."""
    corpus = bench.corpus("synth", subjects=1, variants=("normal",), repetitions=1)
    place = int(np.flatnonzero(corpus.gestures == "rub")[0])
    frames, rate = corpus[place].astype(float), corpus.rate_hz
    figure, axes = figures.new_figure((8, 3.7), (1, 1), (0.8, 0.15, 0.6, 1.75))
    axis = axes[0, 0]
    seconds = np.arange(len(frames)) / rate
    axis.plot(seconds, frames.sum(axis=(1, 2)), color=BLUE)
    axis.set(xlabel="seconds since the touch began", ylabel="sum of all taxels", xlim=(0, seconds[-1]))
    shown = np.linspace(0, len(frames) - 1, 8).round().astype(int)
    for i, at in enumerate(shown):
        small = figure.add_axes(((0.8 + i * 0.89) / 8, 2.1 / 3.7, 0.81 / 8, 0.81 / 3.7))
        small.imshow(frames[at], cmap="viridis", vmin=0, vmax=frames.max())
        small.set(xticks=[], yticks=[])
        small.set_title(f"frame {at}", fontsize=8)
        axis.axvline(seconds[at], color=GREY, linewidth=0.8, zorder=0)
    grid = " x ".join(map(str, frames.shape[1:]))
    figure.text(0.1, 0.93, f"A capture: rub, {len(frames)} frames of {grid} taxels at {rate:g} Hz", fontsize=10)
    done(figure, folder / "capture.png", synthetic=True)


def protocol(folder: Path) -> None:
    """Which captures each fold trains on and tests: nobody on both sides with LOSO, everybody with k-fold."""
    corpus = bench.corpus("synth", subjects=6, variants=("normal",), repetitions=2)
    corpus = corpus[np.argsort(corpus.subjects.astype(int), kind="stable")]
    figure, axes = figures.new_figure((8, 3.4), (1, 2), (0.65, 0.15, 0.65, 0.75), (0.45, 0))
    said = {"loso": "loso: each fold tests one subject", "kfold": "kfold: every subject is on both sides"}
    for axis, (name, words) in zip(axes.flat, said.items(), strict=True):
        splitter = load("protocols", name)(**({} if name == "loso" else {"folds": 6}))
        folds = list(splitter.split(corpus, corpus.gestures, corpus.subjects))
        tested = np.zeros((len(folds), len(corpus)))
        for row, (_, test) in zip(tested, folds, strict=True):
            row[test] = 1
        both = [len(set(corpus.subjects[a]) & set(corpus.subjects[b])) for a, b in folds]
        axis.imshow(tested, aspect="auto", cmap=colours(), interpolation="nearest")
        ends = np.flatnonzero(corpus.subjects[1:] != corpus.subjects[:-1]) + 0.5
        axis.vlines(ends, -0.5, len(folds) - 0.5, color="white", linewidth=1)
        middles = (np.r_[-0.5, ends] + np.r_[ends, len(corpus) - 0.5]) / 2
        axis.set_xticks(middles, [f"s{i + 1}" for i in range(len(middles))])
        axis.set_yticks(range(len(folds)), range(1, len(folds) + 1))
        axis.set_title(f"{words}\nsubjects on both sides of a fold: {max(both)}", fontsize=9)
        axis.set(xlabel="captures, by subject", ylabel="fold")
    figure.text(0.08, 0.955, "red: tested in this fold, grey: trained on", fontsize=9)
    done(figure, folder / "protocol.png", synthetic=True)


def colours() -> object:
    """Grey for training, red for test."""
    from matplotlib.colors import ListedColormap

    return ListedColormap(["0.88", RED])


def unit(folder: Path) -> None:
    """The decisions of a system on windows along one capture, and the label of the whole."""
    table = next(r for r in stored(connect()) if "window" in r["system"]).tables["predictions"]
    classes = [c for c in table if c.startswith("p_")]
    table = table.assign(predicted=table[classes].idxmax(axis=1).str.removeprefix("p_"))
    counts = table.groupby("capture").size()
    share = table.assign(right=table["predicted"] == table["true"]).groupby("capture")["right"].mean()
    place = share[counts.between(6, 15) & share.between(0.6, 0.99)].idxmin()  # some windows wrong, the whole right
    rows = table[table["capture"] == place].sort_values("start")
    shown = rows[classes].mean().sort_values(ascending=False).index[:4]
    figure, axes = figures.new_figure((8, 3.2), (1, 1), (0.65, 1.3, 0.6, 0.65))
    axis = axes[0, 0]
    steps = np.arange(1, len(rows) + 1)
    for name, colour in zip(shown, (BLUE, RED, "tab:green", "tab:purple"), strict=True):
        axis.plot(steps, 100 * rows[name], marker="o", markersize=4, color=colour, label=name[2:])
        axis.axhline(100 * rows[name].mean(), color=colour, linewidth=0.8, linestyle=":")
    axis.set(xlabel="window", ylabel="probability, %", ylim=(0, 100), xticks=steps)
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=9)
    truth, right = rows["true"].iloc[0], int((rows["predicted"] == rows["true"]).sum())
    figure.text(
        0.08,
        0.87,
        f"One capture of {truth}, {len(rows)} windows: {right} of {len(rows)} windows are right.\n"
        f"Dotted: the means; the largest, {shown[0][2:]}, is the label of the capture, 1 of 1 right.",
        fontsize=9,
    )
    done(figure, folder / "unit.png", synthetic=True)


def interval(folder: Path) -> None:
    """Accuracy of each person of each system, the mean, and its interval over people."""
    _, results = loso(stored(connect()), "synth")
    table, _ = by_subject(results)
    figure, axes = figures.new_figure((8, 0.42 * len(table) + 1.2), (1, 1), (2.6, 0.2, 0.6, 0.4))
    axis = axes[0, 0]
    for place, (_, people) in enumerate(table.iloc[::-1].iterrows()):
        values = people.to_numpy(dtype=float)
        low, high = statistics.interval(values)
        axis.plot(values, np.full(len(values), place), "o", color=GREY, markersize=5, zorder=1)
        axis.plot([low, high], [place, place], color=BLUE, linewidth=2)
        axis.plot(values.mean(), place, "o", color=BLUE)
    axis.set_yticks(range(len(table)), table.index[::-1])
    axis.set(xlabel="captures labelled correctly, %", ylim=(-0.6, len(table) - 0.4))
    axis.grid(axis="x", alpha=0.25)
    axis.set_title(f"grey: each of {table.shape[1]} subjects; blue: mean and 95 % interval over subjects", fontsize=9)
    done(figure, folder / "interval.png", synthetic=True)


def chart(data: str, budget: float, path: Path) -> None:
    """Accuracy against flash, as the report draws it, with a budget.

    Args:
        data: the corpus; LOSO runs of the store are drawn.
        budget: kB of flash.
        path: of the picture.
    """
    every = every_result(connect())
    alone = [r for r in every if r.alone]
    title, results = loso(stored(connect()), data)
    answer = candidates.considered(title, results, alone, {"flash": budget})
    models = {r.system: str(r["model_name"]) for r in every}
    points = candidates.marks(answer, models, {*published()["system"]})
    drawn = speed.cost_chart(answer.title, points, costs()["flash"], budget)
    if drawn is None:
        raise SystemExit(f"{data}: the flash of no system is known; run one whose size can be counted")
    figures.in_one_size(drawn[0])
    done(drawn[0], path, "(synthetic)" in answer.title)


def loso(results: list[Result], data: str) -> tuple[str, list[Result]]:
    """The first group of results on a corpus with LOSO, and its name."""
    return next(
        (name, members)
        for name, members in grouped(results).items()
        if members[0]["data"] == data and members[0]["protocol_name"] == "loso"
    )


def done(figure: object, path: Path, synthetic: bool) -> None:
    """Write a picture; one of generated captures says so on its face."""
    if synthetic:
        figures.mark(figure)
    figure.savefig(path, dpi=125, metadata={"Software": None})
    print(path)


def concepts(folder: Path) -> None:
    """All pictures of the page of concepts, from runs in a store of their own."""
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        os.environ["MLFLOW_TRACKING_URI"] = f"sqlite:///{place}/mlflow.db"
        os.chdir(place)
        bench.run(model=["tree", "bayes", "lda", "svm"], features="jung28", **SMALL)
        bench.run(model="lda", features="touch", model__window=0.5, **SMALL)
        for draw in (capture, unit, protocol, interval):
            draw(folder)
        chart("synth", 64, folder / "front.png")
        os.chdir("/")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["concepts"]:
            concepts(DOCS / "pictures")
        case ["speed"]:
            chart("haart", 64, DOCS / "speed.png")
        case _:
            sys.exit(__doc__)
