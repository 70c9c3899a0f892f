"""A fourth kind of run is one file: accuracy against the number of training captures, in 50 lines."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pandas as pd
import pytest

from bench.commands.printing import runs_table, show
from bench.errors import InputError
from bench.measures import Measure, percent
from bench.outcomes import scores
from bench.outcomes.results import FoldResult, table_of
from bench.outcomes.runs import stored
from bench.plan.cells import cells
from bench.result import Result
from bench.work.experiment import Experiment
from bench.work.fold import computing, decisions
from bench.work.loop import execute, prepared
from tests.conftest import runs


@dataclass(frozen=True)
class Learning(Experiment):
    """Accuracy when only so many captures of each class are trained on."""

    kind: ClassVar[str] = "learning"
    fold_kind: ClassVar[str] = "learning_fold"
    heading: ClassVar[str] = "Accuracy in percent by training captures of each class"
    shown: ClassVar[tuple[Measure, ...]] = tuple(percent(str(n), read=f"accuracy.{n}", spare=n) for n in (1, 2, 3))
    columns: ClassVar[frozenset[str]] = frozenset({"each"})

    counts: tuple[int, ...] = (1, 2)

    def refuse(self, plan):
        for fold in plan.folds:
            fewest = min(pd.Series(plan.corpus.gestures[fold.train]).value_counts())
            if max(self.counts) > fewest:
                raise InputError(f"counts={max(self.counts)}: a class of fold {fold.name} has {fewest} captures")

    def fold(self, cell, corpus, fold, threads):
        tables = []
        for each in self.counts:
            order = pd.Series(corpus.gestures[fold.train]).groupby(corpus.gestures[fold.train]).cumcount()
            part = fold.train[(order < each).to_numpy()]
            estimator = cell.estimator()
            with computing(threads):
                estimator.fit(corpus[part], corpus.gestures[part])
                tables.append(decisions(estimator, corpus, fold.name, fold.test).assign(each=each))
        return FoldResult(fold.name, pd.concat(tables, ignore_index=True))

    def result(self, plan, about, folds):
        captures = {each: scores.captures(part) for each, part in table_of(folds).groupby("each")}
        rows = [{"each": each, "accuracy": (t["true"] == t["predicted"]).mean()} for each, t in captures.items()]
        metrics = {f"accuracy.{row['each']}": row["accuracy"] for row in rows}
        tables = {"predictions": table_of(folds), "curve": pd.DataFrame(rows)}
        return Result(about, metrics | {"accuracy": rows[-1]["accuracy"]}, tables)


SMALL = {"model": "bayes", "data.subjects": "4", "data.variants": "normal", "data.repetitions": "2"}


def done(**options):
    return execute(prepared(cells(SMALL), [Learning(**options)], 1))


def test_it_runs_is_tracked_and_printed(capsys):
    (result,) = done()
    assert show([result], Learning) == 0
    out = capsys.readouterr().out
    (texts,) = runs_table([result], Learning).texts
    assert [*texts] == ["system", "1", "2", "folds"]  # no run has three, so there is no such column
    assert texts["2"] == f"{100 * result['accuracy.2']:.1f}" and texts["2"] in out
    assert Learning.heading in out and "4/4" in out and "synthetic" in out
    store, (run,) = runs("learning")
    assert run.info.status == "FINISHED" and run.data.params["learning.counts"] == "(1, 2)"
    (again,) = stored(store, "learning")
    assert again.metrics == result.metrics and again.comparable == result.comparable
    curve = again.tables["curve"]
    assert curve["each"].tolist() == [1, 2]
    assert curve["accuracy"].iloc[-1] == pytest.approx(run.data.metrics["accuracy"])
    done()
    assert len(runs("learning")[1]) == 1  # found again
    done(counts=(1, 3))
    assert len(runs("learning")[1]) == 2  # other options are another run


def test_it_refuses_before_anything_runs(corpus, monkeypatch):
    with pytest.raises(InputError, match="counts=99.* fold 1 .* 6 captures"):
        done(counts=(99,))
    named = corpus.changed(captures=corpus.captures.assign(each=1))
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: named)
    with pytest.raises(InputError, match="random .*'each'"):  # a column that its table needs
        done()
    assert not Path("mlflow.db").exists()
