"""Tables in LaTeX, with booktabs: one for each set of comparable rows, and systems by protocols."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from math import nan
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError, suggest_names
from bench.grammar.help import define_classifiers
from bench.reports.comparison import protocol_precedence, row_context, short_name_notes
from bench.reports.notes import busy_machine_notes
from bench.values import few
from bench.values.columns import run_columns, unit_headings
from bench.values.measures import (
    UNKNOWN,
    Cost,
    Measure,
    format_p_value,
    text_measure,
    to_percent,
    value_or_none,
)
from bench.values.result import BATCH_MARK, MIXED_MARK, MIXED_NOTE, Row, footnotes_of_system
from bench.values.sentences import render_sentences
from bench.values.table import Table

ESCAPED = {sign: rf"\{sign}" for sign in "&%$#_{}"} | {
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
    "\N{MULTIPLICATION SIGN}": r"$\times$",
    BATCH_MARK: r"$^\dagger$",
    MIXED_MARK: r"$^\ddagger$",
}
LATIN = "\N{LATIN SMALL LETTER LONG S}"  # the last letter that pdflatex sets
MEAN, SEED_SD, PUBLISHED = "accuracy %", "SD over seeds %", "published %"
SHARES = {  # columns of paper.csv in percent, by the share in a row of `average_seeds`
    "accuracy": MEAN,
    "subject_sd": "SD %",
    "accuracy_low": "low %",
    "accuracy_high": "high %",
    "macro_f1": "macro_f1 %",
    "seed_sd": SEED_SD,
}
SCORES = {  # columns under each protocol
    "accuracy": Measure(MEAN, "accuracy", (MEAN, "SD %"), join=" ± "),
    "interval": Measure("low %", "95 % interval", ("low %", "high %"), join=" to "),
    "p": Measure("p Holm", "p", form=format_p_value),
    "published": text_measure(PUBLISHED, "published"),
    "macro_f1": Measure("macro_f1 %", "F1"),
    "seed_sd": Measure(SEED_SD, "SD of seeds"),
}
HEADINGS = {
    "accuracy": "accuracy",
    "macro_f1": "macro-F1",
    "fit_seconds": "fit s",
    "predict_ms_p50": "ms",
    "flash": "kB",
}
LONG = 32  # letters of a name that fit into one line
NARROW = 4  # columns of a table that fits into one of two columns of a page
COSTS = {"fit": "fit_seconds", "predict": "predict_ms_p50", "flash": "flash"}  # key of each column
# A table no wider than there is room.
FITTED = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{"


@dataclass(frozen=True)
class Paper:
    """The systems on one corpus, subset and target, most accurate under the first protocol first.

    Attributes:
        corpus: corpus and subset in words.
        table: a row per system.
        headings: protocol and heading of each column of the table.
        best: most accurate system of each column; empty for none.
        notes: footnotes.
    """

    corpus: tuple[str, str]
    table: Table
    headings: list[tuple[str, str]]
    best: list[str]
    notes: list[str]


def comparison_latex(rows: Sequence[Row]) -> str:
    """The rows of `bench.reports.comparison.average_seeds`, a table for each comparable set."""
    people: dict[tuple, int] = {}  # by captures
    for row in rows:
        captures = (row["data"], row["subset"])
        people[captures] = max(people.get(captures, 0), int(row["subjects"]))
    parts = [[*part] for _, part in groupby(rows, row_context)]
    tables = [
        _comparison_table(part, i, people[part[0]["data"], part[0]["subset"]])
        for i, part in enumerate(parts, 1)
    ]
    return _join_tables("corpus, subset, protocol and unit", tables)


def papers_latex(papers: Sequence[Paper]) -> str:
    """The tables of a paper; the most accurate system under each protocol is bold."""
    tables = [_paper_table(paper, i) for i, paper in enumerate(papers, 1)]
    return _join_tables("corpus and subset", tables)


def _join_tables(each: str, tables: Sequence[str]) -> str:
    """The tables below a comment on the packages, and on the engine if letters need another one."""
    packages = f"% One table for each {each}. Needs \\usepackage{{booktabs,graphicx}}.\n"
    text = "\n".join([packages, *tables])
    engine = "% Letters beyond Latin: needs lualatex or xelatex, and a font that has them.\n"
    return engine * any(c.isalpha() and c > LATIN for c in text) + text


def escape_latex(words: object) -> str:
    """Text that LaTeX sets as it is."""
    return "".join(ESCAPED.get(c, c) for c in " ".join(str(words).split()) if c.isprintable())


def _comparison_table(rows: Sequence[Row], number: int, people: int) -> str:
    """One table of comparable rows, its best accuracy in bold; ``people`` have such captures."""
    columns = [text_measure("system", source=_row_name), *run_columns("latex")]
    if len({row["seeds"] for row in rows}) > 1:
        columns.append(Measure("seeds", form=".0f"))
    table = Table(columns, rows)
    headings = {m.name: HEADINGS.get(m.key, m.name) for m in table.columns}
    cells = table.to_text_frame().rename(columns=headings)
    compared = [nan if row["system"].endswith(BATCH_MARK) else row["accuracy"] for row in rows]
    best = np.array(compared) == np.fmax.reduce(compared)  # nothing equals NaN
    full_names = [row.get("full_name", row["system"]) for row in rows]
    classifiers, comments = _classifier_sentences(full_names)
    caption = _comparison_caption(rows, classifiers, people)
    bold = {HEADINGS["accuracy"]: best & (len(rows) > 1)}
    return comments + _table_latex(cells, bold, caption, f"{number}")


def _paper_table(paper: Paper, number: int) -> str:
    systems = pd.Index([str(row["system"]) for row in paper.table.rows])
    headings = pd.MultiIndex.from_tuples(paper.headings)
    cells = paper.table.to_text_frame().set_axis(headings, axis=1)
    best = {
        heading: systems == name for heading, name in zip(paper.headings, paper.best, strict=True)
    }
    classifiers, comments = _classifier_sentences(row["full_name"] for row in paper.table.rows)
    caption = render_sentences(
        *("bench.reports", "sentences", "paper"),
        data=paper.corpus[0],
        subset=paper.corpus[1],
        notes=paper.notes,
        classifiers=classifiers,
    )
    return comments + _table_latex(cells, best, escape_latex(" ".join(caption)), f"paper-{number}")


def _classifier_sentences(systems: Iterable[str]) -> tuple[list[str], str]:
    """A sentence for each classifier without parameters; with them as comments of LaTeX."""
    definitions = define_classifiers(systems)
    comments = "".join(f"% {line}\n" for line in definitions)
    return [re.sub(r" \(\S+=[^)]*\)\.$", ".", line) for line in definitions], comments


def _table_latex(
    cells: pd.DataFrame, bold: Mapping[Any, np.ndarray], caption: str, label: str
) -> str:
    """A table of text, no wider than its place on a page; ``bold`` marks cells of some columns."""
    text = cells.map(escape_latex).replace("-", "--")
    for column, mask in bold.items():
        text[column] = text[column].mask(mask, r"\textbf{" + text[column] + "}")
    is_long = cells.iloc[:, 0].str.len().max() > LONG
    if is_long:
        names = text.iloc[:, 0].str.replace(r"\_", r"\_\allowbreak{}", regex=False)
        text.isetitem(0, r"\raggedright " + names)
    if text.columns.nlevels > 1:
        text.columns = pd.Index([tuple(map(escape_latex, heading)) for heading in text])
    else:
        text.columns = pd.Index([escape_latex(heading) for heading in text])
    latex = text.style.hide(axis="index").to_latex(
        hrules=True,
        column_format=("p{5cm}" if is_long else "l") + "r" * (len(text.columns) - 1),
        multicol_align="c",
        position_float="centering",
        environment="table*" if is_long or len(text.columns) > NARROW else "table",
        caption=caption,
        label=f"tab:touchbench-{label}",
    )
    latex = latex.replace(r"\begin{tabular}", FITTED + r"\begin{tabular}")
    return latex.replace(r"\end{tabular}", r"\end{tabular}}")


def _comparison_caption(rows: Sequence[Row], classifiers: Sequence[str], people: int) -> str:
    """Data, subset, protocol, unit, captures and subjects, and the meaning of the columns."""
    first, data = rows[0], rows[0]["data"]
    corpus = re.search(r"corpus [0-9a-f]+$", first["group"])
    subset = "all captures" if first["subset"] == "all" else f"captures with {first['subset']}"

    def values(name: str) -> list[Any]:
        return [value for row in rows if (value := value_or_none(row.get(name))) is not None]

    subjects = sorted({int(n) for n in values("subjects")})
    notes = [note for row in rows for note in short_name_notes(row)]
    notes += [note.rstrip(".") for row in rows for note in footnotes_of_system(row["system"], data)]
    words = render_sentences(
        *("bench.reports", "sentences", "caption"),
        where=f"{data}{f' ({corpus[0]})' if corpus else ''}, {subset}, {first['protocol']}",
        captures=_number_range(values("captures")),
        subjects=_number_range(subjects) + f" of {people}" * (people > max(subjects)),
        seeds=_seed_words({int(row["seeds"]) for row in rows}),
        synthetic="(synthetic)" in data,
        unit=first["unit"],
        interval=bool(values("accuracy_low")),
        few=[few.too_few_sentence(n) for n in subjects if n < few.FEWEST_FOR_TEST],
        timed=bool(values("predict_ms_p50")),
        busy=[*dict.fromkeys(note for row in rows for note in busy_machine_notes(row))],
        against=values("against")[0] if values("p_holm") else "",
        classifiers=classifiers,
        notes=[*dict.fromkeys(notes)],
    )
    return escape_latex(" ".join(words)).replace(r"95 \%", r"95\,\%")


def _number_range(values: Sequence[float]) -> str:
    """A number that all rows share, or the range of different ones."""
    if not values:
        return "an unknown number of"
    return " to ".join(dict.fromkeys(f"{end:.0f}" for end in (min(values), max(values))))


def _row_name(row: Row) -> str:
    """The name of a run, with its failed folds and the way in which windows are combined."""
    done, _, folds = str(row.get("folds", "")).partition("/")
    finished = f"{row['folds']} folds" if folds and done != folds else ""
    return ", ".join(filter(None, [str(row["name"]), finished, row.get("combined")]))


def parse_columns(value: str | Iterable[str]) -> list[str]:
    """The columns that ``paper=`` names: those of `SCORES` and `COSTS`.

    Raises:
        InputError: a name is none of these, or there is no score.
    """
    names = value.split(",") if isinstance(value, str) else [*value]
    columns = [*SCORES, *COSTS]
    for name in names:
        if name not in columns:
            raise InputError(f"paper={name}: {suggest_names(name, columns)}")
    if not {*SCORES} & {*names}:
        raise InputError(f"paper={','.join(names)} has no score; add accuracy or macro_f1")
    return [name for name in columns if name in names]


def make_papers(rows: Iterable[Row], columns: Sequence[str]) -> list[Paper]:
    """A table for each corpus, subset and target, of rows of `average_seeds` on whole captures.

    Runs with failed folds are left out.
    """
    corpora: dict[tuple[str, str, str], dict[str, list[Row]]] = {}
    for row in rows:
        run = row["result"]
        if run.is_complete and row["unit"] == "capture" and row.get("combined") != "majority vote":
            data, subset, protocol = run.context
            protocols = corpora.setdefault((data, subset, str(run["corpus_digest"])), {})
            protocols.setdefault(protocol, []).append(row)
    versions = Counter(key[:2] for key in corpora)
    papers = []
    for (data, subset, digest), protocols in corpora.items():
        version = f" (corpus {digest[:8]})" * (versions[data, subset] > 1)
        papers.append(_make_paper((data + version, subset), protocols, columns))
    return papers


def _make_paper(
    corpus: tuple[str, str], protocols: Mapping[str, Sequence[Row]], columns: Sequence[str]
) -> Paper:
    """The table of averaged rows on the same captures, by protocol."""
    runs = {name: [row["result"] for row in each] for name, each in protocols.items()}
    mixed = {name for name, each in runs.items() if any(r.mixes_subjects for r in each)}
    ordered = sorted(protocols, key=lambda name: (protocol_precedence(runs[name]), name))
    costs = [m for m in run_columns() if m.key in [COSTS.get(name) for name in columns]]
    shown = [SCORES[name] for name in columns if name in SCORES]
    rows: dict[str, dict[str, Any]] = {}
    measures, headings, best = [text_measure("system")], [("", "system")], [""]
    counts: dict[str, list[int]] = {}  # of seeds
    elsewhere: dict[str, list[str]] = {}  # systems whose costs are those under another protocol
    titles = _protocol_titles(ordered, mixed)
    for name, title in titles.items():
        for row in protocols[name]:
            system = str(row["system"])
            if system not in rows:
                of_costs = {cost.source_name: row.get(cost.source_name) for cost in costs}
                full_name = row.get("full_name", system)
                rows[system] = {"system": system, "full_name": full_name, **of_costs}
                if name != ordered[0]:
                    elsewhere.setdefault(title, []).append(system)
            numbers: dict[str, Any] = {
                column: to_percent(row.get(share, nan)) for share, column in SHARES.items()
            }
            numbers |= {"p Holm": row.get("p_holm"), PUBLISHED: _numbers_only(row.get("published"))}
            rows[system] |= {f"{title}: {column}": value for column, value in numbers.items()}
            counts.setdefault(system, []).append(row["seeds"])
        names = [str(row["system"]) for row in protocols[name]]
        compared = [system for system in names if not system.endswith(BATCH_MARK)]
        for measure in shown:
            column = _measure_under(title, measure)
            if not any(column.as_text(row) != UNKNOWN for row in rows.values()):
                continue  # such as p of three people
            measures.append(column)
            headings.append((title, measure.name))
            is_bold = measure.key == MEAN and len(compared) > 1
            best.append(compared[0] if is_bold else "")
    seeds = {count for each in counts.values() for count in each}
    if len(seeds) > 1:
        for system, each in counts.items():
            rows[system]["seeds"] = _number_range(each)
        measures.append(text_measure("seeds"))
        headings.append(("", "seeds"))
    headings += [("costs", HEADINGS[cost.key]) for cost in costs]
    best += [""] * (len(headings) - len(best))
    every = [row for name in ordered for row in protocols[name]]
    tested = {row["protocol"]: row["against"] for row in every if row.get("against")}
    footnotes = [note for row in rows.values() for note in short_name_notes(row)]
    footnotes += [note.rstrip(".") for s in rows for note in footnotes_of_system(s, corpus[0])]
    notes = render_sentences(
        *("bench.reports", "sentences", "paper_notes"),
        synthetic="(synthetic)" in corpus[0],
        protocols=_describe_protocols(protocols, ordered),
        columns=columns,
        seeds=_seed_words(seeds),
        costs=titles[ordered[0]] if costs else "",
        elsewhere=elsewhere if costs else {},
        against=_words_by_protocol(tested) if "p" in columns else "",
        published=[
            f"{row['system']} under {row['protocol']}: {row['published']}"
            for row in every
            if row.get("published") and "published" in columns
        ],
        mixed=f"{MIXED_MARK} {MIXED_NOTE}" if mixed else "",
        notes=[*dict.fromkeys(footnotes)],
    )
    return Paper(corpus, Table([*measures, *costs], [*rows.values()]), headings, best, notes)


def _measure_under(title: str, measure: Measure) -> Measure:
    """A column of `SCORES` under a protocol."""
    sources = measure.source if isinstance(measure.source, tuple) else (measure.key,)
    names = tuple(f"{title}: {name}" for name in sources)
    source = names if isinstance(measure.source, tuple) else names[0]
    key, heading = f"{title}: {measure.key}", f"{title}: {measure.name}"
    return replace(measure, key=key, heading=heading, source=source)


def _numbers_only(published: str | None) -> str | None:
    """Published numbers without their units and sources."""
    return published and re.sub(r" \(.*?\)(?=;|$)", "", published)


def _seed_words(numbers: set[int]) -> str:
    """Say over how many seeds the numbers of a table are means; empty for one of each system."""
    if numbers == {1}:
        return ""
    return f"{max(numbers)} seeds" if len(numbers) == 1 else "the seeds of each system"


def _words_by_protocol(words: Mapping[str, str]) -> str:
    """Words that all protocols share, or those of each."""
    if len({*words.values()}) < 2:
        return next(iter(words.values()), "")
    return ", ".join(f"{text} ({protocol})" for protocol, text in words.items())


def _describe_protocols(
    protocols: Mapping[str, Sequence[Row]], ordered: Sequence[str]
) -> list[str]:
    """Each protocol, with its number of tested people where another one tests more."""
    people = {name: int(max(row["subjects"] for row in protocols[name])) for name in ordered}
    everyone = max(people.values())
    return [
        f"{name}, tests {people[name]} of {everyone} people" if people[name] < everyone else name
        for name in ordered
    ]


def _protocol_titles(names: Sequence[str], mixed: set[str]) -> dict[str, str]:
    """The heading of each protocol: short if that tells them apart, marked if it mixes subjects."""
    short = [re.split(r"[,(]", name)[0].strip() for name in names]
    titles = short if len({*short}) == len(short) else names
    return {
        name: title + f" {MIXED_MARK}" * (name in mixed)
        for name, title in zip(names, titles, strict=True)
    }


def papers_table(papers: Sequence[Paper]) -> pd.DataFrame:
    """The numbers of all tables, for a CSV file."""
    parts = []
    for paper in papers:
        mixed = [note for note in paper.notes if note.startswith(MIXED_MARK)]
        notes = [
            " ".join([*mixed, *footnotes_of_system(row["system"], paper.corpus[0])])
            for row in paper.table.rows
        ]
        units = unit_headings(c for c in paper.table.columns if isinstance(c, Cost))
        table = paper.table.to_frame().rename(columns=units)
        parts.append(table.assign(data=paper.corpus[0], subset=paper.corpus[1], note=notes))
    table = pd.concat(parts, ignore_index=True)
    first = ["data", "subset", "system"]
    others = table.columns.difference([*first, "note"], sort=False)
    return table[[*first, *others, "note"]]
