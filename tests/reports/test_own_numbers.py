"""Published numbers of the user's own: beside his runs, marked, in tables, page and bundle."""

from pathlib import Path

import pandas as pd
import pytest

import bench
from bench.cli import main
from bench.reports.own_numbers import OWN_NUMBER, load_numbers
from tests.reading.results import predictions_with_hits
from tests.reports.store import tracked_run

HEAD = "system,data,protocol,accuracy,reference,unit,sd\n"
OURS = {"data": "haart", "synthetic": "false", "protocol": "challenge"}


def test_own_numbers_stand_beside_the_runs_of_their_system_and_are_marked(store, quick, capsys):
    """A number without a run is listed, too; the bundle has them without the file."""
    tracked_run(store, "Mine · shape", predictions_with_hits([9, 14, 18, 11]), **OURS)
    lines = [
        "Mine · shape,haart,challenge,71.25,Doe 2024,subject mean,4.5",
        "Net,haart,loso,66,Doe 2023,,",
    ]
    Path("mine.csv").write_text(HEAD + "\n".join(lines) + "\n")
    report = ["report", "paper=accuracy,published", "published=mine.csv", "bundle=paper.zip"]
    assert main(report) == 0
    table = pd.read_csv("report/published.csv")
    row = table[table["confidence"] == OWN_NUMBER].reset_index()
    assert row["published"].tolist() == [71.25, 66] and row["ours"][0] == pytest.approx(65)
    assert row["reference"].tolist() == ["Doe 2024 (own number)", "Doe 2023 (own number)"]
    assert row["verdict"].tolist() == ["no interval", "not run"]
    assert row["published_sd"].tolist()[0] == 4.5
    page = Path("report/index.html").read_text()
    assert "74 from papers and 2 of your own, beside ours" in page
    assert "Doe 2024 (own number): Mine · shape" in page
    tex = Path("report/paper.tex").read_text()
    assert "& 71.25 " in tex and "71.25 (subject mean, own number 1: Doe 2024)" in tex
    assert bench.latex(bench.runs(), ["accuracy", "published"], "mine.csv") == tex
    Path("mine.csv").unlink()
    assert main(["report", "from=paper.zip", "out=again"]) == 0
    for name in ("index.html", "paper.tex", "published.csv"):
        assert (Path("again") / name).read_bytes() == (Path("report") / name).read_bytes()


@pytest.mark.parametrize(
    ("text", "fact"),
    [
        ("system,data\na,haart\n", "published=mine.csv: no column"),
        (HEAD + "a,haart,loso,71 %,Doe,,\n", "line 2: accuracy is '71 %'; give percent"),
        (HEAD + "a,haart,loso,0.7,Doe,,x\n", "line 2: sd is 'x'"),
        (HEAD + "a,haart,loso,170,Doe,,\n", "line 2: accuracy is '170'"),
        (HEAD + "a,haart,loso,71,,,\n", "line 2: reference is empty"),
        (HEAD + "a,haart,loso,71,Doe,captures,\n", "did you mean capture"),
        ('\0"', "published=mine.csv: "),
    ],
)
def test_what_is_no_number_is_refused_by_its_line(tmp_path, text, fact):
    path = tmp_path / "mine.csv"
    path.write_text(text)
    with pytest.raises(bench.InputError, match=fact.replace("?", ".")):
        load_numbers(path)
