"""Measures, costs, and columns of runs, against values by hand."""

import numpy as np
import pandas as pd
import pytest

from bench.errors import InputError
from bench.values.columns import run_columns
from bench.values.measures import (
    Cost,
    Interval,
    Measure,
    all_costs,
    format_three_digits,
    percent_measure,
    text_measure,
    to_thousands,
)

ROW = {"share": 0.8125, "share_low": 0.75, "share_high": 0.9, "bytes": 90064, "p50": 1.5}
ROW |= {"p95": None, "name": "a"}
SHARE = percent_measure("accuracy", source="share", ends="share")
KILOBYTES = Measure("kB", source="bytes", form=format_three_digits, scale=to_thousands)


@pytest.mark.parametrize(
    ("measure", "value", "text"),
    [
        (SHARE, Interval(81.25, 75.0, 90.0), "81.2 [75.0, 90.0]"),
        (percent_measure("share", ends="bytes"), 81.25, "81.2"),  # no interval of this name
        (KILOBYTES, 90.064, "90.1"),
        (Measure("B", source="bytes", form=format_three_digits), 90064, "90 064"),
        (Measure("ms", source=("p50", "p95"), form=".2f"), (1.5, None), "1.50"),
        (Measure("ms", source=("p95", "p50")), (None, 1.5), "- / 1.5"),
        (text_measure("name"), "a", "a"),
        (Measure("nothing", source=lambda row: pd.NA), None, "-"),
        (Measure("zero", source=lambda row: 0.0), 0.0, "0.0"),
    ],
)
def test_a_measure_reads_and_formats_a_value(measure, value, text):
    assert measure.value_of_row(ROW) == value and measure.as_text(ROW) == text


def test_costs_have_their_budgets_and_amounts():
    costs, least = all_costs(), ["worst_person", "worst_tenth"]
    skin = ["taxels", "wires", "values_per_s", "bits_per_s", "frame", "processor"]
    first = ["flash", "ram", "predict", *skin]
    assert [*costs] == [*first, "decision", "fault_loss", "worst_fault", *least]
    for name, cost in costs.items():
        assert cost.budget_key == f"{'min' if name in least else 'max'}_{name}"
    run = {"flash_bytes": 2500, "ram_bytes": 512, "predict_ms_p50": 1.5, "predict_ms_p95": 9}
    run |= {"capture_ms": 300, "taxels": 16, "wires": 8, "frame_bytes": 16}
    run |= {"values_per_s": 432, "bits_per_s": 2592}
    amounts = {"flash": 2.5, "ram": 0.512, "predict": 1.5, "decision": 300, "processor": 5}
    amounts |= {"taxels": 16, "wires": 8, "values_per_s": 432, "bits_per_s": 2592, "frame": 0.016}
    measured = {n: cost.value_of_row(run) for n, cost in costs.items() if cost.of_people is None}
    assert measured == amounts


def test_a_cost_reads_and_formats_budgets():
    flash = all_costs()["flash"]
    assert flash.parse_budget("1MiB") == pytest.approx(1048.576)
    assert flash.format_budget(64) == "max_flash=64kB"
    assert [flash.format_amount(x) for x in (64, 1234.5, np.nan)] == ["64 kB", "1234 kB", "-"]
    assert flash.format_two_amounts(64.001, 64.002) == ("64.001 kB", "64.002 kB")
    with pytest.raises(InputError, match="max_flash="):
        flash.parse_budget("3ms")
    with pytest.raises(InputError, match="min_worst_person=101: give a number from 0 to 100"):
        all_costs()["worst_person"].parse_budget("101")
    life = Cost("battery_life", unit="h", better="high")
    assert (life.budget_key, life.best_word, life.as_burden(3.0)) == (
        "min_battery_life",
        "highest",
        -3.0,
    )
    phrases = ("battery life", "of battery life", "battery life (h)")
    assert (life.noun, life.phrase, life.axis) == phrases


def test_columns_of_runs_by_hand():
    columns = {measure.key: measure for measure in run_columns()}
    run = {"accuracy": 0.75, "pooled_accuracy": 0.8, "subject_sd": 0.125, "fit_seconds": 1.234}
    texts = ["75.0", "80.0", "12.5", "1.23"]
    assert [columns[name].as_text(run) for name in run] == texts
    interval = {"accuracy_low": 0.7, "accuracy_high": 0.8}
    assert columns["accuracy"].as_text(run | interval) == "75.0 [70.0, 80.0]"
    assert columns["accuracy"].as_text({}) == "-"
