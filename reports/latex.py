"""Tables in LaTeX, with booktabs: one for each corpus, subset, protocol and unit, and one of systems by protocols."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import nan
from statistics import mean
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError, nearest
from bench.grammar.described import definitions
from bench.reading.frame import by_subject
from bench.reports.comparison import context_of
from bench.reports.contexts import busy
from bench.values import few
from bench.values.columns import run_columns, unit_headings
from bench.values.measures import Cost, Measure, known, percent, text
from bench.values.result import MARK, MIXED, MIXED_MARK, Result, Row, notes_on
from bench.values.sentences import sentences
from bench.values.table import Table

SIGNS = r"\textbackslash{} \textasciitilde{} \textasciicircum{} $<$ \textgreater{} \textbar{} \char34{} \textquotesingle{}"
SIGNS += r" \textasciigrave{} $\cdot$ $\pm$ $\times$ $^\dagger$ $^\ddagger$"
ESCAPED = dict(
    zip("\\~^<>|\"'`·±\N{MULTIPLICATION SIGN}" + MARK + MIXED_MARK, SIGNS.split(), strict=True)
)
ESCAPED |= {sign: rf"\{sign}" for sign in "&%$#_{}"}
LATIN = "\N{LATIN SMALL LETTER LONG S}"  # the last letter that pdflatex sets
SCORES = ("accuracy", "macro_f1")  # columns under each protocol
HEADINGS = {
    "accuracy": "accuracy",
    "macro_f1": "macro-F1",
    "fit_seconds": "fit s",
    "predict_ms_p50": "ms",
}
HEADINGS |= {"flash": "kB"}
LONG, NARROW = (
    32,
    4,
)  # letters of a name in one line; columns of a table in one of two columns of a page
COSTS = {
    "fit": "fit_seconds",
    "predict": "predict_ms_p50",
    "flash": "flash",
}  # columns of `run_columns`, of a system
FITTED = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{"  # no wider than there is room


@dataclass(frozen=True)
class Paper:
    """The systems on one corpus, subset and target, the most accurate under the first protocol first."""

    data: tuple[str, str]  # corpus and subset in words
    table: Table
    heads: list[tuple[str, str]]  # of each column of the table: protocol and heading
    best: list[str]  # for each column, its most accurate system; empty for none
    notes: list[str]


def latex(rows: Sequence[Row]) -> str:
    """The rows of `bench.reports.comparison.scored`, a table for all that may be compared."""
    parts = [[*part] for _, part in groupby(rows, context_of)]
    return _headed(
        "corpus, subset, protocol and unit", [_one(part, i) for i, part in enumerate(parts, 1)]
    )


def side_by_side(made: Sequence[Paper]) -> str:
    """The tables of a paper; the most accurate system under each protocol is bold."""
    return _headed("corpus and subset", [_side_by_side(one, i) for i, one in enumerate(made, 1)])


def _headed(each: str, tables: Sequence[str]) -> str:
    """The tables behind a line on what they need; another one names the engine where letters need one."""
    words = f"% One table for each {each}. Needs \\usepackage{{booktabs,graphicx}}.\n"
    text = "\n".join([words, *tables])
    engine = "% Letters beyond Latin: needs lualatex or xelatex, and a font that has them.\n"
    return engine * any(c.isalpha() and c > LATIN for c in text) + text


def escaped(words: object) -> str:
    """Text that LaTeX sets as it is."""
    return "".join(ESCAPED.get(c, c) for c in " ".join(str(words).split()) if c.isprintable())


def _one(part: Sequence[Row], position: int) -> str:
    """One table, its best accuracy in bold."""
    table = Table([text("system", read=_named), *run_columns("latex")], part)
    cells = table.shown().rename(
        columns={m.name: HEADINGS.get(m.key, m.name) for m in table.columns}
    )
    compared = [
        nan if row["system"].endswith(MARK) or len(part) == 1 else row["accuracy"] for row in part
    ]
    best = np.array(compared) == np.fmax.reduce(compared)  # nothing equals NaN
    names, values = _classifiers(row["system"] for row in part)
    return values + _written(
        cells, {HEADINGS["accuracy"]: best}, _caption(part, names), f"{position}"
    )


def _side_by_side(one: Paper, position: int) -> str:
    systems = pd.Index([str(row["system"]) for row in one.table.rows])
    cells = one.table.shown().set_axis(pd.MultiIndex.from_tuples(one.heads), axis=1)
    best = {head: systems == name for head, name in zip(one.heads, one.best, strict=True)}
    names, values = _classifiers(systems)
    about = {"data": one.data[0], "subset": one.data[1], "notes": one.notes, "classifiers": names}
    words = sentences("bench.reports", "sentences", "paper", **about)
    return values + _written(cells, best, escaped(" ".join(words)), f"paper-{position}")


def _classifiers(systems: Iterable[str]) -> tuple[list[str], str]:
    """A sentence for each classifier without its parameters, whose names are of the code; with them, as comments."""
    every = definitions(systems)
    return [re.sub(r" \(\S+=[^)]*\)\.$", ".", each) for each in every], "".join(
        f"% {each}\n" for each in every
    )


def _written(cells: pd.DataFrame, best: Mapping[Any, np.ndarray], caption: str, label: str) -> str:
    """A table of text, no wider than its place on a page; ``best`` tells the bold cells of some columns."""
    made, names = cells.map(escaped).replace("-", "--"), cells.iloc[:, 0]
    for column, bold in best.items():
        made[column] = made[column].mask(bold, r"\textbf{" + made[column] + "}")
    if long := names.str.len().max() > LONG:
        made.isetitem(
            0,
            r"\raggedright " + made.iloc[:, 0].str.replace(r"\_", r"\_\allowbreak{}", regex=False),
        )
    heads = [
        tuple(map(escaped, head)) if isinstance(head, tuple) else escaped(head) for head in made
    ]
    made.columns = pd.Index(heads)
    text = made.style.hide(axis="index").to_latex(
        hrules=True,
        column_format=("p{5cm}" if long else "l") + "r" * (len(heads) - 1),
        multicol_align="c",
        position_float="centering",
        environment="table*" if long or len(heads) > NARROW else "table",
        caption=caption,
        label=f"tab:touchbench-{label}",
    )
    return text.replace(r"\begin{tabular}", FITTED + r"\begin{tabular}").replace(
        r"\end{tabular}", r"\end{tabular}}"
    )


def _caption(part: Sequence[Row], names: Sequence[str]) -> str:
    """Data, subset, protocol, unit, number of captures and subjects, and what the numbers are."""
    one, data = part[0], part[0]["data"]
    corpus = re.search(r"corpus [0-9a-f]+$", one["group"])
    subset = "all captures" if one["subset"] == "all" else f"captures with {one['subset']}"
    known_of = lambda name: [value for row in part if (value := known(row.get(name))) is not None]  # noqa: E731
    subjects = sorted({int(n) for n in known_of("subjects")})
    words = sentences(
        *("bench.reports", "sentences", "caption"),
        where=f"{data}{f' ({corpus[0]})' if corpus else ''}, {subset}, {one['protocol']}",
        captures=_numbers(known_of("captures")),
        subjects=_numbers(subjects),
        synthetic="(synthetic)" in data,
        unit=one["unit"],
        interval=bool(known_of("accuracy_low")),
        few=[few.too_few(n) for n in subjects if n < few.TEST],
        timed=bool(known_of("predict_ms_p50")),
        busy=[*dict.fromkeys(note for row in part for note in busy(row))],
        against=next(iter(known_of("against")), "") if known_of("p_holm") else "",
        classifiers=names,
        notes=[
            *dict.fromkeys(
                note.rstrip(".") for row in part for note in notes_on(row["system"], data)
            )
        ],
    )
    return escaped(" ".join(words)).replace(r"95 \%", r"95\,\%")


def _numbers(values: Sequence[float]) -> str:
    """A number that all rows share, or from which to which they go."""
    ends = (
        dict.fromkeys(f"{end(values):.0f}" for end in (min, max))
        if values
        else ["an unknown number of"]
    )
    return " to ".join(ends)


def _named(row: Row) -> str:
    """A run with what makes its row another one: failed folds, how windows are combined."""
    done, _, folds = str(row.get("folds", "")).partition("/")
    words = [
        str(row["name"]),
        f"{row['folds']} folds" if folds and done != folds else "",
        row.get("combined") or "",
    ]
    return ", ".join(filter(None, words))


def columns_of(value: str | Iterable[str]) -> list[str]:
    """The columns that ``paper=`` names: those of `SCORES` and `COSTS`."""
    asked = value.split(",") if isinstance(value, str) else [*value]
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
        corpora.setdefault((data, subset, str(r["corpus_digest"])), {}).setdefault(
            protocol, []
        ).append(r)
    names = Counter(key[:2] for key in corpora)
    return [
        _paper(
            (data + f" (corpus {digest[:8]})" * (names[data, subset] > 1), subset), protocols, asked
        )
        for (data, subset, digest), protocols in corpora.items()
    ]


def _paper(
    data: tuple[str, str], protocols: Mapping[str, list[Result]], asked: Sequence[str]
) -> Paper:
    """The table of results on the same captures, by protocol."""
    people = {name: by_subject(results)[0] for name, results in protocols.items()}
    mixed = {name for name, results in protocols.items() if any(r.mixed for r in results)}
    ordered = sorted(protocols, key=lambda name: (name in mixed, -people[name].shape[1], name))
    brief = {name: re.split(r"[,(]", name)[0].strip() for name in protocols}
    brief = brief if len({*brief.values()}) == len(brief) else {name: name for name in protocols}
    heads = {name: brief[name] + f" {MIXED_MARK}" * (name in mixed) for name in ordered}
    costs = [
        measure
        for measure in run_columns()
        if measure.key in [COSTS[name] for name in asked if name in COSTS]
    ]
    rows: dict[str, dict[str, Any]] = {}
    columns: list[tuple[Measure, tuple[str, str], str]] = [(text("system"), ("", "system"), "")]
    for name, head in heads.items():
        accuracy, sd, macro = f"{head}: accuracy %", f"{head}: SD %", f"{head}: macro_f1 %"
        named: dict[str, list[Result]] = {}
        for r in protocols[name]:
            named.setdefault(r.system, []).append(r)
        for system, scores in people[name].iterrows():
            seeds = named.get(str(system), [])
            row = rows.setdefault(str(system), {"system": str(system)})
            row |= {
                accuracy: scores.mean(),
                sd: scores.std(ddof=1),
                macro: mean(r["macro_f1"] for r in seeds),
            }
            if name == ordered[0]:
                row |= {cost.source: mean(r.get(cost.source, nan) for r in seeds) for cost in costs}
        compared = [str(system) for system in people[name].index if not str(system).endswith(MARK)]
        if "accuracy" in asked:
            shown = Measure(accuracy, head, (accuracy, sd), join=" ± ")
            columns.append((shown, (head, "accuracy"), compared[0] if len(compared) > 1 else ""))
        if "macro_f1" in asked:
            columns.append((percent(macro, f"{head}, macro-F1"), (head, "F1"), ""))
    columns += [(cost, ("costs", HEADINGS[cost.key]), "") for cost in costs]
    notes = sentences(
        *("bench.reports", "sentences", "paper_notes"),
        synthetic="(synthetic)" in data[0],
        protocols=ordered,
        asked=asked,
        costs=heads[ordered[0]] if costs else "",
        mixed=f"{MIXED_MARK} {MIXED}" if mixed else "",
        notes=[
            *dict.fromkeys(
                note.rstrip(".") for system in rows for note in notes_on(system, data[0])
            )
        ],
    )
    measures, spans, best = map(list, zip(*columns, strict=True))
    return Paper(data, Table(measures, [*rows.values()]), spans, best, notes)


def sheet(made: Sequence[Paper]) -> pd.DataFrame:
    """The numbers of all tables, for a CSV file."""
    parts = []
    for paper in made:
        mixed = [note for note in paper.notes if note.startswith(MIXED_MARK)]
        notes = [
            " ".join([*mixed, *notes_on(row["system"], paper.data[0])]) for row in paper.table.rows
        ]
        table = paper.table.frame().rename(
            columns=unit_headings(c for c in paper.table.columns if isinstance(c, Cost))
        )
        parts.append(table.assign(data=paper.data[0], subset=paper.data[1], note=notes))
    every = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
    head = ["data", "subset", "system"]
    return every.reindex(
        columns=[*head, *every.columns.difference([*head, "note"], sort=False), "note"]
    )
