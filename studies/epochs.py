"""How long to train and how fast: accuracy on training subjects who are left out, epoch by epoch.

    python studies/epochs.py data=haart protocol=challenge model=hughes2017_cnn model.rate=1e-4,1e-3 model.epochs=200

deals the training subjects of every fold into ``groups=3``, trains the network without one group at a time and notes
its accuracy on that group after each epoch. It returns the best epoch of each system, and writes a table and a figure
to ``out=``. Test subjects are never used. The other keys are those of `bench run`.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

import bench
from bench import contract
from bench.amounts import convert
from bench.arguments import KEYS, parse
from bench.models import recipe
from bench.models.nets.window import WindowNet
from bench.models.search.inner_folds import inner_folds
from bench.plan.plan import Plan
from bench.reports.figures import new_figure, save
from bench.work.fold import computing

SMOOTH = 5  # epochs that the best one is the middle of: one epoch's accuracy is noise


def check(plan: Plan, groups: int) -> None:
    """Refuse what is not one network, and fewer subjects than groups.

    Raises:
        InputError: one of them.
    """
    cell, factory = plan.cell, plan.cell.model.factory
    if not (isinstance(factory, type) and issubclass(factory, WindowNet)):
        raise bench.InputError(f"model={cell.model}: only a network by itself has epochs to look at")
    if plan.mixes_subjects:
        raise bench.InputError(f"protocol={cell.protocol}: it trains on tested subjects; choose another")
    fewest = min(len(set(plan.corpus.subjects[fold.train])) for fold in plan.folds)
    if not 2 <= groups <= fewest:
        raise bench.InputError(f"groups={groups}: give 2 to {fewest}, the training subjects of a fold")


def trained(plan: Plan, number: int, groups: int, group: int) -> pd.DataFrame:
    """Loss, and accuracy on one group of training subjects, after each epoch of training on the others.

    Args:
        plan: of one network.
        number: of the fold.
        groups: into which its training subjects are dealt.
        group: the one that is left out, from 0.
    """
    fold = plan.folds[number]
    part = plan.corpus[fold.train]
    subjects = part.subjects.astype(str)
    _, judged = inner_folds(subjects, str(groups))[group]

    # A class of a function has no checkpoint (`bench.models.nets.checkpoint`), which would be the same one for every
    # group.
    class Watched(plan.cell.model.factory):
        holds_out = True

        def _held_out(self, X: bench.Corpus) -> np.ndarray:
            return np.isin(X.subjects.astype(str), subjects[judged])

    with computing(plan.threads):
        system = recipe.build(Watched, None, **plan.cell.model.parameters).fit(part, part.gestures)
    history = [row for row in contract.history(system) if "held_accuracy" in row]
    table = pd.DataFrame(history).rename(columns={"held_accuracy": "accuracy"})[["loss", "accuracy"]]
    return table.assign(epoch=np.arange(1, len(table) + 1), captures=len(judged))


def pooled(trainings: list[pd.DataFrame]) -> pd.DataFrame:
    """Accuracy over all captures that were left out, and mean loss, by epoch; a training that has ended stays."""
    last = max(len(training) for training in trainings)
    longer = [training.set_index("epoch").reindex(range(1, last + 1)).ffill() for training in trainings]
    right = sum(training["accuracy"].to_numpy() * training["captures"].iloc[0] for training in longer)
    size = sum(training["captures"].iloc[0] for training in longer)
    loss = np.mean([training["loss"] for training in longer], axis=0)
    return pd.DataFrame({"epoch": range(1, last + 1), "accuracy": right / size, "loss": loss})


def best_epoch(curve: pd.DataFrame) -> tuple[int, float]:
    """The epoch in the middle of the `SMOOTH` that are best together, the first of equal ones, and their accuracy."""
    width = min(SMOOTH, len(curve))
    means = np.convolve(curve["accuracy"], np.full(width, 1 / width), "valid")
    at = int(np.argmax(np.round(means, 12)))
    return int(curve["epoch"].iloc[at + width // 2]), float(means[at])


def drawn(curves: dict[str, pd.DataFrame], context: str, out: Path) -> None:
    """Accuracy with the best epoch, and training loss, by epoch."""
    figure, axes = new_figure((12.5, 4.2), (1, 2), margins=(0.7, 3.0, 0.6, 0.3), between=(0.8, 0.5))
    for name, curve in curves.items():
        epoch, accuracy = best_epoch(curve)
        (line,) = axes[0][0].plot(curve["epoch"], 100 * curve["accuracy"], linewidth=1)
        axes[0][0].plot(epoch, 100 * accuracy, "o", color=line.get_color())
        axes[0][1].plot(curve["epoch"], curve["loss"], linewidth=1, label=name)
    axes[0][0].set_ylabel("accuracy on subjects left out, %")
    axes[0][1].set_ylabel("training loss")
    for axis in axes[0]:
        axis.set_xlabel("epoch")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0][1].legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    caption = f"{context}: training subjects in groups, each left out once; dots mark the epoch to choose."
    save(figure, out, "epochs", context, caption)


def main(words: list[str]) -> pd.DataFrame:
    """Train, write the table and the figure, return the best and the last epoch of each system."""
    values = parse(words, KEYS | {"groups", "out"})
    groups, out = convert("groups", values.pop("groups", "3"), 3), Path(values.pop("out", "epochs"))
    curves, rows = {}, []
    plans = bench.plans(**values)
    for plan in plans:
        check(plan, groups)
    if len({plan.cell.title() for plan in plans}) < len(plans):
        raise bench.InputError("two curves would have the same name; give each system once, and one seed")
    for plan in plans:
        name, parts = plan.cell.title(), [(n, group) for n in range(len(plan.folds)) for group in range(groups)]
        trainings = Parallel(plan.workers)(delayed(trained)(plan, n, groups, group) for n, group in parts)
        curves[name] = curve = pooled(trainings)
        epoch, accuracy = best_epoch(curve)
        row = {"system": name, "best epoch": epoch, "accuracy": accuracy, "at the end": curve["accuracy"].iloc[-1]}
        ends = ", ".join(str(len(training)) for training in trainings)
        rows.append(row | {"last loss": curve["loss"].iloc[-1], "ended after": ends})
    out.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame(rows)
    table.to_csv(out / "epochs.csv", index=False)
    drawn(curves, f"{plans[0].corpus.name}{' (synthetic)' if plans[0].corpus.synthetic else ''}", out)
    return table


if __name__ == "__main__":
    try:
        print(main(sys.argv[1:]).round(4).to_string(index=False))
    except bench.InputError as error:
        sys.exit(str(error))
