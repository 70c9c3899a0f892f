"""The origin of a row: its command, and its machine."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from bench.result import Result
from bench.table import of_text

MACHINE = ("git", "cpu", "threads")
ROWS = 300  # of a table on the page; the CSV file holds all


def command(result: Result) -> str:
    """The command line that makes a run, as it was tracked; ``-`` for a run of Python objects."""
    arguments = result.get("touchbench.arguments")
    if arguments is None:
        return "-"
    words = [f"{key}={value}" for key, value in json.loads(arguments).items()]
    return shlex.join(["bench", result["touchbench.command"], *words])


def provenance(groups: Mapping[str, Sequence[Result]]) -> pd.DataFrame:
    """Origin of each run, a row each, oldest first: its name, command, corpus, revision, machine and MLflow id."""
    rows = []
    for group, r in sorted(((g, r) for g, results in groups.items() for r in results), key=lambda p: p[1]["started"]):
        git, cpu, threads = (r.get(name) or "-" for name in MACHINE)
        about = {"group": group, "system": r.system, "seed": r["seed"], "command": command(r)}
        about |= {"corpus digest": r["corpus_digest"][:16], "git": git, "CPU, threads": f"{cpu}, {threads}"}
        rows.append(about | {"run": r["run_id"]})
    return pd.DataFrame(rows)


def software(results: Sequence[Result]) -> pd.DataFrame:
    """Versions that the runs were made with, the most frequent first."""
    versions = [{k: v for k, v in r.about.items() if k.startswith("version.")} for r in results]
    table = pd.DataFrame(versions).fillna("-")
    counted = table[sorted(table)].value_counts().reset_index(name="runs")
    return counted.rename(columns=lambda c: c.removeprefix("version."))


def provenance_section(results: Sequence[Result], table: pd.DataFrame) -> dict[str, Any]:
    """Corpora, versions, and the command of every run."""
    counted = Counter((r["data"], r["synthetic"], r["corpus_digest"]) for r in results)
    rows = [(data + " (synthetic)" * (s == "true"), digest, n) for (data, s, digest), n in sorted(counted.items())]
    return {
        "corpora": of_text(pd.DataFrame(rows, columns=("data", "corpus_digest", "runs")).astype(str)),
        "versions": of_text(software(results).astype(str)),
        "commands": of_text(table.iloc[:ROWS], code=("command",)),
        "all": len(table),
    }
