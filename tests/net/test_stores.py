"""The comparison of two stores finds what differs in the last digit, and nothing in what may differ."""

from pathlib import Path
from urllib.parse import urlparse

import numpy as np
import pandas as pd
import pytest

from bench.store import connect
from bench.tables import file_of, write_table
from tests.net import stores
from tests.net.build import copy, inside
from tests.reports.store import made_up, tracked_run


def files_of(run):
    """The folder of a run's files, in the working folder."""
    return Path(urlparse(run.info.artifact_uri).path.lstrip("/"))


@pytest.fixture(scope="module")
def before(tmp_path_factory, empty_store):
    """A folder with a store of one run."""
    folder = tmp_path_factory.mktemp("stores") / "before"
    folder.mkdir()
    with inside(folder, empty_store):
        table = made_up(subjects=2, per_class=1).assign(note="")
        run = tracked_run(store := connect(), "svm", table, **{"model.C": 8})
        folds = pd.DataFrame({"fold": ["1", "2"], "status": "FINISHED", "accuracy": [1 / 3, 2 / 3], "seconds": 1.0})
        write_table(folds, Path(file_of("folds")))
        store.keep(run, Path(file_of("folds")))
        Path("figure.svg").write_bytes(b"a")
        store.keep(run, Path("figure.svg"))
    return folder


@pytest.fixture
def after(before, tmp_path):
    """A copy of the store to change, its run and the folder of its files."""
    with inside(copy(before, tmp_path / "after")):
        store = connect()
        (run,) = store.of_kind("cell")
        yield store, run.info.run_id, files_of(run)


def compared(capsys, before, code):
    assert stores.main(str(before), ".") == code
    return capsys.readouterr().out.splitlines()


def next_metric(store, run, name):
    store.log(run, {name: np.nextafter(store.client.get_run(run).data.metrics[name], 2)})


def rewritten(path, change):
    change(pd.read_parquet(path)).to_parquet(path, index=False)


DIFFERENCES = {  # changes of the second store, and the words of the one line that tells of each
    "a number in its last digit": (lambda s, r, f: next_metric(s, r, "macro_f1"), "number macro_f1: 0."),
    "a number of a fold in its last digit": (
        lambda s, r, f: rewritten(f / "folds.parquet", lambda t: t.assign(accuracy=[1 / 3, np.nextafter(2 / 3, 2)])),
        "folds.parquet: column accuracy: differs in 1 rows, row 1: 0.666",
    ),
    "a step": (lambda s, r, f: s.log(r, {"macro_f1": 0.5}, step=3), "-> [(0, 0."),
    "a new number": (lambda s, r, f: s.log(r, {"f2": 1}), "number f2 only after"),
    "a tag": (lambda s, r, f: s.log(r, tags={"mixes_subjects": "true"}), "tags mixes_subjects: 'false' -> 'true'"),
    "a parameter": (lambda s, r, f: s.log(r, params={"model.gamma": 1}), "params model.gamma only after"),
    "a status": (lambda s, r, f: s.client.set_terminated(r, "FAILED"), "status: 'FINISHED' -> 'FAILED'"),
    "a missing table": (lambda s, r, f: (f / "per_class.parquet").unlink(), "file per_class.parquet only before"),
    "a text": (
        lambda s, r, f: rewritten(f / "predictions.parquet", lambda t: t.assign(subject="0" + t["subject"])),
        "predictions.parquet: column subject: differs in 6 rows, row 0: '1' -> '01'",
    ),
    "an empty text that is missing": (
        lambda s, r, f: rewritten(f / "predictions.parquet", lambda t: t.assign(note=t["note"].replace("", None))),
        "predictions.parquet: column note: differs in 6 rows, row 0: '' -> ",
    ),
    "a type": (
        lambda s, r, f: rewritten(f / "predictions.parquet", lambda t: t.assign(start=t["start"].astype(str))),
        "predictions.parquet: column start: number -> text",
    ),
    "the order of rows": (
        lambda s, r, f: rewritten(f / "predictions.parquet", lambda t: t.iloc[[1, 0, *range(2, len(t))]]),
        "predictions.parquet: column capture: differs in 2 rows",
    ),
    "the number of rows": (
        lambda s, r, f: rewritten(f / "predictions.parquet", lambda t: t[1:]),
        "'6 rows' -> '5 rows'",
    ),
    "another run": (lambda s, r, f: tracked_run(s, "lda", made_up(2, 1)), "run only after"),
    "a picture": (lambda s, r, f: (f / "figure.svg").write_bytes(b"b"), "figure.svg: 'ca978112ca1b' -> '3e23e8160039'"),
    "a text file": (lambda s, r, f: (f / "stability.md").write_text("new"), "file stability.md only after"),
}


@pytest.mark.parametrize("name", DIFFERENCES)
def test_a_difference_is_told(name, before, after, capsys):
    change, words = DIFFERENCES[name]
    change(*after)
    *told, counts, total = compared(capsys, before, 1)
    assert any(words in line for line in told), told
    assert len(told) == 1 or name == "the order of rows", told
    assert total == f"{len(told)} differences" and counts.startswith("compared: ")


def test_what_may_differ_is_no_difference(before, after, capsys):
    """Other ids, times and places."""
    store, run, files = after
    store.log(run, {"predict_ms_p50": 99.0, "fit_seconds": 0.1, "peak_rss_bytes": 3})
    store.log(run, tags={"touchbench.cell": "other"})
    rewritten(files / "folds.parquet", lambda t: t.assign(seconds=9.0))
    counts, total = compared(capsys, before, 0)[-2:]
    assert total == "0 differences" and "1 runs" in counts


def test_nothing_equals_nothing_is_no_result(tmp_path, empty_store, capsys):
    for name in ("before", "after"):
        (tmp_path / name).mkdir()
        with inside(tmp_path / name, empty_store):
            connect()
    assert stores.main(str(tmp_path / "before"), str(tmp_path / "after")) == 1
    assert capsys.readouterr().out.splitlines()[-2:] == ["compared: nothing", "0 differences"]
