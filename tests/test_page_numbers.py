"""Numbers of the pages and the table of their commands, docs/notes/numbers.md."""

import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parent.parent / "docs" / "tools"
sys.path.insert(0, str(TOOLS))
import page_numbers  # noqa: E402

sys.path.remove(str(TOOLS))


def test_every_number_is_on_its_page_and_has_a_command():
    entries = page_numbers.entries()
    assert len(entries) > 30
    for one in entries:
        assert one.is_on_page(), f"{one.page} no longer has: {one.text}"
        assert one.numbers and one.commands and one.read.split(", ")[0] in page_numbers.READ, one.text
        assert (one.data == "haart") == ("data=haart" in one.commands[0]), one.text


def test_no_figure_is_written_in_two_ways_but_for_exceptions_that_are_needed():
    assert page_numbers.differently() == []
    found = page_numbers.beside(page_numbers.pages(), page_numbers.reference_figures(), [])
    for page, text, _ in page_numbers.rows(3):
        assert any(line.startswith(page) and text in line for line in found), f"{page}: remove {text}"


def test_a_figure_of_another_measure_and_two_rows_that_differ_are_reported(monkeypatch):
    figures = {"`reflex`": {"cuddlebot": 76.624}, "`lda`": {"haart": 76.62}}
    page = """On CuddleBot `reflex` reaches 76.7 %. It has 76.7 kB; `lda` on `touch` 76.7 %.

| system | accuracy |
| `reflex` without repair | 76.7 |
| `reflex` | 76.6 [76.7, 82.1] |
| `reflex` | 76.5 |
"""
    other, one = page_numbers.beside({"a.md": page}, figures, [])
    assert one.startswith("a.md: 76.7, but `reflex` has 76.6 in cuddlebot: On CuddleBot") and "| 76.5 |" in other
    assert page_numbers.beside({"a.md": page}, figures, [("a.md", "On CuddleBot"), ("a.md", "76.5")]) == []
    read = "reference, haart, reflex, accuracy"
    texts = [("a", ["83.5"]), ("b", ["83"]), ("c", ["83.4"])]
    entries = [page_numbers.Entry(p, "", n, ("leaderboard",), read, "reference") for p, n in texts]
    monkeypatch.setattr(page_numbers, "entries", lambda: entries)
    assert page_numbers.twice() == ["c: 83.4, but a: 83.5; both by bench leaderboard"]


@pytest.mark.parametrize(
    ("written", "now", "same"),
    [
        ("83.2", 83.249, True),
        ("83.2", 83.26, False),
        ("15", 15.4, True),
        ("15", 15.6, False),
        ("765 000", 768_000, True),
        ("765 000", 770_000, False),
        ("a quarter", 21.0, True),
        ("a quarter", 31.0, False),
    ],
)
def test_a_number_agrees_in_its_digits(written, now, same):
    assert page_numbers.agrees(written, now) is same


def test_a_changed_number_and_a_changed_page_are_reported(monkeypatch, capsys):
    page = "docs/notes/tasks.md"
    entry = page_numbers.Entry(page, "HAART, LOSO, 829 captures", ["829"], ("leaderboard",), "captures", "reference")
    gone = page_numbers.Entry(page, "830 captures", ["830"], ("leaderboard",), "captures", "haart")
    monkeypatch.setattr(page_numbers, "entries", lambda: [entry, gone])
    monkeypatch.setattr(page_numbers, "differently", lambda: ["in two ways"])
    for now, verdict, code in ((829.0, "same", 1), (828.0, "DIFFERS", 1)):
        monkeypatch.setattr(page_numbers.Entry, "now", lambda self, now=now: [now])
        assert page_numbers.main([]) == code
        first, second, third = capsys.readouterr().out.splitlines()
        assert first.endswith(verdict) and second.endswith("not on the page") and third == "in two ways"
    assert page_numbers.main(["no such page"]) == 0
