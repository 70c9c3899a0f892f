"""A data folder that cannot be used: one line with the reason and the folder, never a traceback."""

import errno
import os
import shutil
import tempfile
from pathlib import Path

import pytest

from bench.cli import main
from bench.errors import StoreError
from bench.ground.scratch import data_folder, write_then_rename
from bench.store.client import report_store_errors


def remove_folder():
    shutil.rmtree(data_folder())
    tempfile.mkdtemp()  # as many libraries do


def fill_disk():
    with write_then_rename(data_folder() / "reference.json"):
        raise OSError(errno.ENOSPC, "No space left on device")


def copy_folder():
    place = str(data_folder() / "tmp" / "code")
    raise shutil.Error([("here", place, "[Errno 13] Permission denied: 'here'")])


def copy_file():
    file = str(data_folder() / "locks" / "a")
    raise OSError(errno.EACCES, "Permission denied", "here", None, file)


FAILURES = {
    remove_folder: (2, "No such file or directory"),
    fill_disk: (1, "no space is left"),
    copy_folder: (2, "Permission denied"),
    copy_file: (2, "Permission denied"),
}


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("within", ["", "store"])
def test_a_data_folder_that_fails_is_one_line(failure, within, monkeypatch, capsys):
    def command(_):
        with report_store_errors() if within else open(os.devnull):
            failure()

    monkeypatch.setattr("bench.commands.data.command", command)
    code, reason = FAILURES[failure]
    assert main(["data"]) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line and str(data_folder()) in line and "failed" not in line


def test_a_full_store_is_named_and_not_the_data_folder():
    """A table is copied from a temporary file into the store."""
    source, target = str(data_folder() / "tmp" / "a.parquet"), "mlruns/1/a.parquet"
    error = OSError(errno.ENOSPC, "No space left on device", source, None, target)
    with pytest.raises(StoreError, match=f"No space left on device: {target}") as raised:
        with report_store_errors():
            raise error
    assert str(data_folder()) not in str(raised.value)


def test_errors_of_other_places_stay_what_they_are(monkeypatch):
    def command(_):
        Path("nowhere/file").read_text()

    monkeypatch.setattr("bench.commands.data.command", command)
    with pytest.raises(FileNotFoundError):
        main(["data"])
