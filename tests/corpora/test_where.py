"""Conditions on captures: the same as pandas' queries where they are allowed, and nothing but conditions."""

import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.corpora.where import chosen
from bench.errors import InputError

WORDS = ["pat", "rub", "slap", "a b", "", "é", "p", "'", "&", "or"]


def table(seed=0, rows=12):
    """Text with and without gaps, whole numbers, floats with gaps, truth; names with a space and with an accent."""
    rng = np.random.default_rng(seed)
    floats = rng.integers(-4, 5, rows) / 2
    floats[rng.random(rows) < 0.3] = np.nan
    gaps = pd.Series(rng.choice(WORDS, rows)).where(rng.random(rows) < 0.7)
    return pd.DataFrame(
        {
            "subject": rng.choice(["1", "2", "10"], rows),
            "gesture": rng.choice(WORDS, rows),
            "cover": gaps,
            "n": rng.integers(-3, 4, rows),
            "two words": rng.integers(0, 3, rows),
            "épaisseur": floats,
            "flag": rng.random(rows) < 0.5,
        }
    )


def corpus(captures):
    frames = [np.ones((1, 2, 2), np.uint16)] * len(captures)
    return Corpus.from_captures(frames, captures, 100.0, name="arm")


def pandas_says(text, captures):
    """Its mask, or None where it finds none."""
    try:
        mask = captures.eval(text, engine="python")
    except Exception:
        return None
    return mask.to_numpy() if isinstance(mask, pd.Series) and mask.dtype == bool else None


def test_the_same_as_pandas():
    examples = [
        "subject == '1' and n > 1",
        "subject == '1' & n > 1 | flag",  # & and | bind as and and or do
        "not subject == '1'",
        "~flag or n in [1, 2]",
        "-1 < n <= 2",
        "['pat'] != gesture",
        "`two words` * 2 - n // 2 >= 3 % 2 + n / 4",
        "épaisseur.between(-1, 0.5) and épaisseur == épaisseur",
        "épaisseur != épaisseur",
        "cover != 'pat'",
        "gesture.str.startswith('p') | gesture.str.endswith('b') and cover.isin(('pat', 'rub'))",
        "n % 2 in [0, -1] or gesture not in ['pat', \"'\"] | ~(flag and `two words` != 1)",
        "-(n * 2) <= épaisseur / -1.5 and n.isin([1, -2, 0.5]) or subject < '2'",
        "gesture == '&' or gesture == \"'\"",
    ]
    for text in examples:
        captures = table(3, 60)
        before = captures.copy()
        theirs = pandas_says(text, captures)
        assert theirs is not None and theirs.any(), text
        assert np.array_equal(chosen(text, captures, "arm"), theirs), text
        pd.testing.assert_frame_equal(captures, before)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("n ==", "invalid syntax"),
        ("n == 1 and flagg", "no column 'flagg'; the columns of arm are subject, gesture"),
        ("n == 1 & x.y", "'x.y' cannot be used"),
        ("n", "not a condition"),
        ("not n", "'not n' cannot be used"),
        ("flag and True", "'flag and True' cannot be used"),
        ("n == 99", "selects none of the 12 captures of arm"),
        ("subject == '1", "unterminated string"),
        ("n == 1 # so", "a comment"),
        ("subject in '1'", "is not a list"),
        ("subject < 1", "cannot be computed"),
        ("flag + 1 > 1", "'flag + 1' cannot be used"),
        ("n in [1, n]", "is not a list"),
        ("", "invalid syntax"),
        ("n == 1 or " * 1001, "has 10010 characters"),
        ("(" * 150 + "n" + ")" * 150 + " == 1 and", "invalid syntax"),
        ("~" * 9000 + "flag", "too deeply nested"),
        ("'" * 9999, "unterminated"),
        ("n == 1\0", "null byte"),
    ],
)
def test_what_is_refused_is_named(text, reason):
    with pytest.raises(InputError) as refused:
        corpus(table()).select(text)
    assert reason in str(refused.value) and len(str(refused.value)) <= 300, str(refused.value)


ATTEMPTS = [
    # those of the review
    "n.__init__.__func__.__globals__['sys'].modules['os'].system('touch stolen') == n",
    "n.to_csv('stolen') == n",
    # code
    "@os.system('touch stolen') == 0",
    "__import__('os').system('touch stolen') == n",
    "open('stolen', 'w') == n",
    "(lambda: n)() == n",
    "f'{n.to_csv(\"stolen\")}' == gesture",
    "n.isin(*[[1]])",
    # attributes, parts and other methods
    "n.__class__ == 1",
    "n[0] == 1",
    "gesture.str.startswith('p').to_csv('stolen') == n",
    "gesture.str.contains('(a+)+$', regex=True)",
    "gesture.str.startswith(n.to_csv('stolen'))",
    "n.isin([n.to_csv('stolen')])",
    "index > 1",
    # time and memory
    "10**10**10 > n",
    "'a' * 10**9 == gesture",
    "n & 1 == 1 == n | 2",
    "1" * 5000 + " > n",
]


@pytest.mark.parametrize("text", ATTEMPTS)
def test_a_condition_can_do_nothing_else(text, tmp_path, monkeypatch):
    monkeypatch.setattr("os.system", lambda *_: pytest.fail("a command was run"))
    made = corpus(table())
    before = made.captures.copy()
    started = time.perf_counter()
    with pytest.raises(InputError) as refused:
        made.select(text)
    assert time.perf_counter() - started < 2
    message = str(refused.value)
    assert len(message) <= 300 and "\n" not in message and message.startswith("where=")
    assert "allowed on columns" in message or "the columns of arm are" in message
    pd.testing.assert_frame_equal(made.captures, before)
    assert all(made.captures[c].name == c for c in made.captures)
    assert not list(tmp_path.iterdir()) and not Path("stolen").exists()
