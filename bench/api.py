"""The commands as functions, for scripts and notebooks: the same names, tables and small objects for printing."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from bench.arguments import KEYS, check_key, jobs_of
from bench.commands import audit as _audit
from bench.commands import choose as _choose
from bench.commands import data as _data
from bench.commands import fit as _fit
from bench.commands import groups as _groups
from bench.commands import tune as _tune
from bench.commands.kind import made
from bench.corpora.corpus import Corpus
from bench.corpora.streams import StreamSurvey
from bench.corpora.survey import Survey
from bench.errors import InputError, nearest
from bench.measures import over_people
from bench.options import keys, makers
from bench.outcomes.runs import SELECTING, asked_of, frame_of, grouped, selected, stored, wanted
from bench.outcomes.store import connect
from bench.plan.cells import cells, corpus_variants
from bench.plan.plan import Plan, captures_of, planned
from bench.registry import parts
from bench.reports.comparison import comparison, published
from bench.reports.latex import latex as latex
from bench.reports.pair import Compared, compared
from bench.result import COUNTS, Result
from bench.table import Table
from bench.words import items
from bench.work.fit import Fitted

SHOWN = (  # columns that matter, by name
    "task system accuracy low high behind subject_sd macro_f1 adaptive_accuracy adaptive_ms flash_bytes predict_ms_p50 "
    "origin seed folds run_id subset target data protocol"
).split()
OWN = "reference"  # name of the results that come with touchbench
RENAMED = {"accuracy_low": "low", "accuracy_high": "high", "subject_accuracy_sd": "subject_sd"}
POOLED = ["accuracy", "accuracy_low", "accuracy_high"]  # over captures, as runs store them; shown over subjects
ON = ("data", "where", "target", "protocol")
SHARES = ("accuracy", "macro_", "subject_accuracy")  # metrics that are shown in percent


class Joined(Mapping[str, pd.DataFrame]):
    """Tables by name, each of all results below each other; a table is made when it is asked for."""

    def __init__(self, runs: Sequence[Result]) -> None:
        self._runs = [*runs]

    def __getitem__(self, name: str) -> pd.DataFrame:
        tables = [(r, r.tables.get(name)) for r in self._runs]
        parts = [table.assign(system=r.method) for r, table in tables if table is not None]
        if not parts:
            raise KeyError(f"no table is called {name!r}; {nearest(name, sorted(self))}")
        return pd.concat(parts, ignore_index=True)

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys(name for r in self._runs for name in r.tables))

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Results(pd.DataFrame):
    """A row for each run with the columns that matter; all that is known of the runs is one attribute away.

    Attributes:
        runs: the `bench.result.Result` of each run behind the rows, with its ``tables``. In `bench.results` a run may
            have several rows, and reference results have none.
        tables: tables of all runs below each other by name, each with the column ``system`` (with the seed, where that
            is not the usual one).
    """

    _metadata = ["runs", "tables"]
    runs: list[Result]
    tables: Mapping[str, pd.DataFrame]

    @property
    def _constructor(self) -> type[pd.DataFrame]:
        return pd.DataFrame  # what is cut out of it or copied is a plain table

    def __reduce__(self) -> str | tuple[object, ...]:
        return pd.DataFrame(self).__reduce__()  # so is what is pickled: a store is of one process

    @property
    def full(self) -> pd.DataFrame:
        """A row for each run with every number that was measured, in percent; ``accuracy`` is pooled over captures."""
        return table_of(self.runs) if self.runs else pd.DataFrame(self)  # reference results have no runs


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
) -> Survey | StreamSurvey:
    """Survey a corpus, as ``bench data show`` does; the result prints as the same sentences.

    Args:
        data: an imported corpus, or ``synth``.
        where: captures, or recordings, to look at, a condition on their columns.
        out: folder for figures, an animation and a page that holds them; None draws nothing.
        capture: the one to animate, by its position in the whole corpus; None for a typical one of each gesture.
        target: columns that make the class to predict, such as ``variant``; its classes are counted.
        parameters: parameters of ``synth``.

    Returns:
        Tables ``counts``, ``gaps``, ``classes``, ``durations``, ``pressure``, ``taxels`` and ``duplicates``; of
        recordings ``recordings``, ``events`` and ``stretches``, and these tables as ``captures``.

    Raises:
        InputError: it is not here, a value cannot be used, or the folder cannot be written.
    """
    return _data.looked(data, where, target, None if out is None else Path(out), capture, parameters)


def run(**values: object) -> Results:
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
        One row per run: ``system``, ``accuracy`` in percent, the mean over subjects, with its 95 % t-interval (``low``,
        ``high``) and SD (``subject_sd``), ``macro_f1`` in percent, ``flash_bytes``, ``predict_ms_p50``, what it ran
        on, ``folds`` and ``run_id``. ``bench.results(full=True)`` has everything that was measured; ``accuracy`` there
        is pooled over captures, ``subject_accuracy_mean`` is the mean over subjects.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    return __getattr__("run")(**values)


def __getattr__(name: str) -> Callable[..., Results]:
    """The function of a command that makes runs: its keys are those of the command, and it writes no files.

    Raises:
        AttributeError: there is no such command.
    """
    if name not in (known := makers()):
        raise AttributeError(f"module 'bench.api' has no attribute {name!r}")
    own = [option for option in known[name].options() if option.key != "out"]

    def make(**values: object) -> Results:
        return results_of(made(name, _values(values, keys(name))))

    make.__name__ = make.__qualname__ = name
    lines = [f"    {option.key}: {option.help}." for option in own]
    text = known[name].spelling.command.text
    make.__doc__ = "\n".join([text, "", "Takes the keys of `run`, and:", *lines, "", "Gives a row per run."])
    return make


def plans(**values: object) -> list[Plan]:
    """The plans of `run`: captures, folds and an untrained system for every combination of the values.

    Args:
        values: keys of `run`.

    Returns:
        Plans with ``corpus``, ``folds`` (``name``, positions ``train`` and ``test``) and ``cell.estimator()``.

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    typed = _values(values, KEYS)
    return planned(cells(typed), jobs_of(typed))


def tune(**values: object) -> Results:
    """Search parameters inside each training part, as ``bench tune`` does; a row per run.

    Args:
        values: keys of `run`; values of ``model__X`` to try; ``trials`` (combinations in each fold, default 50),
            ``seconds`` (of searching in a fold) and ``inner`` (groups of training subjects that judge, default 3, or
            ``loso``). ``smallest`` (a parameter, or ``features``) looks for its smallest value that suffices.

    Returns:
        The columns of `run`.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    return results_of(_tune.searched(_values(values, keys("tune"))))


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


def choose(**values: object) -> _choose.Chosen:
    """Choose the cheapest stored system within one standard error of the best, as ``bench choose`` does.

    Args:
        values: the runs to choose among, as `results` selects them;
            ``by`` (the cost to keep low, default ``flash``); budgets ``max_flash``, ``max_ram``, ``max_predict``,
            ``max_decision``, ``max_cycles``; ``max_false_alarms`` (per hour of background) and ``max_latency``
            (median, such as ``"1s"``), which compare runs of `watch` alone; ``clock`` of the target, such as
            ``64MHz``, at which measured cycles count for ``max_decision``; ``margin`` (tolerated loss of accuracy in
            points); ``unit`` (``capture`` or ``window``); ``batch`` (``yes`` to include systems whose labels depend on
            the batch); ``shots`` (labelled captures of a new person).

    Raises:
        InputError: something in the values cannot be used, or nothing is tracked for them.
    """
    return _choose.chosen(_values(values, keys("choose")))


def groups(**values: object) -> pd.DataFrame:
    """Groups of gestures that a stored system can tell apart, as ``bench groups`` finds them.

    Args:
        values: ``data``, ``where``, ``target``, ``protocol``, ``model`` and ``features`` of `run`, among whose runs the
            most accurate system is used; ``batch`` (``yes`` to include systems whose labels depend on the batch);
            ``out`` (folder, which only the command writes).

    Returns:
        One row per number of groups, from one per gesture down to 2: `bench.outcomes.groups.groupings`.

    Raises:
        InputError: something in the values cannot be used, or no run is stored for them.
    """
    return _groups.grouped(_values(values, keys("groups")))[0]


def results(of: str = "", full: bool = False, against: str = "", **values: object) -> Results | pd.DataFrame:
    """Tracked evaluations, accuracies in percent, with published numbers; reference results come last.

    Args:
        of: nothing for the store; ``reference`` for the results that come with touchbench: a row per frozen task and
            system, and by ``<task>/<name>`` the labels of every capture.
        full: one row per run with every tag, parameter and metric, as MLflow has them: accuracies are fractions there.
        against: system that p values compare with, in the groups that have it; default the best one of each.
        values: the runs to keep: ``data``, ``where``, ``target``, ``protocol``, ``model`` and ``features`` of `run`,
            ``run`` (their ids), ``latest`` (True: of each model and feature set, only the newest parameters and
            captures). With ``model``, ``features``, ``run`` or ``latest``, reference results are left out.

    Returns:
        One row per run and way to score it, as `bench.reports.comparison.comparison` makes them; ``runs`` as of
        `Results`.

    Raises:
        InputError: nothing is tracked for them.
    """
    if of:
        return _reference(of, values | ({"full": full} if full else {}))
    typed = _values(values, SELECTING)
    runs = wanted(stored(connect()), asked_of(typed))
    if full:
        return frame_of(runs)
    if against and against not in (systems := sorted({r.system for r in runs})):
        raise InputError(f"against={against}: no run of this system is stored; {nearest(against, systems)}")
    table = comparison(grouped(runs), published(), not {"model", "features", "run", "latest"} & set(typed), against)
    return _with(Results(table), runs)


def compare(system: str | Mapping[str, object], other: str | Mapping[str, object], **values: object) -> Compared:
    """Two tracked systems on whole captures, paired over subjects; seeds are averaged.

    Args:
        system: system name as in tables, such as ``"svm · jung54"``, or its values as `run` takes them, such as
            ``{"model": "svm", "features": "jung28"}``. With ``data``, ``where``, ``target`` or ``protocol`` among
            these, only matching runs are searched.
        other: the system to compare it with.
        values: the runs of both, as `results` selects them.

    Returns:
        ``difference`` (first less second, mean over subjects, in points), its 95 % t-interval ``low`` and ``high``,
        ``p`` (two-sided Wilcoxon test), ``subjects`` (their number), ``gain`` and ``lose`` (the subjects on whom the
        first or the second is more accurate) and ``accuracy`` (a table [subjects, 2]).

    Raises:
        InputError: a system has no complete run, or the two were not run on the same data, subset and protocol.
    """
    asked = asked_of(_values(values, SELECTING))
    every = selected(stored(connect()), asked)
    sides = []
    for one in (system, other):
        typed = {} if isinstance(one, str) else _values(one, KEYS)
        among = {key: items(key, value) for key, value in typed.items() if key in ON}
        name = one if isinstance(one, str) else _system({k: v for k, v in typed.items() if k not in ON})
        groups = {group: selected(members, among) for group, members in grouped(every).items()}
        sides.append((name, {group: members for group, members in groups.items() if members}))
    return compared(sides)


def results_of(runs: Sequence[Result]) -> Results:
    """Results as a table with a row each."""
    scored = Table([over_people("accuracy")], runs).frame()
    scored = scored.reindex(columns=POOLED if scored["accuracy"].notna().any() else [])
    named = table_of(runs).drop(columns=POOLED, errors="ignore").join(scored).rename(columns=RENAMED)
    return _with(Results(named[[name for name in SHOWN if name in named]]), runs)


def _with(table: Results, runs: Sequence[Result]) -> Results:
    """The table with its results, and their tables below each other."""
    table.runs, table.tables = [*runs], Joined(runs)
    return table


def _system(values: dict[str, object]) -> str:
    """The name of the one system that some values mean."""
    systems = {cell.system() for cell in cells(values)}
    if len(systems) > 1:
        raise InputError(f"{values} describe {len(systems)} systems; give one")
    return systems.pop()


def _reference(of: str, values: dict[str, object]) -> Results:
    if of != OWN or values:
        what = f"{of!r}: give {OWN!r}" if of != OWN else f"{next(iter(values))}=: not with {OWN!r}"
        raise InputError(f"{what}, or nothing for the runs of the store")
    if not (shipped := parts("references")):
        raise InputError(f"{of!r}: this installation has no reference results; give nothing for the runs of the store")
    scores, tables = zip(*(one.tables() for one in shipped), strict=True)
    table = Results(pd.concat(scores, ignore_index=True))
    table.runs, table.tables = [], {name: each for named in tables for name, each in named.items()}
    return table


def table_of(runs: Sequence[Result]) -> pd.DataFrame:
    """A table with a row per run and all its measurements; accuracies in percent."""
    rows = []
    for r in runs:
        data, _, protocol = r.context
        row: dict[str, object] = {"system": r.system, "data": data, "subset": r["subset"], "target": r["target"]}
        row |= {"protocol": protocol, "seed": r["seed"]}
        row |= {k: 100 * v if any(s in k for s in SHARES) else v for k, v in r.metrics.items() if k not in COUNTS}
        rows.append(row | {"folds": r.folds, "run_id": r["run_id"]})
    return pd.DataFrame(rows)


def _values(values: Mapping[str, object], known: Collection[str]) -> dict[str, object]:
    """Keyword arguments as the command line has them; None is the same as not given."""
    typed = {key.replace("__", "."): value for key, value in values.items() if value is not None}
    for key in typed:
        check_key(key, known)
    return typed
