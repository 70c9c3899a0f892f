"""touchbench: recognisers of social touch on the same captures under the same protocol.

    import bench

    corpus = bench.corpus("synth", subjects=6)
    table = bench.run(data="synth", protocol="loso", model=["svm", "bayes"], data__subjects=6)
    bench.choose(data="synth", protocol="loso", max_flash="256kB")

The functions take the keys of the command line (see ``bench run --help``), with lists instead of
commas, ``model__C=8`` for ``model.C=8``, and scikit-learn estimators, feature sets and splitters
besides names. All raise `InputError` for invalid values. Nothing heavy is imported before a call.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError as InputError
from bench.grammar.options import (
    RUN_KEYS,
    STORED_OPTIONS,
    Option,
    command_options,
    key_options,
    make_executor,
    values_from_keywords,
)
from bench.grammar.signatures import set_signatures

if TYPE_CHECKING:
    import pandas as pd

    from bench.corpora.corpus import Corpus
    from bench.corpora.survey import Survey
    from bench.plan.plan import Plan
    from bench.reading.choice import Choice
    from bench.reading.compare import Compared
    from bench.running.fit import Fitted


def run(**values: object) -> pd.DataFrame:
    """Evaluate every combination of the values; stored runs are not repeated.

    Args:
        values: keys of ``bench run``. Each value of a list is run. ``model__C=8`` sets a parameter
            of a part, as ``model.C=8`` does on the command line. Scikit-learn estimators, feature
            sets and splitters may replace names.

    Returns:
        One row per run, as from `bench.runs`; `bench.predictions` takes it and gives the labels.
    """
    from bench.commands.run import run_from_python

    return run_from_python("run", values)


def stress(**values: object) -> pd.DataFrame:
    """Evaluate under faults and on fewer training subjects, as ``bench stress`` does.

    Args:
        values: keys of ``bench stress``, as `run` takes them.
    """
    from bench.commands.run import run_from_python

    return run_from_python("stress", values)


def plans(**values: object) -> list[Plan]:
    """Plan the runs of `run`, which takes the same values, without evaluating them.

    Returns:
        For every combination a plan with ``corpus``, ``folds`` (``name``, positions ``train`` and
        ``test``) and ``cell.estimator()``, which makes an untrained system.
    """
    from bench.plan.grid import make_cells
    from bench.plan.plan import make_plans

    typed = values_from_keywords(values, RUN_KEYS)
    return make_plans(make_cells(typed), make_executor(typed).jobs)


def tune(**values: object) -> pd.DataFrame:
    """Search parameters inside each training part; returns the columns of `run`.

    Args:
        values: keys of ``bench tune``, such as ``trials``, as `run` takes them. All values of a
            list for ``model__X`` are tried.
    """
    from bench.commands.tune import run_searches
    from bench.reading.frame import runs_table

    return runs_table(run_searches(values_from_keywords(values, _keys_of_new_runs("tune"))))


def fit(**values: object) -> Fitted:
    """Train one system on all captures and save it; ``recogniser.label(corpus)`` uses it.

    Args:
        values: keys of ``bench fit``, as `run` takes them.
    """
    from bench.commands.fit import fit_from_values

    return fit_from_values(values_from_keywords(values, key_options("fit")))


def audit(**values: object) -> pd.DataFrame:
    """Verify that systems keep the rules of the contract, on generated captures.

    Args:
        values: keys of ``bench audit``, as `run` takes them.

    Returns:
        One row per system and check: system, check, result (passed, failed or not applicable),
        sentence, seconds.
    """
    import pandas as pd

    from bench.commands.audit import audit_systems

    audits = audit_systems(values_from_keywords(values, key_options("audit")))
    rows = [
        ({"system": cell.system_name()}, vars(v)) for cell, verdicts in audits for v in verdicts
    ]
    return pd.DataFrame([system | verdict for system, verdict in rows])


def corpus(
    data: str = "synth", where: str = "", target: str = "gesture", **parameters: object
) -> Corpus:
    """Load captures: a sequence of arrays [frames, rows, cols], table ``captures``, ``plot(i)``.

    Args:
        data: an imported corpus, or ``synth``.
        where: captures to use, a condition on their columns.
        target: columns of the class.
        parameters: parameters of ``synth``, and of a designed skin, such as ``skin__grid="4x4"``.
    """
    from bench.commands.data import load_selected_captures

    return load_selected_captures(data, parameters, where, target)


def look(
    data: str = "synth",
    where: str = "",
    out: str | Path | None = None,
    target: str = "gesture",
    **parameters: object,
) -> Survey:
    """Survey a corpus, as ``bench data show`` does; the result prints as the same sentences.

    Args:
        data: as for `corpus`.
        where: as for `corpus`.
        out: folder for figures and a page that holds them; None draws nothing.
        target: as for `corpus`; its classes are counted.
        parameters: as for `corpus`.

    Returns:
        Tables ``counts``, ``gaps``, ``classes``, ``durations``, ``pressure``, ``taxels`` and
        ``duplicates``.
    """
    from bench.commands.data import survey_captures

    return survey_captures(
        corpus(data, where, target, **parameters), None if out is None else Path(out)
    )


def extract(**values: object) -> pd.DataFrame:
    """Compute features of all captures, in a table with subject, gesture and conditions.

    Features that learn are fitted to all these captures: do not test a system on any of them.

    Args:
        values: ``data``, ``where``, ``target``, ``features`` and ``seed`` of `run`.
    """
    from bench.commands.data import extract_features

    return extract_features(
        values_from_keywords(values, RUN_KEYS.keys() - {"protocol", "model", "jobs"})
    )


def runs(cases: bool = False, **values: object) -> pd.DataFrame:
    """List stored runs of all kinds, with accuracies in percent.

    Args:
        cases: True for a row per case of the circumstances of each run, such as a fault at one
            severity.
        values: keys of ``bench runs`` that select runs, such as ``data``, ``run`` (ids) and
            ``latest=True``.

    Returns:
        One row per run: ``name``, which has what differs from its neighbours; ``accuracy``, the
        mean over subjects, with its 95 % t-interval (``low``, ``high``) and SD, and every other
        number; system, model, features, parameters, seed, unit, subset, target, data and protocol;
        ``complete``, ``alone``, ``folds`` and ``run_id``.
    """
    from bench.reading.frame import runs_table

    return runs_table(_load_selected(values), cases)


def predictions(
    runs: pd.DataFrame | None = None, table: str = "predictions", **values: object
) -> pd.DataFrame:
    """Join the predictions, or another table, of stored runs.

    Args:
        runs: rows of `runs`, or of a function that makes runs; None for all selected ones.
        table: ``predictions`` (a row per capture, its windows combined: ``id``, ``subject``,
            ``truth``, ``prediction``, which is empty if the system abstained, fold, conditions and
            the probability of each class), ``decisions`` (the same of each window),
            ``per_subject``, ``labels`` (labels in the cases of circumstances) or another table.
        values: keys that select runs, as for `runs`.

    Returns:
        The rows of the table with the ``name`` and ``run_id`` of their run; shares in percent.
    """
    from bench.reading.frame import join_tables

    if runs is not None:
        values["run"] = [*runs["run_id"]]
    return join_tables(_load_selected(values), table)


def compare(system: object, other: object, **values: object) -> Compared:
    """Compare two systems on the same captures, paired over subjects.

    Args:
        system: a table or the path of a CSV or parquet file with the columns ``id`` (of a capture),
            ``subject``, ``truth`` and ``prediction``, where several rows of an id vote; or a stored
            system: its name as ``bench runs`` prints it, such as ``"svm · jung54"``, its values as
            `run` takes them, or a run id. Seeds are averaged. In a stored run, the id of a capture
            is its position in the corpus (`corpus`, attribute ``index``).
        other: the system to compare it with, given in the same ways.
        values: keys that select runs of stored systems, as for `runs`.

    Returns:
        The difference and its test, and tables of subjects, captures and gestures.
    """
    from bench.commands.compare import compare_systems

    return compare_systems((system, other), values)


def ledger(**values: object) -> pd.DataFrame:
    """Compare the protocols under which each system was run: accuracies, and points over LOSO.

    Args:
        values: keys that select runs, as for `runs`.

    Returns:
        A row per captures, system and protocol: `bench.reports.ledger.make_ledger`.
    """
    from bench.reading.runs import results_on_captures
    from bench.reports.ledger import make_ledger

    return make_ledger(results_on_captures(_load_selected(values)))


def choose(**values: object) -> Choice:
    """Choose the cheapest stored system within one standard error of the best.

    Args:
        values: keys of ``bench choose``, such as ``max_flash="64kB"``. Those of `runs` select the
            candidates.
    """
    from bench.commands.choose import choose_from_values

    return choose_from_values(values_from_keywords(values, key_options("choose")))


def groups(**values: object) -> pd.DataFrame:
    """Group gestures so that a stored system can distinguish the groups.

    Args:
        values: keys that select runs, as for `runs`, of which the most accurate system is used;
            ``batch`` of `choose`.

    Returns:
        One row per number of groups, from one per gesture down to 2:
        `bench.reading.groups.accuracy_by_grouping`.
    """
    from bench.commands.choose_groups import KEYS, find_groups

    return find_groups(values_from_keywords(values, KEYS))[0]


def latex(
    runs: pd.DataFrame, paper: Sequence[str] | str = (), published: str | Path | None = None
) -> str:
    """Write tables in LaTeX that compare systems, with corpus, protocol and unit in the captions.

    Args:
        runs: rows of `runs`, or of a function that makes runs. Runs on the same captures, under the
            same protocol and in the same unit share a table; p is corrected for its systems.
        paper: columns of a table with systems as rows and protocols side by side: ``accuracy``
            (mean over people ± SD), ``interval``, ``p``, ``published``, ``macro_f1`` and
            ``seed_sd`` under each protocol, ``fit``, ``predict`` and ``flash`` of each system.
            Seeds are averaged. Protocols that mix people are marked. Empty for a table of each
            protocol.
        published: CSV file of published numbers of your own, as ``bench report`` takes it.

    Returns:
        Text for a document that loads booktabs and graphicx.
    """
    from bench.reading.frame import group_results
    from bench.reading.runs import results_on_captures
    from bench.reports.comparison import average_seeds, score_rows
    from bench.reports.latex import comparison_latex, make_papers, papers_latex, parse_columns
    from bench.reports.own_numbers import load_numbers

    if "run_id" not in runs:
        raise InputError("bench.latex: give the table of bench.runs()")
    results = results_on_captures(_load_selected({"run": [*runs["run_id"]]}))
    numbers = load_numbers(None if published is None else Path(published))
    rows = score_rows(group_results(results), numbers=numbers)
    rows = average_seeds(rows, results)
    if paper:
        return papers_latex(make_papers(rows, parse_columns(paper)))
    return comparison_latex(rows)


def _load_selected(values: Mapping[str, object]) -> list:
    from bench.reading.runs import load_results, parse_selection, select_or_fail
    from bench.store.client import connect

    keys = {option.key for option in STORED_OPTIONS}
    selection = parse_selection(values_from_keywords(values, keys))
    return select_or_fail(load_results(connect(), selection), selection)


def _keys_of_new_runs(command: str) -> dict[str, Option]:
    """The keys of a command that makes runs or fits; ``dry`` needs a terminal."""
    return {key: option for key, option in command_options(command).items() if key != "dry"}


def _keys_of_stored_runs(command: str = "", only: str = "") -> dict[str, Option]:
    """The keys that select stored runs, all by default, and those of a command, or one of them."""
    keys = command_options(command) if command else {}
    added = {key: option for key, option in keys.items() if only in ("", key)}
    return added | {each.key: replace(each, default=None) for each in STORED_OPTIONS}


set_signatures(
    {
        **{
            function: partial(_keys_of_new_runs, function.__name__)
            for function in (run, stress, tune, fit, audit)
        },
        plans: partial(dict, RUN_KEYS),
        extract: lambda: {
            key: option
            for key, option in RUN_KEYS.items()
            if key not in ("protocol", "model", "jobs")
        },
        choose: partial(_keys_of_stored_runs, "choose"),
        groups: partial(_keys_of_stored_runs, "choose", "batch"),
        **dict.fromkeys((runs, predictions, compare, ledger), _keys_of_stored_runs),
    }
)
