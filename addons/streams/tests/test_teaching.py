"""A detector that is saved with its system, and what C makes of it: what is measured, and named."""

import io
import json
import pickle

import numpy as np
import pytest

import bench
from addons.chip.tests.compiled import describe_missing
from addons.chip.tests.test_chip import WATCHED
from addons.streams.tests.people import import_day
from bench.cli import main
from bench.running.saved import FORMAT, load_recogniser
from bench.store.client import connect
from tests.conftest import runs
from touchbench_chip.circumstance import InC
from touchbench_chip.write import write_c_sources


def test_a_saved_model_watches_with_the_detector_that_was_asked_for_in_its_format(golden):
    """For other attributes, raise `bench.running.saved.FORMAT` and write its golden file."""
    import_day()
    given = {"detector": "frames", "detector.wait": 0.5, "false_alarms": 40, "model.window": 0.5}
    fitted = bench.fit(data="day", model="lda", features="touch", out="rec", **given)
    params = connect().client.get_run(fitted.run_id).data.params
    assert (params["watch.detector"], params["watch.false_alarms"]) == ("frames[wait=0.5]", "40")
    recogniser, kept = load_recogniser("rec"), fitted.recogniser
    assert recogniser.watcher.detector.wait == 0.5
    assert json.dumps(recogniser.watcher.chosen) == json.dumps(kept.watcher.chosen)
    assert "int touch_watch(" in write_c_sources(recogniser, 32, "")["touch.c"]
    stream = recogniser.watcher.open_stream(
        recogniser.grid, recogniser.rate_hz, recogniser.full_scale
    )
    assert all(stream.push(np.zeros(recogniser.grid, np.float32)) == [] for _ in range(100))
    names = sorted(Attributes(kept).names.items())
    golden(
        f"saved_{FORMAT}_frames.txt",
        "".join(f"{kind}: {', '.join(sorted(each))}\n" for kind, each in names),
    )


class Attributes(pickle.Pickler):
    """Names of attributes inside an object, by class; with shapes of a detector's arrays."""

    def __init__(self, thing):
        super().__init__(io.BytesIO())
        self.names = {}
        self.dump(thing)

    def reducer_override(self, one):
        kind = f"{type(one).__module__}.{type(one).__qualname__}"
        if kind.startswith(("bench.", "touchbench_streams.")):
            own = kind.startswith("touchbench_streams.")
            shapes = {
                n: f"{n}{v.shape}" if own and isinstance(v, np.ndarray) else n
                for n, v in vars(one).items()
            }
            self.names[kind] = self.names.get(kind, set()) | {*shapes.values()}
        return NotImplemented


def test_a_detector_without_c_is_not_exported(tmp_path, capsys):
    import_day()
    (tmp_path / "my.py").write_text(
        "from touchbench_streams.detectors.threshold import Threshold\n"
        "class Mine(Threshold): pass\n"
    )
    words = "data=day model=lda features=touch model.window=0.5 stopping=no out=rec".split()
    words.append("detector=my.py:Mine")
    assert main(["fit", *words]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"detector={tmp_path / 'my.py'}:Mine finds touches in a stream" in lines
    assert "next: bench predict rec new.csv" in lines
    assert main(["export", "rec", "out=rec_c"]) == 2
    assert "detector=mine has no C; use frames or threshold" in capsys.readouterr().err


@pytest.mark.skipif(bool(describe_missing("cc")), reason=describe_missing("cc"))
def test_watching_is_measured_where_captures_can_teach_it(costs, monkeypatch, capsys):
    words = [
        "run",
        "form=c",
        "model=lda",
        "bits=8",
        "features=touch",
        "model.window=1",
        "data.variants=normal",
    ]
    words += ["where=gesture in ('pat', 'press', 'rub')", "data.subjects=3", "data.rate_hz=20"]
    assert main([*words, "data.repetitions=1"]) == 0
    assert (
        "not measured: background=quiet: no capture of synth begins or ends with 0.25 s"
        in capsys.readouterr().err
    )
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)
    monkeypatch.setattr(
        "touchbench_streams.teaching.default_background", lambda corpus, background: "press"
    )
    assert main([*words, "data.repetitions=2", "detector=threshold"]) == 0
    printed = capsys.readouterr()
    assert "not measured" not in printed.err
    table = printed.out.partition("touch_watch")[2].replace("│", " ")
    assert " ".join(table.split()).count("8 threshold 31.0 15.0 420 110,000 260,000 1,200,000") == 1
    unmeasured, measured = runs("cell")[1]
    assert {name: measured.data.metrics[name] for name in WATCHED} == WATCHED
    assert (
        measured.data.metrics["chip_watch_defined"] == 2
    )  # gestures without press, the background
    assert not {*unmeasured.data.metrics} & {*WATCHED}


def test_detectors_are_named_with_their_parameters():
    each = InC.from_typed(
        {"form": "c", "bits": "8", "detector": "frames", "detector.wait": "0.5,0.7"}
    )
    assert [(one.bits, one.detector) for one in each] == [
        ("8", "frames[wait=0.5]"),
        ("8", "frames"),
    ]
    assert each[0].typed_arguments() == {
        "form": "c",
        "bits": "8",
        "detector": "frames",
        "detector.wait": "0.5",
    }
    assert InC.from_typed({"form": "c"})[0].detector == ""
