"""The command ``bench check``: a gate for CI that compares systems with a stored baseline."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from bench.commands.run import run_cells
from bench.errors import InputError
from bench.grammar.options import (
    MORE,
    RUN_OPTIONS,
    Command,
    Option,
    backend_keys,
    backend_of,
    key_options,
    parse_arguments,
    typed_settings,
)
from bench.grammar.options import RUN_KEYS
from bench.ground.scratch import write_then_rename
from bench.ground.registry import PART_GROUPS
from bench.values.result import format_count

if TYPE_CHECKING:
    from bench.ground.machine import Backend
    from bench.plan.cells import Cell
    from bench.reading.gate import Measured

LIMITS = ("error", "slower")  # keys
COMMAND = Command(
    MORE,
    "compare runs with a stored baseline, a gate for CI",
    "Prints one line per system of the baseline: same, worse, better, changed (labels), slower, larger, or not "
    "run. Runs everything that the current code has not run yet. Exit code 1 if a system is not the same. better "
    "also counts, because a leak makes a system better. A paired bootstrap over subjects tests accuracy. 0.2 % of "
    "the labels may change, and sizes may grow by 10 %. Keys of bench run select systems of the baseline.",
    "bench check update=yes data=haart model=svm,rf features=jung54\nbench check junit=check.xml slower=3",
    options=(
        *RUN_OPTIONS,
        Option("baseline", "text", "reports/baseline.json", "baseline file"),
        Option(
            "update", "yes", False, "yes: write the baseline again; keys of bench run add systems"
        ),
        Option("stored", "yes", False, "yes: run nothing, compare the newest stored runs"),
        Option(
            "error",
            "number",
            1,
            "error rate in percent of all tests of accuracy and labels together",
        ),
        Option(
            "slower",
            "number",
            2,
            "largest factor of computing time, relative to a reference workload",
        ),
        Option("junit", "text", "", "JUnit file for a CI server, such as check.xml"),
    ),
)


def command(arguments: list[str]) -> int:
    """Compare with the baseline, or write it; exit code 1 on an alarm, or if a run failed.

    What prevents the comparison is written into the JUnit file, too: the one of the last check may have been green.
    """
    from bench.reading import gate

    try:
        return _command(arguments)
    except BaseException as e:
        for path in [
            a.removeprefix("junit=") for a in arguments if a.startswith("junit=") and a != "junit="
        ]:
            _write(Path(path), gate.refused(f"{type(e).__name__}: {e}"), "junit")
        raise


def _command(arguments: list[str]) -> int:
    from bench.commands.printing import print_lines
    from bench.reading import gate
    from bench.reading.runs import SELECTING_KEYS, parse_selection

    values = parse_arguments(arguments, key_options("check"))
    how = typed_settings("check", values)
    limits = {k: float(how[k]) for k in LIMITS}
    if limits["error"] >= 100:
        raise InputError(f"error={limits['error']:g}: give a percentage below 100, such as error=1")
    of_runs = {k: v for k, v in values.items() if k not in {*backend_keys(), *how}}
    added = [f"{k}={v}" for k, v in of_runs.items()]
    path = Path(how["baseline"])
    if how["update"]:
        if how["stored"]:
            raise InputError(
                "stored=yes and update=yes exclude each other: an update needs runs; leave stored= out"
            )
        return _update(path, added, backend_of(values), limits)
    if new := [
        f"{k}={v}"
        for k, v in of_runs.items()
        if k not in SELECTING_KEYS and not k.startswith("protocol.")
    ]:
        raise InputError(
            f"{new[0]} adds systems, which needs update=yes; leave it out to compare with the baseline"
        )
    asked = parse_selection(of_runs)
    baseline = [then for then in gate.read(path) if not asked or _cells([then.run], asked, then)]
    if not baseline:
        raise InputError(f"baseline={path} holds no system with {' '.join(added)}; leave a key out")
    failed: dict[tuple, str] = {}
    if how["stored"]:
        current = _stored(baseline)
    else:
        current, failed = _run([then.run for then in baseline], backend_of(values), asked)
    verdicts = gate.compare(baseline, current, limits["error"], limits["slower"], failed, _history)
    print_lines(*(verdict.line for verdict in verdicts))
    if how["junit"]:
        _write(Path(how["junit"]), gate.junit(verdicts), "junit")
    alarms = [v for v in verdicts if v.wrong]
    accept = f"; to accept the changes: bench check baseline={path} update=yes" if alarms else ""
    print_lines(
        f"{len(verdicts) - len(alarms)} of {len(verdicts)} systems are the same as in {path} (error rate of all tests "
        f"together: {limits['error']:g} %){accept}"
    )
    return 1 if alarms else 0


def _cells(
    runs: list[str], asked: Mapping[str, list], then: Measured | None = None
) -> list[tuple[Cell, str]]:
    """The selected cells of ``bench run`` arguments, with these; each once."""
    from bench.plan.grid import make_cells
    from bench.reading.runs import select_runs

    planned: dict[str, tuple[Cell, str]] = {}
    for run in dict.fromkeys(runs):
        for cell in make_cells(parse_arguments(shlex.split(run), RUN_KEYS)):
            row = {"data": cell.data, "subset": cell.where or "all", "target": cell.target}
            row |= {"protocol": str(cell.protocol), "system": cell.system_name()}
            parts = dict.fromkeys(PART_GROUPS.values(), "") | {
                part.group: part.name for part in cell.parts
            }
            named = {f"{key}_name": parts[room] for key, room in PART_GROUPS.items()}
            named |= {f"protocol.{k}": str(v) for k, v in cell.protocol.parameters.items()}
            if select_runs([row | named], asked) and (
                then is None or row.items() <= then.names.items()
            ):
                planned.setdefault(repr(cell), (cell, run))
    return [*planned.values()]


def _run(
    runs: list[str], backend: Backend, asked: Mapping[str, list] | None = None
) -> tuple[list[Measured], dict[tuple, str]]:
    """Run what is not tracked yet; complete runs of the code, versions and threads as they are, and why others fail."""
    from bench.commands.printing import print_failures
    from bench.reading import gate

    planned = _cells(runs, asked or {})
    results = run_cells([cell for cell, _ in planned], backend)
    print_failures(results)
    complete: dict[tuple[str, ...], Measured] = {}
    for result, (_, run) in zip(results, planned, strict=True):
        if result.is_complete:
            complete.setdefault(
                tuple(str(result[k]) for k in gate.NAMES), gate.measured(result, run)
            )
    failed = {
        tuple(str(r[k]) for k in gate.SAME): next(iter(r.errors.values())).reason
        for r in results
        if r.errors
    }
    return [*complete.values()], failed


def _stored(baseline: list[Measured]) -> list[Measured]:
    """The newest complete results of the store that may be held against the baseline, whatever code made them."""
    from bench.reading import gate
    from bench.reading.runs import load_results_on_captures
    from bench.store.client import connect

    same = {tuple(then.names[k] for k in gate.SAME) for then in baseline}
    complete = [
        r
        for r in load_results_on_captures(connect())
        if r.is_complete and tuple(r[k] for k in gate.SAME) in same
    ]
    return [gate.measured(r, "") for r in complete]


def _history(now: Measured) -> list[tuple[str, Measured]]:
    """The stored runs of a system up to a current one, oldest first, each with its revision."""
    from bench.reading import gate
    from bench.reading.runs import load_clean_runs
    from bench.store.client import connect

    results = [
        r
        for r in load_clean_runs(connect())
        if all(str(r[name]) == value for name, value in now.names.items())
    ]
    runs = [(r.get("git") or "unknown", gate.measured(r, "")) for r in results]
    last = max(
        (i for i, (_, each) in enumerate(runs) if each.costs == now.costs), default=len(runs) - 1
    )
    return runs[: last + 1]  # after a checkout of older code, newer runs are of other code


def _update(path: Path, added: list[str], backend: Backend, limits: dict[str, float]) -> int:
    """Run again what the baseline names, and what is added; write it if every run is complete."""
    from bench.commands.printing import print_lines
    from bench.reading import gate

    before = gate.read(path) if path.exists() or not added else []
    after, failed = _run(
        [then.run for then in before] + ([shlex.join(added)] if added else []), backend
    )
    if failed:
        print_lines(f"a run failed; {path} is unchanged")
        return 1
    kept = [then for then in before if gate.counterpart(then, after)]
    print_lines(
        *(verdict.line for verdict in gate.compare(kept, after, limits["error"], limits["slower"]))
    )
    for now in after:
        if not any(gate.counterpart(then, [now]) for then in before):
            hits = (now.labels["true"] == now.labels["predicted"]).mean()
            print_lines(f"{'new':8} {gate.named(now)}: pooled {100 * hits:.1f} %")
    for then in before:
        if then not in kept:
            print_lines(f"{'gone':8} {gate.named(then)}: bench run {then.run} no longer makes it")
    _write(path, gate.text(after), "baseline")
    print_lines(f"{path}: {format_count(len(after), 'system')}")
    return 0


def _write(path: Path, content: str, key: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_then_rename(path) as beside:
            beside.write_text(content, encoding="utf-8")
    except OSError as e:
        raise InputError(
            f"{key}={path} cannot be written ({e.strerror}); choose another place"
        ) from e
