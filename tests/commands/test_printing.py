"""What commands print, and what a choice loads."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import bench
from bench.cli import main
from bench.ground.typed import quote_value
from bench.reports.views.captures import warn_of_one_label
from tests.reading.results import make_run, predictions_with_hits
from tests.reports.store import make_predictions, tracked_run


def test_a_choice_loads_neither_torch_nor_scikit_learn(store):
    for system in ("lda", "svm"):
        tracked_run(store, system, make_predictions())
    code = "import sys; from bench.cli import main; main(['choose']); "
    code += "print({'torch', 'sklearn'} & set(sys.modules))"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert "\nChoose " in out and out.splitlines()[-1] == "set()"


def test_at_most_eight_lines_follow_the_table_and_why_prints_the_rest(store, capsys):
    """Of a protocol that mixes people, with a failed run and four budgets."""
    for i in range(3):
        tracked_run(
            store, f"m{i}", make_predictions(8, seed=i), cost=3.0 * (i + 1), mixes_subjects="true"
        )
    tracked_run(store, "failed", make_predictions(8), failed=1)

    def below(*more):
        main(
            ["choose", "max_flash=20kB", "max_ram=1MB", "max_decision=9s", "max_predict=9s", *more]
        )
        return capsys.readouterr().out.rpartition("┘")[2].strip().splitlines()

    brief, every = below(), below("why=yes")
    (more,) = [line for line in brief if "with why=yes." in line]
    assert len(brief) <= 8 < len(every) and {*brief} - {more} < {*every}
    assert int(more.split()[0]) == len([line for line in every if line not in brief])


def test_a_key_goes_before_a_line_of_the_scene(store):
    tracked_run(store, "svm", make_predictions())
    Path("robot.toml").write_text('[budget]\nflash = "1kB"\n')
    assert bench.choose(scene="robot.toml").system is None
    assert bench.choose(scene="robot.toml", max_flash="1MB").system == "svm"


def test_a_run_with_one_label_in_a_fold_is_warned_of():
    right = predictions_with_hits([20, 15, 10])
    one = right.assign(**{f"p_{g}": float(g == "pat") for g in ("pat", "rub", "tap")})
    line = warn_of_one_label([make_run("lda", right), make_run("One", one)])
    assert (
        "One in 3 of 3 folds" in line
        and "lda" not in line
        and warn_of_one_label([make_run("lda", right)]) == ""
    )


VALUES = r"""a == 'it"s'; x == '$HOME'; plain; a == '`ls`'; x == 'a!b'"""


@pytest.mark.parametrize("value", VALUES.split("; "))
def test_a_value_is_quoted_so_that_a_shell_hands_it_over(value):
    assert shlex.split(f"where={quote_value(value)}") == [f"where={value}"]
