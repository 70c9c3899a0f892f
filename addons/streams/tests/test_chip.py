"""A system that watches as C: what is measured, and named."""

import pytest

from addons.chip.tests.compiled import lacking
from addons.chip.tests.test_chip import WATCHED
from bench.cli import main
from bench.errors import InputError
from tests.conftest import runs
from touchbench_chip.circumstance import InC


@pytest.mark.skipif(bool(lacking("cc")), reason=lacking("cc"))
def test_watching_is_measured_where_captures_can_teach_it(costs, monkeypatch, capsys):
    words = ["run", "form=c", "model=lda", "bits=8", "features=touch", "model.window=1", "data.variants=normal"]
    assert main([*words, "data.subjects=3", "data.repetitions=1", "data.rate_hz=20"]) == 0
    assert "not measured: background=quiet: no capture of synth begins or ends with 0.25 s" in capsys.readouterr().err
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)
    monkeypatch.setattr("touchbench_streams.teaching.usual", lambda corpus, background: "press")
    assert main([*words, "data.subjects=3", "data.repetitions=2", "data.rate_hz=20", "detector=frames"]) == 0
    printed = capsys.readouterr()
    assert "not measured" not in printed.err
    table = printed.out.partition("touch_watch")[2].replace("│", " ")
    assert " ".join(table.split()).count("8 frames 31.0 15.0 420 110,000 260,000 1,200,000") == 1
    unmeasured, measured = runs("cell")[1]
    assert {name: measured.data.metrics[name] for name in WATCHED} == WATCHED
    assert measured.data.metrics["chip_watch_defined"] == 13  # gestures without press, the background
    assert not {*unmeasured.data.metrics} & {*WATCHED}


def test_detectors_are_named_with_their_parameters():
    each = InC.of({"form": "c", "bits": "8", "detector": "frames", "detector.wait": "0.5,0.7"})
    assert [(one.bits, one.detector) for one in each] == [("8", "frames[wait=0.5]"), ("8", "frames")]
    assert each[0].arguments() == {"form": "c", "bits": "8", "detector": "frames", "detector.wait": "0.5"}
    assert InC.of({"form": "c"})[0].detector == ""
    with pytest.raises(InputError, match="wiat"):
        InC.of({"form": "c", "detector": "frames", "detector.wiat": "0.5"})
