"""The commands as functions, for scripts and notebooks: the same names, tables and small objects for printing."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import asdict, dataclass, field
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from bench.commands import audit as _audit
from bench.commands import choose as _choose
from bench.commands import data as _data
from bench.commands import fit as _fit
from bench.commands import run as _run
from bench.commands import stream as _stream
from bench.commands import stress as _stress
from bench.commands import tune as _tune
from bench.commands.printing import grid, output
from bench.corpora.corpus import Corpus
from bench.corpora.survey import Survey
from bench.errors import InputError, nearest
from bench.outcomes.runs import selected, tracked, without_runs
from bench.outcomes.store import connect
from bench.plan.arguments import check_key, items
from bench.plan.cells import corpus_variants
from bench.plan.plan import captures_of
from bench.work.fit import Fitted
from bench.work.loop import Outcome, warn
from reports.comparison import comparison, published
from reports.latex import latex as latex
from reports.leaderboard import OWN, reference, scores_of

WORDS = ("task", "system", "data", "subset", "target", "protocol", "seed")  # columns of text that matter
SAID_BY_TASK = ("data", "subset", "protocol")
NAMED = {"accuracy %": "accuracy", "behind the best": "behind"}  # columns of numbers that matter, by their heading
NUMBERS = NAMED | {
    "macro-F1 %": "macro_f1",
    "early %": "adaptive_accuracy",
    "after ms": "adaptive_ms",
    "flash kB": "flash_bytes",
    "predict ms": "predict_ms_p50",
}
MOST = 4  # tables that are named
SHARES = ("accuracy", "macro_", "subject_accuracy")  # metrics that are shown in percent


@dataclass(frozen=True)
class Found:
    """What a command found: prints as its table, holds more of them.

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
        rows, said = self._shown()
        out = StringIO()
        if rows:
            spare = [name for name in rows[0] if name not in (*WORDS, *NAMED)]
            grid(Console(file=out, width=output().width), said, rows, WORDS, spare[::-1])
        names = [repr(name) for name in self.more]
        others = f" and {len(names) - MOST} others" if len(names) > MOST else ""
        tables = f"\nmore tables: {', '.join(names[:MOST])}{others}" if names else ""
        return f"{out.getvalue() or 'nothing was found; '}all {len(self.table.columns)} columns: .table{tables}"

    def _repr_html_(self) -> str:
        rows, said = self._shown()
        return f"<p>{escape(said)}</p>{pd.DataFrame(rows).to_html(index=False)}"

    def _shown(self) -> tuple[list[dict[str, str]], str]:
        """The columns that matter, as text; what all rows share stands in the title."""
        table = self.table
        known = [c for c in WORDS if c in table and not (c in SAID_BY_TASK and "task" in table)]
        shared = [c for c in known if c != "system" and len(table) > 1 and table[c].nunique() == 1]
        rows = []
        for row in table.to_dict("records"):
            numbers = {heading: _number(row, name) for heading, name in NUMBERS.items() if name in table}
            rows.append({c: str(row[c]) for c in known if c not in shared} | numbers)
        title = ", ".join(str(table[c].iloc[0]) for c in shared)
        intervals = "in brackets 95 % intervals over subjects" if any("[" in "".join(r.values()) for r in rows) else ""
        return rows, "; ".join(filter(None, [title, intervals])) or "what was found"


def _number(row: dict[Hashable, Any], name: str) -> str:
    """A number with its 95 % interval where the row has one; bytes as kB."""
    unit = 1000 if name.endswith("bytes") else 1
    ends = [row.get(each.format(name), np.nan) for each in ("{}_low", "{}_high")]
    if name == "accuracy" and "low" in row:
        ends = [row["low"], row["high"]]
    interval = "" if pd.isna(ends).any() else f" [{ends[0] / unit:.1f}, {ends[1] / unit:.1f}]"
    return "-" if pd.isna(row[name]) else f"{row[name] / unit:.1f}{interval}"


def corpus(data: str = "synth", where: str = "", target: str = "gesture", **parameters: object) -> Corpus:
    """The captures of a corpus: ``len``, ``captures`` (a table), one array [frames, rows, cols] each, ``plot(i)``.

    Args:
        data: an imported corpus, or ``synth``.
        where: captures to use, a condition on their columns.
        target: columns to tell apart.
        parameters: of ``synth``.

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
    **parameters: object,
) -> Survey:
    """What a corpus holds, as ``bench data show`` tells it; prints the same words.

    Args:
        data: an imported corpus, or ``synth``.
        where: captures to look at, a condition on their columns.
        out: folder for figures, an animation and a page that holds them; None draws nothing.
        capture: the one to animate, by its position in the whole corpus; None for a typical one of each gesture.
        parameters: of ``synth``.

    Returns:
        Tables ``counts``, ``gaps``, ``durations``, ``pressure``, ``taxels`` and ``duplicates``.

    Raises:
        InputError: it is not here, a value cannot be used, or the folder cannot be written.
    """
    return _data.looked(data, where, None if out is None else Path(out), capture, parameters)


def run(**values: object) -> pd.DataFrame:
    """Evaluate every combination of the values; what is tracked already is not run again.

    Args:
        values: as ``bench run`` takes them.

    Returns:
        One row per run, accuracies in percent.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    return table_of(_run.evaluated_values(_values(values, _run.KEYS)))


def tune(**values: object) -> pd.DataFrame:
    """Search parameters inside each training part, as ``bench tune`` does; a row per run.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    return table_of(_tune.searched(_values(values, _tune.KEYS)))


def stress(**values: object) -> Found:
    """Find where systems fail, as ``bench stress`` does; tables ``faults``, ``conditions``, ``slices``, ``learning``.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    outcomes, _ = _stress.stressed(_values(values, _stress.KEYS))
    analyses = [outcome.analysis for outcome in outcomes if outcome.findings]
    names = {"faults": "curves", "conditions": "conditions", "slices": "slices", "learning": "learning"}
    more = {
        name: pd.concat([getattr(a, part).assign(method=a.method) for a in analyses], ignore_index=True)
        for name, part in names.items()
        if analyses
    }
    return Found(table_of(outcomes), more)


def stream(**values: object) -> Found:
    """Replay captures, as ``bench stream`` does; tables ``instants`` and ``stopping``.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    known = _stream.KEYS - {"source", "window_ms"}
    outcomes, _ = _stream.streamed(_values(values, known))
    good = [(o.findings.tables, o.plan.cell.system()) for o in outcomes if o.findings]
    more = {
        name: pd.concat([tables[f"{name}.csv"].assign(system=system) for tables, system in good], ignore_index=True)
        for name in ("instants", "stopping")
        if good
    }
    return Found(table_of(outcomes), more)


def fit(**values: object) -> Fitted:
    """Train one system on all captures and save it, as ``bench fit`` does; ``recogniser.label(corpus)`` uses it.

    Raises:
        InputError: something in the values or the data cannot be used.
    """
    return _fit.trained(_values(values, _fit.KEYS))[0]


def audit(**values: object) -> pd.DataFrame:
    """Verify that systems keep the rules of the contract, as ``bench audit`` does, on generated captures.

    Args:
        values: ``model``, ``features``, ``seed`` and their parameters, as `run` takes them.

    Returns:
        One row per system and check: system, check, result (passed, failed or not applicable), sentence, seconds.

    Raises:
        InputError: something in the values cannot be used, or a system cannot be made; nothing was checked.
    """
    audits = _audit.audited_values(_values(values, _audit.KEYS))
    return pd.DataFrame([{"system": cell.system(), **asdict(v)} for cell, verdicts in audits for v in verdicts])


def choose(**values: object) -> _choose.Chosen | pd.DataFrame:
    """The cheapest tracked system that is within one standard error of the best, as ``bench choose`` tells it.

    With ``over=``, runs are made as ``bench choose over=`` makes them; see `run` for what they give.

    Raises:
        InputError: something in the values cannot be used, or nothing is tracked for them.
    """
    given = _values(values, _choose.KEYS)
    return table_of(_choose.smallest(given)) if "over" in given else _choose.chosen(given)


def results(of: str = "", **values: object) -> pd.DataFrame | Found:
    """Tracked evaluations, one row per run and unit, accuracies in percent, published numbers beside them.

    ``bench.results("reference")`` are the results that come with touchbench: a row per frozen task and system, and by
    ``<task>/<name>`` the labels of every capture.

    Args:
        of: ``reference``, or nothing for the store.
        values: names of ``data``, ``protocol``, ``where``, ``target``, ``model``, ``features`` to keep.

    Raises:
        InputError: nothing is tracked for them.
    """
    if of:
        return _reference(of, values)
    given = _values(values, set(_choose.AMONG))
    runs = tracked(connect())
    asked = {key: items(key, value) for key, value in given.items()}
    for lacking in without_runs([runs], asked):
        warn(f"warning: {lacking}: no run of it is tracked")
    runs = selected(runs, asked)
    if not len(runs):
        raise InputError("no run is tracked for these values; make some with bench.run")
    return comparison(runs, published())


def _reference(of: str, values: dict[str, object]) -> Found:
    if of != OWN or values:
        what = f"{of!r}: give {OWN!r}" if of != OWN else f"{next(iter(values))}=: not with {OWN!r}"
        raise InputError(f"{what}, or nothing for the runs of the store")
    found = reference()
    return Found(scores_of(found), {f"{one.task.name}/{one.name}": one.table for one in found})


def table_of(outcomes: list[Outcome]) -> pd.DataFrame:
    """One row per run with all that was measured; accuracies in percent."""
    rows = []
    for outcome in outcomes:
        plan, cell = outcome.plan, outcome.plan.cell
        measured = {k: 100 * v if any(s in k for s in SHARES) else v for k, v in outcome.metrics.items()}
        about: dict[str, object] = {
            "system": cell.system(),
            "data": cell.data + (" (synthetic)" if plan.corpus.synthetic else ""),
            "subset": cell.where or "all",
            "target": cell.target,
            "protocol": plan.label,
            "seed": "none" if cell.seed is None else str(cell.seed),
        }
        counts = {"folds": f"{len(outcome.results)}/{len(plan.folds)}", "run_id": outcome.run_id}
        rows.append(about | measured | counts)
    return pd.DataFrame(rows)


def _values(given: dict[str, object], known: set[str]) -> dict[str, object]:
    """Keyword arguments as the command line has them; None is the same as not given."""
    values = {key.replace("__", "."): value for key, value in given.items() if value is not None}
    for key in values:
        check_key(key, known)
    return values
