"""The command: a bad line is one line of output with exit code 2; streams and files."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.cli import _accept_all_output, main
from bench.errors import InputError
from bench.ground.typed import expand_home, parse_toml
from tests.conftest import BENCH

SMALL = ["data=synth", "data.subjects=2", "data.variants=normal"]
SYNTH = ["data", "export", "synth"]
FEW = "where=gesture in ('pat', 'rub', 'tap') and (gesture != 'rub' or subject in ('1', '2'))"
FEW_RUBS = ["data.subjects=4", "data.variants=normal", "data.repetitions=1", "features=jung28", FEW]
BAD = [  # arguments, and what the line names
    (["run", "model="], "'model='"),
    (["run", "data.subjects.x=2"], "subjects.x"),
    (["run", "model.C=None"], "model.C=None"),
    (["run", "jobs=two"], "jobs=two"),
    (["run", "--hop-ms", "125"], "hop_ms=125"),
    (["run", "data=a\0b"], "NUL"),
    (["run", "data=\x1b[31mred"], "data="),
    (["run", "where=" + 500 * "x"], "where="),
    *(
        (["stress", "data.subjects=4", f"train_subjects={n}"], f"train_subjects={n}")
        for n in ("few", "4")
    ),
    (["run", "after=each", "hop_ms=1"], "hop_ms=1"),
    (["run", "after=each", "stopping=yes", "data.subjects=2"], "one subject"),
    (["run", "model=bayes", "train_subjects=1", *FEW_RUBS], "nobody"),
    (["tune", "model=tree", "inner=loso", *FEW_RUBS], "nobody"),
    (["fit", "stopping=maybe"], "stopping=maybe"),
    (["predict", "rec"], "MODEL FILE"),
    (["predict", "rec", "x.csv", "rate_hz=-1"], "rate_hz=-1"),
    *((["ui", f"port={port}"], "from 1 to 65535") for port in ("65536", "٣")),
    *(([*SYNTH, target, "subjects=2"], "name a file") for target in ("", "folder", "pipe")),
    ([*SYNTH, "o.csv", "subjects=1,2"], "one value of each parameter"),
    (["data", "import", "cost", "\udcff.csv"], ".csv"),
    (["data", "import", "table", "x.csv", "rate_hz=fast"], "rate_hz=fast"),
    (["data", "import", "cost", "x.csv", "name=../x"], "name=../x"),
    (["data", "show", "synth", "subject=2"], "did you mean subjects"),
    (["data", "show", "synth", "subjects=2", "data.subjects=3"], "data.subjects="),
    (["data", "show", "synth", "subjects=1", "out=file/x"], "file/x"),
    (["data", "show", "synth", "subjects=1", "variants=normal", "out=taken"], "taken/captures.svg"),
]


@pytest.mark.parametrize(("arguments", "fact"), BAD, ids=range(len(BAD)))
def test_a_bad_line_is_one_line_that_names_the_key_and_writes_nothing(arguments, fact, capsys):
    Path("folder").mkdir()
    Path("taken/captures.svg").mkdir(parents=True)
    Path("file").write_text("mine")
    os.mkfifo("pipe")
    assert main(arguments) == 2
    output = capsys.readouterr()
    (line,) = output.err.splitlines()
    assert line.startswith("bench: ") and line.isprintable() and len(line) <= 300
    assert fact in line and not output.out
    made = {path.name for path in Path().iterdir()} - {"home", "mlflow.db", "mlruns", "mlartifacts"}
    assert made == {"folder", "taken", "file", "pipe"} and Path("file").read_text() == "mine"


def test_output_is_written_where_the_locale_knows_no_such_letter(monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written := io.BytesIO(), encoding="ascii"))
    _accept_all_output()
    print("\xb7", flush=True)
    assert written.getvalue().strip() == b"\\xb7"


@pytest.mark.parametrize("arguments", [["--help"], ["data"]])
def test_output_that_is_closed_is_no_error(arguments):
    done = subprocess.run(
        [*BENCH, *arguments], stderr=subprocess.PIPE, preexec_fn=lambda: os.close(1)
    )
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_closed_pipe_is_told_by_its_stream(tmp_path):
    """Of standard output: seen enough. Of standard error: dropped. Of a system: its error."""
    (tmp_path / "my.py").write_text(
        "import os\n"
        "from sklearn.naive_bayes import GaussianNB\n"
        "class Piped(GaussianNB):\n"
        "    def fit(self, X, y):\n"
        "        r, w = os.pipe()\n"
        "        os.close(r)\n"
        "        os.write(w, b'x')\n"
    )

    def run_with_closed(streams, *arguments):
        reader, writer = os.pipe()
        os.close(reader)
        others = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        others |= dict.fromkeys(streams, writer)
        done = subprocess.run([*BENCH, *arguments], **others)
        os.close(writer)
        return done.returncode, (done.stdout or b"") + (done.stderr or b"")

    for arguments in (["--help"], ["data"], ["runs"]):
        code, text = run_with_closed(["stdout"], *arguments)
        assert (code, text) == (0, b"") or (arguments == ["runs"] and code == 2), arguments
    code, text = run_with_closed(["stderr"], "nonsense")
    assert code == 2 and b"no command is called 'nonsense'" in text
    fit = ["fit", *SMALL, "features=jung28", "model=my.py:Piped", "out=saved"]
    code, text = run_with_closed([], *fit)
    assert code == 1 and b"BrokenPipeError" in text and not Path("saved").exists()


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("out=~/rep", "out={}/rep"),
        ("~/new.csv", "{}/new.csv"),
        ("model=svm,~/my.py:My", "model=svm,{}/my.py:My"),
        ("out=~", "out={}"),
        ("out=a~/b", "out=a~/b"),
        ("where=~(subject == '1')", "where=~(subject == '1')"),
        ("where=~flag", "where=~flag"),
        ("where=a == '~/x'", "where=a == '~/x'"),
        ("out=~nobody-here/x", "out=~nobody-here/x"),
    ],
)
def test_the_home_of_the_user_is_found_in_every_argument(argument, expected, monkeypatch):
    monkeypatch.setenv("HOME", "/home/me")
    assert expand_home(argument) == expected.format("/home/me")


def test_no_folder_is_called_tilde(tmp_path, monkeypatch, capsys):
    home = tmp_path / "me"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    assert main(["data", "export", "synth", "out.csv", "subjects=1", "out=~/x"]) == 2
    (tmp_path / "grid.toml").write_bytes(b"\xef\xbb\xbfmodel = '~/my.py:My'\n")
    assert main(["run", "grid.toml", "dry=yes"]) == 2
    assert str(home) in capsys.readouterr().err
    monkeypatch.setenv("TOUCHBENCH_HOME", "~/data")
    assert main(["data"]) == 0 and (home / "data").is_dir()
    assert not [*tmp_path.glob("~*")]


@pytest.mark.parametrize(
    ("content", "advice"),
    [
        (b"model = 'lda'\nmodel = 'svm'", "once, and several values of a key as a list"),
        (b"[a]\nmodel = 'lda'\n[a]\n", "once, and several values"),
        (b"model = 'lda'\nmodel.C = 8", "dot in quotes"),
        (b"model = lda", "text in quotes"),
        (b"model = [1,", "lists in brackets"),
        (b"\xff\xfem", "save the file as UTF-8"),
    ],
)
def test_a_toml_error_has_its_own_advice(content, advice):
    with pytest.raises(InputError, match=advice):
        parse_toml(content)
    assert parse_toml(b'\xef\xbb\xbf"data.x" = 3\n') == {"data.x": 3}


def test_memory_that_runs_out_is_one_line(monkeypatch, capsys):
    def hungry(_):
        raise MemoryError("Unable to allocate 1 TiB")

    monkeypatch.setattr("bench.commands.data.command", hungry)
    assert main(["data"]) == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "Unable to allocate 1 TiB" in line
