"""A saved system for one person: what is saved decides as one adapted by hand; mistakes are one line."""

import numpy as np
import pandas as pd
import pytest

from bench import contract
from bench.cli import main
from bench.corpora.library import open_corpus
from bench.work.saved import load

SMALL = ["data=synth", "data.subjects=4", "where=gesture in ['pat', 'rub', 'grab'] and subject != '4'"]


def written(corpus, rows, path, **labels):
    """Some captures as a table with one row per frame."""
    parts = []
    for i in rows:
        frames = pd.DataFrame(corpus[int(i)].reshape(corpus.lengths[i], -1)).rename(columns=lambda k: f"ch{k + 1}")
        about = {"capture": str(i), "frame": range(len(frames))} | {k: v[i] for k, v in labels.items()}
        parts.append(pd.concat([pd.DataFrame(about, index=frames.index), frames], axis=1))  # channels come last
    pd.concat(parts).to_csv(path, index=False)
    return str(path)


@pytest.fixture
def person(tmp_path):
    corpus = open_corpus("synth", {"subjects": 4})
    own = np.flatnonzero((corpus.subjects == "4") & np.isin(corpus.gestures, ["pat", "rub", "grab"]))
    return corpus, own


def test_with_labels_or_without_it_decides_as_one_adapted_by_hand(person, tmp_path, capsys):
    corpus, own = person
    known, rest = own[::2], own[1::2]
    labelled = written(corpus, known, tmp_path / "known.csv", gesture=corpus.gestures)
    alone = written(corpus, known, tmp_path / "alone.csv")
    model = str(tmp_path / "rec")
    assert main(["fit", *SMALL, "model=lda", "features=touch", f"out={model}"]) == 0
    general = load(model).estimator
    before = general.predict_proba(corpus[rest])
    asked = {"own": (labelled, [], True), "no": (labelled, ["labels=no"], False), "alone": (alone, [], False)}
    for name, (path, more, with_labels) in asked.items():
        assert main(["adapt", model, path, *more, f"out={tmp_path / name}"]) == 0
        assert f"adapted to {len(known)} captures with" in capsys.readouterr().out
        part = corpus[known].detached()
        by_hand = contract.adapted(general, part, part.gestures if with_labels else None)
        found = load(str(tmp_path / name)).estimator.predict_proba(corpus[rest])
        np.testing.assert_allclose(found, by_hand.predict_proba(corpus[rest]), atol=1e-9)
        assert not np.array_equal(found, before)
    assert main(["adapt", str(tmp_path / "own"), labelled, f"out={tmp_path / 'again'}"]) == 2
    assert "is adapted already" in capsys.readouterr().err
    np.testing.assert_array_equal(load(model).estimator.predict_proba(corpus[rest]), before)
    unseen = written(corpus, rest, tmp_path / "rest.csv")
    assert main(["predict", str(tmp_path / "own"), unseen]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(rest) + 1


def test_mistakes_are_one_line_and_leave_nothing(person, tmp_path, capsys):
    corpus, own = person
    path = written(corpus, own[:4], tmp_path / "known.csv", gesture=corpus.gestures)
    model, fixed = str(tmp_path / "rec"), str(tmp_path / "rf")
    assert main(["fit", *SMALL, "model=lda", "features=touch", f"out={model}"]) == 0
    assert main(["fit", *SMALL, "model=rf", "model.trees=5", "features=touch", f"out={fixed}"]) == 0
    some = corpus.gestures.copy()
    some[own[0]] = ""
    partly = written(corpus, own[:4], tmp_path / "partly.csv", gesture=some)
    two = written(corpus, own[:4], tmp_path / "two.csv", subject=np.arange(len(corpus)).astype(str))
    other = written(corpus, own[:4], tmp_path / "other.csv", gesture=np.full(len(corpus), "poke"))
    capsys.readouterr()
    out = f"out={tmp_path / 'new'}"
    for arguments, said in {
        (model, path): "needs out=",
        (fixed, path, out): "cannot adapt",
        (model, partly, out): "gesture is empty",
        (model, two, out): "captures of 4 subjects",
        (model, other, out): "gesture poke is none that",
        (model, path, out, "labels=maybe"): "labels=maybe: give yes or no",
        (model, path, f"out={model}"): "there is something already",
        (model, str(tmp_path / "gone.csv"), out): "there is no such file",
        (model, path, out, "weight=3"): "no such option",
        (model,): "give a model and a file",
        (str(tmp_path / "nothing"), path, out): "not a saved model",
    }.items():
        assert main(["adapt", *arguments]) == 2
        told = "".join(capsys.readouterr())
        assert said in told and "Traceback" not in told
    assert not (tmp_path / "new").exists()
