"""Frozen tasks, submissions from runs and from strangers, and the page of them."""

import hashlib
import itertools
import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from sklearn.metrics import f1_score

import bench
from bench.cli import main
from bench.corpora.faults import SEVERITIES, known
from bench.errors import InputError
from bench.leaderboard import marks, submissions, tasks
from protocols.personal import Personal
from reports.leaderboard import board, reference, scores_of
from tests.conftest import random_corpus, runs
from tests.reports.store import tracked_run
from tests.reports.submitted import ABOUT, CHALLENGE, folder_of

ROOT = Path(__file__).parent.parent.parent
HAART = "d086fb847e3caddb00adea342d9b33818a69d2866419d9caf8ce84b50bd34a8f"


SMALL = ["data=synth", "data.subjects=2", "data.variants=normal", "data.repetitions=1"]
MINE = """
import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin


class Taxels(ClassifierMixin, BaseEstimator):
    def fit(self, X, y):
        self.classes_ = np.unique(y)
        return self

    def predict(self, X):
        return np.repeat(self.classes_[:1], len(X))
"""


def haart_predictions(wrong=0.3, windows=1):
    """What a run of ``bench run data=haart protocol=loso`` stores, with a share of wrong labels."""
    listed = tasks.captures_of(tasks.TASKS["haart-loso-v1"])
    rng, gestures = np.random.default_rng(0), sorted(set(listed["gesture"]))
    rows = []
    for capture, subject, gesture in listed.itertuples(index=False):
        right = gestures.index(gesture)
        said = rng.integers(7) if rng.random() < wrong else right
        for w in range(windows):
            p = rng.dirichlet(np.ones(7)) * 0.1
            p[said] += 0.9
            rows.append((subject, int(capture), w, 432, gesture, subject, *p.astype(np.float32)))
    return pd.DataFrame(
        rows, columns=["fold", "capture", "start", "frames", "true", "subject", *map("p_{}".format, gestures)]
    )


def haart_run(store, predictions=None, **about):
    """A tracked run of svm, which has no seed."""
    about = {"data": "haart", "synthetic": "false", "corpus_digest": HAART, "git": "0123456789ab"} | about
    made = {"touchbench.command": "run", "touchbench.arguments": '{"data": "haart", "protocol": "loso"}'}
    about = {"seed": "none"} | made | about
    return tracked_run(store, "svm · jung54", haart_predictions() if predictions is None else predictions, **about)


def test_what_a_name_means_never_changes():
    frozen = {
        "haart-loso-v1": (HAART, "loso", 829),
        "haart-challenge-v1": (HAART, "challenge", 251),
        "haart-early-v1": (HAART, "loso", 829 * 5),
        "haart-faults-v1": (HAART, "loso", 829 * (1 + 17 * 5)),
        "haart-personal-v1": (HAART, "personal[shots=3]", 829 * 5),
    }
    for name, (digest, protocol, rows) in frozen.items():
        task = tasks.TASKS[name]
        expected = tasks.rows_of(task)
        assert (task.digest, task.protocol, len(expected)) == (digest, protocol, rows)
        assert not expected.duplicated(["capture", *task.keys]).any() and expected["subject"].nunique() in (3, 10)
    assert set(tasks.TASKS) == {*frozen, "cost-loso-v1"}
    counts = tasks.captures_of(tasks.TASKS["haart-loso-v1"])["gesture"].value_counts().to_dict()
    assert counts == dict.fromkeys(("notouch", "pat", "scratch", "stroke", "tickle"), 119) | {
        "constant": 117,
        "rub": 117,
    }
    assert Personal(shots=3).draws == tasks.DRAWS


def test_the_faults_are_those_of_the_task():
    now = {(f.name, str(s)): f.describe(s) for f in known().values() for s in range(1, SEVERITIES + 1)}
    assert tasks.faults() == {("none", "0"): ""} | now, "a fault has changed: leave the task, and make a -v2"


def test_reference_is_what_the_docs_say():
    found = bench.results("reference")
    table = found.table.set_index(["task", "system"])
    accuracy = table["accuracy"].xs("haart-loso-v1")
    assert accuracy["svm · jung54"].round(1) == 67.8 and accuracy["xgb · jung54"].round(1) == 74.4  # notes/haart.md
    assert table["command"].str.match(r"bench (run|stream|stress) data=haart protocol=").all()
    assert table["revision"].str.fullmatch("[0-9a-f]{12}").all()
    told = (ROOT / "docs" / "haart.md").read_text()
    early = table.xs("haart-early-v1")[["at 500 ms", "at 1000 ms", "at 2000 ms"]].round(1)
    for system, words in {"reflex": "`reflex`", "rocket": "`rocket`", "svm · jung54": "`svm` on `jung54`"}.items():
        (line,) = [row for row in told.splitlines() if row.startswith(f"| {words} | ") and row.count("|") == 9]
        assert early.loc[system].tolist() == [float(n) for n in line.split("|")[7].split("/")]
    assert len(accuracy) >= 8 and table["accuracy"].between(14.3, 100).all()
    one = found["haart-loso-v1/svm-jung54"]
    assert 100 * (one["true"] == one["predicted"]).mean() == pytest.approx(accuracy["svm · jung54"])
    assert one.filter(like="p_").sum(axis=1).to_numpy() == pytest.approx(1, abs=0.02)
    size = sum(path.stat().st_size for path in (ROOT / "reports" / "reference").rglob("*") if path.is_file())
    assert size < 1_000_000
    with pytest.raises(InputError, match="'refrence': give 'reference'"):
        bench.results("refrence")
    with pytest.raises(InputError, match="model=: not with"):
        bench.results("reference", model="svm")


def test_scores_are_those_of_the_labels():
    rng = np.random.default_rng(1)
    said = rng.choice(sorted(set(CHALLENGE["true"])), len(CHALLENGE))
    order = rng.permutation(len(CHALLENGE))
    folder = folder_of(table=CHALLENGE[["capture"]].assign(predicted=said).iloc[order], parameters=12)
    found = submissions.score(submissions.read(folder))
    hit = (said == CHALLENGE["true"]).to_numpy()
    assert found["accuracy"] == pytest.approx(hit.mean())
    assert found["macro_f1"] == pytest.approx(f1_score(CHALLENGE["true"], said, average="macro"))
    each = [hit[CHALLENGE["subject"] == s].mean() for s in set(CHALLENGE["subject"])]
    assert len(each) == 3 and found["subject_mean"] == pytest.approx(np.mean(each))
    assert found["subject_sd"] == pytest.approx(np.std(each, ddof=1)) and found["low"] <= hit.mean() <= found["high"]


def test_the_difference_to_the_best_is_paired_over_people():
    rng = np.random.default_rng(4)
    wrong = {"better": rng.random(len(CHALLENGE)) < 0.1, "worse": rng.random(len(CHALLENGE)) < 0.4}
    others = CHALLENGE["true"].map(lambda g: "pat" if g != "pat" else "rub")
    read = [
        submissions.read(folder_of(k, CHALLENGE[["capture"]].assign(predicted=CHALLENGE["true"].where(~w, others))))
        for k, w in wrong.items()
    ]
    lost = wrong["better"].astype(int) - wrong["worse"]  # of each capture, by hand
    people = [lost[CHALLENGE["subject"] == s] for s in sorted(set(CHALLENGE["subject"]))]
    drawn = [np.concatenate(each).mean() for each in itertools.product(people, repeat=3)]  # all 27 there are
    mean, low, high = submissions.behind(read[1], read[0])
    assert mean == pytest.approx(lost.mean()) and low < mean < high < 0
    # Each is one in 27, so more than 2.5 % of drawn samples are the lowest, and as many the highest.
    assert (low, high) == pytest.approx((min(drawn), max(drawn)))
    table = scores_of(read[::-1]).set_index("name")
    assert table.loc["worse", "behind"] == pytest.approx(100 * mean) and np.isnan(table.loc["better", "behind"])
    text = board(read, [])
    assert f"\N{MINUS SIGN}{-100 * mean:.1f} [\N{MINUS SIGN}{-100 * low:.1f}, \N{MINUS SIGN}{-100 * high:.1f}]" in text


def test_each_submission_is_scored_once(monkeypatch, capsys):
    counted = []
    score = submissions._scored
    monkeypatch.setattr(submissions, "_scored", lambda one: counted.append(one.name) or score(one))
    folder_of("mine")
    assert main(["leaderboard", "all"]) == 0 and main(["leaderboard", "all"]) == 0
    assert counted.count("mine") == 2 and max(map(counted.count, {*counted} - {"mine"}), default=0) <= len(tasks.TASKS)


def test_reference_prints_and_becomes_latex():
    found = bench.results("reference")
    said = repr(found)
    assert max(map(len, said.splitlines())) <= 200 and all(len(line) <= 100 for line in said.splitlines()[:-1])
    for task, system in found.table[["task", "system"]].itertuples(index=False):
        assert any(task in line and system in line for line in said.splitlines()), (task, system)
    row = found.table.iloc[0]
    assert f"{row['accuracy']:.1f} [{row['low']:.1f}, {row['high']:.1f}]" in said
    assert "more tables: 'haart-challenge-v1/bayes-jung28'" in said
    text = bench.latex(found)
    assert text.count("Origin: reference, shipped with touchbench.") == found.table["task"].nunique()
    assert text.count(r"\begin{table}") == found.table["task"].nunique() and text == bench.latex(found.table)
    assert f"& {row['macro_f1']:.1f} & {row['flash_bytes'] / 1000:.1f} " in text and "median time" not in text
    for wrong, told in ((3, "not int"), (pd.DataFrame({"system": ["svm"]}), "no column data, subset, protocol")):
        with pytest.raises(InputError, match=told):
            bench.latex(wrong)


def test_the_mean_of_instants_and_of_faults():
    early = tasks.rows_of(tasks.TASKS["haart-early-v1"])
    right = early["ms"].isin(["8000", "4000"])
    said = early["true"].where(right, early["true"].map(lambda g: "pat" if g != "pat" else "rub"))
    folder = folder_of("early", early[["capture", "ms"]].assign(predicted=said), task="haart-early-v1")
    found = submissions.score(submissions.read(folder))
    assert found["accuracy"] == pytest.approx(0.4) and (found["at 500 ms"], found["at 4000 ms"]) == (0, 1)
    faulty = tasks.rows_of(tasks.TASKS["haart-faults-v1"])
    wrong = (faulty["fault"] == "noise") & (faulty["severity"] == "5")
    said = faulty["true"].where(~wrong, faulty["true"].map(lambda g: "pat" if g != "pat" else "rub"))
    columns = ["capture", "fault", "severity"]
    folder = folder_of("faults", faulty[columns].assign(predicted=said), task="haart-faults-v1")
    found = submissions.score(submissions.read(folder))
    assert found["accuracy"] == pytest.approx(84 / 85) and found["clean"] == 1
    assert found["worst fault: noise"] == pytest.approx(0.8)


def test_a_run_is_submitted_with_its_labels_and_its_provenance(store, capsys):
    predictions = haart_predictions(windows=3)
    haart_run(store, predictions)
    assert main(["submit", "task=haart-loso-v1", "model=svm", "who=A. Name", "out=all/mine"]) == 0
    means = predictions.groupby("capture").mean(numeric_only=True).filter(like="p_")
    labels = means.to_numpy().argmax(axis=1)
    truth = predictions.groupby("capture")["true"].first()
    accuracy = (np.array([c[2:] for c in means])[labels] == truth).mean()
    assert f"{100 * accuracy:.1f} % of 829 captures" in capsys.readouterr().out
    one = submissions.read(Path("all/mine"))
    assert submissions.score(one)["accuracy"] == pytest.approx(accuracy)
    assert one.table.filter(like="p_").to_numpy() == pytest.approx(means.to_numpy(), abs=5.1e-4)
    assert one.about["command"] == "bench run data=haart protocol=loso" and one.about["digest"] == HAART
    assert (one.about["parameters"], one.about["revision"]) == (1000, "0123456789ab")
    assert sorted(os.listdir("all/mine")) == ["predictions.parquet", "submission.json"]
    assert main(["submit", "task=haart-loso-v1", "model=svm", "who=A. Name", "out=all/mine"]) == 2


def test_a_file_of_ones_own_is_known_by_name_and_content_not_by_its_folder(store, tmp_path):
    private = tmp_path / "secret place"
    private.mkdir()
    (private / "mine.py").write_text(MINE)
    assert main(["run", *SMALL, "jobs=1", f"model={private / 'mine.py'}:Taxels"]) == 0
    (run,) = [r for r in runs("cell")[1] if r.data.tags["model"] == "Taxels"]
    content = hashlib.sha256((private / "mine.py").read_bytes()).hexdigest()
    assert run.data.params["model_file"] == content
    arguments = {"data": "haart", "protocol": "loso", "model": f"{private / 'mine.py'}:Taxels"}
    tags = {"touchbench.arguments": json.dumps(arguments), "model_file": content}
    run_id = haart_run(store, **tags)
    assert main(["submit", "task=haart-loso-v1", f"run={run_id}", "who=me", "out=all/mine"]) == 0
    text = Path("all/mine/submission.json").read_text()
    about = submissions.read(Path("all/mine")).about
    assert "secret" not in text and str(tmp_path) not in text
    assert about["command"] == "bench run data=haart protocol=loso model=mine.py:Taxels"
    assert about["revision"] == f"mine.py {content[:12]}" and content in about["note"]
    assert "touchbench at 0123456789ab" in about["note"]


def test_a_row_keeps_its_digits_where_rounding_would_change_its_label():
    classes = sorted(set(CHALLENGE["true"]))
    proba = np.full((len(CHALLENGE), 7), 0.1, np.float32)
    proba[:, 2], proba[:, 5] = 0.2501, 0.2504  # both are 0.25, and the first of them would win
    proba[9, 5] = 0.2599
    labels = np.asarray(classes)[proba.argmax(axis=1)]
    table = CHALLENGE.assign(predicted=labels, **{f"p_{c}": proba[:, i] for i, c in enumerate(classes)})
    Path("f").mkdir()
    submissions.write(Path("f"), ABOUT, table)
    kept = submissions.read(Path("f")).table
    assert kept["predicted"].tolist() == labels.tolist() and set(labels) == {classes[5]}
    assert kept[f"p_{classes[5]}"][0] == np.float32(0.2504) and kept[f"p_{classes[5]}"][9] == np.float32(0.26)


@pytest.mark.parametrize(
    ("about", "said"),
    [
        ({"corpus_digest": "e" * 64}, "stored with data digest eeeeeeeeeeeeeeee, which is not haart-loso-v1"),
        ({"subset": "split == 'train'"}, "stored with subset split == 'train'"),
        ({"protocol": "kfold"}, "stored with protocol kfold"),
        ({"target": "cover"}, "stored with target cover"),
        ({"failed": 1}, "stored with status FAILED"),
        ({"seed": "3"}, "no run of bench run is stored of svm · jung54, seed none"),
    ],
)
def test_a_run_that_does_not_answer_the_task_is_refused(store, about, said, capsys):
    haart_run(store, **about)
    assert main(["submit", "task=haart-loso-v1", "model=svm", "who=me", "out=mine"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line and "bench run data=haart protocol=loso model=svm" in line
    assert not Path("mine").exists()


def test_a_personal_run_with_other_shots_is_refused(store, capsys):
    """Another seed draws other captures."""
    haart_run(store, protocol="personal[shots=3, seed=1]", **{"protocol.seed": "1"})
    assert main(["submit", "task=haart-personal-v1", "model=svm", "who=me", "out=mine"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "stored with protocol personal[shots=3, seed=1], which is not haart-personal-v1" in line
    assert "make a run: bench run data=haart protocol=personal protocol.shots=3 model=svm" in line


def test_a_run_without_all_captures_is_refused(store, capsys):
    haart_run(store, haart_predictions().query("capture != 7"))
    assert main(["submit", "task=haart-loso-v1", "model=svm", "who=me", "out=mine"]) == 2
    assert "has no label of capture 7" in capsys.readouterr().err
    other = haart_predictions().assign(true="pat")
    run = haart_run(store, other, seed="7")
    assert main(["submit", "task=haart-loso-v1", f"run={run}", "who=me", "out=mine"]) == 2
    assert "other captures than haart-loso-v1" in capsys.readouterr().err


def test_nothing_is_stored(capsys):
    assert main(["submit", "task=haart-early-v1", "model=lda", "features=touch", "who=me", "out=x"]) == 2
    wanted = "make one: bench stream data=haart protocol=loso model=lda features=touch"
    assert wanted in capsys.readouterr().err
    for arguments, said in (
        (["task=haart-los-v1", "who=me", "out=x"], "did you mean haart-loso-v1"),
        (["task=haart-loso-v1", "out=x"], "needs who="),
        (["task=haart-loso-v1", "who=me"], "needs out="),
        (["task=haart-loso-v1", "who=me", "out=x", "model=svm,rf"], "name 2 systems"),
        (["task=haart-loso-v1", "who=me", "out=x", "run=1", "model=svm"], "leave out model="),
        (["task=haart-loso-v1", "who=me", "out=x", "where=a == 1"], "no key is called 'where'"),
    ):
        assert main(["submit", *arguments]) == 2 and said in capsys.readouterr().err


def test_folders_that_are_not_there(capsys):
    Path("empty").mkdir()
    assert main(["leaderboard", "nowhere"]) == 2 and "no such folder" in capsys.readouterr().err
    assert main(["leaderboard", "empty"]) == 0 and "empty: no submission is in it" in capsys.readouterr().err
    assert main(["leaderboard", "out=empty"]) == 2 and not list(Path("empty").iterdir())


def test_the_page_has_every_task_and_ranks_by_what_it_computed():
    best = folder_of("best", system="all right")
    worst = folder_of(
        "worst", CHALLENGE[["capture"]].assign(predicted="pat"), system="always pat", note="accuracy 100 %"
    )
    text = board([submissions.read(worst), submissions.read(best), *reference()], [])
    for name in tasks.TASKS:
        assert f'<h2 id="{name}">' in text
    part = text[text.index('id="haart-challenge-v1"') : text.index('id="haart-early-v1"')]
    systems = re.findall(r'<tr><th scope="row">(.*?)</th><td>([0-9.]+) ', part)
    assert systems[0] == ("all right", "100.0") and systems[-1] == ("always pat", f"{100 * 36 / 251:.1f}")
    assert [float(a) for _, a in systems] == sorted((float(a) for _, a in systems), reverse=True)
    assert "Nobody has submitted a result yet" in text[text.index('id="cost-loso-v1"') :]
    assert not re.search(r"(src|href|action)=\"(?!#)", text)


def test_cost_is_only_what_was_published(monkeypatch, capsys):
    folder_of("mine", task="cost-loso-v1")
    assert main(["leaderboard", "all"]) == 1
    assert "left out: mine: data=cost: not imported" in capsys.readouterr().err
    small = random_corpus()
    warned = {"format": "cost", "warnings": ["captures: 36 here, 7805 published"]}
    monkeypatch.setattr(tasks, "open_corpus", lambda *_: small.changed(info=warned))
    with pytest.raises(InputError, match="not CoST as published .captures: 36 here"):
        tasks.rows_of(tasks.TASKS["cost-loso-v1"])
    whole = small.changed(info={"format": "cost", "warnings": []}, digest="c" * 64)
    monkeypatch.setattr(tasks, "open_corpus", lambda *_: whole)
    rows = tasks.rows_of(tasks.TASKS["cost-loso-v1"])
    assert rows["true"].tolist() == list(small.gestures) and tasks.digest_of(tasks.TASKS["cost-loso-v1"]) == "c" * 64


def test_the_workflow_runs_what_the_docs_say():
    flow = yaml.safe_load((ROOT / ".github" / "workflows" / "leaderboard.yml").read_text())
    (job,) = flow["jobs"].values()
    commands = [step["run"] for step in job["steps"] if "run" in step]
    assert flow[True]["pull_request"]["paths"] == ["submissions/**", marks.FILE]
    assert f"git diff --exit-code HEAD^1 -- {marks.FILE}" in commands and flow["permissions"] == {"contents": "read"}
    (made,) = [c for c in commands if c.startswith("bench leaderboard")]
    folder_of("mine")
    Path("all").rename("submissions")
    assert main(made.split()[1:]) == 0
    uploaded = [step["with"]["path"] for step in job["steps"] if "upload-artifact" in step.get("uses", "")]
    assert [Path(p).is_file() for p in uploaded] == [True]


def test_the_example_of_the_docs_is_a_submission():
    text = (ROOT / "docs" / "leaderboard.md").read_text()
    about = json.loads(re.search(r"```json\n(.*?)```", text, re.DOTALL)[1])
    folder = Path("mine")
    folder.mkdir()
    (folder / "submission.json").write_text(json.dumps(about))
    head, *rows = re.search(r"```csv\n(.*?)```", text, re.DOTALL)[1].split()
    listed = tasks.captures_of(tasks.TASKS[about["task"]])
    assert rows == [f"{c},{g}" for c, g in zip(listed["capture"][:2], listed["gesture"][:2], strict=True)]
    lines = [head, *(f"{c},{g}" for c, g in zip(listed["capture"], listed["gesture"], strict=True))]
    (folder / "predictions.csv").write_text("\n".join(lines))
    assert submissions.score(submissions.read(folder))["accuracy"] == 1
    assert all(f"`{name}`" in text for name in tasks.TASKS)


def test_the_script_of_the_docs_writes_what_the_format_asks_for(monkeypatch):
    (code,) = re.findall(r"```python\n(import numpy.*?)```", (ROOT / "docs" / "leaderboard.md").read_text(), re.DOTALL)
    corpus = random_corpus(subjects=3, per_class=8)
    monkeypatch.setattr(bench, "corpus", lambda name: corpus, raising=False)
    names = {}
    exec(code, names)
    table = pd.read_csv("predictions.csv")
    assert sorted(table["capture"]) == list(range(len(corpus))) and set(table["predicted"]) <= set(corpus.gestures)
    assert len(names["worse"]) == len(names["test"])


def test_our_own_rows_are_marked_and_so_is_a_design_on_haart(capsys):
    folder_of("copied", system="reflex", command="bench run data=haart protocol=challenge model=reflex")
    table = scores_of([submissions.read(Path("all/copied")), *reference()]).set_index(["task", "name"])
    assert table.loc[("haart-challenge-v1", "copied"), "origin"] == "submitted"
    assert set(table["origin"].drop(("haart-challenge-v1", "copied"))) == {"reference, shipped with touchbench"}
    assert set(table["verified"]) == {"not verified"}
    noted = {name for (_, name), note in table["note"].items() if "seven of HAART's ten people" in note}
    assert noted == {"copied", "reflex", "lda-touch", "rocket"}
    assert "reference, shipped with touchbench" in repr(bench.results("reference")).splitlines()[0]
    assert main(["leaderboard", "all"]) == 0
    first, note, page, then = capsys.readouterr().out.splitlines()
    assert first == "haart-challenge-v1: reflex by A. Name, 100.0 % of 251 captures, not verified"
    assert "seven of HAART's ten people" in note and page == "leaderboard.html" and then == "next: bench submit --help"
    text = Path(page).read_text()
    (row,) = re.findall(r'<tr><th scope="row">reflex</th><td>100.0 .*?</tr>', text)
    assert "<td>submitted</td><td>not verified</td>" in row and '-1">1</a>' in row
    assert text.count("<td>reference, shipped with touchbench</td>") == len(reference())
    assert "Test labels are public" in text


def test_what_a_run_rests_on_is_recorded_and_shown(store, capsys):
    haart_run(store, **{"touchbench.depends_on_batch": "true", "touchbench.conditions": "substrate,cover"})
    submit = ["submit", "task=haart-loso-v1", "model=svm", "who=A. Name", "out=all/mine"]
    assert main(submit) == 2
    assert "labels of this run depend on other test captures; to submit it, add batch=yes" in capsys.readouterr().err
    assert main([*submit, "batch=no"]) == 2 and "to submit it, add batch=yes" in capsys.readouterr().err
    assert main([*submit, "batch=yes"]) == 0
    about = submissions.read(Path("all/mine")).about
    assert (about["batch"], about["conditions"]) == ("yes", "substrate,cover")
    capsys.readouterr()
    assert main(["leaderboard", "all"]) == 0
    said = "labels depend on other test captures; uses substrate, cover"
    assert said in capsys.readouterr().out and f"<td>{said}</td>" in Path("leaderboard.html").read_text()
    assert not {"batch", "conditions"} & reference()[0].about.keys()
