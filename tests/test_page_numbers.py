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
    page = "docs/leaderboard.md"
    entry = page_numbers.Entry(page, "HAART, LOSO, 829 captures", ["829"], ("leaderboard",), "captures", "reference")
    gone = page_numbers.Entry(page, "830 captures", ["830"], ("leaderboard",), "captures", "haart")
    monkeypatch.setattr(page_numbers, "entries", lambda: [entry, gone])
    for now, verdict, code in ((829.0, "same", 1), (828.0, "DIFFERS", 1)):
        monkeypatch.setattr(page_numbers.Entry, "now", lambda self, now=now: [now])
        assert page_numbers.main([]) == code
        first, second = capsys.readouterr().out.splitlines()
        assert first.endswith(verdict) and second.endswith("not on the page")
    assert page_numbers.main(["no such page"]) == 0
