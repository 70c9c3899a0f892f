"""What went wrong in use: each test is a kind of fault with a small input."""

import io
import shlex
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.cli import _open_output, main
from tests.conftest import SMALL

ON = [*SMALL, "features=jung28"]


def test_output_is_written_where_the_locale_knows_no_such_letter(monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written := io.BytesIO(), encoding="ascii"))
    _open_output()
    print("\xb7", flush=True)
    assert written.getvalue().strip() == b"\\xb7"


@pytest.mark.parametrize(
    "words", [["run", "model=bayes", "train_subjects=1"], ["tune", "model=tree", "inner=loso"]]
)
def test_a_training_part_without_a_gesture_is_refused_in_a_learning_curve_and_in_a_search(
    words, capsys
):
    few = "where=gesture in ('pat', 'rub', 'tap') and (gesture != 'rub' or subject in ('1', '2'))"
    assert main([*words, few, *ON[:1], "data.subjects=4", *ON[2:]]) == 2
    assert "nobody" in (told := capsys.readouterr().err) and "rub" in told


def recorded(change=lambda table: table, levels=lambda v: v, **how):
    """A table of four people who tap and hold a skin of 4 x 6 taxels, of which neighbours move together."""
    rng, rows = np.random.default_rng(0), []
    touches = [
        (s, g, k)
        for s in ("anna", "ben", "carla", "dora")
        for g in ("tap", "hold")
        for k in range(5)
    ]
    for subject, gesture, take in touches:
        noise = np.pad(rng.normal(0, 60, (30, 4, 6)), ((0, 0), (1, 1), (1, 1)))
        near = sum(noise[:, i : i + 4, j : j + 6] for i in range(3) for j in range(3))
        values = levels(
            np.clip(200 + near + 100 * (gesture == "hold"), 0, 1023).round().astype(int)
        )
        rows += [(subject, gesture, take, f, *v) for f, v in enumerate(values.reshape(30, 24))]
    names = ["subject", "gesture", "take", "frame", *(f"ch{i}" for i in range(1, 25))]
    change(pd.DataFrame(rows, columns=names)).to_csv("rec.csv", index=False, **how)
    return ["data", "import", "table", "rec.csv", "name=rec"]


def renamed(column, name, other, takes=1, count=2):
    """A change of a name in some takes of the first people."""

    def change(table):
        rows = (
            (table[column] == name)
            & (table["take"] < takes)
            & table["subject"].isin(["anna", "ben"][:count])
        )
        return table.assign(**{column: table[column].mask(rows, other)})

    return change


USUAL = "grid=4x6 rate_hz=50"


@pytest.mark.parametrize(
    ("words", "how", "told"),
    [
        (USUAL, {}, ""),
        ("grid=6x4 rate_hz=50", {}, "give grid=4x6"),
        ("grid=4x6 rate_hz=5000", {}, "check rate_hz=5000"),
        ("grid=4x6 rate_hz=0.5", {}, "check rate_hz=0.5"),
        (USUAL, {"levels": lambda v: v // 4}, "give full_scale=255"),
        (USUAL, {"levels": lambda v: v // 4 * 4}, "multiples of 4"),
        (USUAL, {"levels": lambda v: 1023 - v}, "pressed at rest"),
        (USUAL, {"change": renamed("gesture", "tap", "Tap ")}, "'Tap' and 'tap'"),
        (USUAL, {"change": renamed("gesture", "hold", "holt", count=1)}, "if it is 'hold'"),
    ],
)
def test_what_captures_contradict_is_told_on_import(words, how, told, capsys):
    assert main([*recorded(**how), *words.split()]) == 0
    err = capsys.readouterr().err
    assert told in err and err.count("\n") == bool(told)


def test_a_name_in_two_encodings_is_one_person(capsys):
    whole, half = (
        renamed("subject", "anna", "Jos\xe9", 5),
        renamed("subject", "anna", "Jose\u0301", 2),
    )
    assert main([*recorded(lambda table: whole(half(table))), *USUAL.split()]) == 0
    told = capsys.readouterr()
    assert "4 subjects" in told.out and "spelt in parts" in told.err


def test_tables_as_programs_write_them_are_the_same_corpus(capsys):
    """Also the table that is exported."""
    digests = []
    for how in (
        {},
        {"sep": ";"},
        {"sep": "\t"},
        {"change": lambda t: t.assign(frame=t["frame"] * 1.0)},
    ):
        assert main([*recorded(**how), *USUAL.split()]) == 0
        digests.append(capsys.readouterr().out.partition("digest ")[2][:16])
    assert main(["data", "export", "rec", "back.parquet"]) == 0
    *_, line = capsys.readouterr().out.splitlines()
    assert main(shlex.split(line.removeprefix("next: bench "))) == 0
    digests.append(capsys.readouterr().out.partition("digest ")[2][:16])
    assert len({*digests}) == 1


@pytest.mark.parametrize(("rows", "code"), [("X", 0), ("X[:1]", 1)])
def test_a_function_from_captures_to_rows_is_a_feature_set(rows, code, capsys):
    text = f"def peaks(X, power=1):\n    return [[c.max() ** power, c.mean()] for c in {rows}]\n"
    Path("feat.py").write_text(text)
    assert (
        main(["run", *SMALL, "model=bayes", "features=feat.py:peaks", "features.power=2"]) == code
    )
    told = capsys.readouterr()
    assert "peaks[power=2]" in told.out + told.err and (
        "1 rows for" in told.out + told.err
    ) == bool(code)


def test_a_check_that_comes_to_no_verdict_leaves_no_green_file(capsys):
    good = "from sklearn.tree import DecisionTreeClassifier as Tree\ndef tree():\n    return Tree(random_state=0)\n"
    Path("my.py").write_text(good)
    check = ["check", "baseline=b.json", "junit=check.xml"]
    assert main([*check, "update=yes", *ON, "model=my.py:tree"]) == main(check) == 0
    assert 'failures="0" errors="0"' in Path("check.xml").read_text()
    Path("bad.json").write_text("<<<<<<< HEAD")
    assert main(["check", "baseline=bad.json", "junit=check.xml"]) == 2
    assert 'errors="1"' in (told := Path("check.xml").read_text()) and "damaged" in told
    Path("my.py").write_text(good.replace("random_state=0", "max_depth=-1"))
    assert main(check) == 1
    assert (
        'errors="1"' in (told := Path("check.xml").read_text()) and "InvalidParameterError" in told
    )
    Path("b.json").write_bytes(b"\xef\xbb\xbf" + Path("b.json").read_bytes())
    Path("my.py").write_text(good)
    assert main(check) == 0
