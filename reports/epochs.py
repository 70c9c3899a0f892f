"""How long to train and how fast: accuracy on training people who are left out, epoch by epoch.

``python -m reports.epochs data=haart protocol=challenge model=hughes2017_cnn model.rate=1e-4,1e-3 model.epochs=200``
deals the training people of every fold into ``groups=3``, trains the network without one group at a time and notes its
accuracy on that group after each epoch. One training shows all shorter ones, so it costs no more than the longest. It
prints the best epoch of each system, and writes table and figure: whether a training was cut short can be seen there.
Nobody who is tested is looked at. Other keys are those of ``bench run``. A killed training begins anew.
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
from bench.plan.arguments import backend_of, convert, parse
from bench.plan.cells import Cell, cells
from bench.plan.plan import Fold, Plan
from bench.work.experiment import Experiment
from bench.work.fold import computing
from bench.work.loop import execute, prepared
from models import contract, recipe
from models.inner import inner_folds
from models.window import WindowNet
from reports.figures import Picture, new_figure, save
from reports.learning import refuse_alike

SMOOTH = 5  # epochs that the best one is the middle of: one epoch's accuracy is noise


@dataclass(frozen=True)
class Epochs(Experiment):
    """Accuracy on one group of training people after each epoch of a network that learns from the others.

    Attributes:
        groups: into which the training people of a fold are dealt.
        group: the one that is left out, from 0.
    """

    kind: ClassVar[str] = "epochs"
    fold_kind: ClassVar[str] = "epochs_fold"
    heading: ClassVar[str] = "Accuracy in percent on training people who are left out, at the best epoch"
    columns: ClassVar[frozenset[str]] = frozenset({"epoch", "loss", "accuracy", "captures"})

    groups: int = 3
    group: int = 0

    def refuse(self, plan: Plan) -> None:
        """Refuse what is not one network, and fewer people than groups.

        Raises:
            InputError: one of them.
        """
        if plan.cell.tuning or not _is_network(plan.cell):
            raise InputError(f"model={plan.cell.model}: only a network by itself has epochs to look at")
        if plan.mixes_subjects:
            raise InputError(f"protocol={plan.cell.protocol}: people who are tested are trained on; choose another")
        for fold in plan.folds:
            if (there := len(set(plan.corpus.subjects[fold.train]))) < self.groups:
                raise InputError(f"groups={self.groups}: fold {fold.name} has {there} people for training; give fewer")

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Train without the group; a row per epoch."""
        part = corpus[fold.train]
        _, judged = inner_folds(part.subjects.astype(str), str(self.groups))[self.group]
        with computing(threads):
            system = watched(cell, np.unique(part.subjects[judged].astype(str)))
            system.fit(part, part.gestures)
        seen = [row for row in contract.history(system) if "held_accuracy" in row]
        if not seen:
            raise InputError(f"{cell.model} does not judge its epochs: hand judge= of learn on to train")
        table = pd.DataFrame(
            {
                "fold": fold.name,
                "epoch": np.arange(1, len(seen) + 1),
                "loss": [row["loss"] for row in seen],
                "accuracy": [row["held_accuracy"] for row in seen],
                "captures": len(judged),
            }
        )
        return FoldResult(fold.name, table, {"epochs_seen": float(len(seen))}, history=contract.history(system))

    def findings(self, plan: Plan, tags: dict[str, str], results: list[FoldResult]) -> Findings[pd.DataFrame]:
        """The curve of this group."""
        table = table_of(results)
        best = best_epoch(curve([table]))
        return Findings({"accuracy": best[1], "epoch": float(best[0])}, {"epochs.parquet": table}, analysis=table)

    def row(self, metrics: dict[str, float]) -> dict[str, str]:
        """The best epoch of this group and its accuracy."""
        if not metrics:
            return {"left out": str(self.group), "best epoch": "-", "accuracy": "-"}
        found = {"left out": str(self.group), "best epoch": f"{metrics['epoch']:.0f}"}
        return found | {"accuracy": f"{100 * metrics['accuracy']:.1f}"}


def _is_network(cell: Cell) -> bool:
    factory = cell.model.factory
    return isinstance(factory, type) and issubclass(factory, WindowNet) and cell.features is None


def watched(cell: Cell, held: np.ndarray) -> contract.System:
    """The system of a cell, with its network judged after each epoch on the captures of some training subjects.

    It does not train on them; its steps, such as damaged copies, are made of them as of the others.

    Args:
        cell: of a network.
        held: names of the subjects.
    """

    # A class of a function has no checkpoint (`models.checkpoint`), which would be the same one for every group.
    class Watched(cell.model.factory):
        holds_out = True

        def _held_out(self, X: Corpus) -> np.ndarray:
            return np.isin(X.subjects.astype(str), held)

    return recipe.build(Watched, None, **cell.model.parameters)


def curve(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Accuracy and loss by epoch, over all captures that were left out; a training that has ended stays as it is."""
    last = max(int(table["epoch"].max()) for table in tables)
    right, size, losses = np.zeros(last), 0, []
    for table in tables:
        for _, rows in table.groupby("fold", sort=False):
            held = rows.set_index("epoch").reindex(range(1, last + 1)).ffill()
            right += held["accuracy"].to_numpy() * rows["captures"].iloc[0]
            size += rows["captures"].iloc[0]
            losses.append(held["loss"].to_numpy())
    return pd.DataFrame({"epoch": range(1, last + 1), "accuracy": right / size, "loss": np.mean(losses, axis=0)})


def best_epoch(found: pd.DataFrame) -> tuple[int, float]:
    """The epoch in the middle of the `SMOOTH` that are best together, the first of equal ones, and their accuracy."""
    width = min(SMOOTH, len(found))
    means = np.convolve(found["accuracy"], np.full(width, 1 / width), "valid")
    at = int(np.argmax(np.round(means, 12)))
    return int(found["epoch"].iloc[at + width // 2]), float(means[at])


def main(arguments: list[str]) -> int:
    """Train, print a row per system, write table and figure."""
    values = parse(arguments, KEYS | {"groups", "out"})
    groups = convert("groups", values.get("groups", "3"), 3)
    if groups < 2:
        raise InputError(f"groups={groups}: give at least 2")
    out = writable(Path(values.get("out", "epochs")))
    asked = cells({k: v for k, v in values.items() if k not in {"groups", "out"}})
    refuse_alike(asked)
    backend = backend_of(values)
    outcomes = execute(prepared(asked, [Epochs(groups, group) for group in range(groups)], backend.jobs), backend)
    if failed := [o.run_id for o in outcomes if o.findings is None or o.errors]:
        console.print(f"some trainings failed: {', '.join(failed)}", style="red", markup=False)
        return 1
    by_system: dict[str, list[pd.DataFrame]] = {}
    for outcome in outcomes:
        by_system.setdefault(outcome.plan.cell.system(), []).append(outcome.analysis)
    table, picture = told(by_system, ", ".join(context_of(outcomes[0].tags)), out)
    table.to_csv(out / "epochs.csv", index=False)
    console.print(f"{picture.group}; accuracy of captures of training people who are left out", markup=False)
    console.print(table.to_string(index=False), markup=False, soft_wrap=True)
    console.print(str(picture.paths[0]), markup=False, soft_wrap=True)
    return 0


def told(by_system: dict[str, list[pd.DataFrame]], context: str, out: Path) -> tuple[pd.DataFrame, Picture]:
    """Best and last epoch of each system, as a table and a figure.

    Args:
        by_system: tables of `Epochs` by the name of their system.
        context: data and protocol.
        out: folder of the figure.
    """
    figure, axes = new_figure((12.5, 4.2), (1, 2), margins=(0.7, 3.0, 0.6, 0.3), between=(0.8, 0.5))
    rows = []
    for name, tables in by_system.items():
        found = curve(tables)
        epoch, accuracy = best_epoch(found)
        ends = [int(ended) for table in tables for ended in table.groupby("fold", sort=False)["epoch"].max()]
        rows.append(
            {"system": name, "best epoch": epoch, "accuracy": round(accuracy, 4)}
            | {"at the end": round(float(found["accuracy"].iloc[-1]), 4), "last loss": round(found["loss"].iloc[-1], 4)}
            | {"ended after": ", ".join(map(str, ends))}
        )
        axes[0][0].plot(found["epoch"], 100 * found["accuracy"], linewidth=1)
        axes[0][0].plot(epoch, 100 * accuracy, "o", color=axes[0][0].lines[-1].get_color())
        axes[0][1].plot(found["epoch"], found["loss"], linewidth=1)
    axes[0][0].set_ylabel("accuracy on people who are left out, %")
    axes[0][1].set_ylabel("training loss")
    for axis in axes[0]:
        axis.set_xlabel("epoch")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0][1].legend(axes[0][0].lines[::2], by_system, loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    caption = f"{context}: training people in groups, each left out once; dots mark the epoch to choose."
    return pd.DataFrame(rows), save(figure, out, "epochs", "epochs", context, caption)


if __name__ == "__main__":
    from reports.epochs import main  # so that workers know its classes by the name of the module

    try:
        raise SystemExit(main(sys.argv[1:]))
    except InputError as error:
        console.print(str(error), style="red", markup=False)
        raise SystemExit(2) from error
