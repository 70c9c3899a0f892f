"""Submissions that strangers may send: each is refused in one line, and the page escapes the others."""

import json
import os
import re
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.board import submissions
from bench.cli import main
from bench.errors import InputError
from tests.board.submitted import ABOUT, CHALLENGE, folder_of

RIGHT = CHALLENGE[["capture"]].assign(predicted=CHALLENGE["true"])
PROBA = CHALLENGE[["capture"]].assign(**{f"p_{c}": 1 / 7 for c in sorted(set(CHALLENGE["true"]))})
COLUMNS = {"capture": CHALLENGE["capture"].tolist(), "predicted": CHALLENGE["true"].tolist()}
TABLES = {
    "a row too few": (RIGHT.iloc[1:], "251 rows"),
    "a row twice": (pd.concat([RIGHT.iloc[1:], RIGHT.iloc[-1:]]), "capture 828"),
    "a strange row": (RIGHT.assign(capture=["9999", *RIGHT["capture"][1:]]), "capture 578"),
    "a strange label": (RIGHT.assign(predicted="<script>"), "'<script>'"),
    "an empty label": (RIGHT.assign(predicted=""), "predicted is ''"),
    "no labels": (RIGHT.drop(columns="predicted"), "predicted"),
    "another truth": (RIGHT.assign(true="pat"), "true of capture 578"),
    "a class without probabilities": (PROBA.drop(columns="p_pat"), "p_pat"),
    "labels and probabilities": (PROBA.assign(predicted=RIGHT["predicted"]), "predicted, or"),
    "infinity": (PROBA.assign(p_pat=np.inf), "0 to 1"),
    "a wrong sum": (PROBA.assign(p_pat=0.9), "1.76"),
}
FIELDS = [
    ({"task": "haart-loso-v2"}, "haart-loso-v1"),
    ({"task": None}, "task is missing"),
    ({"who": ""}, "who is missing"),
    ({"who": "touchbench"}, "only the results of touchbench"),
    ({"system": "x" * 201}, "200"),
    ({"system": "r\u0435flex"}, "'r\\u0435flex'"),
    ({"date": "yesterday"}, "'yesterday'"),
    ({"date": "2026-W05-6"}, "'2026-W05-6'"),
    ({"date": "9999-12-31"}, "date is 9999-12-31, which is in the future"),
    ({"parameters": -1}, "parameters"),
    ({"accuracy": 99.9}, "'accuracy'"),
    ({"digest": "0" * 64}, "haart-challenge-v1"),
    ({"versions": {"numpy": 2}}, "'numpy'"),
]


def parquet(folder, table):
    """A submission with this table in place of its CSV file."""
    (folder / "predictions.csv").unlink()
    pq.write_table(pa.table(table), folder / "predictions.parquet", compression="zstd")


def cut(folder):
    parquet(folder, COLUMNS)
    path = folder / "predictions.parquet"
    path.write_bytes(path.read_bytes()[:-20])


def link(folder):
    path = folder / "predictions.csv"
    path.rename("elsewhere.csv")
    path.symlink_to(Path("elsewhere.csv").absolute())


def pipe(folder):
    (folder / "predictions.csv").unlink()
    os.mkfifo(folder / "predictions.csv")


def content(folder, *, name, data):
    (folder / name).write_bytes(data)


def packed(rows):
    """One row, repeated so often that it is much larger in memory than packed."""
    zeros = pa.array(np.zeros(rows, np.int8))
    return {
        name: pa.DictionaryArray.from_arrays(zeros, [word]) for name, word in (("capture", "1"), ("predicted", "pat"))
    }


csv = partial(content, name="predictions.csv")
description = partial(content, name="submission.json")
CSV = RIGHT.to_csv(index=False)
DAMAGE = {
    "both tables": (lambda folder: content(folder, name="predictions.parquet", data=b""), "2 of"),
    "link": (link, "predictions.csv"),
    "pipe": (pipe, "predictions.csv"),
    "huge": (partial(csv, data=b"0" * (8 << 20) + b"0"), "8388609"),
    "deep": (partial(description, data=b"[" * 60000), "JSON"),
    "bytes below the header": (partial(csv, data=CSV.encode() + b"\xff\xfe"), "utf-8"),
    "a header of a million columns": (partial(csv, data=b"," * (1 << 20) + b"\n"), "line 1"),
    "a row too many in parquet": (partial(parquet, table={k: [*v, v[0]] for k, v in COLUMNS.items()}), "252 rows"),
    "a row repeated": (partial(parquet, table=packed(2_000_000)), "MiB"),
    "cut parquet": (cut, "parquet"),
    "nested": (partial(parquet, table=COLUMNS | {"predicted": [["pat"]] * len(RIGHT)}), "pat"),
    "no label": (partial(parquet, table=COLUMNS | {"predicted": [None, *COLUMNS["predicted"][1:]]}), "predicted is"),
}
DAMAGE |= {name: (partial(csv, data=rows.to_csv(index=False).encode()), fact) for name, (rows, fact) in TABLES.items()}
for fields, fact in FIELDS:
    kept = {k: v for k, v in (ABOUT | fields).items() if v is not None}
    DAMAGE[f"{ascii(fields)[:60]}"] = (partial(description, data=json.dumps(kept).encode()), fact)


@pytest.mark.parametrize(("damage", "fact"), DAMAGE.values(), ids=DAMAGE)
def test_each_is_refused_in_one_line(damage, fact):
    folder = folder_of("wrong")
    assert len(submissions.read(folder).table) == len(CHALLENGE)
    damage(folder)
    with pytest.raises(InputError) as refused:
        submissions.read(folder)
    line = str(refused.value)
    assert line.startswith("wrong: ") and fact in line and line.isprintable() and len(line) < 400


def test_names_are_text_links_are_not_followed_and_the_others_are_shown(capsys):
    folder_of("wrong", RIGHT.assign(predicted="<script>"))
    folder_of("<img src=x onerror=alert(1)>", command="</code><script>alert(1)</script>")
    folder_of("outside")
    Path("all/outside").rename("outside")
    Path("all/link").symlink_to(Path("outside").absolute())
    folder_of(".hidden")
    assert main(["leaderboard", "all"]) == 1
    out, err = capsys.readouterr()
    assert [line.split(":")[1] for line in err.splitlines()] == [" link", " wrong"]
    text = Path("leaderboard.html").read_text()
    assert "&lt;/code&gt;&lt;script&gt;alert(1)" in text and "Left out: " in text
    assert '<th scope="row">mine</th>' in text and "<script>" not in re.sub("<script>\n.*", "", text)
