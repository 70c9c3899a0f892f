"""The results of docs/notes/two_corpora.md and of the frozen tasks, by one command that can be left alone.

    python studies/reference.py out=reference jobs=2

runs every command of `PARTS`, in order, in the current folder's store. ``parts=loso,faults`` runs some of them. A
command whose runs are stored takes seconds, so an interrupted script continues when it is started again. A command that
fails is reported at the end, and the others go on. ``out=`` gets the output of each command, ``times.csv`` (a row each
time a command runs), ``tests.csv`` (`other_tests`) and ``systems.csv`` (`side_by_side`). Import both corpora first:

    bench data import haart "HAART DataSet.zip"
    bench data import haart "HAART DataSet.zip" align=yes
    bench data import cuddlebot FOLDER
    bench data import cuddlebot FOLDER crop=8x8 name=cuddlebot-8x8
"""

import shlex
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

import bench
from bench.amounts import convert
from bench.arguments import parse
from bench.corpora.library import imported
from bench.errors import nearest
from bench.outcomes.runs import every_result, frame_of
from bench.outcomes.store import connect
from bench.paired import interval
from bench.registry import classes

CORPORA = ("haart", "cuddlebot")
CLASSIFIERS = "svm,rf,bayes,lda,tree,xgb,et,softmax"
PUBLISHED = (
    "jung2014_bayes,jung2014_svm,wingerden2014_mlp,balli2015_rf,gaus2015_rf,gaus2015_boost,hughes2015_softmax,"
    "ta2015_rf,ta2015_svm,jung2017_bayes,jung2017_tree,jung2017_svm_linear,jung2017_svm_rbf,jung2017_nn"
)
SMALL = "model=lda features=touch model.window=1.0 model.repair=stuck+dead"
BEST = ("model=reflex", SMALL, "model=xgb features=touch", "model=softmax features=touch", "model=touchnet")
SHIPPED = (
    "model=bayes features=jung28",
    "model=jung2017_svm_rbf,ta2015_rf",
    "model=lda features=touch",
    "model=rf features=jung54",
    "model=svm features=jung54",
    "model=xgb features=jung54",
)
WATCH = ("model=reflex", "model=lda features=touch model.window=0.75 model.repair=stuck+dead")
# fewer epochs than published, which take hours
NETWORKS = ("model=cnn85 model.epochs=15", "model=hughes2017_cnn model.epochs=6 model.rate=0.001")
CURVES = "protocol=groupkfold protocol.folds=13 train_subjects=2,4,8,16 faults=none"  # studies/learning.py draws them
CURVED = ("model=lda,softmax,et,xgb features=touch", "model=touchnet")
TESTS = {  # metrics of a kind of run, and their headings
    "under": {"loss": "lost under faults"},
    "after": {f"accuracy_at_{ms}_ms": f"after {ms}" for ms in (500, 1000, 2000)} | {"adaptive_accuracy": "stopped"},
    "shots": {"accuracy": "with shots"},
    "watch": {"touches_found": "touches found", "first_correct": "first correct", "end_correct": "end correct"},
}
NAMED = ["data", "protocol", "system"]
BENCH = [sys.executable, "-c", "import sys; from bench.cli import main; sys.exit(main())"]


def _loso(data: str) -> list[str]:
    run = f"run data={data} protocol=loso"
    return [
        f"{run} model={CLASSIFIERS} features=jung54,touch",
        f"{run} model=svm,bayes,xgb features=jung28",
        f"{run} model=rf features=ta273",
        f"{run} model=lda features=touch model.window=1.0,2.0",
        f"{run} {SMALL}",
        f"{run} model=rocket,reflex,touchnet",
        f"{run} model={PUBLISHED}",
    ]


def _each(command: str, corpora: tuple[str, ...], systems: tuple[str, ...]) -> list[str]:
    return [f"{command} data={data} {system}" for data in corpora for system in systems]


PARTS: dict[str, list[str]] = {
    "loso": [command for data in CORPORA for command in _loso(data)],
    "aligned": _each(
        "run protocol=loso",
        ("haart-aligned",),
        (*BEST[:4], "model=et features=touch", "model=lda features=touch model.window=1.0,2.0"),
    )
    + _each("run protocol=challenge", ("haart", "haart-aligned"), ("model=reflex", SMALL)),
    # the results of the frozen tasks that come with touchbench, as far as no other part has them
    "tasks": _each("run protocol=challenge", ("haart",), SHIPPED)
    + _each("run protocol=personal protocol.shots=3", ("haart",), ("model=lda features=touch", *SHIPPED[3:5]))
    + _each("stream protocol=loso", ("haart",), ("model=lda features=touch", *SHIPPED[3:6], "model=rocket"))
    + _each("stress protocol=loso", ("haart",), ("model=lda features=touch", *SHIPPED[4:6], "model=rocket"))
    + _each(
        "watch protocol=loso",
        ("haart",),
        ("model=xgb features=touch model.window=0.75 model.repair=stuck+dead", NETWORKS[1]),
    ),
    "faults": _each("stress protocol=loso", CORPORA, BEST),
    "early": _each("stream protocol=loso", CORPORA, BEST),
    "personal": _each("run protocol=personal protocol.shots=3", CORPORA, BEST[:4]),
    "continuous": _each("watch protocol=loso", CORPORA, WATCH),
    "transfer": [
        f"run data={data} protocol=transfer protocol.source={source} {system}"
        for one, other in (("haart", "cuddlebot"), ("haart", "cuddlebot-8x8"))
        for data, source in ((one, other), (other, one))
        for system in (*BEST, "model=lda,svm,rf,et features=touch", "model=rocket")
    ],
    "joint": _each("run protocol=loso", ("haart+cuddlebot",), ("model=reflex,rocket", "model=lda,et features=touch")),
    "curves": _each(f"stress {CURVES}", ("haart+cuddlebot",), CURVED),
    "networks": _each("run protocol=loso", CORPORA, NETWORKS),
}


def run_parts(names: list[str], jobs: int, out: Path) -> list[str]:
    """Run the commands of some parts; return those that failed."""
    out.mkdir(parents=True, exist_ok=True)
    times = out / "times.csv"
    done = pd.read_csv(times).to_dict("records") if times.exists() else []
    failed = []
    commands = [(name, number, command) for name in names for number, command in enumerate(PARTS[name], 1)]
    for count, (name, number, command) in enumerate(commands, 1):
        words = [*shlex.split(command), f"jobs={jobs}"]
        print(f"{count}/{len(commands)} {name}: bench {' '.join(words)}", flush=True)
        if words[0] in ("stress", "stream"):
            words.append(f"out={out / name}")
        began = time.perf_counter()
        with (out / f"{name}-{number:03d}.txt").open("w") as output:
            status = subprocess.run([*BENCH, *words], stdout=output, stderr=output).returncode
        done.append({"part": name, "command": command, "seconds": time.perf_counter() - began, "status": status})
        pd.DataFrame(done).to_csv(times, index=False)
        if status:
            failed.append(command)
    return failed


def side_by_side(corpora: tuple[str, ...], rival: str = "reflex") -> pd.DataFrame:
    """Every system of a store that has complete LOSO runs on all corpora: accuracy and difference to one system.

    Args:
        corpora: names of corpora.
        rival: system that the others are compared with.

    Returns:
        A row per system, indexed by name: for each corpus mean accuracy over subjects with its 95 % t-interval, place,
        and paired difference to ``rival`` with its 95 % t-interval, in percent and points.
    """
    tables = [bench.results(data=data, protocol="loso") for data in corpora]
    shared = set.intersection(*(set(table["system"]) for table in tables))
    systems = sorted(shared)
    if rival not in systems:
        raise bench.InputError(f"{rival} has no complete run on each of {', '.join(corpora)}")
    columns = {}
    for data in corpora:
        means = {}
        for system in systems:
            if system == rival:
                continue
            pair = bench.compare(system, rival, data=data, protocol="loso")
            means[system] = pair.accuracy.iloc[:, 0]
            means[rival] = pair.accuracy.iloc[:, 1]
            columns[data, "difference", system] = f"{pair.difference:+.1f} [{pair.low:.1f}, {pair.high:.1f}]"
        mean = pd.Series({system: values.mean() for system, values in means.items()})
        places = mean.rank(ascending=False, method="min")
        for system, values in means.items():
            low, high = interval(values.to_numpy())
            columns[data, "accuracy", system] = f"{values.mean():.1f} [{low:.1f}, {high:.1f}]"
            columns[data, "place", system] = f"{places[system]:.0f}"
    return pd.DataFrame(
        {
            f"{data}, {what}": {system: columns.get((data, what, system), "") for system in systems}
            for data in corpora
            for what in ("accuracy", "place", "difference")
        }
    )


def other_tests() -> pd.DataFrame:
    """Runs of a store beyond accuracy on whole captures: under faults, early, with shots, on endless streams.

    Returns:
        A row per corpus, protocol and system, in percent and points: the loss under faults is a mean over severities
        and faults, ``after`` counts ms of touch, ``stopped`` is with the learned stopping rule.
    """
    tables = []
    complete = [r for r in every_result(connect()) if r.complete and r["subset"] == "all" and "+" not in r["data"]]
    circumstances = classes("circumstances")
    for name, metrics in TESTS.items():
        holds = circumstances[name].holds if name in circumstances else lambda r, tag=name: r.kind == tag
        if not (shown := [r for r in complete if holds(r)]):
            continue
        runs = frame_of(shown)
        if "loss" in metrics:
            runs = runs.assign(loss=runs.filter(like="loss.").mean(axis=1))
        runs = runs.sort_values("started").drop_duplicates(NAMED, keep="last")
        tables.append(100 * runs.set_index(NAMED).reindex(columns=list(metrics)).rename(columns=metrics).astype(float))
    return pd.concat(tables, axis=1).round(1).sort_index() if tables else pd.DataFrame()


def main(words: list[str]) -> None:
    """Run what is asked for, and write the table."""
    values = parse(words, {"parts", "jobs", "out"})
    names = values.get("parts", ",".join(PARTS)).split(",")
    for name in names:
        if name not in PARTS:
            raise bench.InputError(f"parts={name}: {nearest(name, PARTS)}")
    out = Path(values.get("out", "reference"))
    if missing := [name for name in ("haart", "haart-aligned", "cuddlebot", "cuddlebot-8x8") if name not in imported()]:
        raise bench.InputError(f"import first: {', '.join(missing)}; see the head of studies/reference.py")
    failed = run_parts(names, convert("jobs", values.get("jobs", "2"), 2), out)
    print("\n".join([f"{len(failed)} commands failed", *failed]))
    other_tests().to_csv(out / "tests.csv")
    side_by_side(CORPORA).to_csv(out / "systems.csv")
    if failed:
        sys.exit(1)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except bench.InputError as error:
        sys.exit(str(error))
