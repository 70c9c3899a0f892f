"""The gate: its tests against enumeration, its verdicts, and the command as a whole."""

import itertools
import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from bench import registry
from bench.cli import main
from bench.corpora.synth import generate
from bench.errors import InputError
from bench.outcomes.baseline import Measured, read, text
from bench.outcomes.gate import LIMITS, Verdict, compare, drawn, held, interval, junit, p_value, units_of
from bench.outcomes.results import FoldResult, costs
from bench.work.fold import latency, reference
from features.jung54 import Jung54
from models.classic.svm import svm

NAMES = {
    "data": "toy",
    "corpus_digest": "d",
    "subset": "all",
    "target": "gesture",
    "protocol": "loso",
    "system": "s",
    "seed": "none",
}
HERE = {"cpu": "x", "threads": "1", "version.numpy": "2"}


def measured(right, seed="none", costs=None, environment=HERE, subjects=None, **fields):
    """A run with a correct label wherever ``right`` is 1; each wrong label is the same one."""
    right = np.asarray(right)
    subject = np.arange(len(right)) if subjects is None else np.asarray(subjects)
    labels = pd.DataFrame(
        {"fold": subject.astype(str), "capture": np.arange(len(right)), "subject": subject.astype(str)}
    )
    labels = labels.assign(true="pat", predicted=np.where(right, "pat", "rub"))
    costs = {"relative": 2.0, "flash": 400.0} if costs is None else costs
    return Measured("model=svm", NAMES | {"seed": seed} | fields, environment, costs, labels, True)


def words(then, now, **limits):
    (verdict,) = compare([then], [now], **LIMITS | limits)
    return verdict.wrong


# The bootstrap


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=4))
def test_the_bootstrap_is_the_limit_of_drawing_with_replacement(differences):
    differences = np.array(differences)
    n = len(differences)
    sums = Counter(sum(draw) for draw in itertools.product(differences, repeat=n))
    values, chance = drawn(differences, n)
    assert dict(zip(values[chance > 0], chance[chance > 0], strict=True)) == pytest.approx(
        {s: count / n**n for s, count in sums.items()}
    )
    signed = itertools.product([*differences, *-differences], repeat=n)
    far = sum(abs(sum(draw)) >= abs(differences.sum()) for draw in signed)
    assert p_value(differences) == pytest.approx(far / (2 * n) ** n)
    every = np.repeat([*sums], [*sums.values()])
    low, high = interval(differences)
    assert (every <= low).mean() >= 0.025 - 1e-9 and (every < low).mean() <= 0.025 + 1e-9
    assert (every <= high).mean() >= 0.975 - 1e-9 and (every < high).mean() <= 0.975 + 1e-9


def test_the_bootstrap_agrees_with_sampling():
    rng = np.random.default_rng(0)
    differences = rng.integers(-9, 6, 31)
    both = np.concatenate([differences, -differences])
    sampled = np.abs(rng.choice(both, (200_000, 31)).sum(axis=1)) >= abs(differences.sum())
    assert p_value(differences) == pytest.approx(sampled.mean(), abs=0.004)
    sampled = np.quantile(rng.choice(differences, (200_000, 31)).sum(axis=1), [0.025, 0.975])
    assert interval(differences) == pytest.approx(sampled, abs=1.01)


def test_the_chances_of_a_false_alarm_are_as_stated():
    """Two runs whose hits differ by chance alone; captures of a subject go together, as when a fit is lucky."""
    rng = np.random.default_rng(1)
    p = []
    for _ in range(1500):
        luck = rng.normal(0, 0.1, (2, 12, 1))
        hits = (rng.random((2, 12, 20)) < 0.6 + luck).sum(axis=2)
        p.append(p_value(hits[1] - hits[0]))
    p = np.array(p)
    for level in (0.05, 0.01):  # at most the level, but for the chance of this very simulation
        assert binom.sf((p < level).sum() - 1, len(p), level) > 1e-3
    assert (p < 0.05).mean() > 0.02  # and not because nothing is ever found


def test_a_run_that_is_worse_on_every_subject_has_the_smallest_p():
    assert p_value(np.full(7, -3)) == pytest.approx(2 * 0.5**7)
    assert p_value(np.zeros(7, dtype=int)) == 1 and interval(np.zeros(7, dtype=int)) == (0, 0)
    assert p_value(np.array([4])) == 1  # a single unit tells nothing


def test_captures_are_drawn_where_subjects_are_too_few():
    tested = pd.DataFrame({"subject": list("aabbccde"), "capture": [0, 1, 2, 3, 4, 4, 5, 6]})
    tested["difference"] = [1, 0, -1, -1, 1, 1, 0, -1]
    # none, one or two of five better by the toss of a coin, and as many worse: 2 * (1 + 5 + 10) / 2^5
    units, kind = units_of(tested, 1.0)
    assert kind == "subjects" and units.tolist() == [1, -2, 2, 0, -1]
    units, kind = units_of(tested, 0.99)
    assert kind == "captures" and units.tolist() == [1, 0, -1, -1, 2, 0, -1]  # capture 4 was tested in two folds
    many = pd.DataFrame({"subject": range(16), "capture": range(16), "difference": 0})
    assert units_of(many, 2 * 137 / 2**16)[1] == "subjects" and units_of(many[1:], 0.0042)[1] == "captures"


# Verdicts


def test_verdicts_on_accuracy_and_labels():
    then = measured([1, 0] * 60)
    assert words(then, measured([1, 0] * 60)) == ()
    assert words(then, measured([0, 0] * 12 + [1, 0] * 48)) == ("worse",)
    assert words(then, measured([1, 1] * 12 + [1, 0] * 48)) == ("better",)
    assert words(then, measured([0, 1] * 6 + [1, 0] * 54)) == ("changed",)  # 12 labels, none too many right or wrong
    assert words(then, measured([0, 1] * 6 + [1, 0] * 54), changes=100.0) == ()
    assert words(then, measured([0, 1] + [1, 0] * 59)) == ()  # rounding
    (verdict,) = compare([then], [measured([0, 0] * 12 + [1, 0] * 48)], **LIMITS)
    assert verdict.line.startswith("worse    s | toy* | loso: 50.0 -> 40.0 %, -10.0 [-15.8, -5.0], p ")
    assert "(120 subjects), 12 of 120 labels changed, time x1.00, flash x1.00" in verdict.line


def test_a_random_system_is_held_to_its_labels_only_where_it_must_repeat_them():
    then = measured([1, 0] * 60, seed="0")
    other = measured([0, 1] * 20 + [1, 0] * 40, seed="1")
    assert words(then, replace(other, names=then.names)) == ("changed",)
    assert words(then, other) == () and not held(then, other)
    assert "40 of 120 labels changed (as seed 1 may)" in compare([then], [other], **LIMITS)[0].line
    assert words(then, replace(other, names=then.names, environment=HERE | {"cpu": "y"})) == ()
    none = measured([1, 0] * 60)
    assert held(none, replace(none, environment={}))


def test_verdicts_on_cost():
    then = measured([1, 0] * 9)
    assert words(then, replace(then, costs={"relative": 3.9, "flash": 440.0})) == ()
    assert words(then, replace(then, costs={"relative": 4.1, "flash": 441.0})) == ("slower", "larger")
    assert words(then, replace(then, costs={"relative": 4.1}), slower=3.0) == ()
    assert words(replace(then, costs={}), then) == ()
    worse = measured([0, 0] * 9, costs={"relative": 9.0, "flash": 1.0})
    assert words(then, worse) == ("worse", "slower")


def test_what_has_no_counterpart_is_no_pass():
    then = measured([1, 0, 1], seed="0")
    for current, told in (
        ([], "it is made by: bench run model=svm"),
        ([measured([1, 0, 1], seed="0", system="t")], "it is made by"),
        ([measured([1, 0, 1], seed="0", corpus_digest="e")], "the captures are others than the baseline's"),
    ):
        (verdict,) = compare([then], current, **LIMITS)
        assert verdict.wrong == ("not run",) and told in verdict.told and not verdict.current
    assert words(then, measured([1, 0, 1, 1], seed="0")) == ("other captures",)
    same, other = measured([1, 0, 1], seed="0"), measured([0, 0, 0, 0], seed="1")
    assert compare([then], [same, other], **LIMITS)[0].wrong == ()  # the same seed before any other


def test_the_error_rate_is_shared_by_all_questions():
    """Ten flips one way have p 0.0032: an alarm alone, at 1 % for two questions, none among three such systems."""
    then, now = measured([1] * 10 + [0] * 2000), measured([0] * 10 + [0] * 2000)
    assert 0.01 / 6 < p_value(np.array([-1] * 10 + [0] * 2000)) < 0.01 / 2
    assert words(then, now) == ("worse",)
    other = [measured([1, 0], system=name) for name in "tu"]
    assert [v.wrong for v in compare([then, *other], [now, *other], **LIMITS)] == [(), (), ()]


def test_computing_time_is_tracked_beside_the_reference():
    captures = generate(subjects=2, variants=("normal",))
    predict_ms, decide_ms, relative = latency(svm(Jung54()).fit(captures, captures.gestures), captures, 50)
    assert len(predict_ms) == len(decide_ms) == 20 and reference() == reference()
    assert relative["reference_ms"] > 0 and relative["predict_relative"] > 0
    folds = [
        FoldResult(
            "x",
            metrics={"reference_ms": r, "predict_relative": 2 * r, "flash_bytes": r, "fit_seconds": r},
            predict_ms=[1.0],
            decide_ms=[1.0],
        )
        for r in (1.0, 2.0, 9.0)
    ]
    found = costs(folds)
    assert (found["reference_ms"], found["predict_relative"]) == (2, 4)  # one busy moment counts for little
    assert (found["flash_bytes"], found["fit_seconds"]) == (9, 4)


# The file


@given(st.data())
def test_a_baseline_is_read_as_it_was_written(tmp_path_factory, data):
    n = data.draw(st.integers(1, 12))
    label = st.sampled_from(["pat", "a b", 'q"é', "\\n"])
    labels = pd.DataFrame(
        {
            "fold": data.draw(st.lists(st.sampled_from(["1", "fold02"]), min_size=n, max_size=n)),
            "capture": np.arange(n),
            "subject": data.draw(st.lists(st.sampled_from(["1", "ü"]), min_size=n, max_size=n)),
            "true": data.draw(st.lists(label, min_size=n, max_size=n)),
            "predicted": data.draw(st.lists(label, min_size=n, max_size=n)),
        }
    )
    stored = replace(measured([1]), labels=labels, run="""model=svm 'where=variant == "rough"'""")
    path = tmp_path_factory.mktemp("b") / "b.json"
    path.write_text(text([stored, stored]), encoding="utf-8")
    for found in read(path):
        assert {**vars(found), "labels": 0} == {**vars(stored), "labels": 0}
        pd.testing.assert_frame_equal(found.labels.sort_values("capture", ignore_index=True), labels, check_dtype=False)


def test_a_damaged_baseline_is_one_line_and_stays(tmp_path, capsys):
    path = tmp_path / "b.json"
    whole = text([measured([1, 0])])
    entry = json.loads(whole)["systems"][0]
    broken = [
        whole[:-40],
        "",
        "[]",
        whole.replace('"format": 1', '"format": 2'),
        whole.replace('"classes"', '"class"'),
        whole.replace('"seed"', '"seeds"'),
        whole.replace('"predicted": [0]', '"predicted": [7]'),
        json.dumps({"format": 1, "systems": [entry | {"run": "modl=svm"}]}),
        json.dumps({"format": 1, "systems": [entry | {"tested": []}]}),
        '{"format": 1, "systems": []}',
    ]
    for content in broken:
        path.write_text(content)
        for more in ([], ["update=true"], ["update=true", "model=bayes"]):
            assert main(["check", f"baseline={path}", *more]) == 2, content
            error = capsys.readouterr().err
            assert error.count("\n") == 1 and error.startswith("bench: ")
        assert path.read_text() == content
    path.unlink()
    assert main(["check", f"baseline={path}"]) == 2
    assert "there is no such file; write one, for example: bench check" in capsys.readouterr().err


def test_wrong_arguments_are_one_line(tmp_path, capsys):
    (tmp_path / "b.json").write_text(text([measured([1, 0])]))
    for wrong, told in (
        (["error=0"], "error= and changes= are in percent"),
        (["changes=101"], "error= and changes= are in percent"),
        (["slower=nan"], "slower= is a factor"),
        (["model=svm"], "model=svm adds to a baseline with update=true"),
        (["update=true", "run=false"], "run=false compares only"),
        (["update=yes"], "update=yes: give true or false"),
        (["seeds=1"], "no key is called 'seeds'"),
    ):
        assert main(["check", "baseline=b.json", *wrong]) == 2
        assert told in capsys.readouterr().err
    with pytest.raises(InputError, match="holds no system"):
        (tmp_path / "e.json").write_text('{"format": 1, "systems": []}')
        read(tmp_path / "e.json")


def test_junit_has_a_case_for_each_system():
    verdicts = [
        Verdict("s <1>", (), "fine & well"),
        Verdict("t", ("worse",), "1 \x07"),
        Verdict("u", ("not run",), "", False),
    ]
    suite = ElementTree.fromstring(junit(verdicts))
    assert {k: suite.get(k) for k in ("tests", "failures", "errors")} == {"tests": "3", "failures": "1", "errors": "1"}
    good, bad, none = suite
    assert good.get("name") == "s <1>" and good.find("system-out").text == "same     s <1>: fine & well"
    assert bad.find("failure").get("message") == "worse    t: 1  " and none.find("error") is not None


# The command


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A system of an installed package whose source can be changed, as between two commits."""
    site = tmp_path / "site"
    info = site / "copied-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: copied\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[touchbench.models]\ncopied = copied_system:Copied\n")

    def write(wrong="", fails=""):
        (site / "copied_system.py").write_text(COPIED.replace("# WRONG", wrong).replace("# FAILS", fails))
        sys.modules.pop("copied_system", None)

    write()
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(site)
    registry.names.cache_clear()
    yield write
    sys.modules.pop("copied_system", None)
    registry.names.cache_clear()


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
    assert "new      copied | synth* | loso: " in out and "here/b.json: 1 systems" in out
    before = Path("here/b.json").read_text()
    (stored,) = read(Path("here/b.json"))
    assert len(stored.labels) == 56 and stored.names["seed"] == "none" and 0 < stored.costs["relative"] < 1000
    assert stored.run == " ".join(small)

    assert main([*gate, "junit=out/check.xml"]) == 0
    captured = capsys.readouterr()
    assert "stored before" in captured.err and "same     copied | synth* | loso: " in captured.out
    assert ElementTree.parse("out/check.xml").getroot().get("failures") == "0"

    copied(wrong="maps = [np.roll(m, 1) * (1 + (len(f) % 3)) for m, f in zip(maps, X)]")
    assert main([*gate, "junit=out/check.xml"]) == 1
    out = capsys.readouterr().out
    assert "0 of 1 systems are what here/b.json says" in out
    assert "check baseline=here/b.json update=true" in out
    (case,) = ElementTree.parse("out/check.xml").getroot()
    (line,) = [line for line in out.splitlines() if " labels changed" in line]
    assert case.find("failure").get("message") == line and not line.startswith("same")
    assert main([*gate, "run=false"]) == 1  # the newest tracked run is the faulty one

    copied(fails="raise RuntimeError('no')")
    assert main(gate) == 1
    assert "not run  copied | synth* | loso: no complete current run; it is made by: bench run model=copied" in (
        capsys.readouterr().out
    )
    assert main([*gate, "update=true"]) == 1 and Path("here/b.json").read_text() == before
    assert "a run failed; here/b.json stays as it was" in capsys.readouterr().out

    copied()  # as it was: its run is found again, although a newer one is tracked
    assert main(gate) == 0
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        assert main([*gate, "update=true", "model=bayes", "features=jung28", *small[1:]]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert Path("here/b.json").read_text() == before and len(list(Path("here").iterdir())) == 1
    assert main([*gate, "update=true", "model=bayes", "features=jung28", *small[1:]]) == 0
    out = capsys.readouterr().out
    assert "same     copied" in out and "new      bayes · jung28 | synth* | loso: " in out
    assert [m.names["system"] for m in read(Path("here/b.json"))] == ["copied", "bayes · jung28"]
