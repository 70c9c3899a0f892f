"""The choice among candidates against hand-made ones, and which results become candidates."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_rel

from bench.errors import InputError
from bench.reading.candidates import Candidates, comparable_runs, find_candidates
from bench.reading.choice import choose_candidate
from bench.reading.runs import NothingTracked
from tests.reading.results import make_predictions, make_result, make_run, system_names


def made(accuracies, **costs):
    """Candidates with these accuracies of subjects and costs."""
    subjects = pd.DataFrame(accuracies).rename(columns=lambda i: "abcdef"[i]).astype(float)
    rows = pd.DataFrame({"system": [f"s{i}" for i in range(len(subjects))], "unit": "capture"})
    usual = {name: [1.0] * len(rows) for name in ("flash", "ram", "predict", "decision")}
    rows = rows.assign(accuracy=subjects.mean(axis=1), **usual | costs)
    return Candidates(rows, subjects, np.empty(0), np.empty(0), make_result(), [])


def test_the_cheapest_within_one_standard_error_is_chosen():
    # s1 loses 1, 3, 0, 0 points: mean 1, SD sqrt(2), SE 0.707: worse.
    # s2 loses 3, -1, 2, -2: mean 0.5, SE 1.19: near the best.
    candidates = made(
        [[80, 70, 60, 90], [79, 67, 60, 90], [77, 71, 58, 92]], flash=[50.0, 1.0, 9.0]
    )
    choice = choose_candidate(candidates, "flash", {})
    assert (choice.chosen, choice.best, choice.costlier) == (2, 0, 0)
    assert list(choice.table.index) == [1, 2, 0]  # cheapest first
    assert list(choice.table["verdict"]) == ["below the best", "chosen", "the best, costlier"]
    assert choice.table.loc[1, ["loss", "error"]].tolist() == pytest.approx([1, np.sqrt(2) / 2])
    assert choice.table.loc[2, ["loss", "error"]].tolist() == pytest.approx(
        [0.5, np.sqrt(17 / 3) / 2]
    )


def test_budgets_rule_out_what_is_over_them_or_not_known():
    candidates = made([[90] * 4, [80] * 4, [70] * 4, [60] * 4], ram=[40.0, np.nan, 32.0, 1.0])
    choice = choose_candidate(candidates, "flash", {"ram": 32.0})
    assert (choice.chosen, choice.best) == (2, 2)
    assert choice.table["verdict"][:2].to_dict() == {
        0: "ruled out: ram 40 kB > 32 kB",
        1: "ruled out: ram unknown",
    }
    assert (
        choose_candidate(candidates, "flash", {"ram": 32.0 * (1 - 1e-12)}).chosen == 2
    )  # rounding is no excess
    assert choose_candidate(candidates, "flash", {"ram": 0.5}).chosen is None


def test_a_margin_asks_for_proof_of_equivalence():
    best = np.random.default_rng(0).uniform(60, 90, 6)
    noise = np.array([0.5, -0.4, 0.1, -0.1, 0.3, -0.2])
    candidates = made([best, best - 1 + noise, best - 1 + 12 * noise], flash=[9.0, 2.0, 1.0])
    for i, shown in ((1, True), (2, False)):
        p = ttest_rel(
            candidates.subjects.loc[0] - 3, candidates.subjects.loc[i], alternative="less"
        ).pvalue
        assert (p < 0.05) == shown
    assert [choose_candidate(candidates, "flash", {}, margin).chosen for margin in (3.0, 0.5)] == [
        1,
        0,
    ]
    few = made([[90] * 5, [89.5] * 5], flash=[9.0, 1.0])
    assert choose_candidate(few, "flash", {}, 3.0).chosen == 0  # too few for a p value


def test_each_budget_has_its_price_and_what_binds():
    # Without ram: s0, whose subjects are 10, 14, 10 and 6 points better than those of s2.
    accuracies = [[90, 84, 70, 76], [80] * 4, [80, 70, 60, 70]]
    candidates = made(
        accuracies, ram=[40.0, 32.0, 8.0], flash=[9.0, 20.0, 3.0], predict=[1.0, np.nan, 2.0]
    )
    choice = choose_candidate(candidates, "flash", {"ram": 32.0, "flash": 10.0})
    ram, flash = choice.limits
    counts = ["over", "unknown", "least", "without"]
    assert choice.chosen == 2 and [ram[key] for key in counts] == [1, 0, 2, 0]
    assert (ram["gain"], ram["error"]) == pytest.approx((10, np.sqrt(32 / 3) / 2))
    assert (flash["without"], flash["gain"]) == (1, 10)
    loose = choose_candidate(candidates, "flash", {"ram": 50.0})
    assert (loose.limits[0]["without"], loose.limits[0]["gain"]) == (loose.best, 0)
    ram, predict = choose_candidate(candidates, "flash", {"ram": 4.0, "predict": 1.5}).limits
    assert [ram[key] for key in counts] == [3, 0, 2, 0] and np.isnan(ram["gain"])
    assert [predict[key] for key in counts] == [1, 1, 0, None]


def test_ties_and_one_subject():
    candidates = made(
        [[0.1, 0.2, 0.3, 0.0], [0.3, 0.2, 0.1, 0.0]], flash=[9.0, 1.0]
    )  # sums differ by 1e-17
    choice = choose_candidate(candidates, "flash", {})
    assert (choice.chosen, choice.best, choice.costlier) == (1, 1, None)
    candidates = made([[90.0], [90.0], [80.0]], flash=[9.0, 5.0, 1.0])
    choice = choose_candidate(candidates, "flash", {"ram": 2.0})
    words = " ".join(choice.reason_sentences())
    assert choice.chosen == 1 and "1 subject: too few for an interval" in words
    assert "within" not in words and "nan" not in words


OF_PEOPLE = ("worst_person", "fault_loss")


def people_of(seed, candidates=5, subjects=6):
    """Candidates with round numbers of each person, and the contributions of the people."""
    rng = np.random.default_rng(seed)
    scores = np.minimum(
        rng.uniform(60, 90, (candidates, 1)) + rng.normal(0, 8, (candidates, subjects)), 100
    )
    counts = np.stack([rng.poisson(2, scores.shape), rng.uniform(0.5, 1, scores.shape)]).astype(
        float
    )
    losses = rng.normal(8, 5, (candidates, 3, subjects))
    frame = pd.DataFrame(scores, columns=[*"abcdefghijkl"[:subjects]])
    table = pd.DataFrame({"system": "s", "unit": "capture", "accuracy": scores.mean(axis=1)})
    table["flash"] = [*rng.uniform(1, 50, candidates - 1), np.nan]
    return Candidates(table, frame, losses, counts, make_result(), []).with_people_costs(OF_PEOPLE)


def test_costs_of_people_are_those_of_a_loop():
    people = people_of(0)
    alarms, hours = people.counts.sum(axis=2)
    costs = people.with_people_costs(("worst_person", "fault_loss", "worst_fault", "flash")).table
    scores = people.subjects.to_numpy()
    for i, row in enumerate(scores):
        assert costs["worst_person"][i] == min(row)
        assert people.mean_of_lowest(2)[i] == pytest.approx(np.mean(sorted(row)[:2]))
        assert costs["fault_loss"][i] == pytest.approx(
            np.mean([np.mean(case) for case in people.losses[i]])
        )
        assert costs["worst_fault"][i] == pytest.approx(
            max(np.mean(case) for case in people.losses[i])
        )
        assert people.events_per_hour()[i] == pytest.approx(alarms[i] / hours[i])
    assert costs["flash"].equals(people.table["flash"])
    assert people.without_person(2, ()).mean_of_lowest(1)[0] == min(np.delete(scores[0], 2))


@pytest.mark.parametrize("budgets", [{}, {"worst_person": 55.0, "fault_loss": 9.0}])
def test_each_person_is_left_out_of_the_choice_and_of_nothing_else(budgets):
    others = 0
    for seed in range(8):
        choice = choose_candidate(people_of(seed), "flash", budgets)
        if choice.chosen is None:
            assert choice.left_out_scores is None
            continue
        for person, score in enumerate(choice.left_out_scores):
            left = choice.candidates.without_person(person, OF_PEOPLE)
            other = choose_candidate(left, "flash", budgets).chosen
            scores = choice.candidates.subjects.iloc[:, person]
            assert np.isnan(score) if other is None else score == scores[other]
            others += other not in (None, choice.chosen)
    assert others
    assert choose_candidate(people_of(0, subjects=4), "flash", {}).left_out_scores is None


# Which runs are candidates


def run(system, predictions=None, tables=None, **about):
    """A result with round costs."""
    numbers = {"ram_bytes": 500.0, "predict_ms_p50": 2.0, "decide_ms_p50": 0.5, "capture_ms": 300.0}
    numbers |= {"flash_bytes": 4000.0, "observed_ms": 100.0, "windows": np.nan}
    numbers |= {k: about.pop(k) for k in [*about] if not isinstance(about[k], str)}
    return make_run(
        system, predictions, metrics=numbers, tables=tables, **{"protocol_label": "LOSO"} | about
    )


def systems(results, asked=None, **how):
    return sorted(system_names(comparable_runs(results, asked or {}, **how)[0]))


def percents(labelled):
    """Accuracy of each subject by a loop."""
    hits = {}
    for row in labelled.to_dict("records"):
        p = {name[2:]: value for name, value in row.items() if name.startswith("p_")}
        hits.setdefault(row["subject"], []).append(max(p, key=p.get) == row["true"])
    return {subject: 100 * np.mean(each) for subject, each in hits.items()}


def test_seeds_are_averaged():
    tables = [make_predictions(per_class=2, seed=seed) for seed in (0, 1)]
    seeds = [
        run(
            "rf",
            table,
            flash_bytes=4000.0 + 2000 * s,
            seed=str(s),
            **{"touchbench.arguments": f'{{"seed": "{s}"}}'},
        )
        for s, table in enumerate(tables)
    ]
    other = run("lda", **{"touchbench.conditions": "cover", "cpu": "two"})
    among = find_candidates([*seeds, other], {})
    assert among.table[["system", "unit", "flash", "conditions", "cpu"]].to_numpy().tolist() == [
        ["lda (uses cover)", "capture", 4.0, "cover", "two"],
        ["rf", "capture", 5.0, "", "one"],
    ]
    assert among.table["decision"].tolist() == [300, 300] and among.table["predict"].tolist() == [
        2,
        2,
    ]
    assert among.table["arguments"][1] == '{"seed": "0"}'  # also if seed 1 was run last
    one, other = (percents(table) for table in tables)
    assert among.subjects.loc[1].to_dict() == pytest.approx(
        {s: (one[s] + other[s]) / 2 for s in one}
    )
    assert not among.mixes_subjects and among.context == "synth (synthetic), all, LOSO"
    assert find_candidates([run("lda", mixes_subjects="true")], {}).mixes_subjects


def test_a_replayed_system_decides_as_late_as_the_budget_allows():
    early, late = (
        make_predictions(per_class=1, seed=1).assign(instant=10),
        make_predictions(per_class=1, seed=2).assign(instant=20),
    )
    replay = pd.concat([early, late], ignore_index=True)

    def replayed(start, *ms):
        options = {"stream.start": start, "stream.hop_ms": "None", "stream.after": "each"}
        tables = {"replay": replay, "instants": pd.DataFrame({"ms": ms})}
        return run("lda", tables=tables, replay_ms_p50=0.5, **options)

    results = [run("lda"), replayed("onset", 100.0, 200.0), replayed("middle", 150.0, 200.0)]
    both = ["first 100 ms", "first 200 ms"]
    soon = {
        None: [],
        np.inf: both,
        200.0: both[1:],
        200 * (1 - 1e-12): both[1:],
        199.9: both[:1],
        1.0: both[:1],
    }
    for (
        most,
        units,
    ) in soon.items():  # the earliest, where none is soon enough: it says how far it is from that
        assert list(find_candidates(results, {}, latest_ms=most).table["unit"]) == [
            "capture",
            *units,
        ], most
    among = find_candidates(results, {}, latest_ms=np.inf)
    assert among.table["decision"].tolist() == [300, 100, 200] and among.table[
        "predict"
    ].tolist() == [2, 0.5, 0.5]
    for place, seen in ((1, early), (2, late)):
        assert among.subjects.loc[place].to_dict() == pytest.approx(percents(seen))


def test_runs_on_the_newest_corpus_of_a_name_win():
    results = [
        run(system, corpus_digest=digest * 64)
        for system, digest in (("svm", "a"), ("rf", "a"), ("lda", "b"))
    ]
    kept, (note,) = comparable_runs(results, {})
    assert system_names(kept) == ["lda"]
    assert "2 runs on other captures" in note and "aaaaaaaa" in note
    asked = {
        name: [results[0][name]] for name in ("corpus_digest", "protocol_label")
    }  # as the page asks
    assert systems(results, asked) == ["rf", "svm"]


def test_arguments_tell_protocols_apart():
    tags = {"protocol": "challenge[seed=1]", "protocol.seed": "1", "protocol_label": "seed 1"}
    first = {"protocol": "challenge", "protocol.seed": "0", "protocol_label": "seed 0"}
    results = [run("lda", **first), run("rf", **tags), run("svm")]
    results.append(run("xgb", target="hand"))
    with pytest.raises(InputError) as error:
        systems(results)
    options = str(error.value).partition("name one of: ")[2].split("; ")
    for option, system in zip(options, ("lda", "rf", "svm"), strict=True):
        words = dict(word.split("=") for word in option.split())
        assert systems(results, {key: [value] for key, value in words.items()}) == [system]
    assert systems(results, {"protocol.seed": ["1"]}) == ["rf"] and systems(
        results, {"target": ["hand"]}
    ) == ["xgb"]
    with pytest.raises(InputError, match=r"protocol\.folds"):
        systems(results, {"protocol.folds": ["2"]})
    with pytest.raises(NothingTracked):
        systems(results, {"protocol.seed": ["9"]})


def test_a_run_with_a_failed_fold_is_named():
    results = [run("svm"), run("svm", status="FAILED"), run("rf", status="FAILED")]
    results.append(run("xgb", status="FAILED", corpus_digest="e" * 64))  # elsewhere
    kept, (note,) = comparable_runs(results, {})
    assert system_names(kept) == ["svm"] and "folds failed: rf." in note
    with pytest.raises(NothingTracked, match="folds failed: rf"):
        systems(results, {"system": ["rf"]})


def test_what_to_expect_is_the_mean_of_people_left_out_and_the_worst_person():
    choice = choose_candidate(people_of(1), "flash", {})
    scores = np.array([70.0, 80, 75, 85, 80, 90])
    vars(choice)["left_out_scores"] = scores
    expect, worst = choice.expectation_sentences()
    # 80 +- 2.571 * 7.071 / sqrt(6)
    assert expect.startswith("Expect 80.0 % [72.6, 87.4] for new people")
    own = choice.candidates.subjects.loc[choice.chosen]
    assert f"subject {own.idxmin()}, has {own.min():.1f} %" in worst
    vars(choice)["left_out_scores"] = np.array([*scores[:5], np.nan])
    assert "nothing fits" in choice.expectation_sentences()[0]
