"""A detector that is saved with its system, and what C makes of it."""

import json
from pathlib import Path

import numpy as np
import pytest

import bench
from addons.streams.tests.test_background import PEOPLE, stored
from bench.cli import main
from bench.errors import InputError
from bench.store import connect
from bench.work.saved import FORMAT, load
from touchbench_chip.write import files_of
from touchbench_streams.teaching import Watching

GIVEN = {"detector": "frames", "detector.wait": 0.5, "false_alarms": 40}


@pytest.fixture
def day():
    stored("day", PEOPLE.corpus.frames, PEOPLE.frame_labels(), np.repeat(PEOPLE.subjects, PEOPLE.corpus.lengths))


@pytest.mark.usefixtures("day")
def test_a_saved_model_watches_with_the_detector_that_was_asked_for(tmp_path):
    words = {
        "data": "day",
        "model": "lda",
        "features": "touch",
        "model.window": 0.5,
        "stopping": False,
        "out": str(tmp_path / "rec"),
    }
    fitted = bench.fit(**words, **GIVEN)
    params = connect().client.get_run(fitted.run_id).data.params
    assert (params["watch.detector"], params["watch.false_alarms"]) == ("frames[wait=0.5]", "40")
    recogniser = load(str(tmp_path / "rec"))
    watcher, kept = recogniser.watcher, fitted.recogniser.watcher
    assert watcher.detector.wait == 0.5
    assert json.dumps(watcher.chosen) == json.dumps(kept.chosen)
    assert "int touch_watch(" in files_of(recogniser, 32, "")["touch.c"]
    stream = watcher.stream(recogniser.grid, recogniser.rate_hz, recogniser.full_scale)
    assert all(stream.push(np.zeros(recogniser.grid, np.float32)) == [] for _ in range(100))


@pytest.mark.usefixtures("day")
def test_models_are_of_another_format_when_their_objects_change():
    """The golden file of a format stays as it is: raise `bench.work.saved.FORMAT` and write that of the new one."""
    recogniser = bench.fit(data="day", model="lda", features="touch", detector="frames").recogniser
    text = "".join(f"{name}: {', '.join(sorted(kept))}\n" for name, kept in sorted(attributes(recogniser).items()))
    golden = Path(__file__).parent / f"golden/saved_{FORMAT}_frames.txt"
    assert text == golden.read_text()


def attributes(thing):
    """Names of the attributes of touchbench's objects in an object, by class; with shapes of a detector's arrays."""
    names, stack, done = {}, [thing], []
    while stack:
        one = stack.pop()
        if any(one is other for other in done) or isinstance(one, (np.ndarray, str, type)):
            continue
        done.append(one)
        if isinstance(one, (list, tuple, set)):
            stack += one
        elif isinstance(one, dict):
            stack += one.values()
        elif hasattr(one, "__dict__") and not callable(getattr(one, "__get__", None)):
            stack += vars(one).values()
            if type(one).__module__.startswith(("bench.", "touchbench_streams.")):
                kind = f"{type(one).__module__}.{type(one).__qualname__}"
                own = kind.startswith("touchbench_streams.")
                shapes = {n: f"{n}{v.shape}" if own and isinstance(v, np.ndarray) else n for n, v in vars(one).items()}
                names[kind] = names.get(kind, set()) | {*shapes.values()}
    return names


@pytest.mark.usefixtures("day")
def test_a_detector_without_c_is_not_exported_and_none_is_asked_for_in_vain(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.py").write_text(
        "from touchbench_streams.detectors.threshold import Threshold\nclass Mine(Threshold): pass\n"
    )
    words = "data=day model=lda features=touch model.window=0.5 stopping=no out=rec".split()
    assert main(["fit", *words, "detector=my.py:Mine"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"detector={tmp_path / 'my.py'}:Mine finds touches in a stream" in lines
    assert "next: bench predict rec new.csv" in lines
    assert main(["export", "rec", "out=rec_c"]) == 2
    assert "detector=mine has no C; use frames or threshold" in capsys.readouterr().err
    assert main(["fit", *words, "watch=no", "detector.wait=1"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "watch=no: detector.wait= has no effect without" in line


@pytest.mark.parametrize(
    "values, fact",
    [
        ({"detector": "frames,threshold"}, "one detector"),
        ({"detector": "ear"}, "ear"),
        ({"detector": "threshold", "detector.wait": "1"}, "wait"),
        ({"false_alarms": "-1"}, "false_alarms"),
    ],
)
def test_what_does_not_name_one_detector_is_refused(values, fact):
    with pytest.raises(InputError, match=fact):
        Watching(values)
