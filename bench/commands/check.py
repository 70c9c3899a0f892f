"""The command ``bench check``: a gate for CI that compares systems with a stored baseline."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path

from bench.commands.printing import print_failures, print_lines
from bench.commands.run import run_cells
from bench.errors import InputError
from bench.grammar.options import (
    RUN_KEYS,
    executor_keys,
    key_options,
    make_executor,
    parse_arguments,
    typed_settings,
)
from bench.ground.registry import PART_GROUPS
from bench.ground.scratch import write_then_rename
from bench.ground.typed import Values
from bench.plan.cells import Cell
from bench.plan.grid import make_cells
from bench.reading import gate
from bench.reading.captures import stale_sentences
from bench.reading.gate import SystemRecord, SystemVerdict
from bench.reading.runs import (
    SELECTING_KEYS,
    load_clean_runs,
    load_results_on_captures,
    parse_selection,
    select_runs,
)
from bench.running.workers import FoldExecutor
from bench.store.client import connect
from bench.values.result import format_count


def command(arguments: list[str]) -> int:
    """Compare with the baseline, or write it; exit code 1 on an alarm, or if a run failed.

    An error that prevents the comparison, such as a mistyped key, is written to the JUnit file too:
    the file of the last check may say that all is well.
    """
    try:
        return _check_or_update(parse_arguments(arguments, key_options("check", arguments)))
    except BaseException as e:
        for argument in arguments:
            key, _, path = argument.partition("=")
            if key == "junit" and path:
                _write_file("junit", Path(path), gate.refusal_xml(f"{type(e).__name__}: {e}"))
        raise


def _check_or_update(values: Values) -> int:
    settings = typed_settings("check", values)
    limits = settings["error"], settings["slower"]
    if settings["error"] >= 100:
        raise InputError(
            f"error={settings['error']:g}: give a percentage below 100, such as error=1"
        )
    run_values = {k: v for k, v in values.items() if k not in {*executor_keys(), *settings}}
    path, executor = Path(settings["baseline"]), make_executor(values)
    if settings["update"]:
        if settings["stored"]:
            raise InputError(
                "stored=yes and update=yes exclude each other: an update needs runs; leave "
                "stored= out"
            )
        return _update(path, [f"{k}={v}" for k, v in run_values.items()], executor, limits)
    for key, value in run_values.items():
        if key not in SELECTING_KEYS and not key.startswith("protocol."):
            raise InputError(
                f"{key}={value} adds systems, which needs update=yes; leave it out to compare "
                "with the baseline"
            )
    verdicts = _compare_with_baseline(path, run_values, settings["stored"], executor, limits)
    return _print_verdicts(verdicts, path, settings["junit"], settings["error"])


def _compare_with_baseline(
    path: Path, values: Values, stored: bool, executor: FoldExecutor, limits: tuple[float, float]
) -> list[SystemVerdict]:
    """Compare the selected systems of a baseline with runs, or with stored runs."""
    selection = parse_selection(values)
    baseline = gate.read_baseline(path)
    if selection:
        baseline = [each for each in baseline if _select_cells([each.run], selection, each)]
    if not baseline:
        keys = " ".join(f"{k}={v}" for k, v in values.items())
        raise InputError(f"baseline={path} holds no system with {keys}; leave a key out")
    failures: dict[tuple, str] = {}
    if stored:
        current = _load_stored_runs(baseline)
    else:
        current, failures = _run_all([each.run for each in baseline], executor, selection)
    return gate.compare_with_baseline(baseline, current, *limits, failures, _load_history)


def _print_verdicts(verdicts: list[SystemVerdict], path: Path, junit: str, error: float) -> int:
    """Print verdicts, and write them for a CI server; return the exit code."""
    print_lines(*(verdict.line for verdict in verdicts))
    if junit:
        _write_file("junit", Path(junit), gate.verdicts_xml(verdicts))
    alarms = sum(bool(verdict.alarms) for verdict in verdicts)
    line = (
        f"{len(verdicts) - alarms} of {len(verdicts)} systems are the same as in {path} (error "
        f"rate of all tests together: {error:g} %)"
    )
    if alarms:
        line += f"; to accept the changes: bench check baseline={path} update=yes"
    print_lines(line)
    return int(alarms > 0)


def _select_cells(
    runs: Iterable[str], selection: Mapping[str, list], baseline: SystemRecord | None = None
) -> list[tuple[Cell, str]]:
    """Make the selected cells of ``bench run`` arguments, each once, with these arguments.

    Args:
        runs: arguments as typed.
        selection: values of keys that a cell must have.
        baseline: a system that a cell must be of.
    """
    selected: dict[str, tuple[Cell, str]] = {}
    for run in dict.fromkeys(runs):
        for cell in make_cells(parse_arguments(shlex.split(run), RUN_KEYS)):
            row = {"data": cell.data, "subset": cell.where or "all", "target": cell.target}
            row |= {"protocol": str(cell.protocol), "system": cell.system_name()}
            is_of_system = baseline is None or row.items() <= baseline.names.items()
            names = {part.group: part.name for part in cell.parts}
            row |= {f"{key}_name": names.get(group, "") for key, group in PART_GROUPS.items()}
            row |= {f"protocol.{k}": str(v) for k, v in cell.protocol.parameters.items()}
            if is_of_system and select_runs([row], selection):
                selected.setdefault(repr(cell), (cell, run))
    return [*selected.values()]


def _run_all(
    runs: Iterable[str], executor: FoldExecutor, selection: Mapping[str, list]
) -> tuple[list[SystemRecord], dict[tuple, str]]:
    """Run what is not stored yet.

    Returns:
        The complete runs, and the reason of each one that failed, by its names.
    """
    cells = _select_cells(runs, selection)
    results = run_cells([cell for cell, _ in cells], executor)
    print_failures(results)
    complete: dict[tuple[str, ...], SystemRecord] = {}
    failures: dict[tuple, str] = {}
    for result, (cell, run) in zip(results, cells, strict=True):
        result.attributes["subset"] = cell.where or "all"  # a stored run may write it otherwise
        if result.is_complete:
            names = tuple(str(result[name]) for name in gate.KEY_TAGS)
            complete.setdefault(names, gate.record_of_result(result, run))
        if result.errors:
            names = tuple(str(result[name]) for name in gate.COUNTERPART_TAGS)
            failures[names] = next(iter(result.errors.values())).reason
    return [*complete.values()], failures


def _load_stored_runs(baseline: list[SystemRecord]) -> list[SystemRecord]:
    """Load the newest complete runs that can be compared with the baseline, of any code."""
    systems = {tuple(each.names[name] for name in gate.COUNTERPART_TAGS) for each in baseline}
    results = [
        result
        for result in load_results_on_captures(connect())
        if result.is_complete and tuple(result[name] for name in gate.COUNTERPART_TAGS) in systems
    ]
    print_lines(*stale_sentences(results))
    return [gate.record_of_result(result, "") for result in results]


def _load_history(current: SystemRecord) -> list[tuple[str, SystemRecord]]:
    """Load the runs of a system up to a current one, the oldest first, with their revisions.

    After a checkout of older code, newer runs are of other code.
    """
    runs = [
        (result.get("git") or "unknown", gate.record_of_result(result, ""))
        for result in load_clean_runs(connect())
        if all(str(result[name]) == value for name, value in current.names.items())
    ]
    same = [i for i, (_, record) in enumerate(runs) if record.costs == current.costs]
    return runs[: same[-1] + 1] if same else runs


def _update(
    path: Path, added: list[str], executor: FoldExecutor, limits: tuple[float, float]
) -> int:
    """Run all systems of the baseline and the added ones; write it if every run is complete."""
    before = gate.read_baseline(path) if path.exists() or not added else []
    runs = [each.run for each in before] + ([shlex.join(added)] if added else [])
    after, failures = _run_all(runs, executor, {})
    if failures:
        print_lines(f"a run failed; {path} is unchanged")
        return 1
    kept = [each for each in before if gate.find_counterpart(each, after)]
    print_lines(*(verdict.line for verdict in gate.compare_with_baseline(kept, after, *limits)))
    for current in after:
        if not any(gate.find_counterpart(each, [current]) for each in before):
            accuracy = (current.labels["true"] == current.labels["predicted"]).mean()
            print_lines(f"{'new':8} {gate.system_line(current)}: pooled {100 * accuracy:.1f} %")
    for each in before:
        if each not in kept:
            print_lines(
                f"{'gone':8} {gate.system_line(each)}: bench run {each.run} no longer makes it"
            )
    _write_file("baseline", path, gate.baseline_json(after))
    print_lines(f"{path}: {format_count(len(after), 'system')}")
    return 0


def _write_file(key: str, path: Path, content: str) -> None:
    """Write a file that a key names."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_then_rename(path) as unfinished:
            unfinished.write_text(content, encoding="utf-8")
    except OSError as e:
        raise InputError(
            f"{key}={path} cannot be written ({e.strerror}); choose another place"
        ) from e
