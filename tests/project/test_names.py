"""Gestures and subjects may have any names: every command gives the same numbers.

The new names sort as the old ones do, also where whole numbers come first, as they do for folds:
the order of classes decides ties. No word names a gesture and a subject, so that tables can be
compared under the old names. Random numbers of a subject's sensor depend on the subject's name, so
the fault here is one of single captures.
"""

import csv
import json
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

import bench
from bench.cli import main
from bench.corpora.library import import_corpus
from bench.corpora.read.limits import label_defect
from bench.protocols.subjects import sort_naturally
from bench.reading.reactions import NOTHING
from bench.reading.runs import load_results
from bench.store.client import connect
from tests.conftest import random_corpus
from tests.net.build import inside
from tests.net.masks import MASKED

GESTURES, PEOPLE = ("pat", "rub", "tap"), ("a", "b", "c")
HARD = (
    "1|10|2|03|1.0|-1|1e3|NA|N/A|null|nan|NaN|inf|True|false|true|none.|no one|a,b|"
    'a"b|"|\'|=1+1|#|[x]|{y}|\\|100 %|\u00fc|\u89e6\u308b|\U0001f590|unknown|notouch|quiet|'
    "fold|capture|subject|p_true|labels"
).split("|")
NAMED = (
    "subject",
    "gesture",
    "label",
    "first",
    "fold",
    "true",
    "predicted",
    "value",
)  # columns of names
TEXT = (
    "subject gesture label first fold true predicted factor value kind slice fault amount where "
    "system data subset protocol"
).split()
SCENE = "[reactions]\nboth = {}\n[costs]\nboth = {{ nothing = 0.5 }}\nsilence = 0.7\n"


def write(gestures, people):
    """The same captures under these names, and a scene with a group of the first two gestures."""
    corpus = random_corpus(3, 2, GESTURES, (4, 4), longest=20)
    with open("captures.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["subject", "gesture", "frame", *(f"ch{i}" for i in range(16))])
        for subject, gesture, frames in zip(corpus.subjects, corpus.gestures, corpus, strict=True):
            names = people[int(subject) - 1], gestures[GESTURES.index(gesture)]
            table.writerows([*names, i, *frame.ravel()] for i, frame in enumerate(frames))
    Path("scene.toml").write_text(SCENE.format(json.dumps(gestures[:2], ensure_ascii=False)))


def numbers(table, back):
    """The columns of a table by position, without times; of texts only names, as the old ones."""

    def cell(value, named):
        if isinstance(value, tuple):
            return tuple(cell(one, True) for one in value)
        text = isinstance(value, str)
        return (
            None
            if pd.isna(value) or (text and not named)
            else back.get(value, value)
            if text
            else value
        )

    kept = {name: column for name, column in table.items() if not MASKED.fullmatch(str(name))}
    return [[cell(value, name in NAMED) for value in column] for name, column in kept.items()]


def numbers_of_file(path):
    """The numbers of a CSV file of the report, without names, which may look like numbers."""
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    table = table[~table.eq("predict").any(axis=1)].drop(columns=TEXT, errors="ignore")
    return numbers(table.apply(pd.to_numeric, errors="coerce"), {})


def measured(gestures, people):
    """What run, stress, choose, groups, results and report give under these names."""
    back = dict(zip(people, PEOPLE, strict=True)) | dict(zip(gestures, GESTURES, strict=True))
    write(gestures, people)
    import_corpus("table", Path("captures.csv"), {"name": "arm", "grid": "4x4", "rate_hz": "20"})
    system = {"features": "jung28", "jobs": 1}
    tables = {"run": bench.run(data="arm", model="bayes", **system)}
    tables |= {"stress": bench.stress(data="arm", model="tree", faults="noise", **system)}
    tables |= {"runs": bench.runs(), "groups": bench.groups(data="arm")}
    tables["scene"] = bench.choose(data="arm", scene="scene.toml", by="flash").table
    every = {name: numbers(table, back) for name, table in tables.items()}
    for i, result in enumerate(load_results(connect())):
        every |= {
            (i, name): value for name, value in result.metrics.items() if not MASKED.fullmatch(name)
        }
        every |= {(i, name): numbers(result.tables[name], back) for name in result.tables}
    assert main(["report", "out=page"]) == 0
    for path in sorted(Path("page").glob("*.csv")):
        every[path.name] = numbers_of_file(path)
    return every


def usable(word):
    return not label_defect(word) and word == word.strip() and word != NOTHING


words = st.sampled_from(HARD) | st.text("aé,\"' 0.", min_size=1, max_size=4).filter(usable)
names = st.lists(words, min_size=6, max_size=6, unique=True).map(
    lambda six: (sorted(six[:3]), sorted(six[3:]))
)


@pytest.fixture(scope="module")
def expected(tmp_path_factory, empty_store):
    """The numbers under plain names."""
    with inside(tmp_path_factory.mktemp("plain"), empty_store):
        return measured(GESTURES, PEOPLE)


DRAWN = settings().max_examples // 50  # none but at night
PHASES = [Phase.explicit, *[Phase.generate] * bool(DRAWN)]


@settings(max_examples=max(1, DRAWN), phases=PHASES)
@given(called=names.filter(lambda called: sort_naturally(called[1]) == called[1]))
@example(called=(["NA", "capture", "true"], ["03", "1.0", "null"]))
def test_numbers_are_the_same_under_other_names(expected, called, tmp_path_factory, empty_store):
    with inside(tmp_path_factory.mktemp("names"), empty_store):
        renamed = measured(*called)
    assert renamed.keys() == expected.keys()
    assert {
        name: (renamed[name], value) for name, value in expected.items() if renamed[name] != value
    } == {}
