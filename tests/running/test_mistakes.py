"""What the author of a first system is told, by a fold or once, of each mistake."""

import inspect
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from joblib.externals.loky import process_executor

import bench
from bench.cli import main
from bench.contract import predict_labels
from bench.errors import PredictionError
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.running.workers import ProcessExecutor, run_group_silently
from tests.conftest import SMALL, random_corpus

OWN = """
import numpy as np
from tests.running.fakes import Level
class Own(Level):
    def fit(self, X, y):
        super().fit(X, y)
        {fit}
    def predict_proba(self, X):
        {predict}
        return super().predict_proba(X)
"""


def write_own(fit="pass", predict="pass"):
    Path("own.py").write_text(OWN.format(fit=fit, predict=predict))


@pytest.mark.parametrize(
    ("fit", "words"),
    [
        ("self.classes_ = np.arange(14)", "classes_ has 0, which is no class of training, such as"),
        ("self.classes_ = [*self.classes_, 'x']", "classes_ has 'x', which is no class of"),
        ("del self.classes_", "fit sets no classes_; write self.classes_ = np.unique(y) in fit"),
        ("np.array(X)", "captures of different lengths are no array; iterate over it"),
        ("X.reshape(len(X), -1)", "X.reshape: a Corpus is no array; iterate over it"),
    ],
)
def test_a_mistake_in_fit_fails_with_its_remedy(fit, words, capsys):
    write_own(fit)
    assert main(["run", "model=own.py:Own", *SMALL]) == 1
    assert capsys.readouterr().err.count(words) == 4  # once for each fold, and at the end


def test_numbers_for_names_fail_with_their_remedy(capsys):
    Path("own.py").write_text(
        "import numpy as np\nclass Own:\n"
        "    def fit(self, X, y): self.classes_ = np.unique(y)\n"
        "    def predict(self, X): return np.ones(len(X), int)\n"
    )
    assert main(["run", "model=own.py:Own", *SMALL]) == 1
    assert "predict gives 1, which is not one of" in (err := capsys.readouterr().err)
    assert "give names: self.classes_[numbers]" in err


def test_labels_in_lists_of_lists_are_no_labels():
    """A column is accepted from an array, as CatBoost gives it."""
    three = random_corpus(1, 1)[:3]
    own = SimpleNamespace(classes_=np.array(["pat", "rub", "tap"]))
    labels = ["rub", "tap", "pat"]
    for predicted in ([labels], [[label] for label in labels], np.array([labels])):
        own.predict = lambda _, predicted=predicted: predicted
        with pytest.raises(PredictionError, match="give one list of labels, not lists in it"):
            predict_labels(own, three)
    for predicted in (labels, np.array(labels)[:, None]):
        own.predict = lambda _, predicted=predicted: predicted
        assert predict_labels(own, three).tolist() == labels


def test_a_fit_may_return_nothing():
    write_own()
    values = {key.replace(".", "__"): value for key, _, value in (w.partition("=") for w in SMALL)}
    table = bench.run(model="own.py:Own", train_subjects="1", **values)
    assert table["folds"].tolist() == ["3/3"]
    audit = bench.audit(model="own.py:Own")
    assert "fit" not in [*audit["check"][audit["result"] == "failed"]]


@pytest.mark.parametrize(
    ("noise", "warns"), [("np.random.default_rng().normal()", True), ("0", False)]
)
def test_two_fits_that_differ_are_told_before_the_first_fold(noise, warns, capsys):
    write_own(f"self.means_ += 50 * {noise}")
    assert main(["run", "model=own.py:Own", *SMALL]) == 0
    assert ("Own: two fits to the same captures differ" in capsys.readouterr().err) == warns


def test_what_a_system_prints_in_a_worker_is_counted(capsys):
    write_own(predict="print('predicting', len(X))")
    values = dict(word.split("=") for word in SMALL[:-1])
    (plan,) = make_plans(make_cells({"model": "own.py:Own", **values}), 1)
    (result,) = run_group_silently(plan.cell, plan.corpus, plan.folds[:1], 1)
    assert not result.error and capsys.readouterr().out == ""
    count, _, first = result.printed.partition(" lines, such as ")
    assert int(count) > 1 and first == "predicting 14"


@pytest.mark.pool
def test_the_warning_of_a_worker_that_is_replaced_is_not_shown():
    """loky replaces a worker whose memory has grown, and warns in the words of our filter."""
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        ProcessExecutor(2)._start_pool(1, 1)
        source = inspect.getsource(process_executor)
        text = source[source.index("A worker stopped while") :].partition('"')[0]
        warnings.warn(text, stacklevel=1)
        assert not shown and len(text) > 40
