"""The gate of ``bench check``: systems compared with a stored baseline, a JSON file.

Compared are accuracy, by a paired bootstrap; labels, of a system without a seed, or with the same seed, processor,
versions and threads; computing time and size. All tests of accuracy and labels share one error rate (Bonferroni).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from scipy.stats import binom

from bench.errors import InputError
from bench.values import scores

if TYPE_CHECKING:
    from bench.values.result import Result

FORMAT = 1  # of the file of a baseline
NAMES = (
    "data",
    "corpus_digest",
    "subset",
    "target",
    "protocol",
    "system",
    "seed",
)  # of a run, as they are tracked
CHANGES = 0.002  # share of labels that may change where code is unchanged, such as by rounding
LARGER = 1.1  # times the learnt numbers of the baseline
COSTS = {
    "relative": "predict_relative",
    "flash": "flash_bytes",
}  # what is compared, and what it is tracked as
SAME = tuple(
    name for name in NAMES if name not in ("corpus_digest", "seed")
)  # of a run and its counterpart, at least
SPARED = 2  # subjects that may be no worse where a loss on all the others is to be an alarm
NEGLIGIBLE = 1e-30  # probability at the ends of a distribution


@dataclass(frozen=True)
class Measured:
    """What is compared of one run of a system; a baseline holds one for each."""

    run: str  # the arguments of ``bench run`` that make it
    names: dict[str, str]  # `NAMES`
    environment: dict[str, str]  # processor, threads and versions
    costs: dict[
        str, float
    ]  # known ones of `COSTS`; ``relative`` is a multiple of the reference workload
    labels: (
        pd.DataFrame
    )  # a row per tested capture: ``fold``, ``capture``, ``subject``, ``true``, ``predicted``
    synthetic: bool


class Verdict(NamedTuple):
    """The line on one system; ``wrong`` is empty if nothing changed, ``current`` is False without a run."""

    name: str
    wrong: tuple[str, ...]
    details: str
    current: bool = True

    @property
    def line(self) -> str:
        """All of it."""
        return f"{', '.join(self.wrong) or 'same':8} {self.name}: {self.details}"


def compare(
    baseline: list[Measured],
    current: list[Measured],
    error: float,
    slower: float,
    failed: Mapping[tuple, str] | None = None,
    history: Callable[[Measured], Sequence[tuple[str, Measured]]] = lambda now: (),
) -> list[Verdict]:
    """Judge every system of a baseline; ``failed`` has the reason of each run that failed, by its `SAME`.

    ``history`` has the stored runs of a system up to a current one, oldest first, each with its revision.
    """
    pairs = [(then, counterpart(then, current)) for then in baseline]
    level = (
        error / 100 / max(1, sum(1 + (not free(then, now)) for then, now in pairs if now))
    )  # of each question
    verdicts = []
    for then, now in pairs:
        verdict = judge(then, now, level, slower) if now else _missing(then, current, failed or {})
        words = since(then, history(now), level, slower) if now and verdict.wrong else ""
        verdicts.append(
            verdict._replace(details=f"{verdict.details}, {words}") if words else verdict
        )
    return verdicts


def since(then: Measured, runs: Sequence[tuple[str, Measured]], level: float, slower: float) -> str:
    """The stored revision since which each run, oldest first, differs from the baseline; empty where the last does not.

    A run differs if the gate would raise an alarm, so that a slow change also has a first revision.
    """
    same = [i for i, (_, now) in enumerate(runs) if not judge(then, now, level, slower).wrong]
    first = same[-1] + 1 if same else 0
    if first == len(runs):
        return ""
    return f"since revision {runs[first][0]}" + (
        f" (last the same: {runs[first - 1][0]})" if first else ""
    )


def judge(then: Measured, now: Measured, level: float, slower: float) -> Verdict:
    """Hold one run against that of the baseline."""
    both = then.labels.merge(
        now.labels, on=["fold", "capture"], how="outer", suffixes=("", "_now"), indicator="side"
    )
    if (both["side"] != "both").any() or (both["true"] != both["true_now"]).any():
        other = "the run tests other captures than the baseline; update the baseline"
        return Verdict(named(then), ("other captures",), other)
    hits = [(both[label] == both["true"]).astype(int) for label in ("predicted", "predicted_now")]
    both["difference"] = hits[1] - hits[0]
    units, kind = units_of(both, level)
    gained, n, p, ends = units.sum(), len(both), p_value(units), interval(units)
    changed, may = int((both["predicted"] != both["predicted_now"]).sum()), free(then, now)
    wrong = ["worse" if gained < 0 else "better"] if p < level else []
    if not wrong and not may and binom.sf(changed - 1, n, CHANGES) < level:
        wrong.append("changed")
    before, after = (100 * hit.mean() for hit in hits)
    change, low, high = (100 * number / n for number in (gained, *ends))
    line = (
        f"pooled {before:.1f} -> {after:.1f} %, {change:+.1f} [{low:+.1f}, {high:+.1f}], p {p:.2g} "
    )
    line += (
        f"({len(units)} {kind}), {changed} of {n} labels changed"
        + f" (allowed with {may})" * bool(may)
    )
    for cost, label, alarm, most in (
        ("relative", "time", "slower", slower),
        ("flash", "flash", "larger", LARGER),
    ):
        ratio = (
            now.costs[cost] / then.costs[cost]
            if then.costs.get(cost) and cost in now.costs
            else np.nan
        )
        line += f", {label} unknown" if np.isnan(ratio) else f", {label} x{ratio:.2f}"
        wrong += [alarm] if ratio > most else []
    return Verdict(named(then), tuple(wrong), line)


def free(then: Measured, now: Measured) -> str:
    """With what the labels of unchanged code may change; empty if they must be the same."""
    seed = now.names["seed"]
    if seed != then.names["seed"]:
        return f"seed {seed}"
    return (
        ""
        if seed == "none" or then.environment == now.environment
        else "other processors, threads or versions"
    )


def units_of(tested: pd.DataFrame, level: float) -> tuple[np.ndarray, str]:
    """The summed difference of each unit of the bootstrap, and what they are: subjects, or captures if these are few.

    They are too few if a run that is worse on all of them but two could not be told from chance by the sign of the
    differences. Captures tell as well whether the code has changed: they, and the people, are the same in both runs.
    They leave out that a random system may do better or worse on all captures of a fold at once.
    """
    few = 2 * binom.cdf(SPARED, tested["subject"].nunique(), 0.5) > level
    summed = tested.groupby("capture" if few else "subject")["difference"].sum().to_numpy()
    return summed, "captures" if few else "subjects"


def p_value(differences: np.ndarray) -> float:
    """Two-sided p of a paired bootstrap, under the hypothesis that the two runs could be exchanged.

    As many differences as there are, int [units], are drawn with replacement, each with either sign; p is the chance
    that their sum is as far from 0. This distribution is computed, not sampled, so it has no seed.
    """
    sums, chance = drawn(np.concatenate([differences, -differences]), len(differences))
    return float(min(1.0, chance[np.abs(sums) >= abs(differences.sum())].sum()))


def interval(differences: np.ndarray) -> tuple[int, int]:
    """95 % percentile interval of the sum of differences, int [units], drawn with replacement."""
    sums, chance = drawn(differences, len(differences))
    low, high = np.searchsorted(chance.cumsum(), [0.025, 0.975])
    return int(sums[low]), int(sums[min(high, len(sums) - 1)])


def drawn(values: np.ndarray, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Every sum of values drawn with replacement, int [sums], and its probability; the limit of endless intervals."""
    least = int(values.min())
    one = np.bincount(values - least) / len(values)
    start = 0
    chance: np.ndarray = np.ones(1)
    for _ in range(draws):
        chance = np.convolve(chance, one)
        kept = np.flatnonzero(chance > NEGLIGIBLE)
        start, chance = start + least + int(kept[0]), chance[kept[0] : kept[-1] + 1]
    return np.arange(start, start + len(chance)), chance


def counterpart(then: Measured, current: list[Measured]) -> Measured | None:
    """The run to hold against that of the baseline; one with another seed only of a random system."""
    same = [
        now for now in current if all(now.names[k] == then.names[k] for k in NAMES if k != "seed")
    ]
    fitting = [now for now in same if now.names["seed"] == then.names["seed"]] or same
    return fitting[-1] if fitting else None


def _missing(then: Measured, current: list[Measured], failed: Mapping[tuple, str]) -> Verdict:
    same = tuple(then.names[k] for k in SAME)
    details = f"no complete current run; make one with: bench run {then.run}"
    if reason := failed.get(same):
        details = f"its folds fail: {reason}"
    if any(tuple(now.names[k] for k in SAME) == same for now in current):
        details = f"the run tests other captures than the baseline (digest {then.names['corpus_digest'][:16]})"
    return Verdict(named(then), ("not run",), details, current=False)


def named(measured: Measured) -> str:
    """A system with its corpus and protocol, in one line."""
    names = measured.names
    parts = [names["system"], names["data"] + "*" * measured.synthetic]
    parts += [
        names[key]
        for key, usual in (("subset", "all"), ("target", "gesture"))
        if names[key] != usual
    ]
    return " | ".join(
        [*parts, names["protocol"], *([f"seed {names['seed']}"] if names["seed"] != "none" else [])]
    )


def measured(result: Result, run: str) -> Measured:
    """The compared measurements of a result."""
    environment = {
        k: str(v)
        for k, v in result.items()
        if k in ("cpu", "simd", "threads") or k.startswith("version.")
    }
    environment["version.python"] = environment["version.python"].rpartition(".")[
        0
    ]  # a patch computes the same
    environment.pop("version.touchbench", None)
    costs = {
        k: float(result[name]) for k, name in COSTS.items() if np.isfinite(result.get(name, np.nan))
    }
    labels = scores.captures(result.tables["predictions"])[
        ["fold", "capture", "subject", "true", "predicted"]
    ]
    labels = labels.astype({"fold": str, "subject": str})
    names = {k: str(result[k]) for k in NAMES}
    return Measured(run, names, environment, costs, labels, result["synthetic"] == "true")


def refused(reason: str) -> str:
    """The XML of a check that came to no verdict."""
    return junit([Verdict("bench check", ("not checked",), reason, current=False)])


def junit(verdicts: list[Verdict]) -> str:
    """The verdicts in the XML that CI servers read: a test case for each system."""
    wrong = [v for v in verdicts if v.wrong]
    failures = sum(v.current for v in wrong)
    counts = {"tests": len(verdicts), "failures": failures, "errors": len(wrong) - failures}
    suite = ElementTree.Element(
        "testsuite", {"name": "bench check"} | {k: str(n) for k, n in counts.items()}
    )
    for verdict in verdicts:
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": "bench.check", "name": _printable(verdict.name)}
        )
        line = _printable(verdict.line)
        if verdict.wrong:
            ElementTree.SubElement(
                case, "failure" if verdict.current else "error", {"message": line}
            )
        else:
            ElementTree.SubElement(case, "system-out").text = line
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _printable(text: str) -> str:
    """XML has no way to write control characters."""
    return "".join(c if c.isprintable() else " " for c in text)


# The file


def read(path: Path) -> list[Measured]:
    """Load a baseline."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8-sig"))
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
    if not baseline:
        raise InputError(f"baseline={path} holds no system; add some with update=yes")
    return baseline


def _loaded(entry: dict) -> Measured:
    classes, tables = np.array(entry.pop("classes"), dtype=object), []
    for row in entry.pop("tested"):
        whole = {"fold": str(row["fold"]), "capture": np.array(row["captures"], dtype=np.int64)}
        whole |= {"subject": str(row["subject"])} | {
            name: classes[row[name]] for name in ("true", "predicted")
        }
        tables.append(pd.DataFrame(whole))
    if wrong := {*NAMES} ^ {*entry["names"]}:
        raise KeyError(", ".join(wrong))
    entry["costs"] = {k: float(v) for k, v in entry["costs"].items()}
    return Measured(**entry, labels=pd.concat(tables, ignore_index=True))


def text(baseline: list[Measured]) -> str:
    """A baseline as JSON, with a line for each system and each of its subjects so that differences can be read."""
    entries = []
    for one in baseline:
        classes, tested = sorted({*one.labels["true"], *one.labels["predicted"]}), []
        for (fold, subject), rows in one.labels.groupby(["fold", "subject"], sort=False):
            row = {"fold": fold, "subject": subject, "captures": rows["capture"].tolist()}
            row |= {k: rows[k].map(classes.index).tolist() for k in ("true", "predicted")}
            tested.append(json.dumps(row, ensure_ascii=False))
        head = {k: v for k, v in vars(one).items() if k != "labels"} | {"classes": classes}
        lines = ",\n  ".join(tested)
        entries.append(f'{json.dumps(head, ensure_ascii=False)[:-1]}, "tested": [\n  {lines}]}}')
    return f'{{"format": {FORMAT}, "systems": [\n' + ",\n".join(entries) + "\n]}\n"
