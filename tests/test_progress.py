"""The bar of a run, and its lines where no bar is seen."""

from bench import progress
from bench.work.bar import Bar
from bench.work.results import FoldResult


def test_a_log_has_a_line_for_each_fold_and_the_failures(capsys):
    with Bar(2) as bar:
        for title in ("svm", "rf"):
            bar.begin(title, 3, ["1", "fold02"])
            assert bar.run.fields["now"] == "fold 1" and bar.run.completed == 1
            bar.end_fold(
                FoldResult("1", seconds=200.4, failed={"after": 'Traceback\n  File "x"\nValueError: no replay'})
            )
            bar.end_fold(FoldResult("fold02", error='Traceback\n  File "x"\nValueError: too few', seconds=3.0))
            bar.end()
    said = capsys.readouterr().err
    assert "run 1 of 2: svm: fold 1 done after 3 min 20 s, 2 of 3 folds" in said
    assert "fold 1, after= failed: ValueError: no replay" in said and "fold02 failed: ValueError: too few" in said
    assert "run 2 of 2: rf: fold02 failed after 3 s, 3 of 3 folds" in said


def test_seconds_in_words():
    assert [progress.span(s) for s in (0.4, 59.6, 200, 7500)] == ["0 s", "1 min 0 s", "3 min 20 s", "2 h 5 min"]
