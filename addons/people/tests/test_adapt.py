"""``bench adapt``: the saved system predicts as one adapted by hand; mistakes are one line."""

from pathlib import Path

import numpy as np
import pandas as pd

from bench.cli import main
from bench.corpora.library import open_corpus
from bench.running.saved import Recogniser, load_recogniser
from tests.net.build import step
from tests.running.fakes import Level
from touchbench_people.adaptation import adapt_system

SMALL = ["data=synth", "data.subjects=4", "data.rate_hz=30", "stopping=no"]
SMALL += ["where=gesture in ['pat', 'rub', 'grab'] and subject != '4'"]
WRONG = [
    "fixed alone.csv out=new",
    "labelled labelled.csv out=new",
    "rec partly.csv out=new",
    "rec two.csv out=new",
    "rec other.csv out=new",
    "rec alone.csv out=rec",
    "rec alone.csv out=new rate_hz=54",
]


def write_rows(corpus, rows, path, **columns):
    """Write some captures as a table with one row per frame."""
    parts = []
    for i in rows:
        values = corpus[int(i)].reshape(corpus.lengths[i], -1)
        frames = pd.DataFrame(values, columns=[f"ch{k + 1}" for k in range(values.shape[1])])
        labels = {name: values[i] for name, values in columns.items()}
        labels |= {"capture": str(i), "frame": range(len(frames))}
        parts.append(pd.concat([pd.DataFrame(labels, index=frames.index), frames], axis=1))
    pd.concat(parts).to_csv(path, index=False)


def test_a_saved_system_is_adapted_as_by_hand_and_mistakes_are_one_line(golden, monkeypatch):
    corpus = open_corpus("synth", {"subjects": 4, "rate_hz": 30.0})
    is_own = (corpus.subjects == "4") & np.isin(corpus.gestures, ["pat", "rub", "grab"])
    rows = np.flatnonzero(is_own)
    part, rest = corpus[rows[::2]].detach(), corpus[rows[1::2]]
    assert main(["fit", *SMALL, "model=lda", "features=touch", "out=rec"]) == 0
    general = load_recogniser("rec").estimator
    before = general.predict_proba(rest)
    write_rows(corpus, rows[::2], "labelled.csv", gesture=corpus.gestures)
    write_rows(corpus, rows[::2], "alone.csv")
    for name, labels in (("labelled", part.gestures), ("alone", None)):
        assert main(["adapt", "rec", f"{name}.csv", f"out={name}"]) == 0
        expected = adapt_system(general, part, labels).predict_proba(rest)
        found = load_recogniser(name).estimator.predict_proba(rest)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        assert not np.array_equal(found, before)
    np.testing.assert_array_equal(load_recogniser("rec").estimator.predict_proba(rest), before)
    pins = [Path(name, "requirements.txt").read_text().split() for name in ("rec", "labelled")]
    assert pins[0] == pins[1] and pins[0]

    few, labels = rows[:4], np.where(np.arange(len(corpus)) == rows[0], "", corpus.gestures)
    write_rows(corpus, few, "partly.csv", gesture=labels)
    write_rows(corpus, few, "two.csv", subject=np.arange(len(corpus)).astype(str))
    write_rows(corpus, few, "other.csv", gesture=np.full(len(corpus), "poke"))
    fixed = Recogniser(Level().fit(rest, rest.gestures), corpus)
    monkeypatch.setattr(
        "bench.commands.predict.load_recogniser",
        lambda model: fixed if model == "fixed" else load_recogniser(model),
    )
    golden("refusals.txt", "".join(step(["adapt", *words.split()]) for words in WRONG))
    assert not Path("new").exists()
