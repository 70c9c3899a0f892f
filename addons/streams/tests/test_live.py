"""Frames from standard input, decided on as they come, in one grammar for Python and C."""

import io
import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addons.chip.tests.compiled import STRICT, describe_missing, fit_recogniser, write_files
from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.models.classic.rf import rf
from bench.running.replay import STATE, Calibration, Stopping, Waiting
from bench.running.saved import Recogniser, save_model
from tests.conftest import BENCH
from tests.running.test_replay import Rising, coded_corpus, lengths_of
from touchbench_streams.detectors.base import Event
from touchbench_streams.lines import read_frames
from touchbench_streams.live import decision_windows


@given(lengths_of, st.floats(10, 200), st.integers(1, 12))
def test_a_decision_every_hop_and_one_where_a_capture_ends(lengths, hop_ms, longest):
    frames, naive = [], []
    for c, n in enumerate(lengths, 1):
        frames += [*(np.full(2, 100.0 * c + i) for i in range(n)), None]
        hops = {
            int(np.ceil(k * hop_ms / 10 - 1e-6)) for k in range(1, 1 + int(n * 10 / hop_ms + 1e-6))
        }
        naive += [(c, seen) for seen in sorted({s for s in hops if s <= n} | {n})]
    decided = list(decision_windows(iter(frames[:-1]), 100.0, hop_ms, longest))
    assert [(c, seen) for c, seen, _ in decided] == naive
    for c, seen, window in decided:
        assert [f[0] for f in window] == [100 * c + i for i in range(seen)][-longest:]


GOOD, SHORT = "0,9,9,9,9,9", "0,9,9"


def make_recogniser(stopping=None):
    """A system at 100 Hz on 2 x 3 whose class stands in the first taxel."""
    corpus = coded_corpus()
    return Recogniser(Rising().fit(corpus, corpus.gestures), corpus, stopping)


@pytest.fixture
def streamed(monkeypatch, capsys):
    """A function that runs ``bench live`` and returns exit code, printed lines and errors."""

    def run(recogniser, lines, *words):
        monkeypatch.setattr("bench.running.saved.load_recogniser", lambda _: recogniser)
        monkeypatch.setattr(
            sys, "stdin", SimpleNamespace(buffer=io.BytesIO("\n".join(lines).encode()))
        )
        code = main(["live", "m", *words])
        text = capsys.readouterr()
        return code, text.out.splitlines(), text.err.splitlines()

    return run


def test_standard_input_is_decided_on(streamed):
    lines = [GOOD] * 7 + [""] + ["2 9 9 9 9 9"] * 5
    code, rows, errors = streamed(make_recogniser(), lines, "hop_ms=30")
    # 30 ms are three frames: Rising is wrong, one class too far, and 3/4 sure
    expected = [
        "1,30,b,0.750,-",
        "1,60,a,0.857,-",
        "1,70,a,0.875,-",
        "2,30,a,0.750,-",
        "2,50,c,0.833,-",
    ]
    assert code == 0 and rows == ["capture,ms,label,confidence,settled", *expected]
    assert all(fact in errors[0] for fact in ("2x3", "1023", "100 Hz", "120 ms"))


@pytest.mark.parametrize("threshold", [0.84, np.inf])
def test_a_label_is_settled_as_in_a_replay_that_saw_an_earlier_one(threshold, streamed):
    weights = dict.fromkeys(STATE, 0.0) | {"one": 0.9, "first": -0.5, "same": -0.3}
    calibration = Calibration(10.0, 120.0, 2.0, 0.5)
    system = make_recogniser(Stopping(calibration, Waiting(tuple(weights.values())), threshold))
    _, lines, _ = streamed(system, [GOOD] * 10 + [""] + ["2 9 9 9 9 9"] * 5, "hop_ms=30")
    rows = [line.split(",") for line in lines[1:]]
    # after 3 frames n / (n + 1) = 3/4 is expected to gain 0.9 - 0.375; then less, and less if the
    # label stays:
    # 6 frames see 3 (another label), 9 see 6 and 10 see 6 (the same one); the second capture is new
    gain = [
        0.9 - 3 / 8,
        0.9 - 3 / 7,
        0.9 - 9 / 20 - 0.3,
        0.9 - 5 / 11 - 0.3,
        0.9 - 3 / 8,
        0.9 - 5 / 12,
    ]
    assert [row[:2] for row in rows] == [
        *(["1", t] for t in ("30", "60", "90", "100")),
        ["2", "30"],
        ["2", "50"],
    ]
    expected = ["yes" if 1 - g >= threshold else "no" for g in gain] if threshold < 1 else ["-"] * 6
    assert [row[4] for row in rows] == expected and (threshold > 1 or expected.count("yes") == 2)
    share = np.log(30 / 10) / np.log(
        12
    )  # temperatures: 2 after 10 ms to 0.5 after 120 ms, a line of logarithms
    sharp = np.array([0.75, 0.125, 0.125]) ** (1 / (2 ** (1 - share) * 0.5**share))
    assert rows[0][3] == f"{sharp[0] / sharp.sum():.3f}"


class ScriptedWatcher:
    """A watcher whose stream has a status for each frame, and reports every fourth frame."""

    def __init__(self, statuses):
        self.soonest, self.statuses, self.seen = 3, statuses, 0

    def open_stream(self, grid, rate_hz, full_scale):
        return self

    @property
    def status(self):
        return self.statuses[self.seen - 1]

    def miss(self, frames):
        self.seen += frames
        return []

    def push(self, frame):
        self.seen += 1
        return [] if self.seen % 4 else [Event(self.seen, "a", "a", 0.5, self.seen)]


SHAKY = [0] * 10 + [8] * 400 + [0] * 10 + [8] * 600 + [0] * 501  # 100 frames a second
SKIPPED = [*[GOOD] * 3, "0,9,9,9,9,nan", "9" * 400, *[SHORT] * 8, GOOD, SHORT, *[GOOD] * 4]
BROKEN = [*[GOOD] * 4, *[SHORT] * 11, *[GOOD] * 4]
ENDED = "{},ended,a,0.500".format


@pytest.mark.parametrize(
    ("lines", "code", "reported", "told"),
    [
        (
            SKIPPED,
            0,
            (160,),
            ["line 4: 'nan' is not a decimal number", "of 8 frames: 11 lines lost"],
        ),
        (BROKEN, 2, (40,), ["line 5: 3 values", "bench: line 15: 3 values instead of 6"]),
        (
            [GOOD] * len(SHAKY),
            0,
            range(40, 15_201, 40),
            ["9200 ms: noise: readings", "15200 ms: frames are", "of 1521 frames: 1000 noise"],
        ),
    ],
    ids=[
        "bad lines are lost frames and counted",
        "many in a row end it",
        "a status is told when it has lasted",
    ],
)
def test_an_endless_stream(lines, code, reported, told, streamed):
    system = make_recogniser()
    system.watcher = ScriptedWatcher(SHAKY if len(lines) > 99 else [0] * 20)
    ended, rows, errors = streamed(system, lines)
    assert (ended, rows[1:]) == (
        code,
        [ENDED(ms) for ms in reported],
    )
    assert len(errors) == 1 + len(told) and all(map(str.startswith, errors[1:], told))


@pytest.mark.live
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_decisions_come_while_frames_come_and_control_c_ends_it(tmp_path):
    save_model(tmp_path / "model", make_recogniser().mlflow_arguments([], np.zeros((2, 2, 3))))
    process = subprocess.Popen(
        [*BENCH, "live", str(tmp_path / "model"), "hop_ms=20"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    assert process.stdout.readline() == b"capture,ms,label,confidence,settled\n"
    process.stdin.write(b"1,9,9,9,9,9\n1,9,9,9,9,9\n")
    assert (
        process.stdout.readline() == b"1,20,c,0.667,-\n"
    )  # stdin stays open: nothing else is needed
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 130 and b"Traceback" not in error


FRAME, BLANK, REFUSED = "frame", "blank", "refused"
MOST = 4 * 32  # bytes of a line of four values
# Lines of a sensor with four taxels, values from 0 to 1000, with | between them.
FRAMES = (
    b"1 2 3 4|1,2,3,4|1 , 2,3\t,4|  1\t2  3 4 \t|1 2 3 4\r|1. .5 2e2 +3E-1|-0 0.0 1000 1e3"
    b"|00000000000000000000000000000001 2 3 4"  # 32 characters
    b"|1 2 3 1000.00001|1 2 3 -1e-60"  # 1000 and 0 in single precision
    b"|1 2 3 -1|1 2 3 -19.9"  # taken for 0
)
NO_FRAMES = (
    b"000000000000000000000000000000001 2 3 4|1,2 3,4|1 2,3 4|1,2,3,4,|,1,2,3,4|1,,2,3|1,,2,3,4"
    b"|1;2;3;4|,|1 2 3|1 2 3 4 5|0x1 2 3 4|1 2 3 0x1p3|nan 2 3 4|inf 2 3 4|1_0 2 3 4|1 2 3 -20.1"
    b"|1 2 3 1001|1 2 3 1e39|1 2 3 1e400|1 2 3 4\0|\0|1 2\0 3 4|1\f2 3 4|\f|\v|1 2 3 4\f"
    b"|1\r2 3 4|1 2 3 4\r\r|\xef\xbb\xbf1 2 3 4|1 2 3 1e|1 2 3 ."
    b"|1 2 3 1.2.3|1 2 3 --4|1 2 3 4d"
    b'|1,2,3,"4"'
    b"|\xd9\xa1 2 3 4|1\xc2\xa02 3 4"  # an Arabic digit, a blank that does not break
)
LINES = {
    **dict.fromkeys([*FRAMES.split(b"|"), b"1 2 3 4".ljust(MOST - 1)], FRAME),
    **dict.fromkeys([b"", b" \t ", b"\r", b" " * (MOST - 1)], BLANK),
    **dict.fromkeys(
        [*NO_FRAMES.split(b"|"), b"1 2 3 4".ljust(MOST), b" " * MOST, b"1 2 3 4".ljust(507)],
        REFUSED,
    ),
}


def lines_in_context():
    """Yield each line after a frame, before another or at the end: input, is last, line, kind."""
    for line, kind in LINES.items():
        yield b"9 9 9 9\n" + line + b"\n9 9 9 9\n", False, line, kind
        if len(line) != MOST:  # the end of the line counts
            yield b"9 9 9 9\n" + line, True, line, kind


def test_python_reads_the_grammar():
    for text, ends, line, kind in lines_in_context():
        frames = read_frames(io.BytesIO(text), 4, 1000.0)
        next(frames)
        if kind == REFUSED:
            with pytest.raises(InputError, match="^line 2: "):
                next(frames)
        elif line or not ends:
            assert (next(frames) is None) is (kind == BLANK), line


@pytest.mark.skipif(bool(describe_missing("gcc")), reason=describe_missing("gcc"))
def test_c_reads_the_same_grammar(tmp_path):
    """The C program of a small system; it decides on every frame."""
    rng = np.random.default_rng(0)
    labels = pd.DataFrame({"subject": ["1", "2"] * 2, "gesture": ["a", "a", "b", "b"]})
    arrays = [rng.integers(0, 1000, (20, 2, 2)) for _ in range(4)]
    corpus = Corpus.from_captures(arrays, labels, 50.0, full_scale=1000.0)
    write_files(fit_recogniser(rf(Jung28(), trees=1), corpus), tmp_path)
    call = ["gcc", *STRICT, "-DHOP_MS=1.0", "touch.c", "main.c", "-lm", "-o", "touch"]
    subprocess.run(call, cwd=tmp_path, check=True, capture_output=True)
    for text, ends, line, kind in lines_in_context():
        done = subprocess.run([tmp_path / "touch"], input=text, capture_output=True, check=False)
        captures = [row.split(b",")[0] for row in done.stdout.splitlines()[1:]]
        expected = {
            FRAME: (0, [b"1"] * (2 if ends else 3)),
            BLANK: (0, [b"1"] if ends else [b"1", b"2"]),
            REFUSED: (2, [b"1"]),
        }[kind]
        assert (done.returncode, captures) == expected, line
        assert done.stderr.startswith(b"line 2: ") is (kind == REFUSED)
