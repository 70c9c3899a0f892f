"""``bench check``: a system from one commit to the next, and the gate of this project."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from bench.cli import main
from bench.ground.source import git_revisions
from bench.reading.gate import read_baseline
from tests.conftest import SMALL


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
        rows = [np.sort(m.ravel())[::8].tolist() + [m[2].mean(), len(f)] for m, f in zip(maps, X)]
        return np.array(rows)

    def fit(self, X, y):
        # FAILS
        self.inner_ = NearestCentroid().fit(self.values(X), y)
        self.classes_ = self.inner_.classes_
        return self

    def predict(self, X):
        return self.inner_.predict(self.values(X))
"""


def test_the_command_holds_a_system_from_one_commit_to_the_next(copied, capsys):
    small = ["data.subjects=4", "data.variants=normal"]
    baseline, report = Path("here/b.json"), Path("out/check.xml")

    def said(*words, code=0):
        assert main(["check", f"baseline={baseline}", "slower=1000", *words]) == code
        return capsys.readouterr()

    out = said("update=true", "model=copied", *small).out
    assert "new      copied | synth* | loso: " in out and f"{baseline}: 1 system" in out
    before, (stored,) = baseline.read_text(), read_baseline(baseline)
    assert (
        len(stored.labels) == 56
        and stored.names["seed"] == "none"
        and 0 < stored.costs["relative"] < 1000
    )
    assert stored.run == " ".join(["model=copied", *small])

    again = said(f"junit={report}")
    assert "already stored" in again.err and "same     copied | synth* | loso: " in again.out
    assert ElementTree.parse(report).getroot().get("failures") == "0"

    copied(wrong="maps = [np.roll(m, 1) * (1 + (len(f) % 3)) for m, f in zip(maps, X)]")
    (line,) = [
        line
        for line in said(f"junit={report}", code=1).out.splitlines()
        if " labels changed" in line
    ]
    (case,) = ElementTree.parse(report).getroot()
    assert case.find("failure").get("message") == line and not line.startswith("same")
    revision = git_revisions() or "unknown"
    assert line.endswith(f", since revision {revision} (last the same: {revision})")
    said("stored=yes", code=1)  # the newest tracked run is the faulty one

    copied(fails="raise RuntimeError('no')")
    assert "not run  copied | synth* | loso: its folds fail: RuntimeError: no" in said(code=1).out
    said("update=true", code=1)
    assert baseline.read_text() == before

    copied()  # as it was: its run is found again, although a newer one is tracked
    more = ["model=bayes", "features=jung28", *small]
    assert main(["run", *more]) == 0
    more.append("update=true")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device"))
        )
        assert "No space left on device" in said(*more, code=2).err
    assert baseline.read_text() == before and len(list(baseline.parent.iterdir())) == 1
    out = said(*more).out
    assert "same     copied" in out and "new      bayes · jung28 | synth* | loso: " in out
    assert [m.names["system"] for m in read_baseline(baseline)] == ["copied", "bayes · jung28"]
    out = said("model=bayes", "data=synth").out  # keys select systems of the baseline
    assert "bayes · jung28" in out and "copied" not in out and "1 of 1 systems are the same" in out


BASELINE = Path(__file__).parents[2] / "reports" / "baseline.json"


@pytest.mark.live
@pytest.mark.pool
def test_the_systems_are_what_the_baseline_says(capsys):
    """Labels and size; of computing time only what no difference between machines explains."""
    code = main(["check", f"baseline={BASELINE}", "slower=10"])
    assert code == 0, capsys.readouterr().out
    assert all(measured.synthetic for measured in read_baseline(BASELINE))


def test_a_check_that_comes_to_no_verdict_leaves_no_green_file(capsys):
    good = "from sklearn.tree import DecisionTreeClassifier as Tree\n"
    good += "def tree():\n    return Tree(random_state=0)\n"
    report, system, baseline = Path("check.xml"), Path("my.py"), Path("b.json")
    system.write_text(good)
    check = ["check", "baseline=b.json", "junit=check.xml"]
    few = [*SMALL, "features=jung28", "model=my.py:tree"]
    assert main([*check, "update=yes", *few]) == main(check) == 0
    assert 'failures="0" errors="0"' in report.read_text()
    Path("bad.json").write_text("<<<<<<< HEAD")
    assert main(["check", "baseline=bad.json", "junit=check.xml"]) == 2
    assert 'errors="1"' in (xml := report.read_text()) and "damaged" in xml
    fails = "class Fails(Tree):\n    def fit(self, X, y):\n        raise ValueError('no')\n"
    system.write_text(good.replace("def tree", f"{fails}def tree").replace("Tree(r", "Fails(r"))
    assert main(check) == 1
    assert 'errors="1"' in (xml := report.read_text()) and "ValueError" in xml
    system.write_text(good.replace("random_state=0", "max_depth=-1"))
    assert main(check) == 2  # every fold would refuse it
    assert 'errors="1"' in (xml := report.read_text()) and "max_depth" in xml
    baseline.write_bytes(b"\xef\xbb\xbf" + baseline.read_bytes())  # as some editors write it
    system.write_text(good)
    assert main(check) == 0


def test_a_mistyped_key_leaves_no_green_file():
    Path("check.xml").write_text("green")
    assert main(["check", "junit=check.xml", "modle=svm"]) == 2
    assert "no key is called" in Path("check.xml").read_text(encoding="utf-8")
