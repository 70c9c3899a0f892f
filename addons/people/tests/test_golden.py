"""What runs of a new person print, and the page of their report; ``--golden`` writes the golden files."""

from pathlib import Path

import pytest

from tests.net import masks
from tests.net.build import PEOPLE, build
from tests.net.build import RUNS as CORE

GOLDEN = Path(__file__).parent / "golden"
ONE = ["features=jung28", "protocol=personal", "protocol.draws=1"]
RUNS = {
    "corpora": CORE["corpora"],
    "personal": [
        ["run", *PEOPLE, "model=lda", *ONE, "protocol.shots=0,1"],
        ["run", *PEOPLE, "model=bayes", *ONE, "protocol.shots=1"],
        ["run", *PEOPLE, "model=adaptable", *ONE, "protocol.weight=0"],
        ["run", *PEOPLE, "model=lda", "features=jung28", "protocol=transfer", "protocol.source=three"],
        ["run", *PEOPLE, "protocol=transfer"],
        ["choose", "data=people", "protocol=personal", "protocol.shots=1"],
        ["report"],
        ["adapt", "--help"],
    ],
}


@pytest.fixture
def golden(request, tmp_path, empty_store):
    """Compare a text with the golden file of a name, or write it."""

    def compared(name, text):
        path, text = GOLDEN / name, masks.lines_of(text, (tmp_path / "net",))
        if request.config.getoption("golden"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        assert text == path.read_text()

    return compared


def test_runs_of_a_new_person_print_what_they_printed(golden, tmp_path, empty_store):
    folder = tmp_path / "net"
    build(folder, RUNS, empty_store)
    golden("personal.txt", (folder / "printed" / "personal.txt").read_text())
    page = (folder / "report" / "index.html").read_text()
    assert "1 labelled capture of each class changes the" in page and page.count("<h2>People") == 1
