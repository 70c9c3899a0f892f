"""Results that come with touchbench, beside stored runs and by themselves."""

import pandas as pd
import pytest

import bench
from bench.board.tasks import HAART
from tests.reports.store import tracked_run, with_hits


def test_reference_results_are_listed_and_take_part_in_no_test(store):
    tags = {"data": "haart", "synthetic": "false", "corpus_digest": HAART, "protocol_label": "LOSO (10 subjects)"}
    tracked_run(store, "mine", with_hits([18] * 10), **tags)
    with pytest.raises(bench.InputError, match="take part in no test"):
        bench.compare("mine", "reflex (reference)")
    results = bench.results("reference")
    reference = results.tables["haart-loso-v1/reflex"]
    own = (reference["true"] == reference["predicted"]).groupby(reference["subject"]).mean().mean()
    row = bench.results().set_index("system").loc["reflex (reference)"]
    assert row["accuracy"] == pytest.approx(100 * own) and pd.isna(row["p_holm"]) and not row["against"]
    assert results.full.equals(pd.DataFrame(results)) and not results.runs
    assert "haart-loso-v1" in repr(results) and "reflex" in results._repr_html_()
