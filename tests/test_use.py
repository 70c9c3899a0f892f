"""What went wrong in use: each test is a kind of fault with a small input."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench import registry
from bench.cli import main
from bench.errors import InputError
from bench.source import source_digest

MODEL = """
import joblib
from sklearn.base import BaseEstimator, ClassifierMixin

class Bad(ClassifierMixin, BaseEstimator):
    def fit(self, X, y):
        raise ValueError("file \\udcff")
"""


def test_a_failed_fold_names_the_line_of_the_users_code_and_other_systems_go_on(capsys):
    Path("bad.py").write_text(MODEL)
    words = ["run", "data.subjects=3", "data.variants=normal", "data.repetitions=1", "features=jung28", "jobs=1"]
    assert main([*words, "model=bad.py:Bad,bayes"]) == 1
    told = capsys.readouterr()
    assert "(bad.py, line 7)" in told.out + told.err and "file \\udcff" in told.out + told.err
    assert "bayes" in told.out


def test_output_is_written_where_the_locale_knows_no_such_letter():
    code = "from bench.cli import _open_output; _open_output(); print('\\xb7')"
    plain = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | plain, capture_output=True, check=True)
    assert done.stdout.strip() == b"\\xb7"


@pytest.mark.parametrize("words", [["run", "model=bayes", "train_subjects=1"], ["tune", "model=tree", "inner=loso"]])
def test_a_training_part_without_a_gesture_is_refused_in_a_learning_curve_and_in_a_search(words, capsys):
    few = "where=gesture in ('pat', 'rub', 'tap') and (gesture != 'rub' or subject in ('1', '2'))"
    on = ["data.subjects=4", "data.variants=normal", "data.repetitions=1", "features=jung28", "jobs=1"]
    assert main([*words, few, *on]) == 2
    assert "nobody" in (told := capsys.readouterr().err) and "rub" in told


def test_files_that_a_system_names_are_part_of_its_key():
    Path("my.py").write_text("depends = ['table.txt']\ndef tree(): pass\n")
    keys = []
    for text in ("1", "2", "1"):
        Path("table.txt").write_text(text)
        registry.forget()
        keys.append(source_digest(registry.load("models", "my.py:tree")))
    assert keys[0] == keys[2] != keys[1]
    Path("table.txt").unlink()
    with pytest.raises(InputError, match="depends names 'table.txt'"):
        source_digest(registry.load("models", "my.py:tree"))


@pytest.mark.parametrize(("rows", "code"), [("X", 0), ("X[:1]", 1)])
def test_a_function_from_captures_to_rows_is_a_feature_set(rows, code, capsys):
    text = f"def peaks(X, power=1):\n    return [[c.max() ** power, c.mean()] for c in {rows}]\n"
    Path("feat.py").write_text(text)
    words = ["data.subjects=3", "data.variants=normal", "data.repetitions=1", "model=bayes", "jobs=1"]
    assert main(["run", *words, "features=feat.py:peaks", "features.power=2"]) == code
    told = capsys.readouterr()
    assert "peaks[power=2]" in told.out + told.err and ("1 rows for" in told.out + told.err) == bool(code)


def test_a_check_that_comes_to_no_verdict_leaves_no_green_file(capsys):
    on = ["data.subjects=3", "data.variants=normal", "data.repetitions=1", "features=jung28", "jobs=1"]
    good = "from sklearn.tree import DecisionTreeClassifier as Tree\ndef tree():\n    return Tree(random_state=0)\n"
    Path("my.py").write_text(good)
    check = ["check", "baseline=b.json", "junit=check.xml"]
    assert main([*check, "update=yes", *on, "model=my.py:tree"]) == main(check) == 0
    assert 'failures="0" errors="0"' in Path("check.xml").read_text()
    Path("bad.json").write_text("<<<<<<< HEAD")
    assert main(["check", "baseline=bad.json", "junit=check.xml"]) == 2
    assert 'errors="1"' in (told := Path("check.xml").read_text()) and "damaged" in told
    Path("my.py").write_text(good.replace("random_state=0", "max_depth=-1"))
    assert main(check) == 1
    assert 'errors="1"' in (told := Path("check.xml").read_text()) and "InvalidParameterError" in told
    Path("b.json").write_bytes(b"\xef\xbb\xbf" + Path("b.json").read_bytes())
    Path("my.py").write_text(good)
    assert main(check) == 0
