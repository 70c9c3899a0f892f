"""What is doubtful in an imported table, and the forms in which programs write the same table."""

import shlex

import numpy as np
import pandas as pd
import pytest

from bench.cli import main

USUAL = "grid=4x6 rate_hz=50"


def write_recording(change=lambda table: table, levels=lambda values: values, **how):
    """Write a table of four people who tap and hold a skin of 4 x 6 taxels; the words to import it.

    Neighbours move together.
    """
    rng, rows = np.random.default_rng(0), []
    names = ("anna", "ben", "carla", "dora")
    for subject, gesture, take in (
        (s, g, k) for s in names for g in ("tap", "hold") for k in range(5)
    ):
        noise = np.pad(rng.normal(0, 60, (30, 4, 6)), ((0, 0), (1, 1), (1, 1)))
        near = sum(noise[:, i : i + 4, j : j + 6] for i in range(3) for j in range(3))
        readings = np.clip(200 + near + 100 * (gesture == "hold"), 0, 1023).round().astype(int)
        frames = levels(readings).reshape(30, 24)
        rows += [(subject, gesture, take, i, *frame) for i, frame in enumerate(frames)]
    columns = ["subject", "gesture", "take", "frame", *(f"ch{i}" for i in range(1, 25))]
    change(pd.DataFrame(rows, columns=columns)).to_csv("rec.csv", index=False, **how)
    return ["data", "import", "table", "rec.csv", "name=rec"]


def renamed(column, name, other, takes=1, people=("anna", "ben")):
    """A change of a name in some takes of some people."""

    def change(table):
        rows = (table[column] == name) & (table["take"] < takes) & table["subject"].isin(people)
        return table.assign(**{column: table[column].mask(rows, other)})

    return change


@pytest.mark.parametrize(
    ("words", "how", "message"),
    [
        (USUAL, {}, ""),
        ("grid=6x4 rate_hz=50", {}, "give grid=4x6"),
        ("grid=4x6 rate_hz=5000", {}, "check rate_hz=5000"),
        ("grid=4x6 rate_hz=0.5", {}, "check rate_hz=0.5"),
        (USUAL, {"levels": lambda v: v // 4}, "give full_scale=255"),
        (USUAL, {"levels": lambda v: v // 4 * 4}, "multiples of 4"),
        (USUAL, {"levels": lambda v: 1023 - v}, "pressed at rest"),
        (USUAL, {"change": renamed("gesture", "tap", "Tap ")}, "'Tap' (2x) and 'tap' (18x)"),
        (USUAL, {"change": renamed("subject", "anna", "[Anna]")}, "'[Anna]' (2x) and 'anna' (8x)"),
        (USUAL, {"change": renamed("gesture", "hold", "holt", 1, ["anna"])}, "if it is 'hold'"),
    ],
)
def test_what_captures_contradict_is_reported_on_import(words, how, message, capsys):
    assert main([*write_recording(**how), *words.split()]) == 0
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == bool(message)


@pytest.mark.parametrize(
    ("relation", "statistic"),
    [("mean", lambda v: v.mean(axis=1) // 1), ("maximum", lambda v: v.max(axis=1))],
)
def test_a_statistic_in_place_of_the_last_taxel_is_named(relation, statistic, capsys):
    def change(table):
        readings = table.filter(regex="^ch").iloc[:, :-1]
        return table.assign(ch24=statistic(readings))

    assert main([*write_recording(change), *USUAL.split()]) == 0
    assert f"taxel 24 of 24 is always the {relation} of those" in capsys.readouterr().err


def test_a_name_in_two_encodings_is_one_person(capsys):
    whole = renamed("subject", "anna", "Jos\xe9", 5)
    half = renamed("subject", "anna", "Jose\u0301", 2)
    assert main([*write_recording(lambda table: whole(half(table))), *USUAL.split()]) == 0
    output = capsys.readouterr()
    assert "4 subjects" in output.out and "spelt in parts" in output.err


def test_tables_as_programs_write_them_are_the_same_corpus(capsys):
    """Also the table that is exported."""
    float_frames = {"change": lambda table: table.assign(frame=table["frame"] * 1.0)}
    digests = set()
    for how in ({}, {"sep": ";"}, {"sep": "\t"}, float_frames):
        assert main([*write_recording(**how), *USUAL.split()]) == 0
        digests.add(capsys.readouterr().out.partition("digest ")[2][:16])
    assert main(["data", "export", "rec", "back.parquet"]) == 0
    *_, line = capsys.readouterr().out.splitlines()
    assert main(shlex.split(line.removeprefix("next: bench "))) == 0
    digests.add(capsys.readouterr().out.partition("digest ")[2][:16])
    assert len(digests) == 1
