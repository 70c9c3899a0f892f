"""The columns of runs in every output, and the numbers that runs track."""

from __future__ import annotations

from collections.abc import Iterable

from bench.values.few import FEWEST_FOR_INTERVAL, too_few_sentence
from bench.values.measures import (
    OF_SYSTEMS,
    OUTPUTS,
    Measure,
    Row,
    format_p_value,
    format_thousands,
    percent_measure,
    text_measure,
)

FIT = "training in a fold, mean over folds, without features and search, on the quiet machine"
PREDICT = "one capture from raw frames to label, on one thread of the quiet machine: median; `_p95`, `_p99`: quantiles"


def run_columns(output: str = "") -> list[Measure]:
    """Columns of tables of runs; an entry with a meaning is tracked. An ``output`` selects its columns."""
    page, csv, every = ("page",), ("csv",), OUTPUTS
    share = "mean over subjects of the share of correctly classified captures; `_low`, `_high`: 95 % t-interval"
    pooled = "share of correctly classified captures of all subjects; `_low`, `_high`: 95 % bootstrap over subjects"
    wall = "the same by the wall clock, on the machine as it was"
    every_one = [
        percent_measure("accuracy", "accuracy %", ends="accuracy", shows=every, meaning=share),
        percent_measure(
            "subject_sd", "SD", spare=11, shows=every, meaning="SD over subjects of their shares"
        ),
        text_measure("interval", source=interval_words, shows=csv),
        Measure("difference", form="+.1f", shows=csv, unit="points"),
        Measure("p_holm", "p Holm", form=format_p_value, spare=1, shows=("page", "latex", "csv")),
        text_measure("against", shows=csv),
        text_measure("unit", shows=csv),
        text_measure("combined", "windows combined by", spare=1, shows=("page", "csv")),
        text_measure("seed", shows=csv),
        percent_measure("pooled_accuracy", shows=csv, meaning=pooled),
        percent_measure(
            "macro_f1",
            "macro-F1 %",
            spare=12,
            shows=every,
            meaning="mean over gestures of F1, subjects pooled",
        ),
        percent_measure("macro_precision", shows=csv, meaning="the same of precision"),
        percent_measure("macro_recall", shows=(), meaning="the same of recall"),
        percent_measure(
            "abstained",
            "abstained %",
            spare=1,
            shows=every,
            meaning="captures without a label, if there are any",
        ),
        percent_measure("window_accuracy", "window accuracy %", spare=13, shows=("terminal",)),
        Measure(
            "fit_seconds", "fit s", form=".2f", spare=1, shows=("page", "latex", "csv"), meaning=FIT
        ),
        Measure("fit_cpu_seconds", shows=(), meaning="the same, time of the processor as it was"),
        Measure(
            "search_seconds",
            shows=(),
            meaning="search of parameters in a fold, mean over folds, of a tuned system",
        ),
        Measure(
            "predict_ms_p50",
            "predict ms",
            form=".2f",
            shows=("terminal", "latex", "csv"),
            meaning=PREDICT,
        ),
        Measure("predict_ms_p95", shows=csv),
        Measure("predict_wall_ms_p50", shows=csv, meaning=wall),
        Measure(
            "fit_wall_seconds",
            shows=csv,
            meaning="training by the wall clock, on the machine as it was",
        ),
        Measure(
            "slowdown",
            shows=csv,
            meaning="reference workload: time during the run by that on the quiet machine",
        ),
        Measure("reference_ms", shows=(), meaning="the reference workload, during the run"),
        Measure("quiet_ms", shows=(), meaning="the reference workload, on the quiet machine"),
        Measure(
            "predict_relative",
            shows=(),
            meaning="computing time as a multiple of the reference workload's",
        ),
        Measure(
            "decide_ms_p50", shows=(), meaning="computing time for no more touch than one window"
        ),
        Measure("decide_wall_ms_p50", shows=(), meaning=wall),
        *(cost for cost in OF_SYSTEMS if cost.shows),
        Measure(
            "predict",
            "predict ms p50 / p95",
            ("predict_ms_p50", "predict_ms_p95"),
            ".2f",
            spare=1,
            shows=page,
        ),
        Measure(
            "capture_ms",
            shows=csv,
            meaning="median touch of a capture, which `max_decision=` limits",
        ),
        Measure(
            "observed_ms",
            shows=(),
            meaning="median touch of a window, or of a capture without windows",
        ),
        Measure(
            "parameters",
            form=format_thousands,
            spare=1,
            shows=("page", "csv"),
            meaning="learnt numbers",
        ),
        Measure("peak_rss_bytes", shows=csv, meaning="most memory of the worker during a fold"),
        Measure(
            "captures",
            form=".0f",
            shows=csv,
            meaning="labelled captures, each in each of its test folds",
        ),
        Measure("windows", shows=(), meaning="labelled windows, if there are more than captures"),
        Measure(
            "subjects", form=format_thousands, shows=("page", "csv"), meaning="tested subjects"
        ),
        text_measure("published", "published %", spare=1, shows=("page", "csv"), unit="%"),
        text_measure("folds", shows=("page", "csv")),
        *(
            text_measure(name, shows=csv)
            for name in ("run_id", "group", "note", "subset", "data", "protocol")
        ),
    ]
    return [measure for measure in every_one if not output or output in measure.shows]


def unit_headings(measures: Iterable[Measure]) -> dict[str, str]:
    """The keys of columns with their units, unless the key has it, such as ``fit_seconds``."""
    return {measure.key: f"{measure.key} {measure.unit}" for measure in measures if measure.unit}


def interval_words(row: Row) -> str:
    """The kind of interval in a row of a run, or why there is none."""
    people = int(row["subjects"])
    return (
        too_few_sentence(people)
        if people < FEWEST_FOR_INTERVAL
        else "95 % t-interval over subjects"
    )
