"""How long ``bench report`` takes on a store of many runs, which is made up for it.

Systems with five seeds in four groups (31 and 10 subjects, two of them synthetic), with a child run for every fold.
One run a group is stored by the MLflow store, the others are copies of it in SQL with other names, seeds and scores:
the store would take an hour for them. Every run has all its artifacts.

    python benchmarks/bench_report.py [runs]
"""

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np

from bench.outcomes.store import connect
from bench.outcomes.tables import read_table, write_table
from tests.reports.store import made_up, tracked_run

GROUPS = [("cost", 31, 14), ("haart", 10, 7), ("synth", 31, 14), ("synth", 10, 7)]
TABLES = ("tags", "params", "metrics", "latest_metrics")
REPORT = "import sys; from bench.cli import main; sys.exit(main(['report']))"


def copy(db: sqlite3.Connection, source: str, run: dict[str, str], score: float = 1.0, cost: float = 1.0) -> str:
    """A run like another one, with some tags changed, and scores and costs times a number."""
    name = uuid.uuid4().hex
    for table, key in (("runs", "run_uuid"), *((t, "run_uuid") for t in TABLES)):
        rows = db.execute(f"select * from {table} where {key} = ?", [source])
        columns = [c[0] for c in rows.description]
        changed = []
        for row in map(lambda r: dict(zip(columns, r, strict=True)), rows.fetchall()):
            row[key] = name
            if table == "runs":
                row["artifact_uri"] = row["artifact_uri"].replace(source, name)
            if table == "tags" and row["key"] in run:
                row["value"] = run[row["key"]]
            if table.endswith("metrics") and not row["key"].startswith(("folds", "captures", "subjects", "windows")):
                row["value"] *= score if "accuracy" in row["key"] or "macro" in row["key"] else cost
            changed.append(list(row.values()))
        db.executemany(f"insert into {table} values ({','.join('?' * len(columns))})", changed)
    return name


def fill(runs: int, groups: Sequence[tuple[str, int, int]] = GROUPS) -> None:
    """A store of that many runs in the working folder, as many of each group: data, subjects and gestures."""
    store = connect()
    rng = np.random.default_rng(0)
    each = runs // len(groups)
    templates = []
    for data, subjects, classes in groups:
        gestures = [f"gesture{i}" for i in range(classes)]
        table = made_up(subjects, 6, 0.6, gestures=gestures)
        real = data != "synth"
        name = tracked_run(
            store,
            "system0",
            table,
            data=data,
            synthetic=str(not real).lower(),
            history=[2.0, 1.5, 1.2],
            features="raw frames",
        )
        templates.append((name, Path(store.run(name).info.artifact_uri)))
    with sqlite3.connect("mlflow.db") as db:
        for source, folder in templates:
            asked = "select run_uuid from tags where key = 'mlflow.parentRunId' and value = ?"
            children = [r[0] for r in db.execute(asked, [source])]
            for i in range(1, each):
                level = float(rng.uniform(0.6, 1.3))
                cost = float(10 ** rng.uniform(-1, 1))
                name = copy(db, source, {"system": f"system{i // 5}", "seed": str(i % 5)}, level, cost)
                target = folder.parents[1] / name / "artifacts"
                shutil.copytree(folder, target, copy_function=os.link)
                people = read_table(lambda file, folder=folder: folder / file, "per_subject")
                moved = (people["accuracy"] * level * rng.uniform(0.9, 1.1, len(people))).clip(upper=1.0)
                (target / "per_subject.parquet").unlink()
                write_table(people.assign(accuracy=moved), target / "per_subject.parquet")
                for child in children:
                    copy(db, child, {"mlflow.parentRunId": name})
        assert (
            db.execute("select count(*) from tags where key = 'touchbench.kind' and value = 'cell'").fetchone()[0]
            == runs
        )


def main(runs: int = 2000) -> None:
    """Print wall and CPU seconds of the command in a new process, and what else kept the machine busy."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        started = time.perf_counter()
        fill(runs)
        print(f"{runs} runs made up in {time.perf_counter() - started:.0f} s", flush=True)
        paths = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
        started, before = time.perf_counter(), os.times()
        subprocess.run([sys.executable, "-c", REPORT], check=True, capture_output=True, env=paths)
        wall, after = time.perf_counter() - started, os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        size = Path("report/index.html").stat().st_size / 1e6
        load = os.getloadavg()[0]
        print(
            f"report: {wall:.1f} s, of which {cpu:.1f} s computing; load {load:.1f} on {os.cpu_count()} cores; "
            f"index.html {size:.1f} MB"
        )
        os.chdir("/")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
