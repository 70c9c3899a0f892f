"""The measurements that ``bench check`` compares, and their file."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from bench.errors import InputError

FORMAT = 1
NAMES = ("data", "corpus_digest", "subset", "target", "protocol", "system", "seed")


@dataclass(frozen=True)
class Measured:
    """Measurements of one run of a system; a baseline holds one for each.

    Attributes:
        run: the arguments of ``bench run`` that make it.
        names: data, digest, subset, target, protocol, system and seed as they are tracked.
        environment: processor, threads and versions.
        costs: known costs: ``relative``, processor time of a prediction as a multiple of the reference workload, and
            ``flash`` bytes.
        labels: one row per tested capture: ``fold``, ``capture``, ``subject``, ``true``, ``predicted``.
        synthetic: True for generated captures.
    """

    run: str
    names: dict[str, str]
    environment: dict[str, str]
    costs: dict[str, float]
    labels: pd.DataFrame
    synthetic: bool


def read(path: Path, check: Callable[[str], object] = str) -> list[Measured]:
    """Load a baseline."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if stored["format"] != FORMAT:
            raise ValueError(f"format {stored['format']}, not {FORMAT}")
        baseline = [_loaded(dict(entry)) for entry in stored["systems"]]
    except FileNotFoundError as e:
        raise InputError(
            f"baseline={path}: there is no such file; write one, for example: bench check baseline={path} update=yes "
            "model=svm,rf"
        ) from e
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError) as e:
        raise InputError(
            f"baseline={path} is damaged or no baseline ({type(e).__name__}: {e}); restore it, or move it away and "
            "write a new one with update=yes"
        ) from e
    for measured in baseline:
        check(measured.run)
    if not baseline:
        raise InputError(f"baseline={path} holds no system; add some with update=yes")
    return baseline


def _loaded(entry: dict) -> Measured:
    classes = np.array(entry.pop("classes"), dtype=object)
    tables = [
        pd.DataFrame(
            {
                "fold": str(row["fold"]),
                "capture": np.array(row["captures"], dtype=np.int64),
                "subject": str(row["subject"]),
                "true": classes[row["true"]],
                "predicted": classes[row["predicted"]],
            }
        )
        for row in entry.pop("tested")
    ]
    measured = Measured(**entry, labels=pd.concat(tables, ignore_index=True))
    if set(measured.names) != set(NAMES):
        raise KeyError(", ".join(set(NAMES) ^ set(measured.names)))
    return replace(measured, costs={k: float(v) for k, v in measured.costs.items()})


def text(baseline: list[Measured]) -> str:
    """A baseline as JSON, with a line for each system and each of its subjects so that differences can be read."""
    entries = []
    for measured in baseline:
        labels = measured.labels
        classes = sorted(set(labels["true"]) | set(labels["predicted"]))
        code = {name: i for i, name in enumerate(classes)}
        rows = [
            {"fold": fold, "subject": subject, "captures": rows["capture"].tolist()}
            | {k: rows[k].map(code).tolist() for k in ("true", "predicted")}
            for (fold, subject), rows in labels.groupby(["fold", "subject"], sort=False)
        ]
        head = {k: v for k, v in vars(measured).items() if k != "labels"} | {"classes": classes}
        tested = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in rows)
        entries.append(f'{json.dumps(head, ensure_ascii=False)[:-1]}, "tested": [\n  {tested}]}}')
    return f'{{"format": {FORMAT}, "systems": [\n' + ",\n".join(entries) + "\n]}\n"
