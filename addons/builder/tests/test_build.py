"""``bench build`` from recordings to a folder of C with a certificate, and its check."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from addons.streams.tests.people import FEW, generate_people, import_recordings
from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.corpora.library import open_imported
from bench.corpora.read.table import write_table
from bench.errors import InputError
from bench.running.saved import load_recogniser
from bench.store.client import connect
from tests.conftest import predictions, random_corpus, runs
from touchbench_builder import certificate, check, fitting, systems
from touchbench_builder.build import _import_file, _next_commands
from touchbench_builder.captures import load_corpus
from touchbench_builder.folder import header_lines, label_with_c, watch_with_c
from touchbench_builder.stream import (
    count_other_reports,
    people_of_reports,
    people_of_rows,
    recordings_of_people,
)
from touchbench_streams.events import match_tables

TOOLS = [name for name in ("cc", "make", "c++") if shutil.which(name) is None]
ARM = [name for name in ("arm-none-eabi-gcc", "qemu-system-arm") if shutil.which(name) is None]
SENSOR = ["grid=4x4", "rate_hz=100", "full_scale=1023"]
# In so short a time, one system is compared.
BUILD = ["build", "skin.csv", *SENSOR, "seconds=0.1", "jobs=1", "prefix=skin", "out=robot"]

pytestmark = pytest.mark.skipif(bool(TOOLS), reason=f"{', '.join(TOOLS)} not installed")


@pytest.fixture(autouse=True)
def few_tests(request, monkeypatch):
    """One fault; nothing is linked for a chip, except in live tests."""
    monkeypatch.setattr(systems, "DEFAULT_FAULTS", ("noise",))
    if not request.node.get_closest_marker("live"):
        for module in (systems, fitting):
            monkeypatch.setattr(module, "missing_programs", lambda: ["arm-none-eabi-gcc"])


def write_skin(subjects=6, seed=0, name="skin.csv"):
    """Write a table of captures; a tree classifies most of them."""
    corpus = random_corpus(subjects, 3, grid=(4, 4), seed=seed)
    write_table(corpus, Path(name))
    return corpus


def run_in_robot(*arguments):
    """Exit code and output of a program."""
    process = subprocess.run(arguments, cwd="robot", capture_output=True, text=True, check=False)
    return process.returncode, process.stdout + process.stderr


def test_recordings_become_c_that_compiles_passes_its_test_and_keeps_its_certificate(
    capsys, monkeypatch
):
    write_skin()
    with monkeypatch.context() as patch:
        patch.setattr("touchbench_builder.folder._run_own_test", interrupted)
        assert main(BUILD) == 130 and "the same command continues" in capsys.readouterr().err
    assert (
        main([*BUILD[:-2], "prefix=9", "out=robot"]) == 2
        and "prefix=9: names" in capsys.readouterr().err
    )
    assert not Path("robot").exists() and not [*Path().glob(".touchbench*")]
    before = {run.info.run_id for run in connect().search_runs()}
    Path("robot").mkdir()  # an earlier build
    Path("robot/certificate.json").write_text("{}")
    assert main(BUILD) == 2 and "replace=yes" in capsys.readouterr().err
    Path("robot/mine.txt").touch()
    assert main([*BUILD, "replace=yes"]) == 0 and not Path("robot/mine.txt").exists()
    assert {run.info.run_id for run in connect().search_runs()} == before  # none was made twice

    facts = json.loads(Path("robot/certificate.json").read_text())
    expected = facts["captures"]
    store, stored = runs("cell")
    clean = next(run for run in stored if "faults" not in run.data.params)  # of the only system
    table = predictions(store, clean)
    right = table["true"] == table.filter(like="p_").idxmax(axis=1).str[2:]
    counts = right.groupby(table["subject"].astype(str)).agg(["sum", "size"])
    assert expected["people"] == {name: row.tolist() for name, row in counts.iterrows()}
    mean = (counts["sum"] / counts["size"]).mean()
    assert expected["mean"] == pytest.approx(mean, abs=1e-4)
    assert expected["person_low"] < expected["mean_low"] < expected["mean"]
    assert facts["data"]["people"] == 6 and facts["c"]["captures"] == 54

    words = {
        "touch.h": ["from 54 captures of 6 people of skin", f"{100 * mean:.1f} %"]
        + [f'#define SKIN_MODEL "{facts["c"]["model"]}"', f'_VERSION "{facts["touchbench"]}"'],
        "touch.c": [facts["system"]["model"], facts["data"]["digest"], "bench build skin.csv"],
        "README.md": [f"{100 * mean:.1f} %", "programs for a Cortex-M4F are not installed"],
    }
    words["README.md"] += ["It finds no touches itself: no capture", "captures called notouch"]
    for name, parts in words.items():
        assert all(part in Path("robot", name).read_text() for part in parts)
    page = certificate.render_page(facts)
    assert "Only one system was compared" in page and "tests this page on people" in page
    two = {"mean_low": None, "person_low": None, "next_people": None}
    of_two = certificate.render_page(facts | {"captures": expected | two})
    assert "needs a certificate with bounds" in of_two and "tests this page" not in of_two
    assert "of the next people or more" in of_two and of_two.endswith("`\n")
    shares = {"same": 90.0, "other": 80.0, "cost": 10.0, "low": None, "high": None}
    of_days = {"column": "day", "values": ["1", "2"], "people": 6, **shares}
    days = certificate.render_page(facts | {"sessions": of_days})
    assert "costs 10.0 points (too few" in days and "do not include this cost" in days
    head = header_lines(facts | {"sessions": of_days})
    assert "loses 10.0 points (day 1 and 2)" in head[-1]
    assert head[:-1] == header_lines(facts | {"sessions": None})

    result = run_in_robot("make", "-s", "test", "examples")
    assert result == (0, "3 of 3 captures as in Python\n")
    for example in ("./example", "./example_cpp"):
        code, gestures = run_in_robot(example)
        assert code == 0 and {*gestures.split()} <= {"pat", "rub", "tap"} and gestures
    path = Path("robot/vectors.h")
    before, row = path.read_text().split("\n    {", 1)
    label = row.split(",")[1].strip()
    path.write_text(f"{before}\n    {{" + row.replace(f" {label},", f" {1 - int(label)},", 1))
    code, text = run_in_robot("make", "-s", "test")
    own = " ".join(path.read_text() for path in Path("robot").glob("*.[ch]*"))
    assert "skin_push(" in own and not re.search(r"\b(touch|TOUCH)_\w", own)
    assert code and "2 of 3 captures as in Python" in text and "instead of" in text

    compare_new_people(capsys, facts["data"]["digest"])


def compare_new_people(capsys, digest):
    """Similar people agree with the certificate, swapped gestures contradict it; its own fail."""
    newer = write_skin(5, seed=1, name="newer.csv")
    named = newer.captures.assign(subject="new " + newer.captures["subject"])
    gestures = named["gesture"].replace({"pat": "tap", "tap": "rub", "rub": "pat"})
    swapped = named.assign(gesture=gestures)
    inverted = newer.with_fields(captures=named, frames=1023 - newer.frames)
    for name, corpus, code, words in (
        ("newer", newer.with_fields(captures=named), 0, "agree with the certificate"),
        ("swapped", newer.with_fields(captures=swapped), 1, "contradict the certificate"),
        ("inverted", inverted, 1, f"{len(newer)} of {len(newer)} captures look unlike all"),
    ):
        write_table(corpus, Path(f"{name}.csv"))
        assert main(["data", "import", "table", f"{name}.csv", f"name={name}", *SENSOR]) == 0
        capsys.readouterr()
        assert main(["build", "check", "robot", f"data={name}"]) == code
        out = capsys.readouterr().out
        assert words in out and ("look unlike" in out) is (name == "inverted")
    people = pd.concat([newer.captures.assign(subject="other"), write_skin().captures])
    half = Corpus.from_captures([*newer, *write_skin()], people, 100.0)
    for name, corpus in {"renamed": write_skin(), "half": half}.items():
        renamed = corpus.captures.assign(subject="renamed " + corpus.captures["subject"])
        write_table(corpus.with_fields(captures=renamed), Path(f"{name}.csv"))
        assert main(["data", "import", "table", f"{name}.csv", f"name={name}", *SENSOR]) == 0
    refused = {
        "skin": "was recorded for the build",
        "synth": "grid",
        "renamed": "renamed has the recordings of the build",
        "half": f"half has recordings of the build (digest {digest[:16]}): 54 of {len(half)} cap",
    }
    for data, words in refused.items():
        assert main(["build", "check", "robot", f"data={data}"]) == 2
        assert words in capsys.readouterr().err
    file = Path("robot/certificate.json")
    text = file.read_text()
    for damaged in (
        text.replace('"captures": 54', '"captures": 55'),
        text.replace('"people"', '"folk"'),
    ):
        assert damaged != text
        file.write_text(damaged)
        assert main(["build", "check", "robot", "data=newer"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "certificate.json: no certificate of bench build (it differs from" in line


def import_people(name, count, seed, prefix=""):
    """Import recordings of generated people, who have one touch of each of six gestures."""
    people = generate_people(subjects=count, rate_hz=15.0, seed=seed)
    frames = np.concatenate([*people.corpus])
    subjects = np.repeat(people.subjects.astype(str), people.corpus.lengths)
    labels = people.frame_labels()
    import_recordings(name, frames, labels, np.char.add(prefix, subjects))
    return frames, labels, subjects


def test_the_certificate_of_recordings_is_that_of_their_stream_and_is_checked_in_c(
    capsys, monkeypatch
):
    small = {"model": "lda", "features": "touch", "model.window": 0.5}
    monkeypatch.setattr(systems, "candidate_systems", lambda *_: [(small, 1.0)])
    monkeypatch.setattr(check, "MAX_UNLIKE", 0.999)  # five people show little of what is alike
    import_people("day", 5, 0)
    assert main(["build", "data=day", "jobs=1", "faults=none", "out=robot"]) == 0
    facts = json.loads(Path("robot/certificate.json").read_text())
    stream, text = facts["stream"], Path("robot/README.md").read_text()
    store, stored = runs("watch")
    clean = next(run for run in stored if not run.data.params.get("watch.under"))
    table = predictions(store, clean)
    touches, reports, background_s = match_tables(table, 15.0)
    for share, column in (("found", "found"), ("first", "first_correct"), ("last", "end_correct")):
        counts = touches.groupby("subject")[column].agg(["sum", "size"])
        assert stream[share]["people"] == {name: [*row] for name, row in counts.iterrows()}
        mean = (counts["sum"] / counts["size"]).mean()
        assert stream[share]["mean"] == pytest.approx(mean, abs=1e-4)
        assert f"{100 * mean:.1f} %" in text and stream[share]["mean_low"] < mean
    alarms = reports["subject"][reports["touch"] == -1].value_counts()
    hours = {name: seconds / 3600 for name, seconds in background_s.items()}
    assert stream["alarms"]["people"] == {
        name: [alarms.get(name, 0), pytest.approx(hours[name], abs=1e-6)] for name in hours
    }
    later = people_of_rows(table, 15.0, 1).touches  # as with TOUCH_DELAY
    assert (later["latency_s"] - touches["latency_s"]).dropna().to_numpy() == pytest.approx(1 / 15)
    too_late = people_of_rows(table, 15.0, 10**6)
    assert not too_late.touches["found"].any() and (too_late.reports["touch"] == -1).all()
    medians = touches.groupby("subject")["latency_s"].median()
    assert stream["latency_s"]["mean"] == pytest.approx(medians.mean(), abs=1e-3)
    seen = touches.groupby("gesture")["label"].value_counts()
    for gesture, row in stream["confusions"].items():
        assert sum(row.values()) == 5
        assert {label: n for label, n in row.items() if n} == {
            label or "missed": n for label, n in seen[gesture].items()
        }
    sure = touches[touches["confidence"] >= 0.5]
    assert stream["confidence"][0]["right"] == pytest.approx(sure["end_correct"].mean(), abs=1e-4)
    compared = f"0 of {facts['c']['reports']} reports of the C have another time or last label"
    assert facts["c"]["reports"] >= 5 and compared in text
    assert "The streams are recordings" in text and {*facts["stream"]["gestures"]} == {*FEW}

    frames, labels, subjects = import_people("later", 5, 9, "new ")
    on = {"data": "later"}
    recordings = recordings_of_people(on, load_corpus(on))
    recogniser = load_recogniser(facts["system"]["model"])
    of_c = watch_with_c(Path("robot"), facts["data"]["gestures"], recordings.corpus)
    of_python = recogniser.watcher.report_touches(recordings.corpus)
    assert of_python["changes"].sum() > 0
    compared = ["recording", "reported", "end", "first", "label", "changes"]
    pd.testing.assert_frame_equal(of_c[compared], of_python[compared], check_dtype=False)
    assert count_other_reports(of_python, of_c) == 0
    assert count_other_reports(of_python, of_c.assign(label="other")) == len(of_python)
    assert count_other_reports(of_python[1:], of_c) == 1

    others = dict(zip(sorted(FEW), [*sorted(FEW)[3:], *sorted(FEW)[:3]], strict=True))
    swapped = pd.Series(labels).replace(others).to_numpy()
    import_recordings("swapped", frames, swapped, np.char.add("other ", subjects))
    capsys.readouterr()
    assert main(["build", "check", "robot", "data=later"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if "last label" in line)
    right = people_of_reports(recordings, of_python).count_right("last")
    assert f"last label right of {100 * (right['right'] / right['total']).mean():.1f} %" in line
    assert main(["build", "check", "robot", "data=swapped"]) == 1


def interrupted(*_):
    raise KeyboardInterrupt


def test_a_file_is_imported_as_it_is_described_and_replaces_no_other_corpus():
    write_skin()
    exact = {"grid": "4x4", "rate_hz": "133.33333", "full_scale": "16777215"}
    assert _import_file(Path("skin.csv"), exact, "table") == "skin"
    assert (open_imported("skin").rate_hz, open_imported("skin").full_scale) == (
        133.33333,
        16777215,
    )
    Path("skin.csv").rename("skin.new.csv")
    message = "a corpus skin was imported from skin.csv; give the new one a name="
    with pytest.raises(InputError, match=message):
        _import_file(Path("skin.new.csv"), exact, "table")
    assert _import_file(Path("skin.new.csv"), exact | {"name": "other"}, "table") == "other"


def test_a_folder_whose_c_cannot_be_run_is_one_line(tmp_path):
    for name, text in {"touch.h": "", "tables.h": "", "touch.c": "#error broken"}.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="its C cannot be run: .*broken"):
        label_with_c(tmp_path, ["pat"], random_corpus(1, 1))


@pytest.mark.live
@pytest.mark.skipif(bool(ARM), reason=f"{', '.join(ARM)} not installed")
def test_the_c_is_linked_for_a_board_and_passes_its_test_in_an_emulator(capsys):
    write_skin()
    assert main([*BUILD, "board=nano33ble"]) == 0
    facts = json.loads(Path("robot/certificate.json").read_text())
    chip = facts["chip"]
    assert 1000 < chip["flash_bytes"] < 1000 * facts["board"]["flash_kb"] == 1048576
    share = chip["frame_instructions"] * 100 / 64e6
    assert chip["processor_share"] == pytest.approx(share, abs=1e-4)
    chip["most_instructions"] = 3_000_000  # 46.9 ms at 64 MHz: four frames at 100 Hz
    queue = "46.9 ms; a frame comes every 10.0 ms, so 4 must wait in a queue |"
    assert queue in certificate.render_page(facts)
    chip["most_instructions"] = 600_000
    assert "| 9.4 ms; a frame comes every 10.0 ms |" in certificate.render_page(facts)
    assert run_in_robot("make", "-s", "emulated") == (0, "3 of 3 captures as in Python\n")
    assert main([*BUILD, "max_flash=1kB", "replace=yes"]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "The budget of 1 kB for flash rules out" in line
    assert "The smallest board that holds one of them is" in line
    makefile = Path("robot/Makefile").read_text()
    assert "\nFLASH = 1024K\nRAM = 256K\n" in makefile
    assert Path("robot/touch.c").exists()
    assert pd.DataFrame(facts["compared"])["flash"].notna().all()


def test_a_check_is_proposed_if_the_certificate_has_people_enough():
    check = "bench build check robot data=newpeople"
    assert [check in _next_commands("robot", people) for people in (4, 5)] == [False, True]
