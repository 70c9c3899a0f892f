"""The commands as functions, for scripts and notebooks: the same names, tables and small objects for printing."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from html import escape
from pathlib import Path

import pandas as pd

from bench.arguments import check_key, items, jobs_of
from bench.commands import audit as _audit
from bench.commands import choose as _choose
from bench.commands import data as _data
from bench.commands import fit as _fit
from bench.commands import run as _run
from bench.commands import scene as _scene
from bench.commands import stream as _stream
from bench.commands import stress as _stress
from bench.commands import tune as _tune
from bench.commands import watch as _watch
from bench.commands.printing import output, system_in_tables
from bench.commands.smallest import smallest
from bench.corpora.corpus import Corpus
from bench.corpora.survey import Survey
from bench.errors import InputError, nearest
from bench.options import keys
from bench.outcomes.runs import selected, tracked, with_groups, without_runs
from bench.outcomes.store import connect
from bench.plan.cells import cells, corpus_variants
from bench.plan.plan import Plan, captures_of, planned
from bench.progress import warn
from bench.work.fit import Fitted
from bench.work.loop import Outcome
from reports.comparison import comparison, published
from reports.latex import latex as latex
from reports.leaderboard import OWN, reference, scores_of
from reports.pair import Compared, compared

NUMBERS = ("accuracy", "low", "high", "behind", "subject_sd", "macro_f1", "adaptive_accuracy", "adaptive_ms")
COSTS = ("flash_bytes", "predict_ms_p50")
WORDS = ("origin", "seed", "folds", "run_id", "subset", "target", "data", "protocol")
SHOWN = ("task", "system", *NUMBERS, *COSTS, *WORDS)  # columns that matter
RENAMED = {"accuracy_low": "low", "accuracy_high": "high", "subject_accuracy_sd": "subject_sd"}
ON = ("data", "where", "target", "protocol")
SHARES = ("accuracy", "macro_", "subject_accuracy")  # metrics that are shown in percent


@dataclass(frozen=True)
class Found:
    """The result of a command: prints as its table, holds more of them.

    Attributes:
        table: one row per run.
        more: further tables by name.
    """

    table: pd.DataFrame
    more: dict[str, pd.DataFrame] = field(default_factory=dict)

    def __getitem__(self, name: str) -> pd.DataFrame:
        if name not in self.more:
            raise KeyError(f"no table is called {name!r}; {nearest(name, self.more)}")
        return self.more[name]

    def __repr__(self) -> str:
        text = _short(self.table).to_string(index=False, float_format="{:.1f}".format, line_width=output().width)
        return "\n".join(filter(None, [text, self._rest()]))

    def _repr_html_(self) -> str:
        html = _short(self.table).to_html(index=False, float_format="{:.1f}".format)
        return f"{html}<p>{escape(self._rest())}</p>"

    def _rest(self) -> str:
        names = [repr(name) for name in self.more]
        more = f"; more tables: {', '.join(names[:4])}{', ...' * (len(names) > 4)}" if names else ""
        return f"all {len(self.table.columns)} columns: .table{more}"


def corpus(data: str = "synth", where: str = "", target: str = "gesture", **parameters: object) -> Corpus:
    """The captures of a corpus: ``len``, ``captures`` (a table), one array [frames, rows, cols] each, ``plot(i)``.

    Args:
        data: an imported corpus, or ``synth``.
        where: captures to use, a condition on their columns.
        target: columns of the class.
        parameters: parameters of ``synth``.

    Raises:
        InputError: it is not here, or the condition cannot be used.
    """
    variant, *more = corpus_variants({f"data.{k}": v for k, v in parameters.items()}, data, [data])
    if more:
        raise InputError("give one value of each parameter; a tuple is one value, a list several")
    return captures_of(data, variant, where, target)


def look(
    data: str = "synth",
    where: str = "",
    out: str | Path | None = None,
    capture: int | None = None,
    target: str = "gesture",
    **parameters: object,
) -> Survey:
    """Survey a corpus, as ``bench data show`` does; the result prints as the same sentences.

    Args:
        data: an imported corpus, or ``synth``.
        where: captures to look at, a condition on their columns.
        out: folder for figures, an animation and a page that holds them; None draws nothing.
        capture: the one to animate, by its position in the whole corpus; None for a typical one of each gesture.
        target: columns that make the class to predict, such as ``variant``; its classes are counted.
        parameters: parameters of ``synth``.

    Returns:
        Tables ``counts``, ``gaps``, ``classes``, ``durations``, ``pressure``, ``taxels`` and ``duplicates``.

    Raises:
        InputError: it is not here, a value cannot be used, or the folder cannot be written.
    """
    return _data.looked(data, where, target, None if out is None else Path(out), capture, parameters)


def run(**values: object) -> pd.DataFrame:
    """Evaluate every combination of the values; stored runs are not repeated.

    Args:
        values: a list of values runs each of them. ``model__C=8`` sets a parameter of a part, as ``model.C=8`` does on
            the command line.

            - ``data``: an imported corpus, or ``synth`` (default).
            - ``where``: captures to use, a condition on their columns.
            - ``target``: columns that make the class to predict; default ``gesture``.
            - ``protocol``: how captures are split, by name, or a scikit-learn splitter; default ``loso``.
            - ``model``: a system by name or as ``file.py:Name``, or a scikit-learn estimator; default ``svm``.
            - ``features``: a feature set, for models that take one; default ``jung54``.
            - ``seed``: for models that have one; default 0.
            - ``jobs``: worker processes; default one per core.
            - ``cluster``: address of a dask scheduler whose workers do the folds.

    Returns:
        One row per run: ``system``, ``accuracy`` in percent with its 95 % bootstrap interval over subjects (``low``,
        ``high``), ``subject_sd`` over subjects and ``macro_f1`` in percent, ``flash_bytes``, ``predict_ms_p50``, what
        it ran on, ``folds`` and ``run_id``. ``bench.results(full=True)`` has everything that was measured.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    return _short(table_of(_run.evaluated_values(_values(values, keys("run")))))


def plans(**values: object) -> list[Plan]:
    """The plans of `run`: captures, folds and an untrained system for every combination of the values.

    Args:
        values: keys of `run`.

    Returns:
        Plans with ``corpus``, ``folds`` (``name``, positions ``train`` and ``test``) and ``cell.estimator()``.

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    typed = _values(values, keys("run"))
    return planned(cells(typed), jobs_of(typed))


def tune(**values: object) -> pd.DataFrame:
    """Search parameters inside each training part, as ``bench tune`` does; a row per run.

    Args:
        values: keys of `run`; values of ``model__X`` to try; ``trials`` (combinations in each fold, default 50),
            ``budget`` (seconds of searching in a fold) and ``inner`` (groups of training subjects that judge, default
            3, or ``loso``).

    Returns:
        The columns of `run`.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    return _short(table_of(_tune.searched(_values(values, keys("tune")))))


def stress(**values: object) -> Found:
    """Find where systems fail, as ``bench stress`` does; tables ``faults``, ``conditions``, ``slices``, ``learning``.

    The table ``labels`` has a row per tested capture and circumstance (`bench.work.stress`).

    Args:
        values: keys of `run`; ``faults`` to test under (default all; or ``none``), ``train_subjects`` (numbers of
            training subjects for a learning curve) and ``out`` (folder, which only the command writes).

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    outcomes, _ = _stress.stressed(_values(values, keys("stress")))
    good = [outcome for outcome in outcomes if outcome.findings]
    names = {"faults": "curves", "conditions": "conditions", "slices": "slices", "learning": "learning"}
    more = {
        name: _joined([(o.analysis.method, getattr(o.analysis, part)) for o in good], "method")
        for name, part in names.items()
        if good
    }
    if good:
        more["labels"] = _joined([(o.analysis.method, r.table) for o in good for r in o.results], "method")
    return Found(table_of(outcomes), more)


def stream(**values: object) -> Found:
    """Replay captures, as ``bench stream`` does; tables ``instants`` and ``stopping``.

    Args:
        values: keys of `run`; ``hop_ms`` (milliseconds between decisions), ``start`` (``onset`` or ``middle``) and
            ``out`` (folder, which only the command writes).

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    outcomes, _ = _stream.streamed(_values(values, keys("stream") - {"source"}))
    good = [(system_in_tables(o), o.findings.tables) for o in outcomes if o.findings]
    more = {
        name: _joined([(system, tables[f"{name}.csv"]) for system, tables in good], "system")
        for name in ("instants", "stopping")
        if good
    }
    return Found(table_of(outcomes), more)


def watch(**values: object) -> Found:
    """Watch continuous recordings, as ``bench watch`` does; tables ``touches``, ``reports``, ``subjects``, ``curve``.

    Args:
        values: keys of `run`; ``false_alarms`` (per hour of background, accepted on training subjects, default 5),
            ``background`` (class without touch, or ``quiet``) and ``unknown`` (gesture to leave out of training).

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    outcomes = _watch.watched(_values(values, keys("watch")))
    good = [(system_in_tables(o), o.findings.tables) for o in outcomes if o.findings]
    names = {"touches": "touches", "reports": "reports", "subjects": "per_subject", "curve": "curve"}
    more = {
        name: _joined([(system, tables[f"{file}.csv"]) for system, tables in good], "system")
        for name, file in names.items()
        if good
    }
    return Found(table_of(outcomes), more)


def fit(**values: object) -> Fitted:
    """Train one system on all captures and save it, as ``bench fit`` does; ``recogniser.label(corpus)`` uses it.

    Args:
        values: ``data``, ``where``, ``target``, ``model``, ``features`` and ``seed`` of `run`; ``stopping`` (``false``
            learns no early decision) and ``out`` (folder to save it in, besides the store).

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    return _fit.trained(_values(values, keys("fit")))[0]


def audit(**values: object) -> pd.DataFrame:
    """Verify that systems keep the rules of the contract, as ``bench audit`` does, on generated captures.

    Args:
        values: ``model``, ``features``, ``seed`` and their parameters, as `run` takes them.

    Returns:
        One row per system and check: system, check, result (passed, failed or not applicable), sentence, seconds.

    Raises:
        InputError: something in the values cannot be used, or a system cannot be made; nothing was checked.
    """
    audits = _audit.audited_values(_values(values, keys("audit")))
    return pd.DataFrame([{"system": cell.system(), **asdict(v)} for cell, verdicts in audits for v in verdicts])


def choose(**values: object) -> _choose.Chosen | pd.DataFrame:
    """Choose the cheapest stored system within one standard error of the best, as ``bench choose`` does.

    With ``over``, runs are made as ``bench choose over=`` makes them; see `run` for what they give.

    Args:
        values: ``data``, ``where``, ``target``, ``protocol``, ``model`` and ``features`` of `run`, to choose among;
            ``by`` (the cost to keep low, default ``flash``); budgets ``max_flash``, ``max_ram``, ``max_predict``,
            ``max_decision``, ``max_cycles``; ``max_false_alarms`` (per hour of background) and ``max_latency``
            (median, such as ``"1s"``), which compare runs of `watch` alone; ``clock`` of the target, such as
            ``64MHz``, at which measured cycles count for ``max_decision``; ``margin`` (tolerated loss of accuracy in
            points); ``unit`` (``capture`` or ``window``); ``batch`` (``yes`` to include systems whose labels depend on
            the batch); ``shots`` (labelled captures of a new person); ``over`` (a parameter, or ``features``) with
            ``inner`` and the other keys of `run`.

    Raises:
        InputError: something in the values cannot be used, or nothing is tracked for them.
    """
    typed = _values(values, keys("choose"))
    return _short(table_of(smallest(typed))) if "over" in typed else _choose.chosen(typed)


def scene(**values: object) -> pd.DataFrame:
    """Groups of gestures that a stored system can tell apart, as ``bench scene`` finds them.

    Args:
        values: ``data``, ``where``, ``target``, ``protocol``, ``model`` and ``features`` of `run`, among whose runs the
            most accurate system is used; ``batch`` (``yes`` to include systems whose labels depend on the batch);
            ``out`` (folder, which only the command writes).

    Returns:
        One row per number of groups, from one per gesture down to 2: `bench.outcomes.groups.groupings`.

    Raises:
        InputError: something in the values cannot be used, or no run is stored for them.
    """
    return _scene.grouped(_values(values, keys("scene")))[0]


def results(of: str = "", full: bool = False, **values: object) -> pd.DataFrame | Found:
    """Tracked evaluations, accuracies in percent, with published numbers and reference results beside them.

    Args:
        of: nothing for the store; ``reference`` for the results that come with touchbench: a row per frozen task and
            system, and by ``<task>/<name>`` the labels of every capture.
        full: one row per run with every tag, parameter and metric, as MLflow has them: accuracies are fractions there.
        values: names of ``data``, ``protocol``, ``where``, ``target``, ``model``, ``features`` to keep. With ``model``
            or ``features``, reference results are left out.

    Returns:
        One row per run and way to score it, as `reports.comparison.comparison` makes them.

    Raises:
        InputError: nothing is tracked for them.
    """
    if of:
        return _reference(of, values | ({"full": full} if full else {}))
    typed = _values(values, _choose.AMONG)
    store = connect()
    runs = tracked(store)
    among = {key: items(key, value) for key, value in typed.items()}
    for lacking in without_runs([runs], among):
        warn(f"warning: {lacking}: no run is stored")
    runs = selected(runs, among)
    if not len(runs):
        raise InputError("no run is stored for these values; make one with bench.run")
    if full:
        return runs.reset_index(drop=True)
    return comparison(store, runs, published(), beside=not {"model", "features"} & set(typed))


def compare(system: str | Mapping[str, object], other: str | Mapping[str, object], **values: object) -> Compared:
    """Two tracked systems on whole captures, paired over subjects; seeds are averaged.

    Args:
        system: system name as in tables, such as ``"svm · jung54"`` or ``"reflex (reference)"``, or its values as `run`
            takes them, such as ``{"model": "svm", "features": "jung28"}``. With ``data``, ``where``, ``target`` or
            ``protocol`` among these, only matching runs are searched.
        other: the system to compare it with.
        values: ``data``, ``where``, ``target`` and ``protocol`` of both.

    Returns:
        ``difference`` (first less second, mean over subjects, in points), its 95 % t-interval ``low`` and ``high``,
        ``p`` (two-sided Wilcoxon test), ``subjects`` (their number), ``gain`` and ``lose`` (the subjects on whom the
        first or the second is more accurate) and ``accuracy`` (a table [subjects, 2]).

    Raises:
        InputError: a system has no complete run, or the two were not run on the same data, subset and protocol.
    """
    on = _values(values, ON)
    store = connect()
    runs = with_groups(tracked(store))
    sides = []
    for one in (system, other):
        typed = {} if isinstance(one, str) else _values(one, keys("run"))
        among = {key: items(key, value) for key, value in (on | typed).items() if key in ON}
        name = one if isinstance(one, str) else _system({k: v for k, v in typed.items() if k not in ON})
        sides.append((name, selected(runs, among)))
    return compared(store, sides)


def _joined(tables: list[tuple[str, pd.DataFrame]], column: str) -> pd.DataFrame:
    """Tables below each other, their names in a column."""
    return pd.concat([table.assign(**{column: name}) for name, table in tables], ignore_index=True)


def _system(values: dict[str, object]) -> str:
    """The name of the one system that some values mean."""
    systems = {cell.system() for cell in cells(values)}
    if len(systems) > 1:
        raise InputError(f"{values} describe {len(systems)} systems; give one")
    return systems.pop()


def _reference(of: str, values: dict[str, object]) -> Found:
    if of != OWN or values:
        what = f"{of!r}: give {OWN!r}" if of != OWN else f"{next(iter(values))}=: not with {OWN!r}"
        raise InputError(f"{what}, or nothing for the runs of the store")
    results = reference()
    return Found(scores_of(results), {f"{one.task.name}/{one.name}": one.table for one in results})


def table_of(outcomes: list[Outcome]) -> pd.DataFrame:
    """A table with a row per run and all its measurements; accuracies in percent."""
    rows = []
    for outcome in outcomes:
        plan, cell = outcome.plan, outcome.plan.cell
        row: dict[str, object] = {
            "system": system_in_tables(outcome),
            "data": cell.data + (" (synthetic)" if plan.corpus.synthetic else ""),
            "subset": cell.where or "all",
            "target": cell.target,
            "protocol": plan.label,
            "seed": "none" if cell.seed is None else str(cell.seed),
        }
        row |= {k: 100 * v if any(s in k for s in SHARES) else v for k, v in outcome.metrics.items()}
        rows.append(row | {"folds": f"{len(outcome.results)}/{len(plan.folds)}", "run_id": outcome.run_id})
    return pd.DataFrame(rows)


def _short(table: pd.DataFrame) -> pd.DataFrame:
    """The columns that matter, the first and the last ones most: where it is narrow, pandas leaves out the others."""
    named = table.rename(columns=RENAMED)
    return named[[name for name in SHOWN if name in named]]


def _values(values: Mapping[str, object], known: Collection[str]) -> dict[str, object]:
    """Keyword arguments as the command line has them; None is the same as not given."""
    typed = {key.replace("__", "."): value for key, value in values.items() if value is not None}
    for key in typed:
        check_key(key, known)
    return typed
