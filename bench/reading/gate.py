"""The gate of ``bench check``: systems compared with a stored baseline, a JSON file.

It compares accuracy, by a paired bootstrap; labels, of a system without a seed, or with the same
seed, processor, versions and threads; computing time and size. All tests of accuracy and labels
share one error rate (Bonferroni).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from scipy.stats import binom

from bench.errors import InputError
from bench.ground.digests import json_with_digest, read_json_with_digest
from bench.values import scores

if TYPE_CHECKING:
    from bench.values.result import Result

FORMAT = 2  # of the file of a baseline
KEY_TAGS = ("data", "corpus_digest", "subset", "target", "protocol", "system", "seed")
# Tags that a run shares with its counterpart, at least.
COUNTERPART_TAGS = tuple(name for name in KEY_TAGS if name not in ("corpus_digest", "seed"))
CHANGES = 0.002  # share of labels that may change where code is unchanged, such as by rounding
LARGER = 1.1  # largest factor of flash
COSTS = {"relative": "predict_relative", "flash": "flash_bytes"}  # tracked names by cost
SPARED = 2  # subjects that may be no worse where a loss on all the others is to be an alarm
NEGLIGIBLE = 1e-30  # probability at the ends of a distribution


@dataclass(frozen=True)
class SystemRecord:
    """The measurements of a run of a system that the gate compares.

    Args:
        run: arguments of ``bench run`` that make it.
        names: values of `KEY_TAGS`.
        environment: processor, threads and versions.
        costs: known ones of `COSTS`; ``relative`` is a multiple of the reference workload.
        labels: a row per tested capture: ``fold``, ``capture``, ``subject``, ``true`` and
            ``predicted``.
        synthetic: True for generated captures.
    """

    run: str
    names: dict[str, str]
    environment: dict[str, str]
    costs: dict[str, float]
    labels: pd.DataFrame
    synthetic: bool


class SystemVerdict(NamedTuple):
    """The verdict on a system; ``current`` is False if it has no run."""

    name: str
    alarms: tuple[str, ...]  # words such as ``worse``; empty if nothing changed
    details: str
    current: bool = True

    @property
    def line(self) -> str:
        """The verdict in one line."""
        return f"{', '.join(self.alarms) or 'same':8} {self.name}: {self.details}"


def compare_with_baseline(
    baseline: list[SystemRecord],
    current: list[SystemRecord],
    error: float,
    slower: float,
    failures: Mapping[tuple, str] | None = None,
    load_history: Callable[[SystemRecord], Sequence[tuple[str, SystemRecord]]] = lambda record: (),
) -> list[SystemVerdict]:
    """Compare every system of a baseline with its current run.

    Args:
        baseline: records of the baseline.
        current: records of current runs.
        error: error rate in percent of all tests together.
        slower: largest factor of computing time.
        failures: reason of each run that failed, by its `COUNTERPART_TAGS`.
        load_history: returns the stored runs of a system up to a current one, oldest first, each
            with its revision.
    """
    pairs = [(before, find_counterpart(before, current)) for before in baseline]
    # One test of accuracy each, and one of labels where they must be equal.
    tests = [1 if why_labels_may_differ(before, now) else 2 for before, now in pairs if now]
    level = error / 100 / max(1, sum(tests))
    verdicts = []
    for before, now in pairs:
        if not now:
            verdict = _verdict_without_run(before, current, failures or {})
        else:
            verdict = judge_system(before, now, level, slower)
        if now and verdict.alarms:
            words = first_changed_revision(before, load_history(now), level, slower)
            verdict = verdict._replace(details=verdict.details + words)
        verdicts.append(verdict)
    return verdicts


def first_changed_revision(
    before: SystemRecord, runs: Sequence[tuple[str, SystemRecord]], level: float, slower: float
) -> str:
    """Words on the revision since which every stored run differs from the baseline; may be empty.

    ``runs`` are the oldest first. If the last one does not differ, there is no such revision. A run
    differs if the gate would raise an alarm, so that a slow change also has a first revision.
    """
    alarms = [judge_system(before, run, level, slower).alarms for _, run in runs]
    same = [i for i, each in enumerate(alarms) if not each]
    first = same[-1] + 1 if same else 0
    if first == len(runs):
        return ""
    last_same = f" (last the same: {runs[first - 1][0]})" if first else ""
    return f", since revision {runs[first][0]}{last_same}"


def judge_system(
    before: SystemRecord, now: SystemRecord, level: float, slower: float
) -> SystemVerdict:
    """Compare a run with its baseline; ``level`` is the error rate of each test."""
    both = before.labels.merge(
        now.labels, on=["fold", "capture"], how="outer", suffixes=("", "_now"), indicator="side"
    )
    name = system_line(before)
    if (both["side"] != "both").any() or (both["true"] != both["true_now"]).any():
        details = "the run tests other captures than the baseline; update the baseline"
        return SystemVerdict(name, ("other captures",), details)
    right, right_now = ((both[label] == both["true"]) for label in ("predicted", "predicted_now"))
    both["difference"] = right_now.astype(int) - right.astype(int)
    units, kind = bootstrap_units(both, level)
    gained, captures, p = units.sum(), len(both), bootstrap_p(units)
    alarms = []
    if p < level:
        alarms.append("worse" if gained < 0 else "better")
    changed = int((both["predicted"] != both["predicted_now"]).sum())
    reason = why_labels_may_differ(before, now)
    if not alarms and not reason and binom.sf(changed - 1, captures, CHANGES) < level:
        alarms.append("changed")
    change, low, high = (100 * n / captures for n in (gained, *bootstrap_interval(units)))
    details = (
        f"pooled {100 * right.mean():.1f} -> {100 * right_now.mean():.1f} %, "
        f"{change:+.1f} [{low:+.1f}, {high:+.1f}], p {p:.2g} ({len(units)} {kind}), "
        f"{changed} of {captures} labels changed"
    )
    if reason:
        details += f" (allowed with {reason})"
    limits = {"relative": ("time", "slower", slower), "flash": ("flash", "larger", LARGER)}
    for cost, (label, alarm, limit) in limits.items():
        ratio = now.costs.get(cost, np.nan) / (before.costs.get(cost) or np.nan)
        details += f", {label} unknown" if np.isnan(ratio) else f", {label} x{ratio:.2f}"
        if ratio > limit:
            alarms.append(alarm)
    return SystemVerdict(name, tuple(alarms), details)


def why_labels_may_differ(before: SystemRecord, now: SystemRecord) -> str:
    """The reason why labels may differ although no code changed; empty if they must be equal."""
    seed = now.names["seed"]
    if seed != before.names["seed"]:
        return f"seed {seed}"
    if seed == "none" or before.environment == now.environment:
        return ""
    return "other processors, threads or versions"


def bootstrap_units(tested: pd.DataFrame, level: float) -> tuple[np.ndarray, str]:
    """The summed difference of each unit of the bootstrap, and what the units are.

    They are subjects, or captures if subjects are too few. They are too few if a run that is worse
    on all of them but two could not be told from chance by the sign of the differences. Captures
    also show whether the code has changed: they, and the people, are the same in both runs. They
    ignore that a random system may do better or worse on all captures of a fold at once.
    """
    few = 2 * binom.cdf(SPARED, tested["subject"].nunique(), 0.5) > level
    summed = tested.groupby("capture" if few else "subject")["difference"].sum().to_numpy()
    return summed, "captures" if few else "subjects"


def bootstrap_p(differences: np.ndarray) -> float:
    """Two-sided p of a paired bootstrap, under the hypothesis that the two runs could be exchanged.

    As many differences as there are, int [units], are drawn with replacement, each with either
    sign; p is the chance that their sum is as far from 0. This distribution is computed, not
    sampled, so it has no seed.
    """
    signed = np.concatenate([differences, -differences])
    sums, chances = bootstrap_distribution(signed, len(differences))
    return float(min(1.0, chances[np.abs(sums) >= abs(differences.sum())].sum()))


def bootstrap_interval(differences: np.ndarray) -> tuple[int, int]:
    """95 % percentile interval of the sum of differences, int [units], drawn with replacement."""
    sums, chances = bootstrap_distribution(differences, len(differences))
    low, high = np.searchsorted(chances.cumsum(), [0.025, 0.975])
    return int(sums[low]), int(sums[min(high, len(sums) - 1)])


def bootstrap_distribution(values: np.ndarray, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Every sum of values drawn with replacement, int [sums], and its probability."""
    least = int(values.min())
    of_one_draw = np.bincount(values - least) / len(values)
    start = 0
    chances: np.ndarray = np.ones(1)
    for _ in range(draws):
        chances = np.convolve(chances, of_one_draw)
        kept = np.flatnonzero(chances > NEGLIGIBLE)
        start, chances = start + least + int(kept[0]), chances[kept[0] : kept[-1] + 1]
    return np.arange(start, start + len(chances)), chances


def find_counterpart(before: SystemRecord, current: list[SystemRecord]) -> SystemRecord | None:
    """The current run of a system of the baseline; of another seed if none has its seed."""
    same = [now for now in current if _share_tags(before, now, {*KEY_TAGS} - {"seed"})]
    with_seed = [now for now in same if now.names["seed"] == before.names["seed"]]
    return next(reversed(with_seed or same), None)


def _share_tags(one: SystemRecord, other: SystemRecord, tags: Iterable[str]) -> bool:
    return all(one.names[tag] == other.names[tag] for tag in tags)


def _verdict_without_run(
    before: SystemRecord, current: list[SystemRecord], failures: Mapping[tuple, str]
) -> SystemVerdict:
    reason = failures.get(tuple(before.names[tag] for tag in COUNTERPART_TAGS))
    if any(_share_tags(before, now, COUNTERPART_TAGS) for now in current):
        digest = before.names["corpus_digest"][:16]
        details = f"the run tests other captures than the baseline (digest {digest})"
    elif reason:
        details = f"its folds fail: {reason}"
    else:
        details = f"no complete current run; make one with: bench run {before.run}"
    return SystemVerdict(system_line(before), ("not run",), details, current=False)


def system_line(record: SystemRecord) -> str:
    """A system with its corpus and protocol, in one line."""
    names = record.names
    parts = [names["system"], names["data"] + "*" * record.synthetic]
    parts += [names["subset"]] if names["subset"] != "all" else []
    parts += [names["target"]] if names["target"] != "gesture" else []
    parts.append(names["protocol"])
    parts += [f"seed {names['seed']}"] if names["seed"] != "none" else []
    return " | ".join(parts)


def record_of_result(result: Result, run: str) -> SystemRecord:
    """The compared measurements of a result; ``run`` are the arguments that make it."""
    versions = {name for name in result if name.startswith("version.")} - {"version.touchbench"}
    described = {"cpu", "simd", "threads"} | versions
    environment = {name: str(result[name]) for name in result if name in described}
    # A patch of Python computes the same.
    environment["version.python"] = environment["version.python"].rpartition(".")[0]
    costs = {cost: float(result.get(name, np.nan)) for cost, name in COSTS.items()}
    costs = {cost: value for cost, value in costs.items() if np.isfinite(value)}
    labels = scores.label_captures(result.tables["predictions"])
    labels = labels[["fold", "capture", "subject", "true", "predicted"]]
    labels = labels.astype({"fold": str, "subject": str})
    names = {tag: str(result[tag]) for tag in KEY_TAGS}
    return SystemRecord(run, names, environment, costs, labels, result["synthetic"] == "true")


def refusal_xml(reason: str) -> str:
    """The XML of a check that reached no verdict."""
    return verdicts_xml([SystemVerdict("bench check", ("not checked",), reason, current=False)])


def verdicts_xml(verdicts: list[SystemVerdict]) -> str:
    """The verdicts in the XML that CI servers read: a test case for each system."""
    alarms = [v for v in verdicts if v.alarms]
    failures = sum(v.current for v in alarms)
    counts = {"tests": len(verdicts), "failures": failures, "errors": len(alarms) - failures}
    attributes = {"name": "bench check"} | {name: str(count) for name, count in counts.items()}
    suite = ElementTree.Element("testsuite", attributes)
    for verdict in verdicts:
        name, line = map(_without_control_characters, (verdict.name, verdict.line))
        attributes = {"classname": "bench.check", "name": name}
        case = ElementTree.SubElement(suite, "testcase", attributes)
        if verdict.alarms:
            kind = "failure" if verdict.current else "error"
            ElementTree.SubElement(case, kind, {"message": line})
        else:
            ElementTree.SubElement(case, "system-out").text = line
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _without_control_characters(text: str) -> str:
    """The text with spaces for control characters, which XML cannot have."""
    return "".join(c if c.isprintable() else " " for c in text)


def read_baseline(path: Path) -> list[SystemRecord]:
    """Read a baseline file.

    Raises:
        InputError: the file is missing, damaged or empty.
    """
    try:
        stored = read_json_with_digest(path)
        if stored["format"] != FORMAT:
            raise ValueError(f"format {stored['format']}, not {FORMAT}")
        baseline = [_record_from_json(dict(entry)) for entry in stored["systems"]]
    except FileNotFoundError as e:
        raise InputError(
            f"baseline={path}: there is no such file; write one, for example: "
            f"bench check baseline={path} update=yes model=svm,rf"
        ) from e
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError) as e:
        raise InputError(
            f"baseline={path} is damaged or no baseline ({type(e).__name__}: {e}); restore it, or "
            "move it away and write a new one with update=yes"
        ) from e
    if not baseline:
        raise InputError(f"baseline={path} holds no system; add some with update=yes")
    return baseline


def _record_from_json(entry: dict) -> SystemRecord:
    classes, tables = np.array(entry.pop("classes"), dtype=object), []
    for row in entry.pop("tested"):
        columns: dict[str, Any] = {"fold": str(row["fold"])}
        columns["capture"] = np.array(row["captures"], dtype=np.int64)
        columns["subject"] = str(row["subject"])
        columns |= {name: classes[row[name]] for name in ("true", "predicted")}
        tables.append(pd.DataFrame(columns))
    wrong = {*KEY_TAGS} ^ {*entry["names"]}
    if wrong:
        raise KeyError(", ".join(wrong))
    entry["costs"] = {cost: float(value) for cost, value in entry["costs"].items()}
    return SystemRecord(**entry, labels=pd.concat(tables, ignore_index=True))


def baseline_json(baseline: list[SystemRecord]) -> str:
    """A baseline as JSON with a digest, and a line for each subject, so that diffs can be read."""
    entries = []
    for record in baseline:
        labels, rows = record.labels, []
        classes = sorted({*labels["true"], *labels["predicted"]})
        for (fold, subject), tested in labels.groupby(["fold", "subject"], sort=False):
            row = {"fold": fold, "subject": subject, "captures": tested["capture"].tolist()}
            for name in ("true", "predicted"):
                row[name] = tested[name].map(classes.index).tolist()
            rows.append(json.dumps(row, ensure_ascii=False))
        head = {name: value for name, value in vars(record).items() if name != "labels"}
        text = json.dumps(head | {"classes": classes}, ensure_ascii=False)
        lines = ",\n  ".join(rows)
        entries.append(f'{text[:-1]}, "tested": [\n  {lines}]}}')
    systems = ",\n".join(entries)
    return json_with_digest(f'{{"format": {FORMAT}, "systems": [\n{systems}\n]}}\n')
