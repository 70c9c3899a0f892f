"""Names that may mean the same: one function decides, and every way in asks it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.spellings import (
    background_doubts,
    find_background_words,
    find_same_names,
    known_spelling,
    may_be_same,
    unify_spellings,
)

SAME = [
    ("1", "01"),
    ("1", "1.0"),
    ("1", "1,0"),
    ("1", "(1)"),
    ("1", "１"),
    ("P1", "P01"),
    ("P-1", "P_1"),
    ("P1", "1"),
    ("01", "p 1"),
    ("subject1", "S1"),
    ("sub-01", "sub-1"),
    ("g1_p01", "g1_p1"),
    ("[tap]", "tap"),
    ("“tap”", "'tap'"),
    ("b'tap'", "tap"),
    ("double-tap", "DoubleTap"),
    ("José", "JosÃ©"),
    ("José", "Jos√©"),
    ("José", "Jose"),
    ("José", "Jos?"),
    ("José", "Jos\ufffd"),
    ("tap", "t\u0430p"),  # a Cyrillic letter
]
DIFFERENT = [
    ("1", "10"),
    ("1", "-1"),
    ("1", "1.1"),
    ("1.5", "15"),
    ("1-2", "12"),
    ("A1", "B1"),
    ("P1", "S1"),
    ("tap", "tap2"),
    ("tap", "pat"),
    ("c+", "c"),
    ("+", "-"),
    ("?", "a"),
    ("haart 1", "cuddlebot 1"),
    ("other 1", "1"),
    ("s1t1", "s1t2"),
]


@pytest.mark.parametrize("pair", SAME)
def test_spellings_of_one_name(pair):
    assert may_be_same(*pair) and may_be_same(*pair[::-1])
    assert find_same_names(["rub", *pair]) == [sorted(pair)]
    assert known_spelling(pair[0], ["rub", pair[1]]) == pair[1]


@pytest.mark.parametrize("pair", DIFFERENT)
def test_different_names(pair):
    assert not may_be_same(*pair) and not may_be_same(*pair[::-1])
    assert find_same_names(pair) == [] and known_spelling(pair[0], pair[1:]) is None


WORDS = st.text("abcdefgh", min_size=2, max_size=8)
JOINTS = st.sampled_from([" ", "", "-", "_", ".", " 00", "-0"])
ENDS = st.sampled_from(["", ".0", ",00"])
CHANGES = [str.upper, str.title, "[{}]".format, "'{}'".format, " {}_".format, '("{}")'.format]


@given(WORDS, st.integers(0, 10**6), JOINTS, ENDS, st.lists(st.sampled_from(CHANGES), max_size=4))
def test_any_change_of_spelling_is_seen_and_another_number_is_another_name(
    word, number, joint, end, changes
):
    name, spelt = f"{word} {number}", f"{word}{joint}{number}{end}"
    for change in changes:
        spelt = change(spelt)
    assert may_be_same(name, spelt)
    assert not may_be_same(f"{word} {number + 1}", spelt)


def test_lists_are_unified_under_the_first_spelling_and_no_list_is_merged_within():
    lists = [["tap", "hold"], ["Tap", "rub"], ["TAP", "tap", "[rub]", "Hold", "HOLD"]]
    assert unify_spellings(lists) == [{}, {"Tap": "tap"}, {"[rub]": "rub"}]


@pytest.mark.parametrize("word", "0 0.0 NaN NULL none Rest - idle <NA> N/A background".split())
def test_words_for_no_touch(word):
    assert find_background_words(["tap", word]) == {word}
    assert find_background_words(["tap", f"{word}x7"]) == set()
    if word in ("0", "Rest", "idle"):
        assert find_background_words(["tap", word, ""]) == {""}
        (line,) = background_doubts({"tap": 5, word: 3, "": 9})
        assert "(3 frames) is read as a gesture" in line
    else:
        assert word == "none" or background_doubts({word: 3}) == [
            f"label {word!r} (3 frames) is read as background; if it is a gesture, rename it"
        ]
