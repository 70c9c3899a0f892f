"""What a killed command leaves, and that the next one clears it away."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from bench import scratch
from tests.conftest import BENCH


def dead_process() -> int:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def test_temporary_files_lie_in_a_folder_that_goes_with_the_command():
    before = tempfile.gettempdir()
    with scratch.scratch():
        mine = Path(tempfile.mkdtemp())
        assert mine.parent.parent == scratch.home() / "tmp"
        assert mine.parent.name.startswith(scratch.owner())
    assert tempfile.gettempdir() == before
    assert not mine.parent.exists()


def test_only_what_dead_processes_of_this_machine_left_is_swept(tmp_path):
    host = scratch.owner().split(f"-{os.getpid()}-")[0]
    gone = tmp_path / f"{host}-{dead_process()}-x"
    keep = [
        tmp_path / f"{host}-{os.getpid()}-x",
        tmp_path / f"other{host}-1-x",
        tmp_path / f"{host}-x-1",
        tmp_path / f"{host}-{dead_process()}-1-x",
    ]
    for path in (gone, *keep):
        path.mkdir()
        (path / "file").write_text("")
    scratch.sweep(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(keep)


def test_what_was_being_written_when_a_command_was_killed_goes_with_the_next_command():
    name = f".{scratch.owner().split(f'-{os.getpid()}-')[0]}-{dead_process()}-abcdefgh"
    left = [scratch.home() / place / name for place in ("features", "corpora", "corpora/synth", "corpora/mine")]
    for path in left:
        path.mkdir(parents=True)
        (path / "frames.npy").write_bytes(b"half")
    with scratch.scratch():
        assert not [path for path in left if path.exists()]


@pytest.mark.skipif(not os.access("/dev/shm", os.W_OK), reason="semaphores are files on Linux alone")
def test_semaphores_of_dead_processes_go_with_the_next_command():
    left, mine = (Path(f"/dev/shm/sem.loky-{pid}-touchbench") for pid in (dead_process(), os.getpid()))
    try:
        left.touch()
        mine.touch()
        with scratch.scratch():
            assert not left.exists() and mine.exists()
    finally:
        left.unlink(missing_ok=True)
        mine.unlink(missing_ok=True)


def test_a_folder_that_cannot_be_written_changes_nothing(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "file"))
    before = tempfile.gettempdir()
    with scratch.scratch():
        assert tempfile.gettempdir() == before


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="finds workers in /proc")
@pytest.mark.pool
def test_workers_end_when_their_parent_is_killed_and_the_next_command_cleans(tmp_path):
    command = [*BENCH, "run", "data.subjects=6", "model=cnn85", "model.epochs=400", "jobs=2"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as process:
        deadline = time.time() + 120
        while len(workers(process.pid)) < 2 and process.poll() is None and time.time() < deadline:
            time.sleep(0.1)
        children = workers(process.pid)
        assert len(children) >= 2
        time.sleep(1)  # they have begun
        process.send_signal(signal.SIGKILL)
        process.wait()
    deadline = time.time() + 20
    while any(scratch.alive(child) for child in children) and time.time() < deadline:
        time.sleep(0.1)
    assert not [child for child in children if scratch.alive(child)]
    place = scratch.home() / "tmp"
    assert list(place.iterdir())  # what was killed left its folder
    subprocess.run([*BENCH, "data"], cwd=tmp_path, capture_output=True, check=True)
    assert not list(place.iterdir())


def workers(parent: int) -> list[int]:
    """Worker processes of a process (Linux)."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            after_name = (path / "stat").read_text().rpartition(")")[2].split()
            if int(after_name[1]) == parent and b"popen_loky" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
        except OSError:
            continue
    return found
