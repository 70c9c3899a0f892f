"""Comparison tables in LaTeX, with booktabs: one for each corpus, subset, protocol and unit."""

from __future__ import annotations

import re

import pandas as pd

from bench.errors import InputError
from bench.outcomes.comparable import MARK
from reports.numbers import notes_on, p_value

TOGETHER = ("data", "subset", "protocol", "unit")  # rows that may stand in one table
NEEDED = ("system", *TOGETHER, "accuracy", "low", "high", "subject_sd", "macro_f1", "flash_bytes")
P = "$p$ (Holm)"
ESCAPED = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\char34{}",
    "'": r"\textquotesingle{}",
    "`": r"\textasciigrave{}",
    "·": r"$\cdot$",
    "±": r"$\pm$",
    MARK: r"$^\dagger$",
    "\N{MULTIPLICATION SIGN}": r"$\times$",
} | {sign: rf"\{sign}" for sign in "&%$#_{}"}
HEAD = """\
% One table for each corpus, subset, protocol and unit. Needs \\usepackage{booktabs}.
"""


def latex(table: pd.DataFrame) -> str:
    """Tables that compare systems, each with a caption that says what was compared.

    Args:
        table: as `bench.results` gives it, that of the store or of ``reference``: a row per run and unit, accuracies in
            percent. Rows on the same captures, under the same protocol and in the same unit come into one table. Choose
            systems with `bench.results` rather than in its table: p is corrected for all systems of that.

    Returns:
        Text for a document that loads booktabs.

    Raises:
        InputError: it is no such table.
    """
    table = getattr(table, "table", table) if not isinstance(table, pd.DataFrame) else table
    if not isinstance(table, pd.DataFrame):
        raise InputError(f"bench.latex: give the table of bench.results(), not {type(table).__name__}")
    if lacking := [name for name in NEEDED if name not in table]:
        raise InputError(f"bench.latex: no column {', '.join(lacking[:3])}; give what bench.results() returns")
    same = [name for name in (*TOGETHER, "group") if name in table]
    parts = [part for _, part in table.groupby(same, sort=False)]
    return HEAD + "".join(f"\n{_one(part, number)}" for number, part in enumerate(parts, 1))


def escaped(text: object) -> str:
    """Text that LaTeX sets as it is."""
    return "".join(ESCAPED.get(c, c) for c in " ".join(str(text).split()) if c.isprintable())


def _one(part: pd.DataFrame, number: int) -> str:
    rows = part.to_dict("records")
    columns = {"system": [escaped(_named(row)) for row in rows]}
    columns["accuracy"] = [_one_decimal(row["accuracy"]) for row in rows]
    if part["low"].notna().any():
        columns[r"95\,\% interval"] = [_interval(row["low"], row["high"]) for row in rows]
    if part.get("p_holm", pd.Series(dtype=float)).notna().any():
        columns[P] = [p_value(row["p_holm"]).replace("-", "--").replace("<", "$<$") for row in rows]
    columns["SD"] = [_one_decimal(row["subject_sd"]) for row in rows]
    columns["macro-F1"] = [_one_decimal(row["macro_f1"]) for row in rows]
    columns["kB"] = [_one_decimal(row["flash_bytes"] / 1000) for row in rows]
    if "predict_ms_p50" in part:
        columns["ms"] = [_one_decimal(row["predict_ms_p50"]) for row in rows]
    best = part.loc[[not _depends_on_batch(row) for row in rows], "accuracy"].max()
    lines = []
    for row, cells in zip(rows, zip(*columns.values(), strict=True), strict=True):
        name, accuracy, *rest = cells
        if row["accuracy"] == best and len(rows) > 1 and not _depends_on_batch(row):
            accuracy = rf"\textbf{{{accuracy}}}"
        lines.append(" & ".join([name, accuracy, *rest]) + r" \\")
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering\small\setlength{\tabcolsep}{4pt}",
            rf"\caption{{{_caption(part)}}}",
            rf"\label{{tab:touchbench-{number}}}",
            rf"\begin{{tabular}}{{l{'r' * (len(columns) - 1)}}}",
            r"\toprule",
            " & ".join(columns) + r" \\",
            r"\midrule",
            *lines,
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def _caption(part: pd.DataFrame) -> str:
    """Data, subset, protocol, unit, number of captures and subjects, and what the interval is of."""
    one = part.iloc[0]
    corpus = re.search(r"corpus [0-9a-f]+$", str(one.get("group", "")))
    subset = "all captures" if one["subset"] == "all" else f"captures with {one['subset']}"
    where = f"{one['data']}{f' ({corpus[0]})' if corpus else ''}, {subset}, {one['protocol']}"
    tested = f"{_numbers(part['captures'])} captures of {_numbers(part['subjects'])} subjects, scored by {one['unit']}"
    said = [f"Recognition of touch on {where}: {tested}."]
    if "(synthetic)" in str(one["data"]):
        said.append("The captures are generated and say nothing about people.")
    if "origin" in part:
        said.append(f"Origin: {'; '.join(dict.fromkeys(part['origin']))}.")
    interval = " with a 95 % bootstrap interval over subjects" if part["low"].notna().any() else ""
    pooled = "windows" if one["unit"] == "window" else "captures"
    ms = " ms: median time of one capture, from raw frames to label, on one thread." if "predict_ms_p50" in part else ""
    said.append(
        f"In percent: accuracy, pooled over {pooled}{interval}; SD over subjects; macro-F1. kB: learnt numbers, "
        f"without code.{ms}"
    )
    said += _tested(part)
    if "source" in part and (part["source"] == "reference").any():
        said.append("Rows marked (reference) come with touchbench.")
    notes = [note for system in part["system"] for note in notes_on(str(system), str(one["data"]))]
    said += [note.rstrip(".") + "." for note in dict.fromkeys(notes)]
    return escaped(" ".join(said)).replace(r"95 \%", r"95\,\%")


def _tested(part: pd.DataFrame) -> list[str]:
    """What p is, with the system that all are compared with."""
    against = [name for name in dict.fromkeys(part.get("against", [])) if name]
    if not against or not part["p_holm"].notna().any():
        return []
    return [f"p: paired two-sided Wilcoxon test over subjects against {against[0]}, corrected by Holm's procedure."]


def _depends_on_batch(row: dict) -> bool:
    """Whether a row is of a system whose predictions depend on the batch."""
    return str(row["system"]).endswith(MARK)


def _numbers(column: pd.Series) -> str:
    """A number that all rows share, or from which to which they go."""
    known = sorted({int(n) for n in column.dropna()})
    return " to ".join(dict.fromkeys(map(str, (known[0], known[-1])))) if known else "an unknown number of"


def _named(row: dict) -> str:
    """A system with what makes its row another one: a seed, failed folds."""
    done, _, folds = str(row.get("folds", "")).partition("/")
    words = [f"seed {row['seed']}"] if row.get("seed", "none") not in ("0", "none", "") else []
    words += [f"{row['folds']} folds"] if folds and done != folds else []
    words += [str(row["combined"])] if row.get("combined") else []
    return ", ".join([str(row["system"]), *words])


def _one_decimal(number: float) -> str:
    return "--" if pd.isna(number) else f"{number:.1f}"


def _interval(low: float, high: float) -> str:
    return "--" if pd.isna(low) else f"{low:.1f}--{high:.1f}"
