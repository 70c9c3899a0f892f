"""A saved system for one person: what is saved decides as one adapted by hand; mistakes are one line."""

from pathlib import Path

import numpy as np
import pandas as pd

from bench.cli import main
from bench.corpora.library import open_corpus
from bench.running.saved import Recogniser, load
from tests.net.build import step
from tests.running.fakes import Level
from touchbench_people.adaptation import adapted

SMALL = [
    "data=synth",
    "data.subjects=4",
    "data.rate_hz=30",
    "where=gesture in ['pat', 'rub', 'grab'] and subject != '4'",
    "stopping=no",
]


WRONG = [
    "fixed alone.csv out=new",
    "labelled labelled.csv out=new",
    "rec partly.csv out=new",
    "rec two.csv out=new",
    "rec other.csv out=new",
    "rec alone.csv out=rec",
    "rec alone.csv out=new rate_hz=54",
]


def written(corpus, rows, path, **labels):
    """Some captures as a table with one row per frame."""
    parts = []
    for i in rows:
        frames = pd.DataFrame(corpus[int(i)].reshape(corpus.lengths[i], -1)).rename(
            columns=lambda k: f"ch{k + 1}"
        )
        columns = {"capture": str(i), "frame": range(len(frames))} | {
            k: v[i] for k, v in labels.items()
        }
        parts.append(
            pd.concat([pd.DataFrame(columns, index=frames.index), frames], axis=1)
        )  # channels come last
    pd.concat(parts).to_csv(path, index=False)
    return str(path)


def test_with_labels_or_without_it_decides_as_one_adapted_by_hand_and_mistakes_are_one_line(
    golden, monkeypatch
):
    corpus = open_corpus("synth", {"subjects": 4, "rate_hz": 30.0})
    rows = np.flatnonzero(
        (corpus.subjects == "4") & np.isin(corpus.gestures, ["pat", "rub", "grab"])
    )
    shown, rest = rows[::2], rows[1::2]
    assert main(["fit", *SMALL, "model=lda", "features=touch", "out=rec"]) == 0
    general = load("rec").estimator
    before = general.predict_proba(corpus[rest])
    files = {"labelled": written(corpus, shown, "labelled.csv", gesture=corpus.gestures)}
    files["alone"] = written(corpus, shown, "alone.csv")
    for name, file in files.items():
        assert main(["adapt", "rec", file, f"out={name}"]) == 0
        part = corpus[shown].detached()
        by_hand = adapted(general, part, part.gestures if name == "labelled" else None)
        found = load(name).estimator.predict_proba(corpus[rest])
        np.testing.assert_allclose(found, by_hand.predict_proba(corpus[rest]), atol=1e-9)
        assert not np.array_equal(found, before)
    np.testing.assert_array_equal(load("rec").estimator.predict_proba(corpus[rest]), before)
    pins = [Path(name, "requirements.txt").read_text().split() for name in ("rec", "labelled")]
    assert pins[0] == pins[1] and pins[0]

    few, labels = rows[:4], np.where(np.arange(len(corpus)) == rows[0], "", corpus.gestures)
    written(corpus, few, "partly.csv", gesture=labels)
    written(corpus, few, "two.csv", subject=np.arange(len(corpus)).astype(str))
    written(corpus, few, "other.csv", gesture=np.full(len(corpus), "poke"))
    fixed = Recogniser(Level().fit(corpus[rest], corpus.gestures[rest]), corpus)
    monkeypatch.setattr(
        "bench.running.saved.load", lambda model: fixed if model == "fixed" else load(model)
    )
    golden("refusals.txt", "".join(step(["adapt", *words.split()]) for words in WRONG))
    assert not Path("new").exists()
