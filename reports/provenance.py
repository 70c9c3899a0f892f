"""The origin of a row: its command, and its machine."""

from __future__ import annotations

import json
import shlex

import pandas as pd


def command(run: dict) -> str:
    """The command line that makes a run, as it was tracked; ``-`` for a run of Python objects.

    Args:
        run: a row of `bench.outcomes.runs.tracked`.
    """
    if not isinstance(arguments := run.get("touchbench.arguments"), str):
        return "-"
    words = [f"{key}={value}" for key, value in json.loads(arguments).items()]
    return shlex.join(["bench", run["touchbench.command"], *words])


def provenance(runs: pd.DataFrame) -> pd.DataFrame:
    """Origin of each run, a row each: its name, command, corpus, revision, machine and MLflow id."""
    machine = runs.reindex(columns=["git", "cpu", "threads"]).fillna("-").replace("", "-")
    return pd.DataFrame(
        {
            "group": runs["group"],
            "system": runs["system"],
            "seed": runs["seed"],
            "command": [command(run) for run in runs.to_dict("records")],
            "corpus digest": runs["corpus_digest"].str[:16],
            "git": machine["git"],
            "CPU, threads": machine["cpu"] + ", " + machine["threads"],
            "run": runs["run_id"],
        }
    )


def software(runs: pd.DataFrame) -> pd.DataFrame:
    """Versions that the runs were made with, the most frequent first."""
    columns = sorted(c for c in runs if c.startswith("version."))
    counted = runs[columns].fillna("-").value_counts().reset_index(name="runs")
    return counted.rename(columns=lambda c: c.removeprefix("version."))
