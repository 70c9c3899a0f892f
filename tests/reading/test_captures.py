"""Captures of stored runs: corpora that were imported again, and equal conditions."""

import sqlite3
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import bench
from bench.cli import main
from bench.reading.captures import runs_on_subsets, stale_sentences
from bench.reading.runs import load_all_runs, load_results, select_runs
from bench.store.client import Store, connect
from tests.conftest import SMALL

RUN = ["run", "data=arm", "model=tree,bayes", "features=jung28"]
PAIR = ["compare", "tree · jung28", "bayes · jung28"]


def import_arm(step):
    """Import six people, two gestures, which differ by ``step``."""
    rng, rows = np.random.default_rng(2), []
    for subject in "abcdef":
        for gesture in ("tap", "hold"):
            for take in (1, 2, 3):
                for frame in range(20):
                    cells = rng.integers(0, 40, 4) + step * (gesture == "hold")
                    rows.append((subject, gesture, take, frame, *cells))
    columns = ["subject", "gesture", "take", "frame", "ch1", "ch2", "ch3", "ch4"]
    pd.DataFrame(rows, columns=columns).to_csv("arm.csv", index=False)
    assert main(["data", "import", "table", "arm.csv", "name=arm", "grid=2x2", "rate_hz=50"]) == 0
    return bench.corpus("arm").digest[:16]


def printed(capsys, *arguments, code=0):
    capsys.readouterr()
    assert main([*arguments]) == code
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("hours", [1, -48])
def test_the_corpus_as_imported_now_decides_and_not_the_clock(hours, capsys, monkeypatch):
    import_arm(0)
    assert main(RUN) == 0
    now = import_arm(100)
    sentence = f"The corpus arm was imported again since (digest {now}): these runs are on the"
    for command in (["choose", "data=arm"], ["choose", "data=arm", "groups=yes"], ["runs"]):
        assert sentence in printed(capsys, *command), command
    assert "next: bench run data=arm" in (text := printed(capsys, "choose", "why=yes"))
    assert "bench fit" not in text
    assert sentence in printed(capsys, *PAIR)
    printed(capsys, "report")
    assert sentence in " ".join(Path("report/comparison.md").read_text().split())
    create = Store.create_run

    def create_at_another_time(self, *args, **kwargs):
        run = create(self, *args, **kwargs)
        shifted = run.info.start_time + hours * 3_600_000
        with sqlite3.connect("mlflow.db") as db:
            db.execute(
                "update runs set start_time = ? where run_uuid = ?", (shifted, run.info.run_id)
            )
        return run

    monkeypatch.setattr(Store, "create_run", create_at_another_time)
    assert main(RUN) == 0
    choice = bench.choose(data="arm")
    assert set(choice.table["accuracy"]) == {100} and not stale_sentences([choice.candidates.first])
    assert choice.candidates.first["corpus_digest"].startswith(now)
    assert "next: bench fit data=arm" in printed(capsys, "choose", "data=arm")
    assert bench.runs(latest=True)["accuracy"].tolist() == [100, 100]
    assert "2 of 4 runs are on the earlier captures" in printed(capsys, "runs", "data=arm")
    assert sentence not in printed(capsys, *PAIR)
    import_arm(0)  # the first captures are the current ones again
    assert bench.choose(data="arm").table["accuracy"].max() < 100


def test_a_bundle_keeps_what_was_current_when_it_was_made(capsys):
    import_arm(0)
    assert main(RUN) == 0
    assert main(["report", "bundle=paper.zip"]) == 0
    page = Path("report/comparison.md").read_text()
    import_arm(100)
    assert main(["report", "from=paper.zip", "out=again"]) == 0
    assert Path("again/comparison.md").read_text() == page


@st.composite
def same_subjects(draw):
    """Two conditions on subjects that select the same three or four of five."""
    people = draw(st.permutations("12345"))[: draw(st.integers(3, 4))]
    others = [each for each in "12345" if each not in people]
    quote = draw(st.sampled_from("'\""))
    listed = ", ".join(f"{quote}{each}{quote}" for each in people)
    spellings = [
        f"subject in [{listed}]",
        f"subject.isin([{listed}])",
        " or ".join(f"subject == {quote}{each}{quote}" for each in people),
        " and ".join(f"subject != {quote}{each}{quote}" for each in others),
        " & ".join(f"~(subject=={quote}{each}{quote})" for each in others),
        f"not subject in {others!r}",
    ]
    return draw(st.permutations(spellings))[:2]


DATA = {"data__subjects": 5, "data__variants": "normal", "data__repetitions": 1}


@settings(max_examples=8)
@given(same_subjects())
def test_conditions_that_select_the_same_captures_are_one(conditions):
    first, second = conditions
    values = {"model": "bayes", "features": "jung28", "protocol": "loso", **DATA}
    made = bench.run(where=first, **values)
    again = bench.run(where=second, **values)
    assert made["run_id"].item() == again["run_id"].item()
    for where in conditions:
        assert bench.runs(where=where)["run_id"].tolist() == made["run_id"].tolist()
        assert (
            bench.choose(where=where, data="synth").candidates.first["run_id"]
            == made["run_id"].item()
        )
    for run in connect().runs_of_kind("cell"):
        connect().delete_run(run.info.run_id)


def test_a_condition_that_the_store_would_cut_off_is_refused_at_once():
    people = " or ".join(f"subject == '{number}'" for number in range(500))
    with pytest.raises(bench.InputError, match=f"where= has {len(people)} characters"):
        bench.plans(where=people, model="bayes", **DATA)
    short = " or ".join(f"subject == '{number}'" for number in range(1, 350))
    assert 6000 < len(short) < 7900
    made = bench.run(where=short, model="bayes", features="jung28", **DATA)
    assert bench.choose(where=short).candidates.first["run_id"] == made["run_id"].item()


def test_runs_on_the_same_captures_share_a_table_whatever_their_conditions():
    values = {"features": "jung28", **DATA}
    bench.run(model="bayes", where="subject != '5'", **values)
    bench.run(model="lda", where="subject in ['1', '2', '3', '4']", **values)
    bench.run(model="lda", where="subject != '4'", **values)
    whole = bench.run(model="tree", where="repetition < 9", **values)
    bench.run(model="bayes", **values)
    assert len(bench.choose(where='subject != "5"').table) == 2
    assert len(bench.choose(where='not subject == "4"').table) == 1
    results = load_results(connect())
    assert {r["subset"] for r in results} == {"subject != '5'", "subject != '4'", "all"}
    (everything,) = [r for r in results if r["run_id"] == whole["run_id"].item()]
    assert everything in select_runs(results, {"where": ["all"]})
    assert not runs_on_subsets(results, ["subject == 'nobody'"])
    assert not runs_on_subsets(results, ["not a condition"])


def test_a_clock_that_goes_back_keeps_no_number_of_a_repeated_run(monkeypatch, tmp_path):
    """A fold fails, and is run again two days earlier."""
    (tmp_path / "my.py").write_text(
        "from pathlib import Path\n"
        "from sklearn.naive_bayes import GaussianNB\n"
        "class Often(GaussianNB):\n"
        "    def fit(self, X, y):\n"
        "        for file in [*Path('.').glob('broken*')][:1]:\n"
        "            file.unlink()\n"
        "            raise ValueError('broken')\n"
        "        return super().fit(X, y)\n"
    )
    for name in ("broken in the trial fit", "broken in a fold"):
        Path(name).touch()
    arguments = ["run", *SMALL, "model=my.py:Often", "features=jung28"]
    assert main(arguments) == 1
    (first,) = load_all_runs(connect())
    assert first.metrics["folds_failed"] == 1
    earlier = time.time() - 2 * 86_400
    monkeypatch.setattr("bench.store.client.time.time", lambda: earlier)
    assert main(arguments) == 0
    (second,) = load_all_runs(connect())
    assert second.metrics["folds_failed"] == 0 and second.is_complete
    people = second.tables["per_subject"]["accuracy"]
    assert second["accuracy"] == pytest.approx(people.mean(), abs=1e-12)
