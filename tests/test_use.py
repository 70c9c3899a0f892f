"""What went wrong in use: each test is a kind of fault with a small input."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
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


def recorded(change=lambda table: table, levels=lambda v: v, **how):
    """A table of four people who tap and hold a skin of 4 x 6 taxels, of which neighbours move together."""
    rng, rows = np.random.default_rng(0), []
    touches = [(s, g, k) for s in ("anna", "ben", "carla", "dora") for g in ("tap", "hold") for k in range(5)]
    for subject, gesture, take in touches:
        noise = np.pad(rng.normal(0, 60, (30, 4, 6)), ((0, 0), (1, 1), (1, 1)))
        near = sum(noise[:, i : i + 4, j : j + 6] for i in range(3) for j in range(3))
        values = levels(np.clip(200 + near + 100 * (gesture == "hold"), 0, 1023).round().astype(int))
        rows += [(subject, gesture, take, f, *v) for f, v in enumerate(values.reshape(30, 24))]
    names = ["subject", "gesture", "take", "frame", *(f"ch{i}" for i in range(1, 25))]
    change(pd.DataFrame(rows, columns=names)).to_csv("rec.csv", index=False, **how)
    return ["data", "import", "table", "rec.csv", "name=rec"]


def misspelt(name, other, count=None):
    def change(table):
        rows = (table["gesture"] == name) & (table["take"] == 0) & table["subject"].isin(["anna", "ben"][: count or 2])
        return table.assign(gesture=table["gesture"].mask(rows, other))

    return change


@pytest.mark.parametrize(
    ("words", "how", "told"),
    [
        ("grid=4x6 rate_hz=50", {}, ""),
        ("grid=6x4 rate_hz=50", {}, "give grid=4x6"),
        ("grid=4x6 rate_hz=5000", {}, "check rate_hz=5000"),
        ("grid=4x6 rate_hz=0.5", {}, "check rate_hz=0.5"),
        ("grid=4x6 rate_hz=50", {"levels": lambda v: v // 4}, "give full_scale=255"),
        ("grid=4x6 rate_hz=50", {"levels": lambda v: v // 4 * 4}, "multiples of 4"),
        ("grid=4x6 rate_hz=50", {"levels": lambda v: 1023 - v}, "pressed at rest"),
        ("grid=4x6 rate_hz=50", {"change": misspelt("tap", "Tap ")}, "'Tap' and 'tap'"),
        ("grid=4x6 rate_hz=50", {"change": misspelt("hold", "holt", 1)}, "if it is 'hold'"),
    ],
)
def test_what_captures_contradict_is_told_on_import(words, how, told, capsys):
    assert main([*recorded(**how), *words.split()]) == 0
    err = capsys.readouterr().err
    assert told in err and err.count("\n") == bool(told)


def test_a_name_in_two_encodings_is_one_person(capsys):
    def two(table):
        first = table["take"] < 2
        return table.assign(
            subject=table["subject"]
            .mask(table["subject"] == "anna", "Jos\xe9")
            .mask((table["subject"] == "anna") & first, "Jose\u0301")
        )

    assert main([*recorded(two), "grid=4x6", "rate_hz=50"]) == 0
    told = capsys.readouterr()
    assert "4 subjects" in told.out and "spelt in parts" in told.err


@pytest.mark.parametrize("how", [{"sep": ";"}, {"sep": "\t"}, {"change": lambda t: t.assign(frame=t["frame"] * 1.0)}])
def test_tables_as_other_programs_write_them_are_the_same_corpus(how, capsys):
    digests = []
    for each in ({}, how):
        assert main([*recorded(**each), "grid=4x6", "rate_hz=50"]) == 0
        digests.append(capsys.readouterr().out.partition("digest ")[2][:16])
    assert digests[0] == digests[1]


def test_a_corpus_comes_back_from_the_table_that_is_exported(capsys):
    assert main([*recorded(), "grid=4x6", "rate_hz=50"]) == 0
    for file in ("back.csv", "back.parquet"):
        digest = capsys.readouterr().out.partition("digest ")[2][:16]
        assert main(["data", "export", "rec", file]) == 0
        *_, line = capsys.readouterr().out.splitlines()
        assert main(shlex.split(line.removeprefix("next: bench "))) == 0
        assert digest in (told := capsys.readouterr().out)
        print(told)


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
