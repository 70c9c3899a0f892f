"""A fold gives its system its captures alone: other ways to a corpus are closed or found out."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import numpy as np
import pandas as pd
import pytest

import bench
from bench.cli import main
from bench.corpora.folder import content_digest, write_folder
from bench.errors import InputError
from bench.ground.closed import close_corpora
from bench.ground.registry import load_part
from bench.ground.scratch import data_folder
from bench.plan.grid import make_cells
from bench.running import exchanged
from bench.running.exchanged import AuditedCorpus, exchange_labels
from tests.conftest import SMALL, random_corpus
from tests.running.fakes import Level

WORDS = "inside a fold a system gets its captures as X"
GESTURES = ("hit", "pat", "rub", "tap")
SYSTEM = """
import bench
from tests.running.fakes import Level
class Own(Level):
    def fit(self, X, y):
        {fit}
        return super().fit(X, y)
"""
WAYS = {
    "corpus": lambda: bench.corpus("synth", subjects=3),
    "look": lambda: bench.look("skin"),
    "extract": lambda: bench.extract(data="skin"),
    "plans": lambda: bench.plans(data="skin"),
    "run": lambda: bench.run(data="skin", model="bayes"),
}


def import_corpus(corpus):
    """Store a corpus under the name skin."""
    corpus, digest = corpus.with_fields(name="skin"), content_digest(corpus)
    folder = data_folder() / "corpora/skin"
    write_folder(corpus, folder / digest[:16], digest)
    (folder / "current").write_text(digest[:16])
    return corpus


@pytest.mark.parametrize("way", WAYS.values(), ids=[*WAYS])
def test_our_ways_to_a_corpus_are_closed_meanwhile(way):
    import_corpus(random_corpus())
    errors = []

    def collect():
        try:
            way()
        except InputError as e:
            errors.append(str(e))

    with close_corpora(), close_corpora():
        pass
    with close_corpora():
        collect()
        thread = Thread(target=collect)
        thread.start()
        thread.join()
    assert len(errors) == 2 and all(WORDS in line and "\n" not in line for line in errors)
    assert len(bench.corpus("skin")) == 36


def test_they_are_closed_to_a_process_that_a_system_starts():
    code = "import bench; bench.corpus('synth')"
    with close_corpora():
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode and WORDS in done.stderr


@pytest.mark.parametrize("place", ["fit", "file"])
def test_a_system_that_opens_a_corpus_fails_with_one_line(place, capsys):
    opens = "corpus = bench.corpus('synth')"
    code = SYSTEM.format(fit=opens if place == "fit" else "pass")
    Path("own.py").write_text(code + opens * (place == "file") + "\n")
    assert main(["run", "model=own.py:Own", *SMALL]) == (1 if place == "fit" else 2)
    (line, *more) = [line for line in capsys.readouterr().err.splitlines() if WORDS in line]
    assert "own.py" in line and len(more) == (3 if place == "fit" else 0)


def test_each_fold_finds_the_modules_of_a_file_as_imported_for_the_first_time():
    """Also those that it imports from its folder; after the fold, this process has its own back."""
    Path("beside.py").write_text("seen = []\n")
    fit = "assert not seen and not beside.seen; seen.append(1); beside.seen.append(1)"
    Path("own.py").write_text("import beside\nseen = []\n" + SYSTEM.format(fit=fit))
    factory = load_part("models", "own.py:Own")
    before = sys.modules[factory.__module__], sys.modules["beside"], sys.modules["__main__"]
    table = bench.run(model="own.py:Own", data__subjects=3, data__variants="normal", jobs=1)
    assert table["folds"].tolist() == ["3/3"]
    after = sys.modules[factory.__module__], sys.modules["beside"], sys.modules["__main__"]
    assert after == before and load_part("models", "own.py:Own") is factory
    assert before[0].seen == [] and before[1].seen == []


class Reads(Level):
    """Reads the files of the corpus in the data folder."""

    def fit(self, X, y):
        (folder,) = data_folder().glob("corpora/skin/*/")
        lengths = np.load(folder / "lengths.npy")
        frames = np.split(np.load(folder / "frames.npy"), np.cumsum(lengths)[:-1])
        self.learn_from(frames, pd.read_parquet(folder / "captures.parquet"))
        return super().fit(X, y)


class Memorises(Reads):
    def learn_from(self, frames, captures):
        pairs = zip(frames, captures["gesture"], strict=True)
        self.table_ = {each.tobytes(): label for each, label in pairs}

    def predict_proba(self, X):
        labels = [self.table_.get(frames.tobytes(), self.classes_[0]) for frames in X]
        return (np.array(labels)[:, None] == self.classes_).astype(float)


class HasACopy(Memorises):
    """Reads the true labels, which are not in the folder of the audit."""

    def fit(self, X, y):
        with other_folder(os.environ["TRUE_HOME"]):
            return super().fit(X, y)


class ScalesByAll(Reads):
    def learn_from(self, frames, captures):
        self.scale_ = np.concatenate(frames).mean()

    def measure_level(self, frames):
        return super().measure_level(frames) + frames.max() / self.scale_


@contextmanager
def other_folder(home):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TOUCHBENCH_HOME", str(home))
        yield


class HereWithFolder:
    """Runs tasks in this process with another data folder: a process takes seconds to start."""

    def __init__(self, count, env):
        self.home = env["TOUCHBENCH_HOME"]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def submit(self, function, *values):
        with other_folder(self.home):
            value = function(*values)
        return type("Task", (), {"result": lambda _: value})()


@pytest.mark.parametrize(
    ("kind", "failed"),
    [
        (Level, []),
        (Memorises, ["exchanged labels", "files of the corpus"]),
        (HasACopy, ["exchanged labels"]),
        (ScalesByAll, ["files of the corpus"]),
    ],
)
def test_the_audit_on_a_corpus_finds_who_reads_it(kind, failed, monkeypatch):
    import_corpus(random_corpus(subjects=6, per_class=5, gestures=GESTURES))
    monkeypatch.setenv("TRUE_HOME", str(data_folder()))
    if kind is not Memorises:
        monkeypatch.setattr(exchanged, "ProcessPoolExecutor", HereWithFolder)
    (cell,) = make_cells({"model": f"{__file__}:{kind.__name__}", "data": "skin"})
    results = exchanged.audit_corpus(AuditedCorpus(cell), [])
    assert [each.check for each in results if each.result == "failed"] == failed


def test_exchanged_labels_tell_nothing_of_the_true_ones():
    """No capture keeps its label; each other label is as frequent in a class as any."""
    corpus = random_corpus(subjects=6, per_class=8, gestures=GESTURES)
    other = exchange_labels(corpus)
    counts = pd.crosstab(corpus.gestures, other.gestures).to_numpy()
    assert (np.diag(counts) == 0).all() and np.ptp(counts[~np.eye(4, dtype=bool)]) <= 1
    assert (
        sorted(other.subjects) == sorted(corpus.subjects) and (other.frames == corpus.frames).all()
    )
    assert (other.subjects != corpus.subjects).mean() > 0.7


def test_data_of_an_audit_is_an_imported_corpus(capsys):
    assert main(["audit", "model=bayes", "data=synth"]) == 2
    assert "data=synth: give one imported corpus" in capsys.readouterr().err


def test_a_system_that_is_nearly_always_right_is_doubted(capsys):
    """It has a copy of all labels."""
    corpus = import_corpus(random_corpus())
    labels = dict(zip(map(lambda c: c.tobytes(), corpus), corpus.gestures, strict=True))
    Path("labels.py").write_text(f"LABELS = {labels!r}\n")
    Path("knows.py").write_text(
        "import numpy as np\n"
        "from labels import LABELS\n"
        "from tests.running.fakes import Level\n"
        "class Knows(Level):\n"
        "    def predict(self, X):\n"
        "        return [LABELS[capture.tobytes()] for capture in X]\n"
        "    def predict_proba(self, X):\n"
        "        return np.equal.outer(self.predict(X), self.classes_).astype(float)\n"
    )
    typed = ["run", "data=skin", "protocol=loso", "jobs=1"]
    assert main([*typed, "model=knows.py:Knows"]) == 0
    out = capsys.readouterr().out
    assert "Knows: 100.0 %; to see whether it knows captures" in out
    assert "bench audit model=" in out and "knows.py:Knows data=skin" in out
    dull = "class Dull(Level):\n    def measure_level(self, frames):\n        return 0.0\n"
    Path("dull.py").write_text(f"from tests.running.fakes import Level\n{dull}")
    assert main([*typed, "model=dull.py:Dull"]) == 0
    assert "bench audit" not in capsys.readouterr().out
