"""Tables in LaTeX, with booktabs: one for each corpus, subset, protocol and unit, and one of systems by protocols."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, groupby
from math import nan
from statistics import mean
from typing import Any

import pandas as pd

from bench import few
from bench.columns import framed, run_columns, unit_headings
from bench.described import definitions
from bench.errors import InputError, nearest
from bench.measures import Cost, Interval, Measure, percent, text
from bench.outcomes.frame import by_subject
from bench.reports.contexts import busy
from bench.result import MARK, MIXED, MIXED_MARK, Result, notes_on
from bench.sentences import sentences
from bench.table import Table, rows_of

TOGETHER = ("data", "subset", "protocol", "unit", "group")  # rows that may stand in one table
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
GREEK = zip(
    "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΥΦΨΩ",  # the other capitals are Latin letters
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi "
    "omega Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega".split(),
    strict=True,
)
ESCAPED |= {letter: rf"\ensuremath{{\{word}}}" for letter, word in GREEK}
LATIN = "\N{LATIN SMALL LETTER LONG S}"  # the last letter that pdflatex sets
HEAD = r"% One table for each corpus, subset, protocol and unit. Needs \usepackage{booktabs}." + "\n"
SCORES = ("accuracy", "macro_f1")  # columns under each protocol
HEADINGS = {"accuracy": "accuracy", "p_holm": "$p$ (Holm)", "macro_f1": "macro-F1", "abstained": "abstained"}
HEADINGS |= {"fit_seconds": "fit s", "predict_ms_p50": "ms", "flash": "kB"}
TEXT_WIDTH, COLUMN = 455, 222  # points: 16 cm of an A4 page, and one of two columns on it
NAME = 24  # letters of a line of a name, at least
SIZES = (("small", 4.9, 4), ("footnotesize", 4.4, 3), ("scriptsize", 3.9, 2))  # points of a letter, beside a column
COSTS = {"fit": "fit_seconds", "predict": "predict_ms_p50", "flash": "flash"}  # columns of `run_columns`, of a system
SIDE_BY_SIDE = r"% One table for each corpus and subset. Needs \usepackage{booktabs}." + "\n"


@dataclass(frozen=True)
class Paper:
    """The systems on one corpus, subset and target, the most accurate under the first protocol first."""

    data: tuple[str, str]  # corpus and subset in words
    table: Table
    best: list[int | None]  # for each column, the row of its most accurate system
    notes: list[str]
    heads: dict[str, tuple[str, str]]  # of a column with several under its protocol: protocol and heading in LaTeX


def latex(table: pd.DataFrame) -> str:
    """The rows of `bench.reports.comparison.comparison`, a table for each of `TOGETHER`."""
    parts = table.groupby([name for name in TOGETHER if name in table], sort=False)
    return _headed(HEAD + "".join(f"\n{_one(part, i)}" for i, (_, part) in enumerate(parts, 1)))


def side_by_side(made: Sequence[Paper]) -> str:
    """The tables of a paper; the most accurate system under each protocol is bold."""
    return _headed(SIDE_BY_SIDE + "".join(f"\n{_side_by_side(one, i)}" for i, one in enumerate(made, 1)))


def _headed(text: str) -> str:
    """The text, whose first line names the engine where letters need one."""
    engine = "% Letters beyond Latin and Greek: needs lualatex or xelatex, and a font that has them.\n"
    return engine * any(c.isalpha() and c > LATIN for c in text) + text


def _side_by_side(one: Paper, position: int) -> str:
    cells = one.table.shown().map(escaped)
    for column, row in enumerate(one.best):
        if row is not None:
            cells.iloc[row, column] = rf"\textbf{{{cells.iloc[row, column]}}}"
    data, subset = one.data
    names, values = _classifiers(str(row["system"]) for row in one.table.rows)
    about = {"data": data, "subset": subset, "notes": one.notes, "classifiers": names}
    words = sentences("bench.reports", "sentences", "paper", **about)
    if one.heads:
        heads = [one.heads.get(str(name), ("", str(name))) for name in cells]
        cells.columns = pd.MultiIndex.from_tuples([(escaped(head), escaped(name)) for head, name in heads])
    else:
        cells = cells.rename(columns=escaped)
    return values + _written(cells, escaped(" ".join(words)), f"tab:touchbench-paper-{position}")


def _classifiers(systems: Iterable[str]) -> tuple[list[str], str]:
    """A sentence for each classifier without its parameters, whose names are of the code; with them, as comments."""
    every = definitions(systems)
    return [re.sub(r" \(\S+=[^)]*\)\.$", ".", each) for each in every], "".join(f"% {each}\n" for each in every)


def escaped(words: object) -> str:
    """Text that LaTeX sets as it is."""
    return "".join(ESCAPED.get(c, c) for c in " ".join(str(words).split()) if c.isprintable())


def _one(part: pd.DataFrame, position: int) -> str:
    """One table, its best accuracy in bold."""
    rows = rows_of(part.rename(columns={"low": "accuracy_low", "high": "accuracy_high"}))
    cells = pd.DataFrame({"system": [escaped(_named(row)) for row in rows]}, part.index)
    for measure in map(framed, run_columns("latex")):
        values = [measure.cell(row) for row in rows]
        if all(value is None for value in values) and measure.spare:
            continue
        plain = replace(measure, ends="")
        cells[HEADINGS.get(measure.key) or escaped(measure.name)] = [escaped(plain.of(row)) for row in rows]
        ends = [(v.low, v.high) if isinstance(v, Interval) else (None, None) for v in values]
        if any(isinstance(value, Interval) for value in values):
            cells[r"95\,\% interval"] = ["-" if low is None else f"{low:.1f}--{high:.1f}" for low, high in ends]
    compared = ~part["system"].astype(str).str.endswith(MARK)
    best = compared & (part["accuracy"] == part["accuracy"][compared].max()) & (len(part) > 1)
    cells["accuracy"] = cells["accuracy"].mask(best, r"\textbf{" + cells["accuracy"] + "}")
    names, values = _classifiers(part["system"].astype(str))
    return values + _written(cells, _caption(part, names), f"tab:touchbench-{position}")


def _written(cells: pd.DataFrame, caption: str, label: str) -> str:
    """A table of LaTeX cells, no wider than a page: in smaller letters, then with names in several lines."""
    heads = [name if isinstance(name, tuple) else ("", name) for name in cells]  # protocol and heading
    columns = [[_seen(text) for text in (head, *cells.iloc[:, i])] for i, (_, head) in enumerate(heads)]
    longest = max(len(word) for text in columns[0] for word in re.split("[ _]", text))  # a name may break there
    longest = max(longest, min(NAME, max(map(len, columns[0]))))
    for style in SIZES:
        size, letter, beside = style
        first, *others = [letter * max(map(len, column)) + 2 * beside for column in columns]
        room = TEXT_WIDTH - sum(others)  # of the names
        if letter * longest + 2 * beside <= room:
            break
    form, cells = "l", cells.replace("-", "--")
    if first > room:
        form = f"p{{{max(room, letter * longest) - 2 * beside:.0f}pt}}"
        cells.isetitem(0, r"\raggedright " + cells.iloc[:, 0].str.replace(r"\_", r"\_\allowbreak{}", regex=False))
    environment = "table*" if first + sum(others) > COLUMN else "table"
    lines = [rf"\begin{{{environment}}}", rf"\centering\{size}\setlength{{\tabcolsep}}{{{beside}pt}}"]
    lines += [rf"\caption{{{caption}}}", rf"\label{{{label}}}"]
    lines += [rf"\begin{{tabular}}{{{form}{'r' * len(others)}}}", r"\toprule"]
    if any(head for head, _ in heads):  # protocols span their columns
        spans = [(head, len([*each])) for head, each in groupby(head for head, _ in heads)]
        ends = [*accumulate(wide for _, wide in spans)]
        lines.append(_line(rf"\multicolumn{{{wide}}}{{c}}{{{head}}}" if wide > 1 else head for head, wide in spans))
        rules = (
            rf"\cmidrule(lr){{{end - wide + 1}-{end}}}" for (head, wide), end in zip(spans, ends, strict=True) if head
        )
        lines.append("".join(rules))
    lines += [_line(name for _, name in heads), r"\midrule", *map(_line, cells.to_numpy())]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", rf"\end{{{environment}}}", ""])


def _line(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"


def _seen(text: str) -> str:
    """What is seen of a LaTeX cell, with a letter for each command."""
    return re.sub(r"[${}\\]", "", re.sub(r"\\[a-zA-Z]+", "x", text))


def _caption(part: pd.DataFrame, names: Sequence[str]) -> str:
    """Data, subset, protocol, unit, number of captures and subjects, and what the numbers are."""
    one, data = part.iloc[0], str(part["data"].iloc[0])
    corpus = re.search(r"corpus [0-9a-f]+$", str(one.get("group", "")))
    subset = "all captures" if one["subset"] == "all" else f"captures with {one['subset']}"
    against = [name for name in part.get("against", []) if name]
    notes = [note.rstrip(".") for system in part["system"] for note in notes_on(str(system), data)]
    words = sentences(
        *("bench.reports", "sentences", "caption"),
        where=f"{data}{f' ({corpus[0]})' if corpus else ''}, {subset}, {one['protocol']}",
        captures=_numbers(part["captures"]),
        subjects=_numbers(part["subjects"]),
        synthetic="(synthetic)" in data,
        unit=one["unit"],
        interval=part["low"].notna().any(),
        few=[few.too_few(n) for n in sorted({int(n) for n in part["subjects"].dropna()}) if n < few.TEST],
        timed="predict_ms_p50" in part,
        busy=[*dict.fromkeys(note for row in rows_of(part) for note in busy(row))],
        against=against[0] if against and part["p_holm"].notna().any() else "",
        classifiers=names,
        notes=[*dict.fromkeys(notes)],
    )
    return escaped(" ".join(words)).replace(r"95 \%", r"95\,\%")


def _numbers(column: pd.Series) -> str:
    """A number that all rows share, or from which to which they go."""
    values = sorted({int(n) for n in column.dropna()})
    return " to ".join(dict.fromkeys(map(str, (values[0], values[-1])))) if values else "an unknown number of"


def _named(row: dict) -> str:
    """A run with what makes its row another one: failed folds, how windows are combined."""
    done, _, folds = str(row.get("folds", "")).partition("/")
    words = [str(row["name"]), f"{row['folds']} folds" if folds and done != folds else "", row.get("combined") or ""]
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
        corpora.setdefault((data, subset, str(r["corpus_digest"])), {}).setdefault(protocol, []).append(r)
    names = Counter(key[:2] for key in corpora)
    return [
        _paper((data + f" (corpus {digest[:8]})" * (names[data, subset] > 1), subset), protocols, asked)
        for (data, subset, digest), protocols in corpora.items()
    ]


def _paper(data: tuple[str, str], protocols: Mapping[str, list[Result]], asked: Sequence[str]) -> Paper:
    """The table of results on the same captures, by protocol."""
    people = {name: by_subject(results)[0] for name, results in protocols.items()}
    mixed = {name for name, results in protocols.items() if any(r.mixed for r in results)}
    ordered = sorted(protocols, key=lambda name: (name in mixed, -people[name].shape[1], name))
    brief = {name: re.split(r"[,(]", name)[0].strip() for name in protocols}
    heads = brief if len({*brief.values()}) == len(brief) else {name: name for name in protocols}
    costs = [measure for measure in run_columns() if measure.key in [COSTS[name] for name in asked if name in COSTS]]
    rows: dict[str, dict[str, Any]] = {}
    measures: list[Measure] = []
    spans = {cost.name: ("costs", HEADINGS[cost.key]) for cost in costs}
    best: list[str | None] = []
    for name in ordered:
        head = heads[name] + f" {MIXED_MARK}" * (name in mixed)
        accuracy, sd, macro = f"{head}: accuracy %", f"{head}: SD %", f"{head}: macro_f1 %"
        of: dict[str, list[Result]] = {}
        for r in protocols[name]:
            of.setdefault(r.system, []).append(r)
        for system, scores in people[name].iterrows():
            seeds = of[str(system)]
            row = rows.setdefault(str(system), {"system": str(system)})
            row |= {accuracy: scores.mean(), sd: scores.std(ddof=1), macro: mean(r["macro_f1"] for r in seeds)}
            if name == ordered[0]:
                row |= {key: mean(r.get(key, nan) for r in seeds) for key in (c.source for c in costs)}
        if "accuracy" in asked:
            compared = [str(system) for system in people[name].index if not str(system).endswith(MARK)]
            measures.append(Measure(accuracy, head, (accuracy, sd), join=" ± "))
            spans[head] = head, "accuracy"
            best.append(compared[0] if len(compared) > 1 else None)
        if "macro_f1" in asked:
            measures.append(percent(macro, f"{head}, macro-F1"))
            spans[f"{head}, macro-F1"] = head, "F1"
            best.append(None)
    notes = sentences(
        *("bench.reports", "sentences", "paper_notes"),
        synthetic="(synthetic)" in data[0],
        protocols=ordered,
        asked=asked,
        costs=heads[ordered[0]] + f" {MIXED_MARK}" * (ordered[0] in mixed) if costs else "",
        mixed=f"{MIXED_MARK} {MIXED}" if mixed else "",
        notes=[*dict.fromkeys(note.rstrip(".") for system in rows for note in notes_on(system, data[0]))],
    )
    places = [None, *(None if system is None else [*rows].index(system) for system in best), *([None] * len(costs))]
    table = Table([text("system"), *measures, *costs], [*rows.values()])
    return Paper(data, table, places, notes, spans if {*SCORES} <= {*asked} else {})


def sheet(made: Sequence[Paper]) -> pd.DataFrame:
    """The numbers of all tables, for a CSV file."""
    parts = []
    for paper in made:
        mixed = [note for note in paper.notes if note.startswith(MIXED_MARK)]
        notes = [" ".join([*mixed, *notes_on(row["system"], paper.data[0])]) for row in paper.table.rows]
        table = paper.table.frame().rename(columns=unit_headings(c for c in paper.table.columns if isinstance(c, Cost)))
        parts.append(table.assign(data=paper.data[0], subset=paper.data[1], note=notes))
    every = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
    head = ["data", "subset", "system"]
    return every.reindex(columns=[*head, *every.columns.difference([*head, "note"], sort=False), "note"])
