"""The bar of a run, and its lines where no bar is seen."""

from bench.running.bar import Bar
from bench.running.results import FoldResult


def test_a_grid_has_its_number_of_runs_and_the_time_left_for_all(capsys):
    """By hand; the clock of the bar is set."""
    clock = [0.0]
    with Bar(5, 2, [(4, 100.0), (2, None), (3, 60.0)]) as bar:
        bar.get_time = lambda: clock[0]
        bar.begin_run("svm", 6, ["1", "2", "3", "4"])  # two of its folds are stored
        assert (bar.run.fields["now"], bar.run.completed) == ("fold 1", 2)
        assert bar.seconds_left is None  # the second run has no estimate
        clock[0] = 30.0
        bar.end_fold(FoldResult("1", seconds=30.0))
        # the other folds as fast as this one, as are those of the run without an estimate
        assert bar.seconds_left == 3 * 30 + 2 * 30 + 60
        for fold in "234":
            clock[0] += 10
            bar.end_fold(FoldResult(fold, seconds=10.0))
        assert bar.seconds_left == 0 + 2 * 60 / 4 + 60
        bar.end_run()
        bar.begin_run("rf", 2, ["1", "2"])
        assert bar.seconds_left == 2 * 15 + 60
        traceback = 'Traceback\n  File "x"\nValueError: '
        bar.end_fold(FoldResult("1", error=f"{traceback}too few", seconds=3.0))
        bar.end_fold(FoldResult("2", seconds=200.4, failed={"after": f"{traceback}no replay"}))
    lines = capsys.readouterr().err
    assert "run 3 of 5, about 4 min left: svm: fold 1 done after 30 s, 3 of 6 folds\n" in lines
    assert "run 3 of 5, about 90 s left: svm: fold 4 done after 10 s, 6 of 6 folds\n" in lines
    assert "fold 1 failed after 3 s, 1 of 2 folds" in lines
    assert "fold 1 failed: ValueError: too few" in lines
    assert "fold 2, after= failed: ValueError: no replay" in lines


def test_folds_that_end_together_are_no_reason_to_hope(capsys):
    """Two workers end their first folds at once: the clock counts from the beginning."""
    clock = [0.0]
    with Bar(1) as bar:
        bar.get_time = lambda: clock[0]
        bar.begin_run("svm", 6, [*"123456"])
        for fold, seconds in (("1", 99.0), ("2", 100.0)):
            clock[0] = seconds
            bar.end_fold(FoldResult(fold, seconds=seconds))
    line = "fold 2 done after 1 min 40 s, 2 of 6 folds, 3 min 20 s left\n"
    assert line in capsys.readouterr().err
