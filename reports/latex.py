"""Tables in LaTeX, with booktabs: one for each corpus, subset, protocol and unit, and one of systems by protocols."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import mean
from typing import Any

import pandas as pd

from bench import few
from bench.comparable import MARK, MIXED, MIXED_MARK, facts_of, notes_on
from bench.described import definitions
from bench.errors import InputError, nearest
from bench.measures import Interval, Measure, columns, framed, percent, run_columns, text
from bench.outcomes.frame import by_subject
from bench.reports.contexts import busy
from bench.result import Result
from bench.sentences import sentences
from bench.table import Table, rows_of

TOGETHER = ("data", "subset", "protocol", "unit")  # rows that may stand in one table
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
SCORES = ("accuracy", "macro_f1")  # columns under each protocol
COSTS = {"fit": "fit_seconds", "predict": "predict_ms_p50", "flash": "flash"}  # columns of `run_columns`, of a system
SIDE_BY_SIDE = r"% One table for each corpus and subset. Needs \usepackage{booktabs}." + "\n"


@dataclass(frozen=True)
class Paper:
    """The systems on one corpus, subset and target.

    Attributes:
        data: corpus and subset in words.
        table: a row per system, the most accurate under the first protocol first; protocols for new people come first.
        best: for each column, the row of its most accurate system; None for columns without one.
        notes: sentences on what the numbers are.
    """

    data: tuple[str, str]
    table: Table
    best: list[int | None]
    notes: list[str]


def latex(table: pd.DataFrame) -> str:
    """Tables that compare systems, each with a caption that names corpus, protocol and unit.

    Args:
        table: table of `bench.reports.comparison.comparison`. Rows on the same captures, under the same protocol and in
            the same unit share one table.
    """
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


def escaped(words: object) -> str:
    """Text that LaTeX sets as it is."""
    return "".join(ESCAPED.get(c, c) for c in " ".join(str(words).split()) if c.isprintable())


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
    """A run with what makes its row another one: failed folds, how windows are combined."""
    done, _, folds = str(row.get("folds", "")).partition("/")
    words = [f"{row['folds']} folds"] if folds and done != folds else []
    words += [str(row["combined"])] if row.get("combined") else []
    return ", ".join([str(row["name"]), *words])


def columns_of(value: object) -> list[str]:
    """The columns that ``paper=`` names: those of `SCORES` and `COSTS`.

    Raises:
        InputError: there is no such column, or no score is among them.
    """
    asked = [str(name) for name in (value.split(",") if isinstance(value, str) else value)]  # type: ignore[attr-defined]
    known = [*SCORES, *COSTS]
    for name in asked:
        if name not in known:
            raise InputError(f"paper={name}: {nearest(name, known)}")
    if not {*SCORES} & {*asked}:
        raise InputError(f"paper={','.join(asked)} has no score; add accuracy or macro_f1")
    return [name for name in known if name in asked]


def papers(runs: Sequence[Result], asked: Sequence[str]) -> list[Paper]:
    """A table for each corpus, subset and target, with the columns asked for: means over people of complete results."""
    corpora: dict[tuple[str, str, str], dict[str, list[Result]]] = {}
    for r in (r for r in runs if r.complete):
        data, subset, protocol = r.context
        corpora.setdefault((data, subset, str(r["corpus_digest"])), {}).setdefault(protocol, []).append(r)
    made = []
    for (data, subset, digest), protocols in corpora.items():
        several = len([key for key in corpora if key[:2] == (data, subset)]) > 1
        made.append(_paper((data + f" (corpus {digest[:8]})" * several, subset), protocols, asked))
    return made


def _paper(data: tuple[str, str], protocols: Mapping[str, list[Result]], asked: Sequence[str]) -> Paper:
    """The table of results on the same captures, by protocol."""
    people = {name: by_subject(results)[0] for name, results in protocols.items()}
    mixed = {name for name, results in protocols.items() if any(facts_of(r).mixes_subjects for r in results)}
    first, *others = sorted(protocols, key=lambda name: (name in mixed, -people[name].shape[1], name))
    brief = {name: re.split(r"[,(]", name)[0].strip() for name in protocols}
    heads = brief if len({*brief.values()}) == len(brief) else {name: name for name in protocols}
    heads = {name: head + f" {MIXED_MARK}" * (name in mixed) for name, head in heads.items()}
    costs = [measure for measure in run_columns() if measure.key in [COSTS[name] for name in asked if name in COSTS]]
    rows: dict[str, dict[str, Any]] = {}
    measures: list[Measure] = []
    best: list[int | None] = []
    for name in (first, *others):
        for system, scores in people[name].iterrows():
            seeds = [r for r in protocols[name] if r.system == system]
            row = rows.setdefault(str(system), {"system": str(system)})
            row |= {f"{heads[name]}: accuracy": scores.mean(), f"{heads[name]}: SD": scores.std(ddof=1)}
            row |= {f"{heads[name]}: macro_f1": mean(r["macro_f1"] for r in seeds)}
            if name == first:
                for key in (str(cost.read or cost.key) for cost in costs):
                    row[key] = mean(r.get(key, float("nan")) for r in seeds)
    table = [*rows.values()]  # by accuracy, as `by_subject` has them
    for words in (heads[name] for name in (first, *others)):
        compared = {i: row[f"{words}: accuracy"] for i, row in enumerate(table) if f"{words}: accuracy" in row}
        compared = {i: accuracy for i, accuracy in compared.items() if not table[i]["system"].endswith(MARK)}
        if "accuracy" in asked:
            keys = (f"{words}: accuracy", f"{words}: SD")
            measures.append(Measure(keys[0], words, keys, join=" ± "))
            best.append(max(compared, key=compared.__getitem__) if len(compared) > 1 else None)
        if "macro_f1" in asked:
            measures.append(percent(f"{words}: macro_f1", f"{words}, macro-F1"))
            best.append(None)
    notes = sentences(
        *("bench.reports", "sentences", "paper_notes"),
        synthetic="(synthetic)" in data[0],
        protocols=[first, *others],
        asked=asked,
        costs=heads[first] if costs else "",
        mixed=f"{MIXED_MARK} {MIXED}" if mixed else "",
        notes=[*dict.fromkeys(note.rstrip(".") for row in table for note in notes_on(row["system"], data[0]))],
    )
    return Paper(data, Table([text("system"), *measures, *costs], table), [None, *best, *([None] * len(costs))], notes)


def sheet(made: Sequence[Paper]) -> pd.DataFrame:
    """The numbers of all tables, for a CSV file."""
    parts = []
    for paper in made:
        mixed = [note for note in paper.notes if note.startswith(MIXED_MARK)]
        notes = [" ".join([*mixed, *notes_on(row["system"], paper.data[0])]) for row in paper.table.rows]
        parts.append(paper.table.frame().assign(data=paper.data[0], subset=paper.data[1], note=notes))
    every = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
    head = ["data", "subset", "system"]
    return every.reindex(columns=[*head, *every.columns.difference([*head, "note"], sort=False), "note"])
