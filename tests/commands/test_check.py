"""The command ``bench check``: a system from one commit to the next, bad input, and the gate of this project."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from bench.cli import main
from bench.outcomes.gate import read
from bench.source import git_revision


@pytest.fixture
def copied(plug):
    """A system of an installed package whose source can be changed, as between two commits."""

    def write(wrong="", fails=""):
        source = COPIED.replace("# WRONG", wrong).replace("# FAILS", fails)
        plug("[touchbench.models]\ncopied = copied_system:Copied\n", source, "copied_system")

    write()
    return write


COPIED = """
import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.neighbors import NearestCentroid

class Copied(ClassifierMixin, BaseEstimator):
    def __init__(self, near=1):
        self.near = near

    def values(self, X):
        maps = [frames.mean(axis=0) for frames in X]
        # WRONG
        return np.array([np.append(np.sort(m.ravel())[::8], [m[2].mean(), len(f)]) for m, f in zip(maps, X)])

    def fit(self, X, y):
        # FAILS
        self.inner_ = NearestCentroid().fit(self.values(X), y)
        self.classes_ = self.inner_.classes_
        return self

    def predict(self, X):
        return self.inner_.predict(self.values(X))
"""


def test_the_command_holds_a_system_from_one_commit_to_the_next(copied, capsys):
    small = ["model=copied", "data.subjects=4", "data.variants=normal"]
    gate = ["check", "baseline=here/b.json", "slower=1000"]
    assert main([*gate, "update=true", *small]) == 0
    out = capsys.readouterr().out
    assert "new      copied | synth* | loso: " in out and "here/b.json: 1 system" in out
    before = Path("here/b.json").read_text()
    (stored,) = read(Path("here/b.json"))
    assert len(stored.labels) == 56 and stored.names["seed"] == "none" and 0 < stored.costs["relative"] < 1000
    assert stored.run == " ".join(small)

    assert main([*gate, "junit=out/check.xml"]) == 0
    captured = capsys.readouterr()
    assert "already stored" in captured.err and "same     copied | synth* | loso: " in captured.out
    assert ElementTree.parse("out/check.xml").getroot().get("failures") == "0"

    copied(wrong="maps = [np.roll(m, 1) * (1 + (len(f) % 3)) for m, f in zip(maps, X)]")
    assert main([*gate, "junit=out/check.xml"]) == 1
    out = capsys.readouterr().out
    (case,) = ElementTree.parse("out/check.xml").getroot()
    (line,) = [line for line in out.splitlines() if " labels changed" in line]
    assert case.find("failure").get("message") == line and not line.startswith("same")
    revision = git_revision() or "unknown"
    assert line.endswith(f", since revision {revision} (last the same: {revision})")
    assert main([*gate, "stored=yes"]) == 1  # the newest tracked run is the faulty one

    copied(fails="raise RuntimeError('no')")
    assert main(gate) == 1
    assert "not run  copied | synth* | loso: its folds fail: RuntimeError: no" in capsys.readouterr().out
    assert main([*gate, "update=true"]) == 1 and Path("here/b.json").read_text() == before

    copied()  # as it was: its run is found again, although a newer one is tracked
    assert main(gate) == 0
    assert main(["run", "model=bayes", "features=jung28", *small[1:]]) == 0
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        assert main([*gate, "update=true", "model=bayes", "features=jung28", *small[1:]]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert Path("here/b.json").read_text() == before and len(list(Path("here").iterdir())) == 1
    assert main([*gate, "update=true", "model=bayes", "features=jung28", *small[1:]]) == 0
    out = capsys.readouterr().out
    assert "same     copied" in out and "new      bayes · jung28 | synth* | loso: " in out
    assert [m.names["system"] for m in read(Path("here/b.json"))] == ["copied", "bayes · jung28"]


BASELINE = Path(__file__).parents[2] / "reports" / "baseline.json"


@pytest.mark.live
@pytest.mark.pool
def test_the_systems_are_what_the_baseline_says(capsys):
    """Labels and size; of computing time only what no difference between machines explains."""
    code = main(["check", f"baseline={BASELINE}", "slower=10"])
    assert code == 0, capsys.readouterr().out
    assert all(measured.synthetic for measured in read(BASELINE))


def test_keys_select_systems_of_the_baseline(capsys):
    small = ["features=jung28", "data.subjects=3", "data.variants=normal", "data.repetitions=1", "jobs=1"]
    assert main(["check", "baseline=b.json", "update=yes", "model=tree,bayes", *small]) == 0
    capsys.readouterr()
    assert main(["check", "baseline=b.json", "slower=1000", "model=bayes", "data=synth"]) == 0
    out = capsys.readouterr().out
    assert "bayes · jung28" in out and "tree" not in out and "1 of 1 systems are the same" in out
