"""Where a row comes from: the command that rebuilds it, and what it ran on."""

from __future__ import annotations

import re
import shlex

import pandas as pd

from bench.faults import known

HOW = ("trials", "budget", "inner", "objective")


def command(run: dict) -> str:
    """The command line that made a run, from its tags and parameters.

    Args:
        run: a row of `reports.comparison.tracked`.
    """
    space = run.get("tuning.space")
    tuned = isinstance(space, str)
    chosen = isinstance(run.get("tuning.over"), str)
    kind = run.get("touchbench.kind", "cell")
    verb = kind if kind != "cell" else "choose" if chosen else "tune" if tuned else "run"
    words = [f"bench {verb}", f"data={run['data']}"]
    words += [f"{k}={v}" for k, v in sorted(run.items()) if k.startswith("data.") and isinstance(v, str)]
    words += [] if run["subset"] == "all" else [f"where={run['subset']}"]
    words += [] if run["target"] == "gesture" else [f"target={run['target']}"]
    words += _part(run, "protocol", run["protocol"])
    model, _, features = run["system"].removeprefix("tuned ").partition(" · ")
    words += [f"model={run['model'].split('[')[0]}"] if tuned else _part(run, "model", model)
    words += _part(run, "features", features) if features else []
    if tuned:
        words += _searched(run, space, chosen)
    words += [] if run["seed"] in ("none", "0") else [f"seed={run['seed']}"]
    words += _how(run) if kind != "cell" else []
    return " ".join([words[0], *(shlex.quote(w) for w in words[1:])])


def _how(run: dict) -> list[str]:
    """Options of ``bench stress`` and ``bench stream`` that are not the default."""
    usual = {"faults": ", ".join(known()), "train_subjects": "all", "stream.hop_ms": "None", "stream.start": "onset"}
    given = {k: run[k] for k, value in usual.items() if isinstance(run.get(k), str) and run[k] != value}
    return [f"{k.removeprefix('stream.')}={v.replace(' ', '')}" for k, v in given.items()]


def _part(run: dict, key: str, text: str) -> list[str]:
    """A part and those of its parameters that its name tells because they are not the default."""
    words = [f"{key}={text.split('[')[0]}"]
    for name in re.findall(r"(\w+)=", text.partition("[")[2]):
        if isinstance(value := run.get(f"{key}.{name}"), str):
            words.append(f"{key}.{name}={value}")
    return words


def _searched(run: dict, space: str, chosen: bool) -> list[str]:
    """Values that a search was given, and how it went about it; ranges are those that the model declares."""
    lists = {
        name: values.replace("'", "").replace(" ", "") for name, values in re.findall(r"'(\w+)': \[(.*?)\]", space)
    }
    words = [f"model.{name}={values}" for name, values in lists.items()]
    if chosen:
        words.append(f"over={run['tuning.over']}")
    how = [k for k in HOW if isinstance(run.get(f"tuning.{k}"), str) and not (chosen and k != "inner")]
    return words + [f"{k}={run[f'tuning.{k}']}" for k in how]


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
