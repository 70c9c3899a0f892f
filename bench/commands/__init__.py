"""The commands. `declarations` has their keys and help; the file of its name has its function.

Files with a longer name belong to the command that they begin with: `run_grids` to ``bench run``.
`printing` is for all of them.
"""

PARTS = {
    "run": "bench.commands.declarations:RUN",
    "choose": "bench.commands.declarations:CHOOSE",
    "report": "bench.commands.declarations:REPORT",
    "data": "bench.commands.declarations:DATA",
    "fit": "bench.commands.declarations:FIT",
    "compare": "bench.commands.declarations:COMPARE_SYSTEMS",
    "stress": "bench.commands.declarations:STRESS",
    "tune": "bench.commands.declarations:TUNE",
    "skin": "bench.commands.declarations:SKIN_DESIGNS",
    "audit": "bench.commands.declarations:AUDIT",
    "ui": "bench.commands.declarations:UI",
    "predict": "bench.commands.declarations:PREDICT",
    "runs": "bench.commands.declarations:RUNS",
    "check": "bench.commands.declarations:CHECK",
}
