"""What to type next where `bench choose` finds too little: commands, from tracked runs and from cells."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping

import pandas as pd

from bench.outcomes.choice import fitting

Arguments = Mapping[str, str]
WHAT = ("data", "where", "target", "protocol")  # keys that say what systems are compared on
# A small system that is accurate on real touch, and one on whole captures to compare it with.
FIRST = {"model": "lda", "features": "touch", "model.window": "1.0", "model.repair": "stuck+dead"}
SECOND = {"model": "rf", "features": "jung54"}
MOST_AT_HAND = 5  # runs that are worth another command


def compared_on(candidates: pd.DataFrame) -> dict[str, str]:
    """The arguments for data, subset, target and protocol, which candidates have in common.

    Empty where all runs were made from Python with objects, which cannot be typed.
    """
    for text in candidates["arguments"]:
        if text:
            return {k: v for k, v in json.loads(text).items() if k.split(".")[0] in WHAT}
    return {}


def is_first(arguments: Arguments) -> bool:
    """Whether arguments are of the system that is proposed first."""
    return FIRST.items() <= arguments.items()


def merged(asked: Iterable[Arguments]) -> list[dict[str, str]]:
    """Fewer lists of arguments that make the same cells: values of model= and of features= with commas."""
    found = [dict(arguments) for arguments in asked]
    for key in ("model", "features"):
        alike: dict[str, dict[str, str]] = {}
        for arguments in found:
            rest = json.dumps(
                {k: v for k, v in arguments.items() if k != key} | {key: key in arguments}, sort_keys=True
            )
            if rest in alike and key in arguments:
                alike[rest][key] += f",{arguments[key]}"
            else:
                alike.setdefault(rest, dict(arguments))
        found = list(alike.values())
    return found


def at_hand(candidates: pd.DataFrame, kind: str, budgets: Mapping[str, float]) -> list[dict[str, str]]:
    """Arguments of runs of ``bench run`` that another command may make fit, the most accurate first.

    Args:
        candidates: as `bench.outcomes.choice.candidates` gives them.
        kind: of run that the other command makes, ``stream`` or ``chip``; systems that have one are left out.
        budgets: those that the run must fit already.
    """
    have = set(candidates["system"][candidates["kind"] == kind])
    runs = fitting(candidates[(candidates["command"] == "run") & (candidates["arguments"] != "")], budgets)
    runs = runs[~runs["system"].isin(have)].sort_values("accuracy", ascending=False, kind="stable")
    return [json.loads(text) for text in runs["arguments"].drop_duplicates()]
