"""``bench build`` with a design of the skin, and what goes on with its folder."""

import json
import re
from pathlib import Path

import pytest

from addons.builder.tests.test_build import BUILD, TOOLS, few_tests, write_skin  # noqa: F401
from bench.cli import main
from bench.corpora.read.table import write_table
from bench.corpora.skin import Design
from bench.running.saved import load_recogniser
from touchbench_builder import check

pytestmark = pytest.mark.skipif(bool(TOOLS), reason=f"{', '.join(TOOLS)} not installed")
DESIGN = ["skin.grid=2x2", "skin.rate_hz=40", "skin.bits=6", "skin.range=auto"]


def test_a_build_for_a_design_is_checked_and_used_on_recorded_captures(capsys, monkeypatch):
    corpus = write_skin()
    assert main([*BUILD, *DESIGN, "watch=no"]) == 0
    facts = json.loads(Path("robot/certificate.json").read_text())
    data, header = facts["data"], Path("robot/touch.h").read_text()
    assert (data["grid"], data["rate_hz"]) == ([2, 2], 40)
    assert data["recorded"] == {
        "digest": data["recorded"]["digest"],
        "grid": [4, 4],
        "rate_hz": 100,
        "whole": True,
    }
    learned = data["skin"]["skin.range"]
    assert re.fullmatch(r"\d+-\d+", learned) and data["skin"]["skin.grid"] == "2x2"
    assert "int skin_skin(skin_skin_t *s" in header and "frame[0]: 1, 2, 5, 6" in header
    model = load_recogniser(facts["system"]["model"])
    assert model.design == Design("2x2", 40.0, 6, learned)

    monkeypatch.setattr(check, "capture_digests", lambda corpus: [""] * len(corpus))
    write_skin(6, seed=1, name="new.csv")
    assert main(["data", "import", "table", "new.csv", "name=new", *BUILD[2:5]]) == 0
    assert main(["build", "check", "robot", "data=new"]) in (0, 1)
    assert "in C" in capsys.readouterr().out

    one = corpus[corpus.subjects == corpus.subjects[0]]
    labels = model.label(model.design.convert(one))["label"]
    write_table(one, Path("one.csv"))
    address = facts["system"]["model"]
    assert main(["predict", address, "one.csv", "skin=recorded", "out=labels.csv"]) == 0
    told = [line.split(",")[1] for line in Path("labels.csv").read_text().splitlines()[1:]]
    assert told == [*labels]
    assert main(["predict", address, "one.csv"]) == 2
    system = ["data=skin", "model=lda", "features=jung28", "stopping=no"]
    assert main(["fit", *system, *DESIGN, "out=rec"]) == 0
    assert main(["adapt", "rec", "one.csv", "skin=recorded", "out=own", "anyway=yes"]) == 0
    assert load_recogniser("own").design == load_recogniser("rec").design == model.design
