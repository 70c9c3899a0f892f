"""Comparison tables in LaTeX, with booktabs: one for each corpus, subset, protocol and unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from bench import few
from bench.comparable import MARK, MIXED_MARK, notes_on
from bench.described import definitions
from bench.errors import InputError
from bench.measures import Interval, columns, framed, run_columns
from bench.outcomes.runs import of_captures
from bench.reports.numbers import busy
from bench.reports.paper import Paper, columns_of, papers
from bench.sentences import sentences
from bench.table import rows_of

TOGETHER = ("data", "subset", "protocol", "unit")  # rows that may stand in one table
NEEDED = ("system", *TOGETHER, "accuracy", "low", "high", "subject_sd", "macro_f1", "flash_bytes")
ESCAPED = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": "$<$",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\char34{}",
    "'": r"\textquotesingle{}",
    "`": r"\textasciigrave{}",
    "·": r"$\cdot$",
    "±": r"$\pm$",
    MARK: r"$^\dagger$",
    MIXED_MARK: r"$^\ddagger$",
    "\N{MULTIPLICATION SIGN}": r"$\times$",
} | {sign: rf"\{sign}" for sign in "&%$#_{}"}
HEAD = r"% One table for each corpus, subset, protocol and unit. Needs \usepackage{booktabs}." + "\n"
SIDE_BY_SIDE = r"% One table for each corpus and subset. Needs \usepackage{booktabs}." + "\n"


def latex(table: pd.DataFrame, paper: Sequence[str] | str = ()) -> str:
    """Tables that compare systems, each with a caption that names corpus, protocol and unit.

    Args:
        table: table from `bench.results`: a row per run and unit, accuracies in percent. Rows on the same captures,
            under the same protocol and in the same unit share one table. Choose systems with `bench.results` rather
            than in its table: p is corrected for all systems of that.
        paper: columns of a table with systems as rows and protocols side by side: ``accuracy`` (mean over people ± SD)
            and ``macro_f1`` under each protocol, ``fit``, ``predict`` and ``flash`` of each system. Protocols that mix
            people are marked. Empty for a table of each protocol.

    Returns:
        Text for a document that loads booktabs.

    Raises:
        InputError: it is no such table.
    """
    if not isinstance(table, pd.DataFrame):
        raise InputError(f"bench.latex: give the table of bench.results(), not {type(table).__name__}")
    if paper:
        if not getattr(table, "runs", None):
            raise InputError("bench.latex: paper= needs what bench.results() returns for stored runs, as it is")
        return side_by_side(papers(of_captures(table.runs), columns_of(paper)))
    if lacking := [name for name in NEEDED if name not in table]:
        raise InputError(f"bench.latex: no column {', '.join(lacking[:3])}; give what bench.results() returns")
    same = [name for name in (*TOGETHER, "group") if name in table]
    parts = [part for _, part in table.groupby(same, sort=False)]
    return HEAD + "".join(f"\n{_one(part, i)}" for i, part in enumerate(parts, 1))


def side_by_side(made: Sequence[Paper]) -> str:
    """The tables of a paper; the most accurate system under each protocol is bold."""
    return SIDE_BY_SIDE + "".join(f"\n{_side_by_side(one, i)}" for i, one in enumerate(made, 1))


def _side_by_side(one: Paper, position: int) -> str:
    cells = one.table.shown().map(escaped)
    for column, row in enumerate(one.best):
        if row is not None:
            cells.iloc[row, column] = rf"\textbf{{{cells.iloc[row, column]}}}"
    data, subset = one.data
    words = sentences(
        *("bench.reports", "sentences", "paper"),
        data=data,
        subset=subset,
        notes=one.notes,
        classifiers=definitions(str(row["system"]) for row in one.table.rows),
    )
    return _written(cells.rename(columns=escaped), escaped(" ".join(words)), f"tab:touchbench-paper-{position}")


def escaped(text: object) -> str:
    """Text that LaTeX sets as it is."""
    return "".join(ESCAPED.get(c, c) for c in " ".join(str(text).split()) if c.isprintable())


def _one(part: pd.DataFrame, position: int) -> str:
    """One table, its best accuracy in bold."""
    rows = rows_of(part.rename(columns={"low": "accuracy_low", "high": "accuracy_high"}))
    measures = [framed(measure) for measure in columns(run_columns(), "latex")]
    cells = pd.DataFrame({"system": [escaped(_named(row)) for row in rows]}, part.index)
    for measure in measures:
        values = [measure.cell(row) for row in rows]
        if all(value is None for value in values) and measure.spare:
            continue
        heading, plain = measure.latex or escaped(measure.name), replace(measure, ends="")
        cells[heading] = [escaped(plain.of(row)) for row in rows]
        if any(isinstance(value, Interval) for value in values):
            ends = [value if isinstance(value, Interval) else None for value in values]
            cells[r"95\,\% interval"] = [
                "-" if v is None or v.low is None else f"{v.low:.1f}--{v.high:.1f}" for v in ends
            ]
    compared = ~part["system"].astype(str).str.endswith(MARK)
    best = compared & (part["accuracy"] == part["accuracy"][compared].max()) & (len(part) > 1)
    cells["accuracy"] = cells["accuracy"].mask(best, r"\textbf{" + cells["accuracy"] + "}")
    return _written(cells, _caption(part), f"tab:touchbench-{position}")


def _written(cells: pd.DataFrame, caption: str, label: str) -> str:
    """A table of LaTeX cells."""
    return (
        cells.replace("-", "--")
        .style.hide(axis="index")
        .to_latex(
            hrules=True,
            column_format="l" + "r" * (len(cells.columns) - 1),
            caption=caption,
            label=label,
            position_float="centering",
        )
        .replace("\\centering\n", "\\centering\\small\\setlength{\\tabcolsep}{4pt}\n", 1)
    )


def _caption(part: pd.DataFrame) -> str:
    """Data, subset, protocol, unit, number of captures and subjects, and what the numbers are."""
    one = part.iloc[0]
    corpus = re.search(r"corpus [0-9a-f]+$", str(one.get("group", "")))
    subset = "all captures" if one["subset"] == "all" else f"captures with {one['subset']}"
    where = f"{one['data']}{f' ({corpus[0]})' if corpus else ''}, {subset}, {one['protocol']}"
    tested = f"{_numbers(part['captures'])} captures of {_numbers(part['subjects'])} subjects, scored by {one['unit']}"
    against = [name for name in dict.fromkeys(part.get("against", [])) if name]
    notes = [note for system in part["system"] for note in notes_on(str(system), str(one["data"]))]
    words = sentences(
        *("bench.reports", "sentences", "caption"),
        where=where,
        tested=tested,
        synthetic="(synthetic)" in str(one["data"]),
        unit=one["unit"],
        interval=part["low"].notna().any(),
        few=[few.too_few(n) for n in sorted({int(n) for n in part["subjects"].dropna()}) if n < few.TEST],
        timed="predict_ms_p50" in part,
        busy=[*dict.fromkeys(note for row in rows_of(part) for note in busy(row))],
        against=against[0] if against and part["p_holm"].notna().any() else "",
        classifiers=definitions(part["system"].astype(str)),
        notes=[note.rstrip(".") for note in dict.fromkeys(notes)],
    )
    return escaped(" ".join(words)).replace(r"95 \%", r"95\,\%")


def _numbers(column: pd.Series) -> str:
    """A number that all rows share, or from which to which they go."""
    values = sorted({int(n) for n in column.dropna()})
    return " to ".join(dict.fromkeys(map(str, (values[0], values[-1])))) if values else "an unknown number of"


def _named(row: dict) -> str:
    """A system with what makes its row another one: a seed, failed folds."""
    done, _, folds = str(row.get("folds", "")).partition("/")
    words = [f"seed {row['seed']}"] if row.get("seed", "none") not in ("0", "none", "") else []
    words += [f"{row['folds']} folds"] if folds and done != folds else []
    words += [str(row["combined"])] if row.get("combined") else []
    return ", ".join([str(row["system"]), *words])
