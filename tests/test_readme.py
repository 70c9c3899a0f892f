"""What the README promises, as it is written there."""

import re
from pathlib import Path

from sklearn.model_selection import LeaveOneGroupOut, cross_val_score

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
