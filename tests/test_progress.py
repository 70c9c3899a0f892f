"""The bar of a run, and its lines where no bar is seen."""

from bench.ground import progress
from bench.running.bar import Bar
from bench.running.results import FoldResult


def test_a_grid_has_its_number_of_runs_and_the_time_left_for_all(capsys):
    """By hand; the clock of the bar is set."""
    clock = [0.0]
    with Bar(5, 2, [(4, 100.0), (2, None), (3, 60.0)]) as bar:
        bar.get_time = lambda: clock[0]
        bar.begin_run("svm", 6, ["1", "2", "3", "4"])  # two of its folds are stored
        assert (bar.run.fields["now"], bar.run.completed) == ("fold 1", 2)
        assert bar.seconds_left is None  # nothing is known of the second one
        clock[0] = 30.0
        bar.end_fold(FoldResult("1", seconds=30.0))
        assert (
            bar.seconds_left == 3 * 30 + 2 * 30 + 60
        )  # the rest as fast as so far, the unknown one by the mean fold
        for fold in "234":
            clock[0] += 10
            bar.end_fold(FoldResult(fold, seconds=10.0))
        assert bar.seconds_left == 0 + 2 * 60 / 4 + 60
        bar.end_run()
        bar.begin_run("rf", 2, ["1", "2"])
        assert bar.seconds_left == 2 * 15 + 60
        bar.end_fold(
            FoldResult("1", error='Traceback\n  File "x"\nValueError: too few', seconds=3.0)
        )
        bar.end_fold(
            FoldResult(
                "2", seconds=200.4, failed={"after": 'Traceback\n  File "x"\nValueError: no replay'}
            )
        )
    said = capsys.readouterr().err
    assert (
        "run 3 of 5, about 4 min left: svm: fold 1 done after 30 s, 3 of 6 folds\n" in said
    )  # 210 s
    assert "run 3 of 5, about 90 s left: svm: fold 4 done after 10 s, 6 of 6 folds\n" in said
    assert (
        "fold 1 failed after 3 s, 1 of 2 folds" in said
        and "fold 1 failed: ValueError: too few" in said
    )
    assert "fold 2, after= failed: ValueError: no replay" in said
    words = [progress.format_estimate(s) for s in (0.2, 8.4, 88, 170, 5400, 6000, 9000)]
    assert words == [f"about {w}" for w in ("1 s", "8 s", "90 s", "3 min", "90 min", "2 h", "2 h")]


def test_seconds_in_words():
    assert [progress.format_seconds(s) for s in (0.4, 59.6, 200, 7500)] == [
        "0 s",
        "1 min 0 s",
        "3 min 20 s",
        "2 h 5 min",
    ]
