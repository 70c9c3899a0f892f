"""Decisions on frames as they come, from standard input too."""

import io
import os
import signal
import subprocess
import sys
import time
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.cli import main
from bench.errors import InputError
from bench.work.live import decided_at, earlier, frames_of
from bench.work.replay import STATE, Calibration, Stopping, Waiting
from tests.conftest import BENCH
from tests.work.test_stream import Rising, coded_corpus, lengths_of


def frames(n, start=0):
    return [np.full(2, start + i, dtype=float) for i in range(n)]


@given(lengths_of, st.floats(10, 200), st.integers(1, 12))
def test_a_decision_every_hop_and_one_where_a_capture_ends(lengths, hop_ms, longest):
    given_, naive = [], []
    for c, n in enumerate(lengths, 1):
        given_ += [*frames(n, 100 * c), None]
        hops = {int(np.ceil(k * hop_ms / 10 - 1e-6)) for k in range(1, 1 + int(n * 10 / hop_ms + 1e-6))}
        naive += [(c, seen) for seen in sorted({s for s in hops if s <= n} | {n})]
    found = list(decided_at(iter(given_[:-1]), 100.0, hop_ms, longest))
    assert [(c, seen) for c, seen, _ in found] == naive
    for c, seen, window in found:
        assert [f[0] for f in window] == [100 * c + i for i in range(seen)][-longest:]


def test_an_endless_stream_needs_no_more_than_the_window():
    def endless():
        while True:
            yield np.zeros(2)

    taken = 0
    for _, seen, window in decided_at(endless(), 100.0, 50.0, 7):
        taken += 1
        assert len(window) == min(seen, 7)
        if taken == 2000:
            break


def test_a_decision_is_out_before_the_next_frame_is_read():
    read = []

    def source():
        for i in range(10):
            read.append(i)
            yield np.zeros(2)

    for _, seen, _ in decided_at(source(), 100.0, 30.0, 5):
        assert len(read) == seen


def test_lines_are_frames():
    text = b"1,2,3\n 4 5\t6\r\n\n\n7, 8 ,9.5\n"
    found = list(frames_of(io.BytesIO(text), 3, 10.0))
    assert [f if f is None else f.tolist() for f in found] == [[1, 2, 3], [4, 5, 6], None, None, [7, 8, 9.5]]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        (b"1,2", "2 values instead of 3"),
        (b"1,2,3,", "4 values instead of 3"),
        (b"1,x,3", "'x' is not a decimal number"),
        (b"1,,3", "'' is not a decimal number"),
        (b"1,1_0,3", "'1_0' is not a decimal number"),
        (b"1,\xff,3", "is not a decimal number"),
        (b"1,nan,3", "'nan' is not a decimal number"),
        (b"1,-1,3", "-1 is not within 0"),
        (b"1,11,3", "11 is not within 0 and the full scale 10"),
        (b"1,2 3", "2 values instead of 3"),
        (b"1" * 500, "longer than"),
    ],
)
def test_a_line_that_is_no_frame_is_named(line, told):
    stream = frames_of(io.BytesIO(b"1,2,3\n" + line + b"\n1,2,3\n"), 3, 10.0)
    assert next(stream) is not None
    with pytest.raises(InputError, match="line 2: ") as e:
        next(stream)
    assert told in str(e.value)


@pytest.fixture
def saved(tmp_path):
    """A model of captures at 100 Hz on 2 x 3 whose class stands in the first taxel."""
    import mlflow

    from bench.work.saved import Recogniser, quiet

    corpus = coded_corpus()
    made = Recogniser(Rising().fit(corpus, corpus.gestures), corpus)
    with quiet():
        mlflow.pyfunc.save_model(str(tmp_path / "model"), **made.model([], corpus[0][:2]))
    return str(tmp_path / "model")


def test_standard_input_is_decided_on(saved, monkeypatch, capsys):
    lines = ["0,9,9,9,9,9"] * 7 + [""] + ["2 9 9 9 9 9"] * 5
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO("\n".join(lines).encode())))
    assert main(["stream", "source=-", f"model={saved}", "hop_ms=30"]) == 0
    captured = capsys.readouterr()
    # 30 ms are three frames: Rising is wrong, one class too far, and 3/4 sure
    assert captured.out.splitlines() == [
        "capture,ms,label,confidence,settled",
        *("1,30,b,0.750,-", "1,60,a,0.857,-", "1,70,a,0.875,-", "2,30,a,0.750,-", "2,50,c,0.833,-"),
    ]
    assert "frames of 2x3 from 0 to 1023, 100 a second" in captured.err and "last 120 ms" in captured.err


def test_a_label_is_settled_as_in_a_replay_that_saw_an_earlier_one(tmp_path, monkeypatch, capsys):
    import mlflow

    from bench.work.saved import Recogniser, quiet

    corpus = coded_corpus()
    model = Rising().fit(corpus, corpus.gestures)
    weights = dict.fromkeys(STATE, 0.0) | {"one": 0.9, "first": -0.5, "same": -0.3}
    waiting, calibration = Waiting(tuple(weights.values())), Calibration(10.0, 120.0, 2.0, 0.5)
    made = Recogniser(model, corpus, Stopping(calibration, waiting, 0.84))
    with quiet():
        mlflow.pyfunc.save_model(str(tmp_path / "model"), **made.model([], corpus[0][:2]))
    lines = ["0,9,9,9,9,9"] * 10 + [""] + ["2 9 9 9 9 9"] * 5
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO("\n".join(lines).encode())))
    assert main(["stream", "source=-", f"model={tmp_path / 'model'}", "hop_ms=30"]) == 0
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()[1:]]
    # after 3 frames n / (n + 1) = 3/4 is expected to gain 0.9 - 0.375; then less, and less where the label stays:
    # 6 frames see 3 (another label), 9 see 6 and 10 see 6 (the same one); the second capture is new
    gain = [0.9 - 3 / 8, 0.9 - 3 / 7, 0.9 - 9 / 20 - 0.3, 0.9 - 5 / 11 - 0.3, 0.9 - 3 / 8, 0.9 - 5 / 12]
    told = [row[4] for row in rows]
    assert [row[:2] for row in rows] == [*(["1", t] for t in ("30", "60", "90", "100")), ["2", "30"], ["2", "50"]]
    assert told == ["no", "no", "yes", "yes", "no", "no"] == ["yes" if 1 - g >= 0.84 else "no" for g in gain]
    sure = calibration(np.array([[0.75, 0.125, 0.125]]), np.array([30.0]))[0, 0]
    assert rows[0][3] == f"{sure:.3f}"


def test_the_label_before_is_the_newest_of_those_that_had_seen_enough_less():
    stood = deque([(2, "a"), (3, "b"), (4, "a"), (5, "b")])
    assert earlier(stood, 2) is None and len(stood) == 4
    assert earlier(stood, 4) == "a" and earlier(stood, 5) == "b" and len(stood) == 3
    assert earlier(stood, 100) == "b" and list(stood) == [(5, "b")]
    assert earlier(deque(), 5) is None


def test_a_bad_line_ends_the_stream_after_the_decisions_before_it(saved, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(b"0,9,9,9,9,9\n" * 4 + b"0,9,9,9,9,9999\n")))
    assert main(["stream", "source=-", f"model={saved}", "hop_ms=20", "window_ms=20"]) == 2
    captured = capsys.readouterr()
    assert captured.out.splitlines()[1:] == ["1,20,b,0.667,-", "1,40,b,0.667,-"]
    assert captured.err.splitlines()[-1] == "bench: line 5: 9999 is not within 0 and the full scale 1023"


@pytest.mark.live
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_decisions_come_while_frames_come_and_control_c_ends_it(saved):
    process = subprocess.Popen(
        [*BENCH, "stream", "source=-", f"model={saved}", "hop_ms=20"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    assert process.stdout.readline() == b"capture,ms,label,confidence,settled\n"
    process.stdin.write(b"1,9,9,9,9,9\n1,9,9,9,9,9\n")
    assert process.stdout.readline() == b"1,20,c,0.667,-\n"  # stdin stays open: nothing else is needed
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 130 and b"Traceback" not in error
