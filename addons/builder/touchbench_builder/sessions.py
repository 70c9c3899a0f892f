"""What another session costs: people left out, trained on one session and tested on the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.ground.progress import warn
from bench.values.intervals import mean_interval
from bench.values.measures import value_or_none
from touchbench_builder.captures import find_two_sessions
from touchbench_builder.fitting import ChosenSystem
from touchbench_builder.systems import WATCH, count_right, make_plan, run_plan


def measure_session_cost(
    corpus: Corpus, on: Mapping[str, Any], choice: ChosenSystem
) -> dict[str, Any] | None:
    """Points that a chosen system loses in another session than it was trained on.

    Each person is left out: trained and tested on one of two sessions, and trained on one and
    tested on the other. None unless there are two sessions, and people enough in each.

    Returns:
        Column, values, people, shares of right labels in the ``same`` and in the ``other`` session,
        ``cost`` in points with its 95 % interval ``low`` and ``high``.
    """
    column, values = find_two_sessions(corpus)
    if not column:
        return None
    keys, command = {**on, **choice.values}, WATCH if choice.watched is not None else "run"
    try:
        across = {"protocol": "sessions", "protocol.column": column}
        other = count_right(run_plan(*make_plan(keys | across, command)))
        parts = []
        for value in values:
            where = f"{column} == {value!r}"
            where = f"({on['where']}) and {where}" if on.get("where") else where
            within = keys | {"protocol": "loso", "where": where}
            parts.append(count_right(run_plan(*make_plan(within, command))))
    except InputError as e:  # such as a session that lacks people or gestures
        warn(f"warning: the cost of another session is not known: {e}")
        return None
    same = pd.concat(parts).groupby(level=0).sum()
    shares = pd.DataFrame({"same": same["right"] / same["total"]})
    shares["other"] = other["right"] / other["total"]
    shares = 100 * shares.dropna()
    costs = (shares["same"] - shares["other"]).to_numpy()
    low, high = mean_interval(costs)
    ends = {"low": value_or_none(round(low, 1)), "high": value_or_none(round(high, 1))}
    means = {name: round(float(shares[name].mean()), 1) for name in shares}
    found = {"column": column, "values": [*map(str, values)], "people": len(shares)}
    return found | means | {"cost": round(float(costs.mean()), 1), **ends}
