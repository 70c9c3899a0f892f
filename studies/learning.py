"""Learning curves, extrapolated to more training subjects.

    python studies/learning.py data=haart protocol=loso train_subjects=2,4 model=lda,svm features=touch + model=touchnet

runs `bench stress` with ``train_subjects=`` and without faults, and fits the law err(n) = a + b n^-c to each curve. It
extends the curves to ``until=`` subjects (default 300) and writes a table and a figure to ``out=``. The other keys are
those of `bench run`; a plus begins another system with ``model`` and ``features`` of its own.

The law is fitted by least squares with a and b from 0 to 1 and c from 0 to 2. Its 95 % interval comes from curves
through subjects drawn with replacement. Three or four points do not identify a law: an extrapolation is a guess, and
its interval is wide.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import bench
from bench import resampling
from bench.amounts import convert
from bench.arguments import KEYS, parse
from bench.reports.figures import MARKERS, new_figure, save

DRAWS = 500  # of subjects, for the interval of a law
COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown", "tab:pink", "tab:olive")


def law(counts: np.ndarray, errors: np.ndarray) -> tuple[float, float, float]:
    """a, b and c of a + b n^-c, all from 0, a and b at most 1, c at most 2, by least squares.

    Args:
        counts: numbers of subjects, at least three different ones.
        errors: shares of wrong labels.
    """
    best = (np.inf, 0.0, 0.0, 0.0)
    for c in np.linspace(0.02, 2, 100):  # for each exponent the rest is linear, with two bounds
        falls = counts**-c
        for columns in ((0, 1), (0,), (1,)):
            terms = np.column_stack([np.ones_like(falls), falls])[:, columns]
            weights = np.linalg.lstsq(terms, errors, rcond=None)[0].clip(0, 1)
            misfit = float(((terms @ weights - errors) ** 2).sum())
            if misfit < best[0] - 1e-15:
                a, b = (float(weights[columns.index(i)]) if i in columns else 0.0 for i in (0, 1))
                best = misfit, a, b, float(c)
    return best[1:]


def extrapolated(labels: pd.DataFrame, counts: np.ndarray, draws: int) -> np.ndarray:
    """Accuracy that the law expects at each number of subjects: of the curve, and of curves through drawn subjects.

    Args:
        labels: of one system, from `bench.stress`.
        counts: numbers of training subjects [counts].
        draws: of tested subjects, with replacement.

    Returns:
        float64 [1 + draws, counts].
    """
    hits = labels["true"] == labels["predicted"]
    hits = hits.groupby([labels["subject"], labels["train_subjects"]]).agg(["sum", "size"])
    right, size = (hits[name].unstack("train_subjects").fillna(0).to_numpy(float) for name in ("sum", "size"))
    numbers = np.sort(labels["train_subjects"].unique()).astype(float)
    drawn = resampling.drawn(len(right), draws)
    curves = []
    for rows in (np.arange(len(right)), *drawn):
        tested = size[rows].sum(axis=0) > 0
        a, b, c = law(numbers[tested], 1 - right[rows][:, tested].sum(axis=0) / size[rows][:, tested].sum(axis=0))
        curves.append(1 - a - b * counts**-c)
    return np.array(curves)


def overtakes(curves: np.ndarray, other: np.ndarray, counts: np.ndarray) -> tuple[float, float]:
    """The number of subjects from which one curve stays above another, and the share of drawn curves that end above.

    Args:
        curves: `extrapolated` of one system [1 + draws, counts].
        other: of another system, the same draws.
        counts: numbers of subjects, rising.
    """
    above = curves > other
    below = np.flatnonzero(~above[0])
    first = counts[below[-1] + 1 if len(below) else 0] if above[0, -1] else np.inf
    return float(first), float(above[1:, -1].mean())


def measured(systems: list[dict[str, str]], shared: dict[str, str]) -> tuple[pd.DataFrame, pd.DataFrame, str]:
    """Points and labels of every system, and the data and protocol they share.

    Raises:
        InputError: they have not the same captures and protocol.
    """
    runs = [bench.stress(**{"train_subjects": "2,4,8", "faults": "none"} | shared | system) for system in systems]
    context = pd.concat([run[["data", "subset", "target", "protocol"]] for run in runs]).drop_duplicates()
    if len(context) > 1:
        raise bench.InputError("give one corpus, subset, target and protocol, not several")
    tables = (pd.concat([run.tables[name] for run in runs], ignore_index=True) for name in ("learning", "labels"))
    points, labels = (table.rename(columns={"system": "method"}) for table in tables)
    return points, labels, ", ".join(context.iloc[0])


def compared(points: pd.DataFrame, labels: pd.DataFrame, context: str, until: int, out: Path) -> pd.DataFrame:
    """Write the figure; return the points, the extrapolation of each law, and where it overtakes the best system now.

    In a row ``above``, ``train_subjects`` is from how many on, and ``share`` how many of the drawn curves end above.
    """
    most = points["train_subjects"].max()
    ahead = np.unique(np.geomspace(2, max(until, most), 60).round(1))
    curves = {name: extrapolated(rows, ahead, DRAWS) for name, rows in labels.groupby("method", sort=False)}
    last = points.groupby("method", sort=False)["accuracy"].last()
    best = last.idxmax()
    figure, axes = new_figure((10.0, 4.6), margins=(0.7, 4.2, 0.6, 0.3))
    axis, rows = axes[0][0], []
    for place, (name, expected) in enumerate(curves.items()):
        low, high = np.quantile(expected[1:], [0.025, 0.975], axis=0)
        of_system, colour = points[points["method"] == name], COLOURS[place % len(COLOURS)]
        marker = MARKERS[place % len(MARKERS)]
        axis.plot(of_system["train_subjects"], 100 * of_system["accuracy"], marker, color=colour, label=name)
        axis.plot(ahead, 100 * expected[0], color=colour, linewidth=1)
        axis.fill_between(ahead, 100 * low, 100 * high, color=colour, alpha=0.12, linewidth=0)
        rows += [{"method": name, "kind": "measured"} | row for row in of_system.to_dict("records")]
        for number in (n for n in (20, 50, 100, 300, 1000) if most < n <= until):
            at = int(np.argmin(np.abs(ahead - number)))
            row = {"method": name, "kind": "expected", "train_subjects": number, "accuracy": expected[0, at]}
            rows.append(row | {"low": low[at], "high": high[at]})
        if name != best:
            number, share = overtakes(expected, curves[best], ahead)
            rows.append({"method": name, "kind": f"above {best}", "train_subjects": number, "share": share})
    axis.set_xscale("log")
    axis.axvline(most, color="0.6", linewidth=0.8, linestyle=":")
    axis.set_xlabel("training subjects; beyond the dotted line extrapolated")
    axis.set_ylabel("accuracy on held-out subjects, %")
    axis.legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    caption = f"{context}: accuracy against training subjects; the law a + b n^-c with its 95 % interval over subjects."
    save(figure, out, "learning", context, caption)
    return pd.DataFrame(rows)


def main(words: list[str]) -> pd.DataFrame:
    """Run the curves, write the table and the figure, return the table."""
    ends = [i for i, word in enumerate(words) if word == "+"]
    first, *others = (words[i + 1 : j] for i, j in zip([-1, *ends], [*ends, len(words)], strict=True))
    values = parse(first, KEYS | {"train_subjects", "until", "out"})
    until, out = convert("until", values.pop("until", "300"), 300), Path(values.pop("out", "learning"))
    shared = {k: v for k, v in values.items() if k.split(".")[0] not in ("model", "features")}
    systems = [values, *(parse(system, {"model", "features"}) for system in others)]
    if others and not all("model" in system for system in systems):
        raise bench.InputError("+ stands between systems: give model= before and behind it")
    out.mkdir(parents=True, exist_ok=True)
    points, labels, context = measured(systems, shared)
    table = compared(points, labels, context, until, out)
    table.to_csv(out / "learning.csv", index=False)
    return table


if __name__ == "__main__":
    try:
        print(main(sys.argv[1:]).to_string(index=False))
    except bench.InputError as error:
        sys.exit(str(error))
