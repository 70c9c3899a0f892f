"""Systems as C for a microcontroller: labels of the C, and its bytes and instructions."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from bench.corpora.composer import check_background, pieces
from bench.errors import InputError
from bench.export.measure import compiled, lacking, measured, measured_watching, toolchain
from bench.export.tables import check
from bench.export.write import CODE, files_of
from bench.measures import Measure, percent
from bench.outcomes import scores
from bench.outcomes.results import FoldResult, costs, table_of
from bench.progress import warn
from bench.result import Result
from bench.work.experiment import Experiment
from bench.work.fold import batch_effects, computing, decisions, fitted, footprint
from bench.work.replay import STATE, Calibration, Stopping, Waiting
from bench.work.watch import Watch
from bench.work.watcher_training import learned

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.source import Code
    from bench.work.saved import Recogniser

# As large as what `bench fit` teaches, which takes three more fits; it changes no probability.
UNTAUGHT = Stopping(Calibration(1.0, 1.0, 1.0, 1.0), Waiting((0.0,) * len(STATE)), 1.0)


@dataclass(frozen=True)
class OnChip(Experiment):
    """Fit on the training captures, export, and let the C label the test captures.

    Attributes:
        bits: bits of a learnt weight, 32 or 8.
    """

    kind: ClassVar[str] = "chip"
    fold_kind: ClassVar[str] = "chip_fold"
    heading: ClassVar[str] = "Accuracy in percent of whole captures, in C and in Python; a Cortex-M4F, linked"
    ranked: ClassVar[bool] = True
    columns: ClassVar[frozenset[str]] = frozenset({"python"})
    shown: ClassVar[tuple[Measure, ...]] = (
        Measure("bits", read="chip.bits"),
        percent("accuracy", "in C", ends="accuracy"),
        percent("python_accuracy", "in Python"),
        Measure("other_labels", "other labels", form=",.0f", spare=4),
        Measure("chip_flash_bytes", "flash kB", form=",.1f", per=1000),
        Measure("chip_ram_bytes", "library RAM kB", form=",.1f", per=1000),
        Measure("chip_program_ram_bytes", "program RAM kB", form=",.1f", per=1000),
        Measure("chip_stack_bytes", "stack B", form=",.0f"),
        Measure("chip_frame_instructions", "instructions a frame", form=",.0f", spare=3),
        Measure("chip_most_instructions", "at most", form=",.0f"),
    )

    bits: int = 32

    def arguments(self) -> dict[str, str]:
        """Bits where they are not the default."""
        return {} if self.bits == 32 else {"bits": str(self.bits)}

    def identity(self) -> object:
        """Bits, the C that is the same for all systems, and the compilers."""
        h = hashlib.sha256()
        for path in sorted(CODE.iterdir()):
            h.update(path.read_bytes())
        return [repr(self), h.hexdigest(), toolchain()]

    def options(self) -> dict[str, object]:
        """Bits and compilers."""
        return super().options() | {"chip.toolchain": "; ".join(toolchain())}

    def depends(self) -> list[Code]:
        """Modules that are imported late."""
        from bench.export import network
        from bench.work import saved

        return [type(self), network, saved]

    def refuse(self, plan: Plan) -> None:
        """Refuse a system that has no C, and a machine without the programs; warn where no watcher can be learned.

        Raises:
            InputError: either.
        """
        watches = check(plan.cell.untrained)
        if missing := lacking():
            raise InputError(
                f"bench chip needs {', '.join(missing)}, which are not installed; on Debian, install gcc make "
                "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
            )
        if watches and (why := _unwatched(plan)):
            warn(f"warning: costs of watching an endless stream are not measured: {why}")

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Labels of the test captures by the C and by Python; bytes and instructions."""
        from bench.work.saved import Recogniser

        train, test = corpus[fold.train], corpus[fold.test]
        estimator = cell.estimator()
        with computing(threads):
            metrics = fitted(estimator, train)
            predicted = decisions(estimator, corpus, fold.name, fold.test)
            effects = batch_effects(estimator, corpus, fold.test, predicted)
        table = scores.captures(predicted).rename(columns={"predicted": "python"})
        table = table.assign(start=0, frames=test.lengths)
        recogniser = Recogniser(estimator, train, UNTAUGHT)
        with tempfile.TemporaryDirectory() as name:
            folder = self._written(recogniser, Path(name))
            in_c = compiled(folder, len(recogniser.classes))
            proba = np.array([in_c(frames) for frames in test])
            metrics |= measured(folder)
        if check(cell.untrained):
            with computing(threads):
                metrics |= self._watching(recogniser, train)
        table[[f"p_{name}" for name in scores.classes_of(predicted)]] = np.float32(0)
        table[[f"p_{name}" for name in recogniser.classes]] = proba
        sizes = footprint(estimator, corpus)
        if self.bits != 32:  # the size of the Python system
            del sizes["flash_bytes"]
        return FoldResult(fold.name, table, metrics | sizes, batch_effects=effects)

    def _written(self, recogniser: Recogniser, folder: Path) -> Path:
        """The folder, with the C of a system."""
        for file, text in files_of(recogniser, self.bits, "a fold of bench chip").items():
            (folder / file).write_text(text, encoding="utf-8")
        return folder

    def _watching(self, recogniser: Recogniser, train: Corpus) -> dict[str, float]:
        """Costs of the system with a watcher; none where the captures cannot teach one.

        Two training subjects with all gestures teach a watcher of the same size in a tenth of the time, except for the
        learned tail and for gestures that their recordings never have for a whole window.
        """
        subjects, watch = train.subjects.astype(str), Watch()
        names = np.unique(subjects)
        parts = (train[np.isin(subjects, names[:count])] for count in range(2, len(names) + 1))
        few = next((part for part in parts if set(part.gestures) == set(train.gestures)), train)
        try:
            recordings = watch.recordings(few, watch.usual(train))
            recogniser.watcher = learned(recogniser.estimator, recordings, watch.false_alarms)[0]
        except InputError:
            return {}
        with tempfile.TemporaryDirectory() as name:
            return measured_watching(self._written(recogniser, Path(name)))

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Accuracy in C and in Python, and costs."""
        return _compared([result]) | costs([result])

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Accuracy in C and in Python over all folds, captures that they label otherwise, and costs."""
        predictions = table_of(folds)
        labelled = scores.captures(predictions)
        metrics = scores.summary(predictions, plan.corpus.rate_hz) | _compared(folds) | costs(folds)
        return Result(about, metrics, {"predictions": predictions, "per_subject": scores.per_subject(labelled)})


def _unwatched(plan: Plan) -> str:
    """The reason why the folds of a plan cannot teach a watcher; empty if they can."""
    if any(len(set(plan.corpus.subjects[fold.train])) < 2 for fold in plan.folds):
        return "a fold trains on one subject"
    try:
        check_background(*pieces(plan.corpus, Watch().usual(plan.corpus)))
    except InputError as e:
        return str(e)
    return ""


def _compared(results: list[FoldResult]) -> dict[str, float]:
    labelled = scores.captures(table_of(results))
    true, in_c, python = (labelled[name].to_numpy() for name in ("true", "predicted", "python"))
    return {
        "accuracy": float((true == in_c).mean()),
        "python_accuracy": float((true == python).mean()),
        "other_labels": int((in_c != python).sum()),
    }
