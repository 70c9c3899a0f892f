"""Printed output of runs of a new person, as golden files (``--golden`` writes them)."""

from tests.net.build import PEOPLE, RUNS, build
from tests.reports.conftest import quick  # noqa: F401

ONE = ["features=jung28", "protocol=personal", "protocol.draws=1"]
COMMANDS = [
    ["run", *PEOPLE, "model=lda", *ONE, "protocol.shots=0,1"],
    ["run", *PEOPLE, "model=bayes", *ONE, "protocol.shots=1"],
    ["run", *PEOPLE, "model=adaptable", *ONE, "protocol.weight=0"],
    ["run", *PEOPLE, "model=lda", "features=jung28", "protocol=transfer", "protocol.source=three"],
    ["run", *PEOPLE, "protocol=transfer"],
    ["choose", "data=people", "protocol=personal", "protocol.shots=1"],
    ["report"],
    ["adapt", "--help"],
]


def test_runs_of_a_new_person_print_what_they_printed(golden, quick, tmp_path, empty_store):  # noqa: F811
    folder = tmp_path / "net"
    build(folder, {"corpora": RUNS["corpora"], "personal": COMMANDS}, empty_store)
    golden("personal.txt", (folder / "printed" / "personal.txt").read_text())
    page = (folder / "report" / "index.html").read_text()
    assert "1 labelled capture of each class changes the" in page and page.count("<h2>People") == 1
