"""The command ``bench check``: whether systems still do what a stored baseline says, a gate for CI.

Three questions about each system. Its accuracy, by a paired bootstrap that every system with a current run is put to.
Its labels, where the same captures must get the same ones: a system without a seed, or one with the same seed on the
same processor, versions and threads. Its cost, computing time and size. The error rate of the first two is ``error``
for the whole gate, shared evenly (Bonferroni).
"""

from __future__ import annotations

import shlex
import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from rich.console import Console
from scipy.stats import binom

from bench import scores
from bench.baseline import NAMES, Measured, read, text
from bench.cells import Cell, cells, convert, parse
from bench.errors import InputError
from bench.run import KEYS as RUN_KEYS
from bench.run import execute, jobs_of, planned

OPTIONS = {"baseline": "reports/baseline.json", "update": False, "run": True, "junit": ""}
LIMITS = {"error": 1.0, "changes": 0.2, "slower": 2.0}
KEYS = RUN_KEYS | OPTIONS.keys() | LIMITS.keys()
LARGER = 1.1  # times the learnt numbers of the baseline
COSTS = {"relative": "predict_relative", "flash": "flash_bytes"}  # what is compared, and what it is tracked as
SPARED = 2  # subjects that may be no worse where a loss on all the others is to be an alarm
NEGLIGIBLE = 1e-18  # probability at the ends of a distribution


@dataclass(frozen=True)
class Verdict:
    """What is said of one system; ``wrong`` is empty where nothing is, and ``current`` tells whether it has a run."""

    name: str
    wrong: tuple[str, ...]
    told: str
    current: bool = True

    @property
    def line(self) -> str:
        """All of it."""
        return f"{', '.join(self.wrong) or 'same':8} {self.name}: {self.told}"


def check(arguments: list[str]) -> int:
    """Compare with the baseline, or write it; exit code 1 on an alarm, or if a run failed.

    Raises:
        InputError: something in the arguments, the baseline or the data cannot be used; no file was changed.
    """
    values = parse(arguments, KEYS)
    how = {k: convert(k, values[k], usual) if k in values else usual for k, usual in (OPTIONS | LIMITS).items()}
    limits = {k: how[k] for k in LIMITS}
    if not 0 < limits["error"] < 100 or not 0 <= limits["changes"] <= 100 or not limits["slower"] > 0:
        raise InputError("error= and changes= are in percent, slower= is a factor above 0; write for example slower=2")
    added = [f"{k}={v}" for k, v in values.items() if k != "jobs" and k not in OPTIONS and k not in LIMITS]
    path = Path(how["baseline"])
    if how["update"]:
        if not how["run"]:
            raise InputError("run=false compares only; leave it out, update=true runs what is not tracked yet")
        return _update(path, added, jobs_of(values), limits)
    if added:
        raise InputError(f"{added[0]} adds to a baseline with update=true; without it, the baseline says what is run")
    baseline = read(path)
    if how["run"]:
        runs = list(dict.fromkeys(then.run for then in baseline))
        current = _run(runs, jobs_of(values))[0]
    else:
        current = _tracked(baseline)
    verdicts = compare(baseline, current, **limits)
    _say(verdicts)
    if how["junit"]:
        _write(Path(how["junit"]), junit(verdicts), "junit")
    alarms = [v for v in verdicts if v.wrong]
    accept = f"; if that is meant: bench check baseline={path} update=true" if alarms else ""
    _print(
        f"{len(verdicts) - len(alarms)} of {len(verdicts)} systems are what {path} says (error rate of accuracy and "
        f"labels {limits['error']:g} %, all together){accept}"
    )
    return 1 if alarms else 0


def compare(
    baseline: list[Measured], current: list[Measured], error: float, changes: float, slower: float
) -> list[Verdict]:
    """Judge every system of a baseline.

    Args:
        baseline: as stored.
        current: the runs to hold against it; of several that fit, one with the same seed and else the last one counts.
        error: chance, in percent, of an alarm about labels or accuracy when all systems are unchanged.
        changes: percent of labels that an unchanged system may change, such as by rounding.
        slower: factor of computing time that is an alarm.
    """
    pairs = [(then, _counterpart(then, current)) for then in baseline]
    questions = sum(1 + held(then, now) for then, now in pairs if now)
    found = []
    for then, now in pairs:
        if now is None:
            found.append(_missing(then, current))
        else:
            found.append(judge(then, now, error / 100 / questions, changes / 100, slower))
    return found


def judge(then: Measured, now: Measured, level: float, changes: float, slower: float) -> Verdict:
    """Hold one run against that of the baseline.

    Args:
        then: of the baseline.
        now: the current run.
        level: error rate of each test.
        changes: share of labels that may change where they are `held`.
        slower: factor of computing time that is an alarm.
    """
    keys = ["fold", "capture"]
    both = then.labels.merge(now.labels, on=keys, how="outer", suffixes=("", "_now"), indicator="side")
    if (both["side"] != "both").any() or (both["true"] != both["true_now"]).any():
        return Verdict(_named(then), ("other captures",), "the run tests other captures; update the baseline")
    hit_then, hit_now = (both[label] == both["true"] for label in ("predicted", "predicted_now"))
    difference = hit_now.astype(int) - hit_then.astype(int)
    units, kind = units_of(both.assign(difference=difference), level)
    p, (low, high) = p_value(units), interval(units)
    wrong = []
    if p < level:
        wrong.append("worse" if difference.sum() < 0 else "better")
    changed = int((both["predicted"] != both["predicted_now"]).sum())
    if not wrong and held(then, now) and binom.sf(changed - 1, len(both), changes) < level:
        wrong.append("changed")
    ratios = {k: now.costs[k] / then.costs[k] for k in COSTS if then.costs.get(k) and k in now.costs}
    wrong += [word for word, k, most in (("slower", "relative", slower), ("larger", "flash", LARGER))
              if ratios.get(k, 0) > most]  # fmt: skip
    percent = 100 / len(both)
    told = (
        f"{100 * hit_then.mean():.1f} -> {100 * hit_now.mean():.1f} %, {percent * difference.sum():+.1f} "
        f"[{percent * low:+.1f}, {percent * high:+.1f}], p {p:.2g} ({len(units)} {kind}), "
        f"{changed} of {len(both)} labels changed{_free(then, now)}, "
        + ", ".join(f"{word} x{ratios[k]:.2f}" if k in ratios else f"{word} not known"
                    for word, k in (("time", "relative"), ("flash", "flash")))
    )  # fmt: skip
    return Verdict(_named(then), tuple(wrong), told)


def held(then: Measured, now: Measured) -> bool:
    """Whether unchanged code must give the same labels."""
    seed = then.names["seed"]
    return seed == now.names["seed"] and (seed == "none" or then.environment == now.environment)


def _free(then: Measured, now: Measured) -> str:
    """Why the labels may change."""
    if held(then, now):
        return ""
    seed = now.names["seed"]
    return f" (as seed {seed} may)" if seed != then.names["seed"] else " (as other processors, threads or versions may)"


def units_of(tested: pd.DataFrame, level: float) -> tuple[np.ndarray, str]:
    """What is drawn in the bootstrap: subjects, or captures where subjects are too few.

    They are too few if a run that is worse on all of them but two could not be told from chance by the sign of the
    differences. Captures tell as well whether the code has changed: they, and the people, are the same in both runs.
    They leave out that a random system may do better or worse on all captures of a fold at once.

    Args:
        tested: ``subject``, ``capture`` and ``difference`` of hits, -1, 0 or 1; a capture may be tested in several
            folds.
        level: error rate of the test.

    Returns:
        The summed difference of each, int, and what they are.
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
    """Every sum of values drawn with replacement, int [sums], and its probability; the limit of endless resampling."""
    first, power = int(values.min()), draws
    base = np.bincount(values - first) / len(values)
    start, chance = 0, np.ones(1)
    while power:  # by repeated squaring
        if power & 1:
            start, chance = _trimmed(start + first, np.convolve(chance, base))
        power >>= 1
        if power:
            first, base = _trimmed(2 * first, np.convolve(base, base))
    return np.arange(start, start + len(chance)), chance


def _trimmed(start: int, chance: np.ndarray) -> tuple[int, np.ndarray]:
    kept = np.flatnonzero(chance > NEGLIGIBLE)
    return start + int(kept[0]), chance[kept[0] : kept[-1] + 1]


def _counterpart(then: Measured, current: list[Measured]) -> Measured | None:
    """The run to hold against that of the baseline; one with another seed only of a random system."""
    same = [now for now in current if all(now.names[k] == then.names[k] for k in NAMES if k != "seed")]
    exact = [now for now in same if now.names["seed"] == then.names["seed"]]
    return (exact or same or [None])[-1]


def _missing(then: Measured, current: list[Measured]) -> Verdict:
    rest = [k for k in NAMES if k not in ("corpus_digest", "seed")]
    if any(all(now.names[k] == then.names[k] for k in rest) for now in current):
        digest = then.names["corpus_digest"][:16]
        return Verdict(
            _named(then), ("not run",), f"the captures are others than the baseline's (digest {digest})", current=False
        )
    return Verdict(
        _named(then), ("not run",), f"no complete current run; it is made by: bench run {then.run}", current=False
    )


def _named(measured: Measured) -> str:
    names = measured.names
    parts = [names["system"], names["data"] + ("*" if measured.synthetic else "")]
    parts += [names["subset"]] if names["subset"] != "all" else []
    parts += [names["target"]] if names["target"] != "gesture" else []
    parts += [names["protocol"]] + ([f"seed {names['seed']}"] if names["seed"] != "none" else [])
    return " | ".join(parts)


def _cells(runs: list[str]) -> dict[str, tuple[Cell, str]]:
    """The cells of ``bench run`` arguments, each with the arguments that it came from."""
    found: dict[str, tuple[Cell, str]] = {}
    for run in runs:
        for cell in cells(parse(shlex.split(run), RUN_KEYS)):
            found.setdefault(repr(cell), (cell, run))
    return found


def _run(runs: list[str], jobs: int | None) -> tuple[list[Measured], int]:
    """Run what is not tracked yet; complete runs of the code, versions and threads as they are, and the exit code."""
    asked = _cells(runs)
    listed = [cell for cell, _ in asked.values()]
    code = execute(listed, jobs)
    if code not in (0, 1):
        raise KeyboardInterrupt
    from bench.tracking import connect, find_cell

    client = connect()
    found: dict[tuple, Measured] = {}
    for (cell, corpus, _, _, threads), (_, run) in zip(planned(listed, jobs), asked.values(), strict=True):
        tracked = find_cell(client, cell.key(corpus, threads))
        if tracked and tracked.info.status == "FINISHED":
            data = tracked.data
            row = {"run_id": tracked.info.run_id} | data.params | data.tags | data.metrics
            measured = _measured(client, row, run)
            found.setdefault(tuple(measured.names.values()), measured)  # seeds of features have no name
    return list(found.values()), code


def _tracked(baseline: list[Measured]) -> list[Measured]:
    """The newest complete runs of the store that may be held against the baseline, whatever code made them."""
    from bench.tracking import connect
    from reports.comparison import tracked

    client = connect()
    rows = tracked(client)
    rest = [k for k in NAMES if k not in ("corpus_digest", "seed")]
    asked = {tuple(then.names[k] for k in rest) for then in baseline}
    complete = rows[rows["status"] == "FINISHED"].to_dict("records")
    return [_measured(client, row, "") for row in complete if tuple(row[k] for k in rest) in asked]


def _measured(client: object, row: dict[str, object], run: str) -> Measured:
    """What is compared of a tracked run."""
    labelled = scores.captures(pd.read_parquet(client.download_artifacts(row["run_id"], "predictions.parquet")))
    environment = {k: str(v) for k, v in row.items() if k in ("cpu", "simd", "threads") or k.startswith("version.")}
    environment["version.python"] = environment["version.python"].rpartition(".")[0]  # a patch computes the same
    return Measured(
        run,
        {k: str(row[k]) for k in NAMES},
        {k: v for k, v in environment.items() if v != "nan" and k != "version.touchbench"},
        {k: float(row[name]) for k, name in COSTS.items() if np.isfinite(row.get(name, np.nan))},
        labelled[["fold", "capture", "subject", "true", "predicted"]].astype({"fold": str, "subject": str}),
        row["synthetic"] == "true",
    )


def _update(path: Path, added: list[str], jobs: int | None, limits: dict[str, float]) -> int:
    """Run again what the baseline names, and what is added; write it if every run is complete."""
    before = read(path) if path.exists() or not added else []
    runs = list(dict.fromkeys([then.run for then in before] + ([shlex.join(added)] if added else [])))
    after, code = _run(runs, jobs)
    if code:
        _print(f"a run failed; {path} stays as it was")
        return code
    kept = [then for then in before if _counterpart(then, after)]
    _say(compare(kept, after, **limits))
    for now in after:
        if not any(_counterpart(then, [now]) for then in before):
            hits = (now.labels["true"] == now.labels["predicted"]).mean()
            _print(f"{'new':8} {_named(now)}: {100 * hits:.1f} %")
    for then in before:
        if then not in kept:
            _print(f"{'gone':8} {_named(then)}: bench run {then.run} no longer makes it")
    _write(path, text(after), "baseline")
    _print(f"{path}: {len(after)} systems")
    return 0


def junit(verdicts: list[Verdict]) -> str:
    """The verdicts in the XML that CI servers read: a test case for each system."""
    wrong = [v for v in verdicts if v.wrong]
    failures = sum(v.current for v in wrong)
    counts = {"tests": len(verdicts), "failures": failures, "errors": len(wrong) - failures}
    suite = ElementTree.Element("testsuite", {"name": "bench check"} | {k: str(n) for k, n in counts.items()})
    for verdict in verdicts:
        case = ElementTree.SubElement(suite, "testcase", {"classname": "bench.check", "name": _printable(verdict.name)})
        line = _printable(verdict.line)
        if verdict.wrong:
            ElementTree.SubElement(case, "failure" if verdict.current else "error", {"message": line})
        else:
            ElementTree.SubElement(case, "system-out").text = line
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _printable(text: str) -> str:
    """XML has no way to write control characters."""
    return "".join(c if c.isprintable() else " " for c in text)


def _write(path: Path, content: str, key: str) -> None:
    """Beside the final name, then renamed.

    Raises:
        InputError: it cannot be written.
    """
    beside = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False
        ) as f:
            beside = Path(f.name)
            f.write(content)
        beside.chmod(0o644)
        beside.replace(path)
    except OSError as e:
        if beside:
            beside.unlink(missing_ok=True)
        raise InputError(f"{key}={path} cannot be written ({e.strerror}); choose another place") from e


def _say(verdicts: list[Verdict]) -> None:
    for verdict in verdicts:
        _print(verdict.line)


def _print(line: str) -> None:
    Console().print(line, markup=False, highlight=False, soft_wrap=True)
