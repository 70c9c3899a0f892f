"""What more seconds of search buy: accuracy of `auto` on held-out subjects against them.

    python studies/anytime.py data=haart protocol=loso seconds=1,2,5,10,30

runs `bench run model=auto` once per number of seconds, each a search of its own in every training part, and writes a
table and a figure to ``out=``. The other keys are those of `bench run`. ``trials.csv`` of a run lists its trials, with
the fronts of accuracy and each cost.
"""

import sys
from pathlib import Path

import pandas as pd

import bench
from bench.arguments import KEYS, parse
from bench.reports.figures import new_figure, save
from bench.words import items


def drawn(table: pd.DataFrame, out: Path) -> None:
    """Accuracy with its interval over subjects, and flash of what the search ends with, against them."""
    figure, axes = new_figure((9.0, 3.6), (1, 2), between=(0.9, 0.9))
    seconds = table["seconds"]
    axes[0][0].fill_between(seconds, table["low"], table["high"], color="tab:red", alpha=0.2, lw=0)
    axes[0][0].plot(seconds, table["accuracy"], "o-", color="tab:red")
    axes[0][0].set_ylabel("accuracy on held-out subjects, %")
    axes[0][1].plot(seconds, table["flash_bytes"] / 1e3, "o-", color="tab:blue")
    axes[0][1].set_ylabel("flash, kB, 32 bits")
    for axis in axes[0]:
        axis.set_xscale("log")
        axis.set_xlabel("seconds of search")
    context = ", ".join(table.loc[0, ["data", "subset", "target", "protocol"]])
    caption = f"{context}: band: 95 % interval over subjects; flash of the largest system of all folds"
    save(figure, out, "anytime", context, caption)


def main(words: list[str]) -> pd.DataFrame:
    """Run every search, write the table and the figure, return the table."""
    values = parse(words, KEYS | {"seconds", "out"})
    out = Path(values.pop("out", "anytime"))
    numbers = items("seconds", values.pop("seconds", "1,2,5,10,30,60"))
    if values.setdefault("model", "auto") != "auto":
        raise bench.InputError(f"model={values['model']}: only auto takes seconds; leave it out")
    tables = [bench.run(**values, **{"model.seconds": seconds}).assign(seconds=float(seconds)) for seconds in numbers]
    table = pd.concat(tables, ignore_index=True).sort_values("seconds", ignore_index=True)
    if table["seconds"].duplicated().any():
        raise bench.InputError("give one value of each key but seconds=")
    out.mkdir(parents=True, exist_ok=True)
    table.to_csv(out / "anytime.csv", index=False)
    drawn(table, out)
    return table


if __name__ == "__main__":
    try:
        print(main(sys.argv[1:])[["seconds", "accuracy", "low", "high", "flash_bytes", "folds"]].to_string(index=False))
    except bench.InputError as error:
        sys.exit(str(error))
