"""Submissions that strangers may send: each ends in a line and is left out."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.cli import main
from tests.reports.submitted import ABOUT, CHALLENGE, folder_of

RIGHT = CHALLENGE[["capture"]].assign(predicted=CHALLENGE["true"])
PROBA = CHALLENGE[["capture"]].assign(**{f"p_{c}": 1 / 7 for c in sorted(set(CHALLENGE["true"]))})


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (RIGHT.iloc[1:], "there are not 251 rows"),
        (pd.concat([RIGHT.iloc[1:], RIGHT.iloc[-1:]]), "capture 828 is there twice"),
        (RIGHT.assign(capture=["9999", *RIGHT["capture"][1:]]), "capture 578 is missing"),
        (RIGHT.assign(predicted="<script>"), "'<script>', not one of constant"),
        (RIGHT.assign(accuracy=1.0), "column 'accuracy' is not one of"),
        (RIGHT.drop(columns="predicted"), "give a column predicted"),
        (RIGHT.drop(columns="capture"), "column capture is missing"),
        (RIGHT.assign(true="pat"), "capture 578 is "),
        (PROBA.drop(columns="p_pat"), "one for every class"),
        (PROBA.assign(p_pat=np.nan), "a probability is no"),
        (PROBA.assign(p_pat=np.inf), "not a number from 0 to 1"),
        (PROBA.assign(p_pat=-0.5), "not a number from 0 to 1"),
        (PROBA.assign(p_pat=0.9), "add up to 1.76, not to 1"),
        (PROBA.assign(p_pat="=HYPERLINK()"), "a probability is no number"),
        (pd.concat([PROBA, RIGHT[["predicted"]]], axis=1), "give a column predicted, or"),
    ],
)
def test_a_wrong_table_is_left_out_with_a_line(table, said, capsys):
    folder_of("wrong", table)
    folder_of("good")
    assert main(["leaderboard", "all"]) == 1
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert line.startswith("left out: wrong: ") and said in line
    assert "haart-challenge-v1: mine by A. Name, 100.0 % of 251 captures, not verified" in out
    text = Path("leaderboard.html").read_text()
    assert (
        '<th scope="row">mine</th>' in text
        and "Left out: wrong" in text
        and "<script>" not in re.sub("<script>\n.*", "", text)
    )


@pytest.mark.parametrize(
    ("about", "said"),
    [
        ({"task": "haart-loso-v2"}, "did you mean haart-loso-v1"),
        ({"task": 3}, "'task' is not one line"),
        ({"task": None}, "task is missing"),
        ({"who": ""}, "who is missing"),
        ({"who": "a\u202eb"}, "'who' is not one line of at most 60 visible characters"),
        ({"system": "x" * 201}, "'system' is not one line"),
        ({"date": "yesterday"}, "not a day such as 2026-01-31"),
        ({"parameters": "many"}, "parameters is not a number"),
        ({"parameters": -1}, "parameters is not a number"),
        ({"flash_bytes": True}, "flash_bytes is not a number"),
        ({"accuracy": 99.9}, "no key is called 'accuracy'"),
        ({"digest": "0" * 64}, "digest 0000000000000000 is not that of haart-challenge-v1"),
        ({"versions": {"numpy": 2}}, "'numpy' is not one line"),
        ({"versions": []}, "versions is no object"),
        ({"system": "  "}, "system is '  '; write ASCII letters (ue for"),
        ({"who": "A  Name"}, "who is 'A  Name'; write ASCII"),
        ({"who": " A. Name"}, "who is ' A. Name'"),
        ({"who": "?!"}, "who is '?!'"),
        ({"who": "J. M\u00fcller"}, "who is 'J. M\\xfcller'; write ASCII"),
        ({"who": "x" * 61}, "at most 60 visible characters"),
        ({"system": "r\u0435flex"}, "system is 'r\\u0435flex'; write ASCII"),
        ({"system": "re\u200bflex"}, "'system' is not one line"),
        ({"who": "touchbench"}, "who is 'touchbench'; only the results in reports/reference may use this name"),
        ({"who": "The Touch-Bench team"}, "only the results in reports/reference"),
        ({"batch": "no"}, "batch is 'no'; write 'yes' or leave it out"),
        ({"conditions": 3}, "'conditions' is not one line"),
    ],
)
def test_a_wrong_description_is_left_out(about, said, capsys):
    folder_of("wrong", **about)
    assert main(["leaderboard", "all/wrong", "out=page.html"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("left out: wrong: ") and said in line


def damaged(folder, how):
    about, table = folder / "submission.json", folder / "predictions.csv"
    match how:
        case "no table":
            table.unlink()
        case "both tables":
            RIGHT.to_parquet(folder / "predictions.parquet")
        case "link":
            table.rename("elsewhere.csv")
            table.symlink_to(Path("elsewhere.csv").absolute())
        case "pipe":
            table.unlink()
            os.mkfifo(table)
        case "folder":
            about.unlink()
            about.mkdir()
        case "huge":
            with table.open("r+b") as f:
                f.truncate(9 << 20)
        case "huge description":
            about.write_text(" " * (65 << 10) + about.read_text())
        case "deep":
            about.write_text("[" * 60000)
        case "nan":
            about.write_text(json.dumps(ABOUT | {"parameters": float("nan")}))
        case "list":
            about.write_text("[]")
        case "bytes":
            table.write_bytes(b"\xff\x00" * 1000)
        case "one line":
            table.write_text("," * (1 << 20) + "\n")
        case "parquet of rows":  # one long row repeated, which is small packed
            table.unlink()
            rows = pa.table(
                {"capture": pa.array(["1"] * 10_000_000).dictionary_encode(), "predicted": ["pat"] * 10_000_000}
            )
            pq.write_table(rows, folder / "predictions.parquet", compression="zstd")
        case "cut parquet":
            table.unlink()
            RIGHT.to_parquet(folder / "predictions.parquet")
            content = (folder / "predictions.parquet").read_bytes()
            (folder / "predictions.parquet").write_bytes(content[:-20])
        case "null" | "bytes as a label" | "bytes as a capture" | "bytes as truth":
            table.unlink()
            labels = CHALLENGE["true"].tolist()
            columns = {"capture": CHALLENGE["capture"].tolist(), "predicted": labels, "true": labels}
            name = {"bytes as a capture": "capture", "bytes as truth": "true"}.get(how, "predicted")
            rest = columns[name][1:]
            columns[name] = [None, *rest] if how == "null" else [b"\xff\xfe", *(word.encode() for word in rest)]
            pq.write_table(pa.table(columns), folder / "predictions.parquet")
        case "a cell too many":
            table.write_text(table.read_text().replace("\n578,", "\n578,x,", 1))
        case "nested":
            table.unlink()
            nested = pa.table({"capture": RIGHT["capture"].tolist(), "predicted": [["pat"]] * len(RIGHT)})
            pq.write_table(nested, folder / "predictions.parquet")


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("no table", "holds 0 of"),
        ("both tables", "holds 2 of"),
        ("link", "predictions.csv is not a plain file"),
        ("pipe", "predictions.csv is not a plain file"),
        ("folder", "submission.json is not a plain file"),
        ("huge", "at most 8388608 are read"),
        ("huge description", "at most 65536 are read"),
        ("deep", "not JSON"),
        ("nan", "NaN is no number"),
        ("list", "not a JSON object"),
        ("bytes", "cannot be read as a table"),
        ("one line", "its first line is no header"),
        ("parquet of rows", ""),
        ("cut parquet", "not a readable parquet file"),
        ("nested", ""),
        ("null", "predicted holds an empty cell"),
        ("bytes as a label", "predicted is not text"),
        ("bytes as a capture", "capture is not text"),
        ("bytes as truth", "true is not text"),
        ("a cell too many", "cannot be read as a table"),
    ],
)
def test_hostile_folders_are_left_out_with_a_line(how, said, capsys):
    damaged(folder_of("wrong"), how)
    folder_of("good")
    assert main(["leaderboard", "all"]) == 1
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert line.startswith("left out: wrong: ") and said in line and len(line) < 400
    assert "haart-challenge-v1: mine by A. Name, 100.0 %" in out


def test_names_are_text_and_links_are_not_followed(capsys):
    folder_of("<img src=x onerror=alert(1)>", command="</code><script>alert(1)</script>")
    folder_of("outside")
    Path("all/outside").rename("outside")
    Path("all/link").symlink_to(Path("outside").absolute())
    folder_of(".hidden")
    assert main(["leaderboard", "all"]) == 1
    assert capsys.readouterr().err.splitlines() == ["left out: link: is a link, not a folder"]
    text = Path("leaderboard.html").read_text()
    assert "&lt;/code&gt;&lt;script&gt;alert(1)" in text and "alert(1)</script>" not in text
