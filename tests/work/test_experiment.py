"""A fourth kind of run is one file: accuracy against the number of training captures, run, killed and resumed."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from bench.commands.printing import show
from bench.errors import InputError
from bench.outcomes import scores
from bench.outcomes.results import Findings, FoldResult, table_of
from bench.plan.cells import cells
from bench.work import loop
from bench.work.experiment import Experiment
from bench.work.fold import computing, decisions
from bench.work.loop import Interrupted, execute, prepared
from tests.conftest import InProcess, runs


@dataclass(frozen=True)
class Learning(Experiment):
    """Accuracy when only so many captures of each class are trained on."""

    kind: ClassVar[str] = "learning"
    fold_kind: ClassVar[str] = "learning_fold"
    heading: ClassVar[str] = "Accuracy in percent by training captures of each class"
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

    def findings(self, plan, tags, results):
        whole = {each: scores.captures(part) for each, part in table_of(results).groupby("each")}
        rows = [{"each": each, "accuracy": (t["true"] == t["predicted"]).mean()} for each, t in whole.items()]
        metrics = {f"accuracy.{row['each']}": row["accuracy"] for row in rows}
        tables = {"predictions.parquet": table_of(results), "curve.csv": pd.DataFrame(rows)}
        return Findings(metrics | {"accuracy": rows[-1]["accuracy"]}, tables)

    def row(self, metrics):
        return {str(each): f"{100 * metrics[f'accuracy.{each}']:.1f}" if metrics else "-" for each in self.counts}


SMALL = {"model": "bayes", "data.subjects": "4", "data.variants": "normal", "data.repetitions": "2"}


def done(**options):
    return execute(prepared(cells(SMALL), [Learning(**options)], 1))


def test_it_runs_is_tracked_and_printed(capsys):
    (outcome,) = done()
    assert show([outcome]) == 0
    out = capsys.readouterr().out
    assert "by training captures of each class" in out and "4/4" in out and "synthetic" in out
    store, (run,) = runs("learning")
    assert run.info.status == "FINISHED" and run.data.params["learning.counts"] == "(1, 2)"
    curve = pd.read_csv(store.fetched(run.info.run_id, "curve.csv"))
    assert curve["each"].tolist() == [1, 2] and curve["accuracy"].iloc[-1] == pytest.approx(
        run.data.metrics["accuracy"]
    )
    assert {f.data.tags["touchbench.fold"] for f in store.folds(run.info.run_id)} == {"1", "2", "3", "4"}
    done()
    assert "all 4 folds were stored before" in capsys.readouterr().err and len(runs("learning")[1]) == 1
    done(counts=(1, 3))
    assert len(runs("learning")[1]) == 2  # other options are another run


def test_it_is_killed_and_goes_on_and_ends_the_same(monkeypatch, tmp_path):
    computed = []

    class Watched(InProcess):
        stop = 2

        def finished(self):
            if len(computed) == self.stop:
                raise KeyboardInterrupt
            done = super().finished()
            computed.append(done.result.name)
            return done

    monkeypatch.setattr(loop, "Processes", Watched)
    with pytest.raises(Interrupted, match="goes on from there"):
        done()
    assert runs("learning")[1][0].info.status == "KILLED"
    Watched.stop = None
    (resumed,) = done()
    assert computed == ["1", "2", "3", "4"] and runs("learning")[1][0].info.status == "FINISHED"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/other.db")
    (whole,) = done()
    assert whole.findings.tables["predictions.parquet"].equals(resumed.findings.tables["predictions.parquet"])


def test_what_it_refuses_is_refused_before_anything_runs():
    with pytest.raises(InputError, match="counts=99: a class of fold 1 has 6 captures"):
        done(counts=(99,))
    assert not np.any([path.name == "mlflow.db" for path in __import__("pathlib").Path().iterdir()])


def test_a_column_that_its_table_needs_is_refused(corpus, monkeypatch):
    named = corpus.changed(captures=corpus.captures.assign(each=1))
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: named)
    with pytest.raises(InputError, match="random has a column 'each'"):
        done()
