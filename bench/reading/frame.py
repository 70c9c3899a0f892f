"""Stored runs as one table: a row for each run, or for each of its cases, whose name tells it from its neighbours."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from bench.errors import InputError, suggest_names
from bench.ground.typed import arguments_of_label, format_command
from bench.values.result import FOLD_COUNTS, Result, Row, setting_phrases, values_to_agree

DESCRIPTION = [
    "system",
    "model",
    "features",
    "parameters",
    "seed",
    "unit",
    "subset",
    "target",
    "data",
    "protocol",
]
PARTS = ("model", "features", "protocol", "data")  # whose parameters are ``<part>.<name>``
SHARE_NAMES = ("accuracy", "subject_sd", "macro_")  # in names of numbers that are shown in percent
ACCURACY_COLUMNS = {
    "accuracy": "accuracy",
    "low": "accuracy_low",
    "high": "accuracy_high",
    "subject_sd": "subject_sd",
}  # of a run
SHOWN = ("accuracy", "low", "high", "subject_sd", "loss")  # of a case, in percent
# Beginnings of tags and parameters that other columns tell, or that tell no reader anything.
HIDDEN = "touchbench. version. mlflow. run_id status started artifacts git threads cpu simd unit synthetic data subset "
HIDDEN += (
    "mixes_subjects test_over_train official_split model features system where target protocol"
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
    """The results by captures and protocol in words; only results of one group are compared.

    Generated captures say so; where several corpora go by one name, the digest tells them apart. Results of a group
    also share the parameters ``same``, which have words (`bench.values.result.setting_phrases`).
    """
    keys = [values_to_agree(r, same or ()) for r in results]
    words = {
        key: ", ".join([*r.context, *setting_phrases(r, same or {})])
        for key, r in zip(keys, results, strict=True)
    }
    digests = {text: {key[1] for key in words if words[key] == text} for text in words.values()}
    groups: dict[str, list[Result]] = {}
    for key, r in zip(keys, results, strict=True):
        text = words[key] + f", corpus {key[1][:8]}" * (len(digests[words[key]]) > 1)
        groups.setdefault(text, []).append(r)
    return groups


def name_rows(results: Sequence[Row], context: bool = False) -> list[str]:
    """What the rows of some runs are called: the system, and what else tells a run from others of this system.

    With ``context`` also captures and protocol, for a table without columns for them.
    """
    named = [r.system if isinstance(r, Result) else str(r["system"]) for r in results]
    places: dict[tuple, list[int]] = {}
    for i, r in enumerate(results):
        shown = (
            () if context else (str(r.get("data")), str(r.get("subset")), str(r.get("protocol")))
        )
        places.setdefault((named[i], *shown), []).append(i)
    for members in (each for each in places.values() if len(each) > 1):
        keys = _distinguishing_keys([results[i] for i in members], context)
        for i in members:
            named[i] = ", ".join(
                [
                    named[i],
                    *(_format_parameter(key, results[i][key]) for key in keys if key in results[i]),
                ]
            )
    return named


def _distinguishing_keys(rows: Sequence[Row], context: bool) -> list[str]:
    """The tags and parameters in which rows differ, as many as tell them apart; their ids if nothing else does."""
    about = [r.attributes if isinstance(r, Result) else r for r in rows]
    every = [
        key
        for key in dict.fromkeys(key for r in about for key in r)
        if not key.endswith(("_name", "_file"))
    ]
    told = tuple(HIDDEN.split())
    usual = [
        key
        for key in every
        if not key.startswith(told) or key.partition(".")[0] in PARTS and "." in key
    ]
    where = ["data", "subset", "target", "protocol"] if context else []
    kept: dict[tuple[int, ...], str] = {}  # by how they part the rows
    for key in dict.fromkeys([*where, "seed", "touchbench.changes", *usual, "corpus_digest"]):
        first: dict[str, int] = {}
        parts = tuple(first.setdefault(str(r.get(key, "")), i) for i, r in enumerate(about))
        if any(parts):
            kept.setdefault(parts, key)
    alone = len({*zip(*kept, strict=True)}) == len(rows) if kept else False
    return [*kept.values()] if alone else [*kept.values(), "run_id"]


def _format_parameter(key: str, value: object) -> str:
    """A tag or parameter in words, such as "seed 0" or "detector frames"."""
    if key in WORDS:
        return WORDS[key].format(str(value))
    return f"{key.rpartition('.')[2].replace('_', ' ')} {value}"


def runs_table(results: Sequence[Result], cases: bool = False) -> pd.DataFrame:
    """A row for each run: its name, its numbers, what it is (`DESCRIPTION`), how many folds went well, and its id.

    Shares are in percent. ``accuracy`` is the mean over subjects with its 95 % t-interval (``low``, ``high``) and SD
    (``subject_sd``), ``pooled_accuracy`` is over captures. ``complete`` is False where a fold failed, ``alone`` False
    where labels depend on other test captures. With ``cases``, a row for each case of the circumstances of each run,
    such as a fault at one severity.
    """
    from bench.values.stability import accuracy_curve

    rows = []
    for name, r in zip(name_rows(results), results, strict=True):
        about = {
            "complete": r.is_complete,
            "alone": r.predicts_alone,
            "folds": r.folds,
            "run_id": r["run_id"],
            **_description(r),
        }
        if not cases:
            rows.append({"name": name} | _numbers_in_percent(r) | about)
        elif (labels := r.tables.get("labels")) is not None:
            for key in filter(None, labels["circumstance"].unique()):
                for row in accuracy_curve(labels, key).to_dict("records"):
                    shown = {k: 100 * v if k in SHOWN else v for k, v in row.items()}
                    rows.append({"name": name, "circumstance": key} | shown | about)
    table = pd.DataFrame(rows, columns=None if rows else ["name", *DESCRIPTION])
    return table[[*(c for c in table if c not in DESCRIPTION), *DESCRIPTION]]


def _description(r: Result) -> dict[str, Any]:
    """What a run is."""
    data, _, protocol = r.context
    parameters = ", ".join(
        f"{k}={v}" for k, v in r.attributes.items() if k.partition(".")[0] in PARTS and "." in k
    )
    about = (r.system, r.get("model_name", ""), r.get("features_name", ""), parameters, r["seed"])
    where = (r.attributes.get("unit", "capture"), r["subset"], r["target"], data, protocol)
    return dict(zip(DESCRIPTION, about + where, strict=True))


def _numbers_in_percent(r: Result) -> dict[str, Any]:
    """The numbers of a run, shares in percent."""
    numbers = {
        k: 100 * v if any(part in k for part in SHARE_NAMES) else v
        for k, v in r.metrics.items()
        if k not in FOLD_COUNTS
    }
    if "accuracy" not in numbers:
        return numbers
    return {
        name: numbers.pop(stored, float("nan")) for name, stored in ACCURACY_COLUMNS.items()
    } | numbers


def join_tables(results: Sequence[Result], name: str = "predictions") -> pd.DataFrame:
    """A table of some runs as one, such as ``labels``; each row has the ``name`` of its run and its ``run_id``."""
    parts = []
    for called, r in zip(name_rows(results, context=True), results, strict=True):
        if (table := r.tables.get(name)) is not None:
            own = table.drop(columns=[c for c in ("name", "run_id") if c in table])
            parts.append(own.assign(name=called, run_id=r["run_id"]))
    if not parts:
        known = sorted({each for r in results for each in r.tables})
        raise InputError(f"no run has a table {name}; {suggest_names(name, known)}")
    return pd.concat(parts, ignore_index=True)


def accuracy_by_subject(results: Iterable[Result]) -> tuple[pd.DataFrame, pd.Series]:
    """Accuracy in percent [systems, subjects] of the complete results of one group, best mean first; seeds of each row.

    Systems that were not tested on all subjects of the group are left out. Results must not depend on the batch.
    """
    complete = [r for r in results if r.is_complete]
    table = pd.DataFrame(
        [r.accuracy_by_subject for r in complete],
        index=pd.Index([r.system for r in complete], name="system"),
    )
    table = table.dropna() if len(table.columns) else table.iloc[:0]
    means = table.groupby(level=0).mean()
    order = means.mean(axis=1).sort_values(ascending=False, kind="stable").index
    return means.loc[order], table.groupby(level=0).size().loc[order]


def selecting_arguments(run: Result, among: Iterable[Result]) -> dict[str, str]:
    """Arguments of `bench choose` that select the captures and the protocol of a run among others."""
    words = {"data": str(run["data"]), "where": str(run["subset"])}  # which may be one of several
    words |= {"target": run["target"]} if run["target"] != "gesture" else {}
    words |= arguments_of_label("protocol", str(run["protocol"]))
    same = [r for r in among if r["protocol_name"] == run["protocol_name"]]
    own = {
        name: str(value) for name, value in run.attributes.items() if name.startswith("protocol.")
    }
    return words | {
        name: v for name, v in own.items() if len({str(r[name]) for r in same if name in r}) > 1
    }


def choose_command(results: Sequence[Result], **more: str) -> str:
    """The command that chooses among stored runs on the captures and under the protocol of the first result."""
    return format_command(
        "choose", (selecting_arguments(results[0], results) if results else {}) | more
    )
