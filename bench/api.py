"""The commands as functions, for scripts and notebooks: the same names, tables and small objects for printing.

`bench.stored` has those that show stored runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from bench import contract
from bench.arguments import KEYS, jobs_of
from bench.commands import audit as _audit
from bench.commands import choose as _choose
from bench.commands import data as _data
from bench.commands import fit as _fit
from bench.commands import groups as _groups
from bench.commands import tune as _tune
from bench.commands.kind import made
from bench.corpora.corpus import Corpus
from bench.corpora.recordings import as_touches, is_recorded
from bench.corpora.streams import StreamSurvey
from bench.corpora.survey import Survey
from bench.errors import InputError
from bench.options import keys, makers, measured
from bench.plan.cells import cells, corpus_variants
from bench.plan.plan import Plan, captures_of, planned
from bench.progress import warn
from bench.stored import Results, results_of, values_of
from bench.words import DEFAULTS
from bench.work.fit import Fitted


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
    own = [option for option in measured(known[name]) if option.key != "out"]

    def make(**values: object) -> Results:
        return results_of(made(name, values_of(values, keys(name))))

    make.__name__ = make.__qualname__ = name
    lines = [f"    {option.key}: {option.help}." for option in own]
    text = known[name].text
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
    typed = values_of(values, KEYS)
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
    return results_of(_tune.searched(values_of(values, keys("tune"))))


def extract(**values: object) -> pd.DataFrame:
    """The features of all captures, beside their subject, gesture and conditions.

    Features that learn are fitted to all these captures: do not test on any of them.

    Args:
        values: ``data``, ``where``, ``target``, ``features`` and ``seed`` of `run`.

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    known = {"data", "where", "target", "features", "seed"}
    cell, *more = cells(values_of(values, known) | {"model": DEFAULTS["model"]})
    if more:
        raise InputError("bench.extract makes one table; give one value of each key")
    captures = captures_of(cell.data, cell.data_parameters, cell.where, cell.target)
    (features,) = cell.feature_sets().values()
    contract.check(features)
    columns = features.fit(captures, captures.gestures).transform(captures)
    if both := sorted({*captures.captures.columns} & {*columns.columns}):
        raise InputError(f"{captures.name} has a column {both[0]!r}, also a feature; rename it and import again")
    if is_recorded(captures):
        warn(as_touches(captures))
    return pd.concat([captures.captures, columns], axis=1)


def fit(**values: object) -> Fitted:
    """Train one system on all captures and save it, as ``bench fit`` does; ``recogniser.label(corpus)`` uses it.

    Args:
        values: ``data``, ``where``, ``target``, ``model``, ``features`` and ``seed`` of `run`; ``stopping`` (``false``
            learns no early decision) and ``out`` (folder to save it in, besides the store).

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    return _fit.trained(values_of(values, keys("fit")))[0]


def audit(**values: object) -> pd.DataFrame:
    """Verify that systems keep the rules of the contract, as ``bench audit`` does, on generated captures.

    Args:
        values: ``model``, ``features``, ``seed`` and their parameters, as `run` takes them.

    Returns:
        One row per system and check: system, check, result (passed, failed or not applicable), sentence, seconds.

    Raises:
        InputError: something in the values cannot be used, or a system cannot be made; nothing was checked.
    """
    audits = _audit.audited_values(values_of(values, keys("audit")))
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
    return _choose.chosen(values_of(values, keys("choose")))


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
    return _groups.grouped(values_of(values, keys("groups")))[0]
