"""What the page says in a sentence, and the curves behind it, against numbers that are known beforehand."""

from bench.registry import views
from bench.reports.contexts import contexts
from tests.results import evaluated, stressed

BOTH = {"noise": 0.1, "shift": 0.234}


def test_faults_of_each_method_the_run_that_met_most_then_the_newest_with_its_lowest_seed(tmp_path):
    results = [
        stressed("svm", 0.5, BOTH),
        whole := stressed("svm", 0.6, BOTH, {"half_margin.shift": 2.25}),
        stressed("svm", 0.6, {"noise": 0.3}),
        stressed("svm", 0.9, BOTH, status="FAILED"),
        stressed("svm", 0.9, BOTH, seed="1"),
        forest := stressed("rf", 0.7, {"noise": 0.05}),
        stressed("rf", 0.7, BOTH, subset="cover == 'none'"),
        stressed("rf", 0.7, BOTH, data="synth", synthetic="true"),
    ]
    (first, runs), *rest = contexts(results, more="loss.")
    assert runs == [forest, whole] and first.endswith("only the lowest seed of each system")
    assert ["cover" in name for name, _ in rest] == [True, False] and "(synthetic)" in rest[1][0]
    part = views()["under"].section(results, tmp_path).parts[0]
    picture, table = part.picture, part.table
    drawn = picture.path.read_text()
    assert all(f">{text}</text>" in drawn for text in ("23", "10", "5", "-", "svm (60 % clean)", "rf (70 % clean)"))
    row = table.shown().set_index("system").loc["svm"]
    assert row["half of the margin is lost at"] == "shift 2.2" and row["failing of tested groups"] == "3 of 40"
    assert row["worst subject"] == "30.0" and table.shown()["system"].tolist() == ["rf", "svm"]


def test_groups_of_several_corpora_and_words_of_what_they_share_come_from_the_class():
    runs = [evaluated("svm", corpus_digest=digest, **{"dim.mode": mode}) for digest in "ab" for mode in ("up", "down")]
    same = {"dim.mode": ("pressed {}", "up")}
    found = contexts(runs, same)
    assert len(found) == 3 and [members for _, members in contexts(runs)] == [[runs[3]], [runs[1]]]
    assert ["pressed down" in words for words, _ in found] == [True, False, True]
    assert len({words for words, _ in found}) == 3 and not any("up" in words for words, _ in found)
