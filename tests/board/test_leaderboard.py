"""Frozen tasks, the answers of runs to them, scores of submissions, their page, and reruns that verify them."""

import hashlib
import json
import re
import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sklearn.metrics import f1_score

import bench
from bench.board import answers, marks, rerun, submissions, tasks
from bench.board.page import reference, scores_of
from bench.board.tasks import CAPTURE, CUDDLEBOT, HAART, LOSO, TASKS, Task
from bench.cli import main
from bench.corpora.faults import SEVERITIES, all_faults, usual_faults
from bench.errors import InputError
from bench.protocols.personal import Personal
from bench.source import git_revision
from tests.board.submitted import ABOUT, CHALLENGE, folder_of
from tests.conftest import random_corpus, runs
from tests.reports.store import tracked_run
from tests.results import result

ROOT = Path(__file__).parent.parent.parent
SYNTH = "synth-loso-v1"
RUN = {  # tags of a run of svm on the first task
    **{"run_id": "1a2b", "system": "svm · jung54", "seed": "none", "started": 1.7e12},
    **{"data": "haart", "synthetic": "false", "corpus_digest": HAART, "git": "0123456789ab", "version.numpy": "2.1"},
}

WATCHED = {"watch.false_alarms": "5.0", "watch.background": "", "watch.unknown": ""}


def other(labels):
    """A wrong label for each label."""
    return labels.map(lambda label: "pat" if label != "pat" else "rub")


def haart_predictions(windows=3):
    """The table that ``bench run data=haart protocol=loso`` stores, with random probabilities."""
    listed = tasks.captures_of(TASKS["haart-loso-v1"]).astype({"capture": int}).rename(columns={"gesture": "true"})
    rows = listed.loc[listed.index.repeat(windows)].reset_index(drop=True)
    classes = sorted(set(listed["true"]))
    proba = np.random.default_rng(0).dirichlet(np.ones(len(classes)), len(rows)).astype(np.float32)
    rows = rows.assign(fold=rows["subject"], start=0, frames=432)
    return pd.concat([rows, pd.DataFrame(proba, columns=[f"p_{c}" for c in classes])], axis=1)


def test_what_a_name_means_never_changes():
    frozen = {
        "haart-loso-v1": (HAART, "loso", 829),
        "haart-challenge-v1": (HAART, "challenge", 251),
        "haart-early-v1": (HAART, "loso", 829 * 5),
        "haart-faults-v1": (HAART, "loso", 829 * (1 + 17 * 5)),
        "haart-personal-v1": (HAART, "personal[shots=3]", 829 * 5),
        "cuddlebot-loso-v1": (CUDDLEBOT, "loso", 902),
    }
    assert HAART == "d086fb847e3caddb00adea342d9b33818a69d2866419d9caf8ce84b50bd34a8f"
    assert set(TASKS) == {*frozen, "haart-watch-v1", "cost-loso-v1"}
    for name, fixed in frozen.items():
        rows = tasks.rows_of(TASKS[name])
        assert (TASKS[name].digest, TASKS[name].protocol, len(rows)) == fixed
        assert not rows.duplicated(["capture", *TASKS[name].keys]).any() and rows["subject"].nunique() in (3, 10, 16)
    counts = tasks.captures_of(TASKS["haart-loso-v1"])["gesture"].value_counts().to_dict()
    assert counts == dict.fromkeys(("notouch", "pat", "scratch", "stroke", "tickle"), 119) | {
        "constant": 117,
        "rub": 117,
    }
    assert Personal(shots=3).draws == tasks.DRAWS
    faults = map(all_faults().__getitem__, usual_faults())
    now = {(f.name, str(s)): f.describe(s) for f in faults for s in range(1, SEVERITIES + 1)}
    assert tasks.faults() == {("none", "0"): ""} | now, "a fault has changed: leave the task, and make a -v2"


def test_cost_is_only_what_was_published(monkeypatch):
    task, small = TASKS["cost-loso-v1"], random_corpus()
    for info in ({"format": "cost", "warnings": ["captures: 36 here, 7805 published"]}, {"format": "table"}):
        monkeypatch.setattr(tasks, "open_corpus", lambda *_, info=info: small.changed(info=info))
        with pytest.raises(InputError, match="36 here|another format"):
            tasks.rows_of(task)
    published = small.changed(info={"format": "cost", "warnings": []}, digest="c" * 64)
    monkeypatch.setattr(tasks, "open_corpus", lambda *_: published)
    assert tasks.rows_of(task)["true"].tolist() == list(small.gestures) and tasks.digest_of(task) == "c" * 64


def test_scores_are_those_of_the_labels():
    """Rows and columns may come in any order, labels as probabilities."""
    rng = np.random.default_rng(1)
    labels, truth = rng.choice(sorted(set(CHALLENGE["true"])), len(CHALLENGE)), CHALLENGE["true"]
    order, proba = rng.permutation(len(CHALLENGE)), {f"p_{c}": (labels == c) * 1.0 for c in sorted(set(truth))[::-1]}
    table = CHALLENGE[["capture"]].assign(predicted=labels).iloc[order]
    scored = submissions.read(folder_of(table=table, parameters=12)).scores
    assert scored == submissions.read(folder_of("p", CHALLENGE[["capture"]].assign(**proba).iloc[order])).scores
    hit = (labels == truth).to_numpy()
    each = [hit[CHALLENGE["subject"] == s].mean() for s in set(CHALLENGE["subject"])]
    assert scored["accuracy"] == pytest.approx(hit.mean()) and np.isnan([scored["low"], scored["high"]]).all()
    assert scored["macro_f1"] == pytest.approx(f1_score(truth, labels, average="macro"))
    assert (scored["subject_mean"], scored["subject_sd"]) == pytest.approx((np.mean(each), np.std(each, ddof=1)))


def test_the_mean_of_instants_and_of_faults():
    early = tasks.rows_of(TASKS["haart-early-v1"])
    labels = early["true"].where(early["ms"].isin(["8000", "4000"]), other(early["true"]))
    folder = folder_of("early", early[["capture", "ms"]].assign(predicted=labels), task="haart-early-v1")
    scored = submissions.read(folder).scores
    assert scored["accuracy"] == pytest.approx(0.4) and (scored["at 500 ms"], scored["at 4000 ms"]) == (0, 1)
    faulty = tasks.rows_of(TASKS["haart-faults-v1"])
    labels = faulty["true"].where((faulty["fault"] != "noise") | (faulty["severity"] != "5"), other(faulty["true"]))
    table = faulty[["capture", "fault", "severity"]].assign(predicted=labels)
    scored = submissions.read(folder_of("faults", table, task="haart-faults-v1")).scores
    assert scored["accuracy"] == pytest.approx(84 / 85) and scored["clean"] == 1
    assert scored["worst fault: noise"] == pytest.approx(0.8)


def test_the_difference_to_the_best_is_paired_over_people():
    rng = np.random.default_rng(4)
    every = tasks.rows_of(TASKS["haart-loso-v1"])
    wrong = {"better": rng.random(len(every)) < 0.1, "worse": rng.random(len(every)) < 0.4}
    labels = {name: every["true"].where(~where, other(every["true"])) for name, where in wrong.items()}
    tables = {name: every[["capture"]].assign(predicted=column) for name, column in labels.items()}
    better, worse = (submissions.read(folder_of(name, table, task="haart-loso-v1")) for name, table in tables.items())
    lost = wrong["better"].astype(int) - wrong["worse"]  # of each capture, by hand
    people = [lost[every["subject"] == s] for s in sorted(set(every["subject"]))]
    draws = np.random.default_rng(1).integers(0, 10, (4000, 10))
    drawn = [np.concatenate([people[i] for i in each]).mean() for each in draws]
    mean, low, high = submissions.behind(worse, better)
    assert mean == pytest.approx(lost.mean()) and low < mean < high < 0
    assert (low, high) == pytest.approx(np.quantile(drawn, [0.025, 0.975]), abs=0.004)
    three = [submissions.read(folder_of(n, CHALLENGE[["capture"]].assign(predicted=n))) for n in ("pat", "rub")]
    assert np.isnan(submissions.behind(*three)[1:]).all()  # three people are too few
    table = scores_of([worse, better]).set_index("name")
    assert list(table.index) == ["better", "worse"] and np.isnan(table.loc["better", "behind"])
    assert table.loc["worse", "behind"] == pytest.approx(100 * mean)


def test_a_row_keeps_its_digits_where_rounding_would_change_its_label():
    classes = sorted(set(CHALLENGE["true"]))
    proba = np.full((len(CHALLENGE), 7), 0.1, np.float32)
    proba[:, 2], proba[:, 5] = 0.2501, 0.2504  # both are 0.25, and the first of them would win
    proba[9, 5] = 0.2599
    labels = np.asarray(classes)[proba.argmax(axis=1)]
    table = CHALLENGE.assign(predicted=labels, **{f"p_{c}": proba[:, i] for i, c in enumerate(classes)})
    kept = submissions.write(Path("f"), ABOUT, table).table
    assert kept["predicted"].tolist() == labels.tolist() and set(labels) == {classes[5]}
    assert kept[f"p_{classes[5]}"][0] == np.float32(0.2504) and kept[f"p_{classes[5]}"][9] == np.float32(0.26)


@pytest.mark.parametrize(
    ("name", "tags", "flaw"),
    [
        ("haart-loso-v1", {}, ""),
        ("haart-loso-v1", {"corpus_digest": "e" * 64}, "data digest eeeeeeeeeeeeeeee"),
        ("haart-loso-v1", {"subset": "split == 'train'"}, "subset split == 'train'"),
        ("haart-loso-v1", {"status": "FAILED"}, "status FAILED"),
        ("haart-personal-v1", {"protocol": "personal[shots=3]"}, ""),
        ("haart-personal-v1", {"protocol": "personal[shots=3, seed=1]"}, "protocol personal[shots=3, seed=1]"),
        ("haart-early-v1", {"stream.start": "onset"}, ""),
        ("haart-early-v1", {"stream.start": "middle"}, "start middle"),
        ("haart-watch-v1", WATCHED, ""),
        ("haart-watch-v1", WATCHED | {"watch.background": "notouch"}, ""),
        ("haart-watch-v1", WATCHED | {"watch.background": "quiet"}, "background quiet"),
        ("haart-watch-v1", WATCHED | {"watch.unknown": "pat"}, "unknown pat"),
        ("haart-watch-v1", WATCHED | {"watch.false_alarms": "8.0"}, "false_alarms 8.0"),
    ],
)
def test_a_run_answers_a_task_or_differs_in_a_value(name, tags, flaw):
    assert answers.differs(TASKS[name], result(**RUN | tags)) == flaw


def test_the_rows_of_each_kind_of_run():
    def table(name, stored, times="each"):
        places = {"haart-faults-v1": "labels", "haart-early-v1": "replay"}
        about = RUN | {"faults": "noise", "stream.after": times}
        return answers.table(TASKS[name], result(tables={places.get(name, "predictions"): stored}, **about))

    stored = haart_predictions()
    mean = stored.groupby("capture").mean(numeric_only=True).filter(like="p_")
    rows = table("haart-loso-v1", stored.sample(frac=1, random_state=0))
    assert rows.filter(like="p_").to_numpy() == pytest.approx(mean.to_numpy(), abs=1e-6)
    assert rows["predicted"].tolist() == [mean.columns[i][2:] for i in mean.to_numpy().argmax(axis=1)]
    with pytest.raises(InputError, match="1a2b has no label of capture 7,"):
        table("haart-loso-v1", stored.query("capture != 7"))
    with pytest.raises(InputError, match="1a2b has no label of capture 7,"):  # on which it abstains
        table("haart-loso-v1", stored.assign(**{p: stored[p].where(stored["capture"] != 7, 0.0) for p in mean}))
    with pytest.raises(InputError, match="other captures than haart-loso-v1"):
        table("haart-loso-v1", stored.assign(true="pat"))
    draws = pd.concat(
        [stored.assign(fold=stored["subject"] + f" draw {d}", p_pat=stored["p_pat"] + d) for d in range(1, 6)]
    )
    assert (table("haart-personal-v1", draws)["predicted"] == "pat").all()
    whole = tasks.rows_of(TASKS["haart-faults-v1"]).astype({"capture": int, "severity": float})
    amounts = pd.Series(tasks.faults()).rename_axis(["fault", "severity"]).rename("amount").reset_index()
    whole = whole.merge(amounts.astype({"severity": float})).rename(columns={"fault": "case", "severity": "level"})
    key = np.where(whole["case"] == "none", "", "under")
    whole = whole.assign(fold=whole["subject"], circumstance=key, predicted=whole["true"])
    few = whole.assign(circumstance="train_subjects", predicted="pat")  # of the learning curve
    rows = table("haart-faults-v1", pd.concat([few, whole]))
    assert (rows["predicted"] == rows["true"]).all() and len(rows) == len(whole)
    with pytest.raises(InputError, match="noise at severity 5 is 99"):
        wrong = (whole["case"] == "noise") & (whole["level"] == 5)
        table("haart-faults-v1", whole.assign(amount=whole["amount"].where(~wrong, "99")))
    labels = {27: "pat", 54: "rub", 500: "tickle"}  # by frames: at 0.5 s, at 1 s, too late
    one = stored[stored.index % 3 == 0]
    replay = pd.concat([one.assign(instant=n, **{f"p_{label}": 5.0}) for n, label in labels.items()])
    first = table("haart-early-v1", replay).query("capture == '0'").set_index("ms")["predicted"]
    assert first.to_dict() == {"500": "pat", "1000": "rub", "2000": "rub", "4000": "rub", "8000": "rub"}
    asked = "250, 500, 1000, 2000, 4000, 8000"
    assert first.equals(table("haart-early-v1", replay, asked).query("capture == '0'").set_index("ms")["predicted"])
    with pytest.raises(InputError, match="1a2b has no label of capture 0, ms 500,"):
        table("haart-early-v1", replay, "250, 1000, 2000, 4000, 8000")


def test_the_metadata_of_a_run():
    """The place of a file of one's own stays private, its content is named."""
    command = "bench run data=haart protocol=loso model='/secret place/mine.py:Taxels'"
    tags = {"model_file": "f" * 64, "touchbench.depends_on_batch": "true", "touchbench.conditions": "substrate,cover"}
    run = result(metrics={"parameters": 1000.0, "flash_bytes": np.nan}, **RUN | tags)
    texts = answers.metadata(TASKS["haart-loso-v1"], run, "me", command)
    assert texts["command"] == "bench run data=haart protocol=loso model=mine.py:Taxels"
    assert "f" * 64 in texts["note"] and "secret" not in json.dumps(texts)
    assert (texts["date"], texts["digest"]) == ("2023-11-14", HAART)
    assert texts["versions"] == {"numpy": "2.1", "python": "3"}
    assert texts["parameters"] == 1000 and "flash_bytes" not in texts
    assert (texts["batch"], texts["conditions"]) == ("yes", "substrate,cover")


def test_a_run_is_submitted(store, capsys):
    tags = {"data": "haart", "synthetic": "false", "corpus_digest": HAART, "seed": "none"}
    tags |= {
        "touchbench.command": "run",
        "touchbench.arguments": '{"data": "haart"}',
        "touchbench.depends_on_batch": "true",
    }
    stored = haart_predictions()
    run_id = tracked_run(store, "svm · jung54", stored, **tags)
    tracked_run(store, "svm · jung54", stored, **tags | {"subset": "half"})  # newer, and no answer
    submit = ["submit", "task=haart-loso-v1", "who=A. Name", "out=all/mine"]
    for wrong, facts in (
        (["model=svm"], ("batch=yes", run_id)),
        (["model=lda", "features=touch"], ("bench run data=haart protocol=loso model=lda features=touch",)),
        (["model=svm,rf"], ("2 systems",)),
        (["run=1", "model=svm"], ("model=",)),
        (["where=a == 1"], ("'where'",)),
        (["batch=maybe"], ("batch=maybe",)),
    ):
        assert main([*submit, *wrong]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert all(fact in line for fact in facts) and not Path("all").exists()
    assert main(["submit", "task=haart-los-v1", "who=me", "out=x"]) == 2 and "haart-loso-v1" in capsys.readouterr().err
    assert main(submit[:2] + submit[3:]) == 2 and "who=" in capsys.readouterr().err
    assert main([*submit, "model=svm", "batch=yes"]) == 0
    one = submissions.read(Path("all/mine"))
    assert f"{100 * one.scores['accuracy']:.1f} % of 829 captures" in capsys.readouterr().out
    assert one.metadata["command"] == "bench run data=haart" and one.metadata["batch"] == "yes"
    assert main([*submit, "model=svm", "batch=yes"]) == 2, "the folder is not empty"


def test_reference_results_have_their_accuracies():
    results = bench.results("reference")
    table = results.set_index(["task", "system"])
    accuracy = table["accuracy"].xs("haart-loso-v1")
    assert (
        accuracy["svm · jung54"].round(1) == 67.8 and accuracy["xgb · jung54"].round(1) == 74.4
    )  # notes/two_corpora.md
    assert len(accuracy) >= 8 and table["accuracy"].between(14.3, 100).all()
    one = results.tables["haart-loso-v1/svm-jung54"]
    assert 100 * (one["true"] == one["predicted"]).mean() == pytest.approx(accuracy["svm · jung54"])
    assert one.filter(like="p_").sum(axis=1).to_numpy() == pytest.approx(1, abs=0.02)
    for wrong in ({"of": "refrence"}, {"of": "reference", "model": "svm"}):
        with pytest.raises(InputError, match="refrence|model="):
            bench.results(**wrong)


def test_the_page_ranks_by_computed_scores_and_marks_our_rows(capsys):
    pat = CHALLENGE[["capture"]].assign(predicted="pat")
    folder_of("worst", pat, system="always pat", note="accuracy 100 %")
    folder_of("copied", system="reflex", command="bench run data=haart protocol=challenge model=reflex")
    assert main(["leaderboard", "all"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "haart-challenge-v1: reflex by A. Name, 100.0 % of 251 captures, not verified"
    text = Path("leaderboard.html").read_text()
    assert all(f'<h2 id="{name}">' in text for name in TASKS) and not re.search(r"(src|href|action)=\"(?!#)", text)
    part = text[text.index('id="haart-challenge-v1"') : text.index('id="haart-early-v1"')]
    systems = re.findall(r'<tr><th scope="row">(.*?)(?:<sup>.*?</sup>)?</th><td>([0-9.]+)<', part)
    assert systems[0] == ("reflex", "100.0") and systems[-1] == ("always pat", f"{100 * 36 / 251:.1f}")
    (row,) = re.findall(r'<tr><th scope="row">reflex<sup>.*?</sup></th><td>100.0<.*?</tr>', text)
    assert "<td>submitted</td><td>not verified</td>" in row and '-1">1</a>' in row
    assert text.count("<td>reference, shipped with touchbench</td>") == len(reference())


def test_folders_that_cannot_be_used(capsys):
    Path("empty").mkdir()
    assert main(["leaderboard", "nowhere"]) == 2 and "nowhere" in capsys.readouterr().err
    assert main(["leaderboard", "empty"]) == 0 and "empty" in capsys.readouterr().err
    assert main(["leaderboard", "out=empty"]) == 2 and not list(Path("empty").iterdir())
    Path(marks.FILE).write_text("[]")
    assert main(["leaderboard"]) == 2 and marks.FILE in capsys.readouterr().err


def test_submit_rerun_and_verify(monkeypatch, capsys):
    """From a run on the smallest generated corpus to a mark, which holds until the submission changes."""
    corpus = bench.corpus("synth", subjects=2, variants=("normal",), repetitions=1)
    listed = corpus.captures[["subject", "gesture"]].assign(capture=[str(i) for i in range(len(corpus))])
    monkeypatch.setattr(tasks, "captures_of", lambda task: listed)
    task = Task(SYNTH, "loso", LOSO, CAPTURE, "28 captures", data="synth", digest=corpus.digest)
    monkeypatch.setitem(TASKS, SYNTH, task)
    monkeypatch.setattr("bench.board.commands.reference", tuple)

    def shown():
        capsys.readouterr()
        assert main(["leaderboard", "submissions"]) == 0
        (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith(SYNTH)]
        return line

    small = ["data=synth", "data.subjects=2", "data.variants=normal", "data.repetitions=1", "jobs=1"]
    assert main(["run", *small, "model=bayes", "features=jung28"]) == 0
    folder = Path("submissions/mine")
    assert (
        main(["submit", f"task={SYNTH}", f"run={runs('cell')[1][0].info.run_id}", "who=A. Name", f"out={folder}"]) == 0
    )
    forged = {f"{SYNTH}/mine": {"sha256": "0" * 64, "date": "2026-01-01", "revision": "abc", "system": "bayes"}}
    (folder / marks.FILE).write_text(json.dumps(forged))
    assert shown().endswith("not verified")
    assert main(["leaderboard", "rerun=mine"]) == 0
    assert "28 of 28 labels are equal (100.00 %)" in capsys.readouterr().out
    (mark,) = json.loads(Path(marks.FILE).read_text()).values()
    today = datetime.now(UTC).date().isoformat()
    assert (mark["date"], mark["revision"], mark["labels"]) == (today, git_revision(), 28)
    assert shown().endswith(f"verified {today} at {git_revision()}, ran bayes · jung28")
    assert len(runs("cell")[1]) == 1, "the rerun must not read or fill the store of this folder"
    before = Path(marks.FILE).read_bytes()
    labels = submissions.read(folder).table[["capture", "predicted"]]
    labels.loc[0, "predicted"] = "pat" if labels.loc[0, "predicted"] != "pat" else "tap"
    (folder / "predictions.parquet").unlink()
    labels.to_csv(folder / "predictions.csv", index=False)
    assert shown().endswith("not verified")
    assert main(["leaderboard", "rerun=mine"]) == 1
    out, err = capsys.readouterr()
    assert "27 of 28 labels are equal (96.42 %)" in out and "not verified" in err
    assert Path(marks.FILE).read_bytes() == before
    metadata = json.loads((folder / "submission.json").read_text()) | {"batch": "yes"}
    (folder / "submission.json").write_text(json.dumps(metadata))
    assert main(["leaderboard", "rerun=mine"]) == 2 and "batch" in capsys.readouterr().err


def test_systems_are_ranked_over_tasks(monkeypatch, capsys):
    """The newest answer counts; labels that depend on other captures do not, nor does another author's system."""
    monkeypatch.setattr("bench.commands.printing.WIDTH", 250)
    assert main(["leaderboard"]) == 0
    assert "16 of cuddlebot and 10 of haart" in capsys.readouterr().out  # the results that come with touchbench
    monkeypatch.setattr("bench.board.commands.reference", tuple)  # without them
    published = random_corpus().changed(info={"format": "cost", "warnings": []}, digest="c" * 64)
    monkeypatch.setattr(tasks, "open_corpus", lambda *_: published)
    for task in ("haart-loso-v1", "cost-loso-v1"):
        rows = tasks.rows_of(TASKS[task])
        right, wrong = (rows[["capture"]].assign(predicted=labels) for labels in (rows["true"], other(rows["true"])))
        data = task.split("-")[0]
        folder_of(f"{data}-good", right, task=task, system="good")
        folder_of(f"{data}-old", right, task=task, system="bad", date="2025-01-31")
        folder_of(f"{data}-bad", wrong, task=task, system="bad")
        folder_of(f"{data}-batch", right, task=task, system="batchy", batch="yes")
        folder_of(f"{data}-stranger", right, task=task, system="mine", who=f"Author of {data}")
    assert main(["leaderboard", "all", "out=board.html"]) == 0
    out = capsys.readouterr().out
    rows = [line for line in out.splitlines() if re.search("[12]\\.00", line) and line.startswith("│ ")]
    assert len(rows) == 2 and "good by A. Name" in rows[0] and "bad by A. Name" in rows[1] and "-100.0" in rows[1]
    people = 10 + len(set(published.subjects))
    assert f"{people} people" in out and "batchy by A. Name (labels depend on other test captures)" in out
    assert "on haart: mine by Author of cost" in out
    text = Path("board.html").read_text()
    assert 'id="over-several-corpora"' in text and "is unknown" in text


@pytest.mark.parametrize(
    ("command", "fact"),
    [
        ("python train.py", "'python train.py'"),
        ("bench stream data=haart", "bench run"),
        ("bench run data=haart protocol=loso", "protocol loso"),
        ("bench run protocol=challenge cluster=tcp://1.2.3.4:5", "'cluster'"),
        ("bench run protocol=challenge out=/tmp/x", "'out'"),
        ("bench run protocol=challenge model=/tmp/evil.py:Mine", "'/tmp/evil.py:Mine'"),
        ("bench run protocol=mine.py:Mine", "mine.py here"),
        ("bench run protocol=challenge model=lda,svm", "2 systems"),
    ],
)
def test_commands_that_are_not_repeated(command, fact):
    folder = folder_of("mine", command=command)
    (folder / "evil.py").write_text("raise SystemExit(99)")
    Path("mine.py").write_text("raise SystemExit(99)")
    with pytest.raises(InputError) as refused:
        rerun.command_of(submissions.read(folder))
    assert fact in str(refused.value) and str(refused.value).isprintable()


def test_commands_that_are_repeated():
    Path("mine.py").write_text("from sklearn.naive_bayes import GaussianNB as Mine\n")
    note = f"mine.py: sha256 {hashlib.sha256(Path('mine.py').read_bytes()).hexdigest()}"
    for command, words in {
        "bench run data=cost protocol=challenge model=svm seed=1": ["run", "data=haart", "protocol=challenge"],
        "bench tune protocol=challenge model.C=1,2 trials=3": ["tune", "model.C=1,2", "trials=3", "data=haart"],
        "bench choose protocol=challenge model=rf over=trees": ["tune", "smallest=trees"],  # a former name
        "bench run protocol=challenge model=mine.py:Mine": ["run", f"model={Path('mine.py').absolute()}:Mine"],
    }.items():
        assert set(words) <= set(rerun.command_of(submissions.read(folder_of("mine", command=command, note=note))))
        shutil.rmtree("all")


def test_a_rerun_is_of_one_folder(capsys):
    folder_of("mine")
    Path("link").mkdir()
    Path("link/mine").symlink_to(Path("all/mine").absolute())
    assert rerun.read("mine", [Path("all"), Path("link")]).name == "mine"
    shutil.copytree("all", "twice")
    for name, folders in (
        ("mine", ["all", "twice"]),
        ("mine", ["link"]),
        ("../all/mine", ["twice"]),
        ("other", ["all"]),
    ):
        assert main(["leaderboard", f"rerun={name}", *folders]) == 2 and folders[0] in capsys.readouterr().err
    assert main(["leaderboard", "rerun=mine", "out=x.html"]) == 2 and "out=" in capsys.readouterr().err
