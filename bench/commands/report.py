"""The commands that show what is tracked: ``bench report`` and ``bench ui``."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from bench.errors import InputError
from bench.outcomes.store import connect, store_uri
from bench.plan.arguments import parse
from bench.quantities import BUDGETS, quantity


def report(arguments: list[str]) -> int:
    """Write the verdict on the tracked runs as a page, with its tables and figures.

    Raises:
        InputError: something in the arguments cannot be used, or the folder cannot be written.
    """
    values = parse(arguments, {"out", *BUDGETS})
    budgets = {BUDGETS[key]: quantity(key, values[key]) for key in BUDGETS if key in values}
    from reports.page import write_report  # loads all plotting: wrong arguments need not wait for it

    for path in write_report(connect(), Path(values.get("out", "report")), budgets):
        print(path)
    return 0


def ui(arguments: list[str]) -> int:
    """Become MLflow's own server on this folder's store, for this machine only.

    Raises:
        InputError: a port that is not a number, or a store that cannot be opened.
    """
    port = parse(arguments, {"port"}).get("port", "5000")
    if not re.fullmatch("[0-9]{1,5}", port) or not 0 < int(port) < 65536:
        raise InputError(f"port={port[:60]}: give a number from 1 to 65535")
    experiment = connect().experiment_id
    # MLflow's front page is about language models; this one is the table of runs.
    print(f"http://127.0.0.1:{port}/#/experiments/{experiment}/runs?workflowType=machine_learning", flush=True)
    command = [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", store_uri(), "--port", port]
    os.execv(sys.executable, [*command, "--host", "127.0.0.1"])
