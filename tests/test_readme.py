"""What the README promises, as it is written there."""

import re
from pathlib import Path

import numpy as np
from sklearn.model_selection import LeaveOneGroupOut, cross_val_score

from bench.cli import COMMANDS
from bench.work.fold import decisions
from models.tuning import Search

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_the_example_recogniser_runs_as_written(corpus):
    (code,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names = {}
    exec(code, names)
    found = cross_val_score(
        names["Level"](power=0.5), corpus, corpus.gestures, groups=corpus.subjects, cv=LeaveOneGroupOut()
    )
    assert found.mean() > 0.9


def test_its_parameter_can_be_searched_though_it_has_no_probabilities(corpus):
    """As `bench tune model=level model.power=0.5,1,2` does in each fold."""
    (code,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names = {}
    exec(code, names)
    train, test = np.flatnonzero(corpus.subjects != "1"), np.flatnonzero(corpus.subjects == "1")
    search = Search({"level": names["Level"]}, {"level": {"power": [0.5, 1.0, 2.0]}}).fit(
        corpus[train], corpus.gestures[train]
    )
    assert not hasattr(search, "predict_proba")
    table = decisions(search, corpus, "1", test)
    labels = table[["p_pat", "p_rub", "p_tap"]].to_numpy()
    assert (labels.max(axis=1) == 1).all() and (labels.sum(axis=1) == 1).all()
    expected = names["Level"](search.chosen_["level.power"]).fit(corpus[train], corpus.gestures[train])
    assert (np.array(["pat", "rub", "tap"])[labels.argmax(axis=1)] == expected.predict(corpus[test])).all()


def test_every_command_is_introduced():
    for command in COMMANDS:
        assert f"bench {command}" in README, command


def test_commands_are_single_lines_and_ci_runs_the_readmes():
    blocks = re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)[:3]
    assert all(block.strip().count("\n") == 0 for block in blocks)
    assert blocks[0].endswith("bench run protocol=loso model=cnn85\n") and "-m pytest" in blocks[1]
    assert README.count("-m pytest") == 1 and "-m pytest" in (ROOT / ".ci" / "run").read_text()


def test_every_name_of_the_table_exists():
    from bench.registry import names

    for room in ("corpora", "features", "models", "protocols"):
        for name in names(room):
            assert f"`{name}`" in README, name
