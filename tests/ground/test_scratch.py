"""What a killed command leaves, and that the next one clears it away."""

import os
import tempfile
from pathlib import Path

import pytest

from bench.ground.scratch import data_folder, owner_prefix, remove_leftovers, use_scratch_folder

HOST = owner_prefix().split(f"-{os.getpid()}-")[0]


def test_temporary_files_lie_in_a_folder_that_goes_with_the_command():
    before = tempfile.gettempdir()
    with use_scratch_folder():
        mine = Path(tempfile.mkdtemp())
        assert mine.parent.parent == data_folder() / "tmp"
        assert mine.parent.name.startswith(owner_prefix())
    assert tempfile.gettempdir() == before and not mine.parent.exists()


def test_only_files_of_dead_processes_of_this_machine_are_removed(tmp_path, dead):
    gone = [tmp_path / f"{HOST}-{dead}-{end}" for end in ("x", "link", "file")]
    kept = [f"{HOST}-{os.getpid()}-x", f"other{HOST}-1-x", f"{HOST}-x-1"]
    kept += [f"{HOST}-{dead}-1-x", f".{HOST}-{dead}-x"]
    for path in (gone[0], *(tmp_path / name for name in kept)):
        path.mkdir()
        (path / "file").write_text("")
    gone[1].symlink_to(tmp_path / kept[0])
    gone[2].write_text("")
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)
    assert all((tmp_path / name / "file").exists() for name in kept)


def test_the_next_command_removes_what_killed_ones_were_writing(dead):
    folders = ("tmp/", "features/.", "corpora/.", "corpora/synth/.", "corpora/mine/.")
    left = [data_folder() / f"{folder}{HOST}-{dead}-abcdefgh" for folder in folders]
    for path in left:
        path.mkdir(parents=True)
        (path / "frames.npy").write_bytes(b"half")
    with use_scratch_folder():
        assert not [path for path in left if path.exists()]


@pytest.mark.skipif(not os.access("/dev/shm", os.W_OK), reason="semaphores are files on Linux")
def test_semaphores_of_dead_processes_go_with_the_next_command(dead):
    left, mine = (Path(f"/dev/shm/sem.loky-{pid}-touchbench") for pid in (dead, os.getpid()))
    try:
        left.touch()
        mine.touch()
        with use_scratch_folder():
            assert not left.exists() and mine.exists()
    finally:
        left.unlink(missing_ok=True)
        mine.unlink(missing_ok=True)
