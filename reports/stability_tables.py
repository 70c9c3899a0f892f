"""Files of a run under faults or with fewer training subjects: ``stability.md``, CSV tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import kendalltau

from bench.errors import InputError
from bench.ground.words import CLEAN
from bench.reports.contexts import noted
from bench.reports.curves import curves, heat_map
from bench.reports.figures import write_svg
from bench.reports.layout import markdown, slug
from bench.values import scores
from bench.values.measures import Measure, percent, text
from bench.values.result import Result, notes_on
from bench.values.sentences import sentences
from bench.values.stability import ALPHA, joined, learning, unharmed
from bench.values.table import Table, of_text, rows_of, write_sheet

TOP = 10  # rows of a table
FILES = {
    "faults": "faults",
    "half_margins": "margins",
    "conditions": "conditions",
    "slices": "slices",
}
FAULTS = (
    "Accuracy in percent at severities 1 to 5, mean loss in points, and the lowest severity at which accuracy is "
    "significantly below that of the system."
)
SLICES = (
    text("slice", "group"),
    Measure("right", read=lambda r: f"{r['right']} of {r['captures']}"),
    Measure("subjects", form=".0f"),
    percent("accuracy"),
    percent("gap", "below system by"),
    Measure("p", form=".2g"),
    Measure("p_corrected", "corrected p", form=".2g"),
)


def write_all(results: Sequence[Result], out: Path) -> list[str]:
    """Write the tables and figures of each corpus, subset and protocol; lines that say where.

    Raises:
        InputError: the folder cannot be written.
    """
    groups: dict[tuple, list[Result]] = {}
    for r in results:
        groups.setdefault(r.comparable, []).append(r)
    lines: dict[Path, str] = {}
    for members in groups.values():
        folder, title = out, ", ".join(members[0].context)
        if len(groups) > 1:
            name = slug(" ".join(members[0].context), 200)
            folder = out / name if out / name not in lines else out / f"{name}-{len(lines) + 1}"
        try:
            write(members, folder)
        except OSError as e:
            raise InputError(
                f"{folder} cannot be written ({e.strerror}); choose another out="
            ) from e
        words = "failing subjects, classes, conditions and faults, with figures"
        lines[folder] = f"{title}: {words}: {folder / 'stability.md'}"
    return [*lines.values()]


def write(results: Sequence[Result], folder: Path) -> None:
    """Write the tables as CSV, ``stability.md``, and the figures as SVG, for results of one context."""
    about = dict(zip(("data", "subset", "protocol"), results[0].context, strict=True))
    tables = {name: joined(results, table) for name, table in FILES.items()}
    tables["learning"] = joined(results, "learning", lambda r: learning(r.tables["labels"]))
    for name, table in (("ranks", ranks(results)), ("seeds", seeds(results))):
        tables[name] = table.assign(**about)[[*about, *table.columns]]
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("stability_*.[ps][nv]g"):  # of an earlier command
        old.unlink()
    for name, table in tables.items():
        write_sheet(noted(table), folder / f"stability_{name}.csv")
    words = markdown(
        "stability.jinja", context=", ".join(results[0].context), sections=[*sections(results)]
    )
    (folder / "stability.md").write_text(words, encoding="utf-8")
    _draw(results, folder)


def _draw(results: Sequence[Result], folder: Path) -> None:
    """Write the losses under faults and the learning curves, where there are any, as SVG."""
    context = ", ".join(results[0].context)
    if len(results[0].tables["faults"]):
        losses = pd.DataFrame(
            {r.method: r.tables["margins"].set_index("fault")["loss"] for r in results}
        ).T
        figure = heat_map(losses, [r["accuracy"] for r in results], context)
        write_svg(figure, folder / "stability_heat_map.svg")
    if any("learning" in r.tables for r in results):
        learned = [
            learning(r.tables["labels"]).rename(columns={"train_subjects": "level"})
            for r in results
        ]
        lines = [
            (i, r.method, curve) for i, (r, curve) in enumerate(zip(results, learned, strict=True))
        ]
        figure = curves("training subjects", lines, title=context)
        write_svg(figure, folder / "stability_training_subjects.svg")


def sections(results: Sequence[Result]) -> Iterator[tuple[str, str, Table | None]]:
    """Heading, remark and table of what is shown to a reader, in percent and points."""
    yield (
        "Clean",
        f"Chance is the share of the most frequent class: {100 * results[0]['chance']:.1f} %.",
        _clean(results),
    )
    under_faults = len(results[0].tables["faults"]) > 0
    if under_faults:
        yield "Worst faults", FAULTS, _worst_faults(results)
    for r in results:
        yield f"Failing groups: {r.method}", *_failing(r)
    if len(results) > 1 and under_faults:
        note = (
            "By mean accuracy over severities; Kendall's tau compares the order with the clean one."
        )
        table = ranks(results).replace({"fault": {CLEAN: "clean"}})
        systems = [
            Measure(name, form="g") for name in table if name not in ("fault", "kendall_tau")
        ]
        tau = Measure("kendall_tau", "Kendall's tau", form=".2f")
        yield "Ranks", note, Table([text("fault"), *systems, tau], rows_of(table))
    if any("learning" in r.tables for r in results):
        yield "Fewer training subjects", "", _learning(results)


def _clean(results: Sequence[Result]) -> Table:
    """Accuracy of the captures as they are, and where it is worst."""
    rows, names = [], {}
    for r in results:
        units = unharmed(r.tables["labels"])
        scored = scores.over_people(units)
        row = {"result": r, "units": len(units), "accuracy": scored["accuracy"]}
        row |= {f"accuracy_{side}": scored[side] for side in ("low", "high")}
        for factor, part in r.tables["conditions"].groupby("factor", sort=False):
            worst = part.loc[part["accuracy"].idxmin()]
            names[f"worst {factor}"] = None
            row[f"worst {factor}"] = f"{worst['value']}: {100 * worst['accuracy']:.1f}"
        rows.append(row)
    columns = [
        text("system", read=lambda row: row["result"].method),
        Measure("units", "captures", form=".0f"),
    ]
    columns += [percent("accuracy", "accuracy [95 %]", ends="accuracy"), *map(text, names)]
    return Table(columns, rows, remarks=[notes_on(r.system, str(r["data"])) for r in results])


def _worst_faults(results: Sequence[Result]) -> Table:
    """Accuracy at each severity of the faults that cost most."""
    rows, severities = [], []
    for r in results:
        slices, margins = (
            r.tables["slices"],
            r.tables["margins"].sort_values("loss", ascending=False).head(TOP),
        )
        by = r.tables["faults"].pivot(index="fault", columns="severity", values="accuracy")
        failing = slices[(slices["kind"] == "fault") & slices["failing"]]
        lowest = failing.groupby("fault")["severity"].min().astype(str)
        severities = severities or [str(s) for s in by.columns]
        for row in rows_of(margins):
            by_severity = dict(zip(severities, by.loc[row["fault"]], strict=True))
            rows.append(row | by_severity | {"method": r.method, "fails": lowest.get(row["fault"])})
    columns = [text("method", "system"), text("fault"), *map(percent, severities), percent("loss")]
    columns += [text("fails", "fails from"), text("where", "half of the margin is lost at")]
    return Table(columns, rows)


def _failing(result: Result) -> tuple[str, Table | None]:
    """How many groups of captures were tested and fail, and the worst of those that fail without a fault."""
    slices = result.tables["slices"]
    tested = slices[slices["tested"]]
    words = sentences(
        *("bench.reports", "sentences", "groups"),
        failing=int(tested["failing"].sum()),
        tested=len(tested),
        under=int((tested["failing"] & (tested["fault"] != "")).sum()),
        level=ALPHA,
        untested=len(slices) - len(tested),
    )
    rows = tested[tested["failing"] & (tested["fault"] == "")].sort_values("gap", ascending=False)
    return words[0], Table(SLICES, rows_of(rows.head(TOP))) if len(rows) else None


def _learning(results: Sequence[Result]) -> Table:
    """Accuracy by number of training subjects."""
    accuracy = percent("accuracy", ends="accuracy")
    shown = {}
    for r in results:
        curve = rows_of(
            learning(r.tables["labels"]).rename(
                columns={"low": "accuracy_low", "high": "accuracy_high"}
            )
        )
        shown[r.method] = {f"{row['train_subjects']:g}": accuracy.of(row) for row in curve}
    return of_text(pd.DataFrame(shown).fillna("-").rename_axis("training subjects").reset_index())


def seeds(results: Sequence[Result]) -> pd.DataFrame:
    """Variation over seeds, a row per system: SD of its clean accuracy, and captures whose label changes."""
    rows = []
    for system in dict.fromkeys(r["system"] for r in results):
        same = [r for r in results if r["system"] == system]
        if len(same) < 2:
            continue
        units = [unharmed(r.tables["labels"]) for r in same]
        labels = [each.set_index(["fold", "capture"])["predicted"].sort_index() for each in units]
        both = pd.concat(labels, axis=1, join="inner")
        changed = int((both.nunique(axis=1) > 1).sum())
        accuracy = np.array([r["accuracy"] for r in same])
        spread = accuracy.mean(), accuracy.std(ddof=1), accuracy.min(), accuracy.max()
        rows.append(
            [
                system,
                ", ".join(r["seed"] for r in same),
                *spread,
                len(both),
                changed,
                changed / len(both),
            ]
        )
    names = [
        "system",
        "seeds",
        "accuracy",
        "sd",
        "lowest",
        "highest",
        "captures",
        "changed",
        "share_changed",
    ]
    return pd.DataFrame(rows, columns=names)


def ranks(results: Sequence[Result]) -> pd.DataFrame:
    """Rank of each system (1 is best, ties share) when clean and under each fault, by mean accuracy over severities.

    Seeds of a system are averaged. ``kendall_tau`` compares the order with the clean one: 1 is the same, -1 the
    reverse, NaN for a single system or where all are equal.
    """
    rows = []
    for r in results:
        rows.append((r["system"], CLEAN, r["accuracy"]))
        by_fault = r.tables["faults"].groupby("fault", sort=False)["accuracy"].mean()
        rows += [(r["system"], str(fault), value) for fault, value in by_fault.items()]
    table = pd.DataFrame(rows, columns=["system", "fault", "accuracy"])
    means = table.groupby(["fault", "system"], sort=False)["accuracy"].mean().unstack()
    means = means.reindex(index=table["fault"].unique(), columns=table["system"].unique())
    order = means.rank(axis=1, ascending=False)
    alone = len(means.columns) < 2
    tau = [
        np.nan if alone else kendalltau(means.loc[CLEAN], means.loc[fault]).statistic
        for fault in means.index
    ]
    return order.assign(kendall_tau=tau).rename_axis("fault").reset_index()
