"""One grammar for frames as text: Python and C agree on every line of a table."""

import io
import subprocess

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.work.live import frames_of
from features.jung28 import Jung28
from models.classic.rf import rf
from tests.export.compiled import STRICT, fitted, lacking, written

FRAME, BLANK, REFUSED = "frame", "blank", "refused"
MOST = 4 * 32  # bytes of a line of four values
LINES = {  # of a sensor with four taxels, values from 0 to 1000
    b"1 2 3 4": FRAME,
    b"1,2,3,4": FRAME,
    b"1 , 2,3\t,4": FRAME,
    b"  1\t2  3 4 \t": FRAME,
    b"1 2 3 4\r": FRAME,
    b"1. .5 2e2 +3E-1": FRAME,
    b"-0 0.0 1000 1e3": FRAME,
    b"00000000000000000000000000000001 2 3 4": FRAME,  # 32 characters
    b"1 2 3 1000.00001": FRAME,  # 1000 in single precision
    b"1 2 3 -1e-60": FRAME,  # 0 in single precision
    b"1 2 3 4" + b" " * (MOST - 8): FRAME,
    b"": BLANK,
    b" \t ": BLANK,
    b"\r": BLANK,
    b" " * (MOST - 1): BLANK,
    b"1 2 3 4" + b" " * (MOST - 7): REFUSED,
    b" " * MOST: REFUSED,
    b"1 2 3 4" + b" " * 500: REFUSED,
    b"000000000000000000000000000000001 2 3 4": REFUSED,
    b"1,2 3,4": REFUSED,
    b"1 2,3 4": REFUSED,
    b"1,2,3,4,": REFUSED,
    b",1,2,3,4": REFUSED,
    b"1,,2,3": REFUSED,
    b"1,,2,3,4": REFUSED,
    b"1;2;3;4": REFUSED,
    b",": REFUSED,
    b"1 2 3": REFUSED,
    b"1 2 3 4 5": REFUSED,
    b"0x1 2 3 4": REFUSED,
    b"1 2 3 0x1p3": REFUSED,
    b"nan 2 3 4": REFUSED,
    b"inf 2 3 4": REFUSED,
    b"1_0 2 3 4": REFUSED,
    b"1 2 3 -1": REFUSED,
    b"1 2 3 1001": REFUSED,
    b"1 2 3 1e39": REFUSED,
    b"1 2 3 1e400": REFUSED,
    b"1 2 3 4\0": REFUSED,
    b"\0": REFUSED,
    b"1 2\0 3 4": REFUSED,
    b"1\f2 3 4": REFUSED,
    b"\f": REFUSED,
    b"\v": REFUSED,
    b"1 2 3 4\f": REFUSED,
    b"1\r2 3 4": REFUSED,
    b"1 2 3 4\r\r": REFUSED,
    b"\xef\xbb\xbf1 2 3 4": REFUSED,
    b"\xd9\xa1 2 3 4": REFUSED,  # an Arabic digit
    b"1\xc2\xa02 3 4": REFUSED,  # a blank that does not break
    b"1 2 3 1e": REFUSED,
    b"1 2 3 .": REFUSED,
    b"1 2 3 1.2.3": REFUSED,
    b"1 2 3 --4": REFUSED,
    b"1 2 3 4d": REFUSED,
    b'1,2,3,"4"': REFUSED,
}


def around(line, end=b"\n"):
    """The line behind a frame and, if it is not the last, before another."""
    return b"9 9 9 9\n" + line + end + (b"9 9 9 9\n" if end else b"")


@pytest.mark.parametrize(("line", "kind"), LINES.items())
def test_python_reads_the_grammar(line, kind):
    for end in (b"\n", b""):
        if end == b"" and len(line) == MOST:
            continue  # the end of the line counts
        found = frames_of(io.BytesIO(around(line, end)), 4, 1000.0)
        next(found)
        if kind == REFUSED:
            with pytest.raises(InputError, match="^line 2: "):
                next(found)
        elif end or line:
            assert (next(found) is None) is (kind == BLANK)


def program(folder):
    """The C program of a small system; it decides on every frame."""
    rng = np.random.default_rng(0)
    about = pd.DataFrame({"subject": ["1", "2"] * 2, "gesture": ["a", "a", "b", "b"]})
    corpus = Corpus.from_captures([rng.integers(0, 1000, (20, 2, 2)) for _ in range(4)], about, 50.0, full_scale=1000.0)
    written(fitted(rf(Jung28(), trees=1), corpus), folder)
    call = ["gcc", *STRICT, "-DHOP_MS=1.0", "touch.c", "main.c", "-lm", "-o", "touch"]
    subprocess.run(call, cwd=folder, check=True, capture_output=True)
    return folder / "touch"


@pytest.mark.skipif(bool(lacking("gcc")), reason=lacking("gcc"))
def test_c_reads_the_same_grammar(tmp_path):
    asked = program(tmp_path)
    for line, kind in LINES.items():
        for end in (b"\n", b""):
            if end == b"" and len(line) == MOST:
                continue
            done = subprocess.run([asked], input=around(line, end), capture_output=True, check=False)
            captures = [row.split(b",")[0] for row in done.stdout.splitlines()[1:]]
            expected = {
                FRAME: (0, [b"1"] * (3 if end else 2)),
                BLANK: (0, [b"1", b"2"] if end else [b"1"]),
                REFUSED: (2, [b"1"]),
            }[kind]
            assert (done.returncode, captures) == expected, line
            assert done.stderr.startswith(b"line 2: ") is (kind == REFUSED)
