"""What the page says in a sentence, against numbers that are known beforehand."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.outcomes.runs import tracked, with_groups
from reports.comparison import published
from reports.figures import Picture
from reports.run_groups import Group, group_of
from reports.summary import EARLY, FAULTS, PEOPLE, STATISTICS, briefs, early, faults, told_apart
from tests.reports.store import tracked_run, with_hits
from tests.reports.test_behaviour import other_run, stressed


def group(rows, mixed=False):
    """Accuracies of systems by name, a number per subject."""
    table = pd.DataFrame(rows, dtype=float).T
    return Group(table.loc[table.mean(axis=1).sort_values(ascending=False, kind="stable").index], mixed)


TEST = "paired Wilcoxon tests against the best, Holm's correction,"
EVEN, ODD = [70, 60] * 6, [60, 70] * 6


def test_two_that_take_turns_are_not_told_apart_and_the_first_beats_the_third():
    # Twelve differences of one sign: p = 2 / 2 ** 12, Holm's correction doubles it. As many of either sign: p = 1.
    said = told_apart(group({"rf": EVEN, "xgb": ODD, "svm": [50] * 12}))
    assert said == f"rf beats svm; xgb cannot be told apart from rf ({TEST} over 12 subjects, 5 %)."


def test_one_that_is_always_first():
    said = told_apart(group({"rf": [90] * 12, "xgb": ODD, "svm": EVEN}))
    assert said == f"rf beats xgb and svm ({TEST} over 12 subjects, 5 %)."


def test_many_that_do_not_differ():
    rng = np.random.default_rng(0)
    said = told_apart(group({f"s{i}": rng.permutation(20) for i in range(5)}))
    assert said.startswith("None of the other 4 systems can be told apart from s") and "over 20 subjects" in said


def test_sentence_and_table_say_the_same_where_nemenyi_does_not_separate(store, monkeypatch):
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda self, path, **_: Path(path).write_text("<svg/>"))
    # All ten subjects gain one capture of 20 with a: p = 2 / 2 ** 10, times four comparisons: 0.008. The mean ranks 1
    # and 2 differ by less than Nemenyi's critical difference, 2.728 sqrt(5 * 6 / (6 * 10)) = 1.93.
    for place, name in enumerate("abcde"):
        tracked_run(store, name, with_hits([18 - place] * 10))
    runs = with_groups(tracked(store))
    found = group_of(store, runs, None, published(), Path.cwd(), 1)
    rows = found.rows.set_index("system")
    assert rows.loc["b", "mean_rank"] - rows.loc["a", "mean_rank"] < 1.93
    assert rows.loc["b", "p_holm"] == pytest.approx(4 * 2 / 2**10)
    assert told_apart(found) == f"a beats b, c, d and e ({TEST} over 10 subjects, 5 %)."
    diagram = next(b for b in found.compared if isinstance(b, Picture))
    assert "more conservative" in diagram.caption and "no sentence" in diagram.caption.lower()


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ({"a": [1, 2]}, "a has nothing to be compared with."),
        ({"a": [1, 2, 3], "b": [3, 2, 1]}, "3 subjects are too few to tell 2 systems apart."),
        # Ten differences of one sign: p = 2 / 2 ** 10; as many of each sign and equal size: p = 1.
        ({"a": [60] * 10, "b": range(50, 60)}, f"a beats b ({TEST} over 10 subjects, 5 %)."),
        ({"a": EVEN, "b": ODD}, f"b cannot be told apart from a ({TEST} over 12 subjects, 5 %)."),
    ],
)
def test_one_two_and_few(rows, said):
    assert told_apart(group(rows)) == said


def test_mixed_subjects_are_said_with_it():
    assert "nothing holds for a new person" in told_apart(group({"a": [60] * 10, "b": range(50, 60)}, mixed=True))


def test_who_loses_least_under_faults(store):
    other_run(store, "stress", "svm", stressed(0.8, {"noise": 0.3, "dead_taxels": 0.1}), at=1)
    other_run(store, "stress", "rf", stressed(0.7, {"noise": 0.05, "dead_taxels": 0.15}), at=1)
    other_run(store, "stress", "tree", stressed(0.9, {"noise": 0.01}), at=1)  # met fewer faults: not comparable
    said = faults(store)
    assert "rf loses 10.0 points of accuracy, mean over 2 faults" in said and "the least of 2 systems" in said
    assert "(the most: svm, 20.0)" in said and said.endswith("most under dead taxels, 15.0 points.")


def test_what_is_known_early(store):
    def streamed(system, **metrics):
        params = {"stream.start": "onset", "stream.hop_ms": "None"}
        other_run(store, "stream", system, metrics | {"decide_ms_p50": 1.0}, at=1, params=params)

    streamed("svm", accuracy=0.8, adaptive_accuracy=0.79, adaptive_ms=1234.4, accuracy_at_500_ms=0.3)
    streamed("rf", accuracy=0.75, adaptive_accuracy=0.74, adaptive_ms=900.0, accuracy_at_500_ms=0.6)
    said = early(store)
    assert "svm labels 79.0 % of captures" in said and "after 1234 ms" in said and "80.0 % of whole captures" in said
    assert said.endswith("rf gets 60.0 % after 500 ms, most of all.")


def test_a_system_that_saves_nothing_is_said_to(store):
    params = {"stream.start": "onset", "stream.hop_ms": "None"}
    metrics = {"accuracy": 0.8, "adaptive_accuracy": 0.8, "adaptive_ms": 8000.0, "mean_ms": 8000.0}
    other_run(store, "stream", "svm", metrics | {"decide_ms_p50": 1.0}, at=1, params=params)
    said = early(store)
    assert "80.0 % of whole captures" in said and "no saving found" in said and "waiting gains" not in said


def test_topics_come_only_with_something_to_say(store):
    assert briefs(store, {}, []) == []
    found = dict(briefs(store, {"here": group({"a": [60, 80], "b": [50, 50]})}, []))
    assert set(found) == {PEOPLE, STATISTICS} and not {EARLY, FAULTS} & set(found)
    assert "a, the most accurate, labels between 60.0 % (subject 0) and 80.0 % (subject 1)" in found[PEOPLE]
