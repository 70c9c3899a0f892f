"""One grammar for frames as text: Python and C agree on every line of a table."""

import io
import subprocess

import numpy as np
import pandas as pd
import pytest

from addons.chip.tests.compiled import STRICT, fitted, lacking, written
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.models.classic.rf import rf
from touchbench_streams.live import frames_of

FRAME, BLANK, REFUSED = "frame", "blank", "refused"
MOST = 4 * 32  # bytes of a line of four values
# Lines of a sensor with four taxels, values from 0 to 1000, with | between them.
FRAMES = (
    b"1 2 3 4|1,2,3,4|1 , 2,3\t,4|  1\t2  3 4 \t|1 2 3 4\r|1. .5 2e2 +3E-1|-0 0.0 1000 1e3"
    b"|00000000000000000000000000000001 2 3 4"  # 32 characters
    b"|1 2 3 1000.00001|1 2 3 -1e-60"  # 1000 and 0 in single precision
)
NO_FRAMES = (
    b"000000000000000000000000000000001 2 3 4|1,2 3,4|1 2,3 4|1,2,3,4,|,1,2,3,4|1,,2,3|1,,2,3,4|1;2;3;4|,|1 2 3"
    b"|1 2 3 4 5|0x1 2 3 4|1 2 3 0x1p3|nan 2 3 4|inf 2 3 4|1_0 2 3 4|1 2 3 -1|1 2 3 1001|1 2 3 1e39|1 2 3 1e400"
    b"|1 2 3 4\0|\0|1 2\0 3 4|1\f2 3 4|\f|\v|1 2 3 4\f|1\r2 3 4|1 2 3 4\r\r|\xef\xbb\xbf1 2 3 4|1 2 3 1e|1 2 3 ."
    b"|1 2 3 1.2.3|1 2 3 --4|1 2 3 4d"
    b'|1,2,3,"4"'
    b"|\xd9\xa1 2 3 4|1\xc2\xa02 3 4"  # an Arabic digit, a blank that does not break
)
LINES = {
    **dict.fromkeys([*FRAMES.split(b"|"), b"1 2 3 4".ljust(MOST - 1)], FRAME),
    **dict.fromkeys([b"", b" \t ", b"\r", b" " * (MOST - 1)], BLANK),
    **dict.fromkeys([*NO_FRAMES.split(b"|"), b"1 2 3 4".ljust(MOST), b" " * MOST, b"1 2 3 4".ljust(507)], REFUSED),
}


def inputs():
    """Each line behind a frame, and before another or at the end: input, whether it ends, line and its kind."""
    for line, kind in LINES.items():
        yield b"9 9 9 9\n" + line + b"\n9 9 9 9\n", False, line, kind
        if len(line) != MOST:  # the end of the line counts
            yield b"9 9 9 9\n" + line, True, line, kind


def test_python_reads_the_grammar():
    for text, ends, line, kind in inputs():
        frames = frames_of(io.BytesIO(text), 4, 1000.0)
        next(frames)
        if kind == REFUSED:
            with pytest.raises(InputError, match="^line 2: "):
                next(frames)
        elif line or not ends:
            assert (next(frames) is None) is (kind == BLANK), line


@pytest.mark.skipif(bool(lacking("gcc")), reason=lacking("gcc"))
def test_c_reads_the_same_grammar(tmp_path):
    """The C program of a small system; it decides on every frame."""
    rng = np.random.default_rng(0)
    labels = pd.DataFrame({"subject": ["1", "2"] * 2, "gesture": ["a", "a", "b", "b"]})
    arrays = [rng.integers(0, 1000, (20, 2, 2)) for _ in range(4)]
    corpus = Corpus.from_captures(arrays, labels, 50.0, full_scale=1000.0)
    written(fitted(rf(Jung28(), trees=1), corpus), tmp_path)
    call = ["gcc", *STRICT, "-DHOP_MS=1.0", "touch.c", "main.c", "-lm", "-o", "touch"]
    subprocess.run(call, cwd=tmp_path, check=True, capture_output=True)
    for text, ends, line, kind in inputs():
        done = subprocess.run([tmp_path / "touch"], input=text, capture_output=True, check=False)
        captures = [row.split(b",")[0] for row in done.stdout.splitlines()[1:]]
        expected = {
            FRAME: (0, [b"1"] * (2 if ends else 3)),
            BLANK: (0, [b"1"] if ends else [b"1", b"2"]),
            REFUSED: (2, [b"1"]),
        }[kind]
        assert (done.returncode, captures) == expected, line
        assert done.stderr.startswith(b"line 2: ") is (kind == REFUSED)
