"""The command ``bench report``: write stored runs as a page."""

from __future__ import annotations

from pathlib import Path

from bench.commands.printing import print_lines, print_next_commands
from bench.grammar.options import cost_limits, typed_settings
from bench.ground.typed import Values
from bench.reading.runs import load_clean_runs, load_results, parse_selection, select_or_fail
from bench.reports.bundle import Bundle, find_own_files, write_bundle
from bench.reports.latex import parse_columns
from bench.reports.own_numbers import load_numbers
from bench.reports.page import write_report
from bench.store.client import connect
from bench.values.result import format_count

FILE_KEYS = ("out", "bundle", "from", "published")  # a bundle does not keep them


def command(values: Values) -> int:
    """Write the page of stored runs, with its tables and figures."""
    source = Bundle(Path(str(values["from"]))) if "from" in values else None
    values = {**(source.options if source else {}), **values}
    settings = typed_settings("report", values)
    selection = parse_selection(values)
    paper, history = parse_columns(settings["paper"]), settings["history"]
    out, store = Path(settings["out"]), source or connect()
    limits = cost_limits(settings), settings["against"]
    own = Path(settings["published"]) if settings["published"] else None
    numbers = source.numbers if source and own is None else load_numbers(own)
    if settings["bundle"]:
        results = select_or_fail(load_results(store, selection), selection)
        results = [*(load_clean_runs(store, selection) if history else []), *results]
        runs = {result["run_id"]: result for result in results}.values()
        options = {k: v for k, v in values.items() if k not in (*selection, *FILE_KEYS)}
        code = source.own_files if source else find_own_files(runs, Path())
        with write_bundle(Path(settings["bundle"]), runs, options, numbers, code) as bundle:
            paths = write_report(bundle, out, *limits, {}, paper, history, numbers)
            bundle.add_report(out, paths)
    else:
        paths = write_report(store, out, *limits, selection, paper, history, numbers)
    tables = format_count(sum(path.suffix == ".csv" for path in paths), "CSV file")
    figures = format_count(sum(path.suffix == ".svg" for path in paths), "figure")
    page = out / "index.html"
    print(
        f"{page}: {'the selected runs' if selection else 'all runs'}; in the same folder .md, "
        f".tex, {tables} and {figures}"
    )
    print(f"open: {page.resolve().as_uri()}")
    if settings["bundle"]:
        print(
            f"{settings['bundle']}: the report, its runs and predictions; bench report from=FILE "
            "makes the page again"
        )
        print_lines(*(f"not in the bundle: {each}" for each in code.missing))
    print_next_commands("bench ui")
    return 0
