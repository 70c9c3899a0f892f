"""Stored runs as one table: a row for each run or case, with a name that distinguishes it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from bench.errors import InputError, suggest_names
from bench.ground.typed import arguments_of_label, format_command
from bench.values import scores
from bench.values.result import FOLD_COUNTS, Result, Row, comparison_key, setting_phrases

DESCRIPTION = (
    "system model features parameters seed unit subset target data protocol".split()
)  # columns that describe a run
PARTS = ("model", "features", "protocol", "data", "skin")  # whose parameters are ``<part>.<name>``
CONTEXT = ("data", "subset", "target", "protocol")
SHARE_NAMES = ("accuracy", "subject_sd", "macro_")  # in names of numbers that are shown in percent
ACCURACY_COLUMNS = {  # stored names by column
    "accuracy": "accuracy",
    "low": "accuracy_low",
    "high": "accuracy_high",
    "subject_sd": "subject_sd",
}
LABELLED = ("predictions", "decisions")  # tables that are made of the stored predictions
NAMES_OF_LABELS = {"capture": "id", "true": "truth", "predicted": "prediction"}
PERCENT_OF_CASE = ("accuracy", "low", "high", "subject_sd", "loss")
# Columns of stored tables that are shares
SHARES = (*PERCENT_OF_CASE, "precision", "recall", "f1")
# Beginnings of tags and parameters that other columns show, or that tell no reader anything.
HIDDEN = tuple(
    "touchbench. version. mlflow. run_id status started artifacts git threads cpu simd unit "
    "synthetic data subset mixes_subjects test_over_train official_split model features system "
    "where target protocol".split()
)
WORDS = {
    "seed": "seed {}",
    "corpus_digest": "corpus {:.8}",
    "touchbench.changes": "{}",
    "run_id": "run {:.8}",
}


def group_results(
    results: Sequence[Result], same: Mapping[str, tuple[str, str]] | None = None
) -> dict[str, list[Result]]:
    """Group results by captures and protocol, in words; only results of one group are compared.

    Generated captures say so; if several corpora have one name, the digest distinguishes them.
    Results of a group also share the parameters ``same``, each with its words and usual value
    (`bench.values.result.setting_phrases`).
    """
    same = same or {}
    words = {comparison_key(r, same): [*r.context, *setting_phrases(r, same)] for r in results}
    texts = {key: ", ".join(each) for key, each in words.items()}
    digests: dict[str, set[str]] = {}
    for key, text in texts.items():
        digests.setdefault(text, set()).add(key[1])
    groups: dict[str, list[Result]] = {}
    for r in results:
        key = comparison_key(r, same)
        digest = f", corpus {key[1][:8]}" if len(digests[texts[key]]) > 1 else ""
        groups.setdefault(texts[key] + digest, []).append(r)
    return groups


def name_rows(results: Sequence[Row], context: bool = False) -> list[str]:
    """Name the rows of some runs: the system, and what distinguishes runs of this system.

    With ``context`` also captures and protocol, for a table without columns for them.
    """
    names = [r.system if isinstance(r, Result) else str(r["system"]) for r in results]
    alike: dict[tuple, list[int]] = {}  # rows that only their names could tell apart
    for i, r in enumerate(results):
        columns = () if context else [str(r.get(key)) for key in ("data", "subset", "protocol")]
        alike.setdefault((names[i], *columns), []).append(i)
    for rows in alike.values():
        keys = _distinguishing_keys([results[i] for i in rows], context) if len(rows) > 1 else []
        for i in rows:
            words = [_format_parameter(k, results[i][k]) for k in keys if k in results[i]]
            names[i] = ", ".join([names[i], *words])
    return names


def _distinguishing_keys(rows: Sequence[Row], context: bool) -> list[str]:
    """Tags and parameters in which rows differ, as many as distinguish them; else also their id."""
    attributes = [r.attributes if isinstance(r, Result) else r for r in rows]
    every = dict.fromkeys(key for r in attributes for key in r)
    usual = [key for key in every if not key.endswith(("_name", "_file"))]
    shown = [key for key in usual if _is_parameter(key) or not key.startswith(HIDDEN)]
    kept: dict[tuple[int, ...], str] = {}  # by how they divide the rows
    first_keys = [*(CONTEXT if context else ()), "seed", "touchbench.changes"]
    for key in dict.fromkeys([*first_keys, *shown, "corpus_digest"]):
        first: dict[str, int] = {}
        parts = tuple(first.setdefault(str(r.get(key, "")), i) for i, r in enumerate(attributes))
        if any(parts):
            kept.setdefault(parts, key)
    if kept and len({*zip(*kept, strict=True)}) == len(rows):
        return [*kept.values()]
    return [*kept.values(), "run_id"]


def _is_parameter(key: str) -> bool:
    part, dot, _ = key.partition(".")
    return part in PARTS and dot == "."


def _format_parameter(key: str, value: object) -> str:
    """A tag or parameter in words, such as "seed 0" or "detector frames"."""
    if key in WORDS:
        return WORDS[key].format(str(value))
    return f"{key.rpartition('.')[2].replace('_', ' ')} {value}"


def runs_table(results: Sequence[Result], cases: bool = False) -> pd.DataFrame:
    """A row for each run: its name, its numbers, its description, its folds and its id.

    Shares are in percent. ``accuracy`` is the mean over subjects with its 95 % t-interval (``low``,
    ``high``) and SD (``subject_sd``), ``pooled_accuracy`` is over captures. ``complete`` is False
    if a fold failed, ``alone`` False if labels depend on other test captures. With ``cases``, a row
    for each case of the circumstances of each run, such as a fault at one severity.
    """
    from bench.values.stability import accuracy_curve

    rows = []
    for name, r in zip(name_rows(results), results, strict=True):
        row: dict[str, Any] = {"complete": r.is_complete, "alone": r.predicts_alone}
        row |= {"folds": r.folds, "run_id": r["run_id"], **_describe_run(r)}
        if not cases:
            rows.append({"name": name} | _numbers_in_percent(r) | row)
            continue
        labels = r.tables.get("labels")
        keys = [] if labels is None else filter(None, labels["circumstance"].unique())
        for key in keys:
            for case in accuracy_curve(labels, key).to_dict("records"):
                case |= {column: 100 * case[column] for column in PERCENT_OF_CASE if column in case}
                rows.append({"name": name, "circumstance": key} | case | row)
    table = pd.DataFrame(rows, columns=None if rows else ["name", *DESCRIPTION])
    return table[[*(column for column in table if column not in DESCRIPTION), *DESCRIPTION]]


def _describe_run(r: Result) -> dict[str, Any]:
    """The columns `DESCRIPTION` of a run."""
    data, _, protocol = r.context
    parameters = [f"{key}={value}" for key, value in r.attributes.items() if _is_parameter(key)]
    parts = (r.system, r.get("model_name", ""), r.get("features_name", ""), ", ".join(parameters))
    # Accuracies are those of captures, also of systems on windows.
    context = (r["seed"], "capture", r["subset"], r["target"], data, protocol)
    return dict(zip(DESCRIPTION, (*parts, *context), strict=True))


def _numbers_in_percent(r: Result) -> dict[str, Any]:
    """The numbers of a run, shares in percent, the accuracy first."""
    numbers = {name: value for name, value in r.metrics.items() if name not in FOLD_COUNTS}
    for name in numbers:
        if any(part in name for part in SHARE_NAMES):
            numbers[name] *= 100
    if "accuracy" not in numbers:
        return numbers
    first = {name: numbers.pop(key, float("nan")) for name, key in ACCURACY_COLUMNS.items()}
    return first | numbers


def join_tables(results: Sequence[Result], name: str = "predictions") -> pd.DataFrame:
    """A table of some runs as one, with the ``name`` and ``run_id`` of the run in each row.

    ``predictions`` has a row for each capture, ``decisions`` one for each window, with the columns
    that `bench.compare` reads. Shares are in percent.

    Raises:
        InputError: no run has this table.
    """
    parts = []
    for label, r in zip(name_rows(results, context=True), results, strict=True):
        table = r.tables.get("predictions" if name in LABELLED else name)
        if table is not None:
            table = table.drop(columns=["name", "run_id"], errors="ignore")
            table = _label_rows(table, name) if name in LABELLED else table
            shares = {column: 100 * table[column] for column in SHARES if column in table}
            parts.append(table.assign(**shares, name=label, run_id=r["run_id"]))
    if not parts:
        names = {each for r in results for each in r.tables}
        names |= {*LABELLED} if "predictions" in names else set()
        raise InputError(f"no run has a table {name}; {suggest_names(name, names)}")
    return pd.concat(parts, ignore_index=True)


def _label_rows(predictions: pd.DataFrame, name: str) -> pd.DataFrame:
    """Label captures or windows of a run; probabilities come last."""
    classes = [scores.PREFIX + each for each in scores.classes_of(predictions)]
    if name == "decisions":
        labelled = scores.label_windows(predictions)
    else:
        labelled = scores.label_captures(predictions).drop(columns=["start", "frames"])
        captures = predictions.groupby(["fold", "capture"], sort=False)
        labelled[classes] = captures[classes].mean().to_numpy()
    labelled = rename_labels(labelled)
    first = ["id", "subject", "truth", "prediction"]
    return labelled[[*first, *labelled.columns.difference([*first, *classes], False), *classes]]


def rename_labels(labelled: pd.DataFrame) -> pd.DataFrame:
    """Name the columns of labelled captures as `bench.compare` reads them."""
    taken = {column: f"{column}_" for column in NAMES_OF_LABELS.values()}  # by a condition
    return labelled.rename(columns=taken).rename(columns=NAMES_OF_LABELS)


def accuracy_by_subject(results: Iterable[Result]) -> tuple[pd.DataFrame, pd.Series]:
    """Accuracy of the complete results of one group, whose labels must not depend on the batch.

    Returns:
        Accuracy in percent [systems, subjects], means over seeds, the best mean first, and the
        number of seeds of each system. Systems that were not tested on all subjects are left out.
    """
    complete = [r for r in results if r.is_complete]
    systems = pd.Index([r.system for r in complete], name="system")
    table = pd.DataFrame([r.accuracy_by_subject for r in complete], index=systems)
    table = table.dropna() if len(table.columns) else table.iloc[:0]
    means = table.groupby(level=0).mean()
    order = means.mean(axis=1).sort_values(ascending=False, kind="stable").index
    return means.loc[order], table.groupby(level=0).size().loc[order]


def selecting_arguments(run: Result, results: Iterable[Result]) -> dict[str, str]:
    """Arguments of `bench choose` that select the captures and the protocol of a run."""
    arguments = {"data": str(run["data"]), "where": str(run["subset"])}
    if run["target"] != "gesture":
        arguments["target"] = run["target"]
    arguments |= arguments_of_label("protocol", str(run["protocol"]))
    same = [r for r in results if r["protocol_name"] == run["protocol_name"]]
    for name, value in run.attributes.items():
        if name.startswith("protocol.") and len({str(r[name]) for r in same if name in r}) > 1:
            arguments[name] = str(value)
    return arguments


def choose_command(results: Sequence[Result], **more: str) -> str:
    """The command that chooses on the captures and under the protocol of the first result."""
    arguments = selecting_arguments(results[0], results) if results else {}
    return format_command("choose", arguments | more)
