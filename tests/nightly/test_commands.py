"""Command lines from the registry's grammar, most a little wrong, run or are refused in a line."""

import contextlib
import io
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

import bench.running.loop as loop
import bench.running.workers as workers
from bench.cli import main
from bench.ground.registry import load_part, parameter_defaults, registered_parts
from bench.ground.typed import format_value
from bench.running.workers import FoldExecutor
from tests.nightly.bounded import bounded

pytestmark = pytest.mark.nightly
ODD = """0 1 -1 0.5 1e-300 1e309 nan -inf None true 1000001 4294967296 1000000000000 0x10 1_0 ١ ½ =
, ,, 1, + a+b é ' "
\\ ../../x /dev/null - ~ $(id) {0} %s [ __class__ None,1 1,1""".split()
ODD += ["", "9" * 25, "9" * 5000, "a" * 300, "a\0b", "\n", "\ud800"]
WHERE = [
    "variant == 'rough'",
    "repetition > 0",
    "repetition.isin([1])",
    "nothing == 1",
    "gesture",
    "(",
    "(" * 500,
    "",
]
WHERE += [
    "__import__('os')",
    "gesture.to_csv('x')",
    "@x",
    "gesture == " * 200,
    "9" * 5000 + " < repetition",
]
CHEAP = dict.fromkeys(("epochs", "pretraining", "runs", "patience"), "1") | dict.fromkeys(
    ("trees", "rounds"), "5"
)
CHEAP |= dict.fromkeys(("trials", "iterations"), "2") | {"kernels": "84"}
SLOW = {
    "auto",
    "rocket",
    "touchnet",
    "mlp",
    "balli2015_rf",
    "wingerden2014_mlp",
}  # even on so few captures
OWN = {
    "run": "",
    "stress": "faults=noise faults=shift,rotation faults=all train_subjects=1",
    "tune": "trials=2 inner=2 seconds=1",
    "fit": "out=m",
    "choose": "by=flash by=ram max_flash=1kB margin=1",
    "report": "out=r",
    "check": "baseline=b.json stored=yes",
    "runs": "delete=yes yes=yes",
    "data": "name=n grid=2x2 rate_hz=10 full_scale=255 format=cost",
}
DATA = [
    "",
    "import table x.csv",
    "import cost x",
    "export synth o.csv",
    "show synth",
    "verify synth",
    "no",
]


@st.composite
def lines(draw):
    """One command line: a valid one, then up to three changes."""
    command = draw(st.sampled_from([*OWN, "run", "run", "run"]))
    pairs = dict(word.split("=") for word in OWN[command].split() if draw(st.booleans()))
    begin = [command, *(draw(st.sampled_from(DATA)).split() if command == "data" else [])]
    if command not in ("data", "report", "check"):
        pairs |= {"data.subjects": "3", "data.variants": "normal"}
        for key, room in {
            "model": "models",
            "protocol": "protocols",
            "features": "features",
        }.items():
            if key == "model" or draw(st.booleans()):
                part = draw(st.sampled_from(sorted(set(registered_parts(room)) - SLOW)))
                usual = parameter_defaults(load_part(room, part))
                pairs |= {key: part} | {f"{key}.{k}": CHEAP[k] for k in usual if k in CHEAP}
                pairs |= {
                    f"{key}.{k}": format_value(v)
                    for k, v in usual.items()
                    if v and draw(st.integers(0, 6)) == 0
                }
        if draw(st.integers(0, 2)) == 0:
            pairs["where"] = draw(st.sampled_from(WHERE))
    words = [f"{key}={value}" for key, value in pairs.items()]
    for _ in range(draw(st.sampled_from([0, 0, 1, 1, 2, 3]))):
        at, odd = draw(st.integers(0, max(0, len(words) - 1))), draw(st.sampled_from(ODD))
        key = words[at].partition("=")[0] if words else "model"
        forms = [
            [f"{key}={odd}"],
            [f"{key}.seed={odd}"],
            [f"{odd}={odd}"],
            [odd],
            [key],
            [f"{key}=1"] * 2,
            [],
        ]
        words[at : at + 1] = draw(st.sampled_from(forms))
    return [*begin, *words]


def ended(words):
    """Exit code and error output of a command."""
    os.environ["OMP_NUM_THREADS"] = "1"
    workers.ProcessExecutor = FoldExecutor
    with (
        contextlib.redirect_stderr(io.StringIO()) as errors,
        contextlib.redirect_stdout(io.StringIO()),
    ):
        loop.console.file = errors
        code = main(words)
    return code, errors.getvalue()


@given(lines())
def test_a_command_line_is_done_or_refused_in_one_line(words):
    code, errors = bounded(ended, words, seconds=120, mib=4000)
    assert "Traceback" not in errors and code in (0, 1, 2), (code, errors[-2000:])
    if code == 2:
        (message,) = [line for line in errors.splitlines() if line.startswith("bench: ")]
        assert len(message) <= 310, message
    elif code == 1:
        assert " failed: " in errors or words[0] in ("check", "data"), errors[-2000:]
