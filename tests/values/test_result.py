"""A result as a value, its tables, and the footnotes of systems."""

import pandas as pd
import pytest

from bench.errors import InputError
from bench.ground.registry import notes_by_design
from bench.plan.grid import make_cells
from bench.values.result import (
    BATCH_NOTE,
    JOINED_NOTE,
    KEPT_ROWS,
    Failure,
    Result,
    RunTables,
    footnotes_of_system,
)

DESIGNED = notes_by_design("features")["touch"][1]


def test_a_result_is_a_mapping_and_knows_its_folds():
    attributes = {"system": "s", "seed": "1", "data": "d", "synthetic": "true", "subset": "all"}
    attributes |= {"target": "gesture", "protocol_label": "LOSO", "touchbench.kind": "cell"}
    attributes |= {"status": "FAILED", "accuracy": "text"}
    errors = {"f": Failure("ValueError: no", "traceback")}
    metrics = {"accuracy": 0.5, "folds": 2, "folds_failed": 1}
    result = Result(attributes, metrics, {}, errors)
    assert result["accuracy"] == dict(result)["accuracy"] == 0.5  # a number before text
    assert (result.system_with_seed, result.folds) == ("s, seed 1", "2/3")
    assert result.context == ("d (synthetic)", "all", "LOSO")
    assert not result.is_complete and result.predicts_alone and result.has_scores


def test_tables_are_read_when_they_are_needed():
    sizes, names_read = {"small": 3, "large": KEPT_ROWS + 1}, []

    def read(name, columns=()):
        names_read.append(name)
        return pd.DataFrame({"n": range(sizes[name])}) if name in sizes else None

    in_memory = {"kept": pd.DataFrame({"n": [1]})}
    tables = RunTables(in_memory, read, "s (run 7) is missing", lambda: [*sizes])
    assert [*tables] == ["small", "large", "kept"] and not names_read
    assert all(len(tables[name]) for name in ("kept", "small", "small", "large", "large"))
    assert names_read == ["small", "large", "large"]  # large ones do not stay in memory
    with pytest.raises(InputError, match=r"none of s \(run 7\) is missing"):
        tables["none"]
    assert "none" not in tables and tables.get("none", 0) == 0
    assert tables.read_columns("small", ["n"])[0].tolist() == [0, 1, 2]
    assert tables.read_columns("none", []) is None


@pytest.mark.parametrize(
    ("system", "data", "notes"),
    [
        ("reflex", "haart", [DESIGNED]),
        ("reflex", "haart-part+synth", [DESIGNED, JOINED_NOTE]),
        ("reflex", "synth", []),
        ("lda[C=1] · touch", "haart", [DESIGNED]),
        ("SVC(C=5) · touch, seed 1", "haart", [DESIGNED]),
        ("tuned rocket[kernels=1|2]", "haart", [DESIGNED]),
        ("auto[features=jung54+touch]", "haart", [DESIGNED]),
        ("lda · jung54 †", "haart", [BATCH_NOTE]),
        ("lda · my.touch", "haart", []),
        ("my.reflex · jung54", "haart", []),
        ("touch() · Touch()", "haart", []),
    ],
)
def test_footnotes_of_a_system(system, data, notes):
    assert footnotes_of_system(system, data) == notes


def test_a_system_of_a_user_with_the_name_of_a_part_of_ours_has_no_footnote(tmp_path):
    path = tmp_path / "my.py"
    path.write_text(
        "from sklearn.dummy import DummyClassifier as Dummy\n"
        "def touch():\n    return Dummy()\n"
        "def reflex():\n    return Dummy()\n"
    )
    names = f"{path}:touch,{path}:reflex,reflex"
    cells = make_cells({"model": names, "features": "jung54"})
    notes = {cell.system_name(): footnotes_of_system(cell.system_name(), "haart") for cell in cells}
    assert notes == {"touch · jung54": [], "my.reflex · jung54": [], "reflex": [DESIGNED]}
