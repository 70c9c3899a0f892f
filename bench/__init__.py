"""touchbench: recognisers of social touch on the same captures under the same protocol.

    import bench

    corpus = bench.corpus("synth", subjects=6)
    table = bench.run(data="synth", protocol="loso", model=["svm", "bayes"], data__subjects=6)
    bench.choose(data="synth", protocol="loso", max_flash="256kB")

The functions take the names of the command line (see ``bench run --help``): lists instead of commas, ``model__C=8`` for
``model.C=8``, and scikit-learn estimators, feature sets and splitters besides names. Nothing heavy is loaded before
one of them is called. All raise `InputError` for what cannot be used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError as InputError

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
        values: keys of ``bench run``. A list of values runs each of them. ``model__C=8`` sets a parameter of a part, as
            ``model.C=8`` does on the command line. Scikit-learn estimators, feature sets and splitters may stand
            instead of names.

    Returns:
        One row per run, as `bench.runs` has them; `bench.predictions` takes it and gives the labels.
    """
    from bench.commands.run import run_from_python

    return run_from_python("run", values)


def stress(**values: object) -> pd.DataFrame:
    """Runs under faults, and on fewer training subjects, as ``bench stress`` makes them; it writes no files.

    Args:
        values: keys of ``bench stress``, as `run` takes them.
    """
    from bench.commands.run import run_from_python

    return run_from_python("stress", values)


def plans(**values: object) -> list[Plan]:
    """The plans of `run`, which takes the same values: captures, folds and an untrained system for every combination.

    Returns:
        Plans with ``corpus``, ``folds`` (``name``, positions ``train`` and ``test``) and ``cell.estimator()``.
    """
    from bench.grammar.options import RUN_KEYS, make_executor, values_from_keywords
    from bench.plan.grid import make_cells
    from bench.plan.plan import make_plans

    typed = values_from_keywords(values, RUN_KEYS)
    return make_plans(make_cells(typed), make_executor(typed).jobs)


def tune(**values: object) -> pd.DataFrame:
    """Search parameters inside each training part; the columns of `run`.

    Args:
        values: keys of ``bench tune``, such as ``trials``, as `run` takes them; a list of ``model__X`` is tried.
    """
    from bench.commands.tune import run_searches
    from bench.grammar.options import key_options, values_from_keywords
    from bench.reading.frame import runs_table

    return runs_table(run_searches(values_from_keywords(values, key_options("tune"))))


def fit(**values: object) -> Fitted:
    """Train one system on all captures and save it; ``recogniser.label(corpus)`` uses it.

    Args:
        values: keys of ``bench fit``, as `run` takes them.
    """
    from bench.commands.fit import fit_from_values
    from bench.grammar.options import key_options, values_from_keywords

    return fit_from_values(values_from_keywords(values, key_options("fit")))


def audit(**values: object) -> pd.DataFrame:
    """Verify that systems keep the rules of the contract, on generated captures.

    Args:
        values: keys of ``bench audit``, as `run` takes them.

    Returns:
        One row per system and check: system, check, result (passed, failed or not applicable), sentence, seconds.
    """
    import pandas as pd

    from bench.commands.audit import audit_systems
    from bench.grammar.options import key_options, values_from_keywords

    audits = audit_systems(values_from_keywords(values, key_options("audit")))
    return pd.DataFrame(
        [
            {"system": cell.system_name(), **vars(each)}
            for cell, verdicts in audits
            for each in verdicts
        ]
    )


def corpus(
    data: str = "synth", where: str = "", target: str = "gesture", **parameters: object
) -> Corpus:
    """The captures of a corpus: ``len``, ``captures`` (a table), one array [frames, rows, cols] each, ``plot(i)``.

    Args:
        data: an imported corpus, or ``synth``.
        where: captures to use, a condition on their columns.
        target: columns of the class.
        parameters: parameters of ``synth``.
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
        Tables ``counts``, ``gaps``, ``classes``, ``durations``, ``pressure``, ``taxels`` and ``duplicates``.
    """
    from bench.commands.data import survey_captures

    return survey_captures(
        corpus(data, where, target, **parameters), None if out is None else Path(out)
    )


def extract(**values: object) -> pd.DataFrame:
    """The features of all captures, beside their subject, gesture and conditions.

    Features that learn are fitted to all these captures: do not test on any of them.

    Args:
        values: ``data``, ``where``, ``target``, ``features`` and ``seed`` of `run`.
    """
    from bench.commands.data import extract_features
    from bench.grammar.options import RUN_KEYS, values_from_keywords

    return extract_features(
        values_from_keywords(values, RUN_KEYS.keys() - {"protocol", "model", "jobs"})
    )


def runs(cases: bool = False, **values: object) -> pd.DataFrame:
    """Stored runs of all kinds, accuracies in percent.

    Args:
        cases: True for a row for each case of the circumstances of each run, such as a fault at one severity.
        values: the runs to keep: keys of ``bench runs``, such as ``data``, ``run`` (ids) and ``latest=True``.

    Returns:
        One row per run: ``name``, which tells what differs from its neighbours; ``accuracy``, the mean over subjects,
        with its 95 % t-interval (``low``, ``high``) and SD, and every other number; system, model, features,
        parameters, seed, unit, subset, target, data and protocol; ``complete``, ``alone``, ``folds`` and ``run_id``.
    """
    from bench.reading.frame import runs_table

    return runs_table(_stored(values), cases)


def predictions(
    runs: pd.DataFrame | None = None, table: str = "predictions", **values: object
) -> pd.DataFrame:
    """The labels of stored runs as one table, or another table of theirs.

    Args:
        runs: rows of `runs`, or of a function that makes runs; None for all that ``values`` select.
        table: ``predictions`` (a row per decision with the probability of each class), ``per_subject``, ``labels``
            (labels in the cases of circumstances) or another table of a run.
        values: the runs to keep, as `runs` takes them.

    Returns:
        The rows of the table with the ``name`` and ``run_id`` of their run.
    """
    from bench.reading.frame import join_tables

    return join_tables(
        _stored(values if runs is None else {**values, "run": [*runs["run_id"]]}), table
    )


def compare(system: object, other: object, **values: object) -> Compared:
    """Two systems on the same captures, paired over subjects; captures are matched by their id.

    Args:
        system: a table or the path of a CSV or parquet file with the columns ``id``, ``subject``, ``truth`` and
            ``prediction`` (several rows of an id vote); or a stored system: its name as ``bench runs`` prints it,
            such as ``"svm · jung54"``, its values as `run` takes them, or a run id. Seeds are averaged. The id of
            a capture of a stored run is its place in the corpus (`corpus`, attribute ``index``).
        other: what to compare it with, given in one of the same ways.
        values: the runs of stored systems, as `runs` selects them.

    Returns:
        The difference and its test, and tables of subjects, captures and gestures.
    """
    from bench.commands.compare import compare_systems

    return compare_systems((system, other), values)


def ledger(**values: object) -> pd.DataFrame:
    """Each stored system under every protocol that was run on the same captures, and the points over LOSO.

    Args:
        values: the runs to keep, as `runs` takes them.

    Returns:
        A row per captures, system and protocol: `bench.reports.ledger.make_ledger`.
    """
    from bench.reading.runs import results_on_captures
    from bench.reports.ledger import make_ledger

    return make_ledger(results_on_captures(_stored(values)))


def choose(**values: object) -> Choice:
    """Choose the cheapest stored system within one standard error of the best.

    Args:
        values: keys of ``bench choose``, such as ``max_flash="64kB"``. The keys of `runs` select the candidates.
    """
    from bench.commands.choose import choose_from_values
    from bench.grammar.options import key_options, values_from_keywords

    return choose_from_values(values_from_keywords(values, key_options("choose")))


def groups(**values: object) -> pd.DataFrame:
    """Groups of gestures that a stored system can tell apart.

    Args:
        values: the runs whose most accurate system is used, as `runs` selects them; ``batch`` of `choose`.

    Returns:
        One row per number of groups, from one per gesture down to 2: `bench.reading.groups.accuracy_by_grouping`.
    """
    from bench.commands.choose_groups import KEYS, find_groups
    from bench.grammar.options import values_from_keywords

    return find_groups(values_from_keywords(values, KEYS))[0]


def latex(runs: pd.DataFrame, paper: Sequence[str] | str = ()) -> str:
    """Tables that compare systems, each with a caption that names corpus, protocol and unit.

    Args:
        runs: rows of `runs`, or of a function that makes runs. Runs on the same captures, under the same protocol and
            in the same unit share one table; p is corrected for all systems of it.
        paper: columns of a table with systems as rows and protocols side by side: ``accuracy`` (mean over people ± SD)
            and ``macro_f1`` under each protocol, ``fit``, ``predict`` and ``flash`` of each system. Protocols that mix
            people are marked. Empty for a table of each protocol.

    Returns:
        Text for a document that loads booktabs and graphicx.
    """
    from bench.reading.frame import group_results
    from bench.reading.runs import results_on_captures
    from bench.reports import latex
    from bench.reports.comparison import score_rows
    from bench.reports.latex import make_papers, papers_latex, parse_columns

    if "run_id" not in runs:
        raise InputError("bench.latex: give the table of bench.runs()")
    results = results_on_captures(_stored({"run": [*runs["run_id"]]}))
    if paper:
        return papers_latex(make_papers(results, parse_columns(paper)))
    return latex.comparison_latex(score_rows(group_results(results)))


def _stored(values: Mapping[str, object]) -> list:
    from bench.grammar.options import STORED_OPTIONS, values_from_keywords
    from bench.reading.runs import load_results, parse_selection, select_or_fail
    from bench.store.client import connect

    asked = parse_selection(values_from_keywords(values, {option.key for option in STORED_OPTIONS}))
    return select_or_fail(load_results(connect(), asked), asked)
