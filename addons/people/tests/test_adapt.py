"""``bench adapt``: the saved system predicts as one adapted by hand; mistakes are one line."""

from pathlib import Path

import numpy as np
import pandas as pd

from bench.cli import main
from bench.corpora.library import open_corpus
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.recipe import Recipe
from bench.running.saved import Recogniser, load_recogniser
from tests.conftest import random_corpus
from tests.net.build import step
from tests.running.fakes import Level
from touchbench_people.adaptation import adapt_system
from touchbench_people.commands import count_right_left_out

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
        assert main(["adapt", "rec", f"{name}.csv", f"out={name}", "anyway=yes"]) == 0
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


def test_a_model_that_gets_worse_without_each_capture_is_written_if_asked_only(capsys, monkeypatch):
    corpus = random_corpus(subjects=3, per_class=4, grid=(4, 4), longest=60)
    train, own = (np.flatnonzero((corpus.subjects == "3") == is_own) for is_own in (False, True))
    general = Recipe(lda(TouchFeatures())).fit(corpus[train], corpus.gestures[train])
    rec, part = Recogniser(general, corpus[train]), corpus[own]
    labels = part.gestures.astype(str)
    right = []
    for i in range(len(own)):  # left out by hand
        rest = np.delete(np.arange(len(own)), i)
        adapted = adapt_system(general, part[rest], labels[rest])
        right.append(adapted.predict(part[[i]])[0] == labels[i])
    before = (general.predict(part) == labels).sum()
    assert count_right_left_out(rec, part, labels) == (before, sum(right))

    assert main(["fit", *SMALL, "model=lda", "features=touch", "out=rec"]) == 0
    synth = open_corpus("synth", {"subjects": 4, "rate_hz": 30.0})
    rows = np.flatnonzero((synth.subjects == "4") & np.isin(synth.gestures, ["pat", "rub"]))[:4]
    write_rows(synth, rows, "few.csv", gesture=synth.gestures)
    capsys.readouterr()
    count = "touchbench_people.commands.count_right_left_out"
    with monkeypatch.context() as patch:
        patch.setattr(count, lambda *_: (4, 3))
        assert main(["adapt", "rec", "few.csv", "out=new"]) == 1 and not Path("new").exists()
        assert "it gets worse: of 4 captures, each left out, it labels 3" in capsys.readouterr().out
        assert main(["adapt", "rec", "few.csv", "out=new", "anyway=yes"]) == 0
        patch.setattr(count, lambda *_: (3, 3))
        capsys.readouterr()
        assert main(["adapt", "rec", "few.csv", "out=equal"]) == 0 and Path("equal").exists()
        assert "no gain is shown" in capsys.readouterr().out
    write_rows(synth, rows[:1], "one.csv", gesture=synth.gestures)  # nothing remains to adapt to
    assert main(["adapt", "rec", "one.csv", "out=one"]) == 0
    assert "of one capture, nobody knows" in capsys.readouterr().out
    write_rows(synth, rows, "few.csv")
    assert main(["adapt", "rec", "few.csv", "out=other"]) == 0
    assert "nobody knows" in capsys.readouterr().out
