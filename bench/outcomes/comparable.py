"""What makes two runs comparable, in tags and in words, and the facts that statistics need of a protocol."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bench.plan.splits import with_seed

BATCH, CONDITIONS = (
    "touchbench.depends_on_batch",
    "touchbench.conditions",
)  # tags of a run; the second where it uses some
MARK = "\N{DAGGER}"  # behind the name of a system whose predictions depend on the batch
MARKED = f"{MARK} predictions depend on the captures that are predicted together; not compared"
Row = Mapping[str, Any]  # of a run: tags and parameters, which are text, and metrics; nan for what it has not
COMPARABLE = ("data", "corpus_digest", "subset", "target", "protocol_label")  # tags, with the digest of the parameters
SAME_SYSTEM = ("protocol", "system", "seed")  # besides, what makes two runs repetitions of one
# Runs that were made before facts were tracked name a protocol whose folds are known to be of this kind.
BEFORE_FACTS = {"loso": False, "groupkfold": False, "challenge": False, "kfold": True, "holdout": True}


def comparable(run: Row) -> tuple[str, ...]:
    """What must agree for two runs to be compared: captures and protocol, and how they are replayed.

    Args:
        run: its tags and parameters.
    """
    return tuple(str(run.get(k, "gesture" if k == "target" else "")) for k in (*COMPARABLE, *_replay(run)))


def _replay(run: Row) -> tuple[str, ...]:
    return tuple(k for k in ("stream.start", "stream.hop_ms") if run.get(k) is not None)


def context_of(tags: Row) -> tuple[str, str, str]:
    """The same in words: data, subset with the target, protocol."""
    data = str(tags["data"]) + (" (synthetic)" if tags["synthetic"] == "true" else "")
    target = f", {tags['target']}" if tags["target"] != "gesture" else ""
    return data, str(tags["subset"]) + target, str(tags["protocol_label"])


def depends_on_batch(tags: Row) -> bool:
    """Whether predictions of a capture changed with the other captures that were predicted together."""
    return tags.get(BATCH) == "true"


def is_checked(tags: Row) -> bool:
    """Whether the run checked what its predictions depend on; those of older versions did not."""
    return tags.get(BATCH) in ("true", "false")


def system_of(tags: Row) -> str:
    """The system as tables name it: with the conditions that it uses, and a mark if it depends on the batch."""
    conditions = tags.get(CONDITIONS)
    uses = f" (uses {conditions.replace(',', ', ')})" if isinstance(conditions, str) and conditions else ""
    return str(tags["system"]) + uses + (f" {MARK}" if depends_on_batch(tags) else "")


def method_of(tags: Row) -> str:
    """System, and its seed where that is not the usual one."""
    return system_of(tags) + (f", seed {tags['seed']}" if tags["seed"] not in ("0", "none") else "")


def seed_number(seed: str) -> int:
    """A tracked seed as a number to sort by, 0 for a system that has none."""
    return int(seed) if seed.lstrip("-").isdecimal() else 0


def seeds_named(tags: Mapping[str, str], params: Mapping[str, str]) -> dict[str, str]:
    """Tags that name the seeds of protocol and feature set, of a run from before they did.

    Args:
        tags: of the run, as they were tracked.
        params: of the run.

    Returns:
        The tags that change.
    """
    if "protocol_label" not in tags:
        return {}
    found, arguments = {}, {}
    protocol, features = params.get("protocol.seed", "0"), params.get("features.seed")
    if protocol not in ("0", "None") and "seed=" not in tags["protocol"]:
        found["protocol"] = _with_parameter(tags["protocol"], f"seed={protocol}")
        found["protocol_label"] = with_seed(tags["protocol_label"], protocol)
        arguments["protocol.seed"] = protocol
    usual = "0" if any(name.startswith("tuning.") for name in params) else tags["seed"]
    if features is not None and usual == "none":
        found["seed"] = features
        arguments |= {"seed": features} if features != "0" else {}
    elif features not in (None, usual) and "seed=" not in tags["features"]:
        found |= {name: _with_parameter(tags[name], f"seed={features}") for name in ("system", "features")}
        arguments["features.seed"] = str(features)
    if arguments and "touchbench.arguments" in tags:
        found["touchbench.arguments"] = json.dumps(json.loads(tags["touchbench.arguments"]) | arguments)
    return found


def _with_parameter(label: str, parameter: str) -> str:
    """``kfold[folds=5]`` with one more parameter."""
    return f"{label[:-1]}, {parameter}]" if label.endswith("]") else f"{label}[{parameter}]"


@dataclass(frozen=True)
class Facts:
    """What statistics need to know of the protocol of a run.

    Attributes:
        mixes_subjects: whether captures of a subject are on both sides of a fold.
        test_over_train: tested by training captures, None where folds share no training captures or it is not known.
        official_split: whether its folds are those that were published; None where there is no such split.
    """

    mixes_subjects: bool
    test_over_train: float | None
    official_split: bool | None


def facts_of(run: Row) -> Facts:
    """The facts of a run as they were tracked; of an older one what its protocol's name and folds say.

    Args:
        run: a row of `bench.outcomes.runs.tracked`.
    """
    if isinstance(run.get("mixes_subjects"), str):
        ratio = str(run.get("test_over_train") or "")
        official = {"true": True, "false": False}.get(run.get("official_split", ""))
        return Facts(run["mixes_subjects"] == "true", float(ratio) if ratio else None, official)
    name, folds = run.get("protocol_name", ""), float(run.get("folds", 1))
    partition = name in ("loso", "groupkfold", "kfold") and folds > 1
    official = folds < 2 if name == "challenge" else None
    return Facts(BEFORE_FACTS.get(name, False), 1 / (folds - 1) if partition else None, official)
