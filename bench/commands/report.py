"""The command ``bench report``: stored runs as a page."""

from __future__ import annotations

from pathlib import Path

from bench.comparable import several
from bench.option import Option
from bench.options import START, STORED, Command, keys, limits_of, parse, settings

COMMAND = Command(
    START,
    "write the verdict, all runs and published numbers to one page",
    "Writes index.html, which loads no other file. It shows the verdict of bench choose within the budgets, "
    "accuracy against each cost, all runs with their commands, published numbers, figures and paired statistics. "
    "The folder also has comparison.md, comparison.tex (booktabs), CSV tables, and figures as SVG. "
    "paper.tex and paper.csv have systems as rows and protocols side by side. The keys of bench run, run= and "
    "latest=yes select the stored runs.",
    "bench report max_flash=64kB max_decision=500ms\n"
    "bench report data=haart protocol=loso,challenge,kfold latest=yes paper=accuracy,flash",
    options=(
        *STORED,
        Option("out", "text", "report", "folder for the page"),
        Option(
            "paper",
            "text",
            "accuracy",
            "columns of paper.tex and paper.csv: accuracy and macro_f1 under each protocol; fit, predict and flash",
        ),
        Option(
            "history", "yes", False, "yes: also accuracy, size and time of each system over git revisions, and steps"
        ),
        Option("against", "text", "", "system that p values compare with; default the best of your own"),
    ),
    budgets="captures",
)


def command(arguments: list[str]) -> int:
    """Write the verdict on the tracked runs as a page, with its tables and figures."""
    from bench.commands.printing import then
    from bench.outcomes.runs import asked_of
    from bench.reports.latex import columns_of
    from bench.store import connect

    values = parse(arguments, keys("report"))
    given = settings("report", values)
    asked = asked_of(values)
    paper = columns_of(given["paper"])
    from bench.reports.page import write_report  # loads all plotting: wrong arguments need not wait for it

    out = Path(given["out"])
    paths = write_report(connect(), out, limits_of(given), given["against"], asked, paper, given["history"])
    counts = {end: sum(path.suffix == end for path in paths) for end in (".csv", ".svg")}
    page = out / "index.html"
    what = "the selected runs" if asked else "all runs"
    beside = f"{several(counts['.csv'], 'CSV file')} and {several(counts['.svg'], 'figure')}"
    print(f"{page}: {what}; in the same folder .md, .tex, {beside}")
    print(f"open: {page.resolve().as_uri()}")
    then("bench ui")
    return 0
