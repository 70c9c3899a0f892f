"""The command ``bench report``: stored runs as a page."""

from __future__ import annotations

from pathlib import Path

from bench.grammar.options import (
    START,
    STORED_OPTIONS,
    Command,
    Option,
    cost_limits,
    key_options,
    parse_arguments,
    typed_settings,
)
from bench.values.result import format_count

COMMAND = Command(
    START,
    "write the verdict, all runs and published numbers to one page",
    "Writes index.html, which loads no other file. It shows the verdict of bench choose within the budgets, "
    "accuracy against each cost, all runs with their commands, published numbers, figures and paired statistics. "
    "The folder also has comparison.md, comparison.tex (booktabs), CSV tables, and figures as SVG. "
    "paper.tex and paper.csv have systems as rows and protocols side by side. The keys of bench run, run= and "
    "latest=yes select the stored runs. bundle= also writes a zip file with the page, its tables, the commands, the "
    "predictions and the digests of the corpora. from= makes the page again from this file, without the store and "
    "without the corpus.",
    "bench report max_flash=64kB max_decision=500ms\n"
    "bench report data=haart protocol=loso,challenge,kfold latest=yes paper=accuracy,flash\n"
    "bench report data=haart bundle=paper.zip\n"
    "bench report from=paper.zip",
    options=(
        *STORED_OPTIONS,
        Option("out", "text", "report", "folder for the page"),
        Option(
            "paper",
            "text",
            "accuracy",
            "columns of paper.tex and paper.csv: accuracy and macro_f1 under each protocol; fit, predict and flash",
        ),
        Option(
            "history",
            "yes",
            False,
            "yes: also accuracy, size and time of each system over git revisions, and steps",
        ),
        Option(
            "against", "text", "", "system that p values compare with; default the best of your own"
        ),
        Option("bundle", "text", "", "zip file for the report and everything behind it"),
        Option(
            "from",
            "text",
            "",
            "bundle to read instead of the store, with the options that it was made with",
        ),
    ),
    budgets="captures",
)

PLACES = ("out", "bundle", "from")  # keys of files and folders, which a bundle does not keep


def command(arguments: list[str]) -> int:
    """Write the verdict on the tracked runs as a page, with its tables and figures."""
    from bench.commands.printing import print_next_commands
    from bench.reading.runs import load_clean_runs, load_results, parse_selection, select_or_fail
    from bench.reports.bundle import Bundle, write_bundle
    from bench.reports.latex import parse_columns
    from bench.store.client import connect

    values = parse_arguments(arguments, key_options("report"))
    source = Bundle(Path(values["from"])) if "from" in values else None
    values = {**(source.options if source else {}), **values}
    given = typed_settings("report", values)
    asked = parse_selection(values)
    paper = parse_columns(given["paper"])
    from bench.reports.page import (
        write_report,  # loads all plotting: wrong arguments need not wait for it
    )

    out, store = Path(given["out"]), source or connect()
    how = (cost_limits(given), given["against"])
    if given["bundle"]:
        kept = select_or_fail(load_results(store, asked), asked)
        older = load_clean_runs(store, asked) if given["history"] else []
        options = {key: value for key, value in values.items() if key not in (*asked, *PLACES)}
        with write_bundle(
            Path(given["bundle"]), {r["run_id"]: r for r in [*older, *kept]}.values(), options
        ) as made:
            paths = write_report(made, out, *how, {}, paper, given["history"])
            made.add_report(out, paths)
    else:
        paths = write_report(store, out, *how, asked, paper, given["history"])
    counts = {end: sum(path.suffix == end for path in paths) for end in (".csv", ".svg")}
    page = out / "index.html"
    what = "the selected runs" if asked else "all runs"
    beside = (
        f"{format_count(counts['.csv'], 'CSV file')} and {format_count(counts['.svg'], 'figure')}"
    )
    print(f"{page}: {what}; in the same folder .md, .tex, {beside}")
    print(f"open: {page.resolve().as_uri()}")
    if given["bundle"]:
        print(
            f"{given['bundle']}: the report, its runs and predictions; bench report from=FILE makes the page again"
        )
    print_next_commands("bench ui")
    return 0
