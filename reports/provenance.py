"""Where a row comes from: the command that rebuilds it, and what it ran on."""

from __future__ import annotations

import json
import shlex

import pandas as pd


def command(run: dict) -> str:
    """The command line that makes a run, as it was tracked; ``-`` for a run of Python objects.

    Args:
        run: a row of `bench.outcomes.runs.tracked`.
    """
    if not isinstance(told := run.get("touchbench.arguments"), str):
        return "-"
    words = [f"{key}={value}" for key, value in json.loads(told).items()]
    return shlex.join(["bench", run["touchbench.command"], *words])


def provenance(runs: pd.DataFrame) -> pd.DataFrame:
    """One row per run: what it is, the command that repeats it, corpus, revision, machine and MLflow id."""
    rows = [
        {
            "group": run["group"],
            "system": run["system"],
            "seed": run["seed"],
            "command": command(run),
            "corpus digest": run["corpus_digest"][:16],
            "git": _text(run, "git"),
            "CPU, threads": f"{_text(run, 'cpu')}, {_text(run, 'threads')}",
            "run": run["run_id"],
        }
        for run in runs.to_dict("records")
    ]
    return pd.DataFrame(rows)


def software(runs: pd.DataFrame) -> pd.DataFrame:
    """Versions that the runs were made with, the most frequent first."""
    columns = sorted(c for c in runs if c.startswith("version."))
    found = runs[columns].fillna("-").value_counts().reset_index(name="runs")
    return found.rename(columns=lambda c: c.removeprefix("version."))


def _text(run: dict, key: str) -> str:
    value = run.get(key)
    return value if isinstance(value, str) and value else "-"
