"""The commands that show what is tracked: ``bench report`` and ``bench ui``."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from bench.commands.printing import then
from bench.errors import InputError
from bench.outcomes.store import connect, store_uri
from bench.plan.arguments import parse
from bench.quantities import BUDGETS, quantity

NAME, WIDE = "attributes.`Run Name`", 300  # pixels, instead of 190: kind, system, data and protocol fit
COLUMNS = {  # of MLflow's table of runs, and their widths in pixels
    "metrics.`accuracy`": 80,
    "metrics.`accuracy_low`": 100,
    "metrics.`accuracy_high`": 100,
    "metrics.`flash_bytes`": 85,
    "metrics.`ram_bytes`": 90,
    "metrics.`predict_ms_p50`": 90,
    "metrics.`macro_f1`": 90,
    "params.`data`": 80,
    "params.`where`": 120,
    "params.`protocol`": 90,
}
VIEW = {
    "selectedColumns": [*COLUMNS],
    "columnOrder": [NAME, *COLUMNS],
    "columnWidths": {NAME: WIDE, **COLUMNS},
    "searchFilter": "tags.`touchbench.cell` LIKE '%'",  # runs without their folds
}


def report(arguments: list[str]) -> int:
    """Write the verdict on the tracked runs as a page, with its tables and figures.

    Raises:
        InputError: something in the arguments cannot be used, or the folder cannot be written.
    """
    values = parse(arguments, {"out", *BUDGETS})
    budgets = {BUDGETS[key]: quantity(key, values[key]) for key in BUDGETS if key in values}
    from reports.page import write_report  # loads all plotting: wrong arguments need not wait for it

    out = Path(values.get("out", "report"))
    paths = write_report(connect(), out, budgets)
    counts = {end: sum(path.suffix == end for path in paths) for end in (".csv", ".png")}
    page = out / "index.html"
    print(f"{page}: all runs; beside it .md and .tex, {counts['.csv']} CSV files, {counts['.png']} figures")
    print(f"open: {page.resolve().as_uri()}")
    then("bench ui")
    return 0


def ui(arguments: list[str]) -> int:
    """Become MLflow's own server on this folder's store, for this machine only.

    Raises:
        InputError: a port that is not a number, or a store that cannot be opened.
    """
    port = parse(arguments, {"port"}).get("port", "5000")
    if not re.fullmatch("[0-9]{1,5}", port) or not 0 < int(port) < 65536:
        raise InputError(f"port={port[:60]}: give a number from 1 to 65535")
    store = connect()
    shown = store.keep_view("touchbench", VIEW)
    # MLflow's front page is about language models; this one is the table of runs.
    page = f"http://127.0.0.1:{port}/#/experiments/{store.experiment_id}/runs?workflowType=machine_learning&{shown}"
    print(f"{page}\nopen it in a browser: accuracy, interval and sizes of all runs; Ctrl-C ends it", flush=True)
    command = [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", store_uri(), "--port", port]
    os.execv(sys.executable, [*command, "--host", "127.0.0.1"])
