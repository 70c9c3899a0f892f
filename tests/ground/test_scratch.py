"""What a killed command leaves, and that the next one clears it away."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from bench.ground.scratch import (
    data_folder,
    hold_path,
    remove_leftovers,
    use_scratch_folder,
    write_then_rename,
)

# A process that is killed while it writes a file, and fills a folder
KILLED = """
import os, sys
from pathlib import Path
from bench.ground.scratch import hold_path, use_scratch_folder, write_then_rename
with use_scratch_folder(), hold_path(Path.cwd()) as folder, write_then_rename(Path("a.csv")) as a:
    folder.mkdir()
    (folder / "file").write_text("half")
    a.write_text("half")
    print(*sorted(os.listdir()), flush=True)
    sys.stdin.read()
    os._exit(9)
"""


def begin(*before):
    """Start a process that has begun to write."""
    words = [*before, sys.executable, "-c", KILLED]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert len(process.stdout.readline().split()) >= 4
    return process


def test_temporary_files_lie_in_a_folder_that_goes_with_the_command():
    before = tempfile.gettempdir()
    with use_scratch_folder():
        mine = Path(tempfile.mkdtemp())
        assert mine.parent.parent == data_folder() / "tmp"
    assert tempfile.gettempdir() == before and not mine.parent.exists()
    assert not list((data_folder() / "tmp").iterdir())


def contents():
    """Files and folders of the working folder, and of the scratch folder."""
    folders = Path.cwd(), data_folder() / "tmp"
    return sorted(path.name for folder in folders for path in folder.iterdir())


PLACES = {
    "here": (),
    "another PID namespace, where its number is another one": ("unshare", "--pid", "--fork"),
    "another host name": ("unshare", "--uts", "sh", "-c", 'hostname elsewhere; exec "$@"', "sh"),
}


@pytest.mark.parametrize("place", PLACES)
def test_what_a_process_uses_stays_and_goes_when_it_is_killed_wherever_it_runs(place):
    words = PLACES[place]
    if words and subprocess.run([*words, "true"], capture_output=True).returncode:
        pytest.skip("no namespaces here")
    (data_folder() / "tmp").mkdir(parents=True)
    kept = contents()
    process = begin(*words)
    during = contents()
    with use_scratch_folder():  # of another command
        remove_leftovers(Path.cwd())
        assert {*during} <= {*contents()}
    assert contents() == during
    process.communicate()
    assert contents() == during
    with use_scratch_folder():
        remove_leftovers(Path.cwd())
    assert contents() == kept


def test_files_of_other_names_stay(tmp_path):
    kept = [".hidden", "touchbench-1-x", f".host-{os.getpid()}-x", "a.lock", ".a.lock"]
    for name in kept:
        (tmp_path / name).write_text("")
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)


def test_a_link_that_was_left_goes_and_what_it_names_stays(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / ".touchbench-1-0").symlink_to(tmp_path / "file")
    remove_leftovers(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_next_command_removes_what_killed_ones_were_writing():
    """In the scratch folder whatever its name, such as an earlier version's of another host."""
    kept = ("features", "detectors", "corpora/synth")
    folders = ("tmp/other-host-12-", *(f"{name}/.touchbench-" for name in kept))
    left = [data_folder() / f"{folder}1-abcdefgh" for folder in folders]
    for path in left:
        path.mkdir(parents=True)
        (path / "frames.npy").write_bytes(b"half")
    with use_scratch_folder():
        assert not [path for path in left if path.exists()]


def test_two_writers_of_a_file_do_not_meet(tmp_path):
    with write_then_rename(tmp_path / "a") as one, write_then_rename(tmp_path / "a") as other:
        one.write_text("1")
        other.write_text("2")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text() == "1"
    with pytest.raises(OSError, match="full") as error, write_then_rename(tmp_path / "b"):
        raise OSError(28, "full")
    assert error.value.filename == str(tmp_path / "b")


@pytest.mark.skipif(not os.access("/dev/shm", os.W_OK), reason="semaphores are files on Linux")
def test_semaphores_of_dead_processes_go_with_their_scratch_folders(dead):
    left, mine = (Path(f"/dev/shm/sem.loky-{pid}-touchbench") for pid in (dead, os.getpid()))
    tmp = data_folder() / "tmp"
    try:
        left.touch()
        mine.touch()
        with use_scratch_folder():
            assert left.exists()  # of another container, perhaps
        (tmp / f"touchbench-{dead}-0").mkdir()
        with hold_path(tmp, f"touchbench-{dead}-"):  # of a process of this number in a container
            with use_scratch_folder():
                assert left.exists()
        (tmp / f"touchbench-{dead}-0").mkdir()
        (tmp / f"touchbench-{os.getpid()}-0").mkdir()
        with use_scratch_folder():
            assert not left.exists() and mine.exists()
    finally:
        left.unlink(missing_ok=True)
        mine.unlink(missing_ok=True)
