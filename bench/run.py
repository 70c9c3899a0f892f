"""The command ``bench run``: cells from arguments, folds in workers, every fold into MLflow as it finishes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import replace

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from bench.cells import PARTS, Cell, cells, parse
from bench.corpus import Corpus, InputError
from bench.fold import FoldResult, run_fold
from bench.runner import Fold, folds_of, run_folds, share_cores, start_workers, usable_cores
from bench.store import open_corpus

KEYS = {"data", "where", "target", "seed", "jobs", *PARTS}

console = Console(stderr=True)


def run(arguments: list[str]) -> int:
    """Run every cell that the arguments name; exit code 1 if a fold failed, 130 if interrupted.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    values = parse(arguments, KEYS)
    return execute(cells(values), jobs_of(values))


def execute(asked: list[Cell], jobs: int | None) -> int:
    """Run cells; the exit code is that of `run`.

    Raises:
        InputError: something in the cells or the data cannot be used; nothing was run.
    """
    plans = planned(asked, jobs)
    client = begun(plans, jobs)
    table = _result_table()
    failed: list[str] = []
    choices = []
    from bench.tracking import CellRun

    for cell, corpus, folds, workers, threads in plans:
        try:
            key = cell.key(corpus, threads)
            metrics, errors, chosen = run_cell(client, CellRun, key, cell, corpus, folds, workers, threads)
        except KeyboardInterrupt:
            return interrupted()
        failed += [f"{cell.system()}, {cell.data}, {cell.protocol}: fold {name}" for name in errors]
        _add_row(table, cell, corpus, metrics, len(folds) - len(errors), len(folds))
        if chosen:
            choices.append(_choice_table(cell, chosen))
    return ended([*choices, table], plans, failed)


def planned(asked: list[Cell], jobs: int | None) -> list[tuple[Cell, Corpus, list[Fold], int, int]]:
    """Cell, corpus, folds, workers and threads of each; all is checked before the first fold starts.

    Raises:
        InputError: something in the cells or the data cannot be used.
    """
    plans = []
    for cell in asked:
        estimator = cell.estimator()
        for part in (estimator, *cell.feature_sets().values()):
            if hasattr(part, "check"):
                part.check()
        corpus = corpus_of(cell)
        folds = folds_of(cell, corpus)
        if hasattr(estimator, "check_training"):
            for fold in folds:
                estimator.check_training(corpus[fold.train], corpus.gestures[fold.train])
        plans.append((cell, corpus, folds, *share_cores(jobs, len(folds))))
    return plans


def corpus_of(cell: Cell) -> Corpus:
    """The captures that a cell is about.

    Raises:
        InputError: they cannot be opened, chosen, or told apart by the target.
    """
    corpus = open_corpus(cell.data, cell.data_parameters)
    if cell.where:
        corpus = corpus.select(cell.where)
    return corpus if cell.target == "gesture" else corpus.with_target(cell.target)


def begun(plans: list[tuple], jobs: int | None) -> object:
    """Start workers, say what a user should know, and open the store: a client of it."""
    start_workers(*plans[0][3:])  # takes as long as opening the store
    if jobs and jobs > usable_cores():
        console.print(f"warning: jobs={jobs}: this machine has {usable_cores()} cores, more workers would only wait")
    for line in dict.fromkeys(_warnings(plans)):
        console.print(line, style="yellow", markup=False, highlight=False, soft_wrap=True)
    from bench.tracking import connect

    return connect()


def interrupted() -> int:
    """What Ctrl-C leaves; the exit code."""
    console.print(
        "interrupted; every finished fold is stored and the same command goes on from there",
        style="bold",
        soft_wrap=True,
    )
    return 130


def output() -> Console:
    """Where results are printed."""
    out = Console()
    if not out.is_terminal:  # a file or a log has no width to fit into
        out.width = 200
    return out


def ended(tables: list[Table], plans: list[tuple], failed: list[str]) -> int:
    """Print the tables and what failed; the exit code."""
    out = output()
    for each in tables:
        out.print(each)
    if any(corpus.synthetic for _, corpus, *_ in plans):
        out.print("* synthetic: generated captures, not people; compare systems on a real corpus")
    if failed:
        more = f" and {len(failed) - 3} more" if len(failed) > 3 else ""
        console.print(
            f"{len(failed)} failed: {'; '.join(failed[:3])}{more}; the traceback is an artifact of the fold's run",
            style="bold red",
            markup=False,
            soft_wrap=True,
        )
        return 1
    return 0


def jobs_of(values: dict[str, str]) -> int | None:
    """Worker processes that were asked for."""
    if "jobs" not in values:
        return None
    try:
        return int(values["jobs"])
    except ValueError as e:
        raise InputError(f"jobs={values['jobs']}: give a whole number of worker processes") from e


def _warnings(plans: list[tuple]) -> list[str]:
    """What a user should know before the run, each thing once."""
    lines = []
    for cell, corpus, *_ in plans:
        lines += [f"warning: {cell.data}: {w}" for w in corpus.info.get("warnings", [])]
        if cell.protocol.make().mixes_subjects:
            lines.append(f"warning: protocol={cell.protocol} mixes subjects: scores are optimistic for a new person")
        frames = cell.model.parameters.get("frames")
        if isinstance(frames, int) and hasattr(model := replace(cell, tuning=None).estimator(), "length"):
            frames = model.length(corpus.rate_hz)
        if isinstance(frames, int) and (short := int((corpus.lengths < frames).sum())):
            lines.append(
                f"warning: {cell.data}: {short} of {len(corpus)} captures are shorter than the {frames}-frame window "
                f"of {cell.model.name}; they are padded"
            )
    return lines


def run_cell(
    client: object,
    tracked: Callable[..., object],
    key: str,
    cell: Cell,
    corpus: Corpus,
    folds: list[Fold],
    workers: int,
    threads: int,
    work: Callable[..., FoldResult] = run_fold,
) -> tuple[dict[str, float], list[str], dict[str, dict]]:
    """Run the folds that are not stored yet and score the cell.

    Args:
        client: of the store.
        tracked: the kind of run, `bench.tracking.CellRun` or one derived from it.
        key: what makes two runs the same.
        cell: what is run.
        corpus: its captures.
        folds: all of its folds.
        workers: processes.
        threads: in each of them.
        work: what a worker does with a fold, called as `run_fold` is.

    Returns:
        Its metrics, the failed folds, and what was chosen in each fold by a system that searches its parameters.
    """
    from bench.tracking import only_one

    with only_one(key):
        run = tracked(client, cell, corpus, key, cell.protocol.make().label(corpus), threads)
        missing = [fold for fold in folds if fold.name not in run.done]
        if not missing:
            said = f"{cell.system()} on {cell.data}, {cell.protocol}: all {len(folds)} folds were stored before"
            console.print(said, markup=False, soft_wrap=True)
        else:
            fill_cache(cell, corpus)
        errors = []
        try:
            with closing(run_folds(cell, corpus, missing, workers, threads, work)) as results, _progress() as bar:
                task = bar.add_task(f"{cell.system()} | {cell.data} | {cell.protocol}", total=len(folds))
                bar.advance(task, len(folds) - len(missing))
                for result in results:
                    run.add(result)
                    bar.advance(task)
                    if result.error:
                        errors.append(result.name)
                        reason = result.error.strip().splitlines()[-1]
                        bar.console.print(f"fold {result.name} failed: {reason}", style="red", markup=False)
            names = [fold.name for fold in folds]
            chosen = {name: run.done[name].chosen for name in names if name in run.done and run.done[name].chosen}
            return run.close(names), errors, chosen
        except KeyboardInterrupt:
            run.interrupt()
            raise


def fill_cache(cell: Cell, corpus: Corpus) -> None:
    """Compute once for all folds what needs no learning; a set that fails here fails in every fold, recorded there."""
    one = corpus[:1]
    for features in cell.feature_sets().values():
        with suppress(Exception):
            features.fit_transform(one, one.gestures)


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("folds"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=True),
        console=console,
    )


def _result_table() -> Table:
    table = Table(title="Accuracy in percent; SD over subjects")
    for name in ("system", "data", "subset", "protocol"):
        table.add_column(name)
    for name in ("captures", "SD", "macro-F1", "windows", "predict ms", "folds"):
        table.add_column(name, justify="right")
    return table


def _choice_table(cell: Cell, chosen: dict[str, dict]) -> Table:
    """What a search has chosen in the training part of each fold."""
    table = Table(title=escape(f"Chosen in each training part: {cell.system()}, {cell.data}, {cell.protocol}"))
    names = list(dict.fromkeys(name for row in chosen.values() for name in row))
    for name in ("fold", *names):
        table.add_column(escape(name))
    for fold, row in chosen.items():
        cells = [row.get(name, "") for name in names]
        table.add_row(fold, *(f"{c:.4g}" if isinstance(c, float) else escape(str(c)) for c in cells))
    return table


def _add_row(table: Table, cell: Cell, corpus: Corpus, metrics: dict[str, float], good: int, folds: int) -> None:
    def percent(name: str) -> str:
        return f"{100 * metrics[name]:.1f}" if name in metrics else "-"

    table.add_row(
        escape(cell.system()),  # rich would take svm[C=8.0] for markup
        cell.data + ("*" if corpus.synthetic else ""),
        escape((cell.where or "all") + (f", {cell.target}" if cell.target != "gesture" else "")),
        escape(str(cell.protocol)),
        percent("accuracy"),
        percent("subject_accuracy_sd"),
        percent("macro_f1"),
        percent("window_accuracy"),
        f"{metrics['predict_ms_p50']:.2f}" if metrics else "-",
        f"{good}/{folds}",
    )
