"""The columns of runs in every output, and the numbers that runs track."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

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

MEANINGS = {  # of tracked numbers, by key; those of costs lie in `OF_SYSTEMS`
    "accuracy": (
        "mean over subjects of the share of correctly classified captures; `_low`, `_high`: "
        "95 % t-interval"
    ),
    "subject_sd": "SD over subjects of their shares",
    "pooled_accuracy": (
        "share of correctly classified captures of all subjects; `_low`, `_high`: 95 % "
        "bootstrap over subjects"
    ),
    "macro_f1": "mean over gestures of F1, subjects pooled",
    "macro_precision": "the same of precision",
    "macro_recall": "the same of recall",
    "abstained": "captures without a label, if there are any",
    "fit_seconds": (
        "training in a fold, mean over folds, without features and search, on the quiet machine"
    ),
    "fit_cpu_seconds": "the same, time of the processor as it was",
    "search_seconds": "search of parameters in a fold, mean over folds, of a tuned system",
    "predict_ms_p50": (
        "one capture from raw frames to label, on one thread of the quiet machine: median; "
        "`_p95`, `_p99`: quantiles"
    ),
    "predict_wall_ms_p50": "the same by the wall clock, on the machine as it was",
    "fit_wall_seconds": "training by the wall clock, on the machine as it was",
    "slowdown": "reference workload: time during the run by that on the quiet machine",
    "reference_ms": "the reference workload, during the run",
    "quiet_ms": "the reference workload, on the quiet machine",
    "predict_relative": "computing time as a multiple of the reference workload's",
    "decide_ms_p50": "computing time for no more touch than one window",
    "decide_wall_ms_p50": "the same by the wall clock, on the machine as it was",
    "capture_ms": "median touch of a capture, which `max_decision=` limits",
    "observed_ms": "median touch of a window, or of a capture without windows",
    "parameters": "learnt numbers",
    "peak_rss_bytes": "most memory of the worker during a fold",
    "captures": "labelled captures, each in each of its test folds",
    "windows": "labelled windows, if there are more than captures",
    "subjects": "tested subjects",
}


def run_columns(output: str = "") -> list[Measure]:
    """Columns of tables of runs, those of one ``output`` if it is given.

    A column with a meaning is a number that runs track.
    """
    page, csv = ("page",), ("csv",)
    page_csv, latex = ("page", "csv"), ("page", "latex", "csv")
    columns = [
        percent_measure("accuracy", "accuracy %", ends="accuracy", shows=OUTPUTS),
        percent_measure("subject_sd", "SD", spare=11, shows=OUTPUTS),
        text_measure("interval", source=interval_words, shows=csv),
        Measure("difference", form="+.1f", shows=csv, unit="points"),
        Measure("p_holm", "p Holm", form=format_p_value, spare=1, shows=latex),
        text_measure("against", shows=csv),
        text_measure("unit", shows=csv),
        text_measure("combined", "windows combined by", spare=1, shows=page_csv),
        text_measure("seed", shows=csv),
        percent_measure("pooled_accuracy", shows=csv),
        percent_measure("macro_f1", "macro-F1 %", spare=12, shows=OUTPUTS),
        percent_measure("macro_precision", shows=csv),
        percent_measure("macro_recall", shows=()),
        percent_measure("abstained", "abstained %", spare=1, shows=OUTPUTS),
        percent_measure("window_accuracy", "window accuracy %", spare=13, shows=("terminal",)),
        Measure("fit_seconds", "fit s", form=".2f", spare=1, shows=latex),
        Measure("fit_cpu_seconds", shows=()),
        Measure("search_seconds", shows=()),
        Measure("predict_ms_p50", "predict ms", form=".2f", shows=("terminal", "latex", "csv")),
        Measure("predict_ms_p95", shows=csv),
        Measure("predict_wall_ms_p50", shows=csv),
        Measure("fit_wall_seconds", shows=csv),
        Measure("slowdown", shows=csv),
        Measure("reference_ms", shows=()),
        Measure("quiet_ms", shows=()),
        Measure("predict_relative", shows=()),
        Measure("decide_ms_p50", shows=()),
        Measure("decide_wall_ms_p50", shows=()),
        *(cost for cost in OF_SYSTEMS if cost.shows),
        Measure(
            "predict",
            "predict ms p50 / p95",
            ("predict_ms_p50", "predict_ms_p95"),
            ".2f",
            spare=1,
            shows=page,
        ),
        Measure("capture_ms", shows=csv),
        Measure("observed_ms", shows=()),
        Measure("parameters", form=format_thousands, spare=1, shows=page_csv),
        Measure("peak_rss_bytes", shows=csv),
        Measure("captures", form=".0f", shows=csv),
        Measure("windows", shows=()),
        Measure("subjects", form=format_thousands, shows=page_csv),
        text_measure("published", "published %", spare=1, shows=page_csv, unit="%"),
        text_measure("folds", shows=page_csv),
    ]
    names = ("run_id", "group", "note", "subset", "data", "protocol")
    columns += [text_measure(name, shows=csv) for name in names]
    columns = [replace(c, meaning=MEANINGS.get(c.key, c.meaning)) for c in columns]
    return [column for column in columns if not output or output in column.shows]


def unit_headings(measures: Iterable[Measure]) -> dict[str, str]:
    """The key of each column that has a unit, with it, such as ``predict ms``."""
    return {measure.key: f"{measure.key} {measure.unit}" for measure in measures if measure.unit}


def interval_words(row: Row) -> str:
    """Name the interval in a row of a run, or say why there is none."""
    people = int(row["subjects"])
    return (
        too_few_sentence(people)
        if people < FEWEST_FOR_INTERVAL
        else "95 % t-interval over subjects"
    )
