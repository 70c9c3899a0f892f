"""Conditions on captures give what pandas' queries give, and can do nothing else."""

import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.corpora.where import where_mask
from bench.errors import InputError

WORDS = ["pat", "rub", "slap", "a b", "", "é", "p", "'", "&", "or"]


@pytest.fixture
def captures():
    """Text, whole numbers, floats and truth values, some with gaps; two unusual names."""
    rng = np.random.default_rng(3)
    table = pd.DataFrame({name: rng.choice(WORDS, 60) for name in ("subject", "gesture", "cover")})
    table = table.assign(
        subject=rng.choice(["1", "2", "10"], 60),
        n=rng.integers(-3, 4, 60),
        flag=rng.random(60) < 0.5,
    )
    table["two words"], table["épaisseur"] = rng.integers(0, 3, 60), rng.integers(-4, 5, 60) / 2
    return table.assign(
        **{name: table[name].where(rng.random(60) < 0.7) for name in ("cover", "épaisseur")}
    )


@pytest.mark.parametrize(
    "text",
    [
        "subject == '1' & n > 1 | flag",  # & and | bind as and and or do
        "~flag or not subject == '1' and -1 < n <= 2",
        "`two words` >= n and -2 < n",
        "épaisseur.between(-1, 0.5) and épaisseur == épaisseur and cover != 'pat'",
        "gesture.str.startswith('p') | gesture.str.endswith('b') and cover.isin(('pat', 'rub'))",
        "n in [0, -1] or gesture not in ['pat', \"'\"] | ~(flag and `two words` != 1)",
        "n <= épaisseur and n.isin([1, -2, 0.5]) or subject < '2'",
        "gesture == '&' or ['pat'] != gesture",
    ],
)
def test_the_same_as_pandas(captures, text):
    theirs = captures.eval(text, engine="python").to_numpy()
    assert theirs.any() and np.array_equal(where_mask(text, captures, "arm"), theirs)


REFUSED = [
    ("n ==", "invalid syntax"),
    ("n == 1 and flagg", "no column 'flagg'; the columns of arm are subject, gesture"),
    ("flag and True", "'True' cannot be used"),
    ("n == 99", "selects none of the 60 captures of arm"),
    ("subject == '1", "unterminated string"),
    ("subject in '1'", "is not a list"),
    ("subject < 1", "subject holds text; write '1'"),
    ("subject != 1", "subject holds text; write '1'"),
    ("1 == subject", "subject holds text; write '1'"),
    ("subject in ['1', 2]", "subject holds text; write '2'"),
    ("subject not in [10.0]", "subject holds text; write '10'"),
    ("subject.isin([1])", "subject holds text; write '1'"),
    ("subject.between(1, 2)", "subject holds text; write '1'"),
    ("subject != '01'", "subject has no '01'; write '1'"),
    ("gesture not in ['Pat']", "gesture has no 'Pat'; write 'pat'"),
    ("n != '1'", "n holds numbers; write 1"),
    ("n != subject", "one holds text, the other numbers"),
    ("~" * 9000 + "flag", "too deeply nested"),
    ("n == 1\0", "null byte"),
    ("n == 1 # or n == 2", "a comment cannot be used"),
    ("n == 1) or (n == 2", "unmatched ')'"),
]
ATTACKS = [
    "n.__init__.__func__.__globals__['sys'].modules['os'].system('touch stolen') == n",
    "@os.system('touch stolen') == 0",
    "(lambda: n)() == n",
    "f'{n.to_csv(\"stolen\")}' == gesture",
    "n.isin(*[[1]])",
    "gesture.str.contains('(a+)+$', regex=True)",
    "n.isin([n.to_csv('stolen')])",
    "10**10**10 > n",
    "n & 1 == 1 == n | 2",
    "1" * 5000 + " > n",
]


@pytest.mark.parametrize(
    ("text", "reason"), [*REFUSED, *((text, "allowed on columns") for text in ATTACKS)]
)
def test_a_condition_that_is_none_is_refused_in_a_line_and_does_nothing(captures, text, reason):
    before, started = captures.copy(), time.perf_counter()
    with pytest.raises(InputError) as refused:
        where_mask(text, captures, "arm")
    message = str(refused.value)
    assert time.perf_counter() - started < 2 and message.startswith("where=")
    assert reason in message and len(message) <= 300 and "\n" not in message, message
    pd.testing.assert_frame_equal(captures, before)
    assert not Path("stolen").exists()
