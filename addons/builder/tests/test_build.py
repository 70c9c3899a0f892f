"""From recordings to a folder of C with a certificate: the way as a whole, and what it refuses."""

import json
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from bench.cli import main
from bench.corpora.library import stored_value
from bench.corpora.read.table import write_table
from bench.errors import InputError
from bench.store.client import connect
from tests.conftest import predictions, random_corpus, runs
from touchbench_builder import certificate
from touchbench_builder.folder import labelled
from touchbench_builder.way import _imported

TOOLS = [name for name in ("cc", "make", "c++") if shutil.which(name) is None]
ARM = [name for name in ("arm-none-eabi-gcc", "qemu-system-arm") if shutil.which(name) is None]
SENSOR = ["grid=4x4", "rate_hz=100", "full_scale=1023"]
BUILD = [
    "build",
    "skin.csv",
    *SENSOR,
    "seconds=0.1",
    "jobs=1",
    "out=robot",
]  # so that one system is compared

pytestmark = pytest.mark.skipif(bool(TOOLS), reason=f"{', '.join(TOOLS)} not installed")


@pytest.fixture(autouse=True)
def quick(request, monkeypatch):
    """One fault; nothing is linked for a chip, except in live tests."""
    monkeypatch.setattr("touchbench_builder.choice.FAULTS", ("noise",))
    if not request.node.get_closest_marker("live"):
        monkeypatch.setattr("touchbench_builder.choice.lacking", lambda: ["arm-none-eabi-gcc"])


def skin(subjects=6, seed=0, name="skin.csv", **fields):
    """A table of captures; a tree classifies most of them."""
    corpus = random_corpus(subjects, 3, grid=(4, 4), seed=seed, **fields)
    write_table(corpus, Path(name))
    return corpus


def said(*arguments, cwd="robot"):
    """Output of a program, with its exit code."""
    done = subprocess.run(arguments, cwd=cwd, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_recordings_become_c_that_compiles_passes_its_test_and_keeps_its_certificate(
    capsys, monkeypatch
):
    skin()
    with monkeypatch.context() as patch:
        patch.setattr("touchbench_builder.folder._tested", interrupted)
        assert main(BUILD) == 130 and "the same command continues" in capsys.readouterr().err
    assert not Path("robot").exists() and not [*Path().glob(".robot*")]
    before = {run.info.run_id for run in connect().runs()}
    Path("robot").mkdir()  # an earlier build
    Path("robot/certificate.json").write_text("{}")
    assert main(BUILD) == 2 and "replace=yes" in capsys.readouterr().err
    Path("robot/mine.txt").touch()
    assert main([*BUILD, "replace=yes"]) == 0 and not Path("robot/mine.txt").exists()
    assert {run.info.run_id for run in connect().runs()} == before, (
        "a run or a model was made twice"
    )

    facts = json.loads(Path("robot/certificate.json").read_text())
    store, found = runs("cell")
    plain = next(
        run for run in found if "faults" not in run.data.params
    )  # one system: nothing else could be chosen
    labelled = predictions(store, plain)
    right = (
        labelled["true"]
        == labelled[[c for c in labelled if c.startswith("p_")]].idxmax(axis=1).str[2:]
    )
    counts = right.groupby(labelled["subject"].astype(str)).agg(["sum", "size"])
    assert facts["expected"]["people"] == {
        name: [int(s), int(n)] for name, (s, n) in counts.iterrows()
    }
    assert facts["expected"]["mean"] == pytest.approx(
        (counts["sum"] / counts["size"]).mean(), abs=1e-4
    )
    assert (
        facts["expected"]["person_low"] < facts["expected"]["mean_low"] < facts["expected"]["mean"]
    )
    assert facts["data"]["people"] == 6 and facts["c"]["captures"] == 54

    header, code, page = (
        Path("robot", name).read_text() for name in ("touch.h", "touch.c", "README.md")
    )
    accuracy = f"{100 * facts['expected']['mean']:.1f} %"
    assert (
        "from 54 captures of 6 people of skin" in header and accuracy in header and accuracy in page
    )
    assert (
        facts["system"]["model"] in code
        and facts["data"]["digest"] in code
        and "bench build skin.csv" in code
    )
    assert (
        "programs for a Cortex-M4F are not installed" in page
        and "the C of this system cannot watch" in page
    )

    assert said("make", "-s", "test", "examples") == (0, "3 of 3 captures as in Python\n")
    for example in ("./example", "./example_cpp"):
        code, gesture = said(example)
        assert code == 0 and gesture.strip() in ("pat", "rub", "tap")
    vectors = Path("robot/vectors.h").read_text()
    first = vectors.index("    {") + 5
    label = vectors[first:].split(",")[1].strip()
    Path("robot/vectors.h").write_text(
        vectors[:first] + vectors[first:].replace(f", {label},", f", {1 - int(label)},", 1)
    )
    code, text = said("make", "-s", "test")
    assert code and "2 of 3 captures as in Python" in text and "instead of" in text

    check(facts, capsys)


def check(facts, capsys):
    """People of the same kind agree with the certificate, swapped gestures do not; people of the build are refused."""
    newer = skin(5, seed=1, name="newer.csv")
    named = newer.captures.assign(subject="new " + newer.captures["subject"])
    swapped = named.assign(
        gesture=named["gesture"].replace({"pat": "tap", "tap": "rub", "rub": "pat"})
    )
    inverted = newer.changed(captures=named, frames=1023 - newer.frames)
    for name, corpus, code, words in (
        ("newer", newer.changed(captures=named), 0, "agrees with the certificate"),
        ("swapped", newer.changed(captures=swapped), 1, "contradicts the certificate"),
        (
            "inverted",
            inverted,
            1,
            f"{len(newer)} of {len(newer)} captures look unlike all captures of the build",
        ),
    ):
        write_table(corpus, Path(f"{name}.csv"))
        assert main(["data", "import", "table", f"{name}.csv", f"name={name}", *SENSOR]) == 0
        capsys.readouterr()
        assert main(["build", "check", "robot", f"data={name}"]) == code
        out = capsys.readouterr().out
        assert words in out and ("look unlike" in out) is (name == "inverted")
    for data, words in {"skin": "was recorded for the build", "synth": "grid"}.items():
        assert (
            main(["build", "check", "robot", f"data={data}"]) == 2
            and words in capsys.readouterr().err
        )


def interrupted(*_):
    raise KeyboardInterrupt


def test_a_file_is_imported_as_it_is_described_and_replaces_no_other_corpus():
    skin()
    exact = {"grid": "4x4", "rate_hz": "133.33333", "full_scale": "16777215"}
    assert _imported(Path("skin.csv"), exact, "table") == "skin"
    assert (stored_value("skin").rate_hz, stored_value("skin").full_scale) == (133.33333, 16777215)
    Path("skin.csv").rename("skin.new.csv")
    with pytest.raises(
        InputError, match="a corpus skin was imported from skin.csv; give the new one a name="
    ):
        _imported(Path("skin.new.csv"), exact, "table")
    assert _imported(Path("skin.new.csv"), exact | {"name": "other"}, "table") == "other"


def test_a_folder_whose_c_cannot_be_run_is_one_line(tmp_path):
    for name, text in {"touch.h": "", "tables.h": "", "touch.c": "#error broken"}.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="its C cannot be run: .*broken"):
        labelled(tmp_path, ["pat"], random_corpus(1, 1))


@pytest.mark.live
@pytest.mark.skipif(bool(ARM), reason=f"{', '.join(ARM)} not installed")
def test_the_c_is_linked_for_a_board_and_passes_its_test_in_an_emulator(capsys):
    skin()
    assert main([*BUILD, "board=nano33ble"]) == 0
    facts = json.loads(Path("robot/certificate.json").read_text())
    assert (
        1000 < facts["chip"]["flash_bytes"] < 1000 * facts["chip"]["board"]["flash_kb"] == 1048576
    )
    assert facts["chip"]["processor_share"] == pytest.approx(
        facts["chip"]["frame_instructions"] * 100 / 64e6, abs=1e-4
    )
    facts["chip"]["most_instructions"] = (
        3_000_000  # 46.9 ms at 64 MHz, in which four frames come at 100 Hz
    )
    assert "46.9 ms; a frame comes every 10.0 ms, so 4 must wait in a queue |" in certificate.page(
        facts
    )
    facts["chip"]["most_instructions"] = 600_000
    assert "| 9.4 ms; a frame comes every 10.0 ms |" in certificate.page(facts)
    assert said("make", "-s", "emulated") == (0, "3 of 3 captures as in Python\n")
    assert main([*BUILD, "max_flash=1kB", "replace=yes"]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert (
        "The budget of 1 kB for flash rules out" in line
        and "uno-r3" in line
        and Path("robot/touch.c").exists()
    )
    assert pd.DataFrame(facts["compared"])["flash"].notna().all()
